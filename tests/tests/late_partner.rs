//! A late partner breaks nothing: every shipped scenario is struck at its busiest moment, each of its controllers is
//! stalled for a short and for a long time, slowed down five times, killed, and late with its results by most of a period.
//!
//! Whoever is late, in the seconds after it no node and no body is faster than [`bounded::SPEED_MAX`](trocar_tests::bounded::SPEED_MAX) or
//! farther than [`bounded::REACH`](trocar_tests::bounded::REACH) from where bodies were, nothing stands still that moved before, hands feel at most their device's limit and no force
//! that nobody renews, and every controller works on. A sample is run by default, the whole grid in a thorough run.
//!
//! One run of a scenario up to its moment serves all its cells: each is a branch of it under a fault plan of its own.

use trocar::kernel::faults::{FaultPlan, secs};
use trocar::kernel::runtime::ControllerReport;
use trocar::prelude::*;
use trocar::run::run;
use trocar_scene::random::SplitMix64;
use trocar_test_support::thorough;
use trocar_tests::app;
use trocar_tests::bounded::Bounded;

/// Longest time for which a driver renders a force that nobody renews.
const FORCE_AGE_MAX: SimTime = SimTime::from_millis(20);
/// Time between two looks at the scene.
const LOOK_EVERY: SimTime = SimTime::from_millis(10);
/// Session time that a cell lasts beyond its fault \[s\].
const AFTERWARDS: f64 = 1.5;

/// The moment at which a scenario is struck \[s\]: instruments hold, press or cut.
const MOMENTS: [(&str, f64); 17] = [
    ("peg-transfer", 6.0),
    ("wall", 0.8),
    ("collision-gallery", 1.0),
    ("soft-stomach", 3.0),
    ("fem-liver", 3.0),
    ("two-rates", 3.0),
    ("omentum", 2.0),
    ("band", 3.0),
    ("cloth-cut", 6.0),
    ("cautery", 4.0),
    ("bleeding", 4.0),
    ("needle-tissue", 5.0),
    ("knot", 6.0),
    ("tube-loop", 4.0),
    ("instruments", 2.0),
    ("tele-liver", 3.0),
    ("tele-palpation", 5.0),
];

/// What makes a partner late.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Late {
    /// A step hangs for this long \[s\].
    Stall(f64),
    /// For two seconds each step takes as long as this many periods.
    Slow(f64),
    Kill,
    /// For two seconds what it writes arrives this share of a period later, as by a step that computes for so long.
    Computing(f64),
}

const ALL: [Late; 5] =
    [Late::Stall(0.2), Late::Stall(2.0), Late::Slow(5.0), Late::Kill, Late::Computing(0.9)];

impl Late {
    fn plan(self, controller: &str, rate_hz: f64, at: f64) -> FaultPlan {
        let plan = FaultPlan::new(1).at(secs(at));
        match self {
            Self::Stall(span) => plan.lasting(secs(span)).stall(controller),
            Self::Slow(times) => plan.lasting(secs(self.span())).slow(controller, secs(times / rate_hz)),
            Self::Kill => plan.kill(controller),
            Self::Computing(share) => {
                plan.lasting(secs(self.span())).delay(controller, secs(share / rate_hz))
            }
        }
    }

    fn span(self) -> f64 {
        match self {
            Self::Stall(span) => span,
            Self::Slow(_) | Self::Computing(_) => 2.0,
            Self::Kill => 0.0,
        }
    }
}

/// A scenario at its moment.
struct Struck {
    name: &'static str,
    at: f64,
    controllers: Vec<(String, f64)>,
    session: Session,
}

impl Struck {
    fn new(app: &App, name: &'static str) -> Self {
        let (_, at) = MOMENTS.iter().find(|(known, _)| *known == name).expect("a moment of this scenario");
        let scenario = app.scenario(name).expect("a shipped scenario");
        let controllers = scenario.controllers.iter().map(|of| (of.name.clone(), of.rate_hz)).collect();
        let mut session = Session::builder().app(app).open_scenario(&scenario).expect("it begins");
        assert!(session.run_until(secs(*at)), "{name} is over before {at} s");
        Self { name, at: *at, controllers, session }
    }

    /// What is wrong after `controller` was late, one line each.
    fn strike(&mut self, controller: &str, late: Late) -> Vec<String> {
        let cell = format!("{} / {controller} / {late:?}", self.name);
        let rate_hz = self.controllers.iter().find(|(name, _)| name == controller).expect("a controller").1;
        let mut seen = Bounded::around(&self.session.snapshot());
        if self.name == "collision-gallery" {
            // Its stones are thrown through the detectors and fly on.
            seen.reach_max = f64::INFINITY;
        }
        let plan = late.plan(controller, rate_hz, self.at + 0.01);
        let mut session = match self.session.branch_with_faults(plan.clone()) {
            Ok(branch) => branch,
            // A hand behind a packet reflector exists only once: the same seed brings another one to the same moment.
            Err(BranchError::Device(_)) => {
                let app = app();
                let scenario = app.scenario(self.name).expect("a shipped scenario");
                let again = Session::builder().app(&app).faults(plan).open_scenario(&scenario);
                let mut again = again.expect("it begins");
                assert!(again.run_until(secs(self.at)));
                again
            }
            Err(error) => panic!("{}: no branch: {error}", self.name),
        };
        let until = secs(self.at + late.span() + AFTERWARDS);
        let mut goes_on = true;
        while goes_on && session.now() < until {
            goes_on = session.step(LOOK_EVERY);
            seen.look(&session.snapshot());
        }
        // Who does not work at the end, unless the exercise is over.
        let worked = session.reports();
        if goes_on && session.step(secs(0.2)) {
            for (before, after) in worked.iter().zip(session.reports()) {
                let ran = |row: &ControllerReport| row.scheduled - row.missed;
                if ran(&after) == ran(before) {
                    seen.wrong.insert(format!("{} does nothing any more", after.name));
                }
            }
        }
        let finished = session.finish();
        seen.wrong.extend(finished.outcome.held.iter().map(|(name, why)| format!("{name} was {why}")));
        seen.wrong.extend(finished.outcome.reason.clone());
        if finished.force_age_max() > FORCE_AGE_MAX {
            let age = finished.force_age_max().as_secs_f64() * 1e3;
            seen.wrong.insert(format!("a force was held for {age:.1} ms"));
        }
        println!(
            "{cell}: {:.2} m/s, {:.1} mm outside, {:.2} N; {:?}",
            seen.speed,
            seen.reach.max(0.0) * 1e3,
            finished.force_newtons_max,
            seen.wrong
        );
        seen.wrong.into_iter().map(|wrong| format!("{cell}: {wrong}")).collect()
    }
}

/// A controller and what makes it late.
type Cell = (&'static str, Late);

/// The cells that are run by default: what broke something once, with its neighbours, and each kind of solver.
const SAMPLE: [(&str, &[Cell]); 6] = [
    (
        "omentum",
        &[
            ("organs", Late::Slow(2.0)),
            ("organs", Late::Slow(5.0)),
            ("organs", Late::Slow(12.0)),
            ("organs", Late::Stall(0.2)),
            ("organs", Late::Computing(0.3)),
            ("organs", Late::Computing(0.9)),
            ("omentum", Late::Slow(5.0)),
            ("instruments", Late::Stall(2.0)),
        ],
    ),
    (
        "band",
        &[
            ("stomach", Late::Slow(5.0)),
            ("band", Late::Slow(5.0)),
            ("band", Late::Stall(0.2)),
            ("stomach", Late::Computing(0.9)),
        ],
    ),
    ("two-rates", &[("organ", Late::Slow(5.0)), ("membrane", Late::Stall(0.2))]),
    ("fem-liver", &[("liver", Late::Slow(5.0)), ("liver", Late::Stall(2.0)), ("trainee", Late::Kill)]),
    ("tube-loop", &[("thread", Late::Slow(5.0))]),
    ("peg-transfer", &[("engine", Late::Slow(5.0)), ("haptics.right", Late::Stall(2.0))]),
];

/// Strikes every cell of the sample, or of the grid in a thorough run; `TROCAR_GRID=band,knot` chooses its scenarios.
#[test]
fn a_late_partner_breaks_nothing() {
    let app = app();
    let chosen = std::env::var("TROCAR_GRID").ok();
    let is_chosen = |name: &str| chosen.as_ref().is_none_or(|names| names.split(',').any(|of| of == name));
    let mut wrong = Vec::new();
    if thorough() {
        for (name, _) in MOMENTS.into_iter().filter(|(name, _)| is_chosen(name)) {
            let mut struck = Struck::new(&app, name);
            for (controller, _) in struck.controllers.clone() {
                wrong.extend(ALL.into_iter().flat_map(|late| struck.strike(&controller, late)));
            }
        }
    } else {
        for (name, cells) in SAMPLE {
            let mut struck = Struck::new(&app, name);
            wrong.extend(cells.iter().flat_map(|(controller, late)| struck.strike(controller, *late)));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// How long a step takes in a spell, at random of these multiples of [`UNITS`]; 1 is on time. At 60 the supervisor takes a
/// step for hung, and begins another life of its controller.
const TIMES: [f64; 6] = [1.0, 3.0, 7.0, 15.0, 30.0, 60.0];
/// The controllers that are late: one period of the membrane's, and 0.4 of the organs' \[s\].
const UNITS: [(&str, f64); 2] = [("organs", 0.004), ("omentum", 0.002)];
/// Until when they are late \[s\].
const LATE_UNTIL: f64 = 1.6;
/// Numbers of the plans that threw the membrane once, at 15, 9 and 6 m/s.
const BROKE_ONCE: [u64; 3] = [176, 42, 15];
/// How many plans are run in a thorough run.
const PLANS: u64 = 400;

/// A plan in which both partners of a coupling are late at once, by spells of 30 to 280 ms of its own each.
fn both_late(seed: u64) -> FaultPlan {
    let mut random = SplitMix64::new(seed);
    let mut plan = FaultPlan::new(1);
    for (controller, unit) in UNITS {
        let mut at = 0.003;
        while at < LATE_UNTIL {
            let span = 0.03 + 0.25 * random.unit();
            let times = TIMES[random.below(TIMES.len() as u64) as usize];
            if times > 1.0 {
                plan = plan.at(secs(at)).lasting(secs(span)).slow(controller, secs(times * unit));
            }
            at += span + 0.001;
        }
    }
    plan
}

/// A membrane and the organs that it has grown onto, while a shaft presses on it.
#[test]
fn both_partners_late_at_random_break_nothing() {
    let app = app();
    let scenario = app.scenario("omentum").expect("a shipped scenario");
    let mut wrong = Vec::new();
    let seeds: Vec<u64> = if thorough() { (1..=PLANS).collect() } else { BROKE_ONCE.to_vec() };
    for seed in seeds {
        let session = Session::builder().app(&app).faults(both_late(seed)).open_scenario(&scenario);
        let mut session = session.expect("it begins");
        let mut seen = Bounded::around(&session.snapshot());
        while session.now() < secs(LATE_UNTIL + 0.1) && session.step(LOOK_EVERY) {
            seen.look(&session.snapshot());
        }
        println!("plan {seed}: {:.2} m/s ({}); {:?}", seen.speed, seen.fastest, seen.wrong);
        wrong.extend(seen.wrong.into_iter().map(|wrong| format!("plan {seed}: {wrong}")));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// A partner that computes for almost a whole period writes late but misses nothing: the exercise is completed as ever.
#[test]
fn a_partner_that_computes_for_long_changes_no_result() {
    let app = app();
    let scenario = app.scenario("omentum").expect("a shipped scenario");
    for delay in [0.003, 0.009] {
        let plan = FaultPlan::new(1).at(secs(0.001)).lasting(secs(60.0)).delay("organs", secs(delay));
        let options = RunOptions { lockstep: true, faults: Some(plan), ..RunOptions::default() };
        let task = run(&app, &scenario, &options, &mut |_| {}).expect("the session starts").summary.task;
        assert!(task.completed, "{delay} s late: {task:?}");
    }
}

/// Every shipped scenario has a moment.
#[test]
fn every_shipped_scenario_is_in_the_grid() {
    let mut moments: Vec<&str> = MOMENTS.iter().map(|(name, _)| *name).collect();
    let mut shipped: Vec<&str> = trocar::app::SCENARIOS.iter().map(|(name, _)| *name).collect();
    moments.sort_unstable();
    shipped.sort_unstable();
    assert_eq!(moments, shipped);
}
