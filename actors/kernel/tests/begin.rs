//! Sessions in real time that begin later than at zero: the same as any other, at later times.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::support::toys::{eventually, session, toy};
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_kernel::live::{LiveError, LiveSession};
use trocar_kernel::spec::{BEGIN_MAX, ControllerSpec, SessionSpec};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::{Access, Commands, Controller, ControllerError, EntitySet, SimTime, Snapshot, Tick};
use trocar_test_support::alone;

use crate::support::toys::Count;

/// A thousand days would be too late; this is a month.
const BEGIN: SimTime = SimTime(30 * 86_400_000_000_000 + 345_600_000);

/// Number and time of each tick.
type Ticks = Arc<Mutex<Vec<(u64, SimTime)>>>;

struct Noting(Ticks);
impl Controller for Noting {
    fn access(&self) -> Access {
        Access::new().writes::<Count>(EntitySet::Own)
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.0.lock().expect("whole").push((tick.number, tick.time));
        out.put(tick.me, Count(tick.number));
        Ok(())
    }
}

fn noting(name: &str, id: u16, rate_hz: f64) -> (ControllerSpec, Ticks) {
    let ticks = Ticks::default();
    let given = ticks.clone();
    let spec = ControllerSpec::new(name, id, RuntimeClass::Task, rate_hz, move |context| {
        assert!(context.time >= BEGIN);
        Ok(Box::new(Noting(given.clone())) as Box<dyn Controller>)
    });
    (spec, ticks)
}

fn later(controllers: Vec<ControllerSpec>) -> SessionSpec {
    SessionSpec { begin: BEGIN, ..session(controllers) }
}

#[test]
fn ticks_reports_and_the_end_have_the_times_and_rates_of_a_session_that_began_there() {
    let _alone = alone();
    let (mut a, ticks) = noting("a", 1, 500.0);
    a.phase = SimTime::from_micros(700);
    let (b, slow) = noting("b", 2, 20.0);
    let live = LiveSession::start(later(vec![a, b])).expect("starts");
    assert_eq!(live.begin(), BEGIN);
    eventually("both tick", || {
        ticks.lock().expect("whole").len() > 100 && slow.lock().expect("whole").len() > 5
    });
    let span = live.elapsed() - BEGIN;
    assert!(span > SimTime::ZERO && span < secs(20.0), "{span}");
    assert!(live.incidents().is_empty(), "{:?}", live.incidents());
    let outcome = live.stop(0);
    assert_eq!((outcome.code, outcome.begin), (0, BEGIN));
    let span = outcome.sim - BEGIN;
    assert!(span > SimTime::ZERO && span < secs(30.0), "{span}");
    for (ticks, (period, phase)) in [(ticks, (2_000_000, 700_000)), (slow, (50_000_000, 0))] {
        let ticks = ticks.lock().expect("whole");
        assert!(ticks[0].1 >= BEGIN && ticks[0].1 < BEGIN + secs(10.0), "{:?}", ticks[0]);
        assert!(ticks.iter().all(|(number, time)| time.0 == phase + number * period));
    }
    for row in &outcome.controllers {
        let due = span.as_secs_f64() * row.target_hz;
        assert!(row.achieved_hz > 0.1 * row.target_hz && row.achieved_hz < 1.5 * row.target_hz, "{row:?}");
        assert!((row.scheduled as f64) <= due + 2.0, "nothing was due before the begin: {row:?}");
        assert!(row.lateness_us.max < 10e6 && row.cpu_share < 2.0, "{row:?}");
    }
    // Over a month instead of a second it would be less than a millionth.
    let busiest = outcome.controllers.iter().map(|row| row.cpu_share).fold(0.0, f64::max);
    assert!(busiest > 1e-5, "{busiest}");
    assert!(outcome.snapshot.time() >= BEGIN);
}

#[test]
fn it_pauses_ends_and_is_struck_by_faults_at_its_own_times() {
    let _alone = alone();
    let (a, wish) = toy("a", 1, 500.0);
    let mut spec = later(vec![a]);
    let (struck, ended) = (BEGIN + secs(1.5), BEGIN + secs(3.0));
    spec.until = Some(ended);
    spec.faults = FaultPlan::new(1).at(secs(3.0)).kill("a").at(struck).kill("a");
    let live = LiveSession::start(spec).expect("starts");
    assert!(live.pause(|| {}));
    let time = live.elapsed();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(live.elapsed(), time);
    assert!(live.resume());
    eventually("it ends", || live.has_ended());
    assert_eq!(wish.epoch.load(std::sync::atomic::Ordering::Relaxed), 2);
    let outcome = live.stop(0);
    assert!(outcome.sim >= ended);
    assert_eq!((outcome.faults[0].injected, outcome.controllers[0].restarts), (None, 1));
    assert!(outcome.faults[1].injected.expect("struck") >= struck);
}

#[test]
fn a_begin_that_no_session_can_have_is_refused() {
    let _alone = alone();
    let spec = SessionSpec { begin: BEGIN_MAX + SimTime(1), ..session(vec![toy("a", 1, 500.0).0]) };
    assert!(matches!(LiveSession::start(spec), Err(LiveError::Begin(_))));
}
