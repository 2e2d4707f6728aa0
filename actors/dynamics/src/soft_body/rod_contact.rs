//! Contact of rods with a deformable body: every vertex within a rod, and for each rod the deepest point on the surface
//! or the line, so that thin jaws between coarse vertices are felt as well, and other deep ones along the rod. A rod deeper in a volume than its own
//! radius is detected by its samples inside the volume, and pushed out along the shortest way. A rod whose axis crosses
//! a sheet is pressed farther into it than its radius: the sheet is moved beyond the tip, except at a hole. Open jaws
//! pass on either side of the sheet that they are to grasp: no look-ahead and no push-out for them.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_collision::primitive::{
    closest_on_segment, closest_on_triangle, closest_segment_triangle, closest_segments,
};
use trocar_scene::{Collision, Detection, Entity, Primitive, SimTime};

use super::instrument_rods::Rod;

/// Maximum number of contacts that a controller writes to the collision list; the deepest are kept.
pub const COLLISIONS_MAX: usize = 64;

/// One contact of a rod.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RodContact {
    /// Index of the rod.
    pub rod: usize,
    /// Corners of the touched feature; one vertex three times for a vertex, the last twice for a segment.
    pub nodes: [u32; 3],
    /// Barycentric weights of the point: each in \[0, 1\], their sum 1.
    pub weights: [f64; 3],
    /// Unit direction from the rod to the body.
    pub normal: Vector3<f64>,
    /// Penetration depth \[m\]; negative for a feature that the rod may reach within a tick.
    pub depth: f64,
    /// Velocity of the rod at the contact \[m/s\].
    pub velocity: Vector3<f64>,
    /// Nearest point on the rod's axis \[m\].
    pub on_axis: Point3<f64>,
    /// Index of the triangle or segment; `None` for a vertex.
    pub element: Option<u32>,
}

/// Collision geometry of a body.
#[derive(Clone, Copy, Debug)]
pub struct ContactSurface<'a> {
    /// Vertices \[m\].
    pub positions: &'a [Point3<f64>],
    /// Surface triangles.
    pub triangles: &'a [[u32; 3]],
    /// Line segments.
    pub segments: &'a [[u32; 2]],
    /// Distance of its surface from the vertices \[m\]: half the thickness of a cloth, the radius of a thread.
    pub thickness: f64,
    /// Whether its triangles enclose a volume.
    pub closed: bool,
}

/// Sample points along a rod that are tested for being inside a volume.
const SAMPLES: u32 = 5;
/// A sheet or a line closer to a rod than this fraction of the rod's radius counts as touched: if it sprang back to the
/// rod within a tick it would be detected behind its surface and thrown off, and so on in every other tick. The same
/// holds for anything that the rod reaches within the tick, and would have passed before the next.
const AHEAD: f64 = 1.0;
/// Depth of elements besides the deepest that are touched as well, as a share of the distance from a rod's axis to the
/// surface.
const DEEP: f64 = 0.6;
/// A point nearer to the axis of a rod than this lies on it \[m\].
const ON: f64 = 1e-12;
/// How far beyond a sheet the tip of a rod is still tracked, in addition to its motion in this tick \[m\].
const THROUGH: f64 = 0.01;

/// Fills `touches` with all contacts in a tick of `period` \[s\], by rod; each rod's vertices first.
pub fn touches(rods: &[Rod], skin: &ContactSurface<'_>, period: f64, touches: &mut Vec<RodContact>) {
    touches.clear();
    for (index, rod) in rods.iter().enumerate() {
        touch_vertices(index, rod, skin, period, touches);
        let known = touches.iter().filter(|touch| touch.rod == index).map(|touch| touch.depth);
        let deeper = known.fold(f64::NEG_INFINITY, f64::max);
        let first = touches.len();
        let found = touch_elements(index, rod, skin, period, touches);
        let deep = deeper.max(DEEP * (rod.radius + skin.thickness));
        keep_deepest(touches, first, deeper, deep);
        if skin.closed && !found && deeper == f64::NEG_INFINITY {
            touches.extend(deepest_within(index, rod, skin).or_else(|| on_surface(index, rod, skin)));
        }
    }
}

/// The deepest point of a rod within a volume that it does not touch from outside.
fn deepest_within(index: usize, rod: &Rod, skin: &ContactSurface<'_>) -> Option<RodContact> {
    let mut positions = skin.positions.iter();
    let first = *positions.next()?;
    let (low, high) = positions.fold((first, first), |(low, high), point| (low.inf(point), high.sup(point)));
    let samples = (0..SAMPLES).map(|sample| f64::from(sample) / f64::from(SAMPLES - 1));
    let within = samples.filter_map(|along| {
        let on_axis = rod.ends[0].lerp(&rod.ends[1], along);
        let boxed = (0..3).all(|k| on_axis[k] >= low[k] && on_axis[k] <= high[k]);
        if !boxed || !is_within(&on_axis, skin) {
            return None;
        }
        let nearest = skin.triangles.iter().enumerate().map(|(element, nodes)| {
            let corners = nodes.map(|node| skin.positions[node as usize]);
            let nearest = closest_on_triangle(&on_axis, &corners);
            (element, nearest.weights, on_axis - nearest.point)
        });
        let (element, weights, inwards) =
            nearest.min_by(|a, b| a.2.norm_squared().total_cmp(&b.2.norm_squared()))?;
        let normal = inwards.try_normalize(1e-12)?;
        let depth = rod.radius + skin.thickness + inwards.norm();
        let velocity = rod.velocities[0].lerp(&rod.velocities[1], along);
        let nodes = skin.triangles[element];
        let element = Some(element as u32);
        Some(RodContact { rod: index, nodes, weights, normal, depth, velocity, on_axis, element })
    });
    within.max_by(|a, b| a.depth.total_cmp(&b.depth))
}

/// Where the axis of a rod outside a volume meets its surface: it ends on it, lies in it, or cuts off a corner. The
/// distance from the axis is then zero, so only the surface gives the direction of the push.
fn on_surface(index: usize, rod: &Rod, skin: &ContactSurface<'_>) -> Option<RodContact> {
    let search_box = [rod.ends[0].inf(&rod.ends[1]), rod.ends[0].sup(&rod.ends[1])];
    skin.triangles.iter().enumerate().find_map(|(element, &nodes)| {
        let corners = nodes.map(|node| skin.positions[node as usize]);
        if is_apart(&corners, &search_box) {
            return None;
        }
        let nearest = closest_segment_triangle(&rod.ends, &corners);
        if nearest.distance_squared > ON * ON {
            return None;
        }
        let [a, b, c] = corners;
        let normal = (c - a).cross(&(b - a)).try_normalize(1e-18)?;
        let on_axis = rod.ends[0].lerp(&rod.ends[1], nearest.along);
        let velocity = rod.velocities[0].lerp(&rod.velocities[1], nearest.along);
        let (depth, weights) = (rod.radius + skin.thickness, nearest.weights);
        let element = Some(element as u32);
        Some(RodContact { rod: index, nodes, weights, normal, depth, velocity, on_axis, element })
    })
}

/// Whether a point is inside, by the solid angle of the surface around it (van Oosterom and Strackee 1983).
fn is_within(point: &Point3<f64>, skin: &ContactSurface<'_>) -> bool {
    let angle: f64 = skin
        .triangles
        .iter()
        .map(|nodes| {
            let [a, b, c] = nodes.map(|node| skin.positions[node as usize] - point);
            let [la, lb, lc] = [a.norm(), b.norm(), c.norm()];
            let below = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
            2.0 * a.dot(&b.cross(&c)).atan2(below)
        })
        .sum();
    angle > 2.0 * std::f64::consts::PI
}

/// Whether look-ahead contacts, and contacts after a pass through, apply to this pair.
fn looks_ahead(rod: &Rod, skin: &ContactSurface<'_>) -> bool {
    !(skin.closed || rod.is_open_jaw)
}

/// Distance from the axis of a rod within which something touches it, or may within a tick.
fn reach(rod: &Rod, skin: &ContactSurface<'_>) -> f64 {
    let ahead = if looks_ahead(rod, skin) { AHEAD * rod.radius } else { 0.0 };
    rod.radius + skin.thickness + ahead
}

/// Bounding box of possible contacts of a rod, including its motion in the tick.
fn search_box(rod: &Rod, skin: &ContactSurface<'_>, period: f64) -> [Point3<f64>; 2] {
    let period = if looks_ahead(rod, skin) { period } else { 0.0 };
    let [a, b] = rod.ends;
    let [c, d] = [a + rod.velocities[0] * period, b + rod.velocities[1] * period];
    let reach = Vector3::repeat(reach(rod, skin));
    [a.inf(&b).inf(&c).inf(&d) - reach, a.sup(&b).sup(&c).sup(&d) + reach]
}

/// Distance of a rod from the body's surface, if it is within `way` \[m\]; negative where they overlap.
pub fn gap(rod: &Rod, skin: &ContactSurface<'_>, way: f64) -> Option<f64> {
    let reach = rod.radius + skin.thickness;
    let far = Vector3::repeat(reach + way);
    let [a, b] = rod.ends;
    let search_box = [a.inf(&b) - far, a.sup(&b) + far];
    let mut nearest = f64::INFINITY;
    for nodes in skin.triangles {
        let corners = nodes.map(|node| skin.positions[node as usize]);
        if !is_apart(&corners, &search_box) {
            nearest = nearest.min(closest_segment_triangle(&rod.ends, &corners).distance_squared);
        }
    }
    for nodes in skin.segments {
        let [a, b] = nodes.map(|node| skin.positions[node as usize]);
        if !is_apart(&[a, b, b], &search_box) {
            nearest = nearest.min(closest_segments(&rod.ends, &[a, b]).distance_squared);
        }
    }
    let gap = nearest.sqrt() - reach;
    (gap <= way).then_some(gap)
}

/// Whether a triangle lies entirely on one side of a box.
fn is_apart(corners: &[Point3<f64>; 3], [low, high]: &[Point3<f64>; 2]) -> bool {
    (0..3).any(|k| {
        corners.iter().all(|corner| corner[k] < low[k]) || corners.iter().all(|corner| corner[k] > high[k])
    })
}

/// The contact of a rod with the point nearest to its axis, if it is within reach, or if the rod gets there within the
/// tick: `passes` returns how near the path of the axis point comes to the other.
fn touch(
    rod: (usize, &Rod),
    skin: &ContactSurface<'_>,
    (along, on_body): (f64, Point3<f64>),
    period: f64,
    passes: impl Fn(&[Point3<f64>; 2]) -> f64,
) -> Option<RodContact> {
    let (index, rod) = rod;
    let on_axis = rod.ends[0].lerp(&rod.ends[1], along);
    let velocity = rod.velocities[0].lerp(&rod.velocities[1], along);
    let away = on_body - on_axis;
    let distance = away.norm();
    let depth = rod.radius + skin.thickness - distance;
    let is_reached = || {
        let way = velocity * period;
        looks_ahead(rod, skin)
            && way.dot(&away) > 0.0
            && passes(&[on_axis, on_axis + way]) < rod.radius + skin.thickness
    };
    if distance < ON || (distance >= reach(rod, skin) && !is_reached()) {
        return None;
    }
    let normal = away / distance;
    let (nodes, weights) = ([0; 3], [1.0, 0.0, 0.0]);
    Some(RodContact { rod: index, nodes, weights, normal, depth, velocity, on_axis, element: None })
}

/// The contact of a rod whose axis crosses a sheet at `along` from its handle end: the sheet is to be moved to the
/// rod's tip.
fn through(rod: (usize, &Rod), skin: &ContactSurface<'_>, along: f64, period: f64) -> Option<RodContact> {
    let (index, rod) = rod;
    let ahead = rod.ends[1] - rod.ends[0];
    let beyond = (1.0 - along) * ahead.norm();
    let velocity = rod.velocities[1];
    if !looks_ahead(rod, skin) || beyond > THROUGH + velocity.norm() * period {
        return None;
    }
    let normal = ahead.try_normalize(1e-12)?;
    let depth = rod.radius + skin.thickness + beyond;
    let (nodes, weights) = ([0; 3], [1.0, 0.0, 0.0]);
    Some(RodContact {
        rod: index,
        nodes,
        weights,
        normal,
        depth,
        velocity,
        on_axis: rod.ends[1],
        element: None,
    })
}

fn touch_vertices(
    index: usize,
    rod: &Rod,
    skin: &ContactSurface<'_>,
    period: f64,
    touches: &mut Vec<RodContact>,
) {
    let [low, high] = search_box(rod, skin, period);
    for (vertex, position) in skin.positions.iter().enumerate() {
        if !(0..3).all(|k| position[k] >= low[k] && position[k] <= high[k]) {
            continue;
        }
        let along = closest_on_segment(position, &rod.ends);
        let passes = |way: &[Point3<f64>; 2]| {
            (position - way[0].lerp(&way[1], closest_on_segment(position, way))).norm()
        };
        if let Some(touch) = touch((index, rod), skin, (along, *position), period, passes) {
            touches.push(RodContact { nodes: [vertex as u32; 3], ..touch });
        }
    }
}

/// Of the contacts of a rod with elements, from `first` on, keeps the deepest if it is deeper than `deeper`, that of the
/// vertices; and of others that are deeper than `deep` those that share no vertex with deeper ones. A rod that is pressed
/// in between two rows of vertices is borne all along.
fn keep_deepest(touches: &mut Vec<RodContact>, first: usize, deeper: f64, deep: f64) {
    let own = &mut touches[first..];
    own.sort_unstable_by(|a, b| b.depth.total_cmp(&a.depth).then(a.element.cmp(&b.element)));
    let mut kept = first;
    for at in first..touches.len() {
        let touch = touches[at];
        let is_apart = || {
            touches[first..kept]
                .iter()
                .all(|other| other.nodes.iter().all(|node| !touch.nodes.contains(node)))
        };
        let least = if at == first { deeper } else { deep };
        if touch.depth > least && is_apart() {
            touches[kept] = touch;
            kept += 1;
        }
    }
    touches.truncate(kept);
}

/// Appends all contacts of a rod with triangles and segments; returns whether there are any.
fn touch_elements(
    index: usize,
    rod: &Rod,
    skin: &ContactSurface<'_>,
    period: f64,
    touches: &mut Vec<RodContact>,
) -> bool {
    let search_box = search_box(rod, skin, period);
    let before = touches.len();
    let mut keep = |touch: RodContact| touches.push(touch);
    for (element, nodes) in skin.triangles.iter().enumerate() {
        let corners = nodes.map(|node| skin.positions[node as usize]);
        if is_apart(&corners, &search_box) {
            continue;
        }
        let nearest = closest_segment_triangle(&rod.ends, &corners);
        let touched = if nearest.distance_squared > 0.0 {
            let passes =
                |way: &[Point3<f64>; 2]| closest_segment_triangle(way, &corners).distance_squared.sqrt();
            touch((index, rod), skin, (nearest.along, nearest.on_triangle), period, passes)
        } else {
            through((index, rod), skin, nearest.along, period)
        };
        if let Some(touch) = touched {
            keep(RodContact {
                nodes: *nodes,
                weights: nearest.weights,
                element: Some(element as u32),
                ..touch
            });
        }
    }
    for (element, &[a, b]) in skin.segments.iter().enumerate() {
        let ends = [a, b].map(|node| skin.positions[node as usize]);
        let nearest = closest_segments(&rod.ends, &ends);
        let [along, share] = nearest.along;
        let on_body = ends[0].lerp(&ends[1], share);
        let passes = |way: &[Point3<f64>; 2]| closest_segments(way, &ends).distance_squared.sqrt();
        if let Some(touch) = touch((index, rod), skin, (along, on_body), period, passes) {
            let weights = [1.0 - share, share, 0.0];
            keep(RodContact { nodes: [a, b, b], weights, element: Some(element as u32), ..touch });
        }
    }
    touches.len() > before
}

/// A rod contact as a row of the collision list: `a` is the instrument, `b` the body.
pub fn collision(
    touch: &RodContact,
    rod: &Rod,
    body: Entity,
    force_on_body: &Vector3<f64>,
    world_from_body: &Isometry3<f64>,
    at: SimTime,
) -> Collision {
    let on_rod = touch.on_axis + touch.normal * rod.radius;
    let on_body = on_rod - touch.normal * touch.depth;
    Collision {
        a: rod.instrument,
        primitive_a: Primitive::Shaft,
        b: body,
        primitive_b: match touch.element {
            Some(element) if touch.nodes[1] == touch.nodes[2] => Primitive::Segment(element),
            Some(element) => Primitive::Triangle(element),
            None => Primitive::Vertex(touch.nodes[0]),
        },
        points_in_world: [world_from_body * on_rod, world_from_body * on_body],
        normal_in_world: world_from_body.rotation * touch.normal,
        depth: touch.depth,
        force_in_world: world_from_body.rotation * force_on_body,
        velocity_constraint: 0.0,
        method: Detection::Simulator,
        detected_at: at,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 1e-3;

    /// One triangle, without thickness.
    fn sheet(positions: &[Point3<f64>]) -> ContactSurface<'_> {
        ContactSurface { positions, triangles: &[[0, 1, 2]], segments: &[], thickness: 0.0, closed: false }
    }

    fn rod(from: [f64; 3], to: [f64; 3]) -> Rod {
        Rod {
            instrument: Entity::new(0, 1, 1),
            ends: [from.into(), to.into()],
            radius: 0.002,
            velocities: [Vector3::x(), Vector3::y()],
            is_open_jaw: false,
        }
    }

    #[test]
    fn a_rod_between_coarse_vertices_touches_the_triangle() {
        let positions = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]].map(Point3::from);
        let skin = ContactSurface { thickness: 0.0005, ..sheet(&positions) };
        let mut found = Vec::new();
        touches(&[rod([0.02, 0.03, 0.001], [0.02, 0.03, 0.1])], &skin, PERIOD, &mut found);
        assert_eq!(found.len(), 1);
        let touch = found[0];
        assert!((touch.depth - 0.0015).abs() < 1e-12 && (touch.normal + Vector3::z()).norm() < 1e-12);
        let at =
            touch.nodes.iter().zip(touch.weights).fold(Vector3::zeros(), |sum, (&node, weight)| {
                sum + positions[node as usize].coords * weight
            });
        assert!((at - Vector3::new(0.02, 0.03, 0.0)).norm() < 1e-12);
        assert_eq!((touch.element, touch.velocity), (Some(0), Vector3::x()));
    }

    #[test]
    fn vertices_within_a_rod_are_touched_each() {
        let positions: Vec<Point3<f64>> =
            (0..20).map(|k| Point3::new(0.001 * f64::from(k), 0.0015, 0.0)).collect();
        let skin = ContactSurface {
            positions: &positions,
            triangles: &[],
            segments: &[],
            thickness: 0.0,
            closed: false,
        };
        let mut found = Vec::new();
        touches(&[rod([0.0, 0.0, 0.0], [0.01, 0.0, 0.0])], &skin, PERIOD, &mut found);
        // Eleven beside it, and one beyond its round end.
        let (inside, near): (Vec<RodContact>, Vec<RodContact>) =
            found.iter().partition(|touch| touch.depth > 0.0);
        assert_eq!((inside.len(), near.len()), (12, 2));
        assert!(found.iter().all(|touch| touch.depth > -0.002 && touch.element.is_none()));
    }

    #[test]
    fn a_rod_that_goes_through_a_sheet_is_pushed_out_along_itself_and_one_that_is_far_through_is_not() {
        let positions = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]].map(Point3::from);
        let skin = sheet(&positions);
        let mut found = Vec::new();
        let pressed =
            |tip: f64| Rod { velocities: [Vector3::z(); 2], ..rod([0.02, 0.03, -0.05], [0.02, 0.03, tip]) };
        for (tip, depth) in [(-1e-9, 0.002), (1e-9, 0.002), (0.003, 0.005), (0.0105, 0.0125)] {
            touches(&[pressed(tip)], &skin, PERIOD, &mut found);
            assert_eq!(found.len(), 1, "{tip}");
            let touch = found[0];
            assert!(
                (touch.depth - depth).abs() < 1e-8 && (touch.normal - Vector3::z()).norm() < 1e-9,
                "{touch:?}"
            );
            assert_eq!((touch.element, touch.velocity), (Some(0), Vector3::z()));
        }
        touches(&[pressed(0.0115)], &skin, PERIOD, &mut found);
        assert!(found.is_empty());
        touches(&[Rod { is_open_jaw: true, ..pressed(0.003) }], &skin, PERIOD, &mut found);
        assert!(found.is_empty(), "an open jaw goes to the other side");
        // A hole: the rod crosses nothing.
        touches(&[rod([0.07, 0.07, -0.05], [0.07, 0.07, 0.01])], &skin, PERIOD, &mut found);
        assert!(found.is_empty());
    }

    #[test]
    fn what_a_rod_comes_to_within_the_tick_is_touched_and_what_it_passes_beside_is_not() {
        let positions = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]].map(Point3::from);
        let skin = sheet(&positions);
        let mut found = Vec::new();
        let mut count = |height: f64, y: f64, velocity: Vector3<f64>| {
            let fast = Rod { velocities: [velocity; 2], ..rod([0.02, y, height], [0.04, y, height]) };
            touches(&[fast], &skin, 0.01, &mut found);
            (found.len(), found.first().map_or(0.0, |touch| touch.depth))
        };
        // A centimetre in the tick: to where it is 2 mm off, and from where it would be past it.
        assert_eq!(count(0.013, 0.02, Vector3::z() * -1.0), (0, 0.0));
        let (hits, depth) = count(0.011, 0.02, Vector3::z() * -1.0);
        assert!(hits == 1 && (depth + 0.009).abs() < 1e-12, "{hits} {depth}");
        assert_eq!(count(0.005, 0.02, Vector3::z() * -1.0).0, 1);
        assert_eq!(count(0.005, 0.02, Vector3::z()).0, 0, "it goes away");
        assert_eq!(count(0.005, 0.12, Vector3::z() * -1.0).0, 0, "beside the triangle");
        assert_eq!(count(0.005, 0.02, Vector3::y()).0, 0, "over it");
    }

    #[test]
    fn a_thin_rod_deep_in_a_volume_is_found_and_one_beside_it_is_not() {
        let corners = |bits: u32| [0, 1, 2].map(|k| 0.02 * (f64::from(bits >> k & 1) - 0.5));
        let positions: Vec<Point3<f64>> = (0..8).map(|bits| Point3::from(corners(bits))).collect();
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let triangles: Vec<[u32; 3]> =
            quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let skin = ContactSurface {
            positions: &positions,
            triangles: &triangles,
            segments: &[],
            thickness: 0.0,
            closed: true,
        };
        let mut found = Vec::new();
        let thin = |from: [f64; 3], to: [f64; 3]| Rod { radius: 0.0005, ..rod(from, to) };
        // The whole rod is inside, its lower end the deepest: 4 mm below the top, 0.5 mm more with its radius.
        touches(&[thin([0.001, 0.002, 0.007], [0.001, 0.002, 0.006])], &skin, PERIOD, &mut found);
        assert_eq!(found.len(), 1);
        assert!((found[0].depth - 0.0045).abs() < 1e-12 && (found[0].normal + Vector3::z()).norm() < 1e-9);
        assert_eq!(found[0].velocity, Vector3::y());
        touches(&[thin([0.001, 0.002, 0.03], [0.001, 0.002, 0.012])], &skin, PERIOD, &mut found);
        assert!(found.is_empty());
        // A rod whose axis ends on the surface (face, edge, vertex) or lies in it is pushed out by its radius.
        for (x, y, from) in
            [(0.001, 0.002, 0.03), (0.01, 0.002, 0.03), (0.01, 0.01, 0.03), (0.01, 0.01, 0.010)]
        {
            touches(&[thin([x, y, from], [x, y, 0.01])], &skin, PERIOD, &mut found);
            let touch = found.last().unwrap_or_else(|| panic!("at {x} {y} nothing is touched"));
            assert!((touch.depth - 0.0005).abs() < 1e-9, "at {x} {y}: {touch:?}");
            let inwards = touch.normal.dot(&(Point3::origin() - touch.on_axis));
            assert!(inwards > 0.0, "at {x} {y}: {touch:?}");
        }
    }

    #[test]
    fn a_thread_is_touched_by_its_segment() {
        let positions = [[-0.05, 0.001, 0.0], [0.05, 0.001, 0.0]].map(Point3::from);
        let skin = ContactSurface {
            positions: &positions,
            triangles: &[],
            segments: &[[0, 1]],
            thickness: 0.0002,
            closed: false,
        };
        let mut found = Vec::new();
        touches(&[rod([0.01, 0.0, -0.01], [0.01, 0.0, 0.01])], &skin, PERIOD, &mut found);
        assert_eq!(found.len(), 1);
        assert!((found[0].weights[1] - 0.6).abs() < 1e-12 && (found[0].depth - 0.0012).abs() < 1e-12);
    }
}
