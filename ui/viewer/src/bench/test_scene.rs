//! A generated test scene: tissue, moving instruments, a lamp with shadows.

use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use trocar_scene::{
    Burn, Commands, Entity, EntityAllocator, Instrument, Light, Pose, RegistryBuilder, SCENARIO_SPAWNER,
    Shape, SimTime, Snapshot, Store, SurfaceMesh, Texture, TextureCoordinates, VertexPositions,
    VisualMaterial,
};

use crate::draw_list::DrawList;
use crate::view::{Lens, View};

/// Tissues, each with its centre \[m\] and its size \[m\].
const SHEETS: [(&str, [f64; 3], f64); 4] = [
    ("peritoneum", [0.0, 0.03, -0.012], 0.40),
    ("liver", [-0.045, 0.04, 0.014], 0.10),
    ("fat", [0.050, 0.045, 0.020], 0.09),
    ("gallbladder", [0.005, -0.010, 0.010], 0.05),
];
/// A scene with so many triangles: four wet tissues with all four maps, two steel instruments and three rubber rings,
/// under one lamp with shadows. The materials are those of the scenarios, without relief; tissue fills the picture, so
/// that every pixel is shaded.
pub struct TestScene {
    store: Store,
    commands: Commands,
    instruments: Vec<Entity>,
    sheets: Vec<(Entity, Vec<Point3<f64>>)>,
    steps: u32,
}

impl TestScene {
    /// With about so many triangles.
    pub fn new(triangles: usize) -> Self {
        let mut test_scene = Self::empty();
        test_scene.hardware();
        let mut draw_list = DrawList::new();
        draw_list.update(&test_scene.snapshot());
        let hardware: usize =
            draw_list.items().iter().map(|item| item.surface.geometry.indices.len() / 3).sum();
        let share = triangles.saturating_sub(hardware) / SHEETS.len();
        // Two triangles per square.
        let side = ((share as f64 / 2.0).sqrt().round() as usize).max(1);
        for (name, middle, size) in SHEETS {
            test_scene.sheet(name, middle.into(), size, side);
        }
        test_scene
    }

    /// One sheet of tissue with `side × side` vertices that deforms as a whole, and nothing else.
    pub fn sheet_of(side: usize) -> Self {
        let mut test_scene = Self::empty();
        test_scene.sheet("liver", Point3::origin(), 0.2, side.max(2) - 1);
        test_scene
    }

    fn empty() -> Self {
        let mut builder = RegistryBuilder::default();
        // The standard components have unique names.
        let registered = trocar_scene::register(&mut builder);
        debug_assert!(registered.is_ok(), "{registered:?}");
        let registry = builder.build();
        let commands = Commands::new(Arc::clone(&registry), EntityAllocator::new(0, SCENARIO_SPAWNER));
        Self { store: Store::new(registry), commands, instruments: Vec::new(), sheets: Vec::new(), steps: 0 }
    }

    /// The snapshot for the viewer.
    pub fn snapshot(&self) -> Snapshot {
        self.store.snapshot()
    }

    /// A view from above the tissue, as through a laparoscope.
    pub fn view(&self, aspect: f64) -> View {
        let lens = Lens { field_of_view: 0.75, aspect, near: 0.01, far: 1.0, shift: [0.0; 2] };
        View::looking_at(Point3::new(0.0, -0.11, 0.13), Point3::new(0.0, 0.012, 0.0), Vector3::z(), lens)
    }

    /// Moves both instruments a little.
    pub fn move_instruments(&mut self) {
        self.steps += 1;
        let swing = 0.05 * f64::from(self.steps).sin();
        let instruments = self.instruments.clone();
        self.write(|out| {
            for (side, instrument) in [-1.0, 1.0].into_iter().zip(instruments) {
                out.put(instrument, instrument_pose(side, swing));
            }
        });
    }

    /// Moves every vertex of the first sheet.
    pub fn deform(&mut self) {
        self.steps += 1;
        let phase = 0.1 * f64::from(self.steps);
        let Some((sheet, rest)) = self.sheets.first() else { return };
        let moved = |point: &Point3<f64>| {
            point + Vector3::z() * (0.002 * (60.0 * point.x + phase).sin() * (60.0 * point.y).cos())
        };
        let (sheet, positions) = (*sheet, Arc::new(rest.iter().map(moved).collect()));
        self.write(|out| out.put(sheet, VertexPositions { positions }));
    }

    fn write<T>(&mut self, write: impl FnOnce(&mut Commands) -> T) -> T {
        self.commands.begin(SimTime::ZERO);
        let value = write(&mut self.commands);
        self.store.apply(&mut self.commands, SimTime::ZERO);
        value
    }

    fn sheet(&mut self, name: &str, middle: Point3<f64>, size: f64, squares: usize) {
        let corners = squares + 1;
        let grid = || (0..corners).flat_map(move |j| (0..corners).map(move |i| (i, j)));
        let uv = |(i, j): (usize, usize)| Vector2::new(i as f64, j as f64) / squares as f64;
        let positions: Vec<Point3<f64>> = grid()
            .map(uv)
            .map(|uv| {
                let (x, y) = ((uv.x - 0.5) * size, (uv.y - 0.5) * size);
                // A dome that goes below its neighbours at the edge, with folds.
                let rim = (2.0 * (uv - Vector2::repeat(0.5))).norm_squared();
                let folds = (9.0 * uv.x).sin() * (7.0 * uv.y).cos() + 0.4 * (23.0 * uv.x + 17.0 * uv.y).sin();
                middle + Vector3::new(x, y, size * (0.03 * folds + 0.06 * (1.0 - rim)))
            })
            .collect();
        let at = |i: usize, j: usize| (j * corners + i) as u32;
        let triangles = (0..squares)
            .flat_map(|j| (0..squares).map(move |i| (i, j)))
            .flat_map(|(i, j)| {
                let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]]
            })
            .collect();
        // Coagulated in one place, so that the edit map is not empty.
        let omega = grid().map(|at| 3.0 * (1.0 - 12.0 * (uv(at) - Vector2::new(0.45, 0.4)).norm()).max(0.0));
        let burn = Burn { omega: Arc::new(omega.collect()) };
        let map = || Some(Texture::Procedural(name.to_owned()));
        let material = VisualMaterial {
            base_color: [1.0; 4],
            wetness: 0.8,
            tiling: [(size / 0.05).ceil(); 2],
            color_map: map(),
            normal_map: map(),
            free_map: map(),
            ..VisualMaterial::default()
        };
        let uvs = TextureCoordinates { uv: Arc::new(grid().map(uv).collect()) };
        let rest = positions.clone();
        let sheet = self.write(|out| {
            let sheet = out.spawn();
            out.put(sheet, VertexPositions { positions: Arc::new(positions) });
            out.put(sheet, SurfaceMesh { triangles: Arc::new(triangles) });
            out.put(sheet, uvs);
            out.put(sheet, burn);
            out.put(sheet, material);
            sheet
        });
        self.sheets.push((sheet, rest));
    }

    fn hardware(&mut self) {
        self.instruments = self.write(|out| {
            let mut instruments = Vec::new();
            for side in [-1.0, 1.0] {
                let entity = out.spawn();
                instruments.push(entity);
                let steel = VisualMaterial {
                    base_color: [0.75, 0.75, 0.78, 1.0],
                    roughness: 0.25,
                    metalness: 1.0,
                    ..VisualMaterial::default()
                };
                out.put(entity, Instrument::default());
                out.put(entity, steel);
                out.put(entity, instrument_pose(side, 0.0));
            }
            for x in [-0.03, 0.0, 0.03] {
                let ring = out.spawn();
                let rubber =
                    VisualMaterial { base_color: [0.85, 0.1, 0.1, 1.0], ..VisualMaterial::default() };
                out.put(ring, Shape::Torus { ring_radius: 0.008, tube_radius: 0.0015 });
                out.put(ring, rubber);
                out.put(ring, Pose::at(x, -0.03, 0.02));
            }
            let lamp = out.spawn();
            out.put(lamp, Light { cone_angle: 0.7, shadows: true, ..Light::default() });
            let eye = Point3::new(0.05, -0.10, 0.20);
            let looking = View::looking_at(eye, Point3::new(0.0, 0.02, 0.0), Vector3::z(), Lens::default());
            out.put(lamp, Pose::from(looking.world_from_eye));
            instruments
        });
    }
}

/// The tip is beside the middle, the shaft comes from behind the eye.
fn instrument_pose(side: f64, swing: f64) -> Pose {
    let tip = Vector3::new(0.015 * side, 0.0, 0.025);
    let towards = Vector3::new(-0.4 * side + swing, 0.55, -0.7);
    let turn = UnitQuaternion::rotation_between(&Vector3::z(), &towards).unwrap_or_default();
    Pose::new(tip, turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_theatre_has_about_as_many_triangles_as_were_asked_for() {
        for asked in [20_000, 200_000] {
            let mut draw_list = DrawList::new();
            draw_list.update(&TestScene::new(asked).snapshot());
            let triangles: usize =
                draw_list.items().iter().map(|item| item.surface.geometry.indices.len() / 3).sum();
            assert!(triangles.abs_diff(asked) * 20 < asked, "{triangles} of {asked}");
        }
    }
}
