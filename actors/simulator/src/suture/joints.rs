//! Joints between needle, thread and tissue, as three constraint rows each: directions, gaps and force laws.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3, Vector6};

use super::needle::{NeedleState, Solid};
use super::tissue::TissueFeature;
use crate::linear_algebra::block_banded::Cell;
use crate::suture_thread::bishop_frame::{angle_about, perpendicular};
use crate::suture_thread::contact::{ForceLaw, Rows};
use crate::suture_thread::discrete_elastic_rod::RodIterate;
use crate::suture_thread::island::coupled_body::Tie;

/// Compliance of a row \[m/N\]: some micrometres under suturing forces, far less than the tissue's around one wire, and
/// enough to regularise two rows at one point.
pub(super) const COMPLIANCE: f64 = 1e-6;

/// A joint's action on needle and tissue; its tie is its action on the thread.
#[derive(Clone, Copy, Debug)]
pub(super) struct Joint {
    /// On the needle: force, and torque about its centre of mass, per force of each row.
    pub needle: [Vector6<f64>; 3],
    /// Point in the tissue. The directions are those of the tie's rows.
    pub tissue: Option<TissueFeature>,
}

/// A joint and its tie.
pub(super) type Pair = (Joint, Tie);

fn pair(directions: [Vector3<f64>; 3], gap: [f64; 3], law: ForceLaw) -> Pair {
    let rows = Rows { nodes: [0; 4], cells: [[Cell::zeros(); 4]; 3], used: 0, directions };
    let tie = Tie { rows, law, gap, yields: [COMPLIANCE; 3], force: [0.0; 3], obstacle: None };
    (Joint { needle: [Vector6::zeros(); 3], tissue: None }, tie)
}

fn cell(direction: &Vector3<f64>, weight: f64) -> Cell {
    Cell::new(direction.x * weight, direction.y * weight, direction.z * weight, 0.0)
}

fn on_needle(direction: &Vector3<f64>, arm: &Vector3<f64>) -> Vector6<f64> {
    let turn = arm.cross(direction);
    Vector6::new(direction.x, direction.y, direction.z, turn.x, turn.y, turn.z)
}

const AXES: fn() -> [Vector3<f64>; 3] = || [Vector3::x(), Vector3::y(), Vector3::z()];

/// A point on needle or thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct JointPoint {
    /// Arc length from the swage \[m\].
    pub along: f64,
    /// Position in the world \[m\].
    pub point: Point3<f64>,
    /// Tangent towards the tip.
    pub tangent: Vector3<f64>,
    /// Thread edge and fraction along it; `None` on the needle.
    pub edge: Option<(usize, f64)>,
}

/// Two directions perpendicular to a tangent: those of the needle's plane where there is one.
pub(super) fn across(tangent: &Vector3<f64>, near: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = perpendicular(near, tangent);
    [first, tangent.cross(&first)]
}

/// A site against a channel point that is at `now`: displacement of the site from it in each direction.
pub(super) fn passage(
    site: &JointPoint,
    center: &Point3<f64>,
    feature: TissueFeature,
    now: &Point3<f64>,
    directions: [Vector3<f64>; 3],
) -> Pair {
    let gap = directions.map(|direction| direction.dot(&(site.point - now)));
    let (mut joint, mut tie) = pair(directions, gap, ForceLaw::HELD);
    joint.tissue = Some(feature);
    match site.edge {
        Some((edge, share)) => {
            (tie.rows.nodes[0], tie.rows.nodes[1], tie.rows.used) = (edge as u32, edge as u32 + 1, 2);
            for (cells, direction) in tie.rows.cells.iter_mut().zip(&directions) {
                (cells[0], cells[1]) = (cell(direction, 1.0 - share), cell(direction, share));
            }
        }
        None => joint.needle = directions.map(|direction| on_needle(&direction, &(site.point - center))),
    }
    (joint, tie)
}

/// The swage: the thread's first node in the tail, its second on the tail's tangent, and its turn that of the needle.
pub(super) fn swage(solid: &Solid, needle: &NeedleState, at: &RodIterate, turn: f64) -> [Pair; 2] {
    let pose = needle.pose();
    let tail = pose * solid.point(0.0);
    let tangent = pose * solid.tangent(0.0);
    let axes = AXES();
    let gap = axes.map(|axis| axis.dot(&(at.positions[0] - tail)));
    let mut first = pair(axes, gap, ForceLaw::HELD);
    first.0.needle = axes.map(|axis| -on_needle(&axis, &(at.positions[0] - needle.center)));
    first.1.rows.used = 2;
    first.1.rows.nodes = [0, 1, 0, 0];
    for (cells, axis) in first.1.rows.cells.iter_mut().zip(&axes) {
        cells[0] = cell(axis, 1.0);
    }
    let second = at.positions[1];
    let [n1, n2] = across(&tangent, &(pose * Vector3::z()));
    let axis = at.tangents[0];
    let wanted = perpendicular(&(pose * Vector3::z()), &axis);
    let mut turned = angle_about(&wanted, &at.directors[0], &axis) - turn;
    turned -= (turned / std::f64::consts::TAU).round() * std::f64::consts::TAU;
    let gap = [n1.dot(&(second - tail)), n2.dot(&(second - tail)), turned];
    let mut line = pair([n1, n2, axis], gap, ForceLaw::HELD);
    // The tangent rotates with the needle, so that the force acts at the node.
    let arm = second - needle.center;
    line.0.needle = [
        -on_needle(&n1, &arm),
        -on_needle(&n2, &arm),
        Vector6::new(0.0, 0.0, 0.0, -axis.x, -axis.y, -axis.z),
    ];
    line.1.rows.used = 2;
    line.1.rows.nodes = [0, 1, 0, 0];
    line.1.rows.cells[0][1] = cell(&n1, 1.0);
    line.1.rows.cells[1][1] = cell(&n2, 1.0);
    line.1.rows.cells[2][0] = Cell::new(0.0, 0.0, 0.0, 1.0);
    [first, line]
}

/// A jaw's grip on a point of the needle: position error and rotation error from the wanted pose.
pub(super) fn grip(needle: &NeedleState, wanted: &nalgebra::Isometry3<f64>, grip: &super::Grip) -> [Pair; 2] {
    let pose = needle.pose();
    let point = pose * grip.point;
    let off = point - wanted * grip.point;
    let turned = (pose.rotation * wanted.rotation.inverse()).scaled_axis();
    let within = |most: f64| ForceLaw::Within { least: [-most; 3], most: [most; 3] };
    let axes = AXES();
    let mut place = pair(axes, off.into(), within(grip.force_max));
    place.0.needle = axes.map(|axis| on_needle(&axis, &(point - needle.center)));
    place.1.yields = [1.0 / grip.stiffness; 3];
    let mut turn = pair(axes, turned.into(), within(grip.torque_max));
    turn.0.needle = axes.map(|axis| Vector6::new(0.0, 0.0, 0.0, axis.x, axis.y, axis.z));
    turn.1.yields = [1.0 / grip.turning_stiffness; 3];
    [place, turn]
}

/// Contact of the needle's body with the surface at a point: `gap` along the first direction, tangential displacement
/// along the others.
pub(super) fn side(
    needle: &NeedleState,
    touching: &Point3<f64>,
    feature: TissueFeature,
    directions: [Vector3<f64>; 3],
    gap: [f64; 3],
    friction: f64,
) -> Pair {
    let (mut joint, tie) = pair(directions, gap, ForceLaw::Contact { friction });
    joint.needle = directions.map(|direction| on_needle(&direction, &(touching - needle.center)));
    joint.tissue = Some(feature);
    (joint, tie)
}

/// Contact of the needle with an obstacle, by its index: the first direction points from it
/// to the needle; `gap` along that, tangential displacement along the others.
pub(super) fn obstacle(
    needle: &NeedleState,
    touching: &Point3<f64>,
    obstacle: usize,
    directions: [Vector3<f64>; 3],
    gap: [f64; 3],
    friction: f64,
) -> Pair {
    let (mut joint, mut tie) = pair(directions, gap, ForceLaw::Contact { friction });
    joint.needle = directions.map(|direction| on_needle(&direction, &(touching - needle.center)));
    tie.obstacle = Some(obstacle);
    (joint, tie)
}

/// Contact of a strand with the needle: `rows` act on the thread, the first direction pointing from the needle to it;
/// `gap` along that, tangential displacement along the others; `force` is the initial force on the strand, in the world
/// \[N\].
pub(super) fn strand(
    needle: &NeedleState,
    touching: &Point3<f64>,
    rows: Rows,
    gap: [f64; 3],
    friction: f64,
    force: &Vector3<f64>,
) -> Pair {
    let directions = rows.directions;
    let (mut joint, mut tie) = pair(directions, gap, ForceLaw::Contact { friction });
    joint.needle = directions.map(|direction| -on_needle(&direction, &(touching - needle.center)));
    tie.rows = rows;
    tie.force = tie.law.confined(directions.map(|direction| force.dot(&direction)));
    (joint, tie)
}

/// Response of the needle to force and torque in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mobility {
    mass: f64,
    inverse_inertia: Matrix3<f64>,
    square: f64,
}

impl Mobility {
    pub fn new(solid: &Solid, needle: &NeedleState, dt: f64) -> Option<Self> {
        let inverse_inertia = needle.inertia(solid).try_inverse()?;
        Some(Self { mass: solid.mass(), inverse_inertia, square: dt * dt })
    }

    /// Displacement and rotation by force and torque over the step.
    pub fn answer(&self, load: &Vector6<f64>) -> Vector6<f64> {
        let by = load.fixed_rows::<3>(0) * (self.square / self.mass);
        let turn = self.inverse_inertia * load.fixed_rows::<3>(3) * self.square;
        Vector6::new(by.x, by.y, by.z, turn.x, turn.y, turn.z)
    }
}

/// The needle displaced and rotated by this much.
pub(super) fn carried(needle: &NeedleState, by: &Vector6<f64>) -> NeedleState {
    let turn = Rotation3::new(by.fixed_rows::<3>(3).into_owned());
    let mut next = *needle;
    next.center += by.fixed_rows::<3>(0);
    next.rotation = nalgebra::UnitQuaternion::from_rotation_matrix(&turn) * needle.rotation;
    next.rotation.renormalize();
    next
}
