//! Device specifications: the text that names a device on a command line or in a scenario.
//!
//! ```text
//! virtual                                     a virtual hand of default figures
//! virtual:impedance=off,mass=0.05             … with others
//! replay:FILE                                 a CSV of hand motion (t,x,y,z,qw,qx,qy,qz,gripper)
//! replay:FILE,force=on,arm_stiffness=300      … on which force acts
//! replay:FILE,start=1700000000.5,time=ns      … from this time of its clock on, which counts nanoseconds
//! jigsaws:FILE,side=left,source=slave,scale=1.0
//! ```
//!
//! A file's name ends at the first comma. [`crate::spec_options`] has all the keys.

use std::path::PathBuf;
use std::str::FromStr;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use thiserror::Error;

use crate::clock::{TimeUnit, parse_time};
use crate::device::{Dofs, HapticDevice, Workspace};
use crate::hand_config::{HandConfigError, VirtualHandConfig};
use crate::hand_csv::read_hand_csv;
use crate::jigsaws::{JigsawsSelection, JigsawsSide, JigsawsSource, read_jigsaws};
use crate::reader::{ReadError, StartTime};
use crate::replay_hand::ReplayHand;
use crate::spec_options::{DeviceOption, HAND_OPTIONS, JIGSAWS_OPTIONS, REPLAY_OPTIONS};
use crate::trajectory::{Registration, Trajectory, TrajectoryError};
use crate::virtual_hand::VirtualHand;

const KINDS: &str = "virtual, replay:FILE, jigsaws:FILE";
/// A device as a user names it; see the module for the text.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceSpec {
    /// A virtual hand.
    Virtual(VirtualHandConfig),
    /// A recording of hand motion.
    Replay {
        /// CSV file.
        file: PathBuf,
        /// Meaning of its first time.
        start: StartTime,
        /// Unit of its times, if they are numbers; none: as the file tells.
        unit: Option<TimeUnit>,
        /// The virtual hand on which force acts; none: force has no effect.
        force: Option<VirtualHandConfig>,
    },
    /// A recording of the JIGSAWS data set.
    Jigsaws {
        /// File of kinematics.
        file: PathBuf,
        /// Which manipulator.
        selection: JigsawsSelection,
        /// Whether the centre of the motion is moved to the pose's origin.
        centre: bool,
        /// Scale and pose in the device's frame.
        registration: Registration,
        /// The virtual hand on which force acts; none: force has no effect.
        force: Option<VirtualHandConfig>,
    },
}

/// Why a device specification is invalid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SpecError {
    /// No such kind of device.
    #[error("unknown device {kind:?}; valid are {KINDS}")]
    UnknownKind {
        /// The text before the colon.
        kind: String,
    },
    /// A recording without a file.
    #[error("device {kind:?} needs a file: {kind}:FILE")]
    MissingFile {
        /// Kind of device.
        kind: &'static str,
    },
    /// No such key.
    #[error("unknown key {key:?} of device {kind:?}; valid are {valid}")]
    UnknownKey {
        /// Kind of device.
        kind: &'static str,
        /// The key.
        key: String,
        /// Every valid key.
        valid: String,
    },
    /// Something that is not `key=value`.
    #[error("{text:?} of device {kind:?} is not of the form key=value")]
    NotAPair {
        /// Kind of device.
        kind: &'static str,
        /// The text found.
        text: String,
    },
    /// A key given twice.
    #[error("key {key:?} of device {kind:?} is given twice")]
    Twice {
        /// Kind of device.
        kind: &'static str,
        /// The key.
        key: String,
    },
    /// A value of the wrong kind.
    #[error("{key}={value:?} of device {kind:?}: valid is {valid}")]
    Value {
        /// Kind of device.
        kind: &'static str,
        /// The key.
        key: String,
        /// Its value.
        value: String,
        /// What is valid.
        valid: &'static str,
    },
    /// A key of the virtual hand, for a recording without force.
    #[error("key {key:?} of device {kind:?} needs force=on")]
    NeedsForce {
        /// Kind of device.
        kind: &'static str,
        /// The key.
        key: String,
    },
    /// A parameter of the virtual hand is out of range.
    #[error("device {kind:?}: {source}")]
    Figure {
        /// Kind of device.
        kind: &'static str,
        /// The parameter and its range.
        source: HandConfigError,
    },
}

/// Why a specified device could not be built.
#[derive(Debug, Error)]
pub enum BuildError {
    /// The recording could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The recording cannot be registered.
    #[error("{file}: {source}")]
    Registration {
        /// The file.
        file: String,
        /// What is wrong.
        source: TrajectoryError,
    },
    /// A parameter of the virtual hand is out of range.
    #[error(transparent)]
    Figure(#[from] HandConfigError),
}

impl DeviceSpec {
    /// The file that the device plays, if it plays one.
    pub fn file(&self) -> Option<&PathBuf> {
        match self {
            Self::Virtual(_) => None,
            Self::Replay { file, .. } | Self::Jigsaws { file, .. } => Some(file),
        }
    }

    /// Builds the device; reads its file.
    ///
    /// # Errors
    /// [`BuildError`] names the file and the place in it.
    pub fn build(&self) -> Result<Box<dyn HapticDevice>, BuildError> {
        match self {
            Self::Virtual(config) => Ok(Box::new(VirtualHand::new(config.clone())?)),
            Self::Replay { file, start, unit, force } => {
                replay(read_hand_csv(file, *start, *unit)?, force.as_ref())
            }
            Self::Jigsaws { file, selection, centre, registration, force } => {
                let trajectory = read_jigsaws(file, *selection)?;
                let mut registration = *registration;
                if *centre {
                    registration.centre_in_source = trajectory.centre();
                }
                let registered = trajectory.registered(&registration).map_err(|source| {
                    BuildError::Registration { file: file.display().to_string(), source }
                })?;
                replay(registered, force.as_ref())
            }
        }
    }
}

fn replay(
    trajectory: Trajectory,
    force: Option<&VirtualHandConfig>,
) -> Result<Box<dyn HapticDevice>, BuildError> {
    let hand = ReplayHand::new(trajectory);
    Ok(Box::new(match force {
        Some(config) => hand.with_force(config.clone())?,
        None => hand,
    }))
}

impl FromStr for DeviceSpec {
    type Err = SpecError;

    fn from_str(text: &str) -> Result<Self, SpecError> {
        let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
        match kind.trim() {
            "virtual" => parse_virtual(rest),
            "replay" => parse_replay(rest),
            "jigsaws" => parse_jigsaws(rest),
            other => Err(SpecError::UnknownKind { kind: other.to_owned() }),
        }
    }
}

/// One `key=value` of a device.
struct Pair<'a> {
    kind: &'static str,
    key: &'a str,
    value: &'a str,
}

impl Pair<'_> {
    fn wrong(&self, valid: &'static str) -> SpecError {
        SpecError::Value { kind: self.kind, key: self.key.to_owned(), value: self.value.to_owned(), valid }
    }

    fn switch(&self) -> Result<bool, SpecError> {
        self.one_of(&[("on", true), ("off", false)], "on or off")
    }

    fn number(&self) -> Result<f64, SpecError> {
        self.value.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| self.wrong("a finite number"))
    }

    fn number_within(&self, min: f64, max: f64, valid: &'static str) -> Result<f64, SpecError> {
        Some(self.number()?).filter(|x| (min..=max).contains(x)).ok_or_else(|| self.wrong(valid))
    }

    fn one_of<T: Copy>(&self, choices: &[(&str, T)], valid: &'static str) -> Result<T, SpecError> {
        let choice = choices.iter().find(|(name, _)| *name == self.value);
        choice.map(|(_, value)| *value).ok_or_else(|| self.wrong(valid))
    }

    fn size(&self) -> Result<Vector3<f64>, SpecError> {
        let edges: Vec<f64> = self.value.split('x').map_while(|edge| edge.parse().ok()).collect();
        match edges[..] {
            [x, y, z] if self.value.split('x').count() == 3 => Ok(Vector3::new(x, y, z)),
            _ => Err(self.wrong("WIDTHxHEIGHTxDEPTH in metres, such as 0.16x0.12x0.07")),
        }
    }
}

fn pairs<'a>(
    kind: &'static str,
    rest: &'a str,
    valid: &[&[DeviceOption]],
) -> Result<Vec<Pair<'a>>, SpecError> {
    let mut pairs: Vec<Pair<'a>> = Vec::new();
    for part in rest.split(',').map(str::trim).filter(|part| !part.is_empty()) {
        let Some((key, value)) = part.split_once('=') else {
            return Err(SpecError::NotAPair { kind, text: part.to_owned() });
        };
        let (key, value) = (key.trim(), value.trim());
        let mut known = valid.iter().copied().flatten().map(|option| option.key);
        if !known.clone().any(|known| known == key) {
            let valid = known.by_ref().collect::<Vec<_>>().join(", ");
            return Err(SpecError::UnknownKey { kind, key: key.to_owned(), valid });
        }
        if pairs.iter().any(|pair| pair.key == key) {
            return Err(SpecError::Twice { kind, key: key.to_owned() });
        }
        pairs.push(Pair { kind, key, value });
    }
    Ok(pairs)
}

fn file_and_rest<'a>(kind: &'static str, rest: &'a str) -> Result<(PathBuf, &'a str), SpecError> {
    let (file, rest) = rest.split_once(',').unwrap_or((rest, ""));
    let file = file.trim();
    if file.is_empty() { Err(SpecError::MissingFile { kind }) } else { Ok((PathBuf::from(file), rest)) }
}

/// Sets one parameter of a virtual hand.
fn set_figure(config: &mut VirtualHandConfig, pair: &Pair<'_>) -> Result<(), SpecError> {
    let start = &mut config.start_in_device.translation.vector;
    match pair.key {
        "impedance" => config.impedance = pair.switch()?,
        "mass" => config.device_mass = pair.number()?,
        "damping" => config.device_damping = pair.number()?,
        "friction" => config.friction = pair.number()?,
        "arm_mass" => config.arm.mass = pair.number()?,
        "arm_damping" => config.arm.damping = pair.number()?,
        "arm_stiffness" => config.arm.stiffness = pair.number()?,
        "push_x" => config.push.x = pair.number()?,
        "push_y" => config.push.y = pair.number()?,
        "push_z" => config.push.z = pair.number()?,
        "x" => start.x = pair.number()?,
        "y" => start.y = pair.number()?,
        "z" => start.z = pair.number()?,
        "workspace" => config.workspace = Workspace::centred(pair.size()?),
        "stops" => config.stops = pair.switch()?,
        "stop_stiffness" => config.stop_stiffness = pair.number()?,
        "stop_damping" => config.stop_damping = pair.number()?,
        "orientation_hz" => config.orientation_hz = pair.number()?,
        "finger_lag" => config.fingers.time_constant = pair.number()?,
        "finger_speed" => config.fingers.speed_max = pair.number()?,
        "gripper_max" => config.fingers.angle_max = pair.number()?,
        "quantise" => {
            config.resolution = if pair.switch()? { VirtualHandConfig::OMNI_RESOLUTION } else { 0.0 };
        }
        "velocity_cutoff" => config.velocity_cutoff_hz = pair.number()?,
        "max_force" => config.max_force = pair.number()?,
        "max_torque" => config.max_torque = pair.number()?,
        "outputs" => config.output_dofs = pair.one_of(&[("3", Dofs::Three), ("6", Dofs::Six)], "3 or 6")?,
        _ => return Err(pair.wrong("a key of the virtual hand")),
    }
    Ok(())
}

fn checked(kind: &'static str, config: VirtualHandConfig) -> Result<VirtualHandConfig, SpecError> {
    config.check().map_err(|source| SpecError::Figure { kind, source })?;
    Ok(config)
}

fn parse_virtual(rest: &str) -> Result<DeviceSpec, SpecError> {
    let kind = "virtual";
    let mut config = VirtualHandConfig::default();
    for pair in pairs(kind, rest, &[&HAND_OPTIONS])? {
        set_figure(&mut config, &pair)?;
    }
    Ok(DeviceSpec::Virtual(checked(kind, config)?))
}

/// The virtual hand on which force acts: from `force=` and the virtual hand's keys.
fn force_of(kind: &'static str, pairs: &[Pair<'_>]) -> Result<Option<VirtualHandConfig>, SpecError> {
    let force = match pairs.iter().find(|pair| pair.key == "force") {
        Some(pair) => pair.switch()?,
        None => false,
    };
    let mut config = VirtualHandConfig::default();
    let is_figure = |pair: &&Pair<'_>| HAND_OPTIONS.iter().any(|option| option.key == pair.key);
    for pair in pairs.iter().filter(is_figure) {
        if !force {
            return Err(SpecError::NeedsForce { kind, key: pair.key.to_owned() });
        }
        set_figure(&mut config, pair)?;
    }
    if force { checked(kind, config).map(Some) } else { Ok(None) }
}

fn parse_replay(rest: &str) -> Result<DeviceSpec, SpecError> {
    let kind = "replay";
    let (file, rest) = file_and_rest(kind, rest)?;
    let pairs = pairs(kind, rest, &[&REPLAY_OPTIONS, &HAND_OPTIONS])?;
    let start = match pairs.iter().find(|pair| pair.key == "start") {
        Some(pair) => start(pair)?,
        None => StartTime::default(),
    };
    let unit = match pairs.iter().find(|pair| pair.key == "time") {
        Some(pair) => {
            let units = TimeUnit::ALL.map(|unit| (unit.symbol(), unit));
            Some(pair.one_of(&units, "s, ms, us or ns")?)
        }
        None => None,
    };
    Ok(DeviceSpec::Replay { file, start, unit, force: force_of(kind, &pairs)? })
}

/// Where a recording starts: by its own clock, or by the session's.
fn start(pair: &Pair<'_>) -> Result<StartTime, SpecError> {
    match pair.value {
        "zero" => Ok(StartTime::Zero),
        "file" => Ok(StartTime::File),
        time => match parse_time(time.as_bytes(), None) {
            Ok(time) => Ok(StartTime::At(time.ns)),
            Err(_) => {
                Err(pair.wrong("zero, file, or a time of the file's clock: seconds, a Unix time or a date"))
            }
        },
    }
}

fn parse_jigsaws(rest: &str) -> Result<DeviceSpec, SpecError> {
    let kind = "jigsaws";
    let (file, rest) = file_and_rest(kind, rest)?;
    let pairs = pairs(kind, rest, &[&JIGSAWS_OPTIONS, &HAND_OPTIONS])?;
    let mut selection = JigsawsSelection::default();
    let mut centre = true;
    let mut scale = 1.0;
    let (mut at, mut angles) = (Vector3::zeros(), Vector3::zeros());
    for pair in &pairs {
        const METRES: &str = "a length from -10 to 10 m";
        const RADIANS: &str = "an angle from -7 to 7 rad";
        match pair.key {
            "side" => {
                let sides = [("left", JigsawsSide::Left), ("right", JigsawsSide::Right)];
                selection.side = pair.one_of(&sides, "left or right")?;
            }
            "source" => {
                let sources = [("master", JigsawsSource::Master), ("slave", JigsawsSource::Slave)];
                selection.source = pair.one_of(&sources, "master or slave")?;
            }
            "centre" => centre = pair.switch()?,
            "scale" => scale = pair.number_within(1e-3, 1e3, "a factor from 0.001 to 1000")?,
            "at_x" => at.x = pair.number_within(-10.0, 10.0, METRES)?,
            "at_y" => at.y = pair.number_within(-10.0, 10.0, METRES)?,
            "at_z" => at.z = pair.number_within(-10.0, 10.0, METRES)?,
            "roll" => angles.x = pair.number_within(-7.0, 7.0, RADIANS)?,
            "pitch" => angles.y = pair.number_within(-7.0, 7.0, RADIANS)?,
            "yaw" => angles.z = pair.number_within(-7.0, 7.0, RADIANS)?,
            _ => {}
        }
    }
    let rotation = UnitQuaternion::from_euler_angles(angles.x, angles.y, angles.z);
    let device_from_source = Isometry3::from_parts(at.into(), rotation);
    let registration = Registration { scale, device_from_source, ..Registration::default() };
    Ok(DeviceSpec::Jigsaws { file, selection, centre, registration, force: force_of(kind, &pairs)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        text.parse::<DeviceSpec>().unwrap_err().to_string()
    }

    #[test]
    fn a_virtual_hand_takes_figures() {
        assert_eq!("virtual".parse(), Ok(DeviceSpec::Virtual(VirtualHandConfig::default())));
        let spec: DeviceSpec =
            "virtual:impedance=off, mass=0.05,outputs=6,workspace=0.2x0.1x0.1".parse().unwrap();
        let DeviceSpec::Virtual(config) = &spec else { panic!("{spec:?}") };
        assert!(!config.impedance && config.device_mass == 0.05 && config.output_dofs == Dofs::Six);
        assert_eq!(config.workspace.size(), Vector3::new(0.2, 0.1, 0.1));
        assert_eq!(spec.build().unwrap().capabilities().output_dofs, Dofs::Six);
    }

    #[test]
    fn every_listed_key_is_understood() {
        for DeviceOption { key, .. } in HAND_OPTIONS {
            let value = match key {
                "impedance" | "stops" | "quantise" => "on",
                "workspace" => "0.1x0.1x0.1",
                "outputs" => "3",
                _ => "1",
            };
            assert!(format!("virtual:{key}={value}").parse::<DeviceSpec>().is_ok(), "{key}");
        }
        for DeviceOption { key, .. } in JIGSAWS_OPTIONS {
            let value = match key {
                "force" | "centre" => "off",
                "side" => "right",
                "source" => "slave",
                _ => "1",
            };
            assert!(format!("jigsaws:f,{key}={value}").parse::<DeviceSpec>().is_ok(), "{key}");
        }
        for DeviceOption { key, .. } in REPLAY_OPTIONS {
            let value = if key == "time" {
                "ms"
            } else if key == "start" {
                "file"
            } else {
                "on"
            };
            assert!(format!("replay:f,{key}={value}").parse::<DeviceSpec>().is_ok(), "{key}");
        }
    }

    #[test]
    fn a_replay_takes_a_file_and_figures_where_force_acts() {
        let spec: DeviceSpec = "replay:a b.csv,force=on,arm_stiffness=300,start=zero".parse().unwrap();
        let DeviceSpec::Replay { file, start, force: Some(config), unit: None } = spec else { panic!() };
        assert_eq!((file, start), (PathBuf::from("a b.csv"), StartTime::Zero));
        assert_eq!(config.arm.stiffness, 300.0);
        assert_eq!(error("replay:f,mass=1"), "key \"mass\" of device \"replay\" needs force=on");
    }

    #[test]
    fn a_replay_starts_with_its_first_row_or_at_a_time_of_its_clock() {
        let start = |text: &str| match text.parse() {
            Ok(DeviceSpec::Replay { start, .. }) => start,
            other => panic!("{other:?}"),
        };
        assert_eq!(start("replay:f.csv"), StartTime::Zero);
        assert_eq!(start("replay:f.csv,start=file"), StartTime::File);
        for time in ["1700000000.5", "1700000000500", "2023-11-14T22:13:20.5Z"] {
            assert_eq!(
                start(&format!("replay:f.csv,start={time}")),
                StartTime::At(1_700_000_000_500_000_000)
            );
        }
        assert_eq!(start("replay:f.csv,start=2.5"), StartTime::At(2_500_000_000));
        let text = "replay:f.csv,time=us".parse();
        assert!(
            matches!(text, Ok(DeviceSpec::Replay { unit: Some(TimeUnit::Microseconds), .. })),
            "{text:?}"
        );
        assert!(error("replay:f,start=soon").contains("valid is zero, file, or a time of the file's clock"));
        assert!(error("replay:f,time=min").contains("valid is s, ms, us or ns"));
    }

    #[test]
    fn messages_name_the_valid_choices() {
        assert_eq!(error("omni:7"), "unknown device \"omni\"; valid are virtual, replay:FILE, jigsaws:FILE");
        assert!(error("virtual:maas=1").contains("valid are impedance, mass, damping"));
        assert_eq!(error("replay:"), "device \"replay\" needs a file: replay:FILE");
        assert_eq!(error("virtual:mass"), "\"mass\" of device \"virtual\" is not of the form key=value");
        assert_eq!(error("virtual:mass=1,mass=2"), "key \"mass\" of device \"virtual\" is given twice");
        assert!(error("virtual:impedance=maybe").contains("valid is on or off"));
        assert!(error("virtual:mass=1e9").contains("out of range (0.01 to 10 kg)"));
        assert!(error("virtual:mass=nan").contains("a finite number"));
        assert!(error("virtual:workspace=1x2").contains("WIDTHxHEIGHTxDEPTH"));
        assert!(error("jigsaws:f,scale=0").contains("a factor from 0.001 to 1000"));
    }

    #[test]
    fn a_missing_file_is_named_when_the_device_is_built() {
        let spec: DeviceSpec = "replay:no-such-file.csv".parse().unwrap();
        assert!(spec.build().err().unwrap().to_string().contains("no-such-file.csv: "));
    }
}
