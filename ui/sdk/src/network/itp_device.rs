//! `itp:PORT`: a hand that a console of ITP moves, over UDP.
//!
//! ```text
//! itp:36000                              the left arm of a robot on port 36000 of the loopback
//! itp:36000,arm=right,dialect=raven-sim  the right one; as raven2_sim speaks
//! itp:36000,bind=192.0.2.4,peer=192.0.2.7   beyond the loopback both ends are named: nothing is protected
//! ```
//!
//! Two hands with one port are the two arms of one robot.

use std::any::Any;
use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use trocar_devices::{Capabilities, DeviceError, DeviceState, HapticDevice, Wrench};
use trocar_network::itp::{Dialect, ROBOT_PORT, RobotConfig};
use trocar_network::live::itp::{ItpAddress, RobotPort};
use trocar_network::teleoperation::{ItpHand, SlaveConfig, WatchedHand};

/// The form for users.
pub(crate) const ITP_USAGE: &str = "itp:PORT";
/// What it is.
pub(crate) const ITP_ABOUT: &str = "a hand that a console of ITP (the Raven's protocol) moves over UDP, unprotected: arm=left|right, \
                                    dialect=raven|raven-sim, bind=, peer=, reply=PORT, scale=, speed=";
/// The keys.
const KEYS: &str = "arm, dialect, bind, peer, reply, scale, speed";

/// Robots on their ports, which the hands of their arms share.
#[derive(Clone, Default)]
pub(crate) struct ItpRobots(Arc<Mutex<BTreeMap<ItpAddress, Weak<RobotPort>>>>);

/// A hand with the robot that it is an arm of, whose port stays open as long as one of its hands.
pub(crate) struct ItpDevice {
    hand: ItpHand,
    _robot: Arc<RobotPort>,
}

/// What a text says.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ItpSpec {
    address: ItpAddress,
    arm: usize,
    dialect: Dialect,
    slave: SlaveConfig,
}

impl ItpRobots {
    /// Makes the hand of a text.
    ///
    /// # Errors
    /// In words, with what is valid.
    pub fn device(&self, text: &str) -> Result<ItpDevice, String> {
        let spec = ItpSpec::parse(text)?;
        let mut robots = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        robots.retain(|_, robot| robot.strong_count() > 0);
        let known = robots.get(&spec.address).and_then(Weak::upgrade);
        let robot = match known.filter(|_| spec.address.port != 0) {
            Some(robot) => robot,
            None => {
                let config = RobotConfig { dialect: spec.dialect, ..RobotConfig::default() };
                let robot = RobotPort::open(&spec.address, config).map_err(|error| error.to_string())?;
                let robot = Arc::new(robot);
                robots.insert(spec.address, Arc::downgrade(&robot));
                robot
            }
        };
        let arm = robot.take(spec.arm).ok_or_else(|| {
            let side = if spec.arm == 0 { "left" } else { "right" };
            format!("the {side} arm of the robot on port {} has a hand already", robot.local().port())
        })?;
        let hand = ItpHand::new(arm, spec.slave).map_err(|error| error.to_string())?;
        Ok(ItpDevice { hand, _robot: robot })
    }
}

impl ItpDevice {
    /// The end of the actor that shows it, once.
    pub fn take_watched(&mut self) -> Option<WatchedHand> {
        self.hand.take_watched()
    }
}

impl ItpSpec {
    fn parse(text: &str) -> Result<Self, String> {
        let mut spec = Self {
            address: ItpAddress { port: ROBOT_PORT, bind: None, peer: None, reply_port: None },
            arm: 0,
            dialect: Dialect::RAVEN,
            slave: SlaveConfig::default(),
        };
        let mut parts = text.split(',').map(str::trim);
        let first = parts.next().unwrap_or_default();
        let wrong = |key: &str, value: &str, valid: &str| format!("{key}={value:?}: valid is {valid}");
        if !first.is_empty() {
            spec.address.port = first.parse().map_err(|_| {
                format!("{first:?} is no port; valid is 1 to 65535, or 0 for any, before the first comma")
            })?;
        }
        for part in parts {
            let Some((key, value)) = part.split_once('=') else {
                return Err(format!("{part:?} is not of the form key=value; keys are {KEYS}"));
            };
            let ip = || value.parse::<IpAddr>().map_err(|_| wrong(key, value, "an IP address"));
            let number = |valid| value.parse::<f64>().map_err(|_| wrong(key, value, valid));
            match key {
                "arm" => {
                    let arms = ["left", "right"];
                    let arm = arms.iter().position(|arm| *arm == value);
                    spec.arm = arm.ok_or_else(|| wrong(key, value, "left or right"))?;
                }
                "dialect" => {
                    spec.dialect = match value {
                        "raven" => Dialect::RAVEN,
                        "raven-sim" => Dialect::RAVEN_SIM,
                        _ => return Err(wrong(key, value, "raven or raven-sim")),
                    }
                }
                "bind" => spec.address.bind = Some(ip()?),
                "peer" => spec.address.peer = Some(ip()?),
                "reply" => {
                    let port = value.parse().ok().filter(|port| *port > 0);
                    let port = port.ok_or_else(|| wrong(key, value, "a port from 1 to 65535"))?;
                    spec.address.reply_port = Some(port);
                }
                "scale" => spec.slave.scale = number("0.01 to 10")?,
                "speed" => spec.slave.linear_speed = number("0.01 to 10 m/s")?,
                _ => return Err(format!("unknown key {key:?}; valid are {KEYS}")),
            }
        }
        Ok(spec)
    }
}

impl HapticDevice for ItpDevice {
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

    #[test]
    fn a_text_names_port_arm_dialect_and_both_ends() {
        let spec = ItpSpec::parse("").expect("the Raven's own");
        assert_eq!((spec.address.port, spec.arm, spec.dialect), (36_000, 0, Dialect::RAVEN));
        let spec = ItpSpec::parse(
            "7000,arm=right,dialect=raven-sim,bind=192.0.2.4,peer=192.0.2.7,reply=36001,speed=0.2",
        )
        .expect("it is valid");
        assert_eq!((spec.address.port, spec.address.reply_port, spec.arm), (7_000, Some(36_001), 1));
        assert_eq!(spec.address.peer, Some([192, 0, 2, 7].into()));
        assert_eq!(spec.slave.linear_speed, 0.2);
        for (text, says) in [
            ("here", "is no port"),
            ("1,arm=middle", "left or right"),
            ("1,dialect=dvrk", "raven or raven-sim"),
            ("1,peer=robot", "an IP address"),
            ("1,reply=0", "1 to 65535"),
            ("1,sped=2", "unknown key \"sped\"; valid are arm, dialect"),
            ("1,arm", "key=value"),
        ] {
            let error = ItpSpec::parse(text).expect_err(text);
            assert!(error.contains(says), "{text}: {error}");
        }
    }

    #[test]
    fn two_hands_with_one_port_are_the_arms_of_one_robot_and_each_arm_has_one() {
        let robots = ItpRobots::default();
        let first = robots.device("0").expect("any port");
        let port = first._robot.local().port();
        assert!(crate::hands::device_info(first.capabilities()).is_unprotected());
        drop(first);
        let left = robots.device(&port.to_string()).expect("it is free again");
        let right = robots.device(&format!("{port},arm=right")).expect("the other arm");
        assert!(Arc::ptr_eq(&left._robot, &right._robot));
        let error = robots.device(&port.to_string()).err().expect("it is taken");
        assert!(error.contains("the left arm") && error.contains("a hand already"), "{error}");
        drop((left, right));
        assert!(robots.device(&port.to_string()).is_ok(), "the port is closed with its last hand");
        assert!(robots.device("0,bind=0.0.0.0").err().expect("it is refused").contains("peer="));
    }
}
