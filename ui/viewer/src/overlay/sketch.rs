//! Overlay primitives: coloured lines, triangles and spots in world.

use bytemuck::{Pod, Zeroable};
use nalgebra::{Isometry3, Point3, Vector3};

/// sRGB colour and opacity.
pub type Color = [u8; 4];

/// Sides of an arrow's head.
const HEAD_SIDES: u32 = 12;
/// Most primitives of each kind; further ones are left out.
pub const PRIMITIVES_MAX: usize = 100_000;

/// A line of constant screen width, in the layout of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Line {
    /// One end, in world \[m\].
    pub from: [f32; 3],
    /// Width \[pixels\].
    pub width: f32,
    /// The other end, in world \[m\].
    pub to: [f32; 3],
    /// Remaining opacity where it is hidden, in \[0, 1\].
    pub hidden: f32,
    /// Colour at `from`.
    pub from_color: Color,
    /// Colour at `to`.
    pub to_color: Color,
}

/// A triangle's corner, in the layout of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Corner {
    /// Position in world \[m\].
    pub position: [f32; 3],
    /// Remaining opacity where it is hidden, in \[0, 1\].
    pub hidden: f32,
    /// Its colour.
    pub color: Color,
}

/// A coloured part of an item's surface: its intersection with a ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// Index in the draw list.
    pub item: usize,
    /// Centre of the ball, in world \[m\].
    pub centre: Point3<f64>,
    /// Its radius \[m\].
    pub radius: f64,
}

/// Style of a primitive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Its colour.
    pub color: Color,
    /// Width of lines \[pixels\].
    pub width: f32,
    /// Remaining opacity where it is hidden, in \[0, 1\].
    pub hidden: f32,
}

/// The primitives drawn over a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sketch {
    /// Lines.
    pub lines: Vec<Line>,
    /// Three corners per triangle, visible from both sides.
    pub triangles: Vec<Corner>,
    /// Coloured parts of surfaces.
    pub spots: Vec<Spot>,
}

impl Sketch {
    /// A line.
    pub fn line(&mut self, from: &Point3<f64>, to: &Point3<f64>, stroke: &Stroke) {
        self.fading_line((from, stroke.color), (to, stroke.color), stroke);
    }

    /// A line with a colour at each end.
    pub fn fading_line(
        &mut self,
        (from, from_color): (&Point3<f64>, Color),
        (to, to_color): (&Point3<f64>, Color),
        stroke: &Stroke,
    ) {
        if self.lines.len() < PRIMITIVES_MAX {
            let Stroke { width, hidden, .. } = *stroke;
            self.lines.push(Line { from: single(from), width, to: single(to), hidden, from_color, to_color });
        }
    }

    /// A filled triangle.
    pub fn triangle(&mut self, corners: [Point3<f64>; 3], stroke: &Stroke) {
        if self.triangles.len() < 3 * PRIMITIVES_MAX {
            let Stroke { color, hidden, .. } = *stroke;
            self.triangles.extend(corners.map(|corner| Corner { position: single(&corner), hidden, color }));
        }
    }

    /// A part of an item's surface.
    pub fn spot(&mut self, spot: Spot) {
        if self.spots.len() < PRIMITIVES_MAX {
            self.spots.push(spot);
        }
    }

    /// An arrow that ends at `from + along`; its head has a quarter of the length, and at most 4 mm.
    pub fn arrow(&mut self, from: &Point3<f64>, along: &Vector3<f64>, stroke: &Stroke) {
        let length = along.norm();
        let Some(direction) = along.try_normalize(1e-9) else { return };
        let head = (0.25 * length).min(0.004);
        let tip = from + along;
        let neck = from + direction * (length - head);
        self.line(from, &neck, stroke);
        let across = direction.cross(&if direction.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() });
        let across = across.normalize();
        let other = direction.cross(&across);
        let rim = |side: u32| {
            let angle = std::f64::consts::TAU * f64::from(side % HEAD_SIDES) / f64::from(HEAD_SIDES);
            neck + (across * angle.cos() + other * angle.sin()) * (0.35 * head)
        };
        for side in 0..HEAD_SIDES {
            let (a, b) = (rim(side), rim(side + 1));
            self.triangle([a, b, tip], stroke);
            self.triangle([b, a, neck], stroke);
        }
    }

    /// The axes of a frame: x red, y green, z blue.
    pub fn axes(&mut self, world_from_frame: &Isometry3<f64>, length: f64, width: f32) {
        let origin = Point3::from(world_from_frame.translation.vector);
        let axes = [
            (Vector3::x(), [235, 60, 50, 255]),
            (Vector3::y(), [70, 200, 60, 255]),
            (Vector3::z(), [70, 120, 255, 255]),
        ];
        for (axis, color) in axes {
            let end = world_from_frame * Point3::from(axis * length);
            self.line(&origin, &end, &Stroke { color, width, hidden: 0.4 });
        }
    }

    /// The edges of a box in a frame.
    pub fn cuboid(
        &mut self,
        world_from_frame: &Isometry3<f64>,
        min: &Point3<f64>,
        max: &Point3<f64>,
        stroke: &Stroke,
    ) {
        let corner = |index: usize| {
            let pick = |axis: usize| if index >> axis & 1 == 0 { min[axis] } else { max[axis] };
            world_from_frame * Point3::new(pick(0), pick(1), pick(2))
        };
        for from in 0..8_usize {
            for axis in (0..3).filter(|axis| from >> axis & 1 == 0) {
                self.line(&corner(from), &corner(from | 1 << axis), stroke);
            }
        }
    }
}

fn single(point: &Point3<f64>) -> [f32; 3] {
    [point.x as f32, point.y as f32, point.z as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    const STROKE: Stroke = Stroke { color: [1, 2, 3, 255], width: 2.0, hidden: 0.5 };

    #[test]
    fn an_arrow_ends_where_it_points() {
        let mut sketch = Sketch::default();
        sketch.arrow(&Point3::new(1.0, 0.0, 0.0), &Vector3::new(0.0, 0.0, 0.02), &STROKE);
        let highest = sketch.triangles.iter().map(|corner| corner.position[2]).fold(0.0, f32::max);
        assert_eq!(highest, 0.02);
        assert_eq!(sketch.lines[0].from, [1.0, 0.0, 0.0]);
        assert!((sketch.lines[0].to[2] - 0.016).abs() < 1e-7);
        // A zero vector gives no arrow.
        sketch.arrow(&Point3::origin(), &Vector3::zeros(), &STROKE);
        assert_eq!(sketch.lines.len(), 1);
    }

    #[test]
    fn a_box_has_twelve_edges_of_its_lengths() {
        let mut sketch = Sketch::default();
        let max = Point3::new(1.0, 2.0, 3.0);
        sketch.cuboid(&Isometry3::identity(), &Point3::origin(), &max, &STROKE);
        let length = |line: &Line| (0..3).map(|axis| (line.to[axis] - line.from[axis]).abs()).sum::<f32>();
        let mut lengths: Vec<f32> = sketch.lines.iter().map(length).collect();
        lengths.sort_by(f32::total_cmp);
        assert_eq!(lengths, [1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0]);
    }

    #[test]
    fn there_is_an_end_to_what_is_drawn() {
        let mut sketch = Sketch::default();
        for _ in 0..PRIMITIVES_MAX + 10 {
            sketch.line(&Point3::origin(), &Point3::origin(), &STROKE);
        }
        assert_eq!(sketch.lines.len(), PRIMITIVES_MAX);
    }
}
