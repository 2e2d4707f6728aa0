//! A zombie: a haptics controller that hangs in its step, is fenced and replaced, then wakes up and repeatedly commands
//! 100 N through its old link.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use nalgebra::Vector3;
use trocar::app::{App, Blueprint, KindContext};
use trocar::hands::HandPort;
use trocar_devices::{DeviceCommand, DeviceLink, Wrench};
use trocar_kernel::spec::Peer;
use trocar_scene::scenario::Scenario;
use trocar_scene::{Access, Commands, Controller, ControllerError, SimTime, Snapshot, Tick};

use crate::failure::Failure;

/// The controller that it replaces.
pub const VICTIM: &str = "haptics.left";
/// Its force while it works \[N\].
pub const GENTLE: f64 = 0.5;
/// Its force as a zombie \[N\].
const BRUTAL: f64 = 100.0;
/// Number of commands as a zombie.
pub const WRITES: u64 = 300;
/// A step that is this late counts as hung.
const LATE: SimTime = SimTime::from_millis(40);
/// Period of a zombie on its own thread.
const PERIOD: SimTime = SimTime::from_millis(1);

/// State of a zombie after its instance was replaced.
#[derive(Default)]
pub struct ZombieState {
    /// The old link, handed from the hung step to a [`ZombiePeer`] in virtual time.
    link: Mutex<Option<DeviceLink>>,
    written: AtomicU64,
}

impl ZombieState {
    /// Number of times that 100 N were commanded.
    pub fn written(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }
    fn link(&self) -> MutexGuard<'_, Option<DeviceLink>> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }
    fn command(&self, link: &mut DeviceLink, now_ns: u64) {
        link.command(command(link.epoch(), now_ns, BRUTAL));
        self.written.fetch_add(1, Ordering::Relaxed);
    }
}

fn command(epoch: u32, time_ns: u64, force: f64) -> DeviceCommand {
    let wrench = Wrench::from_force(Vector3::new(force, 0.0, 0.0));
    DeviceCommand { epoch, time_ns, wrench, passivity: false, intent: None }
}

/// Which instances of the controller become zombies, and where they continue.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum ZombieBehaviour {
    /// The first instance only; in virtual time a [`ZombiePeer`] continues with its link.
    Once,
    /// Every instance, each on the thread that it hung on.
    Always,
}

/// The application with such a controller for the left hand, and the exercise that uses it.
pub fn app_with_zombie(
    behaviour: ZombieBehaviour,
    zombie_state: &Arc<ZombieState>,
) -> Result<(App, Scenario), Failure> {
    let haptics = App::new().kind_of("haptics").cloned();
    let haptics = haptics.ok_or_else(|| Failure::internal("there is no kind 'haptics'"))?;
    let zombie_state = zombie_state.clone();
    let kind = move |context: &KindContext<'_>| {
        let mut blueprint: Blueprint = haptics(context)?;
        let port = context.hands.iter().find(|hand| hand.controller() == context.entry.name);
        if let Some(port) = port.cloned() {
            let (well, zombie_state) = (blueprint.factory.clone(), zombie_state.clone());
            blueprint.factory = Arc::new(move |build| {
                if behaviour == ZombieBehaviour::Once && build.epoch > 1 {
                    return well(build);
                }
                let link = port.slot.take(build.epoch);
                let link = link.map_err(|error| ControllerError::Device(error.to_string()))?;
                let zombie = Zombie {
                    link: Some(link),
                    port: port.clone(),
                    behaviour,
                    zombie_state: zombie_state.clone(),
                };
                Ok(Box::new(zombie) as Box<dyn Controller>)
            });
        }
        Ok(blueprint)
    };
    let app = App::new().kind("zombie", Arc::new(kind));
    let mut scenario = app.scenario(super::lockstep::SCENARIO)?;
    for entry in scenario.controllers.iter_mut().filter(|entry| entry.name == VICTIM) {
        "zombie".clone_into(&mut entry.kind);
    }
    Ok((app, scenario))
}

struct Zombie {
    link: Option<DeviceLink>,
    port: HandPort,
    behaviour: ZombieBehaviour,
    zombie_state: Arc<ZombieState>,
}

impl Controller for Zombie {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        let Some(link) = &mut self.link else { return Ok(()) };
        if scene.time().since(tick.time) < LATE {
            link.command(command(link.epoch(), tick.time.as_nanos(), GENTLE));
            return Ok(());
        }
        match self.behaviour {
            // Virtual time cannot wait.
            ZombieBehaviour::Once => *self.zombie_state.link() = self.link.take(),
            ZombieBehaviour::Always => {
                for _ in 0..WRITES {
                    let now_ns = self.port.monitor.sample().published_at_ns;
                    self.zombie_state.command(link, now_ns);
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
        }
        Ok(())
    }
}

/// The zombie in virtual time.
pub struct ZombiePeer {
    zombie_state: Arc<ZombieState>,
    /// Whether it commands a force; otherwise it wakes up and does nothing.
    loud: bool,
}

impl ZombiePeer {
    pub fn new(zombie_state: &Arc<ZombieState>, loud: bool) -> Self {
        Self { zombie_state: zombie_state.clone(), loud }
    }
}

impl Peer for ZombiePeer {
    fn name(&self) -> &'static str {
        "haunter"
    }
    fn period_ns(&self) -> u64 {
        PERIOD.as_nanos()
    }
    fn step(&mut self, now: SimTime) {
        let mut link = self.zombie_state.link();
        if let Some(link) = link.as_mut().filter(|_| self.loud && self.zombie_state.written() < WRITES) {
            self.zombie_state.command(link, now.as_nanos());
        }
    }
}
