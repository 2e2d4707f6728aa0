//! A scene with one controller on it, ticked by the test.
#![allow(dead_code)] // every test uses another part

pub mod other;

use std::sync::Arc;

use trocar_scene::{
    BuildContext, Commands, Component, Controller, Entity, EntityAllocator, Events, JobOutput, Jobs,
    Registry, RegistryBuilder, Scenario, SimTime, Store, Tick, WriterRules,
};

/// The controller's number.
const ME: u16 = 7;

/// A scene from a scenario's text, and the controller on it.
pub struct Stage<C> {
    pub store: Store,
    pub controller: C,
    rules: WriterRules,
    commands: Commands,
    others: Commands,
    period: SimTime,
    pub ticks: u64,
    /// Outputs of jobs, for the next tick.
    finished: Vec<(u64, JobOutput)>,
}

fn registry(more: impl FnOnce(&mut RegistryBuilder)) -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).expect("names are free");
    trocar_simulator::controller::register(&mut builder).expect("names are free");
    more(&mut builder);
    builder.build()
}

/// The scene of entities that a scenario's text describes.
pub fn scene(entities: &str) -> Store {
    scene_with(entities, |_| {})
}

/// The same with components of other crates.
pub fn scene_with(entities: &str, more: impl FnOnce(&mut RegistryBuilder)) -> Store {
    let registry = registry(more);
    let text = format!("schema = 1\nname = \"stage\"\n{entities}");
    let scenario = Scenario::parse("stage.toml".as_ref(), &text, &registry).unwrap_or_else(|e| panic!("{e}"));
    scenario.spawn(&registry).expect("a valid scene")
}

impl<C: Controller> Stage<C> {
    /// Builds the controller on a scene.
    pub fn new(
        store: Store,
        hz: f64,
        build: impl FnOnce(&BuildContext<'_>) -> Result<C, trocar_scene::ControllerError>,
    ) -> Self {
        let registry = store.view().registry().clone();
        let period = SimTime::from_secs_f64(1.0 / hz);
        let controller = build(&BuildContext { period, ..context(&store, SimTime::ZERO, 1) })
            .unwrap_or_else(|error| panic!("{error}"));
        let rules = WriterRules::compile(&controller.access(), &registry, Entity::of_writer(0, ME))
            .expect("its access is right");
        let commands = Commands::new(registry.clone(), EntityAllocator::new(0, ME));
        let others = Commands::new(registry, EntityAllocator::new(0, 0));
        Self { store, controller, rules, commands, others, period, ticks: 0, finished: Vec::new() }
    }

    pub fn now(&self) -> SimTime {
        SimTime(self.ticks * self.period.0)
    }

    /// Writes a component in another actor's name.
    pub fn put<T: Component>(&mut self, name: &str, value: T) {
        let entity = self.entity(name);
        self.others.put(entity, value);
        self.others.seal();
        assert_eq!(self.others.error(), None);
        let now = self.now();
        self.store.apply(&mut self.others, now);
        self.others.clear();
    }

    pub fn tick(&mut self) {
        self.ticks += 1;
        let scene = self.store.snapshot();
        let jobs = Jobs::default();
        self.finished.drain(..).for_each(|(key, output)| jobs.deliver(key, output));
        let tick = Tick {
            time: self.now(),
            period: self.period,
            number: self.ticks,
            me: Entity::of_writer(0, ME),
            epoch: 1,
            events: Events::new(scene.events(), 0),
            jobs: &jobs,
        };
        self.controller.tick(&tick, &scene, &mut self.commands).expect("a step");
        while let Some(job) = jobs.next_submitted() {
            self.finished.push((job.key, (job.work)()));
        }
        self.commands.seal();
        self.store.validate(&self.commands, &self.rules).expect("what it declared");
        let now = self.now();
        self.store.apply(&mut self.commands, now);
        self.commands.clear();
    }

    /// Restarts the controller, from the scene alone.
    pub fn rebuild(
        &mut self,
        build: impl FnOnce(&BuildContext<'_>) -> Result<C, trocar_scene::ControllerError>,
    ) {
        self.controller = build(&BuildContext { period: self.period, ..context(&self.store, self.now(), 2) })
            .unwrap_or_else(|error| panic!("{error}"));
    }

    pub fn entity(&self, name: &str) -> Entity {
        self.store.view().find(name).unwrap_or_else(|| panic!("'{name}' is in the scene"))
    }

    pub fn get<T: Component>(&self, name: &str) -> T {
        let entity = self.entity(name);
        self.store.view().get::<T>(entity).cloned().unwrap_or_else(|| panic!("'{name}' has no {}", T::NAME))
    }

    pub fn has<T: Component>(&self, name: &str) -> bool {
        self.store.view().get::<T>(self.entity(name)).is_some()
    }

    /// The controller's last measure of this name.
    pub fn measured(&self, what: &str) -> f64 {
        let me = Entity::of_writer(0, ME);
        let all = self.store.view().get::<trocar_scene::Measured>(me).expect("it measures");
        *all.values.get(what).unwrap_or_else(|| panic!("no '{what}': {:?}", all.values.keys()))
    }
}

/// The build context of a controller of 1,000 Hz, for a scene without a stage.
pub fn context(store: &Store, time: SimTime, epoch: u32) -> BuildContext<'_> {
    BuildContext {
        scene: store.view(),
        time,
        period: SimTime::from_millis(1),
        name: "controller",
        me: Entity::of_writer(0, ME),
        epoch,
        seed: 1,
    }
}
