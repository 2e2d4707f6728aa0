//! Joints of rigid bodies: the velocities that they lock, and how far apart their two frames are.

use nalgebra::{Isometry3, Matrix3, UnitQuaternion, Vector3};
use trocar_scene::JointKind;

use super::contact_constraint::Twist;
use super::{RigidMass, RigidState};

/// What a joint leads to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointEnd {
    /// Another body.
    Body {
        /// Its index.
        body: u32,
        /// `body_from_joint`, in the frame of its principal axes.
        body_from_joint: Isometry3<f64>,
    },
    /// The world, whose point may move: `world_from_joint` at the beginning of a step and at its end.
    World([Isometry3<f64>; 2]),
}

/// A joint of a body with another one or with the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyJoint {
    /// The body.
    pub body: u32,
    /// `body_from_joint`, in the frame of its principal axes; the axis of a hinge is z.
    pub body_from_joint: Isometry3<f64>,
    /// The other side.
    pub other: JointEnd,
    /// What it leaves free.
    pub kind: JointKind,
}

/// What a joint bears in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointImpulse {
    /// Impulse on the body, in world \[N·s\].
    pub impulse: Vector3<f64>,
    /// Angular impulse on the body about the joint's point, in world axes \[N·m·s\].
    pub turn: Vector3<f64>,
}

/// Numbers of a joint, one per locked velocity: three linear ones, and up to three angular ones.
pub(super) type Locked = [f64; 6];

/// One side of a joint in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointSide {
    /// Its index; the world is the last.
    pub body: usize,
    /// From the centre of mass to the joint's point.
    pub arm: Vector3<f64>,
    mass_inverse: f64,
    /// Angular velocity that each locked velocity takes in: its lever, and that times the inverse inertia.
    levers: [Vector3<f64>; 6],
    turns: [Vector3<f64>; 6],
}

/// A joint in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointRows {
    pub sides: [JointSide; 2],
    /// Number of locked velocities.
    pub count: usize,
    /// Directions of the angular ones, in world.
    axes: [Vector3<f64>; 3],
    /// Distance and angle by which the frames may stay apart in this step.
    pub allowed: Locked,
    /// Velocities to reach, and those of the discarded motion that brings the frames together.
    pub wanted: Locked,
    pub undo: Locked,
    /// Those with which the joint was least open at the end of the step.
    best: Locked,
    /// Impulses so far.
    pub impulse: Locked,
    /// Of a step that was taken in parts, their sum.
    divided: Option<JointImpulse>,
}

/// Frame of a joint on one side, at these states; `end` selects the world's at the end of the step.
fn frame_of(joint: &BodyJoint, side: usize, states: &[RigidState], end: usize) -> Isometry3<f64> {
    let of = |body: u32, body_from_joint: &Isometry3<f64>| {
        let state = &states[body as usize];
        Isometry3::from_parts(state.position.coords.into(), state.rotation) * body_from_joint
    };
    match (side, &joint.other) {
        (0, _) => of(joint.body, &joint.body_from_joint),
        (_, JointEnd::Body { body, body_from_joint }) => of(*body, body_from_joint),
        (_, JointEnd::World(frames)) => frames[end],
    }
}

/// How far the first frame is from the second, as a translation and a rotation vector, in world.
fn apart([own, other]: [Isometry3<f64>; 2], kind: JointKind) -> [Vector3<f64>; 2] {
    let way = own.translation.vector - other.translation.vector;
    let turn = match kind {
        JointKind::Ball => Vector3::zeros(),
        JointKind::Hinge => {
            let [a, b] = [own, other].map(|frame| frame.rotation * Vector3::z());
            let (across, along) = (b.cross(&a), a.dot(&b));
            // Its length is the angle, also for frames that are far apart.
            let angle = across.norm().atan2(along);
            across.try_normalize(1e-300).map_or_else(Vector3::zeros, |axis| axis * angle)
        }
        JointKind::Fixed => (own.rotation * other.rotation.inverse()).scaled_axis(),
    };
    [way, turn]
}

/// Distance \[m\] and angle \[rad\] between the frames of a joint at these states, after a step.
pub(super) fn errors(joint: &BodyJoint, states: &[RigidState]) -> [f64; 2] {
    apart([0, 1].map(|side| frame_of(joint, side, states, 1)), joint.kind).map(|error| error.norm())
}

impl JointRows {
    /// A joint between bodies in these states (the world is the last of `inverse`).
    pub fn new(joint: &BodyJoint, states: &[RigidState], inverse: &[(f64, Matrix3<f64>)]) -> Self {
        let frames = [0, 1].map(|side| frame_of(joint, side, states, 0));
        let axis = |k: usize| frames[0].rotation * Vector3::ith(k, 1.0);
        let (axes, count) = match joint.kind {
            JointKind::Ball => ([Vector3::zeros(); 3], 3),
            JointKind::Hinge => ([axis(0), axis(1), Vector3::zeros()], 5),
            JointKind::Fixed => ([axis(0), axis(1), axis(2)], 6),
        };
        let stands = inverse.len() - 1;
        let bodies = [
            joint.body as usize,
            match joint.other {
                JointEnd::Body { body, .. } => body as usize,
                JointEnd::World(_) => stands,
            },
        ];
        let sides = [0, 1].map(|side| {
            let (body, point) = (bodies[side], frames[side].translation.vector);
            let arm = states.get(body).map_or_else(Vector3::zeros, |state| point - state.position.coords);
            let (mass_inverse, inertia) = inverse[body];
            let lever = |k: usize| match k {
                0..3 => arm.cross(&Vector3::ith(k, 1.0)),
                _ => axes[k - 3],
            };
            let levers: [Vector3<f64>; 6] = std::array::from_fn(lever);
            JointSide { body, arm, mass_inverse, levers, turns: levers.map(|lever| inertia * lever) }
        });
        let mut rows = Self {
            sides,
            count,
            axes,
            allowed: [0.0; 6],
            wanted: [0.0; 6],
            undo: [0.0; 6],
            best: [0.0; 6],
            divided: None,
            impulse: [0.0; 6],
        };
        rows.allowed = rows.along(&apart(frames, joint.kind));
        rows
    }

    /// The components of a translation and a rotation along what it locks.
    fn along(&self, [way, turn]: &[Vector3<f64>; 2]) -> Locked {
        std::array::from_fn(|k| match k {
            0..3 => way[k],
            _ => self.axes[k - 3].dot(turn),
        })
    }

    /// Keeps the velocities that are wanted now as the best so far.
    pub fn keep_wanted(&mut self) {
        self.best = self.wanted;
    }

    /// Wants the best velocities again.
    pub fn take_best(&mut self) {
        self.wanted = self.best;
    }

    /// Sets its impulse, of a step that was taken in parts.
    pub fn set_total(&mut self, total: &JointImpulse) {
        self.divided = Some(*total);
    }

    /// How far the frames are apart at these states, at the end of the step.
    pub fn error(&self, joint: &BodyJoint, states: &[RigidState]) -> Locked {
        self.along(&apart([0, 1].map(|side| frame_of(joint, side, states, 1)), joint.kind))
    }

    /// The locked velocities of bodies that move so.
    pub fn speed(&self, twists: &[Twist]) -> Locked {
        let of = |side: &JointSide| {
            let [velocity, spin] = twists[side.body];
            [velocity + spin.cross(&side.arm), spin]
        };
        let [a, b] = [of(&self.sides[0]), of(&self.sides[1])];
        self.along(&[a[0] - b[0], a[1] - b[1]])
    }

    /// Change of the locked velocity `row` per impulse along `column` of another joint \[1/kg\].
    pub fn mobility(&self, row: usize, other: &Self, column: usize) -> f64 {
        let mut sum = 0.0;
        for (i, own) in self.sides.iter().enumerate() {
            for (j, side) in other.sides.iter().enumerate() {
                if own.body == side.body {
                    let linear = if row == column && row < 3 { own.mass_inverse } else { 0.0 };
                    let response = linear + own.levers[row].dot(&side.turns[column]);
                    sum += if i == j { response } else { -response };
                }
            }
        }
        sum
    }

    /// Changes the velocities by impulses.
    pub fn push(&self, impulses: &Locked, twists: &mut [Twist]) {
        let linear = Vector3::new(impulses[0], impulses[1], impulses[2]);
        for (side, sign) in self.sides.iter().zip([1.0, -1.0]) {
            let mut turn = Vector3::zeros();
            for (axis, impulse) in side.turns.iter().zip(impulses).take(self.count) {
                turn += axis * *impulse;
            }
            let [velocity, spin] = &mut twists[side.body];
            *velocity += linear * (side.mass_inverse * sign);
            *spin += turn * sign;
        }
    }

    /// Its impulse on the first body.
    pub fn total(&self) -> JointImpulse {
        if let Some(total) = self.divided {
            return total;
        }
        let mut turn = Vector3::zeros();
        for k in 3..self.count {
            turn += self.axes[k - 3] * self.impulse[k];
        }
        JointImpulse { impulse: Vector3::new(self.impulse[0], self.impulse[1], self.impulse[2]), turn }
    }
}

/// The state of a body that has these velocities, at the beginning of a step.
pub(super) fn with_twist(mass: &RigidMass, state: &RigidState, [velocity, spin]: &Twist) -> RigidState {
    let rotation: &UnitQuaternion<f64> = &state.rotation;
    RigidState {
        momentum: velocity * mass.mass,
        angular_momentum: rotation * (rotation.inverse() * spin).component_mul(&mass.inertia),
        ..*state
    }
}
