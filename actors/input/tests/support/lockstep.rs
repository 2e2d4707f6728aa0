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
    BuildContext, Commands, Controller, Entity, EntityAllocator, Events, Jobs, Registry, RegistryBuilder,
    SimTime, Snapshot, Store, TaskState, Tick, WriterRules,
};
use trocar_tasks::PegTransferController;
use trocar_tasks::peg_transfer_controller::{PegTransferConfig, mirrored_start};

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
    pub store: Store,
    pub millis: u64,
    drivers: Vec<Driver>,
    writers: Vec<Writer>,
    trainee: Entity,
    referee: Entity,
}

const SEED_FREE: u32 = 1;

pub fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).unwrap();
    trocar_tasks::register(&mut builder).unwrap();
    trocar_input::register(&mut builder).unwrap();
    builder.build()
}

impl Session {
    /// The scenario in the repository, with changes to it.
    pub fn new(trainee: &AutopilotConfig, seed: u64, change: impl FnOnce(&mut Store)) -> Self {
        let registry = registry();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/peg-transfer.toml");
        let scenario = Scenario::load(&file, &registry).unwrap();
        let mut store = scenario.spawn(&registry).unwrap();
        if trainee.left_handed {
            let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
            for (ring, pose) in mirrored_start(&store.snapshot()) {
                commands.put(ring, pose);
            }
            commands.seal();
            store.apply(&mut commands, SimTime::ZERO);
        }
        change(&mut store);
        let mut session = Self {
            store,
            millis: 0,
            drivers: Vec::new(),
            writers: Vec::new(),
            trainee: Entity::of_writer(0, 5),
            referee: Entity::of_writer(0, 4),
        };
        for (index, name) in ["hand.left", "hand.right"].into_iter().enumerate() {
            let hand = scenario.entity(name).unwrap();
            let device = VirtualHand::new(VirtualHandConfig::default()).unwrap();
            let (end, slot, _monitor) = link();
            let core = DriverCore::new(DriverConfig::default(), &device, end, DeviceFaults::default());
            let capabilities = device.capabilities().clone();
            session.drivers.push(Driver { core, device });
            session.add(
                1 + index as u16,
                1,
                |context| {
                    let link = slot.take(1).unwrap();
                    let config = HapticsConfig::default();
                    Box::new(HapticsController::new(context, hand, link, capabilities, config).unwrap())
                },
                seed,
            );
        }
        let settings = EngineSettings::default();
        session.add(3, 2, |context| Box::new(EngineController::new(context, settings).unwrap()), seed);
        let task: PegTransferConfig =
            PegTransferConfig { left_handed: trainee.left_handed, ..Default::default() };
        session.add(4, 10, |context| Box::new(PegTransferController::new(&task, context).unwrap()), seed);
        session.add(5, 10, |context| Box::new(AutopilotController::new(trainee, context).unwrap()), seed);
        session
    }

    fn add(
        &mut self,
        spawner: u16,
        period_ms: u64,
        build: impl FnOnce(&BuildContext<'_>) -> Box<dyn Controller>,
        seed: u64,
    ) {
        let scene = self.store.snapshot();
        let me = Entity::of_writer(0, spawner);
        let context =
            BuildContext { scene: &scene, time: SimTime::ZERO, name: "lockstep", me, epoch: SEED_FREE, seed };
        let controller = build(&context);
        let registry = scene.registry().clone();
        let rules = WriterRules::compile(&controller.access(), &registry, me).unwrap();
        let commands = Commands::new(registry, EntityAllocator::new(0, spawner));
        self.writers.push(Writer { controller, commands, rules, period_ms, ticks: 0, cursor: 0 });
    }

    /// One millisecond.
    pub fn step(&mut self) {
        self.millis += 1;
        let time = SimTime::from_millis(self.millis);
        for driver in &mut self.drivers {
            driver.core.step(time.as_nanos(), &mut driver.device);
        }
        let jobs = Jobs::default();
        for writer in self.writers.iter_mut().filter(|writer| self.millis % writer.period_ms == 0) {
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

    pub fn scene(&self) -> &Snapshot {
        self.store.view()
    }
    pub fn secs(&self) -> f64 {
        self.millis as f64 * 1e-3
    }
    pub fn task(&self) -> TaskState {
        self.scene().get::<TaskState>(self.referee).cloned().unwrap_or_default()
    }
    pub fn trainee(&self) -> Option<&AutopilotState> {
        self.scene().get::<AutopilotState>(self.trainee)
    }
    /// Runs until the exercise ends or `limit` \[s\]; `look` sees every 10 ms.
    pub fn run(&mut self, limit: f64, mut look: impl FnMut(&Self)) -> TaskState {
        while self.secs() < limit {
            self.step();
            if self.millis % 10 == 0 {
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
