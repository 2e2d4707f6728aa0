//! Oriented boxes, one and four at a time: separating axis test and distance bounds (Gottschalk, Lin, Manocha,
//! *OBBTree: A Hierarchical Structure for Rapid Interference Detection*, 1996).

use super::lanes::{Lanes, Lanes3, dot, each, minus, splat, three};

/// One oriented box, in the unit of its tree.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Obb {
    pub center: [f32; 3],
    /// Unit axes, by rows.
    pub axes: [[f32; 3]; 3],
    /// Half of the extent along each axis.
    pub half: [f32; 3],
    /// Size for the choice of the node to descend: half of the longest extent.
    pub size: f32,
}

impl Obb {
    /// An empty box: separated from every other.
    pub const NONE: Self = Self {
        center: [0.0; 3],
        axes: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        half: [-1e30; 3],
        size: 0.0,
    };
}

/// A similarity from the unit of one tree to that of another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    /// By rows.
    pub rotation: [[f32; 3]; 3],
    pub shift: [f32; 3],
    pub scale: f32,
}

impl Placement {
    #[inline(always)]
    fn turn(&self, v: [f32; 3]) -> [f32; 3] {
        each(self.rotation, |row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    #[inline(always)]
    pub fn place(&self, obb: &Obb) -> Obb {
        let turned = self.turn(obb.center);
        Obb {
            center: three(|i| turned[i] * self.scale + self.shift[i]),
            axes: each(obb.axes, |axis| self.turn(axis)),
            half: each(obb.half, |half| half * self.scale),
            size: obb.size * self.scale,
        }
    }

    /// Transforms four points at a time.
    #[inline(always)]
    pub fn place_points(&self, points: Lanes3) -> Lanes3 {
        let scale = Lanes::all(self.scale);
        three(|i| dot(splat(self.rotation[i]), points) * scale + Lanes::all(self.shift[i]))
    }
}

/// Four oriented boxes, lane by lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct ObbQuad {
    pub center: Lanes3,
    pub axes: [Lanes3; 3],
    pub half: Lanes3,
}

/// Separating axis data of the face axes of two boxes.
struct Faces {
    /// Dot products of the axes: rows for the single box, columns for the four.
    turned: [[Lanes; 3]; 3],
    magnitude: [[Lanes; 3]; 3],
    /// From the single box's centre to the four, in its axes.
    between: Lanes3,
    /// Gap along each axis of the single box, then of the four.
    gaps: [Lanes3; 2],
}

/// The greatest gap along the cross products of the axes, times the length of that product.
#[inline(always)]
fn crossed(
    turned: &[[Lanes; 3]; 3],
    magnitude: &[[Lanes; 3]; 3],
    between: &Lanes3,
    one: &Obb,
    half_of_four: &Lanes3,
) -> Lanes {
    let half = splat(one.half);
    let mut crossed = Lanes::all(f32::NEG_INFINITY);
    for i in 0..3 {
        let (i1, i2) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            let (j1, j2) = ((j + 1) % 3, (j + 2) % 3);
            let apart = (between[i2] * turned[i1][j] - between[i1] * turned[i2][j]).abs();
            let of_one = half[i1] * magnitude[i2][j] + half[i2] * magnitude[i1][j];
            let of_four = half_of_four[j1] * magnitude[i][j2] + half_of_four[j2] * magnitude[i][j1];
            crossed = crossed.max(apart - (of_one + of_four));
        }
    }
    crossed
}

impl ObbQuad {
    pub const NONE: Self =
        Self { center: [Lanes::ZERO; 3], axes: [[Lanes::ZERO; 3]; 3], half: [Lanes::ZERO; 3] };

    pub fn set(&mut self, lane: usize, obb: &Obb) {
        for i in 0..3 {
            self.center[i].0[lane] = obb.center[i];
            self.half[i].0[lane] = obb.half[i];
            for j in 0..3 {
                self.axes[i][j].0[lane] = obb.axes[i][j];
            }
        }
    }

    #[inline(always)]
    fn faces(&self, one: &Obb) -> Faces {
        let axes = each(one.axes, splat);
        let between = minus(self.center, splat(one.center));
        let turned = each(axes, |axis| each(self.axes, |other| dot(axis, other)));
        let magnitude = each(turned, |row| each(row, Lanes::abs));
        let of_one = each(axes, |axis| dot(axis, between));
        let of_four = each(self.axes, |axis| dot(axis, between));
        let half = splat(one.half);
        let along_one = three(|i| of_one[i].abs() - half[i] - dot(magnitude[i], self.half));
        let along_four = three(|j| {
            let column = [magnitude[0][j], magnitude[1][j], magnitude[2][j]];
            of_four[j].abs() - self.half[j] - dot(column, half)
        });
        Faces { turned, magnitude, between: of_one, gaps: [along_one, along_four] }
    }

    /// Which of the four may intersect `one`, and the gap of each along the best separating axis: the more negative,
    /// the deeper the overlap. Gaps up to `slack` count as none.
    #[inline]
    pub fn overlapping(&self, one: &Obb, slack: f32) -> (u32, Lanes) {
        let Faces { turned, magnitude, between, gaps: [a, b] } = self.faces(one);
        let worst = a[0].max(a[1]).max(a[2]).max(b[0]).max(b[1]).max(b[2]);
        let limit = Lanes::all(slack);
        let near = worst.at_most(limit);
        if near == 0 {
            return (0, worst);
        }
        (near & crossed(&turned, &magnitude, &between, one, &self.half).at_most(limit), worst)
    }

    /// Gap of each from `one` along the best separating axis, a lower bound of their distance. Negative if no axis
    /// separates them.
    #[inline]
    pub fn gaps(&self, one: &Obb) -> Lanes {
        let Faces { turned, magnitude, between, gaps: [a, b] } = self.faces(one);
        let faces = a[0].max(a[1]).max(a[2]).max(b[0]).max(b[1]).max(b[2]);
        // The cross product of unit axes is no longer than 1: so the true gap is not smaller than this value.
        faces.max(crossed(&turned, &magnitude, &between, one, &self.half))
    }

    /// Lower bounds of the squared distance from `one` to each, and the squared distance of the centres. Each box is
    /// enclosed in a box with the other's axes, whose gaps in three directions add up.
    #[inline]
    pub fn distance_squared(&self, one: &Obb, slack: f32) -> (Lanes, Lanes) {
        let Faces { between, gaps, .. } = self.faces(one);
        let squared = |gaps: Lanes3| {
            let apart = each(gaps, |gap| (gap - Lanes::all(slack)).max(Lanes::ZERO));
            dot(apart, apart)
        };
        (squared(gaps[0]).max(squared(gaps[1])), dot(between, between))
    }
}
