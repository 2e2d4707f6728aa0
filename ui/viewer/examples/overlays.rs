//! Everything that can be shown over a scene, and four views of it: `overlays [FOLDER]` leaves a picture of each.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use trocar_scene::{
    Burn, Collision, CollisionList, Commands, Detection, DeviceState, EntityAllocator, Hand, Instrument,
    JawState, Light, Name, Pose, Primitive, RegistryBuilder, SCENARIO_SPAWNER, ScalarField, ScalarFields,
    Shape, Side, SimTime, Store, SurfaceMesh, Temperature, Texture, TextureCoordinates, VertexPositions,
    VisualMaterial,
};
use trocar_viewer::draw_list::DrawList;
use trocar_viewer::{Layout, Lens, OffscreenRenderer, Overlay, Overlays, View};

/// Squares along a side of the tissue.
const CELLS: u32 = 40;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "overlays".to_owned()));
    std::fs::create_dir_all(&folder)?;
    let mut builder = RegistryBuilder::new();
    trocar_scene::register(&mut builder)?;
    let registry = builder.build();
    let mut store = Store::new(Arc::clone(&registry));
    let mut out = Commands::new(registry, EntityAllocator::new(0, SCENARIO_SPAWNER));
    let mut renderer = OffscreenRenderer::new(None)?;
    renderer.renderer_mut().overlays = Overlays::of(&[Overlay::Trails]);

    out.begin(SimTime::ZERO);
    let (tissue, tool, ball) = (out.spawn(), out.spawn(), out.spawn());
    put_tissue(&mut out, tissue);
    let steel = VisualMaterial { metalness: 1.0, roughness: 0.3, ..VisualMaterial::default() };
    out.put(tool, Instrument::default());
    out.put(tool, JawState { angle: 0.4, ..JawState::default() });
    out.put(tool, steel);
    out.put(tool, Name("grasper".into()));
    out.put(ball, Shape::Sphere { radius: 0.012 });
    out.put(ball, Pose::at(-0.035, 0.005, 0.0155));
    out.put(ball, VisualMaterial { base_color: [0.8, 0.7, 0.3, 1.0], ..VisualMaterial::default() });
    out.put(ball, Name("bead".into()));
    let hand = out.spawn();
    out.put(
        hand,
        Hand { side: Side::Right, instrument: tool, world_from_device: Pose::default(), scale: 1.0 },
    );
    out.put(hand, DeviceState { applied_force: Vector3::new(0.4, 0.2, 1.5), ..DeviceState::default() });
    let touch = |triangle: u32, x: f64, y: f64| Collision {
        a: tissue,
        primitive_a: Primitive::Triangle(triangle),
        b: tool,
        primitive_b: Primitive::Jaw(0),
        points_in_world: [Point3::new(x, y, height(x, y)); 2],
        normal_in_world: Vector3::z(),
        depth: 5e-4,
        force_in_world: Vector3::new(0.2, 0.0, 1.2),
        velocity_constraint: 0.0,
        method: Detection::default(),
        detected_at: SimTime::ZERO,
    };
    let row = 2 * CELLS;
    let collisions = vec![
        touch(row * 18 + 48, 0.024, -0.010),
        touch(row * 18 + 49, 0.026, -0.009),
        touch(row * 19 + 50, 0.028, -0.004),
        Collision {
            a: ball,
            primitive_a: Primitive::Shape(0),
            b: tissue,
            primitive_b: Primitive::Triangle(row * 21 + 12),
            ..touch(0, -0.035, 0.005)
        },
    ];
    let detector = out.spawn();
    out.put(detector, CollisionList { collisions, penetration_max: 5e-4 });
    let light = out.spawn();
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    out.put(light, Light { cone_angle: 1.0, ..Light::default() });
    out.put(light, Pose::new(Vector3::new(0.05, -0.05, 0.3), down));
    store.apply(&mut out, SimTime::ZERO);

    let lean = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 2.6);
    for step in 0..=60 {
        let turn = 0.1 * f64::from(step);
        let time = SimTime::from_secs_f64(0.03 * f64::from(step));
        out.begin(time);
        let tip =
            Vector3::new(0.026 + 0.02 * (turn.cos() - 1.0), -0.008 + 0.02 * turn.sin(), 0.008 + 0.002 * turn);
        out.put(tool, Pose::new(tip, lean));
        store.apply(&mut out, time);
        renderer.renderer_mut().watch(&store.snapshot());
    }
    let scene = store.snapshot();
    let lens = Lens { field_of_view: 0.6, ..Lens::default() };
    let view =
        View::looking_at(Point3::new(0.02, -0.16, 0.13), Point3::new(0.0, 0.0, 0.005), Vector3::z(), lens);
    for overlay in Overlay::ALL {
        let trails = renderer.renderer().overlays.shows(Overlay::Trails);
        // Trails that are hidden are forgotten.
        renderer.renderer_mut().overlays = Overlays::of(&[overlay]);
        renderer.renderer_mut().overlays.set(Overlay::Trails, trails && overlay <= Overlay::Trails);
        let picture = renderer.picture(&scene, &view, &Layout::Mono, [960, 720])?;
        picture.save(&folder.join(format!("{}.png", overlay.name())))?;
    }
    let mut draw_list = DrawList::new();
    draw_list.update(&scene);
    let shown = [Overlay::Contacts, Overlay::Forces, Overlay::Temperature, Overlay::Names];
    renderer.renderer_mut().overlays = Overlays::of(&shown);
    renderer
        .picture(&scene, &view, &Layout::quad(&draw_list, &view), [960, 720])?
        .save(&folder.join("quad.png"))?;
    Ok(())
}

fn height(x: f64, y: f64) -> f64 {
    0.006 * (40.0 * x).sin() * (35.0 * y).cos()
}

fn put_tissue(out: &mut Commands, tissue: trocar_scene::Entity) {
    let (mut positions, mut uv, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    let (mut celsius, mut omega, mut stress) = (Vec::new(), Vec::new(), Vec::new());
    for row in 0..=CELLS {
        for column in 0..=CELLS {
            let [u, v] = [column, row].map(|index| f64::from(index) / f64::from(CELLS));
            let (x, y) = ((u - 0.5) * 0.12, (v - 0.5) * 0.12);
            positions.push(Point3::new(x, y, height(x, y)));
            uv.push(Vector2::new(u, v));
            let heat = (-((x - 0.026).powi(2) + (y + 0.008).powi(2)) / 2e-4).exp();
            celsius.push(37.0 + 70.0 * heat);
            omega.push((8.0 * heat * heat).exp() - 1.0);
            stress.push(2e3 * (0.2 + (40.0 * x).sin().abs() + heat));
            if row < CELLS && column < CELLS {
                let a = row * (CELLS + 1) + column;
                let (b, c, d) = (a + 1, a + CELLS + 2, a + CELLS + 1);
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    out.put(tissue, Name("liver".into()));
    out.put(tissue, Pose::default());
    out.put(tissue, VertexPositions { positions: Arc::new(positions) });
    out.put(tissue, SurfaceMesh { triangles: Arc::new(triangles) });
    out.put(tissue, TextureCoordinates { uv: Arc::new(uv) });
    out.put(tissue, Temperature { celsius: Arc::new(celsius) });
    out.put(tissue, Burn { omega: Arc::new(omega) });
    let values = Arc::new(stress);
    let stress = ScalarField { name: "stress".into(), unit: "Pa".into(), values, range: None };
    out.put(tissue, ScalarFields { fields: vec![stress] });
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
