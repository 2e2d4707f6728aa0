//! Primitives of an entity of `/scene`, as `foxglove.SceneEntity` has them: boxes, balls and cylinders as such, all other
//! forms as triangles, threads as lines.

use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use trocar_scene::mesh::SurfaceData;
use trocar_scene::shapes::{Detail, surface_of};
use trocar_scene::{Shape, SimTime, VisualMaterial};

use super::coarse::Coarse;
use super::numbers::{SURFACE, rounded, stamp};

/// Detail of curved surfaces that are no primitives of the well-known types.
const DETAIL: Detail = Detail { segments: 24, fine_segments: 8 };
/// Of the kinds of lines: pairs of points.
const LINE_LIST: u8 = 2;

/// The primitives of one entity.
pub(super) struct Drawing {
    color: Value,
    cubes: Vec<Value>,
    spheres: Vec<Value>,
    cylinders: Vec<Value>,
    lines: Vec<Value>,
    triangles: Vec<Value>,
}

impl Drawing {
    /// No primitives yet; they will have the material's colour, without its maps.
    pub(super) fn new(material: Option<&VisualMaterial>) -> Self {
        let [r, g, b, a] = material.cloned().unwrap_or_default().base_color;
        let [r, g, b] = [r, g, b].map(|linear| rounded(displayed(linear), 3));
        Self {
            color: json!({"r": r, "g": g, "b": b, "a": rounded(a, 3)}),
            cubes: Vec::new(),
            spheres: Vec::new(),
            cylinders: Vec::new(),
            lines: Vec::new(),
            triangles: Vec::new(),
        }
    }

    /// A shape in the entity's frame.
    pub(super) fn shape(&mut self, shape: &Shape) {
        match shape {
            Shape::Box { half_extents: [x, y, z] } => {
                self.cube([0.0; 3], [2.0 * x, 2.0 * y, 2.0 * z]);
            }
            Shape::Sphere { radius } => self.sphere([0.0; 3], *radius),
            Shape::Cylinder { radius, half_height } => self.cylinder([0.0; 3], *radius, *half_height),
            Shape::Capsule { radius, half_height } => {
                self.cylinder([0.0; 3], *radius, *half_height);
                self.sphere([0.0, 0.0, *half_height], *radius);
                self.sphere([0.0, 0.0, -half_height], *radius);
            }
            Shape::PegBoard { half_extents: [x, y], thickness, pegs, peg_radius, peg_height } => {
                self.cube([0.0, 0.0, -0.5 * thickness], [2.0 * x, 2.0 * y, *thickness]);
                for [x, y] in pegs {
                    self.cylinder([*x, *y, 0.5 * peg_height], *peg_radius, 0.5 * peg_height);
                }
            }
            Shape::Torus { .. } => {
                if let Ok(surface) = surface_of(shape, &DETAIL) {
                    self.surface(&surface);
                }
            }
        }
    }

    /// A whole surface.
    pub(super) fn surface(&mut self, surface: &SurfaceData) {
        self.list_triangles(surface.positions.iter(), &surface.triangles);
    }

    /// A surface with vertices at `positions`.
    pub(super) fn coarse(&mut self, mesh: &Coarse<3>, positions: &[Point3<f64>]) {
        let points = mesh.vertices.iter().filter_map(|vertex| positions.get(*vertex as usize));
        self.list_triangles(points, &mesh.cells);
    }

    /// A thread with points at `positions`.
    pub(super) fn thread(&mut self, mesh: &Coarse<2>, radius: f64, positions: &[Point3<f64>]) {
        let points = mesh.vertices.iter().filter_map(|vertex| positions.get(*vertex as usize));
        self.lines.push(json!({
            "type": LINE_LIST,
            "pose": pose([0.0; 3]),
            "thickness": rounded(2.0 * radius, SURFACE),
            "scale_invariant": false,
            "points": points.map(point).collect::<Vec<_>>(),
            "color": self.color,
            "colors": [],
            "indices": mesh.cells.as_flattened()
        }));
    }

    /// The entity with its primitives.
    pub(super) fn entity(self, id: &str, frame: &str, now: SimTime) -> Value {
        json!({
            "timestamp": stamp(now),
            "frame_id": frame,
            "id": id,
            // Until it is replaced or deleted.
            "lifetime": {"sec": 0, "nsec": 0},
            "frame_locked": true,
            "metadata": [],
            "arrows": [],
            "cubes": self.cubes,
            "spheres": self.spheres,
            "cylinders": self.cylinders,
            "lines": self.lines,
            "triangles": self.triangles,
            "texts": [],
            "models": []
        })
    }

    fn cube(&mut self, center: [f64; 3], size: [f64; 3]) {
        self.cubes.push(json!({"pose": pose(center), "size": coordinates(size), "color": self.color}));
    }

    fn sphere(&mut self, center: [f64; 3], radius: f64) {
        let size = coordinates([2.0 * radius; 3]);
        self.spheres.push(json!({"pose": pose(center), "size": size, "color": self.color}));
    }

    /// About z.
    fn cylinder(&mut self, center: [f64; 3], radius: f64, half_height: f64) {
        let size = coordinates([2.0 * radius, 2.0 * radius, 2.0 * half_height]);
        self.cylinders.push(json!({
            "pose": pose(center), "size": size, "bottom_scale": 1, "top_scale": 1, "color": self.color
        }));
    }

    fn list_triangles<'a>(&mut self, points: impl Iterator<Item = &'a Point3<f64>>, triangles: &[[u32; 3]]) {
        self.triangles.push(json!({
            "pose": pose([0.0; 3]),
            "points": points.map(point).collect::<Vec<_>>(),
            "color": self.color,
            "colors": [],
            "indices": triangles.as_flattened()
        }));
    }
}

/// A pose without rotation.
fn pose(position: [f64; 3]) -> Value {
    json!({"position": coordinates(position), "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}})
}

fn point(point: &Point3<f64>) -> Value {
    coordinates(point.coords.into())
}

fn coordinates(of: [f64; 3]) -> Value {
    super::numbers::vector(&Vector3::from(of), SURFACE)
}

/// A linear share of light as displays encode it (IEC 61966-2-1, sRGB).
fn displayed(linear: f64) -> f64 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}
