//! Kinds of devices by the texts that scenarios and `--hand NAME=SPEC` use: built-in ones, and those that a program
//! adds.

use std::fmt;
use std::path::Path;
use std::str::FromStr;
use std::sync::Arc;

use trocar_devices::spec_options::{DeviceOption, options};
use trocar_devices::{DeviceSpec, HapticDevice, ReplayHand, SpecError};
use trocar_scene::Entity;

use crate::app::{App, SetupError};
use crate::error::AssemblyError;
use crate::recorded_hand;

/// Built-in devices: the text that selects one, and a description.
pub const STANDARD_DEVICES: [(&str, &str); 4] = [
    ("virtual", "a virtual hand: the inertia and limits of a Phantom Omni, and a human arm"),
    ("replay:FILE", "hand motion from CSV: t,x,y,z,qw,qx,qy,qz,gripper; times of any clock"),
    ("jigsaws:FILE", "hand motion from JIGSAWS kinematics"),
    ("recording:FILE", "the same hand as in a recording of this program"),
];

type Make = Arc<dyn Fn(&str) -> Result<Box<dyn HapticDevice>, String> + Send + Sync>;

/// A kind of device that a program has added.
#[derive(Clone)]
pub(crate) struct DeviceKind {
    usage: String,
    about: String,
    make: Make,
}

/// The part before the colon.
fn kind_of(text: &str) -> &str {
    text.split_once(':').map_or(text, |(kind, _)| kind).trim()
}

impl App {
    /// Adds a kind of device, for `--hand right=KIND:TEXT` and for `device = "KIND:TEXT"` in a scenario.
    ///
    /// `usage` is the form for users, such as `stylus:HOST:PORT`; the part before the colon is the kind's name. `about`
    /// describes it in a line. The text after the colon (empty without one) is parsed as `D`. Parsing opens nothing:
    /// the driver calls [`HapticDevice::open`] repeatedly until the device is there.
    #[must_use]
    pub fn device<D>(self, usage: &str, about: &str) -> Self
    where
        D: HapticDevice + FromStr + 'static,
        D::Err: fmt::Display,
    {
        self.device_with(usage, about, |text| text.parse::<D>())
    }

    /// Like [`App::device`], for a device that a function makes from the text.
    #[must_use]
    pub fn device_with<D, E>(
        mut self,
        usage: &str,
        about: &str,
        make: impl Fn(&str) -> Result<D, E> + Send + Sync + 'static,
    ) -> Self
    where
        D: HapticDevice + 'static,
        E: fmt::Display,
    {
        let kind = kind_of(usage).to_owned();
        let letters = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
        if kind.is_empty() || !kind.chars().all(letters) {
            self.wrong.get_or_insert(SetupError::DeviceName(kind));
            return self;
        }
        let standard = STANDARD_DEVICES.iter().any(|(usage, _)| kind_of(usage) == kind);
        if standard || self.devices.contains_key(&kind) {
            self.wrong.get_or_insert(SetupError::DeviceTaken(kind));
            return self;
        }
        let make: Make = Arc::new(move |text| match make(text) {
            Ok(device) => Ok(Box::new(device)),
            Err(error) => Err(error.to_string()),
        });
        self.devices.insert(kind, DeviceKind { usage: usage.to_owned(), about: about.to_owned(), make });
        self
    }

    /// Every kind of device: its usage and description.
    pub fn devices(&self) -> impl Iterator<Item = (&str, &str)> {
        let own = self.devices.values().map(|kind| (kind.usage.as_str(), kind.about.as_str()));
        STANDARD_DEVICES.into_iter().chain(own)
    }

    /// The `key=value` options of a kind of device, given by its usage.
    pub fn device_options(&self, usage: &str) -> &'static [DeviceOption] {
        options(kind_of(usage))
    }

    /// Makes the device of a hand from its text.
    pub(crate) fn make_device(
        &self,
        hand: &str,
        entity: Entity,
        text: &str,
    ) -> Result<Box<dyn HapticDevice>, AssemblyError> {
        let hand = || hand.to_owned();
        if let Some(file) = text.strip_prefix("recording:") {
            let (points, capabilities) = recorded_hand::read(self.registry(), Path::new(file), entity)
                .map_err(|source| AssemblyError::Recording { hand: hand(), source })?;
            let replay = ReplayHand::from_recording(points)
                .map_err(|error| AssemblyError::Recording { hand: hand(), source: error.into() })?;
            return Ok(Box::new(replay.with_capabilities(capabilities)));
        }
        let kind = kind_of(text);
        if let Some(own) = self.devices.get(kind) {
            let rest = text.split_once(':').map_or("", |(_, rest)| rest);
            return (own.make)(rest).map_err(|reason| AssemblyError::OwnDevice {
                hand: hand(),
                usage: own.usage.clone(),
                reason,
            });
        }
        let spec: DeviceSpec = text.parse().map_err(|source| match source {
            SpecError::UnknownKind { kind } => AssemblyError::UnknownDevice {
                hand: hand(),
                kind,
                known: self.devices().map(|(usage, _)| usage).collect::<Vec<_>>().join(", "),
            },
            source => AssemblyError::Spec { hand: hand(), source },
        })?;
        spec.build().map_err(|source| AssemblyError::Device { hand: hand(), source })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::{RunOptions, start};
    use trocar_devices::{VirtualHand, VirtualHandConfig};

    /// A virtual hand of the mass that the text gives.
    fn light_hand(text: &str) -> Result<VirtualHand, String> {
        let device_mass = text.parse().map_err(|_| format!("'{text}' is no mass; valid: kilograms"))?;
        let config = VirtualHandConfig { device_mass, ..VirtualHandConfig::default() };
        VirtualHand::new(config).map_err(|error| error.to_string())
    }

    fn app() -> App {
        App::new().device_with("light:KILOGRAMS", "a virtual hand of any mass", light_hand)
    }

    fn started(app: &App, device: &str) -> Result<f64, String> {
        let scenario = app.scenario("wall").expect("a scenario");
        let hands = vec![("right".to_owned(), device.to_owned())];
        let options = RunOptions { lockstep: true, hands, ..RunOptions::default() };
        let session = start(app, &scenario, &options).map_err(|error| error.to_string())?;
        Ok(session.hands()[0].capabilities.apparent_mass)
    }

    #[test]
    fn a_device_of_ones_own_is_known_by_its_name() {
        assert_eq!(started(&app(), "light:0.02"), Ok(0.02));
        assert!(app().devices().any(|(usage, _)| usage == "light:KILOGRAMS"));
        assert!(app().device_options("light:KILOGRAMS").is_empty());
        let keys = App::new().device_options("replay:FILE").iter().map(|option| option.key);
        assert!(keys.eq(["force", "start", "time"]));
    }

    #[test]
    fn what_cannot_be_a_device_is_said_with_what_can() {
        let error = started(&app(), "light:heavy").expect_err("refused");
        assert!(error.contains("hand right") && error.contains("light:KILOGRAMS"), "{error}");
        assert!(error.contains("valid: kilograms"), "{error}");
        let error = started(&app(), "lihgt:0.02").expect_err("refused");
        let all = "virtual, replay:FILE, jigsaws:FILE, recording:FILE, itp:PORT, light:KILOGRAMS";
        assert!(error.contains("'lihgt'") && error.contains(all), "{error}");
    }

    #[test]
    fn names_of_devices_are_plain_and_each_is_given_once() {
        let wrong = |app: App| app.scenario("wall").unwrap_err().to_string();
        assert!(wrong(app().device_with("light", "", light_hand)).contains("'light' exists already"));
        assert!(wrong(app().device_with("virtual:X", "", light_hand)).contains("'virtual' exists already"));
        assert!(wrong(app().device_with("my hand:X", "", light_hand)).contains("'my hand'"));
    }
}
