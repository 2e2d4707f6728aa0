//! What persons show one another: strokes that stick to a liver while it is deformed, pointers, labels, a frozen picture.

use std::path::Path;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_scene::annotation::{PlaceReader, nearest_place};
use trocar_scene::{
    Commands, Entity, EntityAllocator, Hand, MentorLabel, MentorPointer, MentorStroke, Name, PictureFreeze,
    Pose, RegistryBuilder, SIGNATURE_NAME_MAX, Scenario, Shape, Side, Signature, SimTime, Snapshot, Store,
    SurfacePlace, TakeOverRequest, TakeOverStep, VertexPositions,
};
use trocar_viewer::{Layout, OffscreenRenderer, Overlays, Picture, StillPicture, View};

use crate::support::{Scene, colored, front, renderer};

/// Of the pictures of the liver.
const SIZE: [u32; 2] = [480, 360];
/// Blue: nothing in the scenes has that colour.
const INK: [u8; 3] = [20, 60, 255];

fn by(station: u16, name: &str) -> Signature {
    Signature { station, name: name.to_owned(), at: SimTime::ZERO }
}

fn stroke(places: Vec<SurfacePlace>, width: f32) -> MentorStroke {
    MentorStroke {
        by: by(3, "Ana"),
        stroke: 1,
        section: 0,
        colour: INK,
        width,
        places: Arc::new(places),
        gaps: Vec::new(),
    }
}

fn is_ink([r, g, b, _]: [u8; 4]) -> bool {
    b > 90 && r < b / 2 && g < b / 2 + 10
}

fn count(picture: &Picture, is: impl Fn([u8; 4]) -> bool) -> usize {
    picture.color.iter().filter(|pixel| is(**pixel)).count()
}

fn drawn(renderer: &mut OffscreenRenderer, scene: &Snapshot, view: &View) -> Picture {
    renderer.picture(scene, view, &Layout::Mono, SIZE).expect("a picture")
}

/// The pixel of a point.
fn pixel(view: &View, point: &Point3<f64>) -> [u32; 2] {
    let [x, y] = view.onto_lens(view.project(point).expect("in front").0);
    [(x * f64::from(SIZE[0])) as u32, (y * f64::from(SIZE[1])) as u32]
}

/// The scenario with the liver, and what writes into it.
struct Liver {
    store: Store,
    out: Commands,
    liver: Entity,
    view: View,
}

impl Liver {
    fn new() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/fem-liver.toml");
        let mut builder = RegistryBuilder::new();
        trocar_scene::components::register(&mut builder).expect("names are free");
        trocar_simulator::controller::register(&mut builder).expect("names are free");
        let registry = builder.build();
        let scenario = Scenario::load(&file, &registry).unwrap_or_else(|error| panic!("{error}"));
        let store = scenario.spawn(&registry).unwrap_or_else(|error| panic!("{error}"));
        let scene = store.snapshot();
        let view = View::default_of(&scene, Some(f64::from(SIZE[0]) / f64::from(SIZE[1])));
        let liver = scene.find("liver").expect("it is in the scenario");
        Self { store, out: Commands::new(registry, EntityAllocator::new(0, 9)), liver, view }
    }

    fn write<T>(&mut self, write: impl FnOnce(&mut Commands) -> T) -> T {
        let value = write(&mut self.out);
        self.store.apply(&mut self.out, SimTime::ZERO);
        self.out.clear();
        value
    }

    /// Places under the mouse along an arc in the picture.
    fn arc(&self) -> Vec<SurfacePlace> {
        let scene = self.store.snapshot();
        let mouse = |step: u32| {
            let angle = 0.12 * f64::from(step);
            [0.56 + 0.12 * angle.cos(), 0.5 + 0.13 * angle.sin()]
        };
        let place = |step| {
            let (origin, direction) = self.view.ray(self.view.through_lens(mouse(step)));
            nearest_place(&scene, &origin, &direction).map(|hit| hit.place)
        };
        let places: Vec<SurfacePlace> = (0..36).filter_map(place).collect();
        assert!(places.len() == 36 && places.iter().all(|place| place.entity == self.liver), "{places:?}");
        places
    }

    /// Presses a hollow into the middle of what is drawn, and pulls it aside.
    fn deform(&mut self, places: &[SurfacePlace]) {
        let scene = self.store.snapshot();
        let mut reader = PlaceReader::new(&scene);
        let middle: Vector3<f64> =
            places.iter().map(|place| reader.find(place).expect("there").point.coords).sum::<Vector3<f64>>()
                / places.len() as f64;
        let middle = scene.world_pose(self.liver).inverse_transform_point(&Point3::from(middle));
        let before = scene.get::<VertexPositions>(self.liver).expect("vertices").positions.clone();
        let moved = |point: &Point3<f64>| {
            let near = (-(point - middle).norm_squared() / (2.0 * 0.03_f64.powi(2))).exp();
            point + Vector3::new(0.018, 0.004, -0.008) * near
        };
        let positions = Arc::new(before.iter().map(moved).collect());
        let liver = self.liver;
        self.write(|out| out.put(liver, VertexPositions { positions }));
    }
}

#[test]
fn a_stroke_sticks_to_the_liver_while_it_is_deformed() {
    let (mut liver, mut renderer) = (Liver::new(), renderer());
    let plain = drawn(&mut renderer, &liver.store.snapshot(), &liver.view);
    assert_eq!(renderer.renderer().overlay_bytes_sent(), 0, "who draws nothing pays nothing");
    assert_eq!(count(&plain, is_ink), 0);
    let places = liver.arc();
    liver.write(|out| {
        let entity = out.spawn();
        out.put(entity, stroke(places.clone(), 0.004));
    });
    let inked = |picture: &Picture, at: [u32; 2]| picture.at(at[0], at[1]).is_some_and(is_ink);
    let pixels = |liver: &Liver| -> Vec<[u32; 2]> {
        let scene = liver.store.snapshot();
        let mut reader = PlaceReader::new(&scene);
        places.iter().map(|place| pixel(&liver.view, &reader.find(place).expect("there").point)).collect()
    };
    let first = pixels(&liver);
    let before = drawn(&mut renderer, &liver.store.snapshot(), &liver.view);
    assert!(first.iter().all(|at| inked(&before, *at)), "every place is on its ribbon");
    let covered = count(&before, is_ink);
    liver.deform(&places);
    let second = pixels(&liver);
    let after = drawn(&mut renderer, &liver.store.snapshot(), &liver.view);
    let still = second.iter().filter(|at| inked(&after, **at)).count();
    assert!(still >= places.len() - 2, "{still} of {} are on the ribbon", places.len());
    // What it covered before, where nothing of it is now, is tissue again.
    let distance =
        |a: &[u32; 2], b: &[u32; 2]| f64::from(a[0].abs_diff(b[0])).hypot(f64::from(a[1].abs_diff(b[1])));
    let left: Vec<&[u32; 2]> =
        first.iter().filter(|at| second.iter().all(|now| distance(at, now) > 12.0)).collect();
    assert!(left.len() > 5, "the ribbon has moved far enough to see: {}", left.len());
    assert!(left.iter().all(|at| !inked(&after, **at)), "it has left where it was");
    let moved = count(&after, is_ink) as f64 / covered as f64;
    assert!((0.6..1.6).contains(&moved), "{moved}");
    // Whoever does not want to see it does not.
    renderer.renderer_mut().overlays = Overlays { annotations: false, ..Overlays::default() };
    assert_eq!(count(&drawn(&mut renderer, &liver.store.snapshot(), &liver.view), is_ink), 0);
}

#[test]
fn a_ribbon_is_as_wide_as_it_says_and_broken_where_it_was_cut() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    scene.light();
    let wall = scene.shape(
        Shape::Box { half_extents: [0.2, 0.01, 0.2] },
        Pose::at(0.0, 0.01, 0.0),
        colored(0.5, 0.4, 0.35),
    );
    let snapshot = scene.view();
    let place = |x: f64| {
        let eye = Point3::new(x, -0.3, 0.0);
        nearest_place(&snapshot, &eye, &Vector3::y()).expect("a hit").place
    };
    let places: Vec<SurfacePlace> = [-0.08, -0.04, 0.04, 0.08].map(place).to_vec();
    assert!(places.iter().all(|place| place.entity == wall));
    scene.write(|out| {
        let entity = out.spawn();
        out.put(entity, MentorStroke { gaps: vec![2], ..stroke(places, 0.02) });
    });
    let side = 256;
    let picture = renderer.picture(&scene.view(), &view, &Layout::Mono, [side, side]).expect("a picture");
    let metres = 0.3 * 2.0 * 0.4_f64.tan() / f64::from(side);
    let column = |x: f64| ((0.5 * f64::from(side)) + x / metres) as u32;
    let height = |x: f64| (0..side).filter(|row| picture.at(column(x), *row).is_some_and(is_ink)).count();
    let expected = 0.02 / metres;
    for x in [-0.06, 0.06] {
        assert!((height(x) as f64 - expected).abs() < 3.0, "{} {expected}", height(x));
    }
    assert_eq!((height(0.0), height(-0.095), height(0.095)), (0, 0, 0));
    assert!(height(0.088) > 5, "its ends are round");
}

#[test]
fn pointers_and_labels_stand_at_their_places_with_the_names_of_persons() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    scene.light();
    scene.shape(
        Shape::Box { half_extents: [0.2, 0.01, 0.2] },
        Pose::at(0.0, 0.01, 0.0),
        colored(0.3, 0.25, 0.2),
    );
    let snapshot = scene.view();
    let place = |x: f64, z: f64| {
        nearest_place(&snapshot, &Point3::new(x, -0.3, z), &Vector3::y()).expect("a hit").place
    };
    let side = 256;
    let mut shot = |scene: &Scene| {
        renderer.picture(&scene.view(), &view, &Layout::Mono, [side, side]).expect("a picture")
    };
    let plain = shot(&scene);
    let at = |x: f64, z: f64| {
        let [x, y] = view.project(&Point3::new(x, 0.0, z)).expect("in front").0;
        [x, y].map(|share| (share * f64::from(side)) as u32)
    };
    let changed = |picture: &Picture| -> Vec<[u32; 2]> {
        let all = (0..side).flat_map(|y| (0..side).map(move |x| [x, y]));
        all.filter(|[x, y]| picture.at(*x, *y) != plain.at(*x, *y)).collect()
    };
    let within = |pixels: &[[u32; 2]], centre: [u32; 2], reach: [u32; 2]| {
        pixels
            .iter()
            .filter(|pixel| (0..2).all(|axis| pixel[axis].abs_diff(centre[axis]) <= reach[axis]))
            .count()
    };
    let pointer = scene.write(|out| {
        let entity = out.spawn();
        out.put(entity, MentorPointer { by: by(1, "Bo"), place: place(-0.05, 0.03) });
        entity
    });
    let pixels = changed(&shot(&scene));
    let centre = at(-0.05, 0.03);
    assert!(within(&pixels, centre, [5, 5]) > 20, "the cross");
    let above = [centre[0], centre[1] - 14];
    assert!(within(&pixels, above, [12, 8]) > 60, "the name above it");
    assert_eq!(pixels.len(), within(&pixels, [centre[0], centre[1] - 8], [16, 16]), "and nothing elsewhere");
    scene.write(|out| {
        out.despawn(pointer);
        let label = out.spawn();
        let text = "cut here".to_owned();
        out.put(label, MentorLabel { by: by(2, "Ana"), label: 1, place: place(0.04, -0.04), text });
    });
    let pixels = changed(&shot(&scene));
    let centre = at(0.04, -0.04);
    assert!(within(&pixels, centre, [3, 3]) > 5, "its end at the place");
    let rows = pixels.iter().map(|pixel| pixel[1]);
    let columns = pixels.iter().map(|pixel| pixel[0]);
    let wide = columns.clone().max().expect("some") - columns.min().expect("some");
    assert!(wide > 50, "a text as long as 'Ana: cut here' is {wide} pixels wide");
    assert!(rows.max().expect("some") <= centre[1] + 4, "it stands above its place");
}

#[test]
fn a_frozen_picture_has_a_frame_and_stands_still_while_strokes_are_drawn_on_it() {
    let (mut liver, mut renderer, mut still) = (Liver::new(), renderer(), StillPicture::new());
    let mut shot = |liver: &Liver| {
        let shown = still.show(&liver.store.snapshot());
        drawn(&mut renderer, &shown, &liver.view)
    };
    let plain = shot(&liver);
    let freeze = liver.write(|out| {
        let entity = out.spawn();
        out.put(entity, PictureFreeze { by: by(3, "Ana") });
        entity
    });
    let frozen = shot(&liver);
    let differs = |a: &Picture, b: &Picture, x: u32, y: u32| a.at(x, y) != b.at(x, y);
    for at in [[1, 1], [SIZE[0] - 2, 1], [1, SIZE[1] - 2], [SIZE[0] - 2, SIZE[1] - 2], [1, SIZE[1] / 2]] {
        assert!(differs(&plain, &frozen, at[0], at[1]), "the frame at {at:?}");
    }
    assert!(!differs(&plain, &frozen, 5, SIZE[1] - 8) && !differs(&plain, &frozen, SIZE[0] / 2, SIZE[1] / 2));
    let told = (0..SIZE[0]).flat_map(|x| (6..26).map(move |y| (x, y)));
    let told: Vec<u32> = told
        .filter(|(x, y)| differs(&plain, &frozen, *x, *y) && *x > 4 && *x < SIZE[0] - 5)
        .map(|(x, _)| x)
        .collect();
    let middle = 0.5 * f64::from(told.iter().min().expect("words") + told.iter().max().expect("words"));
    assert!((middle - 0.5 * f64::from(SIZE[0])).abs() < 4.0 && told.len() > 400, "{middle} {}", told.len());
    // The session goes on.
    let places = liver.arc();
    liver.deform(&places);
    assert_eq!(shot(&liver).color, frozen.color, "not a pixel moves");
    liver.write(|out| {
        let entity = out.spawn();
        out.put(entity, stroke(places.clone(), 0.004));
    });
    let marked = shot(&liver);
    let on_rest = |place: &SurfacePlace| {
        let rest = Liver::new();
        let scene = rest.store.snapshot();
        pixel(&rest.view, &PlaceReader::new(&scene).find(place).expect("there").point)
    };
    for place in places.iter().step_by(9) {
        let [x, y] = on_rest(place);
        assert!(marked.at(x, y).is_some_and(is_ink), "drawn on the picture that stands still");
    }
    liver.write(|out| out.despawn(freeze));
    let on = shot(&liver);
    let anew =
        drawn(&mut OffscreenRenderer::new(None).expect("an adapter"), &liver.store.snapshot(), &liver.view);
    assert_eq!(on.color, anew.color, "it shows what has happened meanwhile");
}

#[test]
fn who_asks_for_an_instrument_is_told_at_the_top() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    let mut lines = |request: Option<TakeOverRequest>, name: &str| {
        let hand = scene.write(|out| {
            let (instrument, hand) = (out.spawn(), out.spawn());
            out.put(instrument, Name(name.to_owned()));
            let world_from_device = Pose::default();
            out.put(hand, Hand { side: Side::Right, instrument, world_from_device, scale: 1.0 });
            hand
        });
        if let Some(request) = request {
            scene.write(|out| out.put(hand, request));
        }
        let picture = renderer.picture(&scene.view(), &front(), &Layout::Mono, SIZE).expect("a picture");
        scene.write(|out| out.despawn(hand));
        picture
    };
    let nothing = lines(None, "grasper");
    let asked = TakeOverRequest { by: by(3, "Ana"), step: TakeOverStep::Asked, answer: None };
    let taken = TakeOverRequest { step: TakeOverStep::Accepted, answer: Some(by(1, "Bo")), ..asked.clone() };
    let kept = TakeOverRequest { step: TakeOverStep::Declined, ..taken.clone() };
    let mut wide = |request: TakeOverRequest| {
        let picture = lines(Some(request), "grasper");
        let columns: Vec<u32> =
            (0..SIZE[0]).filter(|x| (0..SIZE[1]).any(|y| picture.at(*x, y) != nothing.at(*x, y))).collect();
        assert!((40..SIZE[1]).all(|y| (0..SIZE[0]).all(|x| picture.at(x, y) == nothing.at(x, y))));
        columns.len()
    };
    let widths = [wide(asked.clone()), wide(taken), wide(kept)];
    assert!(widths[0] > 80 && widths.is_sorted(), "longer words are wider: {widths:?}");
    // The longest name does not get out of the picture's hands.
    let long = Signature { name: "n".repeat(SIGNATURE_NAME_MAX), ..by(3, "Ana") };
    assert!(wide(TakeOverRequest { by: long, ..asked }) > widths[2]);
}
