//! Background lattice for isosurface stuffing: body-centred cubic at the surface, coarser inside.
//!
//! Cubes of an octree whose neighbours differ by one level at most, also over edges. Tetrahedra lie around what two
//! cubes of one size share, between their middles, and as half pyramids where a cube meets a larger one
//! (Labelle, Shewchuk 2007, "Isosurface stuffing", graded lattices).

use nalgebra::Point3;

use super::OrganError;
use super::implicit::Implicit;

/// Most cubes of the finest size.
pub const CELLS_MAX: usize = 500_000;
/// Cubes of a row beyond the body on either side.
const MARGIN: f64 = 2.0;

/// Tetrahedra of a lattice; only those that may be inside.
pub(super) struct Lattice {
    /// Corner numbers of its tetrahedra, positively oriented.
    pub tets: Vec<[u32; 4]>,
    /// Vertices \[m\].
    pub vertices: Vec<Point3<f64>>,
    /// Depth of each vertex in the body \[m\].
    pub depths: Vec<f64>,
    /// Lattice coordinates of the vertices in half cubes; odd for centres of the finest cubes.
    pub places: Vec<[i32; 3]>,
}

/// Cubes, the finest ones in a box; each stores the level of the cube that contains it.
struct Cubes {
    count: [i32; 3],
    level: Vec<u8>,
    /// Whether a cube is part of the lattice.
    used: Vec<bool>,
}

impl Cubes {
    fn index(&self, at: [i32; 3]) -> Option<usize> {
        let inside = (0..3).all(|k| at[k] >= 0 && at[k] < self.count[k]);
        inside.then(|| ((at[2] * self.count[1] + at[1]) * self.count[0] + at[0]) as usize)
    }

    /// Level of the cube at a lattice position, if there is one.
    fn level(&self, at: [i32; 3]) -> Option<u8> {
        self.index(at).filter(|&index| self.used[index]).map(|index| self.level[index])
    }

    /// Every cube by its first position and its level.
    fn leaves(&self) -> impl Iterator<Item = ([i32; 3], u8)> + '_ {
        let [nx, ny, nz] = self.count;
        let places = (0..nz).flat_map(move |z| (0..ny).flat_map(move |y| (0..nx).map(move |x| [x, y, z])));
        places.filter_map(|at| {
            let level = self.level(at)?;
            at.iter().all(|x| x & ((1 << level) - 1) == 0).then_some((at, level))
        })
    }
}

fn plus(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn along(axis: usize, by: i32) -> [i32; 3] {
    let mut way = [0; 3];
    way[axis] = by;
    way
}

impl Lattice {
    /// The lattice around a body, with cubes of `edge` \[m\] at its surface and up to `2^levels` times that inside.
    pub fn around(body: &Implicit, edge: f64, levels: u8) -> Result<Self, OrganError> {
        let [low, high] = body.bounds().ok_or(OrganError::Empty)?;
        let origin = low - nalgebra::Vector3::repeat(MARGIN * edge);
        let block = f64::from(1_u32 << levels);
        let mut count = [0_i32; 3];
        let mut cells = 1.0;
        for k in 0..3 {
            let wanted = (((high[k] - low[k]) / edge + 2.0 * MARGIN) / block).ceil() * block;
            cells *= wanted;
            if !wanted.is_finite() || cells > CELLS_MAX as f64 {
                return Err(OrganError::TooFine { edge, cells, most: CELLS_MAX });
            }
            count[k] = wanted as i32;
        }
        let place = |at: [i32; 3]| origin + nalgebra::Vector3::from(at.map(f64::from)) * (0.5 * edge);
        let cubes = divide(&count, levels, &|at| body.depth(&place(at)) > 0.0);
        Ok(Self::of(&cubes, &place, body))
    }

    fn of(cubes: &Cubes, place: &dyn Fn([i32; 3]) -> Point3<f64>, body: &Implicit) -> Self {
        let mut corners: Vec<[[i32; 3]; 4]> = Vec::new();
        for (at, level) in cubes.leaves() {
            for axis in 0..3 {
                for side in [0, 1] {
                    join(cubes, at, level, axis, side, &mut corners);
                }
            }
        }
        let mut places: Vec<[i32; 3]> = corners.iter().flatten().copied().collect();
        places.sort_unstable();
        places.dedup();
        let vertices: Vec<Point3<f64>> = places.iter().map(|&at| place(at)).collect();
        let depths = vertices.iter().map(|vertex| body.depth(vertex)).collect();
        // Every corner is in the sorted list.
        let number = |at: &[i32; 3]| places.binary_search(at).unwrap_or(0) as u32;
        let mut tets: Vec<[u32; 4]> =
            corners.iter().map(|tet| [0, 1, 2, 3].map(|k| number(&tet[k]))).collect();
        for tet in &mut tets {
            let [a, b, c, d] = tet.map(|vertex| vertices[vertex as usize]);
            if (b - a).cross(&(c - a)).dot(&(d - a)) < 0.0 {
                tet.swap(2, 3);
            }
        }
        Self { tets, vertices, depths, places }
    }
}

/// Finest cubes where the surface crosses an edge of the lattice, coarser ones inside, none outside. `inside` takes a
/// position in half cubes.
fn divide(count: &[i32; 3], levels: u8, inside: &dyn Fn([i32; 3]) -> bool) -> Cubes {
    let total = count.iter().product::<i32>() as usize;
    let mut cubes = Cubes { count: *count, level: vec![0; total], used: vec![false; total] };
    let [nx, ny, nz] = *count;
    let corners = [nx + 1, ny + 1, nz + 1];
    let corner_index = |at: [i32; 3]| ((at[2] * corners[1] + at[1]) * corners[0] + at[0]) as usize;
    let mut corner = vec![false; corners.iter().product::<i32>() as usize];
    let mut middle = vec![false; total];
    for at in boxed([0; 3], corners) {
        corner[corner_index(at)] = inside(at.map(|x| 2 * x));
    }
    for at in boxed([0; 3], *count) {
        let index = cubes.index(at).unwrap_or_default();
        middle[index] = inside(at.map(|x| 2 * x + 1));
    }
    // A cube is at the surface if an edge of the lattice that starts in it may be crossed.
    let mut near = vec![false; total];
    for at in boxed([0; 3], *count) {
        let index = cubes.index(at).unwrap_or_default();
        let here = middle[index];
        let mixed = boxed(at, plus(at, [2; 3])).any(|at| corner[corner_index(at)] != here)
            || (0..3).any(|axis| {
                [-1, 1].into_iter().any(|by| {
                    cubes.index(plus(at, along(axis, by))).is_some_and(|other| middle[other] != here)
                })
            });
        near[index] = mixed;
    }
    for index in 0..total {
        cubes.used[index] = near[index] || middle[index];
    }
    for level in 1..=levels {
        merge(&mut cubes, &near, level);
    }
    cubes
}

/// Joins eight cubes of the level below where all neighbours are at least as large as they are.
fn merge(cubes: &mut Cubes, near: &[bool], level: u8) {
    let size = 1 << level;
    let blocks = cubes.count.map(|n| n / size);
    for block in boxed([0; 3], blocks) {
        let first = block.map(|x| x * size);
        let own = || boxed(first, plus(first, [size; 3]));
        let large = |index: usize| cubes.used[index] && cubes.level[index] >= level - 1;
        // Its neighbourhood, half its size deep.
        let around = boxed(plus(first, [-size / 2; 3]), plus(first, [size + size / 2; 3]));
        let fits = own().all(|at| cubes.index(at).is_some_and(|index| large(index) && !near[index]))
            && around.into_iter().all(|at| cubes.index(at).is_some_and(large));
        if fits {
            for at in own() {
                if let Some(index) = cubes.index(at) {
                    cubes.level[index] = level;
                }
            }
        }
    }
}

/// Places from `low` to below `high`.
fn boxed(low: [i32; 3], high: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    (low[2]..high[2])
        .flat_map(move |z| (low[1]..high[1]).flat_map(move |y| (low[0]..high[0]).map(move |x| [x, y, z])))
}

/// The tetrahedra between a cube and its neighbour across one face, in half cubes.
fn join(cubes: &Cubes, at: [i32; 3], level: u8, axis: usize, side: i32, tets: &mut Vec<[[i32; 3]; 4]>) {
    let size = 1 << level;
    let beyond = plus(at, along(axis, if side == 1 { size } else { -1 }));
    let Some(other) = cubes.level(beyond) else { return };
    let middle = at.map(|x| 2 * x + size);
    // The face's corners, around it.
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let first = plus(at, along(axis, side * size)).map(|x| 2 * x);
    let corner = |a: i32, b: i32| plus(first, plus(along(u, 2 * size * a), along(v, 2 * size * b)));
    let face = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
    if other == level {
        if side == 0 {
            return; // once, from the other cube
        }
        let across = plus(middle, along(axis, 2 * size));
        for (k, way) in [along(v, -1), along(u, 1), along(v, 1), along(u, -1)].into_iter().enumerate() {
            let (a, b) = (face[k], face[(k + 1) % 4]);
            // The cubes beyond the edge, next to this one and next to the other.
            let step = way.map(|x| if x > 0 { size } else { x });
            let finer =
                |from: [i32; 3]| cubes.level(plus(from, step)).is_some_and(|level_there| level_there < level);
            if level > 0 && (finer(at) || finer(plus(at, along(axis, size)))) {
                let half = [0, 1, 2].map(|k| (a[k] + b[k]) / 2);
                tets.push([middle, across, a, half]);
                tets.push([middle, across, half, b]);
            } else {
                tets.push([middle, across, a, b]);
            }
        }
    } else if other > level {
        let big = beyond.map(|x| x & !((1 << other) - 1)).map(|x| 2 * x + (1 << other));
        // The diagonal starts in the middle of the large cube's face.
        let start =
            face.iter().position(|corner| (0..3).all(|k| k == axis || corner[k] == big[k])).unwrap_or(0);
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| face[(start + k) % 4]);
        for [p, q] in [[b, c], [c, d]] {
            tets.push([middle, a, p, q]);
            tets.push([big, a, p, q]);
        }
    }
}
