//! Clamping of a vessel between jaws. Its wall is inextensible: squeezed to a gap g, its section is a stadium of the
//! same perimeter with 2 (g/d) − (g/d)² of the round area; zero where the walls meet.

use nalgebra::{Isometry3, Point3};

/// A pair of jaws, in an instrument's frame: origin at the tip, hinge at z = −`length`, closing along x, blades of
/// `width` along y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jaws {
    /// Length from the hinge to the tip \[m\].
    pub length: f64,
    /// Width of the blades \[m\].
    pub width: f64,
    /// Full opening \[rad\].
    pub angle: f64,
}

/// A round tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tube {
    /// Inner radius \[m\].
    pub radius: f64,
    /// Thickness of the wall \[m\].
    pub wall: f64,
}

impl Tube {
    /// Closed fraction of its section between two parallel plates `gap` \[m\] apart.
    #[must_use]
    pub fn closed_share(&self, gap: f64) -> f64 {
        let open = ((gap - 2.0 * self.wall) / (2.0 * self.radius)).clamp(0.0, 1.0);
        (1.0 - open) * (1.0 - open)
    }
}

impl Jaws {
    /// Closed fraction of the tube's section. `line` is its centre line from the source \[m\] to the point of interest.
    #[must_use]
    pub fn closed_share(&self, jaws_from_line: &Isometry3<f64>, line: &[Point3<f64>], tube: &Tube) -> f64 {
        let outer = tube.radius + tube.wall;
        let mut closed: f64 = 0.0;
        for ends in line.windows(2) {
            let [a, b] = [jaws_from_line * ends[0], jaws_from_line * ends[1]];
            let Some(at) = self.crossing(&a, &b) else { continue };
            let along = at.z + self.length;
            if !(0.0..=self.length + outer).contains(&along) {
                continue;
            }
            let half = along.min(self.length) * (0.5 * self.angle).clamp(0.0, 1.5).tan();
            // The tube is soft, and moves into the space between the jaws.
            if at.x.abs() <= half + outer {
                closed = closed.max(tube.closed_share(2.0 * half));
            }
        }
        closed
    }

    /// The point of a segment nearest to the middle of the blades, if it is between them.
    fn crossing(&self, a: &Point3<f64>, b: &Point3<f64>) -> Option<Point3<f64>> {
        let run = b.y - a.y;
        let share = if run.abs() < 1e-12 { 0.0 } else { (-a.y / run).clamp(0.0, 1.0) };
        let at = a + (b - a) * share;
        (at.y.abs() <= 0.5 * self.width).then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, Vector3};

    const TUBE: Tube = Tube { radius: 1e-3, wall: 0.2e-3 };

    #[test]
    fn a_squeezed_tube_has_the_section_of_a_stadium() {
        assert!(TUBE.closed_share(2.4e-3) < 1e-12);
        assert_eq!(TUBE.closed_share(2.5e-3), 0.0);
        assert!(TUBE.closed_share(0.4e-3) > 1.0 - 1e-12);
        assert_eq!(TUBE.closed_share(0.0), 1.0);
        // At half the inner width: two half circles of 0.5 mm, and the rest of the perimeter between them.
        let (gap, around) = (1e-3, std::f64::consts::PI * 2e-3);
        let section =
            gap * (around - std::f64::consts::PI * gap) / 2.0 + std::f64::consts::PI * gap * gap / 4.0;
        let open = section / (std::f64::consts::PI * 1e-6);
        assert!((1.0 - TUBE.closed_share(1.4e-3) - open).abs() < 1e-12);
    }

    #[test]
    fn only_what_is_between_closed_jaws_is_closed() {
        let line = [Point3::new(0.0, -0.02, -0.004), Point3::new(0.0, 0.02, -0.004)];
        let jaws = Jaws { length: 0.012, width: 0.003, angle: 0.0 };
        let here = Isometry3::identity();
        let at = |x: f64, y: f64, z: f64| Isometry3::from(Translation3::new(x, y, z));
        assert_eq!(jaws.closed_share(&here, &line, &TUBE), 1.0);
        // Beside it, in front of it, behind the hinge, and past its end.
        for away in [at(0.005, 0.0, 0.0), at(0.0, 0.0, 0.01), at(0.0, 0.0, -0.01), at(0.0, 0.03, 0.0)] {
            assert_eq!(jaws.closed_share(&away, &line, &TUBE), 0.0, "{away}");
        }
        assert_eq!(jaws.closed_share(&here, &line[..1], &TUBE), 0.0, "no line");
        // Opening the jaws opens it, more so nearer to the tip.
        let open = |angle: f64| Jaws { angle, ..jaws }.closed_share(&here, &line, &TUBE);
        let shares = [open(0.06), open(0.12), open(0.2), open(0.4)];
        assert!(shares.windows(2).all(|pair| pair[0] > pair[1] || pair[0] == 0.0), "{shares:?}");
        assert!(shares[0] > 0.9 && shares[3] == 0.0, "{shares:?}");
        let deeper = Jaws { angle: 0.12, ..jaws }.closed_share(&at(0.0, 0.0, -0.006), &line, &TUBE);
        assert!(deeper > shares[1], "{deeper}");
        // A vessel parallel to the blades: its middle counts.
        let along = [Point3::new(0.0, 0.0, -0.1), Point3::from(Vector3::new(0.0, 0.0, 0.0))];
        assert!(jaws.closed_share(&here, &along, &TUBE) <= 1.0);
    }
}
