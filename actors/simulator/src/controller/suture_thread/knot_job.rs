//! Who looks at the knot of a thread: now and then, and beside the controller that steps it.
//!
//! What a look takes depends on how the thread lies, up to tens of milliseconds for a tangle, so no tick does it: where
//! its nodes are is handed to a job, and what that finds is told some ticks later, in lock-step always as many. A thread
//! that has not moved since the last look has the same knot.

use nalgebra::Point3;
use trocar_scene::{Job, SimTime, Tick};

use super::knot::KnotState;
use crate::suture_thread::ThreadState;

/// Ticks from one look at a knot to the next.
const KNOT_EVERY: u64 = 50;
/// Ticks from one look at the order of its throws to the next.
const READ_EVERY: u64 = 10;
/// When the answer comes in lock-step \[s\]: what a look takes, with some to spare.
const LOOK: f64 = 4e-3;
/// Jobs of looks are numbered from here, so that they are no others of the same controller.
const JOBS: u64 = 1 << 32;
/// A thread none of whose nodes has moved further has not been tied or untied, in radii: no strand gets past another.
const STILL: f64 = 0.5;

/// What a look has changed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Looked {
    /// It has to be written.
    pub changed: bool,
    /// It is another knot than before.
    pub is_another: bool,
}

/// Looks at one thread.
#[derive(Debug)]
pub struct KnotWatch {
    state: KnotState,
    job: u64,
    /// Whether a look is under way.
    is_looking: bool,
    /// Where the nodes were when the knot was last looked at, all of them.
    seen: Vec<Point3<f64>>,
    /// Whether the order of throws could not be read as they lay then.
    is_unreadable: bool,
}

/// What a look was for, and what came of it.
enum Found {
    Knot(KnotState),
    Order(Option<KnotState>),
}

impl KnotWatch {
    /// Goes on from what was known. `index` is the thread's among those of its controller.
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

    /// What is known of the knot.
    #[must_use]
    pub fn state(&self) -> &KnotState {
        &self.state
    }

    /// Takes what a look has found, and begins the next one if this is a tick for that; the thread, or several that are looked
    /// at as one, of `radius` \[m\].
    ///
    /// # Errors
    /// Its job delivered something else.
    pub fn look(&mut self, thread: &ThreadState, radius: f64, tick: &Tick<'_>) -> Result<Looked, String> {
        let points = &thread.positions;
        let mut looked = Looked::default();
        if let Some(output) = tick.jobs.take(self.job) {
            self.is_looking = false;
            let found = output.downcast::<Found>().map_err(|_| "a look at its knot found something else")?;
            looked = self.take(*found);
        }
        if self.is_looking {
            return Ok(looked);
        }
        let is_for_knot = tick.number % KNOT_EVERY == 1 && !self.lies_still(points, STILL * radius);
        let is_for_order =
            !self.is_unreadable && self.state.reading.is_some() && tick.number.is_multiple_of(READ_EVERY);
        if is_for_knot {
            self.seen.clear();
            self.seen.extend_from_slice(points);
            self.is_unreadable = false;
            let (points, ends) = (points.clone(), thread.tangled());
            self.is_looking = tick.jobs.submit(self.begin(move || {
                let threads: Vec<&[Point3<f64>]> =
                    ends.iter().map(|[first, last]| &points[*first..=*last]).collect();
                Found::Knot(KnotState::of(&threads))
            }));
        } else if is_for_order && let [[first, last]] = thread.tangled()[..] {
            let (state, points) = (self.state.clone(), points[first..=last].to_vec());
            self.is_looking = tick.jobs.submit(self.begin(move || Found::Order(state.read_on(&points))));
        }
        Ok(looked)
    }

    fn begin(&self, look: impl FnOnce() -> Found + Send + 'static) -> Job {
        let work = move || Box::new(look()) as trocar_scene::JobOutput;
        Job { key: self.job, takes: SimTime::from_secs_f64(LOOK), work: Box::new(work) }
    }

    fn take(&mut self, found: Found) -> Looked {
        match found {
            Found::Knot(found) => {
                let is_another = !self.state.is_same(&found);
                if is_another {
                    self.state = found;
                } else if self.state.reading.is_some() {
                    // Throws that were mingled may come undone one by one now that it lies otherwise.
                    self.state.reading = found.reading;
                }
                Looked { changed: is_another, is_another }
            }
            Found::Order(Some(state)) => {
                self.state = state;
                Looked { changed: true, is_another: false }
            }
            Found::Order(None) => {
                self.is_unreadable = true;
                Looked::default()
            }
        }
    }

    fn lies_still(&self, points: &[Point3<f64>], way: f64) -> bool {
        let near = |(seen, now): (&Point3<f64>, &Point3<f64>)| (now - seen).norm_squared() <= way * way;
        self.seen.len() == points.len() && self.seen.iter().zip(points).all(near)
    }
}
