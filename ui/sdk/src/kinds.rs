//! The built-in kinds of controllers, by the names that scenarios use.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::Vector3;
use serde::Deserialize;
use serde::de::value::Error as ValueError;
use serde::de::{DeserializeOwned, IntoDeserializer};
use trocar_collision::controller::{
    ContinuousConfig, ContinuousController, DynamicPointConfig, DynamicPointController, FingerProxyConfig,
    FingerProxyController, ObbTreeConfig, ObbTreeController, ProximityConfig, ProximityController,
    SphericalHashConfig, SphericalHashController, ZBufferConfig, ZBufferController,
};
use trocar_dynamics::rigid_bodies::RigidBodiesController;
use trocar_engine::{EngineController, EngineSettings, EngineSoftController};
use trocar_haptics::renderer::RendererConfig;
use trocar_haptics::{HapticsConfig, HapticsController};
use trocar_input::manual::controller::add_person;
use trocar_input::{
    AutopilotConfig, AutopilotController, ManualConfig, ManualController, PathConfig, PathController, Skill,
};
use trocar_kernel::spec::{Factory, Fence};
use trocar_kernel::supervision::RuntimeClass;
use trocar_network::itp::UNPROTECTED_MODEL;
use trocar_network::teleoperation::PATH_FIGURES;
use trocar_scene::scenario::{Params, ScenarioError};
use trocar_scene::{BuildContext, Controller, ControllerError};
use trocar_simulator::controller::{
    BleedingController, DynamicFemController, ElectrosurgeryController, FluidController, InstrumentsConfig,
    InstrumentsController, LinearFemController, MassSpringController, SmokeController, SutureController,
    ThreadController, VitalSignsController, XpbdController,
};
use trocar_simulator::impulse_world::{ImpulseWorld, RigidSettings};
use trocar_tasks::peg_transfer_controller::mirrored_start;
use trocar_tasks::{OutcomeConfig, OutcomeController, PegTransferConfig, PegTransferController};

use crate::hands::{HandFence, HandPort};
use crate::kind::{Blueprint, Kind, KindContext, KindInfo};

/// The kind that lets a person move the hands.
pub(crate) const MANUAL: &str = "manual";
/// The kind that moves a hand along the scenario's path. A person who plays takes its place.
pub(crate) const PATH: &str = "path";
/// The kind that serves a haptic device.
pub(crate) const HAPTICS: &str = "haptics";
/// The kind that moves instruments by their hands and by what they touch.
pub(crate) const INSTRUMENTS: &str = "instruments";
/// The kind of the virtual trainee. A person who plays takes its place.
pub(crate) const AUTOPILOT: &str = "autopilot";

/// Every built-in kind with its name.
pub(crate) fn standard() -> Vec<(&'static str, KindInfo, Kind)> {
    vec![
        (
            HAPTICS,
            KindInfo::new("serves a haptic device: instrument pose in, force out", 1_000.0),
            Arc::new(haptics),
        ),
        (
            "rapier",
            KindInfo::new("physics of rigid bodies: contacts, friction, grasping", 500.0).simulating(),
            Arc::new(rapier),
        ),
        (
            "rapier-soft",
            KindInfo::new("moves soft volumes by the engine's own solvers, in place of ours", 200.0)
                .simulating(),
            under_gravity(EngineSoftController::new),
        ),
        (
            "rigid-bodies",
            KindInfo::new("the same by momenta and impulses, in place of the engine", 500.0).simulating(),
            Arc::new(rigid_bodies),
        ),
        (
            "obb-tree",
            KindInfo::new("finds where surfaces are in each other: trees of oriented boxes", 500.0)
                .simulating(),
            Arc::new(obb_tree),
        ),
        (
            "proximity",
            KindInfo::new("finds the nearest points of surfaces, which push before they touch", 500.0)
                .simulating(),
            Arc::new(proximity),
        ),
        (
            "spherical-hash",
            KindInfo::new("finds what touches a deforming body: a local spherical hash", 100.0).simulating(),
            Arc::new(spherical_hash),
        ),
        (
            "dynamic-point",
            KindInfo::new("finds where shafts touch surfaces: the dynamic point of a line", 1_000.0)
                .simulating(),
            Arc::new(dynamic_point),
        ),
        (
            "finger-proxy",
            KindInfo::new("lets hands feel surfaces: a proxy that never passes them", 1_000.0).simulating(),
            Arc::new(finger_proxy),
        ),
        (
            "z-buffer",
            KindInfo::new("finds what shafts meet and have swept over: images of depth", 500.0).simulating(),
            Arc::new(z_buffer),
        ),
        (
            "continuous",
            KindInfo::new("finds what goes through something between two ticks, however fast", 500.0)
                .simulating(),
            Arc::new(continuous),
        ),
        (
            "dynamic-fem",
            KindInfo::new("moves soft volumes: implicit finite elements", 100.0).simulating(),
            under_gravity(DynamicFemController::new),
        ),
        (
            "bleeding",
            KindInfo::new("lets vessels bleed as they are cut, until they are clamped or sealed", 100.0),
            of_the_scene(BleedingController::new),
        ),
        (
            "electrosurgery",
            KindInfo::new("heats, burns and removes tissue under electrodes that are switched on", 100.0),
            of_the_scene(ElectrosurgeryController::new),
        ),
        (
            "fluid",
            KindInfo::new("moves a liquid of particles, such as blood", 60.0),
            under_gravity(FluidController::new),
        ),
        (
            INSTRUMENTS,
            KindInfo::new(
                "puts instruments where their hands are, and tells hands what pushes them",
                1_000.0,
            )
            .simulating(),
            Arc::new(instruments),
        ),
        (
            "linear-fem",
            KindInfo::new(
                "answers for soft volumes at once: finite elements with a precomputed inverse",
                500.0,
            )
            .simulating(),
            Arc::new(linear_fem),
        ),
        (
            "mass-spring",
            KindInfo::new("moves threads, cloth, tubes and volumes of masses and springs", 500.0)
                .simulating(),
            under_gravity(MassSpringController::new),
        ),
        (
            "smoke",
            KindInfo::new("lets smoke rise from where tissue burns", 60.0),
            under_gravity(SmokeController::new),
        ),
        (
            "suture",
            KindInfo::new("sews: needle, thread and tissue stepped as one island", 500.0).simulating(),
            under_gravity(SutureController::new),
        ),
        (
            "thread",
            KindInfo::new("moves suture threads: implicit rods that hold their knots by friction", 500.0)
                .simulating(),
            Arc::new(thread),
        ),
        (
            "vital-signs",
            KindInfo::new("answers loss of blood with pressure and heart rate", 20.0),
            of_the_scene(VitalSignsController::new),
        ),
        (
            "xpbd",
            KindInfo::new("moves soft volumes, cloths and rods by their constraints", 200.0).simulating(),
            under_gravity(XpbdController::new),
        ),
        (
            "outcome",
            KindInfo::new("judges a scene by what simulators measure of it", 100.0),
            Arc::new(outcome),
        ),
        (
            PATH,
            KindInfo::new("moves a virtual hand along a path that the scenario writes down", 200.0),
            Arc::new(path),
        ),
        (
            "peg-transfer",
            KindInfo::new("judges a peg transfer: phases, errors, score", 100.0),
            Arc::new(peg_transfer),
        ),
        (
            AUTOPILOT,
            KindInfo::new("a virtual trainee: moves two hands through the peg transfer", 100.0),
            Arc::new(autopilot),
        ),
        (
            MANUAL,
            KindInfo::new("lets a person move the hands with mouse, keyboard or gamepad", 100.0),
            Arc::new(manual),
        ),
    ]
}

/// A blueprint without fences from a function that builds the controller.
pub(crate) fn plain<C: Controller>(
    class: RuntimeClass,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Send + Sync + 'static,
) -> Blueprint {
    let factory = move |context: &BuildContext<'_>| {
        build(context).map(|controller| Box::new(controller) as Box<dyn Controller>)
    };
    Blueprint { class, factory: Arc::new(factory), fences: Vec::new(), for_hands: None, arrange: None }
}

/// The parameters, or the default when the file gives none.
pub(crate) fn parse_or_default<T: DeserializeOwned + Default>(params: &Params) -> Result<T, ScenarioError> {
    if params.parse::<toml::Table>()?.is_empty() { Ok(T::default()) } else { params.parse() }
}

/// Parameters of a haptics controller: the hand, and settings other than the defaults.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HapticsParams {
    hand: String,
    passivity: Option<bool>,
    remote_scene: Option<bool>,
    felt_window_secs: Option<f64>,
    status_period_secs: Option<f64>,
}

fn haptics(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let params: HapticsParams = context.entry.params.parse()?;
    let Some(port) = context.hands.iter().find(|port| port.name == params.hand) else {
        let known = context.hands.iter().map(|port| port.name.as_str()).collect::<Vec<_>>().join(", ");
        let reason = format!("hand: no hand is called '{}'; there are: {known}", params.hand);
        return Err(context.entry.params.error(reason));
    };
    let renderer = match context.scenario.hands.iter().find(|hand| hand.name == params.hand) {
        Some(hand) => parse_or_default::<RendererConfig>(&hand.renderer)?,
        None => RendererConfig::default(),
    };
    let network = &context.options.network;
    let sharing =
        network.sharing(context.scenario).map_err(|error| context.entry.params.error(error.to_string()))?;
    let is_apart = network.station().is_some() || sharing.is_among_peers();
    // A station renders the contact model that it makes itself: the scene's forces and places have waited for others.
    let renderer = match (is_apart, renderer) {
        (true, RendererConfig::ZeroOrderHold | RendererConfig::VirtualCoupling(_)) => {
            RendererConfig::default()
        }
        (_, renderer) => renderer,
    };
    let default = HapticsConfig::default();
    let config = HapticsConfig {
        renderer,
        passivity: params.passivity.unwrap_or(default.passivity),
        // What a station feels of its host's scene has come over the network.
        remote_scene: params.remote_scene.unwrap_or(is_apart),
        playout_secs: sharing.playout.as_secs_f64(),
        felt_window_secs: params.felt_window_secs.unwrap_or(default.felt_window_secs),
        status_period_secs: params.status_period_secs.unwrap_or(default.status_period_secs),
    };
    config.check().map_err(|error| context.entry.params.error(error.to_string()))?;
    let (factory, fences) = haptics_of(port, config);
    Ok(Blueprint {
        class: RuntimeClass::Haptics,
        factory,
        fences,
        for_hands: Some(Arc::new(move |hands| {
            Some(haptics_of(hands.iter().find(|port| port.name == params.hand)?, config))
        })),
        arrange: None,
    })
}

/// Serves one hand, whose driver refuses the commands of earlier instances.
fn haptics_of(port: &HandPort, config: HapticsConfig) -> (Factory, Vec<Arc<dyn Fence>>) {
    let fence: Arc<dyn Fence> = Arc::new(HandFence(port.slot.fence().clone()));
    let port = port.clone();
    let factory = move |context: &BuildContext<'_>| {
        let link =
            port.slot.take(context.epoch).map_err(|error| ControllerError::Device(error.to_string()))?;
        let capabilities = port.capabilities.clone();
        let controller = HapticsController::new(context, port.entity, link, capabilities, config)?;
        Ok(Box::new(controller) as Box<dyn Controller>)
    };
    (Arc::new(factory), vec![fence])
}

fn rapier(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let mut config: EngineSettings = parse_or_default(&context.entry.params)?;
    config.gravity_in_world = context.scenario.gravity_in_world;
    config.check().map_err(|error| context.entry.params.error(error.to_string()))?;
    Ok(plain(RuntimeClass::Simulation, move |context| Ok(EngineController::new(context, config.clone())?)))
}

fn rigid_bodies(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let mut config: RigidSettings = parse_or_default(&context.entry.params)?;
    config.gravity_in_world = context.scenario.gravity_in_world;
    config.check().map_err(|error| context.entry.params.error(error.to_string()))?;
    Ok(plain(RuntimeClass::Simulation, move |context| {
        Ok(RigidBodiesController::<ImpulseWorld>::new(context, config.clone())?)
    }))
}

fn obb_tree(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: ObbTreeConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Collision, move |context| ObbTreeController::new(&config, context)))
}

fn proximity(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: ProximityConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Collision, move |context| ProximityController::new(&config, context)))
}

fn spherical_hash(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: SphericalHashConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Collision, move |context| SphericalHashController::new(&config, context)))
}

fn finger_proxy(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: FingerProxyConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Collision, move |context| FingerProxyController::new(&config, context)))
}

fn z_buffer(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: ZBufferConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Collision, move |context| ZBufferController::new(&config, context)))
}

fn continuous(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: ContinuousConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Collision, move |context| ContinuousController::new(&config, context)))
}

fn dynamic_point(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: DynamicPointConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Collision, move |context| DynamicPointController::new(&config, context)))
}

fn instruments(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: InstrumentsConfig = parse_or_default(&context.entry.params)?;
    config.check().map_err(|reason| context.entry.params.error(reason))?;
    Ok(plain(RuntimeClass::Simulation, move |context| InstrumentsController::new(config, context)))
}

/// A simulator that takes all parameters from the entities that it moves, and the gravity of the scenario.
fn under_gravity<C: Controller>(
    build: fn(Vector3<f64>, &BuildContext<'_>) -> Result<C, ControllerError>,
) -> Kind {
    Arc::new(move |context| {
        nothing(&context.entry.params)?;
        let gravity = context.scenario.gravity_in_world;
        Ok(plain(RuntimeClass::Simulation, move |context| build(gravity, context)))
    })
}

/// A simulator that takes all inputs from the scene.
fn of_the_scene<C: Controller>(build: fn(&BuildContext<'_>) -> Result<C, ControllerError>) -> Kind {
    Arc::new(move |context| {
        nothing(&context.entry.params)?;
        Ok(plain(RuntimeClass::Simulation, build))
    })
}

fn linear_fem(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    nothing(&context.entry.params)?;
    let (gravity, cache) = (context.scenario.gravity_in_world, cache_folder());
    Ok(plain(RuntimeClass::Simulation, move |context| {
        LinearFemController::new(gravity, cache.clone(), context)
    }))
}

fn thread(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    nothing(&context.entry.params)?;
    let (gravity, cache) = (context.scenario.gravity_in_world, cache_folder());
    Ok(plain(RuntimeClass::Simulation, move |context| ThreadController::new(gravity, cache.clone(), context)))
}

/// The folder that caches computed data between runs: the user's cache folder by the XDG base directory specification.
/// Without one everything is recomputed.
fn cache_folder() -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let user = absolute("XDG_CACHE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".cache")));
    user.map(|user| user.join("trocar"))
}

fn outcome(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let mut config: OutcomeConfig = context.scenario.task.parse()?;
    // Of a hand whose master is a console elsewhere only that console knows the path.
    let elsewhere = context.hands.iter().filter(|hand| hand.capabilities.name == UNPROTECTED_MODEL);
    for hand in elsewhere {
        let is_of_path = |measure: &str| {
            let figure = measure.strip_prefix(&hand.name).and_then(|rest| rest.strip_prefix('.'));
            figure.is_some_and(|figure| PATH_FIGURES.contains(&figure))
        };
        config.expect.retain(|expected| !is_of_path(&expected.measure));
    }
    config.check().map_err(|reason| context.scenario.task.error(reason))?;
    Ok(plain(RuntimeClass::Task, move |context| OutcomeController::new(&config, context)))
}

fn path(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: PathConfig = context.entry.params.parse()?;
    Ok(plain(RuntimeClass::Task, move |context| PathController::new(&config, context)))
}

/// Refuses parameters of a kind that has none, because its settings are components.
fn nothing(params: &Params) -> Result<(), ScenarioError> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct NoParams {}
    params.parse::<NoParams>().map(drop)
}

/// The exercise's parameters with the options of the run.
fn peg_transfer_config(context: &KindContext<'_>) -> Result<PegTransferConfig, ScenarioError> {
    let mut config: PegTransferConfig = parse_or_default(&context.scenario.task)?;
    config.left_handed |= context.options.left_handed;
    Ok(config)
}

fn peg_transfer(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config = peg_transfer_config(context)?;
    let left_handed = config.left_handed;
    let mut blueprint =
        plain(RuntimeClass::Task, move |context| PegTransferController::new(&config, context));
    if left_handed {
        // The dominant hand receives: a left-handed trainee starts with the rings on the right board.
        blueprint.arrange = Some(Box::new(|scene, out| {
            for (entity, pose) in mirrored_start(scene) {
                out.put(entity, pose);
            }
        }));
    }
    Ok(blueprint)
}

fn autopilot(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let mut config: AutopilotConfig = parse_or_default(&context.entry.params)?;
    if let Some(skill) = &context.options.skill {
        let parsed = Skill::deserialize(skill.as_str().into_deserializer());
        config.skill =
            parsed.map_err(|error: ValueError| context.entry.params.error(format!("skill: {error}")))?;
    }
    config.left_handed |= peg_transfer_config(context)?.left_handed;
    Ok(plain(RuntimeClass::Task, move |context| AutopilotController::new(&config, context)))
}

fn manual(context: &KindContext<'_>) -> Result<Blueprint, ScenarioError> {
    let config: ManualConfig = parse_or_default(&context.entry.params)?;
    config.check().map_err(|reason| context.entry.params.error(reason))?;
    // A station shows the hands of others as well.
    let is_own = |port: &&HandPort| {
        context.options.network.station().is_none()
            || context.options.hands.iter().any(|(name, _)| *name == port.name)
    };
    let own: Vec<trocar_scene::Entity> =
        context.hands.iter().filter(is_own).map(|port| port.entity).collect();
    let mut blueprint =
        plain(RuntimeClass::Task, move |context| ManualController::new(&config, &own, context));
    // Without a hand the controller returns the error when it is built.
    blueprint.arrange = Some(Box::new(|scene, out| add_person(scene, out).unwrap_or_default()));
    Ok(blueprint)
}
