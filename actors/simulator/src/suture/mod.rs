//! Sewing: a needle, the thread that is swaged to it and the tissue that they go through, stepped as one island.
//!
//! | Part | File |
//! |---|---|
//! | Tissue that answers inside, and the way through its elements | `tissue.rs` |
//! | Forces of going in, through and out | `material.rs` |
//! | What holds, presses and rubs, as rows | `rows.rs` |
//! | Forces that obey the laws of all rows | `solve.rs` |
//! | Newton iterations on all bodies together | `island.rs` |
//! | The tip at and in the tissue: in, on, out, back | `tip.rs` |
//! | What is kept from step to step | `state.rs` |
//!
//! # Method
//! The tissue is linear and quasi-static ([`Columns`](crate::linear_fem::Columns)); the needle is rigid and implicit; the
//! thread is the implicit elastic rod of [`thread`](crate::thread). Where the tip has cut its way, material points of the
//! tissue are kept, a spacing apart; what lies there, first needle, then thread, is held across the channel and rubs
//! along it: Coulomb's law with a grip per length besides what presses, and what sticks sticks to a place, so that it does
//! not creep. All of it is one problem of bounded forces through the compliance of all three bodies.
//!
//! Elements are larger than a wire is thick: what a line gives way about itself within one of them
//! ([`Tissue::gives_way_about`]) is added to what the elements show, else places in one element pinch the needle.
//!
//! # Limits
//! Tissue is stiffer by nothing where it has been cut, and the channel is as wide as what is in it. Thread does not touch
//! itself, instruments or the outside of the tissue here: that is in [`Thread::step`](crate::thread::Thread::step), which
//! knows no needle. The shaft of the needle is not kept out of the surface, only its tip is. Small displacements of the
//! tissue only: see [`ROTATION_LIMIT`](crate::linear_fem::ROTATION_LIMIT).

mod error;
mod island;
mod material;
mod rows;
mod solve;
mod state;
mod tip;
mod tissue;

pub use error::SutureError;
pub use material::Resistance;
pub use state::{BITES_MAX, Bite, CHANNEL_MAX, ChannelPoint, Event, SutureState, Tip};
pub use tissue::{NODES_MAX, Place, Tissue, Way};

use nalgebra::{Isometry3, Point3, Vector3};

use crate::needle::{NeedleShape, Solid};
use crate::thread::{Hold, Load, STEP_MAX, ThreadMaterial};
use island::{Bodies, Island};

/// A step is divided into this many parts at most.
const PARTS_MAX: u32 = 64;
/// Events that one step tells of at most.
const EVENTS_MAX: usize = 16;

/// Jaws on the needle: they lead it to a pose, and it slips in them beyond what they can hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// Where they hold, in the frame of the needle \[m\].
    pub point: Point3<f64>,
    /// `world_from_needle` as they want it when the step begins.
    pub from: Isometry3<f64>,
    /// And when it ends.
    pub to: Isometry3<f64>,
    /// \[N/m\].
    pub stiffness: f64,
    /// \[N·m/rad\].
    pub turning_stiffness: f64,
    /// Along each axis of the world \[N\].
    pub force_max: f64,
    /// About each axis of the world \[N·m\].
    pub torque_max: f64,
}

/// What a grip did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gripped {
    /// On the needle, in the world \[N\], mean over the step.
    pub force: Vector3<f64>,
    /// On the needle about the grip's point \[N·m\], mean over the step.
    pub torque: Vector3<f64>,
    /// The needle slipped: to hold no more than they can, the jaws are to want this pose instead.
    pub slipped: Option<Isometry3<f64>>,
}

/// What acts during one step. Everything is in the world.
#[derive(Clone, Copy, Debug, Default)]
pub struct Around<'a> {
    /// \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Jaws on the needle.
    pub grips: &'a [Grip],
    /// Nodes of the thread that are led; a hold's largest force is along each axis of the world.
    pub holds: &'a [Hold],
    /// Forces on nodes of the thread.
    pub loads: &'a [Load],
}

/// How a step went. Forces are those at its end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SutureReport {
    /// Parts into which the step had to be divided; 1 when it went as a whole.
    pub parts: u32,
    /// Linearised solutions, over all parts.
    pub iterations: usize,
    /// Factorisations of the forces' problem.
    pub rounds: usize,
    /// Rows of the last problem.
    pub rows: usize,
    /// Of the tissue on the tip \[N\].
    pub tip_force: f64,
    /// Of the tissue along needle and thread, the tip left out: the sum of friction's sizes \[N\].
    pub drag: f64,
    /// Across them, the largest at a place per length that it stands for \[N/m\]: what tears.
    pub across_max: f64,
    /// On the tissue as a whole, mean over the step \[N\].
    pub force_on_tissue: Vector3<f64>,
    /// Length of needle and thread in the tissue \[m\].
    pub length_inside: f64,
}

/// A needle, its thread and a tissue.
pub struct Suture {
    solid: Solid,
    material: Option<ThreadMaterial>,
    resistance: Resistance,
    tissue: Tissue,
    state: SutureState,
    trial: SutureState,
    island: Island,
    events: Vec<Event>,
    gripped: Vec<Gripped>,
    hold_forces: Vec<Vector3<f64>>,
    on_tissue: Vector3<f64>,
}

impl Suture {
    /// Goes on from `state`. A needle that is in nothing may be given a thread anew: see [`Suture::swage`].
    ///
    /// # Errors
    /// What is wrong with needle, thread, tissue or state.
    pub fn new(
        needle: &NeedleShape,
        material: Option<ThreadMaterial>,
        resistance: Resistance,
        mut tissue: Tissue,
        state: SutureState,
    ) -> Result<Self, SutureError> {
        let solid = needle.solid()?;
        resistance.check()?;
        if let Some(material) = &material {
            material.check()?;
        }
        state.check(&tissue, material.as_ref().map(|material| material.radius))?;
        let places = state.channel.iter().map(|point| &point.place).chain(state.tip.place());
        for place in places {
            if !tissue.name(place) {
                return Err(SutureError::Full);
            }
        }
        tissue.deform(state.forces_on_tissue());
        Ok(Self {
            solid,
            material,
            resistance,
            tissue,
            trial: state.clone(),
            state,
            island: Island::default(),
            events: Vec::with_capacity(EVENTS_MAX),
            gripped: Vec::new(),
            hold_forces: Vec::new(),
            on_tissue: Vector3::zeros(),
        })
    }

    /// Lets the thread's first edge be turned against the needle as it is now, so that swaging twists nothing.
    pub fn swage(&mut self) {
        if let Some(thread) = &self.state.thread {
            let axis = (thread.positions[1] - thread.positions[0]).normalize();
            let pose = self.state.needle.pose();
            let across = crate::thread::frame::perpendicular(&(pose * Vector3::z()), &axis);
            self.state.swage_turn = crate::thread::frame::angle_about(&across, &thread.directors[0], &axis);
        }
    }

    /// Everything needed to go on from here.
    #[must_use]
    pub fn state(&self) -> &SutureState {
        &self.state
    }

    /// The needle's shape and mass.
    #[must_use]
    pub fn solid(&self) -> &Solid {
        &self.solid
    }

    /// The tissue as it is now.
    #[must_use]
    pub fn tissue(&self) -> &Tissue {
        &self.tissue
    }

    /// What happened in the last step, in its order.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// What the grips did in the last step, in their order.
    #[must_use]
    pub fn gripped(&self) -> &[Gripped] {
        &self.gripped
    }

    /// Forces of the holds on the thread in the last step, in their order, mean over it \[N\].
    #[must_use]
    pub fn hold_forces(&self) -> &[Vector3<f64>] {
        &self.hold_forces
    }

    /// Where the tip is, in the world \[m\].
    #[must_use]
    pub fn tip(&self) -> Point3<f64> {
        self.state.needle.pose() * self.solid.point(self.solid.shape().length())
    }

    /// Goes on by `dt` \[s\].
    ///
    /// # Errors
    /// Input that makes no sense, by name; or that no step could be found. The state is then what it was.
    pub fn step(&mut self, dt: f64, around: &Around<'_>) -> Result<SutureReport, SutureError> {
        self.check(dt, around)?;
        self.trial.clone_from(&self.state);
        self.events.clear();
        self.on_tissue = Vector3::zeros();
        self.gripped.clear();
        let nothing = Gripped { force: Vector3::zeros(), torque: Vector3::zeros(), slipped: None };
        self.gripped.resize(around.grips.len(), nothing);
        self.hold_forces.clear();
        self.hold_forces.resize(around.holds.len(), Vector3::zeros());
        (self.island.iterations, self.island.rounds) = (0, 0);
        let mut report = SutureReport::default();
        // Time in units of the shortest part, so that the parts add up exactly.
        let (mut done, mut part) = (0, PARTS_MAX);
        while done < PARTS_MAX {
            part = part.min(PARTS_MAX - done);
            let fractions = [done, done + part].map(|time| f64::from(time) / f64::from(PARTS_MAX));
            match self.part(dt * (fractions[1] - fractions[0]), fractions, around) {
                Ok(()) => {
                    done += part;
                    report.parts += 1;
                    while done < PARTS_MAX && part < PARTS_MAX && done % (2 * part) == 0 {
                        part *= 2;
                    }
                }
                Err(why) => {
                    self.tissue.deform(self.trial.forces_on_tissue());
                    if part > 1 && why != SutureError::Full {
                        part /= 2;
                        continue;
                    }
                    self.tissue.deform(self.state.forces_on_tissue());
                    return Err(match why {
                        SutureError::Diverged { why, .. } => SutureError::Diverged {
                            time: dt * fractions[0],
                            shortest: dt * (fractions[1] - fractions[0]),
                            why,
                        },
                        other => other,
                    });
                }
            }
        }
        std::mem::swap(&mut self.state, &mut self.trial);
        self.tell(&mut report);
        Ok(report)
    }

    /// One part of the step, from `trial` to `trial`.
    fn part(&mut self, dt: f64, fractions: [f64; 2], around: &Around<'_>) -> Result<(), SutureError> {
        self.tissue.begin();
        let before = self.trial.tip;
        for round in 0.. {
            let of =
                Bodies { solid: &self.solid, thread: self.material.as_ref(), resistance: &self.resistance };
            let found = self.island.find(&of, &self.trial, &mut self.tissue, dt, fractions, around);
            if let Err(why) = found {
                self.trial.tip = before;
                return Err(SutureError::Diverged { time: 0.0, shortest: 0.0, why });
            }
            // A tip that has come in on the way is stopped there, and the part is made again.
            if round > 0 || !self.meets()? {
                break;
            }
            self.tissue.deform(self.trial.forces_on_tissue());
        }
        self.feel(fractions, around);
        self.commit(dt, &around.gravity)
    }

    /// Adds the forces of this part to what grips, holds and tissue feel, by its share of the step.
    fn feel(&mut self, fractions: [f64; 2], around: &Around<'_>) {
        let weight = fractions[1] - fractions[0];
        let (layout, problem) = (self.island.layout, &self.island.problem);
        for (index, gripped) in self.gripped.iter_mut().enumerate() {
            let first = layout.grips + 6 * index;
            let of = |k: usize| Vector3::from_column_slice(&problem.force[first + k..first + k + 3]);
            gripped.force += of(0) * weight;
            gripped.torque += of(3) * weight;
            let grip = &around.grips[index];
            // What gives way stays where its spring is stretched by what it can hold.
            let given = |k: usize| if problem.gives_way(first + k) { problem.gap_of(first + k) } else { 0.0 };
            let (by, turn) = (Vector3::from_fn(|k, _| given(k)), Vector3::from_fn(|k, _| given(k + 3)));
            gripped.slipped = (by != Vector3::zeros() || turn != Vector3::zeros()).then(|| {
                let rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * grip.to.rotation;
                let translation = grip.to * grip.point + by - rotation * grip.point;
                Isometry3::from_parts(translation.into(), rotation)
            });
        }
        for (index, felt) in self.hold_forces.iter_mut().enumerate() {
            let first = layout.holds + 3 * index;
            *felt += Vector3::from_column_slice(&problem.force[first..first + 3]) * weight;
        }
        for first in (layout.channel..self.island.rows.len()).step_by(3) {
            self.on_tissue -= self.island.force(first) * weight;
        }
    }

    fn tell(&self, report: &mut SutureReport) {
        report.iterations = self.island.iterations;
        report.rounds = self.island.rounds;
        report.rows = self.island.rows.len();
        report.force_on_tissue = self.on_tissue;
        report.tip_force = self.state.tip_force.norm();
        let (state, length) = (&self.state, self.solid.shape().length());
        for (index, point) in state.channel.iter().enumerate() {
            let share = island::share_of_channel(state, index, length);
            report.length_inside += share;
            let Some(site) = self.island.sites.get(index) else { continue };
            let along = point.force.dot(&site.tangent);
            report.drag += along.abs();
            if share > 0.25 * self.resistance.spacing {
                let across = (point.force - site.tangent * along).norm();
                report.across_max = report.across_max.max(across / share);
            }
        }
    }

    fn check(&self, dt: f64, around: &Around<'_>) -> Result<(), SutureError> {
        if dt.is_nan() || dt <= 0.0 || dt > STEP_MAX {
            return Err(SutureError::Number { what: "the step", value: dt, valid: "above 0, at most 2 ms" });
        }
        let given = |what, index, why| Err(SutureError::Given { what, index, why });
        if !around.gravity.iter().all(|x| x.is_finite()) {
            return given("gravity", 0, "not finite");
        }
        let nodes = self.state.thread.as_ref().map_or(0, |thread| thread.positions.len());
        let is_pose = |pose: &Isometry3<f64>| {
            pose.translation.vector.iter().all(|x| x.is_finite()) && (pose.rotation.norm() - 1.0).abs() < 1e-6
        };
        for (index, grip) in around.grips.iter().enumerate() {
            if !is_pose(&grip.from) || !is_pose(&grip.to) || !grip.point.iter().all(|x| x.is_finite()) {
                return given("grip", index, "its pose or point is not finite");
            }
            let stiff = |x: f64| x > 0.0 && x <= 1e9;
            let most = |x: f64| x >= 0.0;
            if !(stiff(grip.stiffness)
                && stiff(grip.turning_stiffness)
                && most(grip.force_max)
                && most(grip.torque_max))
            {
                return given(
                    "grip",
                    index,
                    "valid: stiffness above 0, at most 1e9; force and torque 0 or more",
                );
            }
        }
        for (index, hold) in around.holds.iter().enumerate() {
            if hold.node >= nodes || !hold.to.iter().all(|x| x.is_finite()) {
                return given("hold", index, "there is no such node, or its place is not finite");
            }
            if !(hold.stiffness > 0.0 && hold.stiffness <= 1e9 && hold.force_max >= 0.0) {
                return given(
                    "hold",
                    index,
                    "valid: stiffness above 0, at most 1e9 N/m; force_max 0 or more",
                );
            }
        }
        for (index, load) in around.loads.iter().enumerate() {
            if load.node >= nodes || !load.force.iter().all(|x| x.is_finite()) {
                return given("load", index, "there is no such node, or its force is not finite");
            }
        }
        Ok(())
    }
}
