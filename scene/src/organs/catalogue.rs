//! Catalogue of organs. Sizes are those of an adult in round numbers (Netter, Atlas of Human Anatomy; Standring, Gray's
//! Anatomy); shapes are for training scenes, not for measuring. Every organ has its middle at the origin, x to the
//! patient's left, y to the back, z to the head.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::implicit::{Implicit, Part};

/// A procedurally generated organ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Organ {
    /// A wedge of about 22 by 15 by 10 cm, thick on the right, thin on the left.
    Liver,
    /// Bent like a J, about 20 cm long, filled.
    Stomach,
    /// A pear of 8 cm.
    Gallbladder,
    /// A bean of 11 cm with its hilum.
    Kidney,
    /// A cushion of 12 by 7 by 4 cm.
    Spleen,
    /// The fundus of a stomach and its oesophagus: what a band is laid around.
    Fundus,
}

impl Organ {
    /// Every organ.
    pub const ALL: [Self; 6] =
        [Self::Liver, Self::Stomach, Self::Gallbladder, Self::Kidney, Self::Spleen, Self::Fundus];

    /// Its implicit function.
    pub fn implicit(self) -> Implicit {
        match self {
            Self::Liver => liver(),
            Self::Stomach => stomach(),
            Self::Gallbladder => gallbladder(),
            Self::Kidney => kidney(),
            Self::Spleen => spleen(),
            Self::Fundus => fundus(),
        }
    }
}

fn ellipsoid(middle: [f64; 3], radii: [f64; 3], turn: [f64; 3]) -> Part {
    let pose = Isometry3::from_parts(
        Vector3::from(middle).into(),
        UnitQuaternion::from_scaled_axis(Vector3::from(turn)),
    );
    Part::Ellipsoid { pose, radii: Vector3::from(radii) }
}

/// A tube through points with a radius at each.
fn path(points: &[([f64; 3], f64)]) -> Vec<Part> {
    points
        .windows(2)
        .map(|pair| Part::Cone {
            ends: [Point3::from(pair[0].0), Point3::from(pair[1].0)],
            radii: [pair[0].1, pair[1].1],
        })
        .collect()
}

fn liver() -> Implicit {
    Implicit {
        parts: vec![
            ellipsoid([-0.045, 0.0, 0.0], [0.075, 0.062, 0.070], [0.0, 0.0, 0.2]),
            ellipsoid([0.030, -0.012, 0.014], [0.085, 0.045, 0.040], [0.0, 0.25, -0.1]),
            ellipsoid([-0.005, -0.030, -0.012], [0.045, 0.028, 0.045], [0.0; 3]),
        ],
        // The visceral surface, hollowed by its neighbours.
        cuts: vec![(Point3::new(0.0, 0.030, -0.030), Vector3::new(0.35, 0.62, -0.70).normalize())],
        hollows: vec![ellipsoid([-0.005, 0.045, -0.050], [0.035, 0.030, 0.045], [0.0; 3])],
        blend: 0.025,
        wall: None,
    }
}

fn stomach() -> Implicit {
    let bend = path(&[
        ([0.045, 0.010, 0.085], 0.034),
        ([0.052, 0.000, 0.045], 0.038),
        ([0.046, -0.010, 0.005], 0.035),
        ([0.026, -0.018, -0.032], 0.030),
        ([-0.006, -0.020, -0.052], 0.025),
        ([-0.036, -0.014, -0.050], 0.019),
        ([-0.056, -0.006, -0.038], 0.013),
    ]);
    let oesophagus = path(&[([0.012, 0.014, 0.078], 0.011), ([0.006, 0.018, 0.120], 0.010)]);
    Implicit { parts: [bend, oesophagus].concat(), blend: 0.022, ..Default::default() }
}

fn gallbladder() -> Implicit {
    let pear = path(&[
        ([0.0, 0.0, -0.022], 0.016),
        ([0.0, 0.0, 0.004], 0.012),
        ([0.003, 0.002, 0.026], 0.006),
        ([0.010, 0.004, 0.038], 0.004),
    ]);
    Implicit { parts: pear, blend: 0.008, ..Default::default() }
}

fn kidney() -> Implicit {
    Implicit {
        parts: vec![ellipsoid([0.0; 3], [0.028, 0.020, 0.055], [0.0; 3])],
        hollows: vec![ellipsoid([0.034, 0.0, 0.0], [0.020, 0.024, 0.024], [0.0; 3])],
        blend: 0.012,
        ..Default::default()
    }
}

fn spleen() -> Implicit {
    Implicit {
        parts: vec![ellipsoid([0.0; 3], [0.022, 0.036, 0.060], [0.0; 3])],
        hollows: vec![ellipsoid([-0.036, 0.0, 0.0], [0.028, 0.050, 0.070], [0.0; 3])],
        blend: 0.010,
        ..Default::default()
    }
}

fn fundus() -> Implicit {
    let bag =
        path(&[([0.020, 0.0, 0.022], 0.026), ([0.014, 0.0, -0.012], 0.028), ([0.006, 0.0, -0.042], 0.024)]);
    let oesophagus = path(&[([0.0, 0.0, 0.0], 0.011), ([-0.012, 0.004, 0.062], 0.010)]);
    Implicit { parts: [bag, oesophagus].concat(), blend: 0.012, ..Default::default() }
}

#[cfg(test)]
mod tests {
    use super::super::tetrahedra;
    use super::*;
    use crate::mesh::{validate_surface, validate_tets};

    #[test]
    fn every_organ_is_one_closed_body_without_bad_tetrahedra() {
        for organ in Organ::ALL {
            let body = organ.implicit();
            let [low, high] = body.bounds().unwrap();
            let edge = (high - low).max() / 24.0;
            for levels in [0, 2] {
                let data = tetrahedra(&body, edge, levels).unwrap();
                let report = validate_tets(&data);
                assert_eq!((report.components, report.inverted.count), (1, 0), "{organ:?}: {report}");
                assert_eq!((report.degenerate.count, report.non_manifold_faces.count), (0, 0), "{organ:?}");
                let (surface, _) = data.boundary();
                let report = validate_surface(&surface);
                assert!(report.is_closed() && report.is_oriented(), "{organ:?}: {report}");
                assert!(report.is_manifold(), "{organ:?}: {report}");
                assert_eq!(report.euler_characteristic(), 2, "{organ:?}: {report}");
            }
        }
    }

    #[test]
    fn organs_are_as_large_as_organs() {
        let volume = |organ: Organ, edge: f64| tetrahedra(&organ.implicit(), edge, 2).unwrap().volume() * 1e6;
        // Millilitres, in round numbers; a stomach as full as it is after a meal.
        for (organ, edge, range) in [
            (Organ::Liver, 0.006, 900.0..1800.0),
            (Organ::Stomach, 0.006, 500.0..1500.0),
            (Organ::Gallbladder, 0.003, 20.0..60.0),
            (Organ::Kidney, 0.004, 100.0..250.0),
            (Organ::Spleen, 0.004, 100.0..250.0),
        ] {
            let volume = volume(organ, edge);
            assert!(range.contains(&volume), "{organ:?}: {volume} ml");
        }
    }
}
