//! Constraint planes of a proxy, and the allowed position nearest to the device (Zilles and Salisbury, *A
//! constraint-based god-object method for haptic display*, 1995: at most three of them are active).

use nalgebra::Vector3;

/// Most planes considered, the most violated first.
const PLANES_MAX: usize = 6;

/// Most rounds of adding a plane: more than the possible sets of six planes.
const ROUNDS_MAX: usize = 42;
/// Longest retreat, relative to the depth.
const STEEP: f64 = 4.0;

/// The proxy may move by `z` where `normal · z ≥ least`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    /// Unit normal, towards the allowed side.
    pub(super) normal: Vector3<f64>,
    /// Positive where it has to retreat \[m\].
    pub(super) least: f64,
    /// Owner of the plane, for the caller.
    pub(super) owner: usize,
}

/// A fixed-capacity set of planes, without heap allocation.
#[derive(Clone, Debug)]
pub(super) struct Planes {
    list: [Plane; PLANES_MAX],
    count: usize,
}

/// The proxy's constrained motion, and the active planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct ConstrainedMotion {
    pub(super) motion: Vector3<f64>,
    /// Owner and push \[m\] of each active plane.
    pub(super) active: [Option<(usize, f64)>; 3],
}

/// A motion, and the active planes (by index) that push it away from the desired one.
#[derive(Clone, Copy, Debug)]
struct PlaneCorrection {
    motion: Vector3<f64>,
    by: [Option<(usize, f64)>; 3],
}

impl Planes {
    pub(super) fn none() -> Self {
        let nothing = Plane { normal: Vector3::zeros(), least: 0.0, owner: 0 };
        Self { list: [nothing; PLANES_MAX], count: 0 }
    }

    pub(super) fn as_slice(&self) -> &[Plane] {
        &self.list[..self.count]
    }

    /// Adds a plane; keeps the stricter of two equal ones, and if the set is full those that `wish` violates most.
    pub(super) fn push(&mut self, plane: Plane, wish: &Vector3<f64>) {
        for own in &mut self.list[..self.count] {
            if own.normal.dot(&plane.normal) > 1.0 - 1e-12 {
                if plane.least > own.least {
                    *own = plane;
                }
                return;
            }
        }
        if self.count < PLANES_MAX {
            self.list[self.count] = plane;
            self.count += 1;
            return;
        }
        let room = |plane: &Plane| plane.normal.dot(wish) - plane.least;
        let mut loosest = 0;
        for other in 1..PLANES_MAX {
            if room(&self.list[other]) > room(&self.list[loosest]) {
                loosest = other;
            }
        }
        if room(&plane) < room(&self.list[loosest]) {
            self.list[loosest] = plane;
        }
    }

    /// Whether a motion violates none of them.
    pub(super) fn allow(&self, motion: &Vector3<f64>, tolerance: f64) -> bool {
        self.as_slice().iter().all(|plane| plane.normal.dot(motion) >= plane.least - tolerance)
    }

    /// The allowed motion nearest to `wish`. Planes are added one at a time, the most violated first: with the active
    /// ones each gives a small problem that is solved directly, and the distance from the wish grows in each round, so
    /// that no set repeats (the dual method of Goldfarb and Idnani, 1983, in three dimensions). `None` if no motion is
    /// allowed, or rounding prevents a decision.
    pub(super) fn nearest(&self, wish: &Vector3<f64>, tolerance: f64) -> Option<ConstrainedMotion> {
        let planes = self.as_slice();
        let mut found = PlaneCorrection { motion: *wish, by: [None; 3] };
        for _ in 0..ROUNDS_MAX {
            let mut worst = (tolerance, None);
            for (index, plane) in planes.iter().enumerate() {
                let short = plane.least - plane.normal.dot(&found.motion);
                if short > worst.0 {
                    worst = (short, Some(index));
                }
            }
            let Some(added) = worst.1 else {
                let active = found.by.map(|pushing| pushing.map(|(index, push)| (planes[index].owner, push)));
                return Some(ConstrainedMotion { motion: found.motion, active });
            };
            found = self.with(added, &found, wish, tolerance)?;
        }
        None
    }

    /// The nearest motion that one more plane and the previously active ones allow: the new one is active, with none,
    /// one or two others.
    fn with(
        &self,
        added: usize,
        before: &PlaneCorrection,
        wish: &Vector3<f64>,
        tolerance: f64,
    ) -> Option<PlaneCorrection> {
        let planes = self.as_slice();
        let old = before.by.map(|pushing| pushing.map(|(index, _)| index));
        let allowed = |motion: &Vector3<f64>| {
            old.iter()
                .flatten()
                .all(|&index| planes[index].normal.dot(motion) >= planes[index].least - tolerance)
        };
        // For nearly parallel planes the solution may be dominated by rounding: it must lie on them.
        let on = |index: usize, motion: &Vector3<f64>| {
            (planes[index].normal.dot(motion) - planes[index].least).abs() <= tolerance
        };
        let new = &planes[added];
        let short = |plane: &Plane| plane.least - plane.normal.dot(wish);
        let push = short(new);
        let motion = wish + new.normal * push;
        if push >= 0.0 && allowed(&motion) {
            return Some(PlaneCorrection { motion, by: [Some((added, push)), None, None] });
        }
        for &index in old.iter().flatten() {
            let other = &planes[index];
            let cosine = new.normal.dot(&other.normal);
            let sine_squared = 1.0 - cosine * cosine;
            let first = (short(new) - cosine * short(other)) / sine_squared;
            let second = (short(other) - cosine * short(new)) / sine_squared;
            let motion = wish + new.normal * first + other.normal * second;
            let pushes = first >= 0.0 && second >= 0.0;
            if pushes && on(added, &motion) && on(index, &motion) && allowed(&motion) {
                return Some(PlaneCorrection {
                    motion,
                    by: [Some((added, first)), Some((index, second)), None],
                });
            }
        }
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (Some(i), Some(j)) = (old[i], old[j]) else { continue };
            let corner = [added, i, j];
            let [a, b, c] = corner.map(|index| &planes[index]);
            let across = [b.normal.cross(&c.normal), c.normal.cross(&a.normal), a.normal.cross(&b.normal)];
            let volume = a.normal.dot(&across[0]);
            let motion = (across[0] * a.least + across[1] * b.least + across[2] * c.least) / volume;
            let push = across.map(|across| across.dot(&(motion - wish)) / volume);
            let pushes = push.iter().all(|push| *push >= 0.0);
            if pushes && corner.iter().all(|&index| on(index, &motion)) && allowed(&motion) {
                let by = [Some((added, push[0])), Some((i, push[1])), Some((j, push[2]))];
                return Some(PlaneCorrection { motion, by });
            }
        }
        None
    }

    /// The shortest motion that gives every plane its distance. `None` if there is none, or only a long one: at the
    /// narrow end of a gap a finger would be ejected at high speed. Up to `always` \[m\] any motion is accepted.
    pub(super) fn retreat(&self, tolerance: f64, always: f64) -> Option<Vector3<f64>> {
        let deepest = self.as_slice().iter().fold(0.0, |deepest: f64, plane| deepest.max(plane.least));
        if deepest <= 0.0 {
            return Some(Vector3::zeros());
        }
        let held = self.nearest(&Vector3::zeros(), tolerance)?;
        (held.motion.norm() <= (STEEP * deepest).max(always)).then_some(held.motion)
    }

    /// The same planes without required retreats: staying is always allowed.
    pub(super) fn without_retreat(&self) -> Self {
        let mut planes = self.clone();
        for plane in &mut planes.list {
            plane.least = plane.least.min(0.0);
        }
        planes
    }

    /// Compromise for incompatible planes: towards equal violation.
    pub(super) fn compromise(&self) -> Vector3<f64> {
        let pressing = self.as_slice().iter().filter(|plane| plane.least > 0.0);
        let (sum, count) = pressing.fold((Vector3::zeros(), 0_u32), |(sum, count), plane| {
            (sum + plane.normal * plane.least, count + 1)
        });
        sum / f64::from(count.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn direction() -> impl Strategy<Value = Vector3<f64>> {
        (-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64)
            .prop_map(|(x, y, z)| Vector3::new(x, y, z))
            .prop_filter("a direction", |vector| vector.norm() > 0.1)
            .prop_map(|vector| vector.normalize())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(5_000))]
        /// The nearest allowed position violates no plane, and only planes that it lies on push it (the conditions of
        /// Karush, Kuhn and Tucker: for a convex set they are sufficient).
        #[test]
        fn the_place_is_the_projection_onto_what_is_allowed(
            sides in prop::collection::vec((direction(), -0.5..0.0_f64), 0..6), wish in direction()
        ) {
            let mut planes = Planes::none();
            for (owner, &(normal, least)) in sides.iter().enumerate() {
                planes.push(Plane { normal, least, owner }, &wish);
            }
            let held = planes.nearest(&wish, 1e-9).expect("to stay is allowed");
            let mut pushed = wish;
            for (owner, push) in held.active.into_iter().flatten() {
                let (normal, least) = sides[owner];
                prop_assert!(push >= 0.0 && (normal.dot(&held.motion) - least).abs() <= 1e-9);
                pushed += normal * push;
            }
            prop_assert!((pushed - held.motion).norm() < 1e-6, "{held:?}");
            for (normal, least) in &sides {
                prop_assert!(normal.dot(&held.motion) >= least - 1e-9);
            }
        }
    }

    #[test]
    fn planes_that_cannot_be_kept_are_told_and_balanced() {
        let mut planes = Planes::none();
        for (normal, least) in [(Vector3::x(), 0.3), (-Vector3::x(), 0.1)] {
            planes.push(Plane { normal, least, owner: 0 }, &Vector3::zeros());
        }
        assert!(planes.nearest(&Vector3::y(), 1e-12).is_none() && planes.retreat(1e-12, 1.0).is_none());
        assert!((planes.compromise() - Vector3::x() * 0.1).norm() < 1e-15);
        let held = planes.without_retreat().nearest(&Vector3::y(), 1e-12).expect("to stay is allowed");
        assert_eq!(held.motion, Vector3::y());
    }
}
