//! Orientation predicates: the side of a plane or a line on which a point lies, as the exact sign of a determinant.
//!
//! A floating-point determinant with an error bound decides nearly all cases; otherwise the determinant is formed again
//! as an expansion, a sum of numbers that do not overlap, without any rounding (Shewchuk, *Adaptive Precision
//! Floating-Point Arithmetic and Fast Robust Geometric Predicates*, 1997). Exact unless a product leaves the range of
//! `f64` (coordinates beyond 1e100, differences below 1e-100).

use nalgebra::Point3;

/// Half a unit in the last place of 1.
const ROUNDING: f64 = f64::EPSILON / 2.0;
/// Error bound of the plain 3 × 3 determinant, relative to the sum of its products' magnitudes.
const ERROR_IN_SPACE: f64 = (7.0 + 56.0 * ROUNDING) * ROUNDING;
/// The same of the 2 × 2 determinant.
const ERROR_IN_PLANE: f64 = (3.0 + 16.0 * ROUNDING) * ROUNDING;

/// Sign of six times the volume of a tetrahedron: positive when `a`, `b`, `c` appear clockwise seen from `d`, which is
/// when `d` lies behind the triangle; 0 when the four lie in one plane. Only the sign is meaningful.
#[must_use]
pub fn orientation(a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>, d: &Point3<f64>) -> f64 {
    let (u, v, w) = (a - d, b - d, c - d);
    let (vw, wv) = (v.x * w.y, w.x * v.y);
    let (wu, uw) = (w.x * u.y, u.x * w.y);
    let (uv, vu) = (u.x * v.y, v.x * u.y);
    let determinant = u.z * (vw - wv) + v.z * (wu - uw) + w.z * (uv - vu);
    let permanent = (vw.abs() + wv.abs()) * u.z.abs()
        + (wu.abs() + uw.abs()) * v.z.abs()
        + (uv.abs() + vu.abs()) * w.z.abs();
    if determinant.abs() > ERROR_IN_SPACE * permanent || permanent == 0.0 {
        determinant
    } else {
        exact_in_space(a, b, c, d)
    }
}

/// Sign of twice the area of a triangle in a plane: positive when its corners run counter-clockwise, 0 when they lie on
/// one line. Only the sign is meaningful.
#[must_use]
pub fn orientation_in_plane(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let left = (a[0] - c[0]) * (b[1] - c[1]);
    let right = (a[1] - c[1]) * (b[0] - c[0]);
    let determinant = left - right;
    if determinant.abs() > ERROR_IN_PLANE * (left.abs() + right.abs()) {
        return determinant;
    }
    let (ax, ay) = (difference(a[0], c[0]), difference(a[1], c[1]));
    let (bx, by) = (difference(b[0], c[0]), difference(b[1], c[1]));
    let mut sum = Expansion::<16>::ZERO;
    sum.add_product(&ax, &by, 1.0);
    sum.add_product(&ay, &bx, -1.0);
    sum.sign()
}

#[cold]
fn exact_in_space(a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>, d: &Point3<f64>) -> f64 {
    let from_d = |p: &Point3<f64>| [difference(p.x, d.x), difference(p.y, d.y), difference(p.z, d.z)];
    let rows = [from_d(a), from_d(b), from_d(c)];
    let mut sum = Expansion::<192>::ZERO;
    for first in 0..3 {
        let (u, v, w) = (&rows[first], &rows[(first + 1) % 3], &rows[(first + 2) % 3]);
        let mut minor = Expansion::<16>::ZERO;
        minor.add_product(&v[0], &w[1], 1.0);
        minor.add_product(&w[0], &v[1], -1.0);
        for part in &minor.parts[..minor.count] {
            for height in u[2] {
                let (high, low) = two_product(*part, height);
                sum.add(low);
                sum.add(high);
            }
        }
    }
    sum.sign()
}

/// A sum of numbers that do not overlap, smallest first.
struct Expansion<const MOST: usize> {
    parts: [f64; MOST],
    count: usize,
}

impl<const MOST: usize> Expansion<MOST> {
    const ZERO: Self = Self { parts: [0.0; MOST], count: 0 };

    /// Adds one number without rounding; each number adds at most one part.
    fn add(&mut self, number: f64) {
        let mut carried = number;
        let mut kept = 0;
        for index in 0..self.count {
            let (high, low) = two_sum(carried, self.parts[index]);
            if low != 0.0 {
                self.parts[kept] = low;
                kept += 1;
            }
            carried = high;
        }
        if carried != 0.0 {
            self.parts[kept] = carried;
            kept += 1;
        }
        self.count = kept;
    }

    fn add_product(&mut self, first: &[f64; 2], second: &[f64; 2], sign: f64) {
        for one in first {
            for other in second {
                let (high, low) = two_product(*one, *other);
                self.add(sign * low);
                self.add(sign * high);
            }
        }
    }

    fn sign(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.parts[self.count - 1] }
    }
}

fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let of_b = sum - a;
    let of_a = sum - of_b;
    (sum, (a - of_a) + (b - of_b))
}

fn difference(a: f64, b: f64) -> [f64; 2] {
    let (high, low) = two_sum(a, -b);
    [low, high]
}

fn two_product(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    let ((a_high, a_low), (b_high, b_low)) = (split(a), split(b));
    let rest = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low;
    (product, rest)
}

/// Two halves of 26 bits each, whose products are exact (Dekker 1971).
fn split(a: f64) -> (f64, f64) {
    const HALVES: f64 = 134_217_729.0;
    let scaled = HALVES * a;
    let high = scaled - (scaled - a);
    (high, a - high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The determinant in integers, for points on a grid.
    fn in_integers(p: [[i64; 3]; 4]) -> i128 {
        let row = |i: usize| [0, 1, 2].map(|axis| i128::from(p[i][axis]) - i128::from(p[3][axis]));
        let (u, v, w) = (row(0), row(1), row(2));
        u[2] * (v[0] * w[1] - w[0] * v[1])
            + v[2] * (w[0] * u[1] - u[0] * w[1])
            + w[2] * (u[0] * v[1] - v[0] * u[1])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        /// Points that nearly share a plane, as integers of up to 2³⁸: their sign is computed without rounding.
        #[test]
        fn the_sign_is_that_of_the_integers(
            corners in [[-1_000_000_i64..1_000_000, -1_000_000..1_000_000, -1_000_000..1_000_000],
                        [-1_000_000_i64..1_000_000, -1_000_000..1_000_000, -1_000_000..1_000_000],
                        [-1_000_000_i64..1_000_000, -1_000_000..1_000_000, -1_000_000..1_000_000]],
            steps in [-30_000_i64..30_000, -30_000..30_000],
            beside in [-1_i64..=1, -1..=1, -1..=1],
        ) {
            let [a, b, c] = corners;
            let d = [0, 1, 2].map(|axis| {
                a[axis] + steps[0] * (b[axis] - a[axis]) + steps[1] * (c[axis] - a[axis]) + beside[axis]
            });
            let points = [a, b, c, d].map(|p| Point3::from(p.map(|x| x as f64)));
            let exact = in_integers([a, b, c, d]).signum();
            let found = orientation(&points[0], &points[1], &points[2], &points[3]);
            let found = if found > 0.0 { 1 } else if found < 0.0 { -1 } else { 0 };
            prop_assert_eq!(found, exact);

            let flat = [a, b, c, d].map(|p| [p[0] as f64, p[1] as f64]);
            let exact = ((i128::from(a[0]) - i128::from(d[0])) * (i128::from(b[1]) - i128::from(d[1]))
                - (i128::from(a[1]) - i128::from(d[1])) * (i128::from(b[0]) - i128::from(d[0])))
            .signum();
            let found = orientation_in_plane(flat[0], flat[1], flat[3]);
            let found = if found > 0.0 { 1 } else if found < 0.0 { -1 } else { 0 };
            prop_assert_eq!(found, exact);
        }
    }

    #[test]
    fn one_unit_in_the_last_place_is_seen() {
        let plane =
            [Point3::new(12.0, 12.0, 12.0), Point3::new(24.0, 24.0, 12.0), Point3::new(0.5, 0.5, 40.0)];
        let on = Point3::new(0.1, 0.1, 0.1);
        assert_eq!(orientation(&plane[0], &plane[1], &plane[2], &on), 0.0);
        let above = Point3::new(0.1, 0.1_f64.next_up(), 0.1);
        let below = Point3::new(0.1, 0.1_f64.next_down(), 0.1);
        let (up, down) = (
            orientation(&plane[0], &plane[1], &plane[2], &above),
            orientation(&plane[0], &plane[1], &plane[2], &below),
        );
        assert!(up * down < 0.0, "{up} {down}");
    }
}
