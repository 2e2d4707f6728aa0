//! Random sessions, and how a failing one is made small.

use std::fmt::Write as _;

use trocar_scene::random::SplitMix64;
use trocar_scene::{Access, Entity, EntitySet};

use super::reference::Reference;
use super::values::{Fuse, KINDS, Kind};

pub const RING: Entity = Entity::new(0, 0, 1);
pub const PEG: Entity = Entity::new(0, 0, 2);

/// What a writer declares.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Claim {
    pub writes: Vec<(Kind, EntitySet)>,
    pub contributes: Vec<Kind>,
    pub spawns: bool,
}

impl Claim {
    pub fn is_onlooker(&self) -> bool {
        self.writes.is_empty() && self.contributes.is_empty() && !self.spawns
    }
    pub fn access(&self) -> Access {
        let mut access = Access::new();
        for (kind, set) in &self.writes {
            access = kind.writes(access, set.clone());
        }
        for kind in &self.contributes {
            access = kind.contributes(access);
        }
        access.spawns = self.spawns;
        access
    }
}

/// One command of a batch.
#[derive(Clone, Debug)]
pub enum Write {
    Put(Kind, Entity, u8),
    Remove(Kind, Entity),
    Contribute(Kind, u8),
    Transfer(Kind, Entity, u16),
    Spawn(Entity),
    Despawn(Entity),
    /// Not changed after this revision.
    Require(Kind, Entity, u64),
    Event {
        value: u8,
        finite: bool,
    },
    Unregistered,
    NotFinite(Entity),
}

/// One thing that happens to a Model.
#[derive(Clone, Debug)]
pub enum Step {
    Batch {
        writer: u16,
        epoch: u32,
        time_ns: u64,
        writes: Vec<Write>,
        fuse: Option<Fuse>,
    },
    Fence {
        writer: u16,
        epoch: u32,
    },
    /// A new life of a writer that declares something else.
    Reborn {
        writer: u16,
        epoch: u32,
        claim: Claim,
    },
    Publish {
        take_commits: bool,
    },
    /// A panic elsewhere: nothing was being applied.
    Recover,
}

/// Choices of a session.
pub struct Random(SplitMix64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }
    pub fn next(&mut self) -> u64 {
        self.0.next_u64()
    }
    pub fn below(&mut self, n: usize) -> usize {
        self.0.below(n as u64) as usize
    }
    pub fn chance(&mut self, percent: usize) -> bool {
        self.below(100) < percent
    }
    pub fn of<T: Clone>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())].clone()
    }
}

/// Entities that a session may name: neighbours, and some in another chunk, page and spawner.
pub fn universe() -> Vec<Entity> {
    let mut all = vec![RING, PEG, Entity::new(0, 0, 9)];
    for spawner in 1..=4 {
        all.extend([0, 1, 2, 70, 5_000].map(|counter| Entity::new(0, spawner, counter)));
    }
    all.push(Entity::new(7, 1, 1));
    all
}

/// What the three writers declare in the beginning.
pub fn first_claims() -> [(u16, Claim); 3] {
    let engine = Claim {
        writes: vec![
            (Kind::Bomb, EntitySet::All),
            (Kind::Count, EntitySet::Of(vec![RING])),
            (Kind::Count, EntitySet::Own),
            (Kind::Level, EntitySet::All),
        ],
        contributes: vec![Kind::Pairs, Kind::Shadow],
        spawns: true,
    };
    let pilot = Claim {
        writes: vec![(Kind::Count, EntitySet::Of(vec![PEG]))],
        contributes: vec![Kind::Pairs],
        spawns: false,
    };
    let guest = Claim {
        writes: vec![(Kind::Count, EntitySet::Own), (Kind::Shadow, EntitySet::Own)],
        contributes: vec![Kind::Pairs],
        spawns: true,
    };
    [(1, engine), (2, pilot), (3, guest)]
}

/// Makes sessions up. Looks at the reference, so that most batches go through and reach deep states.
pub struct Author<'a> {
    pub random: &'a mut Random,
    pub universe: &'a [Entity],
}

impl Author<'_> {
    pub fn step(&mut self, now: &Reference) -> Step {
        let writer = if self.random.chance(2) { 4 } else { self.random.of(&[1, 1, 2, 3]) };
        let epoch = now.writers.get(&writer).map_or(1, |writer| writer.epoch);
        match self.random.below(100) {
            0..70 => self.batch(now, writer, epoch),
            70..78 => {
                let ahead = self.random.of(&[0, 1, 1, 1, 3]);
                Step::Fence { writer, epoch: epoch + ahead }
            }
            78..83 => {
                let claim = self.claim();
                Step::Reborn { writer: self.random.of(&[1, 2, 3]), epoch: epoch + 4, claim }
            }
            83..97 => Step::Publish { take_commits: self.random.chance(50) },
            _ => Step::Recover,
        }
    }

    fn batch(&mut self, now: &Reference, writer: u16, epoch: u32) -> Step {
        let fuse = self.random.chance(12).then(|| {
            self.random.of(&[Fuse::Check, Fuse::Encode, Fuse::EncodeFails, Fuse::Replace, Fuse::Replace])
        });
        // An honest writer mostly does what it may; a wild one does anything.
        let honest = self.random.chance(80);
        let mut writes: Vec<Write> = Vec::new();
        for _ in 0..self.random.of(&[0, 1, 1, 2, 2, 3, 4, 6]) {
            let tries = if honest { 12 } else { 1 };
            for _ in 0..tries {
                writes.push(self.write(now, writer));
                if !honest || now.objections(writer, epoch, &writes, None).is_empty() {
                    break;
                }
                writes.pop();
            }
        }
        if honest && self.random.chance(15) {
            // One flaw in an otherwise good batch.
            let flaw = self.flaw(now, writer);
            writes.push(flaw);
        }
        let epoch = match self.random.below(100) {
            0..4 => epoch - 1,
            4..6 => epoch + 1,
            _ => epoch,
        };
        let time_ns = self.random.next() % 1_000_000;
        Step::Batch { writer, epoch, time_ns, writes, fuse }
    }

    fn entity(&mut self, writer: u16) -> Entity {
        match self.random.below(10) {
            0..3 => RING,
            3..5 => PEG,
            5..8 => {
                let counter = self.random.of(&[0, 1, 1, 2, 70, 5_000]);
                Entity::new(0, writer, counter)
            }
            _ => self.random.of(self.universe),
        }
    }

    fn write(&mut self, now: &Reference, writer: u16) -> Write {
        let kind = self.random.of(&KINDS);
        let entity = self.entity(writer);
        let value = self.random.next() as u8;
        match self.random.below(100) {
            0..38 => Write::Put(kind, entity, value),
            38..48 => Write::Remove(kind, entity),
            48..60 => Write::Contribute(kind, value),
            60..68 => Write::Transfer(kind, entity, self.random.of(&[1, 2, 3, 9])),
            68..80 => Write::Spawn(entity),
            80..86 => Write::Despawn(entity),
            86..92 => {
                let back = self.random.next() % 6;
                Write::Require(kind, entity, now.scene.revision.saturating_sub(back))
            }
            92..97 => Write::Event { value, finite: self.random.chance(70) },
            97 => Write::Unregistered,
            _ => Write::NotFinite(entity),
        }
    }

    fn flaw(&mut self, now: &Reference, writer: u16) -> Write {
        let rows: Vec<_> = now.scene.rows.iter().collect();
        match self.random.below(4) {
            0 if !rows.is_empty() => {
                let ((kind, entity), row) = self.random.of(&rows);
                Write::Require(*kind, *entity, row.revision.saturating_sub(self.random.next() % 3))
            }
            1 => Write::Transfer(self.random.of(&KINDS), Entity::of_writer(0, writer), 2),
            2 => Write::Transfer(Kind::Count, self.random.of(&[RING, PEG]), 9),
            _ => self.write(now, writer),
        }
    }

    fn claim(&mut self) -> Claim {
        let mut claim = Claim { spawns: self.random.chance(60), ..Claim::default() };
        for kind in KINDS {
            if self.random.chance(50) {
                let set = match self.random.below(6) {
                    0 => EntitySet::All,
                    1..3 => EntitySet::Own,
                    _ => EntitySet::Of((0..2).map(|_| self.random.of(self.universe)).collect()),
                };
                claim.writes.push((kind, set));
            }
            if self.random.chance(40) {
                claim.contributes.push(kind);
            }
        }
        claim
    }
}

/// The smallest session found that still `fails`: steps, then commands of batches, are left out in ever smaller
/// pieces (delta debugging; Zeller and Hildebrandt 2002) until nothing more can go.
pub fn minimal(mut steps: Vec<Step>, fails: &dyn Fn(&[Step]) -> bool) -> Vec<Step> {
    loop {
        let before = size(&steps);
        let mut piece = steps.len().div_ceil(2);
        while piece > 0 {
            let mut at = 0;
            while at < steps.len() {
                let mut fewer = steps.clone();
                fewer.drain(at..(at + piece).min(steps.len()));
                if fails(&fewer) {
                    steps = fewer;
                } else {
                    at += piece;
                }
            }
            piece /= 2;
        }
        for at in 0..steps.len() {
            let mut inner = 0;
            while let Some(simpler) = simpler(&steps[at], inner) {
                let mut candidate = steps.clone();
                candidate[at] = simpler;
                if fails(&candidate) {
                    steps = candidate;
                } else {
                    inner += 1;
                }
            }
        }
        if size(&steps) == before {
            return steps;
        }
    }
}

/// The step without its part number `at`; `None` when it has no such part.
fn simpler(step: &Step, at: usize) -> Option<Step> {
    match step {
        Step::Batch { writer, epoch, time_ns, writes, fuse } => {
            let (mut writes, mut fuse) = (writes.clone(), *fuse);
            if at < writes.len() {
                writes.remove(at);
            } else if at == writes.len() && fuse.is_some() {
                fuse = None;
            } else {
                return None;
            }
            Some(Step::Batch { writer: *writer, epoch: *epoch, time_ns: *time_ns, writes, fuse })
        }
        Step::Reborn { writer, epoch, claim } => {
            let mut claim = claim.clone();
            if at < claim.writes.len() {
                claim.writes.remove(at);
            } else if at - claim.writes.len() < claim.contributes.len() {
                claim.contributes.remove(at - claim.writes.len());
            } else {
                return None;
            }
            Some(Step::Reborn { writer: *writer, epoch: *epoch, claim })
        }
        _ => None,
    }
}

fn size(steps: &[Step]) -> usize {
    steps
        .iter()
        .map(|step| match step {
            Step::Batch { writes, fuse, .. } => 1 + writes.len() + usize::from(fuse.is_some()),
            Step::Reborn { claim, .. } => 1 + claim.writes.len() + claim.contributes.len(),
            _ => 1,
        })
        .sum()
}

/// One step a line.
pub fn listing(steps: &[Step]) -> String {
    let mut text = String::new();
    for (number, step) in steps.iter().enumerate() {
        let _ = writeln!(text, "  {number:2}. {step:?}");
    }
    text
}
