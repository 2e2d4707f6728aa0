//! Hands behind a packet reflector: the device is the master, and the instrument in the scene the slave.
//!
//! ```toml
//! [network.reflector]
//! hands = ["right"]
//! round_trip_secs = 0.15057            # the mean; the trace is made, see `internet_path`
//! slave = { scale = 1.0 }
//! feedback = "automatic"               # the master's hand feels what the slave touches; or passivity, wave-variables,
//!                                      # model-mediated; nothing without it
//! ```
//!
//! Live the packets go over real sockets, to a reflector that the session starts on the loopback, or to one that
//! [`RunOptions::reflector`](crate::run::RunOptions::reflector) names. In virtual time the same reflector is stepped inside the process.

use std::any::Any;
use std::net::SocketAddr;
use std::sync::Arc;

use serde::Deserialize;
use trocar_devices::HapticDevice;
use trocar_kernel::spec::{Factory, Peer};
use trocar_network::compensation::Compensation;
use trocar_network::datagram::COUPLED_HANDS_MAX;
use trocar_network::impairments::{DELAY_MAX, DelayTrace, Impairments};
use trocar_network::live::reflected::{OwnReflector, socket};
use trocar_network::lockstep::ReflectedPeer;
use trocar_network::reflector::Reflector;
use trocar_network::teleoperation::{
    LinkError, LinkedHand, ReflectedHand, ReflectedLink, SlaveConfig, TeleoperationController,
    TeleoperationWatch, WatchedHand, WatchedLink, internet_path,
};
use trocar_scene::scenario::Scenario;
use trocar_scene::{BuildContext, Controller, Entity, Hand, Instrument, SimTime, Snapshot};

use super::NetworkError;
use super::host::NetworkSettings;
use super::itp_console::{ItpConsoles, Led};
use super::itp_device::ItpDevice;
use super::part::NetworkPart;
use crate::hands::OpenedHand;

/// Name of the actor of tele-operated hands.
pub(crate) const TELEOPERATION: &str = "teleoperation";
/// Its ticks per second \[Hz\].
pub(crate) const TELEOPERATION_HZ: f64 = 250.0;

/// Table `[network.reflector]` of a scenario.
#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct ReflectorSettings {
    /// Names of the hands behind it.
    hands: Vec<String>,
    /// Mean round trip \[s\].
    round_trip_secs: f64,
    /// Whether it varies as a path through the Internet does; else it is constant.
    varies: bool,
    /// Seed of the trace and of the path's luck.
    seed: u64,
    /// Share of the packets that is lost.
    loss: f64,
    /// Mean length of a burst of losses, in packets; below 1 each is lost for itself.
    burst: f64,
    /// Share that comes twice.
    duplicate: f64,
    /// Share that is overtaken by the next one.
    reorder: f64,
    /// Share of which bits flip.
    corrupt: f64,
    /// The robot.
    slave: SlaveConfig,
    /// How the forces at the slave are brought to the master's hand; none: it feels none.
    feedback: Option<Compensation>,
}

impl Default for ReflectorSettings {
    fn default() -> Self {
        Self {
            hands: Vec::new(),
            round_trip_secs: internet_path::MEAN.as_secs_f64(),
            varies: true,
            seed: 1,
            loss: 0.0,
            burst: 0.0,
            duplicate: 0.0,
            reorder: 0.0,
            corrupt: 0.0,
            slave: SlaveConfig::default(),
            feedback: None,
        }
    }
}

impl ReflectorSettings {
    fn check(&self, scenario: &Scenario) -> Result<(), String> {
        let range = |field: &str, value: f64, min: f64, max: f64, unit: &str| {
            // NaN fails every range check.
            let wrong = || format!("reflector.{field}: {value} is out of range ({min} to {max}{unit})");
            if (min..=max).contains(&value) { Ok(()) } else { Err(wrong()) }
        };
        let shortest = if self.varies { internet_path::MEAN_MIN.as_secs_f64() } else { 0.0 };
        range("round_trip_secs", self.round_trip_secs, shortest, DELAY_MAX.as_secs_f64(), " s")?;
        let shares = [
            ("loss", self.loss),
            ("duplicate", self.duplicate),
            ("reorder", self.reorder),
            ("corrupt", self.corrupt),
        ];
        for (field, share) in shares {
            range(field, share, 0.0, 1.0, "")?;
        }
        range("burst", self.burst, 0.0, 1e6, " packets")?;
        if self.feedback.is_some() && self.hands.len() > COUPLED_HANDS_MAX {
            let hands = self.hands.len();
            return Err(format!(
                "reflector.feedback: {hands} hands are too many for one packet; {COUPLED_HANDS_MAX} fit with their forces"
            ));
        }
        let known = || scenario.hands.iter().map(|hand| hand.name.as_str()).collect::<Vec<_>>().join(", ");
        match self.hands.iter().find(|name| !scenario.hands.iter().any(|hand| hand.name == **name)) {
            Some(name) => Err(format!("reflector.hands: no hand is called '{name}'; there are: {}", known())),
            None if self.hands.is_empty() => {
                Err(format!("reflector.hands: names the hands behind it; there are: {}", known()))
            }
            None => Ok(()),
        }
    }

    fn path(&self) -> Impairments {
        let mean = SimTime::from_secs_f64(self.round_trip_secs);
        let (delay, trace) = if self.varies {
            (SimTime::ZERO, internet_path::trace(mean, self.seed))
        } else {
            (mean, DelayTrace::default())
        };
        Impairments {
            delay,
            trace,
            loss: self.loss,
            burst: self.burst,
            duplicate: self.duplicate,
            reorder: self.reorder,
            corrupt: self.corrupt,
            ..Impairments::default()
        }
    }

    /// The delays by which every packet of an own reflector is judged.
    fn expected(&self, path: &Impairments) -> DelayTrace {
        match path.trace.delays.is_empty() {
            true => DelayTrace { delays: vec![path.delay], every: SimTime::from_millis(1) },
            false => path.trace.clone(),
        }
    }
}

/// The tele-operated hands of a session: those behind a packet reflector, those that consoles elsewhere move, and those that
/// lead robots elsewhere.
#[derive(Default)]
pub(crate) struct TeleoperatedHands {
    settings: Option<ReflectorSettings>,
    reflector: Option<SocketAddr>,
    consoles: ItpConsoles,
    linked: Vec<LinkedHand>,
    reflected: Vec<(String, Entity, WatchedHand)>,
    others: Vec<(String, Entity, WatchedHand)>,
}

/// The actor of tele-operated hands, and the link of those that are reflected.
pub(crate) struct TeleoperationPart {
    /// Makes the actor.
    pub actor: Factory,
    /// The link.
    pub part: Option<NetworkPart>,
    /// What copies of the session need, in virtual time.
    pub origin: Option<ReflectedOrigin>,
}

/// What a session in virtual time knows of its reflected hands, for its copies.
pub(crate) struct ReflectedOrigin {
    settings: Arc<ReflectorSettings>,
    hands: Vec<(String, Entity)>,
    watch: TeleoperationWatch,
}

impl TeleoperatedHands {
    /// Those that the scenario names, and those that lead robots elsewhere; `reflector` is one that somebody else runs.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn of(
        scenario: &Scenario,
        reflector: Option<SocketAddr>,
        consoles: &[(String, String)],
    ) -> Result<Self, NetworkError> {
        let is_console = !consoles.is_empty();
        let consoles = ItpConsoles::of(scenario, consoles)?;
        if is_console {
            // The way to the robot is the path.
            return Ok(Self { consoles, ..Self::default() });
        }
        let settings = NetworkSettings::of(scenario)?.reflector;
        if let Some(settings) = &settings {
            let located = |reason| NetworkError::Scenario(scenario.network.error(reason).to_string());
            settings.check(scenario).map_err(located)?;
        } else if reflector.is_some() {
            let reason = "no hand of this scenario goes through a packet reflector; a scenario names them in its \
                          table [network.reflector], such as tele-liver";
            return Err(NetworkError::Usage(reason.to_owned()));
        }
        Ok(Self { settings, reflector, consoles, ..Self::default() })
    }

    /// Puts a path between a hand's device and its driver, if the hand has one. A device that a console elsewhere moves has
    /// its path already.
    ///
    /// # Errors
    /// [`NetworkError`] when the slave's figures are out of range, or there is no robot to lead.
    pub fn wrap(
        &mut self,
        name: &str,
        entity: Entity,
        scene: &Snapshot,
        mut device: Box<dyn HapticDevice>,
    ) -> Result<Box<dyn HapticDevice>, NetworkError> {
        let elsewhere = device.as_any().and_then(|any| any.downcast_mut::<ItpDevice>());
        if let Some(watched) = elsewhere.and_then(ItpDevice::take_watched) {
            self.others.push((name.to_owned(), entity, watched));
            return Ok(device);
        }
        let device = match self.consoles.wrap(name, device)? {
            Led::Leads(device, watched) => {
                self.others.push((name.to_owned(), entity, watched));
                return Ok(device);
            }
            Led::Free(device) => device,
        };
        let Some(settings) = self.settings.as_ref().filter(|all| all.hands.iter().any(|hand| hand == name))
        else {
            return Ok(device);
        };
        let number = self.linked.len() as u8;
        let (hand, linked, watched) = ReflectedHand::new(number, settings.slave, device)
            .map_err(|error| NetworkError::Scenario(format!("reflector: {error}")))?;
        let hand = match settings.feedback {
            Some(choice) => hand.feeding_back(choice, &settings.slave, coupling_stiffness(scene, entity)),
            None => hand,
        };
        self.linked.push(linked);
        self.reflected.push((name.to_owned(), entity, watched));
        Ok(Box::new(hand))
    }

    /// The actor and the link, if there are any hands.
    ///
    /// # Errors
    /// [`NetworkError`] when there is no port, or no key.
    pub fn part(self, lockstep: bool) -> Result<Option<TeleoperationPart>, NetworkError> {
        let (linked, mut hands) = (self.linked, self.reflected);
        let named: Vec<(String, Entity)> =
            hands.iter().map(|(name, entity, _)| (name.clone(), *entity)).collect();
        hands.extend(self.others);
        if hands.is_empty() {
            return Ok(None);
        }
        let Some(settings) = self.settings.filter(|_| !linked.is_empty()) else {
            let watch = TeleoperationWatch::new(hands, None);
            return Ok(Some(TeleoperationPart { actor: actor_of(&watch), part: None, origin: None }));
        };
        if lockstep {
            let (peer, link) = peer(&settings, linked)?;
            let watch = TeleoperationWatch::new(hands, Some(link));
            let (actor, part) = (actor_of(&watch), Some(NetworkPart::Lockstep(peer)));
            let origin = Some(ReflectedOrigin { settings: Arc::new(settings), hands: named, watch });
            return Ok(Some(TeleoperationPart { actor, part, origin }));
        }
        let path = settings.path();
        let (address, own, expected) = match self.reflector {
            // The delays of somebody else's reflector are not known here.
            Some(address) => (address, None, None),
            None => {
                let expected = settings.expected(&path);
                let own = OwnReflector::bind(path, settings.seed)?;
                (own.address(), Some(Box::new(own)), Some(expected))
            }
        };
        let (link, watched) = ReflectedLink::new(address, linked, expected).map_err(without_key)?;
        let part = NetworkPart::Reflected { socket: socket(&address)?, link: Box::new(link), own };
        let watch = TeleoperationWatch::new(hands, Some(watched));
        Ok(Some(TeleoperationPart { actor: actor_of(&watch), part: Some(part), origin: None }))
    }
}

impl ReflectedOrigin {
    /// For a copy that will make its own.
    pub fn again(&self) -> Self {
        Self { settings: self.settings.clone(), hands: self.hands.clone(), watch: self.watch.clone() }
    }

    /// A path with nothing on it, for hands that begin: its peer and its actor.
    ///
    /// # Errors
    /// [`NetworkError`] when there is no key.
    pub fn anew(&mut self, hands: &mut [OpenedHand]) -> Result<(Box<dyn Peer>, Factory), NetworkError> {
        let (linked, watched) = self.ends(hands);
        let (peer, link) = peer(&self.settings, linked)?;
        let named = self.hands.iter().zip(watched).map(|((name, entity), end)| (name.clone(), *entity, end));
        self.watch = TeleoperationWatch::new(named.collect(), Some(link));
        Ok((peer, actor_of(&self.watch)))
    }

    /// A copy of the path of this session's peers, with what is under way, for hands that are copies.
    ///
    /// # Errors
    /// [`NetworkError`] when there is no key.
    pub fn fork<'a>(
        &mut self,
        mut peers: impl Iterator<Item = &'a dyn Peer>,
        hands: &mut [OpenedHand],
    ) -> Result<(Box<dyn Peer>, Factory), NetworkError> {
        let (linked, watched) = self.ends(hands);
        let path = peers.find_map(|peer| (peer as &dyn Any).downcast_ref::<ReflectedPeer>());
        let path = path.ok_or_else(|| NetworkError::System("reflector: the session has none".to_owned()))?;
        let (peer, link) = path.fork(linked).map_err(without_key)?;
        self.watch = self.watch.fork(watched, Some(link));
        Ok((Box::new(peer), actor_of(&self.watch)))
    }

    /// The free ends of copied devices, in the order of the hands behind the reflector.
    fn ends(&self, hands: &mut [OpenedHand]) -> (Vec<LinkedHand>, Vec<WatchedHand>) {
        let of = |hand: &mut OpenedHand| {
            let any = hand.device_mut().as_any()?;
            any.downcast_mut::<ReflectedHand>()?.take_ends()
        };
        hands.iter_mut().filter_map(of).unzip()
    }
}

/// Stiffness between a hand and its instrument [N/m].
fn coupling_stiffness(scene: &Snapshot, hand: Entity) -> f64 {
    let instrument = scene.get::<Hand>(hand).and_then(|hand| scene.get::<Instrument>(hand.instrument));
    instrument.map_or_else(|| Instrument::default().coupling_stiffness, |tool| tool.coupling_stiffness)
}

/// The path in virtual time.
fn peer(
    settings: &ReflectorSettings,
    linked: Vec<LinkedHand>,
) -> Result<(Box<dyn Peer>, WatchedLink), NetworkError> {
    let path = settings.path();
    let (link, watched) =
        ReflectedLink::new((), linked, Some(settings.expected(&path))).map_err(without_key)?;
    let reflector = Reflector::new(&path, settings.seed);
    Ok((Box::new(ReflectedPeer::new("network.reflector", link, reflector)), watched))
}

fn actor_of(watch: &TeleoperationWatch) -> Factory {
    let watch = watch.clone();
    Arc::new(move |_: &BuildContext<'_>| {
        Ok(Box::new(TeleoperationController::new(&watch)?) as Box<dyn Controller>)
    })
}

fn without_key(error: LinkError) -> NetworkError {
    NetworkError::System(format!("reflector: {error}"))
}
