//! What persons show one another: pointers, strokes and labels on the tissue, a frozen picture, requests for instruments.
//!
//! A stroke is a ribbon of its width in metres that lies a little above the surface and follows it. It is opaque, and faint
//! where something hides it.

use nalgebra::{Point3, Vector3};
use trocar_scene::annotation::{PlaceInWorld, PlaceReader};
use trocar_scene::{
    Entity, Hand, LABELS_MAX, MentorLabel, MentorPointer, MentorStroke, PictureFreeze, SECTIONS_MAX,
    Snapshot, TakeOverRequest, TakeOverStep,
};

use super::Seen;
use super::sketch::{Color, Sketch, Stroke};

/// How far above the surface strokes lie \[m\].
const LIFT: f64 = 4e-4;
/// Places nearer to one another are one \[m\].
const SAME: f64 = 1e-6;
/// Half the length of a pointer's cross, and the radius of its dot \[m\].
const CROSS: f64 = 4e-3;
const DOT: f64 = 1e-3;
/// Length of the line from a place to its label \[m\].
const LEADER: f64 = 0.015;
/// Remaining opacity where something hides it.
const HIDDEN: f32 = 0.25;
/// Triangles of a whole disc.
const DISC_SIDES: u32 = 16;
/// Cosine of the turn beyond which a ribbon gets a round joint.
const ROUND_BELOW: f64 = 0.5;
/// Most pointers drawn: one a station.
const POINTERS_MAX: usize = 64;
/// Most lines of requests.
const LINES_MAX: usize = 8;

/// Colours of persons, by the number of the station.
const COLORS: [[u8; 3]; 6] =
    [[60, 200, 255], [255, 170, 40], [120, 235, 90], [255, 110, 200], [245, 235, 80], [170, 140, 255]];

/// The colour of a station's pointer and labels.
pub fn color(station: u16) -> Color {
    let [r, g, b] = COLORS[usize::from(station) % COLORS.len()];
    [r, g, b, 255]
}

/// Whether there is anything to draw.
pub fn are_there(scene: &Snapshot) -> bool {
    fn any<T: trocar_scene::Component>(scene: &Snapshot) -> bool {
        scene.iter::<T>().next().is_some()
    }
    any::<MentorPointer>(scene)
        || any::<MentorStroke>(scene)
        || any::<MentorLabel>(scene)
        || any::<PictureFreeze>(scene)
        || any::<TakeOverRequest>(scene)
}

/// Draws all of it.
pub fn draw(scene: &Snapshot, line_width: f32, seen: &mut Seen) {
    let mut reader = PlaceReader::new(scene);
    for (_, stroke) in scene.iter::<MentorStroke>().take(SECTIONS_MAX) {
        let [r, g, b] = stroke.colour;
        let ink = Stroke { color: [r, g, b, 255], width: line_width, hidden: HIDDEN };
        for run in stroke.runs() {
            // A place that is nowhere interrupts the ribbon until the board has taken it out.
            let mut found: Vec<PlaceInWorld> = Vec::with_capacity(run.len());
            for place in run {
                match reader.find(place) {
                    Some(place) => found.push(place),
                    None => {
                        ribbon(&std::mem::take(&mut found), f64::from(stroke.width), &ink, &mut seen.sketch)
                    }
                }
            }
            ribbon(&found, f64::from(stroke.width), &ink, &mut seen.sketch);
        }
    }
    for (_, label) in scene.iter::<MentorLabel>().take(LABELS_MAX) {
        let Some(PlaceInWorld { point, normal }) = reader.find(&label.place) else { continue };
        let ink = Stroke { color: color(label.by.station), width: line_width, hidden: HIDDEN };
        let end = point + normal * LEADER;
        seen.sketch.line(&point, &end, &ink);
        disc(&lifted(&point, &normal), &normal, 0.5 * DOT, &ink, &mut seen.sketch);
        seen.captions.push((end, format!("{}: {}", label.by.name, label.text)));
    }
    for (_, pointer) in scene.iter::<MentorPointer>().take(POINTERS_MAX) {
        let Some(PlaceInWorld { point, normal }) = reader.find(&pointer.place) else { continue };
        let ink = Stroke { color: color(pointer.by.station), width: 1.5 * line_width, hidden: HIDDEN };
        let centre = lifted(&point, &normal);
        let (across, along) = tangents(&normal);
        for arm in [across + along, across - along] {
            let arm = arm.normalize() * CROSS;
            seen.sketch.line(&(centre - arm), &(centre + arm), &ink);
        }
        disc(&centre, &normal, DOT, &ink, &mut seen.sketch);
        seen.captions.push((centre, pointer.by.name.clone()));
    }
    if let Some((_, PictureFreeze { by })) = scene.iter::<PictureFreeze>().next() {
        seen.frozen = true;
        seen.banner.push(format!("frozen by {}", by.name));
    }
    let requests = scene.iter::<TakeOverRequest>().take(LINES_MAX);
    seen.banner.extend(requests.map(|(hand, request)| told(scene, hand, request)));
}

/// A request as a line of text.
pub(crate) fn told(scene: &Snapshot, hand: Entity, request: &TakeOverRequest) -> String {
    let instrument = scene.get::<Hand>(hand).map_or(hand, |hand| hand.instrument);
    let (instrument, by) = (scene.name(instrument), &request.by.name);
    match (&request.step, &request.answer) {
        (TakeOverStep::Asked, _) => format!("{by} asks for {instrument}"),
        (TakeOverStep::Accepted, _) => format!("{by} has taken {instrument} over"),
        (TakeOverStep::Declined, Some(answer)) => {
            format!("{} keeps {instrument}, which {by} has asked for", answer.name)
        }
        (TakeOverStep::Declined, None) => format!("{by} has asked for {instrument} and does not get it"),
    }
}

fn lifted(point: &Point3<f64>, normal: &Vector3<f64>) -> Point3<f64> {
    point + normal * LIFT
}

/// Two unit vectors across a normal and each other.
fn tangents(normal: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let aside = if normal.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let across = normal.cross(&aside).normalize();
    (across, normal.cross(&across))
}

/// A ribbon through places, with round ends and round joints where it turns sharply.
fn ribbon(places: &[PlaceInWorld], width: f64, ink: &Stroke, sketch: &mut Sketch) {
    let mut path: Vec<(Point3<f64>, Vector3<f64>)> = Vec::with_capacity(places.len());
    for PlaceInWorld { point, normal } in places {
        let point = lifted(point, normal);
        if path.last().is_none_or(|(before, _)| (point - before).norm() > SAME) {
            path.push((point, *normal));
        }
    }
    let (Some((start, start_normal)), Some((end, end_normal))) = (path.first(), path.last()) else { return };
    let half = 0.5 * width;
    disc(start, start_normal, half, ink, sketch);
    if path.len() == 1 {
        return;
    }
    disc(end, end_normal, half, ink, sketch);
    let directions: Vec<Vector3<f64>> =
        path.windows(2).map(|pair| (pair[1].0 - pair[0].0).normalize()).collect();
    // To the left of the ribbon at a place, if it runs in that direction.
    let left = |normal: &Vector3<f64>, direction: &Vector3<f64>| {
        normal.cross(direction).try_normalize(1e-9).unwrap_or_else(|| tangents(normal).0) * half
    };
    let mut before: Option<Vector3<f64>> = None;
    for (at, direction) in directions.iter().enumerate() {
        let [(from, from_normal), (to, to_normal)] = [path[at], path[at + 1]];
        let near = before.take().unwrap_or_else(|| left(&from_normal, direction));
        let far = match directions.get(at + 1) {
            Some(next) if direction.dot(next) > ROUND_BELOW => {
                let shared = left(&to_normal, &(direction + next));
                before = Some(shared);
                shared
            }
            Some(_) => {
                disc(&to, &to_normal, half, ink, sketch);
                left(&to_normal, direction)
            }
            None => left(&to_normal, direction),
        };
        let [a, b, c, d] = [from + near, from - near, to + far, to - far];
        sketch.triangle([a, b, c], ink);
        sketch.triangle([b, d, c], ink);
    }
}

fn disc(centre: &Point3<f64>, normal: &Vector3<f64>, radius: f64, ink: &Stroke, sketch: &mut Sketch) {
    let (across, along) = tangents(normal);
    let rim = |side: u32| {
        let angle = std::f64::consts::TAU * f64::from(side % DISC_SIDES) / f64::from(DISC_SIDES);
        centre + (across * angle.cos() + along * angle.sin()) * radius
    };
    for side in 0..DISC_SIDES {
        sketch.triangle([*centre, rim(side), rim(side + 1)], ink);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INK: Stroke = Stroke { color: [1, 2, 3, 255], width: 2.0, hidden: 0.5 };

    fn along(points: &[[f64; 2]]) -> Sketch {
        let place =
            |[x, y]: &[f64; 2]| PlaceInWorld { point: Point3::new(*x, *y, 0.0), normal: Vector3::z() };
        let places: Vec<PlaceInWorld> = points.iter().map(place).collect();
        let mut sketch = Sketch::default();
        ribbon(&places, 0.002, &INK, &mut sketch);
        sketch
    }

    fn area(sketch: &Sketch) -> f64 {
        let corner = |at: usize| Point3::from(sketch.triangles[at].position).cast::<f64>();
        let triangle = |first: usize| {
            (corner(first + 1) - corner(first)).cross(&(corner(first + 2) - corner(first))).norm() / 2.0
        };
        (0..sketch.triangles.len()).step_by(3).map(triangle).sum()
    }

    #[test]
    fn a_ribbon_has_its_width_all_along_and_lies_above_the_surface() {
        let straight = along(&[[0.0, 0.0], [0.01, 0.0], [0.02, 0.0], [0.02, 0.0], [0.05, 0.0]]);
        let discs =
            2.0 * 0.5 * f64::from(DISC_SIDES) * (std::f64::consts::TAU / f64::from(DISC_SIDES)).sin() * 1e-6;
        assert!((area(&straight) - (0.05 * 0.002 + discs)).abs() < 1e-9, "{}", area(&straight));
        for corner in &straight.triangles {
            assert!((f64::from(corner.position[2]) - LIFT).abs() < 1e-9);
            assert!(f64::from(corner.position[1]).abs() < 0.001 + 1e-9);
        }
    }

    #[test]
    fn a_gentle_turn_shares_its_corners_and_a_sharp_one_gets_a_joint() {
        let discs = |sketch: &Sketch, segments: usize| {
            (sketch.triangles.len() / 3 - 2 * segments) / DISC_SIDES as usize
        };
        assert_eq!(discs(&along(&[[0.0, 0.0], [0.01, 0.0], [0.02, 0.003]]), 2), 2);
        assert_eq!(discs(&along(&[[0.0, 0.0], [0.01, 0.0], [0.0, 0.001]]), 2), 3);
        assert_eq!(discs(&along(&[[0.0, 0.0]]), 0), 1);
        assert!(along(&[]).triangles.is_empty());
    }
}
