//! Instruments on a scene that a thread holds back: where they stand, what their hands feel, a thread that breaks, and a
//! restart.

use nalgebra::Vector3;
use trocar_dynamics::instrument::deflection::InstrumentDeflection;
use trocar_scene::{
    BuildContext, ControllerError, Frozen, InstrumentForce, InstrumentTarget, LocalContactModel, Pose,
    Velocity, VertexPositions,
};
use trocar_simulator::controller::{
    InstrumentsConfig, InstrumentsController, KnotState, ThreadController, ThreadMemory,
};

use crate::support::stage::other::Other;
use crate::support::stage::{Stage, scene};

/// A probe along z whose shaft crosses the thread.
fn text(of_thread: &str) -> String {
    format!(
        r#"
[[entity]]
name = "probe"
pose = {{ translation = [0.001, -0.005, 0.02] }}
instrument = {{ kind = "probe", shaft_length = 0.1, shaft_radius = 0.0018 }}
[[entity]]
name = "thread"
mesh = {{ line = {{ length = 0.03, segments = 30, radius = 0.00025 }} }}
thread = {{ suture = "silk2"{of_thread} }}
anchors = {{ regions = [{{ box = {{ min = [-0.016, -1.0, -1.0], max = [-0.0149, 1.0, 1.0] }} }}, {{ box = {{ min = [0.0149, -1.0, -1.0], max = [0.016, 1.0, 1.0] }} }}] }}
"#
    )
}

fn build(context: &BuildContext<'_>) -> Result<ThreadController, ControllerError> {
    ThreadController::new(Vector3::zeros(), None, context)
}

fn instruments(context: &BuildContext<'_>) -> Result<InstrumentsController, ControllerError> {
    InstrumentsController::new(InstrumentsConfig::default(), context)
}

struct Session {
    stage: Stage<ThreadController>,
    instruments: Other,
    hz: f64,
    hand: f64,
    hardest: f64,
}

impl Session {
    fn new(of_thread: &str, hz: f64) -> Self {
        let stage = Stage::new(scene(&text(of_thread)), hz, build);
        let instruments = Other::new(&stage, 9, 1, instruments);
        Self { stage, instruments, hz, hand: -0.005, hardest: 0.0 }
    }

    /// A tick in which the hand moves by `way` along y.
    fn tick(&mut self, way: f64) {
        self.hand += way;
        let target = InstrumentTarget {
            tip_in_world: Pose::at(0.001, self.hand, 0.02),
            velocity_in_world: Velocity { linear: Vector3::y() * (way * self.hz), angular: Vector3::zeros() },
            sampled_at: self.stage.now(),
            ..InstrumentTarget::default()
        };
        self.stage.put("probe", target);
        self.instruments.tick(&mut self.stage);
        self.stage.tick();
        self.hardest = self.hardest.max(self.stage.measured("thread.contact_force_n"));
    }

    fn lead(&mut self, hand: f64, speed: f64) {
        let step = speed / self.hz;
        while self.hand < hand - 1e-9 {
            self.tick(step.min(hand - self.hand));
        }
        for _ in 0..(0.15 * self.hz) as usize {
            self.tick(0.0);
        }
    }

    fn probe(&self) -> f64 {
        self.stage.get::<Pose>("probe").translation.y
    }
}

#[test]
fn a_held_thread_stops_an_instrument_where_it_is_drawn_and_its_hand_feels_the_coupling() {
    let mut session = Session::new("", 500.0);
    session.lead(0.008, 0.1);
    let stage = &session.stage;
    assert!(!stage.has::<Frozen>("thread"));
    let offset = stage.get::<InstrumentDeflection>("probe").total().offset;
    // 1,000 N/m over at most 8 mm and the radii, by which its surface is ahead of its axis.
    assert!((session.probe() - (0.008 + offset.y)).abs() < 1e-12, "{} {offset:?}", session.probe());
    assert!((-0.01005..-0.0075).contains(&offset.y), "{offset:?}");
    let felt = stage.get::<InstrumentForce>("probe").force;
    assert!((felt - offset * 1000.0).norm() < 1e-3 * felt.norm(), "{felt:?} at {offset:?}");
    let contact = stage.measured("thread.contact_force_n");
    assert!((contact / felt.norm() - 1.0).abs() < 1e-3, "{contact} N and {felt:?}");
    // A hand that is led by planes meets the instrument where it stands.
    let model = stage.get::<LocalContactModel>("probe");
    assert!((model.proxy_in_world.translation.y - session.probe()).abs() < 1e-12);
    let plane = model.planes[0].expect("a plane");
    let depth = (plane.point_in_world.y - 0.008) * plane.normal_in_world.y;
    assert!((depth * plane.stiffness / felt.norm() - 1.0).abs() < 1e-3, "{plane:?} for {felt:?}");
    // No hand feels more than it may, however hard the coupling pulls.
    session.lead(0.014, 0.1);
    let pulled = session.stage.get::<InstrumentDeflection>("probe").total().offset * 1000.0;
    let felt = session.stage.get::<InstrumentForce>("probe").force;
    assert!(pulled.norm() > 12.0 && (felt.norm() - 10.0).abs() < 1e-3, "{pulled:?} {felt:?}");
    // Led back, it is where its hand leads it again.
    while session.hand > -0.005 {
        session.tick(-0.0002);
    }
    for _ in 0..100 {
        session.tick(0.0);
    }
    assert_eq!(session.probe(), session.hand);
    assert!(session.stage.get::<InstrumentDeflection>("probe").by.is_empty());
    assert_eq!(session.stage.get::<InstrumentForce>("probe").force, Vector3::zeros());
}

#[test]
fn nothing_passes_through_a_held_thread_on_a_scene_at_any_rate_and_speed_or_it_breaks_and_says_so() {
    for hz in [250.0, 500.0, 1000.0] {
        for speed in [0.1, 0.5, 1.0] {
            let found = |session: &Session| {
                let tension = session.stage.measured("thread.tension_n");
                format!("{hz} Hz, {speed} m/s: {} N, {tension} N at {}", session.hardest, session.probe())
            };
            let mut session = Session::new("", hz);
            session.lead(0.012, speed);
            let thread = session.stage.get::<VertexPositions>("thread");
            let highest = thread.positions.iter().map(|node| node.y).fold(f64::MIN, f64::max);
            assert!(!session.stage.has::<Frozen>("thread"), "{}", found(&session));
            assert!(highest > session.probe() + 0.0018, "it is through, {}", found(&session));
            assert!(session.hardest < 60.0, "{}", found(&session));
            // A suture of size 2 breaks at 50 N or more; a weak one at 8 N, and the probe goes on with its hand.
            let mut weak = Session::new(", breaks_at = { value = 8.0, source = \"chosen\" }", hz);
            weak.lead(0.012, speed);
            assert_eq!(weak.stage.measured("thread.pieces"), 2.0, "{}", found(&weak));
            let events = weak.stage.store.snapshot();
            let broken = events.events().since(0).any(|(_, event)| event.name == "thread_broken");
            assert!(broken, "{}", found(&weak));
            assert!((weak.probe() - 0.012).abs() < 2e-4, "{}", found(&weak));
        }
    }
}

#[test]
fn a_session_with_a_held_back_instrument_goes_on_to_the_bit_in_another_life() {
    let run = |restart: Option<usize>| {
        let mut session = Session::new("", 500.0);
        for tick in 0..120 {
            if restart == Some(tick) {
                session.stage.rebuild(build);
                session.instruments.rebuild(&session.stage, instruments);
            }
            session.tick(if tick < 80 { 2e-4 } else { -1e-4 });
        }
        let thread = session.stage.get::<VertexPositions>("thread").positions;
        let memory = session.stage.get::<ThreadMemory>("thread");
        let knot = session.stage.get::<KnotState>("thread");
        (thread, memory, knot, session.stage.get::<Pose>("probe"))
    };
    let whole = run(None);
    for tick in [30, 60, 100] {
        assert!(run(Some(tick)) == whole, "restarted before tick {tick}");
    }
}
