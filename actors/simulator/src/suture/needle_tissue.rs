//! Needle and tissue as bodies coupled to the thread in its island: their joints at an iterate, their compliance, and
//! their motion under the resulting forces (as in Duriez, Guébert, Marchal, Cotin, Grisoni 2009, *Interactive
//! simulation of flexible needle insertions based on constraint models*, for tissue and needle).

use nalgebra::{Isometry3, Matrix3, Point3, Vector3, Vector6};

use super::StepInputs;
use super::joints::{self, Joint, JointPoint, Mobility, Pair};
use super::material::Resistance;
use super::needle::{NeedleState, Solid};
use super::needle_obstacle_contact::NeedleTouches;
use super::needle_thread_contact::{self, Strand};
use super::state::{NeedleContact, StrandContact, SutureState, Tip};
use super::tissue::{Tissue, TissueFeature};
use super::tissue_surface::{self, NeedleSide};
use crate::suture_thread::contact::{ForceLaw, Motion, tangents};
use crate::suture_thread::discrete_elastic_rod::RodIterate;
use crate::suture_thread::elastic::SurfaceForce;
use crate::suture_thread::island::coupled_body::{
    ComplianceRows, CoupledBody, Link, Tie, TieResult, Tolerance,
};
use crate::suture_thread::{FailureCause, Obstacle, ThreadMaterial};

/// Convergence criteria of a substep: momentum exchanged by needle and thread agrees to the last relevant digit.
const TOLERANCE: Tolerance =
    Tolerance { free: (1e-8, 1e-6), touching: (1e-6, 2e-4), moved_at_most: 1e-4, iterations: 8 };
/// Limit of the needle's translation \[m\] and rotation \[rad\] in one substep.
const WAY_MAX: f64 = 2.5e-3;
const TURN_MAX: f64 = 0.2;
/// Search range along the thread for a channel point, around its previous arc length \[m\].
const WINDOW: f64 = 6e-3;

/// Where the ties of each kind begin.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TieLayout {
    /// Two per grip: position and rotation.
    pub grips: usize,
    /// One per channel point.
    pub channel: usize,
    pub tip: Option<usize>,
    /// One per needle contact near the surface.
    pub sides: usize,
    /// One per strand near the needle.
    pub strands: usize,
    /// One per place where an instrument or a rigid body touches the needle.
    pub touches: usize,
}

/// Workspace and results of a substep.
#[derive(Clone, Debug, Default)]
pub(super) struct Workspace {
    /// Needle at the iterate.
    pub needle: Option<NeedleState>,
    pub layout: TieLayout,
    /// Sites of the channel points, in their order.
    pub sites: Vec<JointPoint>,
    pub sides: Vec<NeedleSide>,
    pub strands: Vec<Strand>,
    /// Places where obstacles may touch the needle; those that ties stand for, with the point in the world.
    pub touches: NeedleTouches,
    pub touched: Vec<(usize, Point3<f64>)>,
    /// Joints of all ties, in their order.
    pub joints: Vec<Joint>,
    /// Directions of their rows.
    pub directions: Vec<[Vector3<f64>; 3]>,
    /// Contact forces on the surface, at the end of the substep.
    pub presses: Vec<SurfaceForce>,
    forces: Vec<[f64; 3]>,
    answers: Vec<[Vector6<f64>; 3]>,
    spots: Vec<Option<TissueFeature>>,
    mutual: Vec<Matrix3<f64>>,
    mobility: Option<Mobility>,
    left: Vector6<f64>,
}

impl Workspace {
    /// Force of a tie on needle or thread \[N\].
    pub fn force(&self, tied: &[TieResult], tie: usize) -> Vector3<f64> {
        vector(&self.directions[tie], &tied[tie].force)
    }

    /// Stores the contact forces on the surface.
    pub fn press(&mut self, links: &[Link], forces: &[[f64; 3]]) {
        self.presses.clear();
        for (link, force) in links.iter().zip(forces).filter(|(_, force)| force[0] > 0.0) {
            let (at, directions) = match link {
                Link::Surface(place, directions) => (*place, directions),
                Link::Tie(tie) => match self.joints[*tie].tissue {
                    Some(TissueFeature::Surface(place)) => (place, &self.directions[*tie]),
                    _ => continue,
                },
            };
            self.presses.push(SurfaceForce { at, force: -vector(directions, force) });
        }
    }
}

/// Needle and tissue during a substep, as the thread's coupled body.
pub(super) struct Sewing<'a> {
    pub solid: &'a Solid,
    pub thread: Option<&'a ThreadMaterial>,
    pub resistance: &'a Resistance,
    /// State at the beginning of the substep.
    pub start: &'a SutureState,
    pub tissue: &'a mut Tissue,
    pub workspace: &'a mut Workspace,
    pub surroundings: &'a StepInputs<'a>,
    /// All obstacles, the tissue's surface included.
    pub obstacles: &'a [Obstacle<'a>],
    pub dt: f64,
    pub fractions: [f64; 2],
    /// Obstacle index of the tissue's surface.
    pub surface: usize,
    /// Tissue nodes at the beginning of the step, from which the surface's contacts are measured.
    pub step_began: &'a [Point3<f64>],
}

impl Sewing<'_> {
    /// Begins a substep.
    pub fn begin(&mut self) {
        self.workspace.needle = Some(self.start.needle);
        self.workspace.forces.clear();
        self.workspace.sites.clear();
        self.workspace.presses.clear();
        tissue_surface::sides(
            self.solid,
            self.start,
            self.tissue,
            self.resistance,
            self.dt,
            &mut self.workspace.sides,
        );
        let radius = self.thread.map_or(0.0, |thread| thread.radius);
        needle_thread_contact::near(self.solid, self.start, radius, self.dt, &mut self.workspace.strands);
    }

    /// Residual force and torque of the needle's inertia and weight at the iterate.
    fn residual(&self, needle: &NeedleState) -> Vector6<f64> {
        let (start, solid, dt) = (self.start, self.solid, self.dt);
        let moved = needle.center - start.needle.center;
        let turned = (needle.rotation * start.needle.rotation.inverse()).scaled_axis();
        let weight = self.surroundings.gravity * solid.mass();
        let force = (start.needle.momentum - moved * (solid.mass() / dt)) / dt + weight;
        let torque = (start.needle.angular_momentum - needle.inertia(solid) * turned / dt) / dt;
        Vector6::new(force.x, force.y, force.z, torque.x, torque.y, torque.z)
    }

    fn push(&mut self, (joint, mut tie): Pair, free: &Vector6<f64>, ties: &mut Vec<Tie>) {
        for k in 0..3 {
            tie.gap[k] += joint.needle[k].dot(free);
        }
        self.workspace.directions.push(tie.rows.directions);
        self.workspace.joints.push(joint);
        ties.push(tie);
    }

    /// A channel point: friction along the channel, constrained laterally.
    fn pass(&mut self, needle: &NeedleState, at: &RodIterate, index: usize) -> Pair {
        let point = &self.start.channel[index];
        let now = self.tissue.now(&point.place);
        let last = self.workspace.sites.get(index).map_or(point.along, |site| site.along);
        let site = self.site(needle, at, &now, last);
        if index < self.workspace.sites.len() {
            self.workspace.sites[index] = site;
        } else {
            self.workspace.sites.push(site);
        }
        let [n1, n2] = joints::across(&site.tangent, &(needle.pose() * Vector3::z()));
        let directions = [site.tangent, n1, n2];
        let feature = TissueFeature::Inside(point.place);
        let (joint, mut tie) = joints::passage(&site, &needle.center, feature, &now, directions);
        let length = share_of_channel(self.start, index, self.solid.shape().length());
        let material = self.resistance;
        let (grip, friction) = match site.edge {
            None => (material.needle_grip, material.needle_friction),
            Some(_) => (material.thread_grip, material.thread_friction),
        };
        let radius = match (site.edge, self.thread) {
            (Some(_), Some(thread)) => thread.radius,
            _ => self.solid.shape().wire_radius,
        };
        let share = length.max(0.25 * material.spacing);
        for yields in &mut tie.yields[1..] {
            *yields += self.tissue.gives_way_about(radius) / share;
        }
        tie.gap[0] = point.stuck - site.along;
        tie.law = ForceLaw::Passes { base: grip * length, friction };
        self.relax(&mut tie, &feature);
        tie.force = directions.map(|direction| point.force.dot(&direction));
        (joint, tie)
    }

    /// Converts gaps against the current tissue to gaps against the tissue at rest.
    fn relax(&self, tie: &mut Tie, feature: &TissueFeature) {
        let displaced = self.tissue.displaced(feature);
        for k in 0..3 {
            tie.gap[k] += tie.rows.directions[k].dot(&displaced);
        }
    }

    /// The point of needle or thread at a point of the world, near an arc length.
    fn site(&self, needle: &NeedleState, rod: &RodIterate, at: &Point3<f64>, near: f64) -> JointPoint {
        let (pose, solid) = (needle.pose(), self.solid);
        let along = solid.nearest(&pose.inverse_transform_point(at));
        let is_near = near > -2e-3 && along >= 0.0 && (along - near).abs() < 5e-3;
        let thread = self.start.thread.as_ref().filter(|_| !is_near);
        let Some(thread) = thread else {
            let tangent = pose * solid.tangent(along);
            return JointPoint { along, point: pose * solid.point(along), tangent, edge: None };
        };
        // Rest lengths are used: stretch elsewhere along the thread is no sliding here.
        let mut best: Option<(f64, JointPoint)> = None;
        let mut last = (0, 0.0);
        for (edge, [begin, end]) in thread.spans() {
            if begin > WINDOW - near {
                break;
            }
            last = (edge, end);
            if end < -near - WINDOW {
                continue;
            }
            let (from, tangent, length) = (rod.positions[edge], rod.tangents[edge], rod.lengths[edge]);
            let share = ((at - from).dot(&tangent) / length).clamp(0.0, 1.0);
            let point = from + tangent * (share * length);
            let distance = (at - point).norm_squared();
            if best.as_ref().is_none_or(|(known, _)| distance < *known) {
                let along = -(begin + share * thread.rest_lengths[edge]);
                let site = JointPoint { along, point, tangent: -tangent, edge: Some((edge, share)) };
                best = Some((distance, site));
            }
        }
        let (edge, end) = last;
        best.map_or_else(
            || JointPoint {
                along: -end,
                point: rod.positions[edge + 1],
                tangent: -rod.tangents[edge],
                edge: Some((edge, 1.0)),
            },
            |(_, site)| site,
        )
    }

    /// The tip in contact with the tissue.
    fn tip(&self, needle: &NeedleState) -> Option<Pair> {
        let pose = needle.pose();
        let length = self.solid.shape().length();
        let tangent = pose * self.solid.tangent(length);
        let place = self.start.tip.place()?;
        let site = JointPoint { along: length, point: pose * self.solid.point(length), tangent, edge: None };
        let material = self.resistance;
        // Bounded force along the path, and constrained laterally.
        let within = |most: f64| {
            let (least, unbound) = ([-most, f64::NEG_INFINITY, f64::NEG_INFINITY], f64::INFINITY);
            ForceLaw::Within { least, most: [0.0, unbound, unbound] }
        };
        // The first direction is that of the tip's motion.
        let (first, along, law) = match self.start.tip {
            Tip::Touching(_, triangle) => {
                let (friction, most) = (material.needle_friction, material.puncture_force);
                (self.tissue.normal(triangle), tangent, ForceLaw::Skin { friction, most })
            }
            Tip::Leaving(..) => (tangent, pose * Vector3::z(), within(material.exit_force)),
            _ => (tangent, pose * Vector3::z(), within(material.cutting_force)),
        };
        let [n1, n2] = joints::across(&first, &along);
        let (feature, now) = (TissueFeature::Inside(*place), self.tissue.now(place));
        let (joint, mut tie) = joints::passage(&site, &needle.center, feature, &now, [first, n1, n2]);
        tie.law = law;
        tie.force = [first, n1, n2].map(|direction| self.start.tip_force.dot(&direction));
        self.relax(&mut tie, &feature);
        Some((joint, tie))
    }

    /// The needle's body near the surface as it was at the beginning of the substep.
    fn side(&self, needle: &NeedleState, side: &NeedleSide) -> Pair {
        let [before, now] = [&self.start.needle, needle].map(|of| of.pose() * self.solid.point(side.along));
        let [t1, t2] = tangents(&side.normal, &(needle.pose() * self.solid.tangent(side.along)));
        let directions = [side.normal, t1, t2];
        let feature = TissueFeature::Surface(side.place);
        let from_rest = self.tissue.displaced_before(&feature);
        let known = self.start.needle_contacts.iter().find(|known| known.sample == side.sample);
        let drawn = known.map_or(Vector3::zeros(), |known| known.drawn);
        let gap = [
            side.normal.dot(&(now - side.point + from_rest)) - side.radius,
            t1.dot(&(now - before + drawn + from_rest)),
            t2.dot(&(now - before + drawn + from_rest)),
        ];
        let touching = now - side.normal * side.radius;
        let friction = self.resistance.needle_friction;
        let (joint, mut tie) = joints::side(needle, &touching, feature, directions, gap, friction);
        let force = known.map_or(Vector3::zeros(), |known| known.force);
        tie.force = tie.law.confined(directions.map(|direction| force.dot(&direction)));
        (joint, tie)
    }

    /// Compliance between points of the tissue; computed only for new ones.
    fn mutual(&mut self, links: &[Link]) -> Result<(), FailureCause> {
        let count = links.len();
        let Workspace { spots, mutual, joints, .. } = &mut *self.workspace;
        let same = spots.len() == count;
        if !same {
            spots.clear();
            mutual.clear();
            mutual.resize(count * count, Matrix3::zeros());
        }
        for (i, link) in links.iter().enumerate() {
            let own = match link {
                Link::Tie(tie) => joints[*tie].tissue,
                Link::Surface(place, _) => Some(TissueFeature::Surface(*place)),
            };
            if same && spots[i] == own {
                continue;
            }
            if let Some(feature) = &own
                && !self.tissue.name_spot(feature)
            {
                return Err(FailureCause::Full);
            }
            if same {
                spots[i] = own;
            } else {
                spots.push(own);
            }
            let known = if same { count } else { i + 1 };
            for (j, other) in spots[..known].iter().enumerate() {
                let (Some(own), Some(other)) = (&own, other) else { continue };
                // Always the later point's response to the earlier one, so that rounding does not depend on when it was
                // found.
                let (a, b, later, earlier) = if i < j { (j, i, other, own) } else { (i, j, own, other) };
                let between = self.tissue.between(later, earlier);
                mutual[a * count + b] = between;
                mutual[b * count + a] = between.transpose();
            }
        }
        Ok(())
    }
}

impl CoupledBody for Sewing<'_> {
    fn begin(&mut self, dt: f64, motions: &[Motion]) {
        let (surface, passes) = (self.surface, self.surroundings.needle_passes);
        self.workspace.touches.find(
            self.solid,
            &self.start.needle,
            (self.obstacles, motions),
            |index| index != surface && !passes.contains(&index),
            dt,
        );
    }

    fn surface(&self) -> Option<usize> {
        self.thread.map(|_| self.surface)
    }

    fn swept(&self) -> Option<[&[Point3<f64>]; 2]> {
        Some([self.tissue.before(), self.tissue.positions()])
    }

    fn stops(&self, way: [&[Point3<f64>]; 2], motions: &[Motion]) -> Option<usize> {
        let needle = self.workspace.needle?;
        let both = [&self.start.needle, &needle];
        if self.workspace.touches.passes(self.solid, both, (self.obstacles, motions)) {
            return Some(0);
        }
        let material = self.thread?;
        needle_thread_contact::passes(self.solid, material.radius, self.start, &needle, way)
    }

    fn is_sharp(&self, triangle: u32, rim: usize) -> bool {
        self.tissue.is_sharp(triangle, rim)
    }

    fn tolerance(&self) -> Option<Tolerance> {
        Some(TOLERANCE)
    }

    fn tie(&mut self, at: &RodIterate, motions: &[Motion], ties: &mut Vec<Tie>) -> Result<(), FailureCause> {
        let needle = self.workspace.needle.unwrap_or(self.start.needle);
        let mobility = Mobility::new(self.solid, &needle, self.dt).ok_or(FailureCause::NoInertia)?;
        self.workspace.left = self.residual(&needle);
        let free = mobility.answer(&self.workspace.left);
        self.workspace.mobility = Some(mobility);
        self.workspace.joints.clear();
        self.workspace.directions.clear();
        if self.thread.is_some() {
            for pair in joints::swage(self.solid, &needle, at, self.start.swage_turn) {
                self.push(pair, &free, ties);
            }
        }
        self.workspace.layout.grips = ties.len();
        for grip in self.surroundings.grips {
            let wanted = between(&grip.from, &grip.to, self.fractions[1]);
            for pair in joints::grip(&needle, &wanted, grip) {
                self.push(pair, &free, ties);
            }
        }
        self.workspace.layout.channel = ties.len();
        for index in 0..self.start.channel.len() {
            let pair = self.pass(&needle, at, index);
            self.push(pair, &free, ties);
        }
        self.workspace.layout.tip = None;
        if let Some(pair) = self.tip(&needle) {
            self.workspace.layout.tip = Some(ties.len());
            self.push(pair, &free, ties);
        }
        self.workspace.layout.sides = ties.len();
        for index in 0..self.workspace.sides.len() {
            let pair = self.side(&needle, &self.workspace.sides[index]);
            self.push(pair, &free, ties);
        }
        self.workspace.layout.strands = ties.len();
        if let Some(material) = self.thread {
            for index in 0..self.workspace.strands.len() {
                let strand = self.workspace.strands[index];
                let pair =
                    needle_thread_contact::contact(self.solid, material, (self.start, &needle), at, &strand);
                self.push(pair, &free, ties);
            }
        }
        self.workspace.layout.touches = ties.len();
        self.workspace.touched.clear();
        for index in 0..self.workspace.touches.list.len() {
            let touch = self.workspace.touches.list[index];
            let of = (&self.obstacles[touch.obstacle], &motions[touch.obstacle]);
            let both = [&self.start.needle, &needle];
            if let Some((pair, at)) = self.workspace.touches.contact(self.solid, both, of, &touch) {
                self.push(pair, &free, ties);
                self.workspace.touched.push((touch.obstacle, at));
            }
        }
        if self.workspace.forces.len() == ties.len() {
            ties.iter_mut().zip(&self.workspace.forces).for_each(|(tie, force)| tie.force = *force);
        }
        Ok(())
    }

    fn join(&mut self, links: &[Link], compliance_rows: ComplianceRows<'_>) -> Result<(), FailureCause> {
        self.mutual(links)?;
        let count = links.len();
        let rows = 3 * count;
        let Workspace { joints, answers, mutual, spots, directions, mobility, .. } = &mut *self.workspace;
        let Some(mobility) = mobility else { return Err(FailureCause::NoInertia) };
        answers.clear();
        answers.extend(joints.iter().map(|joint| joint.needle.map(|load| mobility.answer(&load))));
        let directions = |link: &Link| match link {
            Link::Tie(tie) => directions[*tie],
            Link::Surface(_, directions) => *directions,
        };
        for (i, link) in links.iter().enumerate() {
            let own = directions(link);
            if let (Link::Surface(..), Some(feature)) = (link, &spots[i]) {
                let since_step = self.tissue.displaced_when(feature, self.step_began);
                let since_part = self.tissue.displaced_before(feature);
                for (k, by) in [since_step, since_part, since_part].iter().enumerate() {
                    compliance_rows.base[3 * i + k] = own[k].dot(by);
                }
            }
            for (j, other) in links[..=i].iter().enumerate() {
                let toward = directions(other);
                let both = spots[i].is_some() && spots[j].is_some();
                for (k, m) in (0..3).flat_map(|k| (0..3).map(move |m| (k, m))) {
                    let mut value = 0.0;
                    if let (Link::Tie(a), Link::Tie(b)) = (link, other) {
                        value += joints[*a].needle[k].dot(&answers[*b][m]);
                    }
                    if both {
                        value += own[k].dot(&(mutual[i * count + j] * toward[m]));
                    }
                    let (row, column) = (3 * i + k, 3 * j + m);
                    compliance_rows.compliance[column * rows + row] = value;
                    compliance_rows.compliance[row * rows + column] = value;
                }
            }
        }
        Ok(())
    }

    fn advance(&mut self, links: &[Link], forces: &[[f64; 3]]) -> Result<f64, FailureCause> {
        let Workspace { joints, directions, spots, needle, mobility, left, forces: kept, .. } =
            &mut *self.workspace;
        let mut load = *left;
        kept.clear();
        kept.resize(joints.len(), [0.0; 3]);
        for (link, force) in links.iter().zip(forces) {
            let Link::Tie(tie) = *link else { continue };
            kept[tie] = *force;
            for (row, force) in joints[tie].needle.iter().zip(force) {
                load += row * *force;
            }
        }
        let (Some(mobility), Some(needle)) = (mobility, needle) else { return Err(FailureCause::NoInertia) };
        let by = mobility.answer(&load);
        let (way, turn) = (by.fixed_rows::<3>(0).norm(), by.fixed_rows::<3>(3).norm());
        if !(way <= WAY_MAX && turn <= TURN_MAX) {
            return Err(FailureCause::TooFar);
        }
        *needle = joints::carried(needle, &by);
        let on_tissue = links.iter().zip(forces).zip(&*spots).filter_map(|((link, force), feature)| {
            let directions = match link {
                Link::Tie(tie) => &directions[*tie],
                Link::Surface(_, directions) => directions,
            };
            Some((feature.as_ref().copied()?, -vector(directions, force)))
        });
        self.tissue.deform(on_tissue);
        Ok(way.max(turn * self.solid.shape().radius))
    }

    fn finish(&mut self, links: &[Link], forces: &[[f64; 3]]) {
        self.workspace.press(links, forces);
    }
}

/// Results of the needle's surface contacts at the end of a substep.
pub(super) fn touched(workspace: &Workspace, tied: &[TieResult], contacts: &mut Vec<NeedleContact>) {
    contacts.clear();
    for (index, side) in workspace.sides.iter().enumerate() {
        let tie = workspace.layout.sides + index;
        let force = tied[tie].force;
        if force[0] > 0.0 {
            let [_, t1, t2] = workspace.directions[tie];
            contacts.push(NeedleContact {
                sample: side.sample,
                force: workspace.force(tied, tie),
                drawn: (t1 * force[1] + t2 * force[2]) * -joints::COMPLIANCE,
            });
        }
    }
}

/// Results of strand contacts with the needle at the end of a substep.
pub(super) fn crossed(workspace: &Workspace, tied: &[TieResult], contacts: &mut Vec<StrandContact>) {
    let first = workspace.layout.strands;
    let forces = (0..workspace.strands.len())
        .map(|index| (tied[first + index].force, workspace.directions[first + index]));
    needle_thread_contact::remember(&workspace.strands, forces, contacts);
}

fn vector(directions: &[Vector3<f64>; 3], force: &[f64; 3]) -> Vector3<f64> {
    directions[0] * force[0] + directions[1] * force[1] + directions[2] * force[2]
}

/// Length of channel represented by a point \[m\]: half of the distance to either neighbour in its bite, and the full
/// distance to a tip in the tissue.
pub(super) fn share_of_channel(state: &SutureState, index: usize, needle_length: f64) -> f64 {
    let own = &state.channel[index];
    let neighbour = |other: Option<&super::state::ChannelPoint>| {
        other.filter(|other| other.bite == own.bite).map(|other| (other.along - own.along).abs())
    };
    let before = index.checked_sub(1).and_then(|before| neighbour(state.channel.get(before)));
    let after = neighbour(state.channel.get(index + 1));
    let ahead = match (after, &state.tip) {
        (Some(way), _) => 0.5 * way,
        (None, Tip::Inside(_) | Tip::Leaving(..)) if index + 1 == state.channel.len() => {
            (needle_length - own.along).max(0.0)
        }
        _ => 0.0,
    };
    ahead + 0.5 * before.unwrap_or(0.0)
}

/// Interpolates between two poses.
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    from.try_lerp_slerp(to, share, 1e-12).unwrap_or(*to)
}
