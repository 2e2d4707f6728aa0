//! What holds needle, thread and tissue together, as rows: directions at places of them, how far they are from where they
//! should be, and what they may do about it.

use nalgebra::{Matrix3, Point3, Rotation3, Vector3, Vector6};

use super::solve::Law;
use crate::needle::{NeedleState, Solid};
use crate::thread::block_band::Cell;
use crate::thread::frame::{angle_about, perpendicular};
use crate::thread::rod::Iterate;

/// How much a row gives way \[m/N\]: some micrometres under the forces of sewing, far less than the tissue does about one
/// wire, and enough that two rows at one place are not one too many.
pub(super) const COMPLIANCE: f64 = 1e-6;

/// One row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    /// On the needle: force, and torque about its centre, per force of the row.
    pub needle: Vector6<f64>,
    /// On the thread: block rows, and weights on them.
    pub thread: [(u32, Cell); 2],
    /// How many of these are in use.
    pub used: usize,
    /// Against the tissue: which place, and the direction.
    pub tissue: Option<(u32, Vector3<f64>)>,
    /// At the iterate \[m\].
    pub gap: f64,
    /// \[m/N\].
    pub compliance: f64,
    pub law: Law,
    /// To begin with \[N\].
    pub force: f64,
}

impl Row {
    fn new(gap: f64, law: Law) -> Self {
        Self {
            needle: Vector6::zeros(),
            thread: [(0, Cell::zeros()); 2],
            used: 0,
            tissue: None,
            gap,
            compliance: COMPLIANCE,
            law,
            force: 0.0,
        }
    }

    /// How much it moves with a motion of the needle and of the thread.
    pub fn moved(&self, needle: &Vector6<f64>, thread: &[Cell]) -> f64 {
        let of_thread: f64 =
            self.thread[..self.used].iter().map(|(node, cell)| cell.dot(&thread[*node as usize])).sum();
        self.needle.dot(needle) + of_thread
    }
}

fn cell(direction: &Vector3<f64>, weight: f64) -> Cell {
    Cell::new(direction.x * weight, direction.y * weight, direction.z * weight, 0.0)
}

fn on_needle(direction: &Vector3<f64>, arm: &Vector3<f64>) -> Vector6<f64> {
    let turn = arm.cross(direction);
    Vector6::new(direction.x, direction.y, direction.z, turn.x, turn.y, turn.z)
}

/// A place on needle or thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Site {
    /// Arc length from the swage \[m\].
    pub along: f64,
    /// In the world \[m\].
    pub point: Point3<f64>,
    /// Towards the tip.
    pub tangent: Vector3<f64>,
    /// An edge of the thread and the share of it; else on the needle.
    pub edge: Option<(usize, f64)>,
}

/// Two directions across a tangent: those of the needle's plane where there is one.
pub(super) fn across(tangent: &Vector3<f64>, near: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = perpendicular(near, tangent);
    [first, tangent.cross(&first)]
}

/// Directions of a site against a place in the tissue: how far the site is ahead of it in each.
pub(super) fn passage(
    site: &Site,
    center: &Point3<f64>,
    place: (u32, &Point3<f64>),
    directions: &[Vector3<f64>; 3],
) -> [Row; 3] {
    directions.map(|direction| {
        let mut row = Row::new(direction.dot(&(site.point - place.1)), Law::Held);
        row.tissue = Some((place.0, direction));
        match site.edge {
            Some((edge, share)) => {
                row.thread = [
                    (edge as u32, cell(&direction, 1.0 - share)),
                    (edge as u32 + 1, cell(&direction, share)),
                ];
                row.used = 2;
            }
            None => row.needle = on_needle(&direction, &(site.point - center)),
        }
        row
    })
}

/// The thread's first node in the tail, its second in the line of the tail, and its turn that of the needle.
pub(super) fn swage(solid: &Solid, needle: &NeedleState, at: &Iterate, turn: f64) -> [Row; 6] {
    let pose = needle.pose();
    let tail = pose * solid.point(0.0);
    let tangent = pose * solid.tangent(0.0);
    let blank = Row::new(0.0, Law::Held);
    let mut rows = [blank; 6];
    for (row, direction) in rows.iter_mut().zip([Vector3::x(), Vector3::y(), Vector3::z()]) {
        row.gap = direction.dot(&(at.positions[0] - tail));
        row.needle = -on_needle(&direction, &(at.positions[0] - needle.center));
        (row.thread[0], row.used) = ((0, cell(&direction, 1.0)), 1);
    }
    let second = at.positions[1];
    for (row, direction) in rows[3..].iter_mut().zip(across(&tangent, &(pose * Vector3::z()))) {
        row.gap = direction.dot(&(second - tail));
        // The line turns with the needle: so the force acts where the node is.
        row.needle = -on_needle(&direction, &(second - needle.center));
        (row.thread[0], row.used) = ((1, cell(&direction, 1.0)), 1);
    }
    let axis = at.tangents[0];
    let wanted = perpendicular(&(pose * Vector3::z()), &axis);
    let row = &mut rows[5];
    row.gap = angle_about(&wanted, &at.directors[0], &axis) - turn;
    row.gap -= (row.gap / std::f64::consts::TAU).round() * std::f64::consts::TAU;
    row.needle = Vector6::new(0.0, 0.0, 0.0, -axis.x, -axis.y, -axis.z);
    (row.thread[0], row.used) = ((0, Cell::new(0.0, 0.0, 0.0, 1.0)), 1);
    rows
}

/// A jaw on the needle, at a point of it: as far as it is from where the jaw wants it, and turned from that.
pub(super) fn grip(needle: &NeedleState, wanted: &nalgebra::Isometry3<f64>, grip: &super::Grip) -> [Row; 6] {
    let pose = needle.pose();
    let point = pose * grip.point;
    let off = point - wanted * grip.point;
    let turned = (pose.rotation * wanted.rotation.inverse()).scaled_axis();
    std::array::from_fn(|k| {
        let axis = Vector3::ith(k % 3, 1.0);
        let (most, stiffness, gap) = if k < 3 {
            (grip.force_max, grip.stiffness, off[k])
        } else {
            (grip.torque_max, grip.turning_stiffness, turned[k - 3])
        };
        let mut row = Row::new(gap, Law::Within { least: -most, most });
        row.compliance = 1.0 / stiffness;
        row.needle = if k < 3 {
            on_needle(&axis, &(point - needle.center))
        } else {
            Vector6::new(0.0, 0.0, 0.0, axis.x, axis.y, axis.z)
        };
        row
    })
}

/// A node of the thread that is led.
pub(super) fn hold(at: &Iterate, hold: &crate::thread::Hold, to: &Point3<f64>) -> [Row; 3] {
    std::array::from_fn(|k| {
        let axis = Vector3::ith(k, 1.0);
        let law = Law::Within { least: -hold.force_max, most: hold.force_max };
        let mut row = Row::new((at.positions[hold.node] - to)[k], law);
        row.compliance = 1.0 / hold.stiffness;
        (row.thread[0], row.used) = ((hold.node as u32, cell(&axis, 1.0)), 1);
        row
    })
}

/// What a force and a torque do to the needle in a step.
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

    /// Displacement and turn by force and torque through the step.
    pub fn answer(&self, load: &Vector6<f64>) -> Vector6<f64> {
        let by = load.fixed_rows::<3>(0) * (self.square / self.mass);
        let turn = self.inverse_inertia * load.fixed_rows::<3>(3) * self.square;
        Vector6::new(by.x, by.y, by.z, turn.x, turn.y, turn.z)
    }
}

/// A needle that has moved and turned by as much.
pub(super) fn carried(needle: &NeedleState, by: &Vector6<f64>) -> NeedleState {
    let turn = Rotation3::new(by.fixed_rows::<3>(3).into_owned());
    let mut next = *needle;
    next.center += by.fixed_rows::<3>(0);
    next.rotation = nalgebra::UnitQuaternion::from_rotation_matrix(&turn) * needle.rotation;
    next.rotation.renormalize();
    next
}
