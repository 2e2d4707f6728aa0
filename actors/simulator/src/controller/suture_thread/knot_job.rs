//! Schedules the classification of a thread's knot: periodically, in background jobs.
//!
//! A classification takes up to tens of milliseconds for a tangle, so no tick does it: the node positions go to a job,
//! and its result is used some ticks later, in lock-step always the same number. A thread that has not moved since the
//! last classification has the same knot.

use nalgebra::Point3;
use trocar_scene::{Job, SimTime, Tick};

use super::knot::KnotState;
use crate::suture_thread::ThreadState;

/// Ticks between two classifications of a knot.
const KNOT_EVERY: u64 = 50;
/// Ticks between two evaluations of the order of its throws.
const READ_EVERY: u64 = 10;
/// Duration of a classification in lock-step \[s\]: its computation time with a margin.
const LOOK: f64 = 4e-3;
/// Offset of the job numbers, so that they differ from other jobs of the same controller.
const JOBS: u64 = 1 << 32;
/// A thread whose nodes have all moved less than this has not been tied or untied, in radii: no strand passes another.
const STILL: f64 = 0.5;

/// Result of a call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KnotCheck {
    /// The classification has to be written to the scene.
    pub changed: bool,
    /// The knot has changed.
    pub is_another: bool,
}

/// Watches the knot of one thread.
#[derive(Debug)]
pub struct KnotWatch {
    state: KnotState,
    job: u64,
    /// Whether a job is running.
    is_looking: bool,
    /// Positions of all nodes at the last classification.
    seen: Vec<Point3<f64>>,
    /// Whether the order of throws could not be read in that configuration.
    is_unreadable: bool,
}

/// A job's request, with its result.
enum KnotJobResult {
    Knot(KnotState),
    Order(Option<KnotState>),
}

impl KnotWatch {
    /// Resumes from a saved classification. `index` is the thread's among those of its controller.
    #[must_use]
    pub fn new(known: Option<&KnotState>, index: u64) -> Self {
        Self {
            state: known.cloned().unwrap_or_default(),
            job: JOBS + index,
            is_looking: false,
            seen: Vec::new(),
            is_unreadable: false,
        }
    }

    /// The current classification.
    #[must_use]
    pub fn state(&self) -> &KnotState {
        &self.state
    }

    /// Takes the result of a finished job, and submits the next one if this tick is due; for one thread, or several
    /// classified as one, of `radius` \[m\].
    ///
    /// # Errors
    /// Its job delivered a result of another type.
    pub fn look(&mut self, thread: &ThreadState, radius: f64, tick: &Tick<'_>) -> Result<KnotCheck, String> {
        let points = &thread.positions;
        let mut looked = KnotCheck::default();
        if let Some(output) = tick.jobs.take(self.job) {
            self.is_looking = false;
            let found =
                output.downcast::<KnotJobResult>().map_err(|_| "a look at its knot found something else")?;
            looked = self.take(*found);
        }
        if self.is_looking {
            return Ok(looked);
        }
        let is_for_knot = tick.number % KNOT_EVERY == 1 && !self.is_at_rest(points, STILL * radius);
        let is_for_order =
            !self.is_unreadable && self.state.reading.is_some() && tick.number.is_multiple_of(READ_EVERY);
        if is_for_knot {
            self.seen.clear();
            self.seen.extend_from_slice(points);
            self.is_unreadable = false;
            let (points, ends, is_closed) = (points.clone(), thread.tangled(), thread.is_closed());
            self.is_looking = tick.jobs.submit(self.begin(move || {
                if is_closed {
                    return KnotJobResult::Knot(KnotState::of_closed(&points));
                }
                let threads: Vec<&[Point3<f64>]> =
                    ends.iter().map(|[first, last]| &points[*first..=*last]).collect();
                KnotJobResult::Knot(KnotState::of(&threads))
            }));
        } else if is_for_order && let [[first, last]] = thread.tangled()[..] {
            let (state, points) = (self.state.clone(), points[first..=last].to_vec());
            self.is_looking =
                tick.jobs.submit(self.begin(move || KnotJobResult::Order(state.read_next(&points))));
        }
        Ok(looked)
    }

    fn begin(&self, look: impl FnOnce() -> KnotJobResult + Send + 'static) -> Job {
        let work = move || Box::new(look()) as trocar_scene::JobOutput;
        Job { key: self.job, takes: SimTime::from_secs_f64(LOOK), work: Box::new(work) }
    }

    fn take(&mut self, found: KnotJobResult) -> KnotCheck {
        match found {
            KnotJobResult::Knot(found) => {
                let is_another = !self.state.is_same(&found);
                if is_another {
                    self.state = found;
                } else if self.state.reading.is_some() {
                    // Intertwined throws may come undone one by one in the new configuration.
                    self.state.reading = found.reading;
                }
                KnotCheck { changed: is_another, is_another }
            }
            KnotJobResult::Order(Some(state)) => {
                self.state = state;
                KnotCheck { changed: true, is_another: false }
            }
            KnotJobResult::Order(None) => {
                self.is_unreadable = true;
                KnotCheck::default()
            }
        }
    }

    fn is_at_rest(&self, points: &[Point3<f64>], way: f64) -> bool {
        let near = |(seen, now): (&Point3<f64>, &Point3<f64>)| (now - seen).norm_squared() <= way * way;
        self.seen.len() == points.len() && self.seen.iter().zip(points).all(near)
    }
}
