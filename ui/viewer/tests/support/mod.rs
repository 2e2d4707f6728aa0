//! Small scenes, and pictures of them.

pub mod gallery;
pub mod perceptual;
pub mod reference;

use std::path::Path;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_scene::{
    Commands, Entity, EntityAllocator, Light, Pose, Registry, RegistryBuilder, SCENARIO_SPAWNER, Scenario,
    Shape, SimTime, Snapshot, Store, VisualMaterial,
};
use trocar_viewer::{Layout, Lens, OffscreenRenderer, Picture, View};

/// A square of so many cells along each side: texture coordinates of its corners (0 to 1), and two triangles a cell.
pub fn grid(cells: u32) -> (Vec<[f64; 2]>, Vec<[u32; 3]>) {
    let share = |index: u32| f64::from(index) / f64::from(cells);
    let corners = (0..=cells).flat_map(|row| (0..=cells).map(move |column| [column, row].map(share)));
    let cell = |row: u32, column: u32| {
        let a = row * (cells + 1) + column;
        let (b, c, d) = (a + 1, a + cells + 2, a + cells + 1);
        [[a, b, c], [a, c, d]]
    };
    let triangles = (0..cells).flat_map(|row| (0..cells).flat_map(move |column| cell(row, column)));
    (corners.collect(), triangles.collect())
}

/// A scene that tests write into.
pub struct Scene {
    store: Store,
    commands: Commands,
    time: SimTime,
}

impl Scene {
    pub fn new() -> Self {
        let mut builder = RegistryBuilder::default();
        trocar_scene::register(&mut builder).expect("the standard components");
        let registry: Arc<Registry> = builder.build();
        let commands = Commands::new(Arc::clone(&registry), EntityAllocator::new(0, SCENARIO_SPAWNER));
        Self { store: Store::new(registry), commands, time: SimTime::ZERO }
    }
    /// What a scenario file says.
    pub fn of_scenario(text: &str) -> (Self, Scenario) {
        let registry = Registry::standard();
        let scenario = Scenario::parse(Path::new("test.toml"), text, &registry).expect("a scenario");
        let store = scenario.spawn(&registry).expect("its entities");
        let commands = Commands::new(registry, EntityAllocator::new(0, SCENARIO_SPAWNER + 1));
        (Self { store, commands, time: SimTime::ZERO }, scenario)
    }
    /// What is written from now on is written then.
    pub fn at_secs(&mut self, secs: f64) {
        self.time = SimTime::from_secs_f64(secs);
    }
    /// Writes, as one batch.
    pub fn write<T>(&mut self, write: impl FnOnce(&mut Commands) -> T) -> T {
        self.commands.begin(self.time);
        let value = write(&mut self.commands);
        self.store.apply(&mut self.commands, self.time);
        value
    }
    pub fn shape(&mut self, shape: Shape, pose: Pose, material: VisualMaterial) -> Entity {
        self.write(|out| {
            let entity = out.spawn();
            out.put(entity, shape);
            out.put(entity, pose);
            out.put(entity, material);
            entity
        })
    }
    /// A light above the eye of [`front`], without shadows.
    pub fn light(&mut self) {
        self.write(|out| {
            let entity = out.spawn();
            out.put(entity, Light { shadows: false, ..Light::default() });
            out.put(entity, Pose::at(0.0, -0.3, 0.2));
        });
    }
    pub fn view(&self) -> Snapshot {
        self.store.snapshot()
    }
}

pub fn colored(r: f64, g: f64, b: f64) -> VisualMaterial {
    VisualMaterial { base_color: [r, g, b, 1.0], ..VisualMaterial::default() }
}

/// From 0.3 m in front of the origin, z up.
pub fn front() -> View {
    let lens = Lens { field_of_view: 0.8, aspect: 1.0, near: 0.01, far: 2.0, shift: [0.0; 2] };
    View::looking_at(Point3::new(0.0, -0.3, 0.0), Point3::origin(), Vector3::z(), lens)
}

pub fn renderer() -> OffscreenRenderer {
    OffscreenRenderer::new(None).expect("a graphics adapter: tests/run installs a software one")
}

pub fn picture(
    renderer: &mut OffscreenRenderer,
    scene: &Scene,
    view: &View,
    layout: &Layout,
    side: u32,
) -> Picture {
    renderer.picture(&scene.view(), view, layout, [side, side]).expect("a picture")
}

/// Mean colour of a block of pixels.
pub fn mean(picture: &Picture, left: u32, top: u32, width: u32, height: u32) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for y in top..top + height {
        for x in left..left + width {
            let pixel = picture.at(x, y).expect("inside");
            (0..3).for_each(|channel| sum[channel] += f64::from(pixel[channel]));
        }
    }
    sum.map(|channel| channel / f64::from(width * height))
}

/// Column at which the pixels that `is` picks have their middle.
pub fn middle_column(picture: &Picture, is: impl Fn([u8; 4]) -> bool) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for y in 0..picture.height {
        for x in 0..picture.width {
            if picture.at(x, y).is_some_and(&is) {
                sum += f64::from(x) + 0.5;
                count += 1.0;
            }
        }
    }
    (count > 0.0).then(|| sum / count)
}
