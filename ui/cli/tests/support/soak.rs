//! A soak: a host whose scene changes at random, and a station with a hand, over a bad path that breaks now and then. Every
//! second the changes rest until the station holds the host's state again, which digests of both scenes tell.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar::app::App;
use trocar::network::impairments::Impairments;
use trocar::network::replication::{ColumnRates, FeedLimits, ReplicatedColumns, SceneFeed};
use trocar_scene::random::SplitMix64;
use trocar_scene::scenario::Scenario;
use trocar_scene::{Commands, Entity, Name, Parent, Pose, SimTime, Snapshot, Velocity, VertexPositions};

use super::here;
use super::pair::{Pair, place};

/// How long the scene changes in each second, and the time between two changes.
const CHANGES: SimTime = SimTime::from_millis(500);
const CHANGE_EVERY: u64 = 20;
/// Bodies at once, and vertices of one.
const BODIES_MAX: usize = 60;
const VERTICES: usize = 200;
/// Longest rest until both agree: a value that is lost several times in a row; and after a break, the way back as well.
const REST_MAX: SimTime = SimTime::from_millis(3_000);
const BREAK_REST_MAX: SimTime = SimTime::from_millis(8_000);

/// What a soak has shown.
#[derive(Debug, Default)]
pub struct Soaked {
    /// Seconds at whose end both digests were compared, and agreed.
    pub agreed: u64,
    /// Of them, those in which they differed before the rest.
    pub differed: u64,
    /// Breaks of the stream, and times at which the path was gone.
    pub breaks: u64,
    /// Longest rest without a break, and behind one.
    pub rest_max: SimTime,
    pub break_rest_max: SimTime,
    /// Bodies that were there in all.
    pub bodies: u64,
}

/// Both scenes as the soak changes them.
struct Soak {
    pair: Pair,
    random: SplitMix64,
    living: Vec<Entity>,
    /// Number of the next change, which bodies carry as the rate at which they turn.
    change: u64,
    /// The number that each body carried at the station last.
    seen: BTreeMap<Entity, f64>,
    /// What was there before the first change: devices, forces and the figures of links never rest.
    known: BTreeSet<Entity>,
    digests: SceneFeed,
    soaked: Soaked,
}

/// A hand that presses on a wall for half of each second and stays where it is in the other half.
fn scenario_and_hand(seconds: u64, folder: &Path) -> (Scenario, String) {
    let mut rows = String::from("t,x,y,z,qw,qx,qy,qz,gripper\n");
    for second in 0..seconds + 60 {
        let depth = if second % 2 == 0 { 0.0 } else { 0.012 };
        for (at, z) in [(0.0, 0.012 - depth), (0.3, depth)] {
            writeln!(rows, "{},0.0,0.0,{z},1.0,0.0,0.0,0.0,0.0", second as f64 + at).expect("a text");
        }
    }
    let file = folder.join("press.csv");
    std::fs::write(&file, rows).expect("a file");
    (App::new().scenario("wall").expect("a scenario"), format!("right=replay:{}", file.display()))
}

/// Whether it came by a change of the soak.
fn is_body(known: &BTreeSet<Entity>, entity: Entity) -> bool {
    entity.station() == 0 && entity.counter() > 0 && !known.contains(&entity)
}

impl Soak {
    fn new(mut pair: Pair, seed: u64) -> Self {
        let registry = App::new().registry().clone();
        let columns = ReplicatedColumns::new(&registry, &ColumnRates::default()).expect("the defaults hold");
        let known: BTreeSet<Entity> = pair.host.snapshot().entities().collect();
        let others = known.clone();
        let digests = SceneFeed::new(Arc::new(columns), FeedLimits::default());
        Self {
            pair,
            random: SplitMix64::new(seed),
            living: Vec::new(),
            change: 0,
            seen: BTreeMap::new(),
            known,
            digests: digests.of(move |entity| is_body(&others, entity)),
            soaked: Soaked::default(),
        }
    }

    fn one(&mut self) -> Option<Entity> {
        let count = self.living.len() as u64;
        (count > 0).then(|| self.living[self.random.below(count) as usize])
    }

    fn pose(&mut self) -> Pose {
        let mut unit = || 2.0 * self.random.unit() - 1.0;
        Pose::at(0.3 * unit(), 0.3 * unit(), 0.3 * unit())
    }

    /// Something happens at the host: a body comes, goes, moves, is deformed, gets a name or another parent.
    fn change(&mut self) {
        self.change += 1;
        let number = self.change as f64;
        let turning = Velocity { linear: Vector3::zeros(), angular: Vector3::new(number, 0.0, 0.0) };
        let (what, moved, other) = (self.random.below(8), self.one(), self.one());
        let (pose, vertex) = (self.pose(), self.random.below(VERTICES as u64) as usize);
        let goes = self.living.len() >= BODIES_MAX || what == 0;
        let gone = self.one().filter(|_| goes);
        let has_mesh = self.change.is_multiple_of(7);
        let scene = self.pair.host.snapshot();
        let mut came = None;
        let write = |out: &mut Commands| {
            if let Some(gone) = gone {
                out.despawn(gone);
            } else if what <= 2 {
                let body = out.spawn();
                out.put(body, pose);
                out.put(body, turning);
                if has_mesh {
                    let positions = (0..VERTICES).map(|at| Point3::new(1e-3 * at as f64, 0.0, 0.1)).collect();
                    out.put(body, VertexPositions { positions: Arc::new(positions) });
                }
                came = Some(body);
            }
            let Some(body) = moved.filter(|body| Some(*body) != gone) else { return };
            out.put(body, turning);
            match what {
                3 => out.put(body, Name(format!("body {number}"))),
                4 => out.remove::<Name>(body),
                5 => {
                    // An older one, so that nobody becomes its own ancestor.
                    let parent = other.filter(|other| *other < body && Some(*other) != gone);
                    parent.into_iter().for_each(|parent| out.put(body, Parent(parent)));
                    out.event("turned", body, None, number);
                }
                6 => out.remove::<Parent>(body),
                _ => out.put(body, pose),
            }
            if let Some(mesh) = scene.get::<VertexPositions>(body) {
                let mut positions = mesh.positions.as_ref().clone();
                positions[vertex] += 1e-2 * pose.translation;
                out.put(body, VertexPositions { positions: Arc::new(positions) });
            }
        };
        self.pair.host.apply(write).expect("an operator may");
        self.living.retain(|body| Some(*body) != gone);
        self.living.extend(came);
        self.soaked.bodies += u64::from(came.is_some());
    }

    /// A millisecond; no row of the station goes back to an older value.
    fn step(&mut self) {
        assert!(self.pair.step(), "the host goes on");
        let scene = self.pair.station.snapshot();
        for (body, velocity) in scene.iter::<Velocity>().filter(|(body, _)| is_body(&self.known, *body)) {
            let (number, before) = (velocity.angular.x, self.seen.entry(body).or_default());
            assert!(number >= *before, "{body}: change {number} after {before} at {}", self.pair.now);
            *before = number;
        }
    }

    /// Whether the station holds what the host does of the bodies that change.
    fn agrees(&mut self) -> bool {
        let [host, station] = [self.pair.host.snapshot(), self.pair.station.snapshot()];
        let (host, station) = (self.bodies(&host), self.bodies(&station));
        host == station
    }

    /// The digest of the bodies of a scene, and who they are.
    fn bodies(&self, scene: &Snapshot) -> (Vec<Entity>, BTreeMap<u64, u64>) {
        let digest = self.digests.digest(scene).expect("it encodes");
        (scene.entities().filter(|entity| is_body(&self.known, *entity)).collect(), digest.chunks)
    }

    /// A break, or the end of one, that is due in this second; how long the path stays gone \[ms\].
    fn break_off(&mut self, second: u64) -> Option<u64> {
        let gone = match second {
            _ if second % 600 == 599 => 7_000,
            _ if second % 61 == 13 => 1_500,
            _ if second % 47 == 7 => 0,
            _ => return None,
        };
        self.soaked.breaks += 1;
        Some(gone)
    }

    /// A second: the scene changes, maybe the path breaks, and both agree after a rest.
    fn second(&mut self, second: u64) {
        let begin = self.pair.now;
        let break_off = self.break_off(second);
        let mut rests_at = begin + CHANGES;
        for ms in 0.. {
            let now = self.pair.now;
            match break_off {
                Some(0) if ms == 200 => self.pair.wire.disconnect(),
                Some(gone) if gone > 0 && ms == 200 => {
                    self.pair.partition(true);
                    rests_at = now + SimTime::from_millis(gone);
                }
                _ => {}
            }
            if now >= rests_at {
                break;
            }
            if ms % CHANGE_EVERY == 0 {
                self.change();
            }
            self.step();
        }
        if break_off.is_some_and(|gone| gone > 0) {
            self.pair.partition(false);
        }
        let most = if break_off.is_some() { BREAK_REST_MAX } else { REST_MAX };
        let rested = self.pair.now;
        self.soaked.differed += u64::from(!self.agrees());
        while !self.agrees() {
            let rest = self.pair.now.since(rested);
            assert!(rest < most, "second {second}, {}: not the same after a rest of {rest}", self.pair.now);
            (0..10).for_each(|_| self.step());
        }
        let rest = self.pair.now.since(rested);
        let longest = match break_off {
            Some(_) => &mut self.soaked.break_rest_max,
            None => &mut self.soaked.rest_max,
        };
        *longest = rest.max(*longest);
        self.soaked.agreed += 1;
        while self.pair.now.since(begin) < SimTime::from_millis(1_000) {
            self.step();
        }
        // Who is gone at both is looked at no more.
        let scene = self.pair.station.snapshot();
        self.seen.retain(|body, _| scene.contains(*body));
    }
}

/// A soak of so many seconds of virtual time, and of those that breaks took.
pub fn soak(seconds: u64) -> Soaked {
    let folder = here();
    let (scenario, hand) = scenario_and_hand(2 * seconds, folder.path());
    let path = Impairments {
        loss: 0.02,
        jitter: SimTime::from_millis(15),
        independent: true,
        duplicate: 0.01,
        reorder: 0.01,
        corrupt: 0.001,
        ..Impairments::delay(SimTime::from_millis(75))
    };
    let mut soak = Soak::new(Pair::of(&scenario, &path, &[&hand], false), 18);
    for second in 0..seconds {
        soak.second(second);
    }
    let (host, station) = (soak.pair.host.snapshot(), soak.pair.station.snapshot());
    let far = (place(&host, "probe.right").translation - place(&station, "probe.right").translation).norm();
    assert!(far < 1e-4, "the instrument is at one place: {far} m");
    for session in [&soak.pair.host, &soak.pair.station] {
        for report in session.reports() {
            assert!(report.restarts == 0 && report.rejected == 0, "{report:?}");
        }
    }
    soak.soaked
}
