//! Instruments that hands lead, as a thread meets them: coupled to their hands and solved with the thread, and how far they
//! have given way, for the controller of the instruments and for a restart.
//!
//! Only instruments with an [`InstrumentDeflection`] give way here: others are moved by a world of rigid bodies.

use nalgebra::{Isometry3, Vector3};
use trocar_dynamics::instrument::deflection::{InstrumentDeflection, InstrumentYield, InstrumentYields};
use trocar_dynamics::instrument::hand_coupling::HandCoupling;
use trocar_scene::{Access, Commands, Entity, EntitySet, Instrument, SimTime, Snapshot};

use super::obstacles::ObstacleParts;
use crate::suture_thread::{LedInstrument, LedMotion, Reaction};

/// One of them in the current tick, in the thread's frame.
#[derive(Clone, Copy, Debug)]
struct Led {
    instrument: Entity,
    /// The displacement by this thread that its pose in the scene contains \[m\].
    drawn: Vector3<f64>,
    impulse: Vector3<f64>,
}

/// All of them.
#[derive(Clone, Debug, Default)]
pub struct LedInstruments {
    list: Vec<Led>,
    /// In the same order, for the solver.
    solved: Vec<LedInstrument>,
    yields: InstrumentYields,
    is_told: bool,
}

impl LedInstruments {
    /// Resumes from the scene.
    #[must_use]
    pub fn resume(scene: &Snapshot, thread: Entity) -> Self {
        let known = scene.get::<InstrumentYields>(thread);
        let is_told = known.is_some() || scene.iter::<Instrument>().next().is_none();
        Self { yields: known.cloned().unwrap_or_default(), is_told, ..Self::default() }
    }

    /// What a controller with these threads reads and writes for them.
    #[must_use]
    pub fn access(access: Access, threads: &[Entity]) -> Access {
        access.reads::<InstrumentDeflection>().writes::<InstrumentYields>(EntitySet::Of(threads.to_vec()))
    }

    /// Begins a tick.
    pub fn begin(&mut self, scene: &Snapshot, thread: Entity, world_from_thread: &Isometry3<f64>) {
        self.list.clear();
        self.solved.clear();
        let own = |of: &Vector3<f64>| world_from_thread.rotation.inverse_transform_vector(of);
        let mut entities: Vec<Entity> =
            scene.iter::<InstrumentDeflection>().map(|(entity, _)| entity).collect();
        entities.sort_unstable();
        for entity in entities {
            let (Some(told), Some(instrument)) =
                (scene.get::<InstrumentDeflection>(entity), scene.get::<Instrument>(entity))
            else {
                continue;
            };
            let known = self.yields.of(entity);
            let drawn = own(&told.of(thread).offset);
            self.list.push(Led { instrument: entity, drawn, impulse: Vector3::zeros() });
            self.solved.push(LedInstrument {
                obstacles: [0; 2],
                coupling: HandCoupling::of(instrument, told.force_max),
                offset: known.map_or_else(Vector3::zeros, |known| own(&known.offset)),
                velocity: known.map_or_else(Vector3::zeros, |known| own(&known.velocity)),
            });
        }
    }

    /// From an instrument's pose in the scene to where its hand leads it, and from there to where it is \[m\].
    #[must_use]
    pub fn shifts(&self, instrument: Entity) -> [Vector3<f64>; 2] {
        let at = self.list.iter().position(|led| led.instrument == instrument);
        at.map_or_else(Default::default, |at| [-self.list[at].drawn, self.solved[at].offset])
    }

    /// Finds their parts among the obstacles; drops those without.
    pub fn find(&mut self, parts: &ObstacleParts) {
        let found = |led: &Led| {
            let is_own =
                |part: &super::obstacles::Part| part.met.entity == led.instrument && part.rod.is_some();
            Some([parts.list.iter().position(is_own)?, parts.list.iter().rposition(is_own)?])
        };
        let obstacles: Vec<Option<[usize; 2]>> = self.list.iter().map(found).collect();
        let mut at = obstacles.iter();
        self.list.retain(|_| at.next().is_some_and(Option::is_some));
        let mut at = obstacles.iter();
        self.solved.retain_mut(|solved| {
            let found = at.next().copied().flatten();
            solved.obstacles = found.unwrap_or_default();
            found.is_some()
        });
    }

    /// For the solver.
    #[must_use]
    pub fn solved(&self) -> &[LedInstrument] {
        &self.solved
    }

    /// After a step of the solver.
    pub fn end_step(&mut self, motions: &[LedMotion], parts: &mut ObstacleParts) {
        for ((led, solved), motion) in self.list.iter_mut().zip(&mut self.solved).zip(motions) {
            (solved.offset, solved.velocity) = (motion.offset, motion.velocity);
            led.impulse += motion.impulse;
            parts.displace(led.instrument, &motion.offset);
        }
    }

    /// Ends a tick of `period` \[s\] with these mean reactions of the obstacles.
    pub fn end(
        &mut self,
        reactions: &[Reaction],
        world_from_thread: &Isometry3<f64>,
        period: f64,
        now: SimTime,
    ) {
        let world = |of: Vector3<f64>| world_from_thread.rotation * of;
        let told = |(led, solved): (&Led, &LedInstrument)| {
            let [first, last] = solved.obstacles;
            let contact = reactions[first..=last].iter().map(|reaction| reaction.force).sum();
            let told = InstrumentYield {
                instrument: led.instrument,
                offset: world(solved.offset),
                velocity: world(solved.velocity),
                coupling_force: world(led.impulse / period),
                contact_force: world(contact),
            };
            let [a, b, c, d] = [told.offset, told.velocity, told.coupling_force, told.contact_force];
            [a, b, c, d].iter().any(|of| *of != Vector3::zeros()).then_some(told)
        };
        let list: Vec<InstrumentYield> = self.list.iter().zip(&self.solved).filter_map(told).collect();
        // One more when nothing is held back any longer; then nothing until something is.
        self.is_told &= list.is_empty() && self.yields.list.is_empty();
        self.yields = InstrumentYields { list, at: now, ..InstrumentYields::default() };
    }

    /// The body moves no more: it holds nothing back.
    pub fn release(&mut self, now: SimTime) {
        self.is_told &= self.yields.list.is_empty();
        self.yields = InstrumentYields { at: now, ..InstrumentYields::default() };
    }

    /// Writes what has changed.
    pub fn publish(&mut self, thread: Entity, out: &mut Commands) {
        if !self.is_told {
            self.is_told = true;
            out.put(thread, self.yields.clone());
        }
    }
}
