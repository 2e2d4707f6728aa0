//! A foreign engine as a controller: a hanging chain, simulated by a library in C.
//!
//! To the framework an engine is a controller like any other: it reads the scene, steps, and writes the scene. The
//! scene, not the engine, owns the state: when the engine crashes, hangs or returns invalid values, a new instance is
//! set to the state in the scene, and goes on.

pub mod ffi;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ffi::{Chain, Engine, EngineError};
use trocar::prelude::*;

/// A chain, with all parameters and state of the engine. The scenario contains it, and each step updates it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "chain_state")]
#[serde(deny_unknown_fields)]
pub struct ChainState {
    /// How many masses.
    pub masses: u32,
    /// Each one's mass \[kg\].
    pub mass: f64,
    /// Length of a spring at rest \[m\].
    pub length: f64,
    /// Stiffness of a spring [N/m].
    pub stiffness: f64,
    /// Damping of a spring [N·s/m].
    pub damping: f64,
    /// Force on the last mass \[N\]. Others may write it: a hand, a person at a console.
    #[serde(default)]
    pub force: [f64; 3],
    /// Positions of the masses \[m\], three numbers each; empty: hanging straight.
    #[serde(default)]
    pub positions: Vec<f64>,
    /// Their velocities [m/s], three numbers each.
    #[serde(default)]
    pub velocities: Vec<f64>,
}

/// Drives the engine.
pub struct ChainController {
    owner: Entity,
    chain: Chain,
    /// The state in the scene, except for changes by others; its vectors are reused as buffers.
    state: ChainState,
}

impl ChainController {
    /// A new instance of the engine, set to the state in the scene: at the start, and after every failure.
    fn new(engine: &Arc<Engine>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let missing = || ControllerError::Scene("no entity has a chain_state".to_owned());
        let (owner, state) = context.scene.iter::<ChainState>().next().ok_or_else(missing)?;
        let mut state = state.clone();
        let mut chain =
            Chain::new(engine, state.masses, state.mass, state.length, state.stiffness, state.damping)
                .map_err(failed)?;
        if !state.positions.is_empty() {
            chain.set(&state.positions, &state.velocities).map_err(failed)?;
        }
        chain.get(&mut state.positions, &mut state.velocities).map_err(failed)?;
        Ok(Self { owner, chain, state })
    }
}

impl Controller for ChainController {
    fn access(&self) -> Access {
        Access::new().writes::<ChainState>(EntitySet::Of(vec![self.owner]))
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if let Some(state) = scene.get::<ChainState>(self.owner) {
            self.state.force = state.force;
        }
        // The engine chooses its own time step; the tick decides how far it advances. If the call never returns, the
        // watchdog sees it: this thread is fenced and abandoned, and another engine takes over.
        self.chain.step(tick.period.as_secs_f64(), -9.81, self.state.force).map_err(failed)?;
        // An error ends this instance of the controller before it writes anything. The next one starts from the last
        // valid state. (Without this check, the Model would refuse the batch.)
        self.chain.get(&mut self.state.positions, &mut self.state.velocities).map_err(failed)?;
        out.put(self.owner, self.state.clone());
        Ok(())
    }
}

fn failed(error: EngineError) -> ControllerError {
    ControllerError::Failed(error.to_string())
}

/// The library to load: the one named by the environment, or the one built beside this crate. A scenario never names
/// it: a file from a stranger must not choose which code runs.
pub fn library_file() -> PathBuf {
    std::env::var_os("CHAIN_ENGINE").map_or_else(|| PathBuf::from(env!("CHAIN_ENGINE_BUILT")), PathBuf::from)
}

/// Trocar with this crate's additions. The engine is loaded and checked now, not in the middle of a session.
///
/// # Errors
/// When the library is invalid.
pub fn app(library: &Path) -> Result<App, EngineError> {
    let engine = Engine::load(library)?;
    let build = move |(): &(), context: &BuildContext<'_>| ChainController::new(&engine, context);
    Ok(App::new()
        .component::<ChainState>()
        .controller_with("chain", build)
        .about("chain", KindInfo::new("a hanging chain, by an engine in C", 500.0)))
}
