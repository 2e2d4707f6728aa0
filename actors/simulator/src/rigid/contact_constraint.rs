//! A contact during the solve: effective mass, impulse response, accumulated impulse.

use nalgebra::{Matrix3, Vector3};
use trocar_dynamics::rigid_world::tangential_mobility_max;

use super::contact::RigidContact;
use super::jaw_joint::{Arm, Turning};

/// Velocity and angular velocity.
pub(super) type Twist = [Vector3<f64>; 2];

/// One of the two bodies of a contact; the second one, and the world, have the opposite sign.
#[derive(Clone, Copy, Debug)]
struct Side {
    /// Its index; the world is the last.
    body: usize,
    arm: Vector3<f64>,
    /// Change of its velocity per impulse \[1/kg\], and of its angular velocity.
    moves: f64,
    turns: Matrix3<f64>,
    /// The same for a unit normal impulse; and the contribution of its angular velocity to the normal velocity.
    turns_along: Vector3<f64>,
    lever: Vector3<f64>,
    /// Jaw opening that moves the point.
    opening: Option<Arm>,
}

/// A contact during the solve.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    sides: [Side; 2],
    has_openings: bool,
    pub normal: Vector3<f64>,
    /// Least normal velocity required \[m/s\].
    pub wanted: f64,
    /// The same for the split impulses.
    pub undo: f64,
    surface: Vector3<f64>,
    friction: f64,
    /// Compliance: velocity by which it gives way per impulse \[1/kg\], and the friction at which it does not give way.
    softness: f64,
    relaxed: Vector3<f64>,
    /// Effective mass along the normal, and in all directions.
    normal_mass: f64,
    mass: Matrix3<f64>,
    /// The same along the normal for the split impulses, which no drive resists.
    undo_mass: f64,
    /// Effective mass in the tangential direction in which it is least.
    least_mass: f64,
    /// Mean velocity change per impulse over all directions \[1/kg\].
    yields: f64,
    along: f64,
    across: Vector3<f64>,
    undone: f64,
}

impl Row {
    /// A contact between two bodies in these states (the world is the last of `inverse`).
    pub fn new(
        contact: &RigidContact,
        bodies: [usize; 2],
        arms: [Vector3<f64>; 2],
        openings: [Option<Arm>; 2],
        inverse: &[(f64, Matrix3<f64>)],
        turning: &[Turning],
    ) -> Self {
        let normal = contact.normal_in_world;
        let mut feels = Matrix3::zeros();
        let sides = [0, 1].map(|side| {
            let sign = [1.0, -1.0][side];
            let (body, arm) = (bodies[side], arms[side]);
            let (mass, inertia) = &inverse[body];
            let cross = arm.cross_matrix();
            feels += Matrix3::identity() * *mass - cross * inertia * cross;
            let turns = inertia * cross * sign;
            Side {
                body,
                arm: arm * sign,
                moves: mass * sign,
                turns,
                turns_along: turns * normal,
                lever: arm.cross(&normal) * sign,
                opening: openings[side],
            }
        });
        let mut yields_alone = normal.dot(&(feels * normal));
        for arm in openings.iter().flatten() {
            let turning = &turning[arm.joint as usize];
            feels += arm.arm * arm.arm.transpose() * turning.inverse;
            yields_alone += arm.arm.dot(&normal).powi(2) * turning.inverse_alone;
        }
        Self {
            sides,
            has_openings: openings.iter().any(Option::is_some),
            normal,
            wanted: 0.0,
            undo: 0.0,
            surface: contact.surface_velocity,
            friction: contact.friction,
            softness: 0.0,
            relaxed: Vector3::zeros(),
            normal_mass: 1.0 / normal.dot(&(feels * normal)),
            undo_mass: 1.0 / yields_alone,
            mass: feels.try_inverse().unwrap_or_else(Matrix3::zeros),
            least_mass: 1.0 / tangential_mobility_max(&feels, &normal),
            yields: feels.trace() / 3.0,
            along: 0.0,
            across: Vector3::zeros(),
            undone: 0.0,
        }
    }

    /// Total impulse on the bodies.
    pub fn impulse(&self) -> Vector3<f64> {
        self.normal * self.along + self.across
    }

    /// Makes it give way like springs of this stiffness \[N/m\] along the normal and across, in a step of `dt` that ends
    /// at their force. At depth `depth` \[m\] the spring along the normal pushes apart by it; those across begin at the
    /// friction of the last step.
    pub fn soften(&mut self, stiffness: f64, depth: f64, dt: f64) {
        self.softness = 1.0 / (stiffness * dt * dt);
        self.normal_mass = 1.0 / (1.0 / self.normal_mass + self.softness);
        self.mass = self
            .mass
            .try_inverse()
            .and_then(|feels| (feels + Matrix3::identity() * self.softness).try_inverse())
            .unwrap_or(self.mass);
        self.wanted = depth / dt;
    }

    /// Its compliance \[1/kg\].
    pub fn softness(&self) -> f64 {
        self.softness
    }

    /// Velocity that a direct solve is to reach without its own impulses: what it gives way is added there.
    pub fn target(&self) -> Vector3<f64> {
        self.normal * self.wanted + self.relaxed * self.softness
    }

    /// Coulomb's coefficient.
    pub fn friction(&self) -> f64 {
        self.friction
    }

    /// Whether it presses.
    pub fn is_loaded(&self) -> bool {
        self.along > 0.0
    }

    /// Whether jaws move its point.
    pub fn has_openings(&self) -> bool {
        self.has_openings
    }

    /// Change of this contact's velocity per impulse at another one \[1/kg\].
    pub fn mobility(&self, other: &Self, turning: &[Turning]) -> Matrix3<f64> {
        let mut sum = Matrix3::zeros();
        for (own, sign) in self.sides.iter().zip([1.0, -1.0]) {
            for (side, pushes) in other.sides.iter().zip([1.0, -1.0]) {
                if own.body == side.body {
                    sum += Matrix3::identity() * (sign * side.moves) - own.arm.cross_matrix() * side.turns;
                }
                if let (Some(arm), Some(by)) = (own.opening, side.opening)
                    && arm.joint == by.joint
                {
                    let inverse = turning[arm.joint as usize].inverse;
                    sum += arm.arm * by.arm.transpose() * (sign * pushes * inverse);
                }
            }
        }
        sum
    }

    /// Changes its impulse to this one, within its cone.
    pub fn take(&mut self, impulse: &Vector3<f64>, twists: &mut [Twist], turning: &mut [Turning]) {
        let before = self.impulse();
        self.along = impulse.dot(&self.normal).max(0.0);
        let across = impulse - self.normal * impulse.dot(&self.normal);
        self.across = across * (self.friction * self.along / across.norm().max(f64::MIN_POSITIVE)).min(1.0);
        self.push(&(self.impulse() - before), twists, turning);
    }

    /// Applies the warm-start impulse.
    pub fn warm(&mut self, held: &Vector3<f64>, twists: &mut [Twist], turning: &mut [Turning]) {
        self.along = held.dot(&self.normal).max(0.0);
        let across = held - self.normal * held.dot(&self.normal);
        self.across = across * (self.friction * self.along / across.norm().max(f64::MIN_POSITIVE)).min(1.0);
        self.relaxed = self.across;
        self.push(&self.impulse(), twists, turning);
    }

    /// Solves it once; returns the largest velocity change \[m/s\].
    #[inline]
    pub fn solve(&mut self, twists: &mut [Twist], undo: &mut [Twist], turning: &mut [Turning]) -> f64 {
        let slip = self.speed_along(twists, turning);
        let missing = self.wanted - slip - self.softness * self.along;
        let along = (self.along + self.normal_mass * missing).max(0.0);
        let more = along - self.along;
        let mut change = more.abs() * self.yields;
        self.along = along;
        if more != 0.0 {
            self.push_along(more, twists);
            if self.has_openings {
                self.turn(&(self.normal * more), turning);
            }
        }
        // The impulse that would stop the slip, if within Coulomb's cone. Otherwise the limit against the slip velocity
        // itself: the stopping impulse is skewed wherever a body rotates more easily than it translates.
        let most = self.friction * self.along;
        if most > 0.0 || self.across != Vector3::zeros() {
            let slip = self.speed(twists, turning);
            let mut slip = slip - self.normal * slip.dot(&self.normal);
            if self.has_openings {
                slip += (self.across - self.relaxed) * self.softness;
            }
            let mut across = self.across - self.mass * slip;
            across -= self.normal * across.dot(&self.normal);
            if across.norm_squared() > most * most {
                across = self.across - slip * self.least_mass;
                across *= (most / across.norm().max(f64::MIN_POSITIVE)).min(1.0);
            }
            let impulse = across - self.across;
            change = change.max(impulse.norm() * self.yields);
            self.across = across;
            self.push(&impulse, twists, turning);
        }
        let mut gap = self.twist_along(undo);
        if self.has_openings {
            gap += self.undone_by_openings(turning).dot(&self.normal);
        }
        let undone = (self.undone + self.undo_mass * (self.undo - gap)).max(0.0);
        let more = undone - self.undone;
        if more != 0.0 {
            self.undone = undone;
            self.push_along(more, undo);
            if self.has_openings {
                self.undo_openings(&(self.normal * more), turning);
            }
        }
        change.max(more.abs() * self.yields)
    }

    /// Relative normal velocity of the first body against the second.
    #[inline]
    fn twist_along(&self, twists: &[Twist]) -> f64 {
        let [a, b] = &self.sides;
        let ([va, wa], [vb, wb]) = (&twists[a.body], &twists[b.body]);
        (va - vb).dot(&self.normal) + wa.dot(&a.lever) + wb.dot(&b.lever)
    }

    /// The same, including jaw openings and the surface's own velocity.
    #[inline]
    fn speed_along(&self, twists: &[Twist], turning: &[Turning]) -> f64 {
        let beside = if self.has_openings { self.turned(turning) - self.surface } else { -self.surface };
        self.twist_along(twists) + beside.dot(&self.normal)
    }

    #[inline]
    pub fn speed(&self, twists: &[Twist], turning: &[Turning]) -> Vector3<f64> {
        let [a, b] = &self.sides;
        let ([va, wa], [vb, wb]) = (&twists[a.body], &twists[b.body]);
        let speed = va - vb + wa.cross(&a.arm) + wb.cross(&b.arm) - self.surface;
        if self.has_openings { speed + self.turned(turning) } else { speed }
    }

    #[inline]
    fn push_along(&self, impulse: f64, twists: &mut [Twist]) {
        for side in &self.sides {
            let [velocity, spin] = &mut twists[side.body];
            *velocity += self.normal * (impulse * side.moves);
            *spin += side.turns_along * impulse;
        }
    }

    #[inline]
    fn push(&self, impulse: &Vector3<f64>, twists: &mut [Twist], turning: &mut [Turning]) {
        for side in &self.sides {
            let [velocity, spin] = &mut twists[side.body];
            *velocity += impulse * side.moves;
            *spin += side.turns * impulse;
        }
        if self.has_openings {
            self.turn(impulse, turning);
        }
    }

    /// Contribution of jaw openings to the velocity.
    fn turned(&self, turning: &[Turning]) -> Vector3<f64> {
        let of = |side: &Side| {
            side.opening.map_or_else(Vector3::zeros, |arm| arm.arm * turning[arm.joint as usize].rate)
        };
        of(&self.sides[0]) - of(&self.sides[1])
    }

    /// The same for the split impulses.
    fn undone_by_openings(&self, turning: &[Turning]) -> Vector3<f64> {
        let of = |side: &Side| {
            side.opening.map_or_else(Vector3::zeros, |arm| arm.arm * turning[arm.joint as usize].undo)
        };
        of(&self.sides[0]) - of(&self.sides[1])
    }

    fn undo_openings(&self, impulse: &Vector3<f64>, turning: &mut [Turning]) {
        for (side, sign) in self.sides.iter().zip([1.0, -1.0]) {
            if let Some(Arm { joint, arm }) = side.opening {
                let turning = &mut turning[joint as usize];
                turning.undo += sign * turning.inverse_alone * arm.dot(impulse);
            }
        }
    }

    fn turn(&self, impulse: &Vector3<f64>, turning: &mut [Turning]) {
        for (side, sign) in self.sides.iter().zip([1.0, -1.0]) {
            if let Some(Arm { joint, arm }) = side.opening {
                let turning = &mut turning[joint as usize];
                turning.rate += sign * turning.inverse * arm.dot(impulse);
            }
        }
    }
}
