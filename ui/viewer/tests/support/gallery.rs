//! What references show: one small scene per thing that a viewer can do.

use std::f64::consts::PI;
use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector2, Vector3};
use trocar_scene::{
    Burn, Collision, CollisionList, Detection, Entity, Light, LineMesh, Name, Pose, Primitive, Shape,
    SimTime, Snapshot, SurfaceMesh, Temperature, Texture, TextureCoordinates, VertexPositions,
    VisualMaterial,
};
use trocar_viewer::draw_list::DrawList;
use trocar_viewer::layout::{Stereo, Tile, TileView};
use trocar_viewer::{Layout, Lens, OffscreenRenderer, Overlay, Overlays, Pane, Picture, Quality, View};

use super::{Scene, colored, grid};

/// Of most references \[pixels\].
pub const SIZE: [u32; 2] = [256, 192];
/// Squares of the tissue each way.
const CELLS: u32 = 12;
/// Side of the tissue \[m\].
pub const TISSUE: f64 = 0.14;

/// What is drawn, and how.
#[derive(Clone)]
pub struct Case {
    pub name: String,
    pub scene: Snapshot,
    pub view: View,
    pub layout: Layout,
    pub size: [u32; 2],
    pub quality: Quality,
    pub overlays: Overlays,
    pub folder: Option<PathBuf>,
}

impl Case {
    pub fn new(name: &str, scene: Snapshot, view: View) -> Self {
        let (layout, quality, overlays) = (Layout::Mono, Quality::FINE, Overlays::default());
        Self { name: name.to_owned(), scene, view, layout, size: SIZE, quality, overlays, folder: None }
    }

    /// The picture, and what drew it. An eye sees one scene in its life: those of others have revisions of the same
    /// numbers.
    pub fn draw(&self) -> (Picture, String) {
        let mut renderer = OffscreenRenderer::new(self.folder.clone())
            .expect("a graphics adapter: tests/run installs a software one");
        renderer.quality = self.quality;
        renderer.renderer_mut().overlays = self.overlays.clone();
        let picture = renderer.picture(&self.scene, &self.view, &self.layout, self.size).expect("a picture");
        (picture, renderer.gpu().describe())
    }
}

/// From above, at a slant.
pub fn slanted(distance: f64, field_of_view: f64) -> View {
    let lens = Lens { field_of_view, aspect: 4.0 / 3.0, near: 0.01, far: 2.0, shift: [0.0; 2] };
    let renderer = Point3::new(0.0, -0.64, 0.768) * distance;
    View::looking_at(renderer, Point3::origin(), Vector3::z(), lens)
}

/// A cone of light from the upper left, that throws shadows or does not.
pub fn lamp(scene: &mut Scene, shadows: bool) {
    scene.write(|out| {
        let light = out.spawn();
        let at = Point3::new(-0.14, -0.08, 0.22);
        let towards = View::looking_at(at, Point3::origin(), Vector3::y(), Lens::default()).world_from_eye;
        out.put(light, Light { cone_angle: 0.6, intensity: 1.5, shadows, ..Light::default() });
        out.put(light, Pose::from(towards));
    });
}

/// A mound with texture coordinates, `shift` off in texture space.
pub fn tissue(scene: &mut Scene, material: VisualMaterial, shift: [f64; 2]) -> Entity {
    let (corners, triangles) = grid(CELLS);
    let mound = |[u, v]: &[f64; 2]| {
        let [x, y] = [u, v].map(|share| (share - 0.5) * TISSUE);
        Point3::new(x, y, 0.03 * (-(x * x + y * y) / 0.0018).exp() - 0.012)
    };
    let positions = corners.iter().map(mound).collect();
    let uvs = corners.iter().map(|[u, v]| Vector2::new(u + shift[0], v + shift[1])).collect();
    scene.write(|out| {
        let entity = out.spawn();
        out.put(entity, VertexPositions { positions: Arc::new(positions) });
        out.put(entity, SurfaceMesh { triangles: Arc::new(triangles) });
        out.put(entity, TextureCoordinates { uv: Arc::new(uvs) });
        out.put(entity, Pose::default());
        out.put(entity, material);
        entity
    })
}

/// A number per vertex of [`tissue`], from its place in the unit square.
fn per_vertex(value: impl Fn(f64, f64) -> f64) -> Arc<Vec<f64>> {
    let side = CELLS + 1;
    let share = |index: u32| f64::from(index) / f64::from(CELLS);
    Arc::new((0..side * side).map(|vertex| value(share(vertex % side), share(vertex / side))).collect())
}

/// Burned around a place, black in the middle.
pub fn burn(scene: &mut Scene, tissue: Entity) {
    let omega = per_vertex(|u, v| 3e5 * (-((u - 0.72).powi(2) + (v - 0.35).powi(2)) / 0.0022).exp());
    scene.write(|out| out.put(tissue, Burn { omega }));
}

fn procedural(name: &str) -> Option<Texture> {
    Some(Texture::Procedural(name.into()))
}

/// Tissue without a map.
pub fn bare() -> VisualMaterial {
    VisualMaterial { roughness: 0.45, tiling: [2.0, 2.0], ..colored(0.62, 0.28, 0.22) }
}

/// A case that shows tissue of a material.
pub fn of_material(name: &str, material: VisualMaterial) -> Case {
    of_tissue(name, material, [0.0; 2], false)
}

/// … its texture moved, or burned.
pub fn of_tissue(name: &str, material: VisualMaterial, shift: [f64; 2], burned: bool) -> Case {
    let mut scene = Scene::new();
    lamp(&mut scene, false);
    let entity = tissue(&mut scene, material, shift);
    if burned {
        burn(&mut scene, entity);
    }
    Case { size: [192, 144], ..Case::new(name, scene.view(), slanted(0.22, 0.56)) }
}

/// Each map of a material alone, and all of them. `folder` is one where the edit map may be written.
pub fn materials(folder: PathBuf) -> Vec<Case> {
    write_edits(&folder);
    let edits = || Some(Texture::File("edits.png".into()));
    let with = |name: &str, change: fn(&mut VisualMaterial)| {
        let mut material = bare();
        change(&mut material);
        of_material(&format!("map-{name}"), material)
    };
    let mut cases = vec![
        of_material("map-none", bare()),
        with("colour", |material| material.color_map = procedural("bowel")),
        with("normal", |material| material.normal_map = procedural("stomach")),
        with("free", |material| material.free_map = procedural("stomach")),
        with("wet", |material| {
            material.normal_map = procedural("liver");
            material.wetness = 1.0;
        }),
        with("relief", |material| {
            material.color_map = procedural("gauze");
            material.normal_map = procedural("gauze");
            material.tiling = [1.0; 2];
            material.relief = 0.004;
        }),
        of_tissue("map-edit", VisualMaterial { edit_map: edits(), wetness: 0.6, ..bare() }, [0.0; 2], true),
    ];
    let all = VisualMaterial { edit_map: edits(), ..together() };
    cases.push(of_tissue("map-together", all, [0.0; 2], true));
    let qualities = [("plain", Quality::PLAIN), ("full", Quality::FULL), ("fine", Quality::FINE)];
    cases.extend(qualities.map(|(name, quality)| {
        let mut scene = Scene::new();
        lamp(&mut scene, true);
        tissue(&mut scene, together(), [0.0; 2]);
        let ring = Shape::Torus { ring_radius: 0.012, tube_radius: 0.003 };
        scene.shape(ring, Pose::at(0.035, -0.03, 0.012), colored(0.9, 0.8, 0.1));
        let case = Case::new(&format!("quality-{name}"), scene.view(), slanted(0.22, 0.56));
        Case { quality, size: [192, 144], ..case }
    }));
    for case in &mut cases {
        case.folder = Some(folder.clone());
    }
    cases
}

/// Wet tissue with every map that is computed.
pub fn together() -> VisualMaterial {
    VisualMaterial {
        base_color: [1.0; 4],
        wetness: 0.7,
        relief: 0.0005,
        color_map: procedural("liver"),
        normal_map: procedural("liver"),
        free_map: procedural("liver"),
        ..bare()
    }
}

/// A picture with a pool of blood and a cut in it: G blood, B cut, A what is left of the gloss.
fn write_edits(folder: &std::path::Path) {
    let picture = image::RgbaImage::from_fn(128, 128, |x, y| {
        let [u, v] = [x, y].map(|texel| (f64::from(texel) + 0.5) / 128.0);
        let blood = 1.0 - ((u - 0.3).hypot(v - 0.62) / 0.16).powi(6);
        let cut = 1.0 - (8.0 * (v - 0.3 - 0.1 * (9.0 * u).sin()).abs() / 0.1).powi(2);
        let share = |part: f64| (255.0 * part.clamp(0.0, 1.0)) as u8;
        image::Rgba([0, share(blood), if (0.15..0.6).contains(&u) { share(cut) } else { 0 }, 255])
    });
    picture.save(folder.join("edits.png")).expect("a picture file");
}

/// Things at several depths on a board.
pub fn studio(shadows: bool) -> Scene {
    let mut scene = Scene::new();
    lamp(&mut scene, shadows);
    let board =
        VisualMaterial { color_map: procedural("checker"), tiling: [1.5, 1.5], ..colored(0.8, 0.8, 0.8) };
    scene.shape(Shape::Box { half_extents: [0.09, 0.09, 0.004] }, Pose::at(0.0, 0.0, -0.024), board);
    let ball = VisualMaterial { roughness: 0.25, ..colored(0.75, 0.08, 0.06) };
    scene.shape(Shape::Sphere { radius: 0.018 }, Pose::at(-0.035, -0.02, -0.002), ball);
    let ring = Shape::Torus { ring_radius: 0.02, tube_radius: 0.006 };
    let upright = UnitQuaternion::from_euler_angles(0.9, 0.3, 0.0);
    scene.shape(ring, Pose::new(Vector3::new(0.03, 0.0, 0.002), upright), colored(0.08, 0.35, 0.7));
    let steel = VisualMaterial { metalness: 1.0, roughness: 0.3, ..colored(0.75, 0.75, 0.78) };
    let block = Shape::Box { half_extents: [0.011, 0.011, 0.022] };
    // No edge along a row of pixels: all of it would fall on one side or the other of the samples.
    let aside = UnitQuaternion::from_euler_angles(0.0, 0.0, 0.4);
    scene.shape(block, Pose::new(Vector3::new(-0.01, 0.032, 0.002), aside), steel);
    scene
}

fn of_studio(name: &str) -> Case {
    Case::new(name, studio(true).view(), slanted(0.25, 0.5))
}

/// How views share a picture.
pub fn layouts() -> Vec<Case> {
    let stereo = Stereo { interocular: 0.02, convergence: 0.25 };
    let mut cases: Vec<Case> = [
        ("stereo-side-by-side", Layout::SideBySide(stereo)),
        ("stereo-top-bottom", Layout::TopBottom(stereo)),
        ("stereo-rows", Layout::RowInterleaved(stereo)),
        ("stereo-anaglyph", Layout::Anaglyph(stereo)),
    ]
    .map(|(name, layout)| Case { layout, ..of_studio(name) })
    .into();
    let mut draw_list = DrawList::new();
    let quad = of_studio("quad");
    draw_list.update(&quad.scene);
    cases.push(Case { layout: Layout::quad(&draw_list, &quad.view), ..quad });
    let pane = |x, y, width, height| Pane { x, y, width, height };
    let mut turned = Tile::new(pane(0.65, 0.0, 0.35, 0.5), TileView::Given);
    turned.view_from_eye = Isometry3::rotation(Vector3::new(0.0, 0.0, 0.5));
    let mut woven = Tile::new(pane(0.65, 0.5, 0.35, 0.5), TileView::Given);
    woven.layout = Layout::Anaglyph(stereo);
    let whole = Tile::new(pane(0.0, 0.0, 0.65, 1.0), TileView::Given);
    cases.push(Case { layout: Layout::Tiles(vec![whole, turned, woven]), ..of_studio("tiles") });
    let lens = of_studio("lens");
    let view = View { distortion: 0.3, vignette: 0.8, ..lens.view };
    cases.push(Case { view, ..lens });
    cases.push(head_tracked());
    cases
}

/// A head to the left of a screen that stands in the studio, seen with both eyes.
fn head_tracked() -> Case {
    let screen = slanted(0.25, 0.5).world_from_eye * Isometry3::translation(0.0, 0.0, 0.25);
    let head = Isometry3::translation(-0.09, -0.03, -0.22);
    let view = View::of_head(&screen, [0.1, 0.075], &head, 0.012, [0.01, 2.0]);
    Case { view, layout: Layout::Anaglyph(Stereo::default()), ..of_studio("head-tracked") }
}

/// The studio, its lamp throwing shadows or not.
pub fn shadow(shadows: bool) -> Case {
    Case::new("shadow", studio(shadows).view(), slanted(0.25, 0.5))
}

/// What lies before what, and threads.
pub fn bodies() -> Vec<Case> {
    let mut scene = Scene::new();
    lamp(&mut scene, true);
    let ball = |radius| Shape::Sphere { radius };
    scene.shape(ball(0.03), Pose::at(-0.02, 0.03, 0.0), colored(0.1, 0.2, 0.7));
    scene.shape(ball(0.022), Pose::at(0.01, 0.0, 0.004), colored(0.7, 0.1, 0.1));
    let through = Shape::Box { half_extents: [0.06, 0.004, 0.008] };
    scene.shape(through, Pose::at(0.0, 0.01, 0.0), colored(0.8, 0.75, 0.2));
    let mut glass = colored(0.2, 0.8, 0.4);
    glass.base_color[3] = 0.4;
    scene.shape(ball(0.02), Pose::at(0.035, -0.03, 0.0), glass);
    let depth = Case::new("depth-order", scene.view(), slanted(0.22, 0.5));
    let mut scene = Scene::new();
    lamp(&mut scene, true);
    tissue(&mut scene, together(), [0.0; 2]);
    let suture =
        VisualMaterial { color_map: procedural("suture"), normal_map: procedural("suture"), ..bare() };
    let violet = VisualMaterial { base_color: [0.35, 0.2, 0.6, 1.0], tiling: [1.0; 2], ..suture };
    scene.write(|out| {
        let thread = out.spawn();
        // A loop that lies on the mound, with a gentle rise where it crosses itself.
        let point = |step: i32| {
            let along = f64::from(step) / 30.0;
            let (x, y) =
                (0.07 * (along - 0.5) + 0.02 * (2.0 * PI * along).sin(), 0.025 * (2.0 * PI * along).cos());
            let ground = 0.03 * (-(x * x + y * y) / 0.0018_f64).exp() - 0.012;
            Point3::new(x, y, ground + 0.003 + 0.006 * along)
        };
        out.put(
            thread,
            LineMesh {
                segments: Arc::new((0..30).map(|index| [index, index + 1]).collect()),
                radius: 0.0018,
            },
        );
        out.put(thread, VertexPositions { positions: Arc::new((0..=30).map(point).collect()) });
        out.put(thread, Pose::default());
        out.put(thread, violet);
    });
    let thread = Case::new("thread", scene.view(), slanted(0.2, 0.5));
    vec![depth, thread, shadow(true)]
}

/// Tissue some of whose triangles touch something.
pub fn touching(triangles: &[u32]) -> Case {
    let mut scene = Scene::new();
    lamp(&mut scene, false);
    let (tissue, tool) = (tissue(&mut scene, bare(), [0.0; 2]), scene.write(|out| out.spawn()));
    let snapshot = scene.view();
    let mesh = snapshot.get::<SurfaceMesh>(tissue).expect("a mesh");
    let vertices = &snapshot.get::<VertexPositions>(tissue).expect("its vertices").positions;
    let collisions = triangles.iter().map(|triangle| {
        let [a, b, c] = mesh.triangles[*triangle as usize].map(|vertex| vertices[vertex as usize]);
        let normal = (b - a).cross(&(c - a)).normalize();
        Collision {
            a: tissue,
            primitive_a: Primitive::Triangle(*triangle),
            b: tool,
            primitive_b: Primitive::Shaft,
            points_in_world: [a + ((b - a) + (c - a)) / 3.0; 2],
            normal_in_world: normal,
            depth: 1e-4,
            force_in_world: 1.6 * normal + Vector3::new(0.8, 0.0, 0.0),
            velocity_constraint: 0.0,
            method: Detection::default(),
            detected_at: SimTime::ZERO,
        }
    });
    let collisions = collisions.collect();
    scene.write(|out| out.put(tool, CollisionList { collisions, penetration_max: 0.0 }));
    let overlays = Overlays::of(&[Overlay::Contacts]);
    Case { overlays, ..Case::new("contacts", scene.view(), slanted(0.22, 0.56)) }
}

/// Triangles of [`touching`]'s reference: a patch and two that stand alone.
pub const TOUCHING: [u32; 9] = [82, 83, 84, 85, 106, 107, 109, 66, 148];

/// What is shown over a scene.
pub fn overlays() -> Vec<Case> {
    let forces = Overlays::of(&[Overlay::Contacts, Overlay::Forces, Overlay::Normals, Overlay::Wireframe]);
    let forces = Case { name: "forces".into(), overlays: forces, ..touching(&TOUCHING) };
    let mut scene = Scene::new();
    lamp(&mut scene, false);
    let entity = tissue(&mut scene, bare(), [0.0; 2]);
    let celsius = per_vertex(|u, v| 37.0 + 63.0 * (-((u - 0.6).powi(2) + (v - 0.4).powi(2)) / 0.03).exp());
    scene.write(|out| out.put(entity, Temperature { celsius }));
    let overlays = Overlays::of(&[Overlay::Temperature]);
    let warm =
        Case { overlays, size: [320, 240], ..Case::new("temperature", scene.view(), slanted(0.22, 0.56)) };
    let mut named = studio(false);
    let things = [("board", 1), ("ball", 2), ("ring", 3), ("block", 4)];
    let entities: Vec<Entity> = named.view().entities().collect();
    named.write(|out| {
        for (name, index) in things {
            out.put(entities[index], Name(name.into()));
        }
    });
    let overlays =
        Overlays { axis_length: 0.03, ..Overlays::of(&[Overlay::Boxes, Overlay::Axes, Overlay::Names]) };
    let named = Case { overlays, ..Case::new("boxes-axes-names", named.view(), slanted(0.25, 0.5)) };
    vec![touching(&TOUCHING), forces, warm, named]
}
