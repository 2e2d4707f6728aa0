//! What peers tell each other: sketches of bodies, requests for a repair and repairs, and invitations of pairs. Whatever comes
//! as a sketch, few bodies are remembered; what an owner answers to a request makes the body the owner's; and what was written
//! is valid.
#![no_main]

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::peer_scene::{BODIES, PEER_COLUMNS, PEER_SCENES, sketches};
use trocar_fuzz::{Bound, Step, first, first_chunk, steps};
use trocar_network::pairs::Invitation;
use trocar_network::peers::comparison::Comparison;
use trocar_network::peers::repair::{self, ROWS_MAX, RepairRequest};
use trocar_network::peers::sketch::{self, Apart};
use trocar_scene::{Commands, Entity, EntityAllocator, SimTime, Store};

/// A sketch takes at least seven bytes and is held as a hundred, in a vector that doubles and in a map of what there is here.
const SKETCHES: Bound = Bound { per_byte: 96, always: 64 << 10 };
/// The dearest bytes are those of a lone row, as in a delta.
const REPAIR: Bound = Bound { per_byte: 512, always: 64 << 10 };
/// Bodies that a comparison may remember.
const DIFFERING_MAX: usize = 1_024;

struct Peer {
    now: SimTime,
    store: Store,
    commands: Commands,
    comparison: Comparison,
}

impl Peer {
    fn new() -> Self {
        let commands = Commands::new(PEER_COLUMNS.registry().clone(), EntityAllocator::new(2, 9));
        let store = Store::from_snapshot(&PEER_SCENES[1]);
        Self { now: SimTime::ZERO, store, commands, comparison: Comparison::default() }
    }

    fn step(&mut self, step: Step<'_>) {
        self.now += SimTime(step.pause_ns);
        let bytes = step.bytes;
        match step.what % 8 {
            0 => self.sketch(bytes),
            1 => self.honest(bytes),
            2 => self.comparison.remember(self.now, &self.store.snapshot()),
            3 => self.repair_asked(),
            4 => {
                let _ = self.repair(bytes);
            }
            5 => {
                // Of a body that is here.
                let (which, rest) = first(bytes);
                let body = BODIES[usize::from(which) % BODIES.len()];
                let _ = self.repair(&[&body.to_bits().to_le_bytes()[..], rest].concat());
            }
            6 => self.request(bytes),
            _ => invitation(bytes),
        }
    }

    /// A payload of sketches; what was read is written and read as the same.
    fn sketch(&mut self, payload: &[u8]) {
        let (now, comparison) = (self.now, &mut self.comparison);
        let compared = SKETCHES.holds(payload.len(), || comparison.compare(now, payload));
        assert!(self.comparison.differing() <= DIFFERING_MAX);
        let read = sketch::read(payload);
        assert_eq!(compared.is_ok(), read.is_ok());
        let Ok((number, read)) = read else { return };
        let again: Vec<_> = sketch::write(number, &read)
            .iter()
            .flat_map(|payload| {
                let (of, again) = sketch::read(payload).expect("it was written");
                assert_eq!(of, number);
                again
            })
            .collect();
        assert_eq!(again.len(), read.len());
        for (read, again) in read.iter().zip(&again) {
            assert_eq!(read.entity, again.entity);
            let apart = read.apart(again);
            assert!(matches!(apart, Apart::By { distance: 0.0, angle } if angle < 1e-2), "{apart:?}");
        }
    }

    /// The owner's sketch of a number, of which a byte may be another one.
    fn honest(&mut self, bytes: &[u8]) {
        let ([number, at, change], _) = first_chunk(bytes);
        for mut payload in sketch::write(number.into(), &sketches(&PEER_SCENES[0], number.into())) {
            let at = usize::from(at) % payload.len();
            payload[at] ^= change;
            self.sketch(&payload);
        }
    }

    /// Asks the owner for what differs, and takes its answers.
    fn repair_asked(&mut self) {
        for entity in self.comparison.take_asked(self.now) {
            let asked = repair::request(&self.store.snapshot(), &PEER_COLUMNS, entity);
            assert!(asked.rows.len() <= ROWS_MAX);
            let Some(answer) = repair::answer(&PEER_SCENES[0], &PEER_COLUMNS, &asked) else { continue };
            // A body that is not here is refused.
            let is_here = self.store.view().contains(entity);
            assert_eq!(self.repair(&answer), is_here.then_some(entity));
            let asked = repair::request(&self.store.snapshot(), &PEER_COLUMNS, entity);
            let differs = repair::answer(&PEER_SCENES[0], &PEER_COLUMNS, &asked).is_some();
            assert!(!is_here || !differs, "{entity} is the owner's now");
        }
    }

    /// A repair becomes a batch that is valid, or has no effect.
    fn repair(&mut self, bytes: &[u8]) -> Option<Entity> {
        let Self { store, commands, .. } = self;
        let scene = store.snapshot();
        let written =
            REPAIR.holds(bytes.len(), || repair::write(bytes, &PEER_COLUMNS, &scene, commands).ok());
        let Some(entity) = written else {
            commands.clear();
            return None;
        };
        commands.seal();
        assert_eq!(commands.error(), None);
        for (_, puts) in commands.puts() {
            assert!((0..puts.len()).all(|row| puts.entity(row) == entity) && puts.check().is_ok());
        }
        assert!(commands.spawns().is_empty() && commands.despawns().is_empty());
        store.check_room(commands).expect("no row is new to its page");
        store.apply(commands, self.now);
        commands.clear();
        // What is there can be sketched.
        let _ = sketches(store.view(), 1);
        Some(entity)
    }

    /// To the owner: what a peer says that it has.
    fn request(&self, bytes: &[u8]) {
        let asked = REPAIR.holds(bytes.len(), || postcard::from_bytes::<RepairRequest>(bytes));
        let Ok(asked) = asked else { return };
        if asked.rows.len() > ROWS_MAX {
            return;
        }
        if let Some(answer) = repair::answer(&PEER_SCENES[0], &PEER_COLUMNS, &asked) {
            assert!(answer.len() <= repair::REPAIR_BYTES_MAX);
            assert_eq!(answer[..8], asked.entity.to_bits().to_le_bytes());
        }
    }
}

/// An invitation is written in one way only.
fn invitation(bytes: &[u8]) {
    if let Ok(invitation) = REPAIR.holds(bytes.len(), || Invitation::read(bytes)) {
        assert_eq!(Invitation::read(&invitation.to_bytes()), Ok(invitation.clone()));
        assert_eq!(invitation.connection(), invitation.clone().connection());
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut peer = Peer::new();
    steps(bytes).for_each(|step| peer.step(step));
});
