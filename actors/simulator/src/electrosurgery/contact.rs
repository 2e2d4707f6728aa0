//! How the metal of a tip lies to tissue. The metal is a ball; what of it faces tissue no farther off than where it is nearest
//! conducts: a tip that rests on tissue touches it with a small cap, one that is pressed in with more, up to what is bare.
//!
//! A generator has one output. Where a tip is at several tissues, its current goes into each by the area that faces it, so
//! that all of them together get what the generator gives.

use nalgebra::{Point3, Vector3};

use super::electrode::Electrode;

/// Directions in which the metal is looked at, evenly spread over the ball.
const FACETS: usize = 96;
/// What is so much farther from tissue than where the metal is nearest is in contact still \[m\]: as uneven as tissue is, and
/// as deep as a film of liquid on it.
const UNEVEN: f64 = 0.1e-3;

/// How far the facets of an electrode's metal are from tissue \[m\]; infinite where there is none in reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    away: [f64; FACETS],
}

/// The golden spiral: facets of equal area, to within a few per cent.
fn direction(facet: usize) -> Vector3<f64> {
    let z = 1.0 - (2.0 * facet as f64 + 1.0) / FACETS as f64;
    let angle = facet as f64 * std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let (sin, cos) = angle.sin_cos();
    let ring = (1.0 - z * z).sqrt();
    Vector3::new(ring * cos, ring * sin, z)
}

impl Contact {
    /// Of an electrode that is at no tissue.
    pub const NONE: Self = Self { away: [f64::INFINITY; FACETS] };

    /// To cubes of tissue of that edge \[m\], given by their middles.
    pub(super) fn with_cells(
        electrode: &Electrode,
        edge: f64,
        cells: impl Iterator<Item = Point3<f64>> + Clone,
    ) -> Self {
        let radius = electrode.contact_radius();
        let tip = electrode.tip_in_rest;
        let nearest = cells.clone().map(|middle| (middle - tip).norm_squared()).fold(f64::INFINITY, f64::min);
        // Beyond, no cell can be within what counts of any facet.
        let reach = (nearest.sqrt() - radius).max(0.0) + radius + UNEVEN + edge;
        let facets: [Vector3<f64>; FACETS] = std::array::from_fn(|facet| direction(facet) * radius);
        let mut away = [f64::INFINITY; FACETS];
        for middle in cells.filter(|middle| (middle - tip).norm_squared() <= reach * reach) {
            let from = tip - middle;
            for (facet, away) in facets.iter().zip(&mut away) {
                let outside = (from + facet).map(|x| (x.abs() - edge / 2.0).max(0.0));
                *away = away.min(outside.norm_squared());
            }
        }
        Self { away: away.map(f64::sqrt) }
    }

    /// From the metal to the nearest tissue \[m\].
    #[must_use]
    pub fn nearest(&self) -> f64 {
        self.away.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn facing(&self, nearest: f64) -> usize {
        self.away.iter().filter(|away| **away <= nearest + UNEVEN).count()
    }

    /// Area of the metal that faces the tissue \[m²\]: at most what is bare, at least one facet.
    #[must_use]
    pub fn area(&self, electrode: &Electrode) -> f64 {
        let ball = 4.0 * electrode.contact_area;
        (ball * self.facing(self.nearest()).max(1) as f64 / FACETS as f64).min(electrode.contact_area)
    }
}

/// Which share of an electrode's power goes into each of several tissues. Their sum is 1 where it is at any.
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

    fn at_plate(z: f64, is_left: fn(&Point3<f64>) -> bool) -> Contact {
        Contact::with_cells(&tip(z), EDGE, plate(is_left).iter().copied())
    }

    #[test]
    fn the_deeper_a_tip_is_pressed_the_more_of_it_is_in_contact_up_to_what_is_bare() {
        let radius = tip(0.0).contact_radius();
        // A cap of a ball: 2π r h, here with what is uneven.
        for depth in [0.0, 0.06e-3, 0.12e-3] {
            let contact = at_plate(radius - depth, |_| true);
            let cap = 2.0 * std::f64::consts::PI * radius * (depth + UNEVEN);
            let area = contact.area(&tip(0.0));
            assert!(contact.nearest() < 1e-5 && (area / cap - 1.0).abs() < 0.15, "{depth}: {area} {cap}");
        }
        assert_eq!(at_plate(0.0, |_| true).area(&tip(0.0)), 1e-6);
        // Above tissue what is nearest is what a spark leaves from.
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
        // What lies beneath something else gets nothing.
        let [above, below] = [at_plate(0.5e-3, |p| p.z > -0.5e-3), at_plate(0.5e-3, |p| p.z < -0.5e-3)];
        assert_eq!(of(&[below, above]), [0.0, 1.0]);
        assert_eq!(of(&[Contact::NONE; 2]), [0.0, 0.0]);
    }
}
