//! Sewing: a needle, the thread that is swaged to it and the tissue that they go through, stepped as one island.
//!
//! | Part | File |
//! |---|---|
//! | Tissue that answers inside, and the way through its elements | `tissue.rs` |
//! | Forces of going in, through and out | `material.rs` |
//! | What holds, presses and rubs, as rows | `joints.rs` |
//! | Needle and tissue as companions in the thread's island | `needle_tissue.rs` |
//! | The needle's side and the thread on the surface | `tissue_surface.rs` |
//! | Strands of the thread on the needle | `needle_thread_contact.rs` |
//! | The tip at and in the tissue: in, on, out, back | `puncture.rs` |
//! | A thread that is cut between needle and tissue, or breaks | `cut.rs` |
//! | What is kept from step to step | `state.rs` |
//!
//! # Method
//! The tissue is linear and quasi-static ([`Columns`](crate::linear_fem::Columns)); the needle is rigid and implicit; the
//! thread is the implicit elastic rod of [`thread`](crate::suture_thread). Where the tip has cut its way, material points of the
//! tissue are kept, a spacing apart; what lies there, first needle, then thread, is held across the channel and rubs
//! along it: Coulomb's law with a grip per length besides what presses, and what sticks sticks to a place, so that it does
//! not creep. All of it is one problem of bounded forces through the compliance of all three bodies.
//!
//! Elements are larger than a wire is thick: what a line gives way about itself within one of them
//! ([`Tissue::gives_way_about`]) is added to what the elements show, else places in one element pinch the needle.
//!
//! Needle and tissue are companions of the thread in its island ([`thread`](crate::suture_thread)): what holds all three together is
//! solved for in the problem of the thread's own contacts. So a sewn thread touches itself, the surface of the tissue and what
//! is around it as any thread does, and is tied as one. The needle's side stays out of the surface as well, and strands of its
//! thread out of the needle.
//!
//! # Limits
//! Tissue is stiffer by nothing where it has been cut, and the channel is as wide as what is in it. The needle touches
//! nothing but tissue, its own thread and the jaws that hold it; of its thread not what comes out of the swage. Next to a hole, as far as one place of the channel from
//! the next, thread and needle do not touch the surface. Small displacements of the tissue only: see
//! [`ROTATION_LIMIT`](crate::linear_fem::ROTATION_LIMIT).

mod cut;
mod error;
pub(crate) mod joints;
mod material;
pub mod needle;
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
pub use tissue::{NODES_MAX, Place, Tissue, Way};

use nalgebra::{Isometry3, Point3, Vector3};

use crate::suture_thread::island::Island;
use crate::suture_thread::island::coupled_body::Tied;
use crate::suture_thread::{
    ContactMemory, Fineness, Hold, Load, Obstacle, Reaction, Renumbered, SWEEPS, Shape, Spared, Surroundings,
    ThreadMaterial, ThreadReport, ThreadState, ThreadStepError, TwistHold, check_step,
};
use needle::{NeedleShape, Solid};
use needle_tissue::{Sewing, Workspace};

/// A step is divided into this many parts at most.
const PARTS_MAX: u32 = 256;
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
pub struct StepInputs<'a> {
    /// \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Jaws on the needle.
    pub grips: &'a [Grip],
    /// Nodes of the thread that are led; a hold's largest force is along each axis of the world.
    pub holds: &'a [Hold],
    /// Edges of the thread that are kept from turning.
    pub twist_holds: &'a [TwistHold],
    /// Forces on nodes of the thread.
    pub loads: &'a [Load],
    /// What the thread can touch besides itself and the tissue; an obstacle keeps its place in the list from step to step.
    pub obstacles: &'a [Obstacle<'a>],
    /// What of the thread does not touch which of them.
    pub spared: &'a [Spared],
}

/// How a step went. Forces are those at its end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SutureReport {
    /// Parts into which the step had to be divided; 1 when it went as a whole.
    pub parts: u32,
    /// Linearised solutions, over all parts.
    pub iterations: usize,
    /// Newton steps on the rules of all places and on the laws of the thread's contacts with obstacles.
    pub sweeps: usize,
    /// Places at which needle, thread and tissue are tied to each other.
    pub ties: usize,
    /// Contacts of the thread that push: with itself, with the tissue's surface, with obstacles.
    pub contacts: usize,
    /// How deep one of these is at most \[m\].
    pub penetration_max: f64,
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
    room: Workspace,
    /// Nodes of the tissue when the step began.
    began: Vec<Point3<f64>>,
    spared: Vec<Spared>,
    /// Empty between steps.
    obstacles: Vec<Obstacle<'static>>,
    nothing: ThreadState,
    events: Vec<Event>,
    gripped: Vec<Gripped>,
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
        for (spot, _) in state.forces_on_tissue() {
            if !tissue.name_spot(&spot) {
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
            room: Workspace::default(),
            began: Vec::new(),
            spared: Vec::new(),
            obstacles: Vec::new(),
            nothing: ThreadState::default(),
            events: Vec::with_capacity(EVENTS_MAX),
            gripped: Vec::new(),
            on_tissue: Vector3::zeros(),
        })
    }

    /// Lets the thread's first edge be turned against the needle as it is now, so that swaging twists nothing.
    pub fn swage(&mut self) {
        if let Some(thread) = &self.state.thread {
            let axis = (thread.positions[1] - thread.positions[0]).normalize();
            let pose = self.state.needle.pose();
            let across = crate::suture_thread::bishop_frame::perpendicular(&(pose * Vector3::z()), &axis);
            self.state.swage_turn =
                crate::suture_thread::bishop_frame::angle_about(&across, &thread.directors[0], &axis);
        }
    }

    /// Everything needed to go on from here.
    #[must_use]
    pub fn state(&self) -> &SutureState {
        &self.state
    }

    /// What the thread's contacts remember, to be numbered anew when obstacles come and go. Contacts with the tissue count it
    /// after all obstacles.
    pub fn contacts_mut(&mut self) -> Option<&mut Vec<ContactMemory>> {
        self.state.thread.as_mut().map(|thread| &mut thread.contacts)
    }

    /// Makes edges of the thread as short as they have to be, and no shorter where they need not. The nodes in `keep` stay, and
    /// so do those in the tissue and the second one, which turns with the needle. `None` when all are as they should be.
    ///
    /// # Errors
    /// A fineness that makes no sense, by name. The thread is then what it was.
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
            // Which part of an edge that was divided touched is not known: the first takes over what is remembered.
            for contact in &mut *strand_contacts {
                contact.edge = now.edges[contact.edge as usize][0];
            }
            strand_contacts.dedup_by_key(|contact| contact.edge);
        }
        Ok(renumbered)
    }

    /// Of the thread \[m\]; 0 where there is none.
    #[must_use]
    pub fn thread_radius(&self) -> f64 {
        self.material.map_or(0.0, |material| material.radius)
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
        self.island.hold_forces()
    }

    /// What the thread did to the obstacles in the last step, in their order.
    #[must_use]
    pub fn reactions(&self) -> &[Reaction] {
        let all = self.island.reactions();
        // The last is the tissue.
        &all[..all.len().saturating_sub(1)]
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
    pub fn step(&mut self, dt: f64, around: &StepInputs<'_>) -> Result<SutureReport, SutureError> {
        self.check(dt, around)?;
        self.trial.clone_from(&self.state);
        self.events.clear();
        self.on_tissue = Vector3::zeros();
        self.gripped.clear();
        let nothing = Gripped { force: Vector3::zeros(), torque: Vector3::zeros(), slipped: None };
        self.gripped.resize(around.grips.len(), nothing);
        self.began.clear();
        self.began.extend_from_slice(self.tissue.positions());
        let mut report = SutureReport::default();
        let mut of_thread = ThreadReport::default();
        // The thread meets the surface as it was when the step began.
        let began = std::mem::take(&mut self.began);
        let triangles = self.tissue.triangles();
        let shape = Shape::Mesh { from: &began, to: &began, triangles: &triangles, radius: 0.0 };
        let friction = self.resistance.thread_friction;
        let mut obstacles = emptied(std::mem::take(&mut self.obstacles));
        obstacles.extend_from_slice(around.obstacles);
        obstacles.push(Obstacle::fixed(shape, Isometry3::identity(), friction));
        let here = Here { around, obstacles: &obstacles, began: &began };
        self.island.begin(self.trial.thread.as_ref().unwrap_or(&self.nothing), &here.surroundings(&[]));
        let done = self.parts(dt, &here, &mut report, &mut of_thread);
        if let (Ok(()), Some(material)) = (&done, &self.material) {
            self.island.tell(material, &here.surroundings(&[]), &mut of_thread);
        }
        self.obstacles = emptied(obstacles);
        self.began = began;
        done?;
        std::mem::swap(&mut self.state, &mut self.trial);
        self.tell(&mut report, &of_thread);
        Ok(report)
    }

    /// All parts of the step.
    fn parts(
        &mut self,
        dt: f64,
        here: &Here<'_>,
        report: &mut SutureReport,
        of_thread: &mut ThreadReport,
    ) -> Result<(), SutureError> {
        // Time in units of the shortest part, so that the parts add up exactly.
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

    /// One part of the step, from `trial` to `trial`.
    fn part(
        &mut self,
        dt: f64,
        fractions: [f64; 2],
        divisible: bool,
        here: &Here<'_>,
        of_thread: &mut ThreadReport,
    ) -> Result<(), SutureError> {
        self.tissue.begin();
        let before = self.trial.tip;
        let surface = here.obstacles.len() - 1;
        self.spared.clear();
        self.spared.extend_from_slice(here.around.spared);
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
                room: &mut self.room,
                around: here.around,
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
            // A tip that has come in on the way is stopped there, and the part is made again.
            match if round > 0 { Ok(false) } else { self.meets() } {
                Err(why) => break Err(why),
                Ok(true) => self.tissue.deform(self.trial.forces_on_tissue()),
                Ok(false) => {
                    let (links, forces) = self.island.links();
                    self.room.press(links, forces);
                    self.island.finish(&material, dt, fractions, &surroundings);
                    break Ok(());
                }
            }
            round += 1;
        };
        self.spared = spared;
        found?;
        self.feel(fractions, here.around);
        self.commit(dt, &here.around.gravity)
    }

    /// Adds the forces of this part to what grips and tissue feel, by its share of the step.
    fn feel(&mut self, fractions: [f64; 2], around: &StepInputs<'_>) {
        let weight = fractions[1] - fractions[0];
        let (layout, tied) = (self.room.layout, self.island.tied());
        for (index, gripped) in self.gripped.iter_mut().enumerate() {
            let first = layout.grips + 2 * index;
            let [place, turn] = [tied[first], tied[first + 1]];
            gripped.force += Vector3::from(place.force) * weight;
            gripped.torque += Vector3::from(turn.force) * weight;
            let grip = &around.grips[index];
            // What gives way stays where its spring is stretched by what it can hold.
            let given = |of: &Tied| Vector3::from_fn(|k, _| if of.gives_way[k] { of.gap[k] } else { 0.0 });
            let (by, turn) = (given(&place), given(&turn));
            gripped.slipped = (by != Vector3::zeros() || turn != Vector3::zeros()).then(|| {
                let rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * grip.to.rotation;
                let translation = grip.to * grip.point + by - rotation * grip.point;
                Isometry3::from_parts(translation.into(), rotation)
            });
        }
        for tie in layout.channel..layout.sides {
            self.on_tissue -= self.room.force(tied, tie) * weight;
        }
        self.on_tissue += self.room.presses.iter().map(|press| press.force).sum::<Vector3<f64>>() * weight;
    }

    fn tell(&self, report: &mut SutureReport, of_thread: &ThreadReport) {
        report.iterations = of_thread.iterations;
        report.sweeps = of_thread.sweeps;
        report.ties = self.island.tied().len();
        report.contacts = of_thread.contacts;
        report.penetration_max = of_thread.penetration_max;
        report.force_on_tissue = self.on_tissue;
        report.tip_force = self.state.tip_force.norm();
        let (state, length) = (&self.state, self.solid.shape().length());
        for (index, point) in state.channel.iter().enumerate() {
            let share = needle_tissue::share_of_channel(state, index, length);
            report.length_inside += share;
            let Some(site) = self.room.sites.get(index) else { continue };
            let along = point.force.dot(&site.tangent);
            report.drag += along.abs();
            if share > 0.25 * self.resistance.spacing {
                let across = (point.force - site.tangent * along).norm();
                report.across_max = report.across_max.max(across / share);
            }
        }
    }

    fn check(&self, dt: f64, around: &StepInputs<'_>) -> Result<(), SutureError> {
        let nodes = self.state.thread.as_ref().map_or(0, |thread| thread.positions.len());
        let whole = Here { around, obstacles: around.obstacles, began: &[] };
        let sound = check_step(dt).and_then(|()| whole.surroundings(&[]).check(nodes));
        sound.map_err(|error| match error {
            ThreadStepError::Given { what, index, why } => SutureError::Given { what, index, why },
            _ => SutureError::Number { what: "the step", value: dt, valid: "above 0, at most 2 ms" },
        })?;
        let is_pose = |pose: &Isometry3<f64>| {
            pose.translation.vector.iter().all(|x| x.is_finite()) && (pose.rotation.norm() - 1.0).abs() < 1e-6
        };
        for (index, grip) in around.grips.iter().enumerate() {
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

/// The room of a list for another one, of what lives at another time.
fn emptied<'b>(mut list: Vec<Obstacle<'_>>) -> Vec<Obstacle<'b>> {
    list.clear();
    // Collected in place.
    list.into_iter().map_while(|_| None).collect()
}

/// What is around needle and thread in a step: what was given, and the tissue as the last obstacle.
struct Here<'a> {
    around: &'a StepInputs<'a>,
    obstacles: &'a [Obstacle<'a>],
    /// Nodes of the tissue when the step began.
    began: &'a [Point3<f64>],
}

impl Here<'_> {
    fn surroundings<'b>(&'b self, spared: &'b [Spared]) -> Surroundings<'b> {
        Surroundings {
            gravity: self.around.gravity,
            holds: self.around.holds,
            twist_holds: self.around.twist_holds,
            loads: self.around.loads,
            obstacles: self.obstacles,
            spared,
            ..Surroundings::default()
        }
    }
}
