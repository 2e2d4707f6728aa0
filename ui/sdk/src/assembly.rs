//! Assembles a session from a scenario and the options of a run, for either time driver.

use std::path::{Component, Path};
use std::sync::Arc;

use trocar_collision::controller::StationTouchController;
use trocar_devices::HapticDevice;
use trocar_kernel::spec::{Factory, SessionSpec, period_of};
use trocar_kernel::supervision::RuntimeClass;
use trocar_network::control::Architecture;
use trocar_network::peers::repaired::rebuilding;
use trocar_network::session::{HostCourse, InstrumentFollower};
use trocar_scene::scenario::Scenario;
use trocar_scene::{
    Commands, ControllerEntry, ControllerError, Entity, EntityAllocator, Hand, SCENARIO_SPAWNER, SimTime,
    Snapshot, Store,
};

use crate::app::App;
use crate::app::actors::ActorKind;
pub use crate::error::AssemblyError;
use crate::hands::{HandPort, OpenedHand};
use crate::kind::{Blueprint, KindContext, joining};
use crate::kinds::{AUTOPILOT, HAPTICS, INSTRUMENTS, MANUAL, PATH, plain};
use crate::network::{
    self, LastWord, NETWORK, NETWORK_HZ, Network, NetworkError, NetworkHands, NetworkPart, ReflectedOrigin,
    STATION_WRITER, Sharing, StationHands, TELEOPERATION, TELEOPERATION_HZ, TakingPart, TeleoperatedHands,
    TeleoperationPart,
};
use crate::options::RunOptions;
use crate::play;
use crate::session::plan::{Role, SessionPlan};

/// Name of a station's own touch.
const TOUCH: &str = "network.touch";
/// Its ticks per second \[Hz\].
const TOUCH_HZ: f64 = 1_000.0;
/// Name of what moves instruments at a station that gets all hands directly, and its ticks per second \[Hz\].
const FOLLOWER: &str = "network.instruments";
const FOLLOWER_HZ: f64 = 500.0;
/// The device that stands for a hand of another station.
const OTHERS_DEVICE: &str = "virtual";

/// Ticks per second of what moves the instruments of a console, where the scenario leaves that to its physics \[Hz\].
const INSTRUMENTS_HZ: f64 = 1_000.0;

/// A session and its hands, before it runs.
pub struct Assembly {
    /// The kernel's specification; without peers, which depend on the time driver.
    pub spec: SessionSpec,
    /// The opened hands.
    pub hands: Vec<OpenedHand>,
    /// What moves the hands' datagrams: those of other stations, and those that a packet reflector returns.
    pub network: Vec<NetworkPart>,
    /// What is said to the others at the end.
    pub(crate) last_word: Option<LastWord>,
    /// At a station, whether its host has paused the session.
    pub(crate) host_course: Option<HostCourse>,
    /// The plan for branches and resets. Changes to `spec` hold for this session only.
    pub(crate) plan: Arc<SessionPlan>,
    /// Actors that join when the session runs live.
    pub(crate) actors: Vec<ActorKind>,
    /// The reflected hands, for branches and resets.
    pub(crate) reflected: Option<ReflectedOrigin>,
}

impl Assembly {
    /// Opens the hands, spawns the scene and makes the blueprint of every controller.
    ///
    /// # Errors
    /// [`AssemblyError`] names file, place and valid choices.
    pub fn new(app: &App, scenario: &Scenario, options: &RunOptions) -> Result<Self, AssemblyError> {
        let played = options.play.then(|| play::played(scenario)).transpose()?;
        let scenario = played.as_ref().unwrap_or(scenario);
        let station = options.network.station();
        let sharing = options.network.sharing(scenario)?;
        let own_part = station.map(|_| own_part(app, scenario, options, sharing));
        let scenario = own_part.as_ref().unwrap_or(scenario);
        let console = (!options.consoles.is_empty()).then(|| console_part(scenario, options));
        let mut network_hands =
            WrappedHands::new(&options.network, sharing, teleoperated(scenario, options)?);
        let scenario = console.as_ref().unwrap_or(scenario);
        let mut store = match (station, &options.resume) {
            (Some(station), _) => Store::from_snapshot(&station.scene),
            (None, Some(resumed)) => {
                resumed.check(scenario)?;
                Store::from_snapshot(resumed.scene())
            }
            (None, None) => scenario.spawn(app.registry())?,
        };
        let mut hands = open_hands(app, scenario, options, store.view(), &mut network_hands)?;
        if let Some(resumed) = &options.resume {
            hands.iter_mut().for_each(|hand| hand.go_on(resumed.scene(), resumed.time()));
        }
        let ports: Vec<HandPort> = hands.iter().map(|hand| hand.port().clone()).collect();
        let begin = options.begin();
        let number = station.map_or(0, |station| station.number);
        let allocator = EntityAllocator::new(number, SCENARIO_SPAWNER);
        // Entities that are added to the scene are numbered after those of the file.
        allocator.skip_to(store.view().first_free(number, SCENARIO_SPAWNER));
        let mut commands = Commands::new(app.registry().clone(), allocator);
        for hand in &hands {
            commands.put(hand.port().entity, hand.info());
        }
        let mut roles = Vec::with_capacity(scenario.controllers.len() + 1);
        let (mut network, mut last, mut host_course) = (Vec::new(), None, None);
        let mut fault_targets = options.fault_targets.clone();
        if let Some(station) = station {
            let TakingPart { actor, part, last_word, host_course: paused, fault_sinks } =
                network::stationed(station, network_hands.take_station(), options.faults.is_some())?;
            fault_targets.0.extend(fault_sinks);
            roles.push(Role::new(NETWORK, STATION_WRITER, NETWORK_HZ, network_actor(actor)));
            network.push(part);
            (last, host_course) = (Some(last_word), paused);
        }
        if !ports.is_empty() && (station.is_some() || sharing.is_among_peers()) {
            let touch = station_touch(store.view(), &ports);
            roles.push(Role::new(TOUCH, roles.len() as u16 + 1, TOUCH_HZ, touch));
        }
        if station.is_some() && sharing.architecture == Architecture::Hybrid {
            let follower = plain(RuntimeClass::Simulation, |context| {
                Ok::<_, ControllerError>(InstrumentFollower::new(context))
            });
            roles.push(Role::new(FOLLOWER, roles.len() as u16 + 1, FOLLOWER_HZ, follower));
        }
        for (index, entry) in scenario.controllers.iter().enumerate() {
            let Some(kind) = app.kind_of(&entry.kind) else {
                let known = app.kinds().collect::<Vec<_>>().join(", ");
                let reason = format!("unknown kind '{}'; there are: {known}", entry.kind);
                return Err(scenario.error_at("controller", index, reason).into());
            };
            let mut blueprint = kind(&KindContext { entry, scenario, hands: &ports, options })?;
            if station.is_some() && app.kind_info(&entry.kind).is_some_and(|about| about.simulates) {
                blueprint.factory = rebuilding(blueprint.factory);
            }
            if let Some(arrange) = blueprint.arrange.take() {
                arrange(store.view(), &mut commands);
            }
            // Spawner 0 is the scenario's; writers count from 1 in the order of the file, after a station's network and touch.
            roles.push(Role::new(&entry.name, roles.len() as u16 + 1, entry.rate_hz, blueprint));
        }
        stagger_haptics(&mut roles);
        if let Some(error) = commands.error() {
            return Err(scenario.error_at("hand", 0, error.to_string()).into());
        }
        commands.seal();
        store.apply(&mut commands, begin);
        let scene = store.snapshot();
        let (host_hands, has_faults) = (network_hands.take_host(), options.faults.is_some());
        let hosted =
            network::hosted(&options.network, scenario, options.seed, &scene, host_hands, has_faults)?;
        if let Some(TakingPart { actor, part, last_word, fault_sinks, .. }) = hosted {
            fault_targets.0.extend(fault_sinks);
            roles.push(Role::new(NETWORK, roles.len() as u16 + 1, NETWORK_HZ, network_actor(actor)));
            network.push(part);
            last = Some(last_word);
        }
        let mut reflected = None;
        let teleoperated = network_hands.take_teleoperated().part(options.lockstep)?;
        if let Some(TeleoperationPart { actor, part, origin }) = teleoperated {
            let writer = roles.len() as u16 + 1;
            roles.push(Role::new(TELEOPERATION, writer, TELEOPERATION_HZ, network_actor(actor)));
            network.extend(part);
            reflected = origin;
        }

        let plan = SessionPlan {
            scenario: scenario.name.clone(),
            station: number,
            scene,
            roles,
            until: options.seconds.map(|seconds| begin + SimTime::from_secs_f64(seconds)),
            faults: options.faults.clone(),
            fault_targets,
        };
        let spec = plan.first((options.seed, begin), &ports);
        let (plan, actors) = (Arc::new(plan), app.actors.clone());
        Ok(Self { spec, hands, network, last_word: last, host_course, plan, actors, reflected })
    }
}

/// The tele-operated hands. A station has none behind a packet reflector: its host has that.
fn teleoperated(scenario: &Scenario, options: &RunOptions) -> Result<TeleoperatedHands, NetworkError> {
    match options.network.station() {
        Some(_) => Ok(TeleoperatedHands::default()),
        None => {
            let is_console = !options.consoles.is_empty();
            let refused = match &options.network {
                _ if is_console && options.lockstep => Some(
                    "a console leads a robot that has a clock of its own: it runs in real time, not in lock-step",
                ),
                Network::Host(_) | Network::LockstepHost(_) if is_console => {
                    Some("a console shares no session: host that of the robot, and watch it")
                }
                _ => None,
            };
            match refused {
                Some(reason) => Err(NetworkError::Usage(reason.to_owned())),
                None => TeleoperatedHands::of(scenario, options.reflector, &options.consoles),
            }
        }
    }
}

/// The part of a scenario that a console computes: the hands that lead robots, what moves them, and where their instruments
/// are. The tissue is the robot's.
fn console_part(scenario: &Scenario, options: &RunOptions) -> Scenario {
    let mut part = scenario.clone();
    part.hands.retain(|hand| options.consoles.iter().any(|(name, _)| *name == hand.name));
    let serves = |entry: &ControllerEntry| match entry.kind.as_str() {
        HAPTICS => part.hands.iter().any(|hand| entry.name == format!("haptics.{}", hand.name)),
        kind => [AUTOPILOT, PATH, MANUAL, INSTRUMENTS].contains(&kind),
    };
    part.controllers = scenario.controllers.iter().filter(|entry| serves(entry)).cloned().collect();
    if !part.controllers.iter().any(|entry| entry.kind == INSTRUMENTS) {
        part.controllers.push(joining(INSTRUMENTS, INSTRUMENTS, INSTRUMENTS_HZ));
    }
    part
}

/// An actor of the network.
fn network_actor(factory: Factory) -> Blueprint {
    Blueprint { class: RuntimeClass::Network, factory, fences: Vec::new(), for_hands: None, arrange: None }
}

/// What the hands of a station touch, by its own copy of the scene.
fn station_touch(scene: &Snapshot, hands: &[HandPort]) -> Blueprint {
    let instrument = |hand: &HandPort| scene.get::<Hand>(hand.entity).map(|hand| hand.instrument);
    let instruments: Vec<Entity> = hands.iter().filter_map(instrument).collect();
    plain(RuntimeClass::Collision, move |context| StationTouchController::new(&instruments, context))
}

/// Staggers the haptic controllers over their period. Drivers tick at whole milliseconds with a higher priority: with
/// few cores, haptic controllers that tick at the same instant wait for the drivers and for each other.
fn stagger_haptics(roles: &mut [Role]) {
    let hands = roles.iter().filter(|role| role.class == RuntimeClass::Haptics).count() as u64;
    let haptics = roles.iter_mut().filter(|role| role.class == RuntimeClass::Haptics);
    for (index, role) in haptics.enumerate() {
        let period = period_of(role.rate_hz).as_nanos();
        role.phase = SimTime(period * (2 * index as u64 + 1) / (2 * hands));
    }
}

fn open_hands(
    app: &App,
    scenario: &Scenario,
    options: &RunOptions,
    scene: &Snapshot,
    network: &mut WrappedHands<'_>,
) -> Result<Vec<OpenedHand>, AssemblyError> {
    for (name, _) in &options.hands {
        if !scenario.hands.iter().any(|hand| hand.name == *name) {
            return Err(AssemblyError::UnknownHand {
                name: name.clone(),
                known: scenario.hands.iter().map(|hand| hand.name.as_str()).collect::<Vec<_>>().join(", "),
            });
        }
    }
    let mut opened = Vec::with_capacity(scenario.hands.len());
    for (index, hand) in scenario.hands.iter().enumerate() {
        let chosen = options.hands.iter().rev().find(|(name, _)| *name == hand.name);
        // A station has no device for the hands of others.
        let own = if options.network.station().is_some() { OTHERS_DEVICE } else { hand.device.as_str() };
        let text = chosen.map_or(own, |(_, spec)| spec.as_str());
        if chosen.is_none() && names_a_file_elsewhere(text) {
            let reason =
                "device: a file named in a scenario must lie below its folder; use --hand for others";
            return Err(scenario.error_at("hand", index, reason).into());
        }
        let device = app.make_device(&hand.name, hand.entity, text)?;
        let device = network.wrap(&hand.name, hand.entity, scene, device)?;
        let is_far = options.network.station().is_some() && !network.sharing.is_among_peers();
        let open = if is_far { OpenedHand::far_from_its_scene } else { OpenedHand::new };
        opened.push(open(hand.name.as_str(), hand.entity, device));
    }
    Ok(opened)
}

/// The part of a scenario that a station computes itself: the haptics of the hands for which it has devices, and the person
/// that moves them; among peers, everything that moves, by all hands.
fn own_part(app: &App, scenario: &Scenario, options: &RunOptions, sharing: Sharing) -> Scenario {
    let mut own = scenario.clone();
    if !sharing.has_all_hands() {
        own.hands.retain(|hand| options.hands.iter().any(|(name, _)| *name == hand.name));
    }
    let simulates = |entry: &ControllerEntry| {
        sharing.is_among_peers() && app.kind_info(&entry.kind).is_some_and(|about| about.simulates)
    };
    let serves = |entry: &ControllerEntry| {
        let of_hand = own.hands.iter().any(|hand| entry.name == format!("haptics.{}", hand.name));
        of_hand || simulates(entry) || (entry.kind == MANUAL && options.play)
    };
    own.controllers = scenario.controllers.iter().filter(|entry| serves(entry)).cloned().collect();
    own
}

/// The hands of a session: a packet reflector, and the network of a session that others share, stand between their devices
/// and their drivers.
struct WrappedHands<'a> {
    network: &'a Network,
    sharing: Sharing,
    teleoperated: TeleoperatedHands,
    host: NetworkHands,
    station: StationHands,
}

impl<'a> WrappedHands<'a> {
    fn new(network: &'a Network, sharing: Sharing, teleoperated: TeleoperatedHands) -> Self {
        Self {
            network,
            sharing,
            teleoperated,
            host: NetworkHands::default(),
            station: StationHands::default(),
        }
    }

    fn wrap(
        &mut self,
        name: &str,
        entity: Entity,
        scene: &Snapshot,
        device: Box<dyn HapticDevice>,
    ) -> Result<Box<dyn HapticDevice>, NetworkError> {
        let device = self.teleoperated.wrap(name, entity, scene, device)?;
        match self.network {
            Network::None => Ok(device),
            Network::Host(_) | Network::LockstepHost(_) => self.host.wrap(name, entity, device, self.sharing),
            Network::Station(station) => self.station.wrap(station, name, device, self.sharing),
        }
    }

    fn take_teleoperated(&mut self) -> TeleoperatedHands {
        std::mem::take(&mut self.teleoperated)
    }

    fn take_host(&mut self) -> NetworkHands {
        std::mem::take(&mut self.host)
    }

    fn take_station(&mut self) -> StationHands {
        std::mem::take(&mut self.station)
    }
}

/// Whether a device's text names a file by an absolute path or one that leaves the folder.
fn names_a_file_elsewhere(device: &str) -> bool {
    let Some((_, rest)) = device.split_once(':') else { return false };
    let file = Path::new(rest.split(',').next().unwrap_or(rest));
    file.components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_named_in_a_scenario_stay_below_its_folder() {
        for device in ["replay:../hand.csv", "jigsaws:/data/a.txt,side=left", "recording:a/../../b.mcap"] {
            assert!(names_a_file_elsewhere(device), "{device}");
        }
        for device in ["virtual", "virtual:mass=0.05", "replay:hands/left.csv,force=on"] {
            assert!(!names_a_file_elsewhere(device), "{device}");
        }
    }
}
