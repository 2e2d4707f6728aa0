//! The shipped exercise on the real physics in virtual time: virtual hands and haptics at 1 kHz, Rapier at
//! 500 Hz, referee and trainee at 100 Hz, one thread, fixed order.

use std::path::Path;
use std::sync::Arc;

use trocar_devices::{
    DeviceFaults, DriverConfig, DriverCore, HapticDevice, VirtualHand, VirtualHandConfig, link,
};
use trocar_engine::{EngineController, EngineSettings};
use trocar_haptics::{HapticsConfig, HapticsController};
use trocar_input::autopilot_controller::AutopilotState;
use trocar_input::{AutopilotConfig, AutopilotController};
use trocar_scene::scenario::Scenario;
use trocar_scene::{
    BuildContext, Commands, Controller, Entity, EntityAllocator, Events, Instrument, Jobs, Registry,
    RegistryBuilder, SimTime, Snapshot, Store, TaskState, Tick, WriterRules,
};
use trocar_tasks::peg_transfer_controller::mirrored_start;
use trocar_tasks::{PegTransferConfig, PegTransferController};

/// Spawners of the five writers, in the order in which they tick.
const HAPTICS: u16 = 1;
const ENGINE: u16 = 3;
const REFEREE: u16 = 4;
const TRAINEE: u16 = 5;

/// A controller with its buffers.
struct Writer {
    controller: Box<dyn Controller>,
    commands: Commands,
    rules: WriterRules,
    period_ms: u64,
    ticks: u64,
    cursor: u64,
}

/// A device in the hand of the trainee.
struct Driver {
    core: DriverCore,
    device: VirtualHand,
}

/// The whole session.
pub struct Session {
    store: Store,
    millis: u64,
    seed: u64,
    trainee: AutopilotConfig,
    drivers: Vec<Driver>,
    writers: Vec<Writer>,
}

fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).unwrap();
    trocar_tasks::register(&mut builder).unwrap();
    trocar_input::register(&mut builder).unwrap();
    builder.build()
}

impl Session {
    /// The repository's scenario with both instruments changed by `change`.
    pub fn new(trainee: &AutopilotConfig, seed: u64, change: impl Fn(&mut Instrument)) -> Self {
        let registry = registry();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/peg-transfer.toml");
        let scenario = Scenario::load(&file, &registry).unwrap();
        let mut store = scenario.spawn(&registry).unwrap();
        let scene = store.snapshot();
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        for (entity, instrument) in scene.iter::<Instrument>() {
            let mut instrument = instrument.clone();
            change(&mut instrument);
            commands.put(entity, instrument);
        }
        if trainee.left_handed {
            mirrored_start(&scene).into_iter().for_each(|(ring, pose)| commands.put(ring, pose));
        }
        commands.seal();
        store.apply(&mut commands, SimTime::ZERO);

        let hands = ["hand.left", "hand.right"].map(|name| scenario.entity(name).unwrap());
        let mut session = Self {
            store,
            millis: 0,
            seed,
            trainee: trainee.clone(),
            drivers: Vec::new(),
            writers: Vec::new(),
        };
        for (index, hand) in hands.into_iter().enumerate() {
            let device = VirtualHand::new(VirtualHandConfig::default()).unwrap();
            let (end, slot, _monitor) = link();
            let core = DriverCore::new(DriverConfig::default(), &device, end, DeviceFaults::default());
            let capabilities = device.capabilities().clone();
            session.drivers.push(Driver { core, device });
            session.add(HAPTICS + index as u16, 1, |context| {
                let (link, config) = (slot.take(1).unwrap(), HapticsConfig::default());
                Box::new(HapticsController::new(context, hand, link, capabilities, config).unwrap())
            });
        }
        session.add(ENGINE, 2, |context| {
            Box::new(EngineController::new(context, EngineSettings::default()).unwrap())
        });
        session.add_referee();
        session.add_trainee();
        session
    }

    fn add_referee(&mut self) {
        let config = PegTransferConfig { left_handed: self.trainee.left_handed, ..Default::default() };
        self.add(REFEREE, 10, |context| Box::new(PegTransferController::new(&config, context).unwrap()));
    }

    fn add_trainee(&mut self) {
        let config = self.trainee.clone();
        self.add(TRAINEE, 10, |context| Box::new(AutopilotController::new(&config, context).unwrap()));
    }

    /// Forgets referee and trainee, and builds both anew from the scene.
    pub fn restart_referee_and_trainee(&mut self) {
        self.writers.truncate(3);
        self.add_referee();
        self.add_trainee();
    }

    fn add(
        &mut self,
        spawner: u16,
        period_ms: u64,
        build: impl FnOnce(&BuildContext<'_>) -> Box<dyn Controller>,
    ) {
        let scene = self.store.snapshot();
        let me = Entity::of_writer(0, spawner);
        let (time, period) = (SimTime::from_millis(self.millis), SimTime::from_millis(period_ms));
        let seed = self.seed;
        let context = BuildContext { scene: &scene, time, period, name: "lockstep", me, epoch: 1, seed };
        let controller = build(&context);
        let registry = scene.registry().clone();
        let rules = WriterRules::compile(&controller.access(), &registry, me).unwrap();
        let commands = Commands::new(registry, EntityAllocator::new(0, spawner));
        let ticks = self.millis / period_ms;
        self.writers.push(Writer { controller, commands, rules, period_ms, ticks, cursor: 0 });
    }

    /// One millisecond.
    pub fn step(&mut self) {
        self.millis += 1;
        let time = SimTime::from_millis(self.millis);
        for driver in &mut self.drivers {
            driver.core.step(time.as_nanos(), &mut driver.device);
        }
        let jobs = Jobs::default();
        for writer in self.writers.iter_mut().filter(|writer| self.millis.is_multiple_of(writer.period_ms)) {
            let scene = self.store.snapshot();
            writer.ticks += 1;
            let tick = Tick {
                time,
                period: SimTime::from_millis(writer.period_ms),
                number: writer.ticks,
                me: writer.rules.me(),
                epoch: 1,
                events: Events::new(scene.events(), writer.cursor),
                jobs: &jobs,
            };
            writer.commands.begin(time);
            writer.controller.tick(&tick, &scene, &mut writer.commands).unwrap();
            writer.cursor = scene.events().next();
            drop(scene);
            writer.commands.seal();
            self.store.validate(&writer.commands, &writer.rules).unwrap();
            self.store.apply(&mut writer.commands, time);
            writer.commands.clear();
        }
    }

    /// The scene as it is.
    pub fn scene(&self) -> &Snapshot {
        self.store.view()
    }
    /// Simulated time \[s\].
    pub fn secs(&self) -> f64 {
        self.millis as f64 * 1e-3
    }
    /// What the referee says.
    pub fn task(&self) -> TaskState {
        self.scene().get::<TaskState>(Entity::of_writer(0, REFEREE)).cloned().unwrap_or_default()
    }
    /// Where trainee, rings and tips are, in one line.
    pub fn describe(&self) -> String {
        let scene = self.scene();
        let Some(state) = scene.get::<AutopilotState>(Entity::of_writer(0, TRAINEE)) else {
            return "no trainee yet".into();
        };
        let steps = state.autopilot.steps().map(|step| step.name());
        let tips = ["grasper.left", "grasper.right"].map(|name| {
            let entity = scene.find(name).unwrap();
            let tip = scene.world_pose(entity).translation.vector * 1e3;
            let held = scene.get::<trocar_scene::Grasp>(entity).map(|grasp| scene.name(grasp.held));
            format!("({:.1} {:.1} {:.1}) mm {}", tip.x, tip.y, tip.z, held.unwrap_or_default())
        });
        format!("{:.2} s {steps:?} {:?} {tips:?}", self.secs(), state.autopilot.rings())
    }

    /// Runs until the exercise ends or `limit` \[s\]; `look` sees every 10 ms.
    pub fn run(&mut self, limit: f64, mut look: impl FnMut(&mut Self)) -> TaskState {
        while self.secs() < limit {
            self.step();
            if self.millis.is_multiple_of(10) {
                look(self);
                let task = self.task();
                if task.phase == "finished" || task.phase == "cut_off" {
                    break;
                }
            }
        }
        self.task()
    }
}
