//! A new behaviour: breathing, which lifts and lowers the organs under the diaphragm.
//!
//! A behaviour is a [`Controller`]: one function from a tick and a snapshot of the scene to commands. Nobody calls
//! it but the framework, at the rate that the scenario gives it, and it shares nothing with anybody: what others
//! shall know of it, it writes into the scene.

mod components;
mod plan;

pub use components::{Breathes, Respiration};
use trocar::prelude::*;

/// What the scenario may set under `params`. What it does not mention keeps its default, and a slip of the pen
/// (`breaths_per_minte`) is an error that names the line.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BreathingParams {
    /// Breaths per minute.
    pub breaths_per_minute: f64,
    /// How far a breath of depth 1 lifts an organ of share 1 \[m\].
    pub excursion: f64,
    /// By how much the depth of one breath differs from the next, at most: 0.2 is a fifth.
    pub variation: f64,
}

impl Default for BreathingParams {
    fn default() -> Self {
        Self { breaths_per_minute: 12.0, excursion: 0.012, variation: 0.2 }
    }
}

/// The behaviour.
pub struct Breathing {
    params: BreathingParams,
    organs: Vec<Entity>,
    seed: u64,
    /// Written into the scene with each tick: a copy in here is only for speed.
    respiration: Respiration,
    /// The breath for which this life of the controller has asked for a plan.
    asked_for: Option<u32>,
}

impl Breathing {
    /// Called at the start, and again after every failure.
    ///
    /// This is where a controller *resumes*: it takes from the scene what its last life left there, and goes on.
    /// So there is one constructor, not one for starting and one for recovering, and it is always tested.
    pub fn new(params: &BreathingParams, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        if !(params.breaths_per_minute > 0.0 && params.breaths_per_minute <= 120.0) {
            let wrong = params.breaths_per_minute;
            let text = format!("breaths_per_minute = {wrong} is out of range (above 0, up to 120)");
            return Err(ControllerError::Failed(text));
        }
        let organs: Vec<Entity> = context.scene.iter::<Breathes>().map(|(organ, _)| organ).collect();
        // `me` is the controller's own entity: the place for what belongs to nothing else in the scene.
        let respiration = context.scene.get::<Respiration>(context.me).cloned().unwrap_or_default();
        Ok(Self { params: *params, organs, seed: context.seed, respiration, asked_for: None })
    }
}

impl Controller for Breathing {
    /// Declared once and held to: whoever writes a row that is not declared is refused, and two controllers that
    /// both declare a row do not start. `trocar graph` draws what stands here.
    fn access(&self) -> Access {
        Access::new()
            .reads::<Breathes>()
            .writes::<Pose>(EntitySet::Of(self.organs.clone()))
            .writes::<Respiration>(EntitySet::Own)
    }

    /// One step. It must neither wait nor, once warmed up, allocate: a late tick is a tick that others feel.
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let respiration = &mut self.respiration;

        // Events: what happened since the last tick, each seen once, however short it was.
        for event in tick.events.iter().filter(|event| event.name == "hold_breath") {
            respiration.held_secs = event.value.clamp(0.0, 60.0);
        }

        // Time comes with the tick. A controller that looks at a clock cannot be tested, replayed or branched.
        let dt = tick.period.as_secs_f64();
        if respiration.held_secs > 0.0 {
            respiration.held_secs = (respiration.held_secs - dt).max(0.0);
        } else {
            respiration.phase += dt * self.params.breaths_per_minute / 60.0;
        }
        if respiration.phase >= 1.0 {
            respiration.phase -= 1.0;
            respiration.breaths += 1;
            respiration.depth = respiration.next_depth.take().unwrap_or(respiration.depth);
            out.event("breath", tick.me, None, respiration.depth);
        }

        // Jobs: work too long for a tick runs elsewhere and arrives later. In lock-step it arrives after `takes`,
        // whatever the machine, so that two runs are the same. A job that dies with its controller is simply
        // asked for again: the scene says that there is no plan yet.
        if respiration.next_depth.is_none() {
            let breath = respiration.breaths;
            if let Some(depth) = tick.jobs.take(u64::from(breath)) {
                respiration.next_depth = depth.downcast::<f64>().ok().map(|depth| *depth);
            } else if self.asked_for != Some(breath) {
                let (seed, variation) = (self.seed, self.params.variation);
                let asked = tick.jobs.submit(Job {
                    key: u64::from(breath),
                    takes: SimTime::from_millis(50),
                    work: Box::new(move || Box::new(plan::depth(seed, breath, variation))),
                });
                // Refused, because too many wait already? Then once more in the next tick.
                self.asked_for = asked.then_some(breath);
            }
        }

        // Reading and writing. `scene` is a snapshot: complete, never changing, at no cost.
        let lift = self.params.excursion * respiration.depth * components::lift(respiration.phase);
        for organ in &self.organs {
            let (Some(breathes), Some(pose)) = (scene.get::<Breathes>(*organ), scene.get::<Pose>(*organ))
            else {
                continue;
            };
            let mut pose = *pose;
            pose.translation.z = breathes.rest_height + breathes.share * lift;
            out.put(*organ, pose);
        }
        out.put(tick.me, respiration.clone());
        // All of it arrives, or nothing: the Model checks the batch as a whole. Returning an error instead ends
        // this life, and the supervisor builds the next one from the scene.
        Ok(())
    }
}

/// Trocar, and what this crate adds to it. The names are those that scenario files use.
pub fn app() -> App {
    App::new()
        .component::<Breathes>()
        .component::<Respiration>()
        .controller_with("breathing", Breathing::new)
        .about("breathing", KindInfo::new("breathing lifts and lowers the organs under the diaphragm", 100.0))
}
