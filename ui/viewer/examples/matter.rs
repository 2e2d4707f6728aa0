//! Smoke over a burned spot, and blood in a fold beside it: `matter [FOLDER] [WIDTH]` leaves pictures of each quality, and
//! says how long each took.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use trocar_scene::random::SplitMix64;
use trocar_scene::{
    Burn, Commands, EntityAllocator, Instrument, JawState, Light, ParticleKind, Particles, Pose,
    RegistryBuilder, SCENARIO_SPAWNER, SimTime, Snapshot, Store, SurfaceMesh, Texture, TextureCoordinates,
    VertexPositions, VisualMaterial,
};
use trocar_viewer::{Layout, Lens, OffscreenRenderer, Quality, View};

/// Squares along a side of the tissue.
const CELLS: u32 = 60;
/// Where the hook burns \[m\].
const BURNED: [f64; 2] = [0.018, 0.008];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().unwrap_or_else(|| "matter".to_owned()));
    let width: u32 = arguments.next().map_or(Ok(960), |width| width.parse())?;
    std::fs::create_dir_all(&folder)?;
    let lens = Lens { field_of_view: 0.62, ..Lens::default() };
    let view =
        View::looking_at(Point3::new(0.015, -0.15, 0.12), Point3::new(0.0, 0.0, 0.008), Vector3::z(), lens);
    let size = [width, width * 3 / 4];
    for (name, quality) in [("plain", Quality::PLAIN), ("full", Quality::FULL), ("fine", Quality::FINE)] {
        for (matter, [smoke, blood]) in [
            ("bare", [false, false]),
            ("smoke", [true, false]),
            ("blood", [false, true]),
            ("both", [true; 2]),
        ] {
            let scene = scene(smoke, blood)?;
            let mut renderer = OffscreenRenderer::new(None)?;
            renderer.quality = quality;
            // What is made once is made before the time is taken.
            renderer.picture(&scene, &view, &Layout::Mono, size)?;
            let started = std::time::Instant::now();
            let picture = renderer.picture(&scene, &view, &Layout::Mono, size)?;
            println!("{name}, {matter}: {:.0} ms", started.elapsed().as_secs_f64() * 1e3);
            picture.save(&folder.join(format!("{name}-{matter}.png")))?;
        }
    }
    Ok(())
}

fn scene(smoke: bool, blood: bool) -> Result<Snapshot, Box<dyn std::error::Error>> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::register(&mut builder)?;
    let registry = builder.build();
    let mut store = Store::new(Arc::clone(&registry));
    let mut out = Commands::new(registry, EntityAllocator::new(0, SCENARIO_SPAWNER));
    out.begin(SimTime::ZERO);
    put_tissue(&mut out);

    let hook = out.spawn();
    let [x, y] = BURNED;
    let lean = UnitQuaternion::from_euler_angles(2.55, 0.45, 0.0);
    out.put(hook, Instrument::default());
    out.put(hook, JawState { angle: 0.25, ..JawState::default() });
    out.put(hook, Pose::new(Vector3::new(x, y, height(x, y) + 0.001), lean));
    out.put(hook, VisualMaterial { metalness: 1.0, roughness: 0.3, ..VisualMaterial::default() });

    let light = out.spawn();
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    out.put(light, Light { cone_angle: 1.0, ..Light::default() });
    out.put(light, Pose::new(Vector3::new(-0.07, 0.13, 0.24), down));
    let scope = out.spawn();
    out.put(scope, Light { intensity: 0.3, shadows: false, ..Light::default() });
    out.put(scope, Pose::at(0.015, -0.15, 0.13));

    for (wanted, particles, pose) in
        [(smoke, plume(), Pose::at(x, y, height(x, y))), (blood, pool(), Pose::default())]
    {
        if wanted {
            let entity = out.spawn();
            out.put(entity, particles);
            out.put(entity, pose);
        }
    }
    store.apply(&mut out, SimTime::ZERO);
    Ok(store.snapshot())
}

/// Smoke that has risen and spread for two seconds.
fn plume() -> Particles {
    let mut random = SplitMix64::new(7);
    let mut unit = move || f64::from(random.unit_f32());
    let (mut positions, mut ages) = (Vec::new(), Vec::new());
    for _ in 0..260 {
        let age = 2.0 * unit();
        let turn = 5.0 * age + 1.5 * unit();
        let wide = 0.0012 + 0.0042 * age;
        let drift = Vector3::new(-0.006 * age * age, 0.003 * age, 0.004 + 0.026 * age);
        let swirl = Vector3::new(turn.cos(), turn.sin(), 0.5 * (unit() - 0.5)) * wide * (0.3 + unit());
        positions.push(Point3::from(drift + swirl));
        ages.push(age);
    }
    Particles {
        kind: ParticleKind::Smoke,
        positions: Arc::new(positions),
        radius: 0.0035,
        color: [0.86, 0.88, 0.92],
        extinction: 55.0,
        ages: Arc::new(ages),
        spread: 2.2,
        ..Particles::default()
    }
}

/// Blood that has gathered where the tissue is lowest, and a trickle that leads there.
fn pool() -> Particles {
    let mut random = SplitMix64::new(11);
    let mut unit = move || f64::from(random.unit_f32());
    let (level, radius) = (-0.0031, 0.0011);
    let mut positions = Vec::new();
    for row in 0..120 {
        for column in 0..120 {
            let [u, v] = [column, row].map(|index| (f64::from(index) - 60.0) * 0.0008);
            let (x, y) = (u + 0.0004 * unit(), v + 0.0004 * unit());
            let deep = level - height(x, y);
            if deep > 0.0 && Vector2::new(x + 0.03, y + 0.005).norm() < 0.035 {
                let layers = (deep / 0.0007).ceil().min(5.0);
                for layer in 0..layers as u32 {
                    let wave = 0.0003 * ((170.0 * x + 60.0 * y).sin() + (140.0 * y - 90.0 * x).cos());
                    let z = level + wave - 0.0007 * f64::from(layer) - 0.0006 + 0.00025 * unit();
                    positions.push(Point3::new(x, y, z.max(height(x, y) - 0.0005)));
                }
            }
        }
    }
    for step in 0..160 {
        let along = f64::from(step) / 160.0;
        let x = BURNED[0] - 0.004 - 0.038 * along + 0.0006 * unit();
        let y = BURNED[1] - 0.006 - 0.008 * along + 0.0015 * (9.0 * along).sin() + 0.0006 * unit();
        positions.push(Point3::new(x, y, height(x, y) - 0.0002));
    }
    Particles {
        kind: ParticleKind::Fluid,
        positions: Arc::new(positions),
        radius,
        color: [0.13, 0.003, 0.004],
        extinction: 900.0,
        ..Particles::default()
    }
}

fn height(x: f64, y: f64) -> f64 {
    0.006 * (40.0 * x).sin() * (35.0 * y).cos() + 0.001 * (130.0 * x + 60.0 * y).sin()
}

fn put_tissue(out: &mut Commands) {
    let (mut positions, mut uv, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    let mut omega = Vec::new();
    for row in 0..=CELLS {
        for column in 0..=CELLS {
            let [u, v] = [column, row].map(|index| f64::from(index) / f64::from(CELLS));
            let (x, y) = ((u - 0.5) * 0.16, (v - 0.5) * 0.16);
            positions.push(Point3::new(x, y, height(x, y)));
            uv.push(Vector2::new(u, v));
            omega.push(6.0 * (-((x - BURNED[0]).powi(2) + (y - BURNED[1]).powi(2)) / 1.2e-5).exp());
            if row < CELLS && column < CELLS {
                let a = row * (CELLS + 1) + column;
                let (b, c, d) = (a + 1, a + CELLS + 2, a + CELLS + 1);
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    let tissue = out.spawn();
    out.put(tissue, Pose::default());
    out.put(tissue, VertexPositions { positions: Arc::new(positions) });
    out.put(tissue, SurfaceMesh { triangles: Arc::new(triangles) });
    out.put(tissue, TextureCoordinates { uv: Arc::new(uv) });
    out.put(tissue, Burn { omega: Arc::new(omega) });
    let liver = || Some(Texture::Procedural("liver".into()));
    out.put(
        tissue,
        VisualMaterial {
            color_map: liver(),
            normal_map: liver(),
            free_map: liver(),
            wetness: 0.8,
            ..VisualMaterial::default()
        },
    );
}
