//! Contact of an electrode's metal with tissue. The metal is a sphere; its parts that are hardly farther from tissue
//! than its nearest point conduct: a tip resting on tissue has a small contact cap, one pressed in a larger one, up to
//! the bare metal.
//!
//! With coagulating current this holds only while the touched tissue is wet. As it dries, it insulates, the generator's
//! voltage rises to that of its open circuit, and sparks leave the metal wherever tissue is in reach (Pearce,
//! *Electrosurgery*, 1986): the burned width then does not depend on a step in the wall of a crater.
//!
//! A generator has one output. If a tip touches several tissues, its current is divided by contact area, so that they
//! share the generator's power.

use nalgebra::{Point3, Vector3};

use super::electrode::{Electrode, Mode};

/// Number of facets, evenly spread over the sphere.
const FACETS: usize = 96;
/// Metal this much farther from tissue than the nearest point is still in contact \[m\]: the roughness of tissue, and
/// the depth of a film of liquid on it.
const UNEVEN: f64 = 0.1e-3;

/// Distances of an electrode's facets from tissue \[m\]; infinite where there is none in reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    away: [f64; FACETS],
    /// Mean remaining water fraction of the touched cells; 0 where there are none.
    wet: f64,
}

/// The golden spiral: facets of equal area, to within a few per cent.
fn direction(facet: usize) -> Vector3<f64> {
    let z = 1.0 - (2.0 * facet as f64 + 1.0) / FACETS as f64;
    let angle = facet as f64 * std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let (sin, cos) = angle.sin_cos();
    let ring = (1.0 - z * z).sqrt();
    Vector3::new(ring * cos, ring * sin, z)
}

/// A tissue cell that metal may face.
#[derive(Clone, Copy, Debug)]
pub(super) struct FacedCell {
    /// Centre \[m\].
    pub middle: Point3<f64>,
    /// Remaining water fraction.
    pub water: f64,
}

impl Contact {
    /// For an electrode without tissue in reach.
    pub const NONE: Self = Self { away: [f64::INFINITY; FACETS], wet: 0.0 };

    /// For tissue cells of this edge length \[m\], given by centre and remaining water fraction.
    pub(super) fn with_cells(
        electrode: &Electrode,
        edge: f64,
        cells: impl Iterator<Item = FacedCell> + Clone,
    ) -> Self {
        let radius = electrode.contact_radius();
        let tip = electrode.tip_in_rest;
        let middles = cells.clone().map(|cell| (cell.middle - tip).norm_squared());
        let nearest = middles.fold(f64::INFINITY, f64::min).sqrt();
        // Farther cells are out of range of every facet; for sparks, they are hidden by the sphere.
        let counts = match electrode.mode {
            Mode::Cut => UNEVEN,
            Mode::Coagulate => UNEVEN.max(2.0 * radius),
        };
        let reach = nearest.max(radius) + counts + edge;
        let facets: [Vector3<f64>; FACETS] = std::array::from_fn(|facet| direction(facet) * radius);
        let mut away = [(f64::INFINITY, 0.0); FACETS];
        for cell in cells.filter(|cell| (cell.middle - tip).norm_squared() <= reach * reach) {
            let from = tip - cell.middle;
            for (facet, away) in facets.iter().zip(&mut away) {
                let outside = (from + facet).map(|x| (x.abs() - edge / 2.0).max(0.0)).norm_squared();
                if outside < away.0 {
                    *away = (outside, cell.water);
                }
            }
        }
        let touched =
            || away.iter().filter(|(squared, _)| *squared <= UNEVEN * UNEVEN).map(|(_, water)| water);
        Self {
            away: away.map(|(squared, _)| squared.sqrt()),
            wet: touched().sum::<f64>() / touched().count().max(1) as f64,
        }
    }

    /// Distance from the metal to the nearest tissue \[m\].
    #[must_use]
    pub fn nearest(&self) -> f64 {
        self.away.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn facing(&self, nearest: f64) -> usize {
        self.away.iter().filter(|away| **away <= nearest + UNEVEN).count()
    }

    /// Metal area from which current flows \[m²\]: at least one facet, at most the bare metal.
    #[must_use]
    pub fn area(&self, electrode: &Electrode) -> f64 {
        let nearest = self.nearest();
        let mut facets = self.facing(nearest).max(1) as f64;
        if electrode.mode == Mode::Coagulate {
            // Each facet is weighted by its spark efficiency relative to the best one.
            let best = electrode.efficiency(nearest).max(f64::MIN_POSITIVE);
            let sparks: f64 = self.away.iter().map(|away| electrode.efficiency(*away) / best).sum();
            facets += (1.0 - self.wet) * (sparks - facets).max(0.0);
        }
        (4.0 * electrode.contact_area * facets / FACETS as f64).min(electrode.contact_area)
    }
}

/// Fraction of an electrode's power that goes into each of several tissues. The sum is 1 where it is at any.
pub fn shares(contacts: &[Contact]) -> impl Iterator<Item = f64> + '_ {
    let nearest = contacts.iter().map(Contact::nearest).fold(f64::INFINITY, f64::min);
    let facing = move |contact: &Contact| if nearest.is_finite() { contact.facing(nearest) } else { 0 };
    let all: usize = contacts.iter().map(facing).sum();
    contacts.iter().map(move |contact| facing(contact) as f64 / all.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::super::Mode;
    use super::*;

    const EDGE: f64 = 0.1e-3;

    fn tip(z: f64) -> Electrode {
        let tip_in_rest = Point3::new(0.0, 0.0, z);
        Electrode { tip_in_rest, power: 30.0, mode: Mode::Cut, contact_area: 1e-6 }
    }

    /// A plate of 4 mm by 4 mm by 2 mm with its upper side at z = 0, where `is_left`.
    fn plate(is_left: fn(&Point3<f64>) -> bool) -> Vec<Point3<f64>> {
        let at = |index: i32| (f64::from(index) + 0.5) * EDGE;
        (-20..20)
            .flat_map(|i| (-20..20).flat_map(move |j| (-20..0).map(move |k| [i, j, k])))
            .map(|cell: [i32; 3]| Point3::from(cell.map(at)))
            .filter(is_left)
            .collect()
    }

    fn wet_plate(tip: &Electrode, is_left: fn(&Point3<f64>) -> bool, water: f64) -> Contact {
        let cells = plate(is_left);
        Contact::with_cells(tip, EDGE, cells.iter().map(|middle| FacedCell { middle: *middle, water }))
    }

    fn at_plate(z: f64, is_left: fn(&Point3<f64>) -> bool) -> Contact {
        wet_plate(&tip(z), is_left, 1.0)
    }

    #[test]
    fn the_deeper_a_tip_is_pressed_the_more_of_it_is_in_contact_up_to_what_is_bare() {
        let radius = tip(0.0).contact_radius();
        // A spherical cap: 2π r h, including the roughness.
        for depth in [0.0, 0.06e-3, 0.12e-3] {
            let contact = at_plate(radius - depth, |_| true);
            let cap = 2.0 * std::f64::consts::PI * radius * (depth + UNEVEN);
            let area = contact.area(&tip(0.0));
            assert!(contact.nearest() < 1e-5 && (area / cap - 1.0).abs() < 0.15, "{depth}: {area} {cap}");
        }
        assert_eq!(at_plate(0.0, |_| true).area(&tip(0.0)), 1e-6);
        // Above tissue, sparks leave from the nearest facets.
        let above = at_plate(radius + 0.3e-3, |_| true);
        assert!((above.nearest() - 0.3e-3).abs() < 2e-5, "{}", above.nearest());
        assert!(above.area(&tip(0.0)) < 0.5e-6);
        assert_eq!(Contact::NONE.nearest(), f64::INFINITY);
    }

    #[test]
    fn tissues_share_one_power_by_the_area_that_faces_them() {
        let [left, right] = [at_plate(0.0, |p| p.x < 0.0), at_plate(0.0, |p| p.x > 0.0)];
        let of = |contacts: &[Contact]| shares(contacts).collect::<Vec<_>>();
        let both = of(&[left, right, Contact::NONE]);
        assert!((both[0] - 0.5).abs() < 0.1 && both[2] == 0.0, "{both:?}");
        assert!((both.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert_eq!(of(&[Contact::NONE, right]), [0.0, 1.0], "one alone gets all");
        // Hidden tissue gets nothing.
        let [above, below] = [at_plate(0.5e-3, |p| p.z > -0.5e-3), at_plate(0.5e-3, |p| p.z < -0.5e-3)];
        assert_eq!(of(&[below, above]), [0.0, 1.0]);
        assert_eq!(of(&[Contact::NONE; 2]), [0.0, 0.0]);
    }

    #[test]
    fn as_what_a_coagulating_tip_touches_dries_sparks_leave_all_of_its_bare_metal() {
        let touching = |mode: Mode, water: f64| {
            let tip = Electrode { mode, ..tip(0.565e-3) };
            wet_plate(&tip, |_| true, water).area(&tip)
        };
        let cap = touching(Mode::Cut, 1.0);
        assert!(cap < 0.5e-6, "{cap}");
        assert_eq!([touching(Mode::Cut, 0.0), touching(Mode::Coagulate, 1.0)], [cap; 2]);
        assert_eq!(touching(Mode::Coagulate, 0.0), 1e-6);
        let half = touching(Mode::Coagulate, 0.8);
        assert!(half > 1.2 * cap && half < 1e-6, "{half} between {cap} and all");
        // Across air nothing wet conducts, as far as sparks reach.
        for (gap, is_reached) in [(1e-3, true), (4e-3, false)] {
            let tip = Electrode { mode: Mode::Coagulate, ..tip(0.565e-3 + gap) };
            let area = wet_plate(&tip, |_| true, 1.0).area(&tip);
            assert_eq!(area == 1e-6, is_reached, "{area} over {gap} m");
        }
    }
}
