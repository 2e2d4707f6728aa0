//! The surface of a tube: rings around the samples of a curve, and caps.

use nalgebra::{Point3, Vector3};

use super::{Cap, Tube, VERTICES_MAX};

/// A ring of vertices.
struct Ring {
    center: Point3<f64>,
    tangent: Vector3<f64>,
    axis: Vector3<f64>,
    /// Cosine and sine of the angle between the normals and the plane across the curve: 0 along the tube, −90° to
    /// 0 over the cap at its beginning, 0 to 90° over the one at its end.
    lean: [f64; 2],
    v: f64,
}

impl Tube {
    pub(super) fn prepare_circle(&mut self) {
        let around = self.style.around as usize;
        if self.circle.len() != around + 1 {
            self.circle.clear();
            self.circle.extend((0..=around).map(|k| {
                let (sine, cosine) = (std::f64::consts::TAU * (k % around) as f64 / around as f64).sin_cos();
                [cosine, sine]
            }));
        }
    }

    /// Builds the surface around the curve.
    pub(super) fn skin(&mut self, radius: f64, closed: bool, caps: [Cap; 2]) {
        let samples = self.curve.samples().len();
        let bands = (self.style.around as usize / 4).max(2);
        let rings = samples + 2 * bands + 2;
        if self.positions.len() + rings * (self.circle.len() + 1) > VERTICES_MAX {
            return;
        }
        let per_length = 1.0 / (std::f64::consts::TAU * radius);
        let total = self.curve.length() * per_length;
        let stretch = if closed { total.round().max(1.0) / total } else { 1.0 };
        let ring_at = |tube: &Self, index: usize| {
            let sample = tube.curve.samples()[index % samples];
            let v = if index == samples { total } else { sample.arc * per_length } * stretch;
            let axis = tube.axes[index % samples];
            Ring { center: sample.position, tangent: sample.tangent, axis, lean: [1.0, 0.0], v }
        };
        let quarter = |band: usize| {
            let (sine, cosine) = (std::f64::consts::FRAC_PI_2 * band as f64 / bands as f64).sin_cos();
            (if band == bands { [0.0, 1.0] } else { [cosine, sine] }, 0.25 * band as f64 / bands as f64)
        };
        let round = [0, 1].map(|end| !closed && caps[end] == Cap::Round);
        let mut pole = false;
        let first = self.positions.len();
        if round[0] {
            for band in (1..=bands).rev() {
                let ([cosine, sine], v) = quarter(band);
                let ring = ring_at(self, 0);
                self.ring(&Ring { lean: [cosine, -sine], v: ring.v - v, ..ring }, radius);
                if band < bands {
                    self.join(std::mem::take(&mut pole), false);
                } else {
                    pole = true;
                }
            }
        }
        let last = if closed { samples } else { samples - 1 };
        for index in 0..=last {
            let ring = ring_at(self, index);
            self.ring(&ring, radius);
            if self.positions.len() > first + self.circle.len() {
                self.join(std::mem::take(&mut pole), false);
            }
        }
        if round[1] {
            for band in 1..=bands {
                let (lean, v) = quarter(band);
                let ring = ring_at(self, last);
                self.ring(&Ring { lean, v: ring.v + v, ..ring }, radius);
                self.join(false, band == bands);
            }
        }
        for end in [0, 1] {
            if !closed && caps[end] == Cap::Flat {
                let ring = ring_at(self, if end == 0 { 0 } else { last });
                self.disc(&ring, radius, end == 1);
            }
        }
    }

    fn vertex(&mut self, position: Point3<f64>, normal: Vector3<f64>, uv: [f64; 2]) {
        self.positions.push([position.x as f32, position.y as f32, position.z as f32]);
        self.normals.push([normal.x as f32, normal.y as f32, normal.z as f32]);
        self.uvs.push([uv[0] as f32, uv[1] as f32]);
    }

    fn ring(&mut self, ring: &Ring, radius: f64) {
        let binormal = ring.tangent.cross(&ring.axis);
        let corners = self.circle.len();
        for corner in 0..corners {
            let [cosine, sine] = self.circle[corner];
            let outward = ring.axis * cosine + binormal * sine;
            let normal = outward * ring.lean[0] + ring.tangent * ring.lean[1];
            let u = corner as f64 / (corners - 1) as f64;
            self.vertex(ring.center + normal * radius, normal, [u, ring.v]);
        }
    }

    /// Joins the last two rings; at a pole all corners are the same point.
    fn join(&mut self, from_pole: bool, to_pole: bool) {
        let corners = self.circle.len() as u32;
        let to = self.positions.len() as u32 - corners;
        let from = to - corners;
        for corner in 0..corners - 1 {
            let (a, b) = (from + corner, from + corner + 1);
            let (d, c) = (to + corner, to + corner + 1);
            if !from_pole {
                self.indices.extend([a, b, c]);
            }
            if !to_pole {
                self.indices.extend([a, c, d]);
            }
        }
    }

    fn disc(&mut self, ring: &Ring, radius: f64, at_end: bool) {
        let binormal = ring.tangent.cross(&ring.axis);
        let normal = if at_end { ring.tangent } else { -ring.tangent };
        let center = self.positions.len() as u32;
        self.vertex(ring.center, normal, [0.5, ring.v]);
        let scale = 0.5 / std::f64::consts::PI;
        for corner in 0..self.circle.len() {
            let [cosine, sine] = self.circle[corner];
            let outward = ring.axis * cosine + binormal * sine;
            self.vertex(
                ring.center + outward * radius,
                normal,
                [0.5 + scale * cosine, ring.v + scale * sine],
            );
        }
        for corner in 1..self.circle.len() as u32 {
            let (a, b) = (center + corner, center + corner + 1);
            self.indices.extend(if at_end { [center, a, b] } else { [center, b, a] });
        }
    }
}
