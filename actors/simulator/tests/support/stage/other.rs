//! Additional controllers on a stage, each at its own rate.

use trocar_scene::{
    BuildContext, Commands, Controller, ControllerError, Entity, EntityAllocator, Events, JobOutput, Jobs,
    SimTime, Tick, WriterRules,
};

use super::Stage;

/// Another controller on the stage.
pub struct Other {
    controller: Box<dyn Controller>,
    pub me: Entity,
    rules: WriterRules,
    commands: Commands,
    ticks: u64,
    /// Outputs of jobs, for the next tick.
    finished: Vec<(u64, JobOutput)>,
    /// Time of its last tick.
    last: SimTime,
    /// Ticks of the first controller per tick of this one.
    pub every: u32,
}

/// The first controller's ticks count as 1 ms.
fn period(every: u32) -> SimTime {
    SimTime(1_000_000 * u64::from(every))
}

impl Other {
    pub fn new<C: Controller, D: Controller>(
        stage: &Stage<C>,
        number: u16,
        every: u32,
        build: impl FnOnce(&BuildContext<'_>) -> Result<D, ControllerError>,
    ) -> Self {
        let me = Entity::of_writer(0, number);
        let context = BuildContext {
            scene: stage.store.view(),
            time: stage.now(),
            period: period(every),
            name: "other",
            me,
            epoch: 1,
            seed: 1,
        };
        let controller = build(&context).unwrap_or_else(|error| panic!("{error}"));
        let registry = stage.store.view().registry().clone();
        let rules = WriterRules::compile(&controller.access(), &registry, me).expect("its access");
        let commands = Commands::new(registry, EntityAllocator::new(0, number));
        Self {
            controller: Box::new(controller),
            me,
            rules,
            commands,
            ticks: 0,
            finished: Vec::new(),
            last: stage.now(),
            every,
        }
    }

    /// Restarts it, from the scene alone, without time passing.
    pub fn rebuild<C: Controller, D: Controller>(
        &mut self,
        stage: &Stage<C>,
        build: impl FnOnce(&BuildContext<'_>) -> Result<D, ControllerError>,
    ) {
        let scene = stage.store.view();
        let (time, period) = (self.last, period(self.every));
        let context = BuildContext { scene, time, period, name: "other", me: self.me, epoch: 2, seed: 1 };
        self.controller = Box::new(build(&context).unwrap_or_else(|error| panic!("{error}")));
    }

    pub fn tick<C: Controller>(&mut self, stage: &mut Stage<C>) {
        self.ticks += 1;
        self.last = stage.now();
        let scene = stage.store.snapshot();
        let jobs = Jobs::default();
        self.finished.drain(..).for_each(|(key, output)| jobs.deliver(key, output));
        let tick = Tick {
            time: stage.now(),
            period: period(self.every),
            number: self.ticks,
            me: self.me,
            epoch: 1,
            events: Events::new(scene.events(), 0),
            jobs: &jobs,
        };
        self.controller.tick(&tick, &scene, &mut self.commands).expect("a look");
        while let Some(job) = jobs.next_submitted() {
            self.finished.push((job.key, (job.work)()));
        }
        self.commands.seal();
        stage.store.validate(&self.commands, &self.rules).expect("what it declared");
        let now = stage.now();
        stage.store.apply(&mut self.commands, now);
        self.commands.clear();
    }
}
