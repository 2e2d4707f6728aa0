//! A host and two stations in virtual time, and the bad network day that they have to stand.

use std::collections::{BTreeSet, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

use trocar::app::App;
use trocar::network::impairments::Impairments;
use trocar::network::lockstep::Wire;
use trocar::network::ticket::{ResumeSecret, Role, Ticket};
use trocar::network::{JoinOptions, Joining, LockstepHost, Network};
use trocar::plans;
use trocar::run::{self, FaultTargets, RunOptions};
use trocar::session::{Finished, Session};
use trocar::soak::is_finite;
use trocar_kernel::faults::{Expect, FaultKind, FaultPlan, Measured};
use trocar_kernel::spec::{FaultOrder, FaultSink};
use trocar_scene::{DeviceState, Entity, Hand, Name, Pose, SimTime, Snapshot, Station};

use super::Plan;
use super::lockstep::{SCENARIO, Wrong, millis, violations};
use crate::failure::Failure;

/// The stations, and the hand that each serves.
const SEATS: [(&str, &str); 2] = [("Ana", "left"), ("Bo", "right")];
/// A path between them without faults.
const DELAY: SimTime = SimTime::from_millis(20);
/// Length of the day, and of the quiet time at its end in which nothing is wrong any more \[ms\].
const DAY_MS: u64 = 60_000;
const QUIET_MS: u64 = 3_000;
/// Longest join \[ms\].
const JOIN_MS_MAX: u64 = 10_000;
/// Time after which a program that was killed is started again.
const STARTED_AGAIN_AFTER: SimTime = SimTime::from_millis(200);
/// How far a hand may be from where the other end shows it \[m\].
const APART_MAX: f64 = 1e-3;
/// How far a body may be from where the host had it within the last half second \[m\]: positions travel as numbers of 1 µm.
const POSE_TOLERANCE: f64 = 1e-5;
const HOST_KEPT: usize = 500;
/// When a station that hears nothing renders no force any more, counted from the beginning of a partition: what is under
/// way arrives, fading ends after 100 ms, and the driver takes a few steps \[s\].
const SILENT_SECS: f64 = 0.3;
/// What counts as no force \[N\].
const FORCE_MIN: f64 = 1e-3;
const MS: SimTime = SimTime::from_millis(1);

/// Rows in virtual time.
pub fn lockstep(plan: &mut Plan<'_>) {
    plan.row("lockstep_bad_network_day", |name| {
        violations(name, |seed, wrong| {
            let plan = FaultPlan { seed, ..plans::plan("bad-network-day").map_err(Failure::internal)? };
            day(&plan, seed, wrong)
        })
    });
}

/// Stations whose programs a fault kills.
#[derive(Default)]
struct Killed(Mutex<BTreeSet<String>>);

impl Killed {
    fn names(&self) -> std::sync::MutexGuard<'_, BTreeSet<String>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl FaultSink for Killed {
    fn fault(&self, order: &FaultOrder) {
        if order.kind == FaultKind::Kill
            && order.begins
            && let Some((_, name)) = order.target.split_once('.')
        {
            self.names().insert(name.to_owned());
        }
    }

    fn is_target_sound(&self, target: &str) -> Option<bool> {
        let (_, name) = target.split_once('.')?;
        Some(!self.names().contains(name))
    }
}

/// A station's place in the session.
struct Seat {
    name: &'static str,
    hand: &'static str,
    ticket: Ticket,
    wire: Wire,
    number: usize,
    /// How it comes back after its program was killed.
    resume: Option<ResumeSecret>,
    at: At,
}

/// Where its program is.
enum At {
    /// It joins.
    Door(Box<Joining<usize>>),
    /// It is in the session.
    Table(Box<Session>),
    /// It was killed, and is started again at this time.
    Gone(SimTime),
}

impl Seat {
    fn options(&self) -> JoinOptions {
        JoinOptions {
            name: Some(self.name.to_owned()),
            hands: vec![(self.hand.to_owned(), "virtual".to_owned())],
            resume: self.resume.clone(),
            ..JoinOptions::default()
        }
    }

    fn start(&mut self, app: &App, now: SimTime) -> Result<(), Failure> {
        let (options, wire) = (self.options(), &self.wire);
        self.at = At::Door(Box::new(Joining::over(
            app.registry(),
            &options,
            &self.ticket,
            wire,
            self.number,
            now,
        )?));
        Ok(())
    }

    /// One step of its program; `killed` says who was killed and is not back.
    fn step(&mut self, app: &App, killed: &Killed, seed: u64, now: SimTime) -> Result<(), Failure> {
        match &mut self.at {
            At::Table(session) => {
                if killed.names().contains(self.name) {
                    // Without a word, as a program that is killed.
                    self.at = At::Gone(now + STARTED_AGAIN_AFTER);
                    self.wire.disconnect();
                } else {
                    session.run_until(now);
                }
            }
            At::Gone(until) if *until <= now => self.start(app, now)?,
            At::Gone(_) => {}
            At::Door(joining) => {
                if !now.as_nanos().is_multiple_of(4 * MS.as_nanos()) || !joining.step(now)? {
                    return Ok(());
                }
                let options = self.options();
                let At::Door(joining) = std::mem::replace(&mut self.at, At::Gone(now)) else {
                    return Ok(());
                };
                let joined = joining.joined(&self.wire, self.number);
                let station = joined.ok_or_else(|| Failure::internal("it joined and has no station"))?;
                self.resume = Some(station.resume.clone());
                let station = Arc::new(station);
                let run = RunOptions {
                    lockstep: true,
                    begin: now,
                    seed,
                    hands: options.hands,
                    network: Network::Station(station.clone()),
                    ..RunOptions::default()
                };
                self.at = At::Table(Box::new(run::start(app, &station.scenario, &run)?));
                killed.names().remove(self.name);
            }
        }
        Ok(())
    }

    fn scene(&mut self) -> Option<Arc<Snapshot>> {
        match &mut self.at {
            At::Table(session) => Some(session.snapshot()),
            At::Door(_) | At::Gone(_) => None,
        }
    }
}

/// Runs the day, and says what went wrong.
fn day(plan: &FaultPlan, seed: u64, wrong: &mut Wrong) -> Result<(), Failure> {
    let app = App::new();
    let scenario = app.scenario(SCENARIO)?;
    let (network, killed) = (Arc::new(LockstepHost::new()?), Arc::new(Killed::default()));
    let mut seats = Vec::new();
    for (index, (name, hand)) in SEATS.into_iter().enumerate() {
        let wire = Wire::new(&Impairments::delay(DELAY), seed.wrapping_add(100 * index as u64));
        let number = network.wires().add(wire.clone());
        let ticket = network.ticket(name, Role::Operate)?;
        seats.push(Seat { name, hand, ticket, wire, number, resume: None, at: At::Gone(SimTime::ZERO) });
    }
    let options = RunOptions {
        lockstep: true,
        seed,
        faults: Some(FaultPlan { expect: Expect::default(), ..plan.clone() }),
        fault_targets: FaultTargets(vec![("station.*".to_owned(), killed.clone() as Arc<dyn FaultSink>)]),
        network: Network::LockstepHost(network),
        ..RunOptions::default()
    };
    let mut host = run::start(&app, &scenario, &options)?;
    let (mut kept, mut forces_in_silence) = (VecDeque::new(), 0);
    let mut all_joined = None;
    for ms in 1..=DAY_MS {
        let now = SimTime::from_millis(ms);
        if !host.run_until(now) {
            break;
        }
        for seat in &mut seats {
            seat.step(&app, &killed, seed, now)?;
            if let Some(scene) = seat.scene() {
                forces_in_silence +=
                    u64::from(is_silent(plan, seat.name, now) && force(&scene, seat.hand) > FORCE_MIN);
            }
        }
        if all_joined.is_none() && seats.iter_mut().all(|seat| matches!(seat.at, At::Table(_))) {
            all_joined = Some(ms);
        }
        kept.push_back(host.snapshot());
        if kept.len() > HOST_KEPT {
            kept.pop_front();
        }
    }
    wrong.check(all_joined.is_some_and(|ms| ms < JOIN_MS_MAX), "a station did not come in");
    wrong.check(forces_in_silence == 0, "a force was felt although nothing arrived for more than 100 ms");
    let scene = host.snapshot();
    for seat in &mut seats {
        check_seat(seat, &scene, &kept, wrong);
    }
    let finished = host.finish();
    check_host(plan, &finished, wrong);
    for seat in seats {
        if let At::Table(session) = seat.at {
            let finished = session.finish();
            wrong.check(finished.outcome.code == 0, "a station's session gave up");
            wrong.check(
                finished.force_newtons_max <= plan.expect.force_newtons_max.unwrap_or(0.0),
                "a force at a station was above its limit",
            );
        }
    }
    Ok(())
}

/// Whether a station hears nothing at all by the plan, and has not for so long that its force has faded.
fn is_silent(plan: &FaultPlan, name: &str, now: SimTime) -> bool {
    let partitions = plan.faults.iter().filter(|fault| fault.kind == FaultKind::Partition);
    partitions.filter(|fault| fault.target.strip_prefix("link.") == Some(name)).any(|fault| {
        let until = fault.at + fault.lasting.unwrap_or_default();
        now >= fault.at + SimTime::from_secs_f64(SILENT_SECS) && now < until
    })
}

fn hand_of(scene: &Snapshot, hand: &str) -> Option<Entity> {
    scene.find(&format!("hand.{hand}"))
}

/// What the driver of a hand renders \[N\].
fn force(scene: &Snapshot, hand: &str) -> f64 {
    let state = hand_of(scene, hand).and_then(|entity| scene.get::<DeviceState>(entity));
    state.map_or(0.0, |state| state.applied_force.norm())
}

/// What must be so at a station at the end of the day.
fn check_seat(seat: &mut Seat, host: &Snapshot, kept: &VecDeque<Arc<Snapshot>>, wrong: &mut Wrong) {
    let row = host.iter::<Station>().find(|(_, row)| row.name == seat.name).map(|(_, row)| row.clone());
    let is_here = row.is_some_and(|row| row.here && row.hands == [seat.hand]);
    wrong.check(is_here, "a station is not here at the end, with its hand");
    let Some(scene) = seat.scene() else {
        wrong.check(false, "a station's program does not run at the end");
        return;
    };
    wrong.check(is_finite(&scene), "a number that is none is in a station's scene");
    // The hand, by its own device here and by what the host's shows: within the last half second they were at one place.
    let at = |scene: &Snapshot| {
        let entity = hand_of(scene, seat.hand)?;
        Some(scene.get::<DeviceState>(entity)?.handle_in_device.translation)
    };
    let own = at(&scene);
    let apart = |scene: &Snapshot| Some((at(scene)? - own?).norm());
    let nearest = kept.iter().filter_map(|scene| apart(scene)).fold(f64::INFINITY, f64::min);
    wrong.check(nearest <= APART_MAX, "a hand is not at one place at both ends");
    check_same_scene(seat, &scene, host, kept, wrong);
}

/// The station's copy has all of the host's scene and nothing else, each body where the host had it a moment ago.
fn check_same_scene(
    seat: &Seat,
    scene: &Snapshot,
    host: &Snapshot,
    kept: &VecDeque<Arc<Snapshot>>,
    wrong: &mut Wrong,
) {
    let of_host = |scene: &Snapshot| {
        let named = scene.iter::<Name>().filter(|(entity, _)| entity.station() == 0);
        named.map(|(entity, name)| (entity, name.0.clone())).collect::<BTreeSet<(Entity, String)>>()
    };
    wrong.check(of_host(scene) == of_host(host), "a station does not have what the host has");
    let own_hand =
        hand_of(host, seat.hand).and_then(|entity| host.get::<Hand>(entity)).map(|hand| hand.instrument);
    for (entity, pose) in scene.iter::<Pose>().filter(|(entity, _)| entity.station() == 0) {
        // The instrument of its own hand is where its own hand is.
        if Some(entity) == own_hand {
            continue;
        }
        let was_there = |host: &Arc<Snapshot>| {
            let there = host.get::<Pose>(entity);
            there.is_some_and(|there| (there.translation - pose.translation).norm() <= POSE_TOLERANCE)
        };
        if !kept.iter().rev().any(was_there) {
            wrong.check(false, "a body is where the host has not had it");
        }
    }
}

/// What must be so at the host at the end of the day.
fn check_host(plan: &FaultPlan, finished: &Finished, wrong: &mut Wrong) {
    let outcome = &finished.outcome;
    wrong.check(outcome.code == 0 && outcome.held.is_empty(), "somebody gave up");
    wrong.check(is_finite(&outcome.snapshot), "a number that is none is in the scene");
    let measured = Measured {
        force_newtons_max: finished.force_newtons_max,
        model_restarts: u64::from(outcome.model.restarts),
        task_completed: false,
        ended: SimTime::from_millis(DAY_MS),
    };
    let last = plan.faults.iter().map(|fault| fault.at + fault.lasting.unwrap_or_default()).max();
    wrong.check(
        last.is_some_and(|last| last + SimTime::from_millis(QUIET_MS) < measured.ended),
        "the plan goes on until the end of the day",
    );
    // Of what was killed the time counts from the blow.
    let limit = plan.expect.recovery_secs_max.unwrap_or(0.0) * 1e3;
    for row in outcome.faults.iter().filter(|row| row.kind == FaultKind::Kill) {
        let took = millis(row.injected, row.resumed);
        tracing::info!("{}: back after {took:.0} ms", row.id);
        wrong.check(took <= limit, "what was killed was not back in time");
    }
    for failure in plan.expect.failures(&outcome.faults, &measured) {
        wrong.check(false, &failure);
    }
}
