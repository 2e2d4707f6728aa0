//! The engine in sessions: it moves, recovers from failures, and its errors never reach the scene.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use template_engine::ffi::{Chain, Engine};
use template_engine::{ChainState, app, library_file};
use trocar::kernel::supervision::Cause;
use trocar::prelude::*;

const SCENARIO: &str = include_str!("../scenario.toml");

/// A modified engine: the real source with one replacement, built by the same compiler.
fn another_engine(name: &str, source: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (file, library) = (folder.join(format!("{name}.c")), folder.join(format!("{name}.so")));
    std::fs::write(&file, source).expect("a file");
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let engine = Path::new(env!("CARGO_MANIFEST_DIR")).join("engine");
    let built = Command::new(compiler)
        .args(["-std=gnu11", "-O2", "-fPIC", "-shared", "-I"])
        .args([&engine, &file])
        .args(["-lm", "-o"])
        .arg(&library)
        .status()
        .expect("a C compiler");
    assert!(built.success());
    library
}

/// An engine with another step function, which may call the real one.
fn with_step(name: &str, step: &str) -> PathBuf {
    let source = format!(
        "#define chain_step real_step\n#include \"chain.c\"\n#undef chain_step\n#include <unistd.h>\n\
         int32_t chain_step(chain *self, double seconds, double gravity, const double force[3]) {{ {step} }}\n"
    );
    another_engine(name, &source)
}

fn started(app: &App, options: &RunOptions) -> (Session, Entity) {
    let scenario = app.scenario_from(Path::new("scenario.toml"), SCENARIO).expect("a sound scenario");
    let chain = scenario.entity("chain").expect("the scenario has one");
    (start(app, &scenario, options).expect("it starts"), chain)
}

/// The last mass's x after every tick, and the session's outcome.
fn swings(app: &App, seconds: f64, faults: Option<FaultPlan>) -> (Vec<f64>, trocar::session::Finished) {
    let options = RunOptions { lockstep: true, faults, ..RunOptions::default() };
    let (mut session, chain) = started(app, &options);
    let mut xs = Vec::new();
    for step in 1..=(seconds * 500.0) as u64 {
        session.run_until(SimTime::from_millis(2 * step));
        let scene = session.snapshot();
        let state = scene.get::<ChainState>(chain).expect("it is there");
        assert!(state.positions.iter().all(|number| number.is_finite()), "what is no number is in the scene");
        xs.push(state.positions[state.positions.len() - 3]);
    }
    (xs, session.finish())
}

#[test]
fn a_pulled_chain_swings_and_comes_to_rest_where_statics_says() {
    let engine = Engine::load(&library_file()).expect("the engine that was built with this crate");
    // One mass: a pendulum, pulled aside. At rest the spring points along the sum of weight and pull.
    let mut chain = Chain::new(&engine, 1, 0.1, 0.1, 1e3, 5.0).expect("a chain");
    let (mut positions, mut velocities) = (Vec::new(), Vec::new());
    // Only the spring has damping, and it does not damp the swing: so the test slows it down.
    for _ in 0..20_000 {
        chain.step(0.002, -9.81, [0.5, 0.0, 0.0]).expect("a step");
        chain.get(&mut positions, &mut velocities).expect("finite");
        velocities.iter_mut().for_each(|velocity| *velocity *= 0.99);
        chain.set(&positions, &velocities).expect("as many as it has");
    }
    let (pull, weight) = (0.5, 0.981);
    let tension = f64::hypot(pull, weight);
    let length = 0.1 + tension / 1e3;
    assert!((positions[0] - length * pull / tension).abs() < 1e-6, "{positions:?}");
    assert!((positions[2] + length * weight / tension).abs() < 1e-6, "{positions:?}");
}

#[test]
fn a_killed_engine_goes_on_from_the_scene_as_if_nothing_had_been() {
    let app = app(&library_file()).expect("the engine");
    let (mut whole, _) = swings(&app, 3.0, None);
    assert!(whole.iter().any(|x| *x > 0.02), "it swings");
    let plan = FaultPlan::new(1).at(secs(0.777)).kill("chain").at(secs(1.555)).kill("chain");
    let (mut killed, finished) = swings(&app, 3.0, Some(plan));
    assert_eq!(finished.outcome.controllers[0].restarts, 2);
    // The ticks between the kill and the restart are missing, and the chain stands still meanwhile. Otherwise its
    // states are bit-identical: they went through the scene and back.
    whole.dedup();
    killed.dedup();
    assert!(whole.starts_with(&killed), "it went on from somewhere else");
    assert!(whole.len() - killed.len() <= 50, "{} ticks are missing", whole.len() - killed.len());
}

#[test]
fn an_engine_that_answers_nonsense_is_replaced_and_the_scene_stays_sound() {
    let step = "static int steps; int32_t code = real_step(self, seconds, gravity, force); \
                if (++steps == 300) self->positions[0] = NAN; return code;";
    let (xs, finished) = swings(&app(&with_step("nonsense", step)).expect("an engine"), 2.0, None);
    assert_eq!(finished.outcome.controllers[0].restarts, 1);
    assert!(matches!(&finished.outcome.incidents[0].cause, Cause::Error(text) if text.contains("finite")));
    assert!(xs[750..].windows(2).any(|pair| pair[0] != pair[1]), "it goes on");
}

/// Writes the engine's results without checking them.
struct Credulous(Chain, Entity, ChainState);
impl Controller for Credulous {
    fn access(&self) -> Access {
        Access::new().writes::<ChainState>(EntitySet::All)
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let _ = self.0.step(0.002, -9.81, [0.0; 3]);
        let _ = self.0.get(&mut self.2.positions, &mut self.2.velocities);
        out.put(self.1, self.2.clone());
        Ok(())
    }
}

#[test]
fn what_a_careless_controller_lets_through_the_model_refuses() {
    let step = "static int steps; int32_t code = real_step(self, seconds, gravity, force); \
                if (++steps == 300) self->velocities[1] = INFINITY; return code;";
    let engine = Engine::load(&with_step("infinite", step)).expect("an engine");
    let build = move |(): &(), context: &BuildContext<'_>| {
        let (owner, state) = context.scene.iter::<ChainState>().next().expect("the scenario has one");
        Ok(Credulous(
            Chain::new(&engine, 10, 0.002, 0.01, 400.0, 0.05).expect("a chain"),
            owner,
            state.clone(),
        ))
    };
    let app = App::new().component::<ChainState>().controller_with("chain", build);
    let (_, finished) = swings(&app, 1.0, None);
    // 500 steps, of which the last 201 are infinite.
    assert_eq!(finished.outcome.controllers[0].rejected, 201);
}

#[test]
fn an_engine_that_never_comes_back_is_fenced_and_another_takes_over() {
    // Only the first instance hangs: the others keep counting.
    let step = "static int steps; if (++steps == 100) for (;;) usleep(1000); \
                return real_step(self, seconds, gravity, force);";
    let app = app(&with_step("hangs", step)).expect("an engine");
    let (mut session, chain) = started(&app, &RunOptions::default());
    let until = Instant::now() + Duration::from_secs(20);
    let x = |scene: &Arc<Snapshot>| {
        scene.get::<ChainState>(chain).expect("it is there").positions.last().copied()
    };
    while session.reports()[0].restarts == 0 {
        assert!(Instant::now() < until, "nobody sees that it hangs");
        std::thread::sleep(Duration::from_millis(5));
    }
    let before = x(&session.snapshot());
    while x(&session.snapshot()) == before {
        assert!(Instant::now() < until, "nobody takes over");
        std::thread::sleep(Duration::from_millis(5));
    }
    let finished = session.finish();
    assert!(finished.outcome.incidents.iter().any(|incident| incident.cause == Cause::Stall));
    assert_eq!((finished.outcome.code, finished.outcome.zombies), (0, 1));
}

#[test]
fn a_library_that_does_not_fit_is_refused_by_name() {
    let refused = |library: &Path| app(library).err().expect("refused").to_string();
    let old = another_engine(
        "old",
        "#include \"chain.h\"\n#undef CHAIN_ABI\n#define CHAIN_ABI 7u\n#include \"chain.c\"\n",
    );
    let error = refused(&old);
    assert!(
        error.contains("old.so") && error.contains("version 7") && error.contains("version 1"),
        "{error}"
    );
    let part = another_engine("part", "#include <stdint.h>\nuint32_t chain_abi(void) { return 1; }\n");
    let error = refused(&part);
    assert!(error.contains("part.so") && error.contains("'chain_create'"), "{error}");
    let error = refused(Path::new("no-such-engine.so"));
    assert!(error.contains("no-such-engine.so") && error.contains("cannot be loaded"), "{error}");
    let text = Path::new(env!("CARGO_TARGET_TMPDIR")).join("text.so");
    std::fs::write(&text, "this is no library").expect("a file");
    assert!(refused(&text).contains("text.so"));
}

#[test]
fn figures_that_make_no_chain_are_refused_at_the_start() {
    let app = app(&library_file()).expect("the engine");
    let text = SCENARIO.replace("mass = 0.002", "mass = -1.0");
    let scenario = app.scenario_from(Path::new("scenario.toml"), &text).expect("a sound scenario so far");
    let error = start(&app, &scenario, &RunOptions { lockstep: true, ..RunOptions::default() });
    assert!(error.err().expect("refused").to_string().contains("-1 kg"));
}
