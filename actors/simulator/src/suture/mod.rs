//! Suturing: needle, swaged thread and tissue, stepped as one island.
//!
//! | Part | File |
//! |---|---|
//! | Elastic tissue, paths through its elements | `tissue.rs` |
//! | Forces of puncture, passage and exit | `material.rs` |
//! | Joints as constraint rows | `joints.rs` |
//! | Needle and tissue as bodies coupled to the thread's island | `needle_tissue.rs` |
//! | Contact of the needle's body and the thread with the tissue surface | `tissue_surface.rs` |
//! | Contact of the thread with the needle | `needle_thread_contact.rs` |
//! | Contact of the needle with instruments and rigid bodies | `needle_obstacle_contact.rs` |
//! | Tip transitions: entry, passage, exit, withdrawal | `puncture.rs` |
//! | Cutting and breaking the thread | `cut.rs` |
//! | State kept from step to step | `state.rs` |
//!
//! # Method
//! The tissue is linear and quasi-static ([`Columns`](crate::linear_fem::Columns)); the needle is rigid and implicit;
//! the thread is the implicit elastic rod of [`thread`](crate::suture_thread). Along the path cut by the tip, material
//! points of the tissue are stored at regular spacing; the needle, then the thread, is constrained laterally to them
//! and slides along the channel with friction: Coulomb's law plus a grip per length. Static friction is a spring to a
//! sticking point, so that nothing creeps. All of it is one problem of bounded forces with the compliance of all three
//! bodies.
//!
//! Elements are larger than the wire is thick: the local compliance around a line within an element
//! ([`Tissue::gives_way_about`]) is added to that of the elements; without it, points in one element would pinch the
//! needle.
//!
//! Needle and tissue are coupled to the thread in its island ([`thread`](crate::suture_thread)): all joints are solved
//! in the same problem as the thread's own contacts. A sutured thread therefore contacts itself, the tissue surface and
//! obstacles like any thread, and can be knotted. The needle's body contacts the surface too, and the thread contacts
//! its needle.
//!
//! # Limits
//! Cutting a channel does not change the tissue's stiffness, and the channel fits what is in it. The needle contacts
//! only tissue, its own thread (except next to the swage), the jaws that hold it and the rods of other instruments. Near a hole, within one spacing of
//! channel points, thread and needle do not contact the surface. Small displacements of the tissue only: see
//! [`ROTATION_LIMIT`](crate::linear_fem::ROTATION_LIMIT).

mod cut;
mod error;
pub(crate) mod joints;
mod material;
pub mod needle;
pub(crate) mod needle_obstacle_contact;
pub(crate) mod needle_thread_contact;
pub(crate) mod needle_tissue;
pub(crate) mod puncture;
mod state;
mod tissue;
pub(crate) mod tissue_surface;

pub use error::SutureError;
pub use material::Resistance;
pub use state::{
    BITES_MAX, Bite, CHANNEL_MAX, ChannelPoint, Event, NeedleContact, StrandContact, SutureState, Tip,
};
pub use tissue::{MaterialPoint, NODES_MAX, PathEnd, Tissue};

use nalgebra::{Isometry3, Point3, Vector3};

use crate::suture_thread::island::Island;
use crate::suture_thread::island::coupled_body::TieResult;
use crate::suture_thread::{
    ContactMemory, Fineness, Hold, IgnoredObstacle, LedInstrument, LedMotion, Load, Obstacle, Reaction,
    Renumbered, SWEEPS, Shape, Surroundings, ThreadMaterial, ThreadReport, ThreadState, ThreadStepError,
    TwistHold, check_step,
};
use needle::{NeedleShape, Solid};
use needle_tissue::{Sewing, Workspace};

/// Maximum number of substeps.
const PARTS_MAX: u32 = 256;
/// Maximum number of events reported per step.
const EVENTS_MAX: usize = 16;

/// Jaws on the needle: they drive it to a pose, and it slips beyond their limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grip {
    /// Grip point, in the frame of the needle \[m\].
    pub point: Point3<f64>,
    /// Wanted `world_from_needle` at the beginning of the step.
    pub from: Isometry3<f64>,
    /// Wanted `world_from_needle` at the end of the step.
    pub to: Isometry3<f64>,
    /// Stiffness \[N/m\].
    pub stiffness: f64,
    /// Rotational stiffness \[N·m/rad\].
    pub turning_stiffness: f64,
    /// Force limit along each axis of the world \[N\].
    pub force_max: f64,
    /// Torque limit about each axis of the world \[N·m\].
    pub torque_max: f64,
}

/// Result of a grip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripResult {
    /// Force on the needle, in the world \[N\], mean over the step.
    pub force: Vector3<f64>,
    /// Torque on the needle about the grip point \[N·m\], mean over the step.
    pub torque: Vector3<f64>,
    /// The needle slipped: the pose that the jaws have to want instead to stay within their limits.
    pub slipped: Option<Isometry3<f64>>,
}

/// Inputs of one step. All quantities in the world frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct StepInputs<'a> {
    /// Gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Jaws on the needle.
    pub grips: &'a [Grip],
    /// Thread nodes with a prescribed motion; a hold's force limit is along each axis of the world.
    pub holds: &'a [Hold],
    /// Thread edges whose rotation is held.
    pub twist_holds: &'a [TwistHold],
    /// Forces on nodes of the thread.
    pub loads: &'a [Load],
    /// Obstacles of the thread besides itself and the tissue; an obstacle keeps its index from step to step.
    pub obstacles: &'a [Obstacle<'a>],
    /// Obstacles that are parts of instruments, each led by a hand and coupled to it.
    pub led: &'a [LedInstrument],
    /// Parts of the thread that ignore some of the obstacles.
    pub spared: &'a [IgnoredObstacle],
    /// Obstacles that the needle passes without contact: those of instruments that hold it, and open jaws.
    pub needle_passes: &'a [usize],
}

/// Statistics of a step. Forces are those at its end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SutureReport {
    /// Number of substeps; 1 when the step was not divided.
    pub parts: u32,
    /// Linear solutions, over all substeps.
    pub iterations: usize,
    /// Newton steps on the force laws of joints and contacts.
    pub sweeps: usize,
    /// Number of joints between needle, thread and tissue.
    pub ties: usize,
    /// Thread contacts with non-zero force: with itself, the tissue surface, obstacles.
    pub contacts: usize,
    /// Largest penetration of these \[m\].
    pub penetration_max: f64,
    /// Force of the tissue on the tip \[N\].
    pub tip_force: f64,
    /// Friction of the tissue along needle and thread without the tip: sum of the magnitudes \[N\].
    pub drag: f64,
    /// Largest lateral force at a channel point per length represented \[N/m\]: this tears tissue.
    pub across_max: f64,
    /// Forces between the needle and instruments that do not hold it: sum of the magnitudes, mean over the step \[N\].
    pub force_on_instruments: f64,
    /// Resultant force on the tissue, mean over the step \[N\].
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
    workspace: Workspace,
    /// Tissue nodes at the beginning of the step.
    began: Vec<Point3<f64>>,
    spared: Vec<IgnoredObstacle>,
    /// Reused buffer, empty between steps.
    obstacles: Vec<Obstacle<'static>>,
    nothing: ThreadState,
    events: Vec<Event>,
    gripped: Vec<GripResult>,
    on_tissue: Vector3<f64>,
    /// Sum of the forces between needle and instruments that do not hold it, mean over the step \[N\].
    on_instruments: f64,
}

impl Suture {
    /// Restores from `state`. A needle outside of the tissue may get a new thread: see [`Suture::swage`].
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
        for (feature, _) in state.forces_on_tissue() {
            if !tissue.name_spot(&feature) {
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
            island: Island::new(SWEEPS),
            workspace: Workspace::default(),
            began: Vec::new(),
            spared: Vec::new(),
            obstacles: Vec::new(),
            nothing: ThreadState::default(),
            events: Vec::with_capacity(EVENTS_MAX),
            gripped: Vec::new(),
            on_tissue: Vector3::zeros(),
            on_instruments: 0.0,
        })
    }

    /// Takes the present angle between the thread's first edge and the needle as the rest angle, so that swaging causes
    /// no twist.
    pub fn swage(&mut self) {
        if let Some(thread) = &self.state.thread {
            let axis = (thread.positions[1] - thread.positions[0]).normalize();
            let pose = self.state.needle.pose();
            let across = crate::suture_thread::bishop_frame::perpendicular(&(pose * Vector3::z()), &axis);
            self.state.swage_turn =
                crate::suture_thread::bishop_frame::angle_about(&across, &thread.directors[0], &axis);
        }
    }

    /// The state: all that a restart needs.
    #[must_use]
    pub fn state(&self) -> &SutureState {
        &self.state
    }

    /// The thread's contact memories, to be renumbered when obstacles are added or removed. Contacts with the tissue
    /// use the index after all obstacles.
    pub fn contacts_mut(&mut self) -> Option<&mut Vec<ContactMemory>> {
        self.state.thread.as_mut().map(|thread| &mut thread.contacts)
    }

    /// Adapts the edge lengths of the thread. Kept are the nodes in `keep`, those in the tissue, and the second one,
    /// which rotates with the needle. `None` when nothing changes.
    ///
    /// # Errors
    /// The name of an invalid target. The thread is then unchanged.
    pub fn adapt(
        &mut self,
        fineness: &Fineness,
        mut keep: Vec<usize>,
    ) -> Result<Option<Renumbered>, SutureError> {
        keep.push(1);
        let length = self.solid.shape().length();
        tissue_surface::nodes_in_tissue(&self.state, length, &self.resistance, &mut keep);
        let radius = self.thread_radius();
        let SutureState { thread, strand_contacts, .. } = &mut self.state;
        let Some(thread) = thread else { return Ok(None) };
        let renumbered = thread.adapt(radius, fineness, &keep)?;
        if let Some(now) = &renumbered {
            // The touching part of a divided edge is not known: the first one inherits the memory.
            for contact in &mut *strand_contacts {
                contact.edge = now.edges[contact.edge as usize][0];
            }
            strand_contacts.dedup_by_key(|contact| contact.edge);
        }
        Ok(renumbered)
    }

    /// Radius of the thread \[m\]; 0 without one.
    #[must_use]
    pub fn thread_radius(&self) -> f64 {
        self.material.map_or(0.0, |material| material.radius)
    }

    /// The needle's shape and mass.
    #[must_use]
    pub fn solid(&self) -> &Solid {
        &self.solid
    }

    /// The deformed tissue.
    #[must_use]
    pub fn tissue(&self) -> &Tissue {
        &self.tissue
    }

    /// Events of the last step, in order.
    #[must_use]
    pub fn events(&self) -> &[Event] {
        &self.events
    }

    /// Results of the grips in the last step, in their order.
    #[must_use]
    pub fn gripped(&self) -> &[GripResult] {
        &self.gripped
    }

    /// Forces of the holds on the thread in the last step, in their order, mean over the step \[N\].
    #[must_use]
    pub fn hold_forces(&self) -> &[Vector3<f64>] {
        self.island.hold_forces()
    }

    /// Reactions of the obstacles to thread and needle in the last step, in their order.
    #[must_use]
    pub fn reactions(&self) -> &[Reaction] {
        let all = self.island.reactions();
        // The last one is the tissue.
        &all[..all.len().saturating_sub(1)]
    }

    /// Motions of the led instruments in the last step, in their order.
    #[must_use]
    pub fn led(&self) -> &[LedMotion] {
        self.island.led()
    }

    /// Position of the tip, in the world \[m\].
    #[must_use]
    pub fn tip(&self) -> Point3<f64> {
        self.state.needle.pose() * self.solid.point(self.solid.shape().length())
    }

    /// Advances by `dt` \[s\].
    ///
    /// # Errors
    /// The name of an invalid input, or that no step converged. The state is then unchanged.
    pub fn step(&mut self, dt: f64, surroundings: &StepInputs<'_>) -> Result<SutureReport, SutureError> {
        self.check(dt, surroundings)?;
        self.trial.clone_from(&self.state);
        self.events.clear();
        self.on_tissue = Vector3::zeros();
        self.on_instruments = 0.0;
        self.gripped.clear();
        let nothing = GripResult { force: Vector3::zeros(), torque: Vector3::zeros(), slipped: None };
        self.gripped.resize(surroundings.grips.len(), nothing);
        self.began.clear();
        self.began.extend_from_slice(self.tissue.positions());
        let mut report = SutureReport::default();
        let mut of_thread = ThreadReport::default();
        // The thread contacts the surface as it was at the beginning of the step.
        let began = std::mem::take(&mut self.began);
        let triangles = self.tissue.triangles();
        let shape = Shape::Mesh { from: &began, to: &began, triangles: &triangles, radius: 0.0 };
        let friction = self.resistance.thread_friction;
        let mut obstacles = emptied(std::mem::take(&mut self.obstacles));
        obstacles.extend_from_slice(surroundings.obstacles);
        obstacles.push(Obstacle::fixed(shape, Isometry3::identity(), friction));
        let here = StepObstacles { surroundings, obstacles: &obstacles, began: &began };
        self.island.begin(self.trial.thread.as_ref().unwrap_or(&self.nothing), &here.surroundings(&[]));
        let done = self.parts(dt, &here, &mut report, &mut of_thread);
        if let (Ok(()), Some(material)) = (&done, &self.material) {
            self.island.fill_report(material, &here.surroundings(&[]), &mut of_thread);
        }
        self.obstacles = emptied(obstacles);
        self.began = began;
        done?;
        std::mem::swap(&mut self.state, &mut self.trial);
        self.fill_report(&mut report, &of_thread);
        Ok(report)
    }

    /// All substeps.
    fn parts(
        &mut self,
        dt: f64,
        here: &StepObstacles<'_>,
        report: &mut SutureReport,
        of_thread: &mut ThreadReport,
    ) -> Result<(), SutureError> {
        // Time in units of the shortest substep, so that substeps add up exactly.
        let (mut done, mut part) = (0, PARTS_MAX);
        while done < PARTS_MAX {
            part = part.min(PARTS_MAX - done);
            let fractions = [done, done + part].map(|time| f64::from(time) / f64::from(PARTS_MAX));
            match self.part(dt * (fractions[1] - fractions[0]), fractions, part > 1, here, of_thread) {
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
        Ok(())
    }

    /// One substep, on `trial`.
    fn part(
        &mut self,
        dt: f64,
        fractions: [f64; 2],
        divisible: bool,
        here: &StepObstacles<'_>,
        of_thread: &mut ThreadReport,
    ) -> Result<(), SutureError> {
        self.tissue.begin();
        let before = self.trial.tip;
        let surface = here.obstacles.len() - 1;
        self.spared.clear();
        self.spared.extend_from_slice(here.surroundings.spared);
        let length = self.solid.shape().length();
        tissue_surface::in_tissue(&self.trial, length, &self.resistance, surface, &mut self.spared);
        let spared = std::mem::take(&mut self.spared);
        let surroundings = here.surroundings(&spared);
        let material = self.material.unwrap_or(ThreadMaterial::silk_2_0());
        let mut round = 0;
        let found = loop {
            let mut sewing = Sewing {
                solid: &self.solid,
                thread: self.material.as_ref(),
                resistance: &self.resistance,
                start: &self.trial,
                tissue: &mut self.tissue,
                workspace: &mut self.workspace,
                surroundings: here.surroundings,
                obstacles: here.obstacles,
                dt,
                fractions,
                surface,
                step_began: here.began,
            };
            sewing.begin();
            let found =
                self.island.part(&material, dt, fractions, &surroundings, divisible, of_thread, &mut sewing);
            if let Err(failure) = found {
                self.trial.tip = before;
                let why = failure.why;
                break Err(SutureError::Diverged { time: 0.0, shortest: 0.0, why });
            }
            // A tip that crossed the surface on the way is stopped there, and the substep repeated.
            match if round > 0 { Ok(false) } else { self.meets() } {
                Err(why) => break Err(why),
                Ok(true) => self.tissue.deform(self.trial.forces_on_tissue()),
                Ok(false) => {
                    let (links, forces) = self.island.links();
                    self.workspace.press(links, forces);
                    self.island.finish(&material, dt, fractions, &surroundings);
                    break Ok(());
                }
            }
            round += 1;
        };
        self.spared = spared;
        found?;
        self.feel(fractions, here.surroundings);
        self.commit(dt, &here.surroundings.gravity)
    }

    /// Accumulates the reactions on grips and tissue in this substep, weighted by its share of the step.
    fn feel(&mut self, fractions: [f64; 2], surroundings: &StepInputs<'_>) {
        let weight = fractions[1] - fractions[0];
        let (layout, tied) = (self.workspace.layout, self.island.tied());
        for (index, gripped) in self.gripped.iter_mut().enumerate() {
            let first = layout.grips + 2 * index;
            let [place, turn] = [tied[first], tied[first + 1]];
            gripped.force += Vector3::from(place.force) * weight;
            gripped.torque += Vector3::from(turn.force) * weight;
            let grip = &surroundings.grips[index];
            // A slipping grip stays where its spring carries the force limit.
            let given =
                |of: &TieResult| Vector3::from_fn(|k, _| if of.gives_way[k] { of.gap[k] } else { 0.0 });
            let (by, turn) = (given(&place), given(&turn));
            gripped.slipped = (by != Vector3::zeros() || turn != Vector3::zeros()).then(|| {
                let rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * grip.to.rotation;
                let translation = grip.to * grip.point + by - rotation * grip.point;
                Isometry3::from_parts(translation.into(), rotation)
            });
        }
        for tie in layout.channel..layout.sides {
            self.on_tissue -= self.workspace.force(tied, tie) * weight;
        }
        for (place, (obstacle, at)) in self.workspace.touched.iter().enumerate() {
            let force = self.workspace.force(self.island.tied(), layout.touches + place) * -weight;
            self.on_instruments += force.norm();
            let origin = Point3::from(surroundings.obstacles[*obstacle].to.translation.vector);
            self.island.add_reaction(*obstacle, &force, at, &origin);
        }
        self.on_tissue +=
            self.workspace.presses.iter().map(|press| press.force).sum::<Vector3<f64>>() * weight;
    }

    fn fill_report(&self, report: &mut SutureReport, of_thread: &ThreadReport) {
        report.iterations = of_thread.iterations;
        report.sweeps = of_thread.sweeps;
        report.ties = self.island.tied().len();
        report.contacts = of_thread.contacts;
        report.penetration_max = of_thread.penetration_max;
        report.force_on_tissue = self.on_tissue;
        report.force_on_instruments = self.on_instruments;
        report.tip_force = self.state.tip_force.norm();
        let (state, length) = (&self.state, self.solid.shape().length());
        for (index, point) in state.channel.iter().enumerate() {
            let share = needle_tissue::share_of_channel(state, index, length);
            report.length_inside += share;
            let Some(site) = self.workspace.sites.get(index) else { continue };
            let along = point.force.dot(&site.tangent);
            report.drag += along.abs();
            if share > 0.25 * self.resistance.spacing {
                let across = (point.force - site.tangent * along).norm();
                report.across_max = report.across_max.max(across / share);
            }
        }
    }

    fn check(&self, dt: f64, surroundings: &StepInputs<'_>) -> Result<(), SutureError> {
        let thread = self.state.thread.as_ref();
        let [nodes, edges] = thread.map_or([0; 2], |of| [of.positions.len(), of.rest_lengths.len()]);
        let whole = StepObstacles { surroundings, obstacles: surroundings.obstacles, began: &[] };
        let sound = check_step(dt).and_then(|()| whole.surroundings(&[]).check(nodes, edges));
        sound.map_err(|error| match error {
            ThreadStepError::Given { what, index, why } => SutureError::Given { what, index, why },
            _ => SutureError::Number { what: "the step", value: dt, valid: "above 0, at most 2 ms" },
        })?;
        let is_pose = |pose: &Isometry3<f64>| {
            pose.translation.vector.iter().all(|x| x.is_finite()) && (pose.rotation.norm() - 1.0).abs() < 1e-6
        };
        for (index, grip) in surroundings.grips.iter().enumerate() {
            let given = |why: &str| Err(SutureError::Given { what: "grip", index, why: why.to_owned() });
            if !is_pose(&grip.from) || !is_pose(&grip.to) || !grip.point.iter().all(|x| x.is_finite()) {
                return given("its pose or point is not finite");
            }
            let stiff = |x: f64| x > 0.0 && x <= 1e9;
            let most = |x: f64| x >= 0.0;
            if !(stiff(grip.stiffness)
                && stiff(grip.turning_stiffness)
                && most(grip.force_max)
                && most(grip.torque_max))
            {
                return given("valid: stiffness above 0, at most 1e9; force and torque 0 or more");
            }
        }
        Ok(())
    }
}

/// Reuses the buffer of a list for another one with another lifetime.
fn emptied<'b>(mut list: Vec<Obstacle<'_>>) -> Vec<Obstacle<'b>> {
    list.clear();
    // Collected in place.
    list.into_iter().map_while(|_| None).collect()
}

/// Obstacles of needle and thread in a step: those given, and the tissue as the last one.
struct StepObstacles<'a> {
    surroundings: &'a StepInputs<'a>,
    obstacles: &'a [Obstacle<'a>],
    /// Tissue nodes at the beginning of the step.
    began: &'a [Point3<f64>],
}

impl StepObstacles<'_> {
    fn surroundings<'b>(&'b self, spared: &'b [IgnoredObstacle]) -> Surroundings<'b> {
        Surroundings {
            gravity: self.surroundings.gravity,
            holds: self.surroundings.holds,
            twist_holds: self.surroundings.twist_holds,
            loads: self.surroundings.loads,
            obstacles: self.obstacles,
            led: self.surroundings.led,
            spared,
            ..Surroundings::default()
        }
    }
}
