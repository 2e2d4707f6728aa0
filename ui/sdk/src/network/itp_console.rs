//! `itp:HOST:PORT`: a hand of this session leads an arm of a robot of ITP somewhere else, over UDP.
//!
//! ```text
//! itp:127.0.0.1:36000                             the left arm of a robot on this machine
//! itp:127.0.0.1:36000,arm=right,pedal=0           the right one, while button 0 of the device is pressed
//! itp:192.0.2.4:36000,bind=192.0.2.7,scale=0.3    beyond the loopback both ends are named: nothing is protected
//! ```
//!
//! Two hands with one robot are the two hands of one console. Such a session is a console and nothing else: it has its hands,
//! and none of the physics, which is the robot's.

use std::any::Any;
use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::sync::Arc;

use trocar_devices::{Capabilities, DeviceError, DeviceState, HandIntent, HapticDevice, Wrench};
use trocar_network::itp::{ConsoleConfig, Dialect};
use trocar_network::live::itp::ConsolePort;
use trocar_network::teleoperation::{ItpMaster, WatchedHand};
use trocar_scene::scenario::Scenario;

use super::NetworkError;

/// The form for users.
const USAGE: &str = "itp:HOST:PORT";
/// The keys.
const KEYS: &str = "arm, dialect, bind, scale, pedal";

/// What a text says.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ConsoleSpec {
    robot: SocketAddr,
    bind: Option<IpAddr>,
    arm: usize,
    pedal: Option<u8>,
    config: ConsoleConfig,
}

/// Hands that lead robots: each console, which its hands share.
#[derive(Default)]
pub(super) struct ItpConsoles {
    specs: BTreeMap<String, String>,
    ports: BTreeMap<SocketAddr, Arc<ConsolePort>>,
}

/// A hand with its console, which sends as long as one of its hands is there.
struct ConsoleDevice {
    hand: ItpMaster,
    _console: Arc<ConsolePort>,
}

impl ItpConsoles {
    /// Those with these names and robots.
    ///
    /// # Errors
    /// [`NetworkError::Usage`] when there is no such hand.
    pub fn of(scenario: &Scenario, consoles: &[(String, String)]) -> Result<Self, NetworkError> {
        for (name, _) in consoles {
            if !scenario.hands.iter().any(|hand| hand.name == *name) {
                let known =
                    scenario.hands.iter().map(|hand| hand.name.as_str()).collect::<Vec<_>>().join(", ");
                let reason = format!("console {name}: no hand is called '{name}'; there are: {known}");
                return Err(NetworkError::Usage(reason));
            }
        }
        Ok(Self { specs: consoles.iter().cloned().collect(), ports: BTreeMap::new() })
    }

    /// Lets a device lead its arm, if the hand is at a console.
    ///
    /// # Errors
    /// [`NetworkError::Usage`] says what is wrong with the text, and what is valid.
    pub fn wrap(&mut self, name: &str, device: Box<dyn HapticDevice>) -> Result<Led, NetworkError> {
        let Some(text) = self.specs.get(name) else { return Ok(Led::Free(device)) };
        let wrong = |reason: String| NetworkError::Usage(format!("console {name}={text}: {reason}"));
        let spec = ConsoleSpec::parse(text).map_err(wrong)?;
        if spec.pedal.is_none() && device.fork().is_none() {
            let reason =
                "a person needs a pedal, which lets the robot follow: pedal=BUTTON of the device, 0 to 15";
            return Err(wrong(reason.to_owned()));
        }
        let console = match self.ports.get(&spec.robot) {
            Some(console) => console.clone(),
            None => {
                let console = ConsolePort::open(spec.robot, spec.bind, spec.config)
                    .map_err(|error| wrong(error.to_string()))?;
                let console = Arc::new(console);
                self.ports.insert(spec.robot, console.clone());
                console
            }
        };
        let arm = console.take(spec.arm).ok_or_else(|| {
            let side = if spec.arm == 0 { "left" } else { "right" };
            wrong(format!(
                "the {side} arm of that robot has a hand already; arm=left or arm=right says which"
            ))
        })?;
        let (hand, watched) = ItpMaster::new(device, arm, spec.arm, spec.pedal);
        Ok(Led::Leads(Box::new(ConsoleDevice { hand, _console: console }), watched))
    }
}

/// A device after it was looked at.
pub(super) enum Led {
    /// It leads no robot.
    Free(Box<dyn HapticDevice>),
    /// It does; with the end of the actor that shows it.
    Leads(Box<dyn HapticDevice>, WatchedHand),
}

impl ConsoleSpec {
    fn parse(text: &str) -> Result<Self, String> {
        let Some(rest) = text.strip_prefix("itp:") else {
            return Err(format!("{USAGE} is expected, such as itp:127.0.0.1:36000"));
        };
        let mut parts = rest.split(',').map(str::trim);
        let place = parts.next().unwrap_or_default();
        let found = place
            .to_socket_addrs()
            .map_err(|error| format!("{place:?}: {error}; HOST:PORT is expected, such as 127.0.0.1:36000"))?;
        let robot = found.into_iter().next().ok_or_else(|| format!("{place:?}: the name has no address"))?;
        let mut spec = Self { robot, bind: None, arm: 0, pedal: None, config: ConsoleConfig::default() };
        let wrong = |key: &str, value: &str, valid: &str| format!("{key}={value:?}: valid is {valid}");
        for part in parts {
            let Some((key, value)) = part.split_once('=') else {
                return Err(format!("{part:?} is not of the form key=value; keys are {KEYS}"));
            };
            match key {
                "arm" => {
                    let arm = ["left", "right"].iter().position(|arm| *arm == value);
                    spec.arm = arm.ok_or_else(|| wrong(key, value, "left or right"))?;
                }
                "dialect" => {
                    spec.config.dialect = match value {
                        "raven" => Dialect::RAVEN,
                        "raven-sim" => Dialect::RAVEN_SIM,
                        _ => return Err(wrong(key, value, "raven or raven-sim")),
                    }
                }
                "bind" => spec.bind = Some(value.parse().map_err(|_| wrong(key, value, "an IP address"))?),
                "scale" => {
                    let scale = value.parse().ok().filter(|scale| (0.01..=10.0).contains(scale));
                    spec.config.scale = scale.ok_or_else(|| wrong(key, value, "0.01 to 10"))?;
                }
                "pedal" => {
                    let button = value.parse().ok().filter(|button| *button < 16);
                    spec.pedal = Some(button.ok_or_else(|| wrong(key, value, "a button, 0 to 15"))?);
                }
                _ => return Err(format!("unknown key {key:?}; valid are {KEYS}")),
            }
        }
        Ok(spec)
    }
}

impl HapticDevice for ConsoleDevice {
    fn capabilities(&self) -> &Capabilities {
        self.hand.capabilities()
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.hand.open(now_ns)
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        self.hand.read(now_ns)
    }

    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        self.hand.write(now_ns, wrench)
    }

    fn set_intent(&mut self, now_ns: u64, intent: &HandIntent) {
        self.hand.set_intent(now_ns, intent);
    }

    fn close(&mut self) {
        self.hand.close();
    }

    fn as_any(&mut self) -> Option<&mut dyn Any> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::App;
    use crate::run::{RunOptions, start};

    #[test]
    fn a_text_names_the_robot_its_arm_and_the_pedal() {
        let spec = ConsoleSpec::parse("itp:127.0.0.1:36000").expect("it is valid");
        assert_eq!((spec.robot.port(), spec.arm, spec.pedal), (36_000, 0, None));
        let text = "itp:192.0.2.4:7000,arm=right,dialect=raven-sim,bind=192.0.2.7,scale=0.3,pedal=2";
        let spec = ConsoleSpec::parse(text).expect("it is valid");
        assert_eq!((spec.arm, spec.pedal, spec.config.scale), (1, Some(2), 0.3));
        assert_eq!((spec.config.dialect, spec.bind), (Dialect::RAVEN_SIM, Some([192, 0, 2, 7].into())));
        for (text, says) in [
            ("127.0.0.1:36000", "itp:HOST:PORT is expected"),
            ("itp:127.0.0.1", "HOST:PORT is expected"),
            ("itp:127.0.0.1:1,arm=middle", "left or right"),
            ("itp:127.0.0.1:1,scale=0", "0.01 to 10"),
            ("itp:127.0.0.1:1,pedal=16", "0 to 15"),
            ("itp:127.0.0.1:1,speed=1", "unknown key \"speed\"; valid are arm, dialect"),
            ("itp:127.0.0.1:1,arm", "key=value"),
        ] {
            let error = ConsoleSpec::parse(text).expect_err(text);
            assert!(error.contains(says), "{text}: {error}");
        }
    }

    #[test]
    fn a_console_has_its_hands_and_no_physics_and_what_cannot_be_one_is_told() {
        let app = App::new();
        let scenario = app.scenario("tele-liver").expect("a scenario");
        let at = |name: &str, text: &str| RunOptions {
            consoles: vec![(name.to_owned(), text.to_owned())],
            ..RunOptions::default()
        };
        let session = start(&app, &scenario, &at("right", "itp:127.0.0.1:9")).expect("it starts");
        let names: Vec<String> = session.accesses().into_iter().map(|(name, ..)| name).collect();
        assert_eq!(names, ["haptics.right", "instruments", "trainee", "teleoperation"]);
        session.finish();
        for (options, says) in [
            (at("left", "itp:127.0.0.1:9"), "no hand is called 'left'; there are: right"),
            (at("right", "itp:192.0.2.1:9"), "bind=OWN-ADDRESS"),
            (RunOptions { lockstep: true, ..at("right", "itp:127.0.0.1:9") }, "in real time"),
        ] {
            let error = start(&app, &scenario, &options).err().expect("it is refused").to_string();
            assert!(error.contains(says), "{error}");
        }
    }
}
