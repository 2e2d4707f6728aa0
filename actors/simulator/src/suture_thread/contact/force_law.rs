//! Force laws of contacts and joints with three rows, for every kind that the dense problem of an island knows: force
//! as a function of separation. Each has a small compliance, so that the law is a function and Newton's method applies.

use super::CoulombState;

/// A force law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ForceLaw {
    /// Unilateral contact along the first row, with Coulomb friction in the other two.
    Contact { friction: f64 },
    /// The same, yielding plastically at a normal force of `most` \[N\].
    Skin { friction: f64, most: f64 },
    /// Each row is a bilateral constraint with bounded force \[N\].
    Within { least: [f64; 3], most: [f64; 3] },
    /// A line in a channel: constrained laterally in the last two rows; along the first, it sticks up to `base` \[N\]
    /// plus `friction` times the lateral force, and slides at that limit.
    Passes { base: f64, friction: f64 },
}

/// The state of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ContactState {
    Contact(CoulombState),
    /// Yields at its largest normal force; tangentially, the state of a contact.
    Gives(CoulombState),
    Within([Bound; 3]),
    /// It sticks.
    Stays,
    /// It slides in this direction (1 or −1), with this lateral direction of force, unit or zero.
    Slides(f64, [f64; 2]),
}

impl ContactState {
    /// Whether the same rows are active in both states.
    pub fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Slides(one, _), Self::Slides(other, _)) => one == other,
            _ => self == other,
        }
    }

    /// This state with one row changed to that of `next`.
    pub fn exchanged(&self, next: &Self) -> Self {
        let (Self::Within(before), Self::Within(next)) = (self, next) else { return *next };
        let mut bounds = *before;
        if let Some(row) = (0..3).find(|&row| before[row] != next[row]) {
            bounds[row] = next[row];
        }
        Self::Within(bounds)
    }

    /// Which rows are at their force bounds.
    pub fn gives_way(&self) -> [bool; 3] {
        match self {
            Self::Contact(CoulombState::Open) => [true; 3],
            Self::Contact(CoulombState::Sticks) | Self::Stays => [false; 3],
            Self::Contact(CoulombState::Slides { .. }) => [false, true, true],
            Self::Gives(coulomb) => {
                let slides = matches!(coulomb, CoulombState::Slides { .. });
                [true, slides, slides]
            }
            Self::Within(bounds) => bounds.map(|bound| bound != Bound::Free),
            Self::Slides(..) => [true, false, false],
        }
    }
}

/// Position of a force relative to its bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Bound {
    Free,
    Least,
    Most,
}

/// One equation of a Newton step on a contact: a linear combination of its rows and forces is zero.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Equation {
    /// Forces in the three rows per unit of the unknown \[N\].
    pub force: [f64; 3],
    /// Weights of the three rows.
    pub along: [f64; 3],
    /// Additional compliance \[m/N\].
    pub yields: f64,
}

const UNIT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl ForceLaw {
    /// Bilateral constraint with unbounded force.
    pub const HELD: Self = Self::Within { least: [f64::NEG_INFINITY; 3], most: [f64::INFINITY; 3] };

    /// Whether it is a law with bounds, rather than a surface contact.
    pub fn is_bounded(&self) -> bool {
        matches!(self, Self::Within { .. } | Self::Passes { .. })
    }

    /// Force \[N\] and state of a contact with separation `apart` \[m\] and compliance `yields` \[m/N\].
    pub fn of(&self, apart: [f64; 3], yields: [f64; 3]) -> ([f64; 3], ContactState) {
        match *self {
            Self::Contact { friction } => {
                let (force, coulomb) = CoulombState::of(apart, friction, yields[0]);
                (force, ContactState::Contact(coulomb))
            }
            Self::Skin { friction, most } => {
                let deepest = [apart[0].max(-most * yields[0]), apart[1], apart[2]];
                let (force, coulomb) = CoulombState::of(deepest, friction, yields[0]);
                let gives = apart[0] < deepest[0];
                (force, if gives { ContactState::Gives(coulomb) } else { ContactState::Contact(coulomb) })
            }
            Self::Within { least, most } => {
                let mut bounds = [Bound::Free; 3];
                let force = std::array::from_fn(|k| {
                    let wanted = -apart[k] / yields[k];
                    if wanted > most[k] {
                        bounds[k] = Bound::Most;
                        most[k]
                    } else if wanted < least[k] {
                        bounds[k] = Bound::Least;
                        least[k]
                    } else {
                        wanted
                    }
                });
                (force, ContactState::Within(bounds))
            }
            Self::Passes { base, friction } => {
                let wanted: [f64; 3] = std::array::from_fn(|k| -apart[k] / yields[k]);
                let across = wanted[1].hypot(wanted[2]);
                let most = base + friction * across;
                if wanted[0].abs() <= most {
                    return (wanted, ContactState::Stays);
                }
                let unit = |k: usize| if across > 0.0 { wanted[k] / across } else { 0.0 };
                let way = wanted[0].signum();
                ([way * most, wanted[1], wanted[2]], ContactState::Slides(way, [unit(1), unit(2)]))
            }
        }
    }

    /// Initial state of a contact with `force` \[N\] and separation `apart` \[m\].
    pub fn begin(&self, force: [f64; 3], apart: [f64; 3], yields: [f64; 3]) -> ContactState {
        match *self {
            Self::Contact { friction } | Self::Skin { friction, .. } => {
                ContactState::Contact(CoulombState::begin(force, apart, friction, yields[0]))
            }
            Self::Within { .. } => self.of(std::array::from_fn(|k| -force[k] * yields[k]), yields).1,
            Self::Passes { base, friction } => {
                let across = force[1].hypot(force[2]);
                let most = base + friction * across;
                if force[0].abs() < most * (1.0 - 1e-9) || force[0] == 0.0 {
                    ContactState::Stays
                } else {
                    let unit = |k: usize| if across > 0.0 { force[k] / across } else { 0.0 };
                    ContactState::Slides(force[0].signum(), [unit(1), unit(2)])
                }
            }
        }
    }

    /// The next state to assume, after assuming `before` and finding `found`: see [`CoulombState::next`].
    pub fn next(&self, before: ContactState, found: ContactState) -> ContactState {
        match (*self, before, found) {
            (Self::Contact { friction }, ContactState::Contact(before), ContactState::Contact(found)) => {
                ContactState::Contact(before.next(found, friction))
            }
            (Self::Skin { friction, .. }, ContactState::Gives(before), ContactState::Gives(found)) => {
                ContactState::Gives(before.next(found, friction))
            }
            (Self::Skin { friction, .. }, ContactState::Contact(before), ContactState::Contact(found)) => {
                ContactState::Contact(before.next(found, friction))
            }
            (Self::Passes { .. }, ContactState::Slides(before, _), ContactState::Slides(way, _))
                if before * way < 0.0 =>
            {
                ContactState::Stays
            }
            // From one bound to the other it passes through the inactive state.
            (Self::Within { .. }, ContactState::Within(before), ContactState::Within(found)) => {
                let far = |k: usize| before[k] != Bound::Free && found[k] != before[k];
                ContactState::Within(std::array::from_fn(|k| if far(k) { Bound::Free } else { found[k] }))
            }
            _ => found,
        }
    }

    /// Equations of a contact in this state with its compliance multiplied by `softness`, and the known part of its
    /// force.
    pub fn linearise(
        &self,
        state: ContactState,
        yields: [f64; 3],
        softness: f64,
        mut equation: impl FnMut(Equation),
    ) -> [f64; 3] {
        let more = yields.map(|yields| (softness - 1.0) * yields);
        match (*self, state) {
            (Self::Contact { friction } | Self::Skin { friction, .. }, ContactState::Contact(coulomb)) => {
                match coulomb {
                    CoulombState::Open => {}
                    CoulombState::Sticks => {
                        for unit in UNIT {
                            equation(Equation { force: unit, along: unit, yields: more[0] });
                        }
                    }
                    CoulombState::Slides { along: [x, y], share } => {
                        let force = [1.0, -friction * x, -friction * y];
                        equation(Equation { force, along: UNIT[0], yields: more[0] });
                        // Perpendicular to the sliding direction friction is stiffer, the less it slides.
                        if friction > 0.0 && share > 1e-9 {
                            let across = [0.0, -y, x];
                            let yields = (softness / share - 1.0) * yields[0];
                            equation(Equation { force: across, along: across, yields });
                        }
                    }
                }
            }
            (Self::Skin { friction, most }, ContactState::Gives(coulomb)) => {
                let CoulombState::Slides { along: [x, y], share } = coulomb else {
                    for unit in [UNIT[1], UNIT[2]] {
                        equation(Equation { force: unit, along: unit, yields: more[0] });
                    }
                    return [most, 0.0, 0.0];
                };
                if friction > 0.0 && share > 1e-9 {
                    let across = [0.0, -y, x];
                    let yields = (softness / share - 1.0) * yields[0];
                    equation(Equation { force: across, along: across, yields });
                }
                return [most, -friction * most * x, -friction * most * y];
            }
            (Self::Within { least, most }, ContactState::Within(bounds)) => {
                let mut known = [0.0; 3];
                for k in 0..3 {
                    match bounds[k] {
                        Bound::Free => equation(Equation { force: UNIT[k], along: UNIT[k], yields: more[k] }),
                        Bound::Least => known[k] = least[k],
                        Bound::Most => known[k] = most[k],
                    }
                }
                return known;
            }
            (Self::Passes { base, friction }, ContactState::Slides(way, across)) => {
                for k in 1..3 {
                    let mut force = UNIT[k];
                    force[0] = way * friction * across[k - 1];
                    equation(Equation { force, along: UNIT[k], yields: more[k] });
                }
                return [way * base, 0.0, 0.0];
            }
            // A sticking contact; states of other laws do not occur here.
            _ => {
                for k in 0..3 {
                    equation(Equation { force: UNIT[k], along: UNIT[k], yields: more[k] });
                }
            }
        }
        [0.0; 3]
    }

    /// The force if only this contact's own compliance `own` \[m/N\] responded, given `force` \[N\] and `gap` \[m\].
    pub fn wanted(&self, force: [f64; 3], gap: [f64; 3], own: [f64; 3]) -> [f64; 3] {
        let held = std::array::from_fn(|k| force[k] - gap[k] / own[k]);
        self.confined(held)
    }

    /// The nearest allowed force.
    pub fn confined(&self, force: [f64; 3]) -> [f64; 3] {
        match *self {
            Self::Contact { friction } | Self::Skin { friction, .. } => {
                let normal = force[0].max(0.0);
                let normal = if let Self::Skin { most, .. } = *self { normal.min(most) } else { normal };
                let most = friction * normal;
                let size = (force[1] * force[1] + force[2] * force[2]).sqrt();
                let scale = if size > most { most / size } else { 1.0 };
                [normal, force[1] * scale, force[2] * scale]
            }
            Self::Within { least, most } => std::array::from_fn(|k| force[k].max(least[k]).min(most[k])),
            Self::Passes { base, friction } => {
                let most = base + friction * force[1].hypot(force[2]);
                [force[0].max(-most).min(most), force[1], force[2]]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{Rng, SeedableRng};

    use super::*;

    const RULES: [ForceLaw; 5] = [
        ForceLaw::Contact { friction: 0.4 },
        ForceLaw::Skin { friction: 0.4, most: 1.0 },
        ForceLaw::Within { least: [-1.0, f64::NEG_INFINITY, -0.5], most: [0.0, f64::INFINITY, 0.5] },
        ForceLaw::HELD,
        ForceLaw::Passes { base: 0.3, friction: 0.4 },
    ];

    #[test]
    fn every_rule_as_it_is_linearised_gives_the_force_that_it_gives() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(3);
        for law in RULES {
            for _ in 0..200 {
                let apart = std::array::from_fn(|_| random.random_range(-3e-6..3e-6));
                let yields = if law.is_bounded() { [1e-6, 2e-6, 2e-6] } else { [1e-6; 3] };
                let (force, state) = law.of(apart, yields);
                let gap: [f64; 3] = std::array::from_fn(|k| apart[k] + yields[k] * force[k]);
                let mut equations = Vec::new();
                let known = law.linearise(state, yields, 1.0, |equation| equations.push(equation));
                let columns =
                    DMatrix::from_fn(3, equations.len(), |row, column| equations[column].force[row]);
                let rest = DVector::from_fn(3, |row, _| force[row] - known[row]);
                let sizes = if equations.is_empty() {
                    DVector::zeros(0)
                } else {
                    columns.clone().svd(true, true).solve(&rest, 1e-12).expect("solved")
                };
                let left = if equations.is_empty() { rest } else { rest - &columns * &sizes };
                assert!(left.amax() < 1e-9, "{law:?} {state:?}: {left}");
                for (equation, size) in equations.iter().zip(sizes.iter()) {
                    let row: f64 = (0..3).map(|k| equation.along[k] * gap[k]).sum();
                    assert!((row + equation.yields * size).abs() < 1e-15, "{law:?} {state:?}");
                }
                for (k, gives) in state.gives_way().into_iter().enumerate() {
                    assert!(gives || gap[k].abs() < 1e-15, "{law:?} {state:?}: row {k} is {}", gap[k]);
                }
                let again = law.confined(force);
                assert!((0..3).all(|k| (again[k] - force[k]).abs() < 1e-12), "{law:?}: {force:?}");
                let began = law.begin(force, apart, yields);
                let touches = !matches!(state, ContactState::Contact(CoulombState::Open));
                assert!(
                    !touches || !matches!(began, ContactState::Contact(CoulombState::Open)),
                    "{law:?} {state:?}"
                );
            }
        }
    }

    #[test]
    fn from_one_bound_to_the_other_a_place_holds_in_between() {
        let law = RULES[2];
        let [least, most] =
            [Bound::Least, Bound::Most].map(|bound| ContactState::Within([bound, Bound::Free, bound]));
        assert_eq!(law.next(least, most), ContactState::Within([Bound::Free; 3]));
        assert!(least.is_like(&least) && !least.is_like(&most));
        let once = ContactState::Within([Bound::Most, Bound::Free, Bound::Least]);
        assert_eq!(least.exchanged(&most), once);
        let slides = |way: f64| ContactState::Slides(way, [1.0, 0.0]);
        assert_eq!(RULES[4].next(slides(1.0), slides(-1.0)), ContactState::Stays);
        assert!(slides(1.0).is_like(&ContactState::Slides(1.0, [0.0, 1.0])));
    }
}
