//! Coulomb's law with contact compliance: force as a function of surface separation, and its derivative.

use super::Rows;
use crate::linear_algebra::block_banded::{Added, Block, Cell};

/// State of a contact, which determines the derivative of its force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum CoulombState {
    /// No contact.
    Open,
    /// Sticking.
    Sticks,
    /// Sliding.
    Slides {
        /// Sliding direction, unit, in the two tangents.
        along: [f64; 2],
        /// Largest elastic tangential displacement over the actual one: 1 where sliding begins, decreasing to 0.
        share: f64,
    },
}

/// What limits the friction of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FrictionLimit {
    /// Coulomb's law: this multiple of the normal force.
    Coefficient(f64),
    /// A force \[N\]: with the normal force of a solution before, the law is that of a potential (Panagiotopoulos
    /// 1975).
    Force(f64),
}

impl From<f64> for FrictionLimit {
    fn from(coefficient: f64) -> Self {
        Self::Coefficient(coefficient)
    }
}

impl FrictionLimit {
    /// With a normal force \[N\].
    #[inline]
    fn force(self, normal: f64) -> f64 {
        match self {
            Self::Coefficient(friction) => friction * normal,
            Self::Force(force) => force,
        }
    }
}

/// In one step, `share` falls at most to this fraction of itself.
const SHARE_KEPT: f64 = 0.1;

impl CoulombState {
    /// Initial state of a contact with `force` \[N\] and expected separation `apart` \[m\].
    pub fn begin(force: [f64; 3], apart: [f64; 3], friction: f64, compliance: f64) -> Self {
        let held = force[1].hypot(force[2]);
        if force[0] <= 0.0 {
            Self::Open
        } else if held < friction * force[0] * (1.0 - 1e-9) {
            Self::Sticks
        } else if held > 0.0 {
            // It continues to slide in the same direction.
            let along = [-force[1] / held, -force[2] / held];
            let most = compliance * held;
            let way = (apart[1] * along[0] + apart[2] * along[1]).max(most);
            Self::Slides { along, share: most / way }
        } else {
            Self::of([-compliance * force[0], apart[1], apart[2]], friction, compliance).1
        }
    }

    /// The next state to assume, after assuming `self` and finding `found`. Plain Newton steps cycle where contacts
    /// slide; they rarely do when a contact that slid backwards is assumed to stick, as it would have on the way, and
    /// when `share` is limited as contacts begin to slide.
    #[inline]
    pub fn next(self, found: Self, friction: f64) -> Self {
        match (self, found) {
            (Self::Slides { along: a, share: before }, Self::Slides { along: b, share }) => {
                if a[0] * b[0] + a[1] * b[1] < 0.0 && friction > 0.0 {
                    Self::Sticks
                } else {
                    Self::Slides { along: b, share: share.max(SHARE_KEPT * before) }
                }
            }
            _ => found,
        }
    }

    /// Force \[N\] and state of a contact whose surfaces are `apart` \[m\] along the normal and two tangents, the
    /// latter from their sticking point, with compliance `compliance` \[m/N\]. The radial return of plasticity (Simo,
    /// Hughes, *Computational Inelasticity*, 1998, §1.2), with friction as the yield stress.
    #[inline]
    pub fn of(apart: [f64; 3], limit: impl Into<FrictionLimit>, compliance: f64) -> ([f64; 3], Self) {
        // NaN counts as contact, so that it is detected.
        if apart[0] >= 0.0 {
            return ([0.0; 3], Self::Open);
        }
        let stiffness = 1.0 / compliance;
        let most = match limit.into() {
            FrictionLimit::Coefficient(friction) => -apart[0] * friction,
            FrictionLimit::Force(force) => force * compliance,
        };
        let square = apart[1] * apart[1] + apart[2] * apart[2];
        if square <= most * most {
            return (apart.map(|apart| -apart * stiffness), Self::Sticks);
        }
        let size = square.sqrt();
        let along = [apart[1] / size, apart[2] / size];
        let held = -most * stiffness;
        let force = [-apart[0] * stiffness, held * along[0], held * along[1]];
        (force, Self::Slides { along, share: most / size })
    }

    /// Force of the law linearised in this state: it becomes tensile where the law would open.
    #[inline]
    pub fn linear(&self, apart: [f64; 3], limit: impl Into<FrictionLimit>, compliance: f64) -> [f64; 3] {
        let stiffness = 1.0 / compliance;
        match *self {
            Self::Open => [0.0; 3],
            Self::Sticks => apart.map(|apart| -apart * stiffness),
            Self::Slides { along: [x, y], share } => {
                let normal = -apart[0] * stiffness;
                let across = -(apart[2] * x - apart[1] * y) * share * stiffness;
                let held = -limit.into().force(normal);
                [normal, held * x - across * y, held * y + across * x]
            }
        }
    }

    /// Adds the force derivative of a contact on two neighbouring block rows to the rod's matrix.
    #[inline]
    pub fn add(&self, rows: &Rows, limit: impl Into<FrictionLimit>, compliance: f64, to: &mut Added) {
        let (first, second) = (rows.nodes[0] as usize, rows.nodes[1] as usize);
        to.slanted |= self.slopes(rows, limit.into(), compliance, |force, apart| {
            let apart = [apart[0].transpose(), apart[1].transpose()];
            to.diagonal[first] += force[0] * apart[0];
            to.diagonal[second] += force[1] * apart[1];
            to.below[second] += force[1] * apart[0];
            to.above[second] += force[0] * apart[1];
        });
    }

    /// The force derivative of a contact on four block rows, and whether it is unsymmetric.
    #[inline]
    pub fn blocks(
        &self,
        rows: &Rows,
        limit: impl Into<FrictionLimit>,
        compliance: f64,
    ) -> ([[Block; 4]; 4], bool) {
        let mut blocks = [[Block::zeros(); 4]; 4];
        let slanted = self.slopes(rows, limit.into(), compliance, |force, apart| {
            for (of, apart) in apart.iter().enumerate() {
                let apart = apart.transpose();
                for (on, force) in force.iter().enumerate() {
                    blocks[on][of] += force * apart;
                }
            }
        });
        (blocks, slanted)
    }

    /// The force derivative as a sum of products of force and motion rows. Also whether it is unsymmetric.
    #[inline]
    fn slopes(
        &self,
        rows: &Rows,
        limit: FrictionLimit,
        compliance: f64,
        mut outer: impl FnMut(&[Cell; 4], &[Cell; 4]),
    ) -> bool {
        let stiffness = 1.0 / compliance;
        match *self {
            Self::Open => false,
            Self::Sticks => {
                for cells in &rows.cells {
                    outer(&cells.map(|cell| cell * stiffness), cells);
                }
                false
            }
            Self::Slides { along: [x, y], share } => {
                let [normal, first, second] = &rows.cells;
                let friction = match limit {
                    FrictionLimit::Coefficient(friction) => friction,
                    FrictionLimit::Force(_) => 0.0,
                };
                let push: [Cell; 4] =
                    std::array::from_fn(|k| normal[k] - (first[k] * x + second[k] * y) * friction);
                outer(&push.map(|cell| cell * stiffness), normal);
                let across: [Cell; 4] = std::array::from_fn(|k| second[k] * x - first[k] * y);
                outer(&across.map(|cell| cell * (share * stiffness)), &across);
                friction > 0.0
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::suture_thread::contact::{Side, tangents};

    const FRICTION: f64 = 0.4;
    const YIELDS: f64 = 1e-6;

    /// A contact on an edge in general position.
    fn rows() -> Rows {
        let edge = Point3::new(0.3, -0.2, 0.5) - Point3::new(0.1, 0.4, 0.2);
        let (tangent, length) = (edge.normalize(), edge.norm());
        let normal = tangent.cross(&Vector3::new(0.2, 0.3, 0.9)).normalize();
        let [first, second] = tangents(&normal, &tangent);
        let side = Side { edge: 0, along: 0.3, arm: normal * -0.05, tangent, length };
        Rows::new(&side, None, [normal, first, second])
    }

    #[test]
    fn its_slope_is_what_it_adds_to_the_matrix() {
        let rows = rows();
        for at in [[-2e-3, 1e-4, -3e-4], [-2e-3, 3e-3, -1e-3], [-1e-3, -9e-3, 4e-3], [1e-3, 1.0, 1.0]] {
            let (force, coulomb) = CoulombState::of(at, FRICTION, YIELDS);
            assert_eq!(coulomb.linear(at, FRICTION, YIELDS).map(f64::to_bits)[0], force[0].to_bits());
            let mut added = Added::default();
            added.clear(2);
            coulomb.add(&rows, FRICTION, YIELDS, &mut added);
            assert_eq!(added.slanted, matches!(coulomb, CoulombState::Slides { .. }));
            for node in 0..2 {
                for axis in 0..4 {
                    let pushed = |by: f64| {
                        let mut moved = [Cell::zeros(); 2];
                        moved[node][axis] = by;
                        let apart = rows.apart(&moved);
                        let (force, _) =
                            CoulombState::of(std::array::from_fn(|k| at[k] + apart[k]), FRICTION, YIELDS);
                        let mut right = [Cell::zeros(); 2];
                        rows.push(&force, &mut right);
                        right
                    };
                    let (more, less) = (pushed(1e-8), pushed(-1e-8));
                    for other in 0..2 {
                        let block = match (other, node) {
                            (0, 1) => &added.above[1],
                            (1, 0) => &added.below[1],
                            _ => &added.diagonal[node],
                        };
                        let found = (more[other] - less[other]) / 2e-8;
                        let off = (found + block.column(axis)).amax();
                        assert!(off < 1e-4 / YIELDS, "{coulomb:?}, node {node}, axis {axis}: off by {off}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_slid_back_is_taken_to_stick_and_nothing_slides_far_at_once() {
        let slides = |x: f64, share: f64| CoulombState::Slides { along: [x, 0.0], share };
        assert_eq!(slides(1.0, 0.5).next(slides(-1.0, 0.5), FRICTION), CoulombState::Sticks);
        assert_eq!(slides(1.0, 0.5).next(slides(-1.0, 0.0), 0.0), slides(-1.0, 0.05));
        assert_eq!(slides(1.0, 0.5).next(slides(1.0, 1e-6), FRICTION), slides(1.0, 0.05));
        assert_eq!(slides(1.0, 0.5).next(CoulombState::Open, FRICTION), CoulombState::Open);
    }
}
