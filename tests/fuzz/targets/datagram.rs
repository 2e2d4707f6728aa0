//! Datagrams of a station that was let in, and of strangers: header, seal, hands, link report and block of compensation,
//! each with what acts on it: opener, receiver and sender of hands, door, and the ends of a coupling.
#![no_main]

use std::collections::BTreeSet;

use libfuzzer_sys::fuzz_target;
use nalgebra::Vector3;
use trocar_devices::{Capabilities, Dofs, Workspace};
use trocar_fuzz::{Step, first, first_chunk, steps, touches};
use trocar_network::compensation::{
    BLOCK_BYTES, Compensation, CompensationBlock, CouplingConfig, CouplingSample, MasterEnd, MasterReading,
    SlaveEnd,
};
use trocar_network::datagram::{
    DATAGRAM_MAX, HAND_BYTES, HEADER_BYTES, Hands, Header, Keys, Kind, Opener, PAYLOAD_MAX, REPLAY_WINDOW,
    ROTATION_TOLERANCE, ReceiveKey, Refused, Sealer, SendKey, Side, encode_hands,
};
use trocar_network::hand_sample::HandSample;
use trocar_network::haptic::{
    HEARTBEAT, HapticReceiver, HapticSender, LinkReport, Order, REPORT_BYTES, SenderConfig,
};
use trocar_network::remote_hand::{Door, DoorLimits};
use trocar_scene::SimTime;

const CONNECTION: u32 = 7;
const HANDS: [u8; 2] = [0, 1];
const GRACE: SimTime = SimTime::from_millis(100);
/// The edges of the device's workspace \[m\].
const EDGES: [f64; 3] = [0.16, 0.12, 0.07];

/// Keys of a phase, known to both ends and to whoever wrote the input.
fn keys(phase: u32) -> Keys {
    let export = |_: &[u8], context: &[u8], out: &mut [u8]| -> Result<(), ()> {
        for (at, byte) in out.iter_mut().enumerate() {
            *byte = (at as u8).wrapping_mul(31) ^ context[at % context.len()];
        }
        Ok(())
    };
    Keys::from_exporter(CONNECTION, phase, export).expect("it exports")
}

fn of_client(keys: Keys) -> SendKey {
    keys.split(Side::Client).0
}

fn of_server(keys: Keys) -> ReceiveKey {
    keys.split(Side::Server).1
}

/// What is known of the numbers that were opened, without a window of bits.
#[derive(Default)]
struct Numbers {
    newest: u64,
    opened: BTreeSet<u64>,
}

impl Numbers {
    fn accept(&mut self, sequence: u64) -> bool {
        let is_in_window = sequence > self.newest || self.newest - sequence < REPLAY_WINDOW;
        let is_new = sequence != 0 && sequence != u64::MAX && is_in_window && self.opened.insert(sequence);
        if is_new {
            self.newest = self.newest.max(sequence);
        }
        is_new
    }
}

struct Station {
    now: SimTime,
    /// Both ends of a link with a key, and the receiving end of one with checksums, for which the input can make any header.
    sealer: Sealer,
    opener: Opener,
    summed: Opener,
    numbers: Numbers,
    /// The last sealed datagram.
    sealed: Vec<u8>,
    hands: Hands,
    receiver: HapticReceiver,
    sender: HapticSender,
    local: [HandSample; 2],
    door: Door,
    coupling: Coupling,
}

struct Coupling {
    master: MasterEnd,
    slave: SlaveEnd,
}

impl Station {
    fn new() -> Self {
        let capabilities = Capabilities {
            name: "bench".into(),
            workspace: Workspace::centred(Vector3::from(EDGES)),
            max_force_newtons: 3.3,
            max_torque: 0.1,
            max_stiffness: 1_000.0,
            input_dofs: Dofs::Six,
            output_dofs: Dofs::Six,
            apparent_mass: 0.05,
        };
        let mut door =
            Door::new(HANDS[0], DoorLimits::default(), &capabilities).expect("the limits are valid");
        door.open(SimTime::ZERO, None);
        let config = CouplingConfig::default();
        Self {
            now: SimTime::ZERO,
            sealer: Sealer::new(of_client(keys(0))),
            opener: Opener::new(of_server(keys(0)), GRACE),
            summed: Opener::new(of_server(Keys::unprotected(CONNECTION, 0)), GRACE),
            numbers: Numbers::default(),
            sealed: Vec::with_capacity(DATAGRAM_MAX),
            hands: Hands::default(),
            receiver: HapticReceiver::new(&HANDS).expect("two hands"),
            sender: HapticSender::new(&SenderConfig::default()),
            local: HANDS.map(HandSample::unknown),
            door,
            coupling: Coupling {
                master: MasterEnd::new(Compensation::Automatic, config),
                slave: SlaveEnd::new(config),
            },
        }
    }

    fn step(&mut self, step: Step<'_>) {
        self.now += SimTime(step.pause_ns);
        match step.what % 9 {
            0 => self.forged(step.bytes),
            1 => self.sealed(step.bytes),
            2 => self.summed(step.bytes),
            3 => self.again(),
            4 => self.rekey(step.bytes),
            5 => self.report(step.bytes),
            6 => self.tick(step.bytes),
            7 => self.couple(step.bytes),
            _ => self.open_door(step.bytes),
        }
    }

    /// Nothing that was not sealed comes in, or moves the window.
    fn forged(&mut self, bytes: &[u8]) {
        let newest = self.opener.newest_sequence();
        let mut datagram = bytes.to_vec();
        let (opened, before) = (self.opener.open(self.now, &mut datagram).is_ok(), newest);
        assert!(!opened && self.opener.newest_sequence() == before, "{bytes:?} was never sealed");
    }

    /// What a station that was let in seals is opened as it was, and once.
    fn sealed(&mut self, bytes: &[u8]) {
        let ([kind, hands], rest) = first_chunk(bytes);
        let (sent_at, payload) = first_chunk(rest);
        let kind = Kind::ALL[usize::from(kind) % Kind::ALL.len()];
        let sent_at = SimTime(u64::from_le_bytes(sent_at));
        let mut out = [0; DATAGRAM_MAX];
        let Ok(length) = self.sealer.seal(kind, hands, sent_at, payload, &mut out) else {
            assert!(!kind.allows_hands(hands) || payload.len() > PAYLOAD_MAX);
            return;
        };
        self.sealed.clear();
        self.sealed.extend_from_slice(&out[..length]);
        let touched = touches();
        let (header, opened) =
            self.opener.open(self.now, &mut out[..length]).expect("it is authentic and new");
        assert_eq!(touches(), touched, "opening allocates nothing");
        assert_eq!((header.kind, header.hands, header.sent_at, opened), (kind, hands, sent_at, payload));
        self.accept(header, payload);
    }

    /// Any header under a checksum: judged by version, connection, phase and number alone.
    fn summed(&mut self, bytes: &[u8]) {
        let mut datagram = bytes.to_vec();
        let mut sum = crc32fast::Hasher::new();
        sum.update(&[1]);
        sum.update(bytes);
        datagram.extend_from_slice(&sum.finalize().to_le_bytes());
        let decoded = Header::decode(bytes);
        let (phase, newest) = (self.summed.phase(), self.summed.newest_sequence());
        let opened =
            self.summed.open(self.now, &mut datagram).map(|(header, payload)| (header, payload.len()));
        match (&decoded, &opened) {
            (Ok(header), Ok((of_opened, payload))) => {
                assert_eq!(header, of_opened);
                assert_eq!(header.encode(), bytes[..HEADER_BYTES]);
                assert_eq!(HEADER_BYTES + payload, bytes.len());
                assert!(header.connection == CONNECTION && self.numbers.accept(header.sequence));
                self.accept(*header, &bytes[HEADER_BYTES..]);
            }
            (Ok(header), Err(refused)) => {
                let is_long = datagram.len() > DATAGRAM_MAX;
                let is_other = header.connection != CONNECTION;
                let is_stale = !is_other && !is_long && matches!(refused, Refused::Stale(_));
                assert!(is_long || is_other || header.phase != phase as u8 || is_stale, "{refused}");
                assert!(!is_stale || !self.numbers.accept(header.sequence), "{refused}");
                assert_eq!(self.summed.newest_sequence(), newest);
            }
            (Err(_), Ok(_)) => panic!("a header that is none was opened"),
            (Err(_), Err(_)) => {}
        }
    }

    fn again(&mut self) {
        let mut datagram = self.sealed.clone();
        assert!(self.opener.open(self.now, &mut datagram).is_err(), "it has been opened before");
    }

    /// The next phase, or any other, which is refused.
    fn rekey(&mut self, bytes: &[u8]) {
        let (phase, rest) = first_chunk(bytes);
        let (phase, next) = (u32::from_le_bytes(phase), self.opener.phase() + 1);
        if first(rest).0.is_multiple_of(4) {
            let before = self.summed.phase();
            let rekeyed = self.summed.rekey(self.now, of_server(Keys::unprotected(CONNECTION, phase)));
            // The one after the newest that is known: after the present one, or after that which waits.
            assert!(rekeyed.is_err() || phase == before + 1 || phase == before + 2, "{phase} after {before}");
            return;
        }
        self.opener.rekey(self.now, of_server(keys(next))).expect("the next phase");
        self.sealer.rekey(of_client(keys(next))).expect("the next phase");
        // The first datagram under it is what the opener waits for.
        self.sealed(&[Kind::Rows as u8]);
        assert_eq!(self.opener.phase(), next);
    }

    /// An authenticated datagram, whatever it says.
    fn accept(&mut self, header: Header, payload: &[u8]) {
        let (now, touched) = (self.now, touches());
        let decoded = header.kind == Kind::Hands && self.hands.decode(header.hands, payload).is_ok();
        if !decoded {
            self.receiver.receive_other(header.sequence, header.sent_at, now);
            assert_eq!(touches(), touched);
            return;
        }
        let (echo, samples) = (self.hands.echo(), self.hands.samples());
        let order = self.receiver.receive(header.sequence, header.sent_at, echo, samples, now);
        if let Some(echo) = echo.filter(|_| order != Order::Repeated) {
            self.sender.echoed(echo, self.receiver.clock(), now);
        }
        for sample in samples {
            assert!(sample.is_valid());
            let admitted = self.door.admit(now, now, sample);
            assert_eq!(admitted.is_ok(), sample.hand == HANDS[0], "{admitted:?}");
        }
        check_door(&mut self.door, now);
        for hand in HANDS {
            if let Some(read) = self.receiver.read(hand, now) {
                assert!(read.sample.is_valid() && (0.0..=1.0).contains(&read.fade));
            }
        }
        let report = self.receiver.report(now);
        assert_eq!(touches(), touched, "nothing allocates at the datagrams' rate");
        if let Some(report) = report {
            assert_eq!(LinkReport::decode(&report.encode()), Ok(report));
        }
        check_encoding(&self.hands, payload);
    }

    fn report(&mut self, bytes: &[u8]) {
        let Ok(report) = LinkReport::decode(bytes) else { return };
        assert_eq!(report.encode(), bytes[..REPORT_BYTES]);
        self.sender.report(&report, self.receiver.clock(), self.now);
        assert!(self.sender.heartbeat() > SimTime::ZERO && self.sender.heartbeat() <= HEARTBEAT);
        assert!((0.0..=1.0).contains(&self.sender.loss()));
    }

    /// The station's own hands move, and go out if the sender says so.
    fn tick(&mut self, bytes: &[u8]) {
        let ([buttons, x, force, sends], _) = first_chunk(bytes);
        self.local[0].state.buttons = u32::from(buttons);
        self.local[0].state.pose_in_device.translation.x = f64::from(x) * 1e-3;
        self.local[1].wrench.force.z = f64::from(force) * 0.1;
        let Some(outgoing) = self.sender.tick(&self.local, self.receiver.clock(), self.now) else { return };
        if sends.is_multiple_of(4) {
            return self.sender.blocked();
        }
        self.sender.sent(&self.local, self.now);
        let mut out = [0; DATAGRAM_MAX];
        let length =
            self.sealer.seal_hands(self.now, outgoing.echo, &self.local, &mut out).expect("they fit");
        let (header, payload) = self.opener.open(self.now, &mut out[..length]).expect("it is authentic");
        let payload = payload.to_vec();
        self.hands.decode(header.hands, &payload).expect("they are valid");
        check_encoding(&self.hands, &payload);
    }

    /// A block of compensation with position, velocity and force of the other end.
    fn couple(&mut self, bytes: &[u8]) {
        let (block, rest) = first_chunk::<BLOCK_BYTES>(bytes);
        let Ok(block_read) = CompensationBlock::decode(&block) else { return };
        assert_eq!(block_read.encode(), block, "it is written in one way only");
        let (vectors, rest) = first_chunk::<36>(rest);
        let number = |at: usize| f64::from(f32::from_le_bytes(std::array::from_fn(|k| vectors[4 * at + k])));
        let vector = |at: usize| Vector3::new(number(at), number(at + 1), number(at + 2));
        let sample =
            CouplingSample { position: vector(0), velocity: vector(3), force: vector(6), block: block_read };
        let (round_trip_ms, times) = first(rest);
        let round_trip = SimTime::from_millis(4 * u64::from(round_trip_ms));
        let Coupling { master, slave } = &mut self.coupling;
        for k in 0..=times.len().min(16) {
            self.now += SimTime::from_millis(1);
            let position = Vector3::x() * (0.01 * (k as f64).sin());
            let reading = MasterReading { position, velocity: Vector3::zeros(), round_trip };
            let received = (k == 0).then_some(&sample);
            let sent = master.step(self.now, &reading, received);
            // What the fullest tank lets through: a spring of 1,000 N/m with 0.2 J.
            assert!(sent.force.norm() <= 20.0 + 1e-9, "{}", sent.force);
            assert_eq!(CompensationBlock::decode(&sent.block.encode()), Ok(sent.block));
            let Some(told) = slave.step(self.now, &Vector3::z(), received) else { continue };
            assert!(told.position.iter().chain(&told.velocity).all(|number| number.is_finite()));
            // A contact is told in single precision.
            let told_again = CompensationBlock::decode(&told.block.encode()).expect("it is valid");
            assert_eq!(told_again.account, told.block.account);
        }
    }

    fn open_door(&mut self, bytes: &[u8]) {
        let what = first(bytes).0;
        self.door.set_holding(what & 1 == 1);
        if what & 2 == 2 {
            let shown = self.door.state();
            self.door.open(self.now, (what & 4 == 4).then_some(&shown));
        }
        check_door(&mut self.door, self.now);
    }
}

/// What comes through a door is a state of the device, whatever came in.
fn check_door(door: &mut Door, now: SimTime) {
    let state = door.step(now);
    assert!(state.is_valid(), "{state:?}");
    let position = state.pose_in_device.translation.vector;
    for (axis, edge) in EDGES.into_iter().enumerate() {
        assert!(position[axis].abs() <= edge / 2.0 + 1e-9, "{position}");
    }
    assert!((0.0..=door.limits().gripper_max).contains(&state.gripper));
    let wrench = door.wrench(now);
    assert!(wrench.force.norm() <= 3.3 + 1e-9 && wrench.torque.norm() <= 0.1 + 1e-9, "{wrench:?}");
}

/// Hands that were read are written as the same bytes, but for the rotations, which were brought to unit length.
fn check_encoding(hands: &Hands, payload: &[u8]) {
    const ECHO: usize = 12;
    const ROTATION: std::ops::Range<usize> = 20..36;
    let mut out = [0; PAYLOAD_MAX];
    let length = encode_hands(hands.echo(), hands.samples(), &mut out).expect("they are valid");
    assert_eq!(length, payload.len());
    assert_eq!(out[..ECHO], payload[..ECHO]);
    let (written, read) = (out[ECHO..length].chunks(HAND_BYTES), payload[ECHO..].chunks(HAND_BYTES));
    for (written, read) in written.zip(read) {
        assert_eq!(written[..ROTATION.start], read[..ROTATION.start]);
        assert_eq!(written[ROTATION.end..], read[ROTATION.end..]);
        for (written, read) in written[ROTATION].chunks(4).zip(read[ROTATION].chunks(4)) {
            let number = |bytes: &[u8]| f32::from_le_bytes(std::array::from_fn(|at| bytes[at]));
            let apart = f64::from(number(written)) - f64::from(number(read));
            assert!(apart.abs() <= 1.01 * ROTATION_TOLERANCE);
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut station = Station::new();
    steps(bytes).for_each(|step| station.step(step));
});
