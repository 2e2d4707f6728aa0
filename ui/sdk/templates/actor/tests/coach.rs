//! The coach in a live session. Real-time tests wait for the expected event, and never measure how long it took: that
//! would fail on a busy machine.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use actix::prelude::*;
use template_actor::{Advice, Coach, app};
use trocar::prelude::*;

fn advice(scene: &Snapshot) -> Advice {
    scene.iter::<Advice>().next().map(|(_, advice)| advice.clone()).unwrap_or_default()
}

fn eventually(why: &str, session: &mut Session, mut what: impl FnMut(&Snapshot) -> bool) {
    let until = Instant::now() + Duration::from_secs(20);
    while !what(&session.snapshot()) {
        assert!(Instant::now() < until, "{why}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn live(app: &App) -> Session {
    let scenario = app.scenario("peg-transfer").expect("it comes with Trocar");
    start(app, &scenario, &RunOptions::default()).expect("it starts")
}

#[test]
fn the_coach_sees_who_moves_and_speaks_up_and_ends_with_the_session() {
    // Two virtual trainees move; none is as gentle as this coach wants.
    let mut session = live(&app(0.001));
    eventually("it speaks up", &mut session, |scene| advice(scene).count > 0);
    let finished = session.finish();
    assert!(advice(&finished.outcome.snapshot).speed_max > 0.001);
    assert_eq!(finished.driver_errors, Vec::<String>::new());
}

/// A coach whose first instance panics as soon as it has spoken.
struct Clumsy {
    coach: Coach,
    life: u32,
}
impl Actor for Clumsy {
    type Context = Context<Self>;
    fn started(&mut self, ctx: &mut Self::Context) {
        ctx.run_interval(Duration::from_millis(5), |clumsy, _| {
            clumsy.coach.look();
            assert!(clumsy.life > 0 || clumsy.coach.advice().count == 0, "clumsy");
        });
    }
}

#[test]
fn a_coach_that_panics_is_built_again_and_goes_on_counting() {
    let lives = AtomicU32::new(0);
    let app = App::new().component::<Advice>().actor("coach", Coach::access(), move |guest| {
        let life = lives.fetch_add(1, Ordering::Relaxed);
        Clumsy { coach: Coach::new(guest, 0.001), life }
    });
    let mut session = live(&app);
    // Each instance warns at least once. If the second one had not read the count of the first, it would say "once"
    // again.
    eventually("it counts on", &mut session, |scene| advice(scene).count >= 2);
    assert_eq!(session.actors()[0].restarts(), 1);
    assert!(session.finish().outcome.incidents.is_empty(), "nobody else noticed");
}

#[test]
fn in_lockstep_it_is_left_out() {
    let app = app(0.001);
    let scenario = app.scenario("peg-transfer").expect("it comes with Trocar");
    let options = RunOptions { lockstep: true, seconds: Some(1.0), ..RunOptions::default() };
    let outcome = run(&app, &scenario, &options, &mut |_| {}).expect("it runs");
    assert_eq!(advice(&outcome.kernel.snapshot), Advice::default());
}
