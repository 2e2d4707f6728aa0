//! Small surfaces with what a proxy may fall through: thin walls, sharp edges, pits, wedges.

use nalgebra::{Point3, Vector3};

pub type Mesh = (Vec<Point3<f64>>, Vec<[u32; 3]>);

/// A square of `cells` × `cells` cells in the plane z = 0, outward up, `width` wide \[m\].
pub fn plate(cells: u32, width: f64) -> Mesh {
    let place = |step: u32| (f64::from(step) / f64::from(cells) - 0.5) * width;
    let vertices =
        (0..=cells).flat_map(|y| (0..=cells).map(move |x| Point3::new(place(x), place(y), 0.0))).collect();
    let at = |x: u32, y: u32| y * (cells + 1) + x;
    let triangles = (0..cells)
        .flat_map(|y| {
            (0..cells).flat_map(move |x| {
                let (a, b, c, d) = (at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1));
                if (x + y) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] }
            })
        })
        .collect();
    (vertices, triangles)
}

/// A box from −`half` to `half`, outward.
pub fn cuboid(half: Vector3<f64>) -> Mesh {
    super::super::cuboid::cuboid((-half).into(), half.into())
}

pub fn inverted((vertices, triangles): Mesh) -> Mesh {
    (vertices, triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect())
}

pub fn joined(first: Mesh, second: Mesh) -> Mesh {
    let offset = first.0.len() as u32;
    let (mut vertices, mut triangles) = first;
    vertices.extend(second.0);
    triangles.extend(second.1.into_iter().map(|corners| corners.map(|corner| corner + offset)));
    (vertices, triangles)
}

/// A box whose wall is `wall` thick, hollow.
pub fn hollow(half: Vector3<f64>, wall: f64) -> Mesh {
    joined(cuboid(half), inverted(cuboid(half - Vector3::repeat(wall))))
}

/// A sphere of about 20 · 4^`levels` triangles whose vertices `shape` moves out or in.
pub fn sphere(levels: u32, shape: impl Fn(&Vector3<f64>) -> f64) -> Mesh {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut vertices: Vec<Vector3<f64>> = Vec::new();
    for (first, second) in [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)] {
        vertices.push(Vector3::new(first, second, 0.0));
    }
    for (first, second) in [(-1.0, golden), (1.0, golden), (-1.0, -golden), (1.0, -golden)] {
        vertices.push(Vector3::new(0.0, first, second));
    }
    for (first, second) in [(golden, -1.0), (golden, 1.0), (-golden, -1.0), (-golden, 1.0)] {
        vertices.push(Vector3::new(first, 0.0, second));
    }
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    for _ in 0..levels {
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |a: u32, b: u32, vertices: &mut Vec<Vector3<f64>>| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                vertices.push(vertices[a as usize].normalize() + vertices[b as usize].normalize());
                vertices.len() as u32 - 1
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let (ab, bc, ca) =
                    (middle(a, b, &mut vertices), middle(b, c, &mut vertices), middle(c, a, &mut vertices));
                [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
            })
            .collect();
    }
    let vertices = vertices
        .iter()
        .map(|vertex| {
            let direction = vertex.normalize();
            Point3::from(direction * shape(&direction))
        })
        .collect();
    (vertices, triangles)
}

/// A burr: spikes and pits, every edge sharp, that grow and shrink in time \[s\]. It never meets itself: whatever it does,
/// it is seen whole from its middle.
pub fn burr(levels: u32, radius: f64, time: f64) -> Mesh {
    sphere(levels, |direction| {
        let noise = (direction.x * 12.9898 + direction.y * 78.233 + direction.z * 37.719).sin() * 43_758.547;
        let phase = noise - noise.floor();
        radius * (0.725 + 0.275 * (std::f64::consts::TAU * (phase + time * (0.5 + phase))).sin())
    })
}

/// How often a closed surface winds around a point (van Oosterom and Strackee, 1983).
pub fn winding(vertices: &[Point3<f64>], triangles: &[[u32; 3]], point: &Point3<f64>) -> f64 {
    let angle = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|vertex| vertices[vertex as usize] - point);
        let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
        let volume = a.dot(&b.cross(&c));
        let cosine = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
        2.0 * volume.atan2(cosine)
    };
    triangles.iter().map(angle).sum::<f64>() / (2.0 * std::f64::consts::TAU)
}
