//! Hands behind a packet reflector: the device is the master, and the instrument in the scene the slave.
//!
//! ```toml
//! [network.reflector]
//! hands = ["right"]
//! round_trip_secs = 0.15057            # the mean; the trace is made, see `internet_path`
//! slave = { scale = 1.0 }
//! ```
//!
//! Live the packets go over real sockets, to a reflector that the session starts on the loopback, or to one that
//! [`RunOptions::reflector`](crate::run::RunOptions::reflector) names. In virtual time the same reflector is stepped inside the process.

use std::net::SocketAddr;
use std::sync::Arc;

use serde::Deserialize;
use trocar_devices::HapticDevice;
use trocar_kernel::spec::Factory;
use trocar_network::hands_link::HandsLink;
use trocar_network::impairments::{DELAY_MAX, DelayTrace, Impairments};
use trocar_network::live::reflected::{OwnReflector, socket};
use trocar_network::lockstep::ReflectedPeer;
use trocar_network::reflector::Reflector;
use trocar_network::teleoperation::{
    LinkedHand, TeleoperationController, ReflectedHand, ReflectedLink, TeleoperationWatch, SlaveConfig, WatchedHand,
    WatchedLink, internet_path,
};
use trocar_scene::scenario::Scenario;
use trocar_scene::{BuildContext, Controller, Entity, SimTime};

use super::NetworkError;
use super::host::NetworkSettings;
use super::part::NetworkPart;

/// Name of the actor of reflected hands.
pub(crate) const REFLECTOR: &str = "reflector";
/// Its ticks per second \[Hz\].
pub(crate) const REFLECTOR_HZ: f64 = 250.0;

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

/// The reflected hands of a session.
#[derive(Default)]
pub(crate) struct ReflectedHands {
    settings: Option<ReflectorSettings>,
    reflector: Option<SocketAddr>,
    linked: Vec<LinkedHand>,
    watched: Vec<(String, Entity, WatchedHand)>,
}

/// The actor of reflected hands, and their link.
pub(crate) struct ReflectedPart {
    /// Makes the actor.
    pub actor: Factory,
    /// The link.
    pub part: NetworkPart,
}

impl ReflectedHands {
    /// Those that the scenario names; `reflector` is one that somebody else runs.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn of(scenario: &Scenario, reflector: Option<SocketAddr>) -> Result<Self, NetworkError> {
        let settings = NetworkSettings::of(scenario)?.reflector;
        if let Some(settings) = &settings {
            let located = |reason| NetworkError::Scenario(scenario.network.error(reason).to_string());
            settings.check(scenario).map_err(located)?;
        } else if reflector.is_some() {
            let reason = "no hand of this scenario goes through a packet reflector; a scenario names them in its \
                          table [network.reflector], such as tele-liver";
            return Err(NetworkError::Usage(reason.to_owned()));
        }
        Ok(Self { settings, reflector, ..Self::default() })
    }

    /// Puts the path between a hand's device and its driver, if the hand is behind the reflector.
    ///
    /// # Errors
    /// [`NetworkError`] when the slave's figures are out of range.
    pub fn wrap(
        &mut self,
        name: &str,
        entity: Entity,
        device: Box<dyn HapticDevice>,
    ) -> Result<Box<dyn HapticDevice>, NetworkError> {
        let Some(settings) = self.settings.as_ref().filter(|all| all.hands.iter().any(|hand| hand == name))
        else {
            return Ok(device);
        };
        let number = self.linked.len() as u8;
        let (hand, linked, watched) = ReflectedHand::new(number, settings.slave, device)
            .map_err(|error| NetworkError::Scenario(format!("reflector: {error}")))?;
        self.linked.push(linked);
        self.watched.push((name.to_owned(), entity, watched));
        Ok(Box::new(hand))
    }

    /// The actor and the link, if there are any hands.
    ///
    /// # Errors
    /// [`NetworkError`] when there is no port, or no key.
    pub fn part(self, lockstep: bool) -> Result<Option<ReflectedPart>, NetworkError> {
        let Some(settings) = self.settings.filter(|_| !self.linked.is_empty()) else { return Ok(None) };
        let path = settings.path();
        let expected = settings.expected(&path);
        let (part, watch) = if lockstep {
            let (link, watch) = link((), self.linked, Some(expected))?;
            let reflector = Reflector::new(&path, settings.seed);
            let peer = ReflectedPeer::new("network.reflector", link, reflector);
            (NetworkPart::Lockstep(Box::new(peer)), watch)
        } else {
            let (address, own, expected) = match self.reflector {
                // The delays of somebody else's reflector are not known here.
                Some(address) => (address, None, None),
                None => {
                    let own = OwnReflector::bind(path, settings.seed)?;
                    (own.address(), Some(Box::new(own)), Some(expected))
                }
            };
            let (link, watch) = link(address, self.linked, expected)?;
            (NetworkPart::Reflected { socket: socket(&address)?, link, own }, watch)
        };
        let watch = TeleoperationWatch::new(self.watched, watch);
        let factory = move |_: &BuildContext<'_>| {
            Ok(Box::new(TeleoperationController::new(&watch)?) as Box<dyn Controller>)
        };
        Ok(Some(ReflectedPart { actor: Arc::new(factory), part }))
    }
}

fn link<A: Copy + PartialEq + Send + 'static>(
    reflector: A,
    hands: Vec<LinkedHand>,
    trace: Option<DelayTrace>,
) -> Result<(Box<dyn HandsLink<A>>, WatchedLink), NetworkError> {
    let (link, watch) = ReflectedLink::new(reflector, hands, trace)
        .map_err(|error| NetworkError::System(format!("reflector: {error}")))?;
    Ok((Box::new(link), watch))
}
