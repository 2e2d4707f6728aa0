//! Swept volume of a shaft as it turns about its port, in thin slices of time.

use nalgebra::{Point3, Vector3};
use thiserror::Error;

use crate::continuous::Sweep;

/// Why the sweep of a shaft is invalid.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ShaftError {
    /// A port or tip is not finite.
    #[error("the {which} has a coordinate that is not a finite number")]
    NotFinite {
        /// The point.
        which: &'static str,
    },
    /// The radius is negative or not finite.
    #[error("a radius of {radius} m is not one: 0 and more is valid")]
    Radius {
        /// The value given \[m\].
        radius: f64,
    },
}

/// A shaft between two frames: a tube from its port to its tip, which turns about the port at constant speed in the
/// plane of both directions, slides through it, and is carried along where the port itself moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShaftSweep {
    port: Sweep<Point3<f64>>,
    directions: [Vector3<f64>; 2],
    lengths: [f64; 2],
    angle: f64,
    radius: f64,
}

/// Largest number of slices of a sweep: half a turn in steps of 3°.
const SLICES_MAX: usize = 64;

impl ShaftSweep {
    /// A sweep from the port and the tip in world \[m\] at both frames, and the radius \[m\].
    ///
    /// # Errors
    /// For non-finite coordinates, or a radius that is negative or not finite.
    pub fn new(
        port_in_world: Sweep<Point3<f64>>,
        tip_in_world: Sweep<Point3<f64>>,
        radius: f64,
    ) -> Result<Self, ShaftError> {
        for (which, point) in [
            ("port at the beginning", port_in_world.from),
            ("port at the end", port_in_world.to),
            ("tip at the beginning", tip_in_world.from),
            ("tip at the end", tip_in_world.to),
        ] {
            if !point.iter().all(|coordinate| coordinate.is_finite()) {
                return Err(ShaftError::NotFinite { which });
            }
        }
        if !(radius.is_finite() && radius >= 0.0) {
            return Err(ShaftError::Radius { radius });
        }
        let shafts = [tip_in_world.from - port_in_world.from, tip_in_world.to - port_in_world.to];
        let lengths = shafts.map(|shaft| shaft.norm());
        let units = shafts.map(|shaft| shaft.try_normalize(0.0));
        // A tip in the port takes the direction of the other frame.
        let first = units[0].or(units[1]).unwrap_or_else(Vector3::z);
        let second = units[1].unwrap_or(first);
        let angle = first.cross(&second).norm().atan2(first.dot(&second));
        Ok(Self { port: port_in_world, directions: [first, second], lengths, angle, radius })
    }

    /// Radius of the shaft \[m\].
    #[must_use]
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Port and tip in world at a share of the time between the frames \[m\].
    #[must_use]
    pub fn at(&self, time: f64) -> [Point3<f64>; 2] {
        let port = self.port.from + (self.port.to - self.port.from) * time;
        let [first, second] = self.directions;
        let aside = self.aside();
        let turned = self.angle * time;
        // At the ends exactly the given points.
        let direction = match time {
            0.0 => first,
            1.0 => second,
            _ => first * turned.cos() + aside * turned.sin(),
        };
        [port, port + direction * (self.lengths[0] * (1.0 - time) + self.lengths[1] * time)]
    }

    /// Perpendicular to the first direction, towards the second; any perpendicular if they are parallel.
    fn aside(&self) -> Vector3<f64> {
        let [first, second] = self.directions;
        let aside = second - first * first.dot(&second);
        let aside = aside - first * first.dot(&aside);
        aside.try_normalize(1e-12).unwrap_or_else(|| {
            let across = first.cross(&Vector3::ith(first.iamin(), 1.0));
            across.normalize()
        })
    }

    /// Axes of a view across the plane of motion: along the shaft, aside, and across the plane. Of the possible planes
    /// of motion, the one that the axis leaves least.
    pub(super) fn axes(&self) -> [Vector3<f64>; 3] {
        let along = self.directions[0];
        let ends = [self.at(0.0), self.at(0.5), self.at(1.0)];
        let across = [self.aside(), self.port.to - self.port.from, ends[2][1] - ends[0][1]];
        let mut best: Option<(f64, Vector3<f64>)> = None;
        for aside in across {
            let Some(normal) = along.cross(&aside).try_normalize(1e-12 * aside.norm()) else { continue };
            let range =
                ends.as_flattened().iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], point| {
                    let depth = normal.dot(&(point - ends[0][0]));
                    [low.min(depth), high.max(depth)]
                });
            let depth = range[1] - range[0];
            if best.is_none_or(|(least, _)| depth < least) {
                best = Some((depth, normal));
            }
        }
        let normal = best.map_or_else(|| along.cross(&self.aside()), |(_, normal)| normal);
        [along, normal.cross(&along), normal]
    }

    /// Ends of the axis (port, tip) between thin slices of time, and by how much the motion within a slice can leave
    /// the hull of its four ends \[m\]: at most about `tolerance`, which bounds their number.
    pub(super) fn slices(&self, tolerance: f64) -> (usize, f64) {
        let length = self.lengths[0].max(self.lengths[1]);
        let slide = (self.lengths[1] - self.lengths[0]).abs();
        // The error of a chord: an eighth of the second derivative of length times direction, times the time squared.
        let bulge = |slices: f64| self.angle * (length * self.angle + 2.0 * slide) / (8.0 * slices * slices);
        let carried = (self.port.to - self.port.from).norm();
        let twist = length * self.angle + slide;
        let hull = |slices: f64| carried.min(0.25 * twist) / slices;
        let mut slices = 1;
        while slices < SLICES_MAX && bulge(slices as f64).max(hull(slices as f64)) > tolerance {
            slices += 1;
        }
        (slices, bulge(slices as f64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_turns_about_the_port_and_slides() {
        let port = Sweep { from: Point3::origin(), to: Point3::origin() };
        let tip = Sweep { from: Point3::new(0.1, 0.0, 0.0), to: Point3::new(0.0, 0.2, 0.0) };
        let shaft = ShaftSweep::new(port, tip, 0.005).expect("a shaft");
        assert_eq!((shaft.at(0.0)[1], shaft.at(1.0)[1]), (tip.from, tip.to));
        let half = Point3::new(0.15, 0.15, 0.0) * std::f64::consts::FRAC_1_SQRT_2;
        assert!((shaft.at(0.5)[1] - half).norm() < 1e-15);
        assert!(shaft.axes()[2].xy().norm() < 1e-15);
        // Within the slices the tip is as near to its chords as stated.
        let (slices, bulge) = shaft.slices(1e-4);
        assert!(slices > 1 && slices < SLICES_MAX && bulge <= 1e-4);
        for step in 0..1_000 {
            let time = f64::from(step) / 1_000.0;
            let slice = (time * slices as f64).floor();
            let [from, to] = [slice, slice + 1.0].map(|at| shaft.at(at / slices as f64)[1]);
            let chord = from + (to - from) * (time * slices as f64 - slice);
            assert!((shaft.at(time)[1] - chord).norm() <= bulge * 1.000_001);
        }
    }

    #[test]
    fn what_cannot_be_used_is_named_and_what_stands_still_is_a_shaft() {
        let port = Sweep { from: Point3::origin(), to: Point3::origin() };
        let bad = Sweep { from: Point3::origin(), to: Point3::new(f64::NAN, 0.0, 0.0) };
        let error = ShaftSweep::new(port, bad, 0.01).expect_err("not a number");
        assert_eq!(error.to_string(), "the tip at the end has a coordinate that is not a finite number");
        assert_eq!(ShaftSweep::new(port, port, -1.0), Err(ShaftError::Radius { radius: -1.0 }));
        let still = ShaftSweep::new(port, port, 0.01).expect("a ball");
        assert!(still.at(0.3) == [Point3::origin(); 2] && still.slices(1e-4) == (1, 0.0));
        for axis in still.axes() {
            assert!((axis.norm() - 1.0).abs() < 1e-12);
        }
    }
}
