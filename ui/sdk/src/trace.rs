//! The trace of a run for the report: time series, marks and paths in bounded memory.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use trocar_scene::{
    Component, DeviceForce, DeviceState, Entity, ForceFeedback, Grasp, Hand, HapticStatus, JawState,
    LinkState, SimTime, Snapshot, Station, TaskState, Teleoperation,
};

use crate::decimate::{Series, Track};
use crate::outline::{Outline, outlines};

/// Buckets of a number over time.
const SERIES_BUCKETS: usize = 1024;
/// Buckets of a path.
const TRACK_BUCKETS: usize = 4096;
/// Width of the first buckets \[s\].
const INTERVAL_SECS: f64 = 0.005;
/// Most seconds of a link that are kept: three hours.
pub const LINK_SECONDS_MAX: usize = 10_800;
/// Buckets of a master and its slave over time: the path's delay has to be seen.
const TELEOPERATION_BUCKETS: usize = 4096;
/// Most links that are kept.
const LINKS_MAX: usize = 64;
/// Most phases, marks and events that are kept; further ones are counted.
pub const MARKS_MAX: usize = 4096;

/// Motion and forces of one hand.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HandTrace {
    /// Path of the instrument's tip in world \[m\].
    pub tip_in_world: Track,
    /// Magnitude of the force that the driver rendered, after its limits \[N\].
    pub applied_force: Series,
    /// Magnitude of the force that haptics commanded \[N\].
    pub asked_force: Series,
    /// Energy observed at the device's port \[J\].
    pub energy: Series,
    /// Full opening of the jaws \[rad\].
    pub jaw_angle: Series,
    /// Intervals in which the instrument held something: from, to \[s\].
    pub held: Vec<(f64, f64)>,
}

impl Default for HandTrace {
    fn default() -> Self {
        let series = || Series::new(INTERVAL_SECS, SERIES_BUCKETS);
        Self {
            tip_in_world: Track::new(INTERVAL_SECS, TRACK_BUCKETS),
            applied_force: series(),
            asked_force: series(),
            energy: series(),
            jaw_angle: series(),
            held: Vec::new(),
        }
    }
}

/// A second of a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinkSecond {
    /// Time \[s\].
    pub secs: f64,
    /// How the link did.
    pub link: LinkState,
}

/// A link of a session over a network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkTrace {
    /// Whether strangers can neither read nor forge what it carries.
    pub protected: bool,
    /// Its seconds, the first [`LINK_SECONDS_MAX`] of them.
    pub seconds: Vec<LinkSecond>,
}

/// A master and its slave over time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TeleoperationTrace {
    /// The master's tip along the world's x axis \[m\].
    pub master_x: Series,
    /// The slave's tip along it \[m\].
    pub slave_x: Series,
    /// Round trip of the newest packet \[s\].
    pub round_trip: Series,
    /// Force on the master's hand \[N\], if forces are fed back.
    pub felt_force: Series,
    /// Force at the slave \[N\], if forces are fed back.
    pub slave_force: Series,
}

impl Default for TeleoperationTrace {
    fn default() -> Self {
        let series = || Series::new(INTERVAL_SECS, TELEOPERATION_BUCKETS);
        Self {
            master_x: series(),
            slave_x: series(),
            round_trip: series(),
            felt_force: series(),
            slave_force: series(),
        }
    }
}

impl TeleoperationTrace {
    fn sample(&mut self, row: &Teleoperation) {
        let secs = row.at.as_secs_f64();
        self.master_x.push(secs, row.master_in_world.translation.x.into());
        if row.applied > SimTime::ZERO {
            self.slave_x.push(secs, row.slave_in_world.translation.x.into());
        }
        if row.round_trip > 0.0 {
            self.round_trip.push(secs, row.round_trip.into());
        }
        if row.feedback != ForceFeedback::None {
            self.felt_force.push(secs, row.felt_in_world.norm().into());
            self.slave_force.push(secs, row.force_in_world.norm().into());
        }
    }
}

/// An event at an instant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// Time \[s\].
    pub secs: f64,
    /// What: an error's kind, a phase, or the name of an event.
    pub what: String,
    /// The entity that it concerns.
    pub subject: Option<String>,
    /// Its position in world \[m\].
    pub position_in_world: Option<[f64; 3]>,
}

/// A run as time series, sampled from snapshots.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunTrace {
    /// Outlines of the scene at the first sample.
    pub outlines: Vec<Outline>,
    /// Hands by side.
    pub hands: BTreeMap<String, HandTrace>,
    /// Links of a session over a network, by the names of their stations.
    pub links: BTreeMap<String, LinkTrace>,
    /// Masters and their slaves, by the sides of their hands.
    pub teleoperations: BTreeMap<String, TeleoperationTrace>,
    /// Phases of the exercise: when each began.
    pub phases: Vec<Mark>,
    /// Steps done over time.
    pub done: Vec<(f64, u32)>,
    /// Errors of the trainee.
    pub errors: Vec<Mark>,
    /// Events of the scene.
    pub events: Vec<Mark>,
    /// Events that were missed, or exceeded the limit.
    pub events_lost: u64,
    /// Time of the last sample \[s\].
    pub secs: f64,
    begun: bool,
    cursor: u64,
    errors_seen: usize,
}

impl RunTrace {
    /// An empty trace.
    pub fn new() -> Self {
        Self::default()
    }

    /// An empty trace of a session that starts at the session time `secs` \[s\]: the scene that it starts with may be
    /// older.
    pub fn starting_at(secs: f64) -> Self {
        Self { secs, ..Self::default() }
    }

    /// Samples the scene. Call it about a hundred times per second; a snapshot older than the last one is ignored.
    pub fn sample(&mut self, scene: &Snapshot) {
        let secs = scene.time().as_secs_f64();
        let secs = if self.begun { secs } else { secs.max(self.secs) };
        if secs < self.secs {
            return;
        }
        self.secs = secs;
        if !self.begun {
            self.begun = true;
            self.outlines = outlines(scene);
        }
        for (entity, hand) in scene.iter::<Hand>() {
            let trace = self.hands.entry(hand.side.as_str().to_owned()).or_default();
            trace.sample(secs, scene, entity, hand.instrument);
            if let Some(row) = scene.get::<Teleoperation>(entity) {
                self.teleoperations.entry(hand.side.as_str().to_owned()).or_default().sample(row);
            }
        }
        if let Some((_, task)) = scene.iter::<TaskState>().next() {
            self.sample_task(secs, scene, task);
        }
        self.sample_links(secs, scene);
        self.sample_events(scene);
    }

    fn sample_links(&mut self, secs: f64, scene: &Snapshot) {
        // A station also sees its own end of its link, under its own number; the host's row of it comes over the link.
        let own = scene.iter::<Station>().map(|(entity, _)| entity.station()).max().unwrap_or(0);
        for (_, station) in scene.iter::<Station>().filter(|(entity, _)| entity.station() == own) {
            if self.links.len() >= LINKS_MAX && !self.links.contains_key(&station.name) {
                continue;
            }
            let trace = self.links.entry(station.name.clone()).or_default();
            trace.protected = station.protected;
            let is_new = trace.seconds.last().is_none_or(|last| last.link != station.link);
            if is_new && station.link.rate > 0.0 && trace.seconds.len() < LINK_SECONDS_MAX {
                trace.seconds.push(LinkSecond { secs, link: station.link });
            }
        }
    }

    fn sample_task(&mut self, secs: f64, scene: &Snapshot, task: &TaskState) {
        let same_phase = self.phases.last().is_some_and(|mark| mark.what == task.phase);
        if !same_phase && !task.phase.is_empty() && self.phases.len() < MARKS_MAX {
            let mark = Mark { secs, what: task.phase.clone(), subject: None, position_in_world: None };
            self.phases.push(mark);
        }
        if self.done.last().is_none_or(|(_, done)| *done != task.done) && self.done.len() < MARKS_MAX {
            self.done.push((secs, task.done));
        }
        for error in task.errors.iter().skip(self.errors_seen) {
            if self.errors.len() < MARKS_MAX {
                // The error's own time may be the exercise's clock: this is the session's.
                self.errors.push(mark(secs, &error.kind, error.entity, scene));
            }
        }
        self.errors_seen = self.errors_seen.max(task.errors.len());
    }

    fn sample_events(&mut self, scene: &Snapshot) {
        let log = scene.events();
        self.events_lost += log.first().saturating_sub(self.cursor);
        for (_, event) in log.since(self.cursor) {
            if self.events.len() < MARKS_MAX {
                self.events.push(mark(event.at.as_secs_f64(), &event.name, Some(event.subject), scene));
            } else {
                self.events_lost += 1;
            }
        }
        self.cursor = log.next();
    }
}

fn mark(secs: f64, what: &str, subject: Option<Entity>, scene: &Snapshot) -> Mark {
    Mark {
        secs,
        what: what.to_owned(),
        subject: subject.map(|entity| scene.name(entity)),
        position_in_world: subject
            .filter(|entity| scene.contains(*entity))
            .map(|entity| scene.world_pose(entity).translation.vector.into()),
    }
}

impl HandTrace {
    fn sample(&mut self, secs: f64, scene: &Snapshot, hand: Entity, instrument: Entity) {
        if scene.contains(instrument) {
            let tip_in_world = scene.world_pose(instrument).translation.vector;
            self.tip_in_world.push(secs, tip_in_world.into());
        }
        // A device's components are usually on the hand; a scenario may put them on the instrument instead.
        if let Some(state) = either::<DeviceState>(scene, hand, instrument) {
            self.applied_force.push(secs, state.applied_force.norm().into());
        }
        if let Some(asked) = either::<DeviceForce>(scene, hand, instrument) {
            self.asked_force.push(secs, asked.force.norm().into());
        }
        if let Some(status) = either::<HapticStatus>(scene, hand, instrument) {
            self.energy.push(secs, status.energy.into());
        }
        if let Some(jaws) = either::<JawState>(scene, instrument, hand) {
            self.jaw_angle.push(secs, jaws.angle.into());
        }
        if let Some(grasp) = either::<Grasp>(scene, instrument, hand) {
            let since = grasp.since.as_secs_f64();
            let room = self.held.len() < MARKS_MAX;
            match self.held.last_mut() {
                Some((_, to)) if since <= *to => *to = secs,
                _ if room => self.held.push((since.min(secs), secs)),
                _ => {}
            }
        }
    }
}

fn either<T: Component>(scene: &Snapshot, first: Entity, second: Entity) -> Option<&T> {
    scene.get::<T>(first).or_else(|| scene.get::<T>(second))
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{Commands, EntityAllocator, Instrument, Name, Pose, Registry, Side, Store, TaskError};

    fn scene() -> (Store, Commands, Entity, Entity) {
        let registry = Registry::standard();
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let (hand, grasper) = (commands.spawn(), commands.spawn());
        commands.put(
            hand,
            Hand { side: Side::Left, instrument: grasper, world_from_device: Pose::default(), scale: 1.0 },
        );
        commands.put(grasper, Instrument::default());
        commands.put(grasper, Name("grasper.left".to_owned()));
        (Store::new(registry), commands, hand, grasper)
    }

    fn commit(store: &mut Store, commands: &mut Commands, millis: u64) -> Snapshot {
        commands.seal();
        store.apply(commands, SimTime::from_millis(millis));
        commands.clear();
        store.snapshot()
    }

    #[test]
    fn a_hand_leaves_its_path_its_force_and_what_it_held() {
        let (mut store, mut commands, hand, grasper) = scene();
        let mut trace = RunTrace::new();
        for i in 0..50u64 {
            let z = i as f64 * 0.001;
            commands.put(grasper, Pose::at(0.01, 0.02, z));
            let state =
                DeviceState { applied_force: nalgebra::Vector3::new(0.0, 3.0, 4.0), ..Default::default() };
            commands.put(hand, state);
            if i == 10 || i == 30 {
                let grasp = Grasp {
                    held: hand,
                    anchor: Pose::default(),
                    since: SimTime::from_millis(i * 10),
                    assisted: false,
                };
                commands.put(grasper, grasp);
            } else if i == 20 || i == 40 {
                commands.remove::<Grasp>(grasper);
            }
            trace.sample(&commit(&mut store, &mut commands, i * 10));
        }
        let left = &trace.hands["left"];
        assert_eq!(left.tip_in_world.iter().last().unwrap().1, [0.01, 0.02, 0.049]);
        assert_eq!(left.applied_force.range(), Some((5.0, 5.0)));
        let millis = |secs: f64| (secs * 1e3).round() as u32;
        let held: Vec<_> = left.held.iter().map(|(from, to)| (millis(*from), millis(*to))).collect();
        assert_eq!(held, [(100, 190), (300, 390)]);
        assert!(left.energy.is_empty(), "nobody wrote a haptic status");
        assert!((trace.secs - 0.49).abs() < 1e-9);
    }

    #[test]
    fn phases_errors_and_events_are_taken_once_and_an_old_snapshot_not_at_all() {
        let (mut store, mut commands, hand, grasper) = scene();
        let mut trace = RunTrace::new();
        commands.put(grasper, Pose::at(0.0, 0.0, 0.05));
        let mut task = TaskState { phase: "lift".to_owned(), steps: 12, ..TaskState::default() };
        commands.put(hand, task.clone());
        commands.event("lifted", grasper, None, 1.0);
        let first = commit(&mut store, &mut commands, 10);
        trace.sample(&first);
        trace.sample(&first);
        task.phase = "place".to_owned();
        task.done = 1;
        let error = TaskError { kind: "drop_in_view".to_owned(), at_secs: 0.0, entity: Some(grasper) };
        task.errors.push(error);
        commands.put(hand, task);
        commands.event("placed", grasper, None, 1.0);
        trace.sample(&commit(&mut store, &mut commands, 20));
        trace.sample(&first);
        let names = |marks: &[Mark]| marks.iter().map(|mark| mark.what.clone()).collect::<Vec<_>>();
        assert_eq!(names(&trace.phases), ["lift", "place"]);
        assert_eq!(names(&trace.events), ["lifted", "placed"]);
        assert_eq!(trace.done, [(0.01, 0), (0.02, 1)]);
        assert_eq!(trace.errors.len(), 1);
        assert_eq!(trace.errors[0].subject.as_deref(), Some("grasper.left"));
        assert_eq!(trace.errors[0].position_in_world, Some([0.0, 0.0, 0.05]));
        assert_eq!((trace.events_lost, trace.secs), (0, 0.02));
    }
}
