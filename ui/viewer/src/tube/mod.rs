//! Threads and bands as smooth tubes: the segments of a `LineMesh` sorted into chains ([`ChainFinder`]), a curve
//! through their points ([`Curve`]), frames along it that do not twist ([`frames`]), and rings around it.

mod chains;
mod curve;
pub mod frames;
mod skin;

use nalgebra::{Point3, Vector3};

pub use chains::{Chain, ChainFinder};
pub use curve::{Curve, Sample};

/// The ends of a tube.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cap {
    /// A hemisphere. Ends where chains meet are always round, so that a branching has no gap.
    Round,
    /// A disc.
    Flat,
}

/// Resolution of a tube, and its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TubeStyle {
    /// Corners of a ring, 3 to 64.
    pub around: u32,
    /// Largest angle by which the curve turns from one ring to the next \[rad\], 0.02 to 1.
    pub turn: f64,
    /// Shape of free ends.
    pub cap: Cap,
}

impl Default for TubeStyle {
    fn default() -> Self {
        Self { around: 12, turn: 0.2, cap: Cap::Round }
    }
}

/// Most vertices of a tube: further ones are left out.
pub const VERTICES_MAX: usize = 2_000_000;

/// The tubes of one `LineMesh`. Buffers are kept from one update to the next.
///
/// Texture coordinates: u is 0 to 1 once around; v is the arc length in circumferences, so that a square texture
/// stays square and keeps its scale. Around a closed loop v is stretched to a whole number.
#[derive(Clone, Debug, Default)]
pub struct Tube {
    style: TubeStyle,
    chains: ChainFinder,
    curve: Curve,
    axes: Vec<Vector3<f64>>,
    /// First axis of each chain in the last update, so that a thread does not spin from one picture to the next.
    first_axes: Vec<Option<Vector3<f64>>>,
    /// Cosine and sine of each corner of a ring; the last repeats the first.
    circle: Vec<[f64; 2]>,
    points: Vec<Point3<f64>>,
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    indices: Vec<u32>,
}

impl Tube {
    /// An empty tube.
    pub fn new(style: TubeStyle) -> Self {
        let style =
            TubeStyle { around: style.around.clamp(3, 64), turn: style.turn.clamp(0.02, 1.0), ..style };
        Self { style, ..Self::default() }
    }

    /// Follows the segments and points of a `LineMesh`. Segments with invalid points, or from a point to itself, are
    /// left out, as are points that coincide with the previous one. A radius that is not above 0 gives an empty tube.
    /// Once the buffers are large enough, nothing is allocated unless the segments change.
    pub fn update(&mut self, segments: &[[u32; 2]], points: &[Point3<f64>], radius: f64) {
        self.positions.clear();
        self.normals.clear();
        self.uvs.clear();
        self.indices.clear();
        if !(radius > 0.0 && radius < 1e6) {
            return;
        }
        self.prepare_circle();
        if self.chains.find(segments, points.len()) {
            self.first_axes.clear();
            self.first_axes.resize(self.chains.chains().len(), None);
        }
        for index in 0..self.chains.chains().len() {
            let chain = self.chains.chains()[index];
            self.points.clear();
            for vertex in self.chains.vertices(chain) {
                let point = points[*vertex as usize];
                let apart = self.points.last().is_none_or(|last| (point - last).norm() > 1e-6 * radius);
                if apart && point.coords.amax() < 1e9 {
                    self.points.push(point);
                }
            }
            if chain.closed {
                while self.points.len() > 1
                    && (self.points[0] - self.points[self.points.len() - 1]).norm() <= 1e-6 * radius
                {
                    self.points.pop();
                }
            }
            let closed = chain.closed && self.points.len() > 2;
            self.curve.trace(&self.points, closed, self.style.turn);
            if self.curve.samples().len() < 2 {
                continue;
            }
            frames::transport(self.curve.samples(), closed, self.first_axes[index], &mut self.axes);
            self.first_axes[index] = self.axes.first().copied();
            let caps =
                [chain.meets[0], chain.meets[1]].map(|meets| if meets { Cap::Round } else { self.style.cap });
            self.skin(radius, closed, caps);
        }
    }

    /// Vertices \[m\].
    pub fn positions(&self) -> &[[f32; 3]] {
        &self.positions
    }

    /// Unit normal of each vertex.
    pub fn normals(&self) -> &[[f32; 3]] {
        &self.normals
    }

    /// Texture coordinate of each vertex.
    pub fn uvs(&self) -> &[[f32; 2]] {
        &self.uvs
    }

    /// Three vertices per triangle, counter-clockwise seen from outside.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }
}

#[cfg(test)]
mod tests;
