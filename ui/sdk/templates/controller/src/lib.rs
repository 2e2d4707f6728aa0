//! A new behaviour: breathing, which lifts and lowers the organs under the diaphragm.
//!
//! A behaviour is a [`Controller`]: one function from a tick and a snapshot of the scene to commands. Only the
//! framework calls it, at the rate in the scenario, and it shares no memory with others: data for others it writes into
//! the scene.

mod components;
mod plan;

pub use components::{Breathes, Respiration};
use trocar::prelude::*;

/// The scenario's `params`. Missing keys keep their defaults, and a misspelt key (`breaths_per_minte`) is an error that
/// names the line.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BreathingParams {
    /// Breaths per minute.
    pub breaths_per_minute: f64,
    /// How far a breath of depth 1 lifts an organ of share 1 \[m\].
    pub excursion: f64,
    /// Largest difference in depth between two breaths: 0.2 is a fifth.
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
    /// Written into the scene in each tick: this copy is only for speed.
    respiration: Respiration,
    /// The breath for which this instance has submitted a plan.
    asked_for: Option<u32>,
}

impl Breathing {
    /// Called at the start, and again after every failure.
    ///
    /// A controller *resumes* here: it takes the state of its previous instance from the scene. So there is one
    /// constructor, not one for starting and one for recovering, and it is always tested.
    pub fn new(params: &BreathingParams, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        if !(params.breaths_per_minute > 0.0 && params.breaths_per_minute <= 120.0) {
            let wrong = params.breaths_per_minute;
            let text = format!("breaths_per_minute = {wrong} is out of range (above 0, up to 120)");
            return Err(ControllerError::Failed(text));
        }
        let organs: Vec<Entity> = context.scene.iter::<Breathes>().map(|(organ, _)| organ).collect();
        // `me` is the controller's own entity: the place for data that belongs to no other entity.
        let respiration = context.scene.get::<Respiration>(context.me).cloned().unwrap_or_default();
        Ok(Self { params: *params, organs, seed: context.seed, respiration, asked_for: None })
    }
}

impl Controller for Breathing {
    /// Declared once and enforced: writes to an undeclared row are refused, and a session in which two controllers
    /// declare the same row does not start. `trocar graph` draws these declarations.
    fn access(&self) -> Access {
        Access::new()
            .reads::<Breathes>()
            .writes::<Pose>(EntitySet::Of(self.organs.clone()))
            .writes::<Respiration>(EntitySet::Own)
    }

    /// One step. It must neither block nor, once warmed up, allocate: a late tick delays others.
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let respiration = &mut self.respiration;

        // Events since the last tick, each seen once, however short it was.
        for event in tick.events.iter().filter(|event| event.name == "hold_breath") {
            respiration.held_secs = event.value.clamp(0.0, 60.0);
        }

        // Time comes from the tick. A controller that reads a clock cannot be tested, replayed or branched.
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

        // Jobs: work too long for a tick runs elsewhere and its result arrives later. In lock-step it arrives after
        // `takes`, whatever the machine, so that two runs are identical. A job that dies with its controller is
        // submitted again: the scene shows that there is no plan yet.
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
                // Refused, because too many are queued already? The next tick tries again.
                self.asked_for = asked.then_some(breath);
            }
        }

        // Reading and writing. `scene` is a snapshot: complete, immutable, without cost.
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
        // The Model checks the batch as a whole and applies all of it or nothing. Returning an error instead ends this
        // instance, and the supervisor builds the next one from the scene.
        Ok(())
    }
}

/// Trocar with this crate's additions. The names are those in scenario files.
pub fn app() -> App {
    App::new()
        .component::<Breathes>()
        .component::<Respiration>()
        .controller_with("breathing", Breathing::new)
        .about("breathing", KindInfo::new("breathing lifts and lowers the organs under the diaphragm", 100.0))
}
