//! Surfaces of revolution about z: cylinder, capsule, sphere, torus.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Vector3;

use super::builder::{Builder, Corner};
use super::{ShapeError, length, segments as check_segments};
use crate::mesh::SurfaceData;

/// A point of a profile in the half plane r ≥ 0, with the normals of the pieces before and after it.
#[derive(Clone, Copy)]
struct ProfilePoint {
    r: f64,
    z: f64,
    /// (radial, axial) unit normal of the piece that ends here.
    normal_in: [f64; 2],
    /// (radial, axial) unit normal of the piece that begins here.
    normal_out: [f64; 2],
}

fn smooth(r: f64, z: f64, normal: [f64; 2]) -> ProfilePoint {
    ProfilePoint { r, z, normal_in: normal, normal_out: normal }
}

/// Turns a profile, which runs with the outside on its right, about z. A closed profile returns to its first
/// point; an open one begins and ends on the axis.
fn revolve(profile: &[ProfilePoint], segments: usize, closed: bool) -> SurfaceData {
    let mut builder = Builder::default();
    let angle = |j: usize| TAU * j as f64 / segments as f64;
    let rings: Vec<Vec<u32>> = profile
        .iter()
        .map(|point| {
            if point.r == 0.0 {
                return vec![builder.vertex(0.0, 0.0, point.z)];
            }
            (0..segments)
                .map(|j| builder.vertex(point.r * angle(j).cos(), point.r * angle(j).sin(), point.z))
                .collect()
        })
        .collect();
    let pieces = if closed { profile.len() } else { profile.len() - 1 };
    let lengths: Vec<f64> = (0..pieces)
        .map(|i| {
            let (a, b) = (profile[i], profile[(i + 1) % profile.len()]);
            (b.r - a.r).hypot(b.z - a.z)
        })
        .collect();
    let total: f64 = lengths.iter().sum();
    let mut before = 0.0;
    for (i, piece_length) in lengths.iter().enumerate() {
        let next = (i + 1) % profile.len();
        let v = [before / total, (before + piece_length) / total];
        before += piece_length;
        for j in 0..segments {
            let corner = |ring: usize, normal: [f64; 2], v: f64, step: usize| {
                let pole = rings[ring].len() == 1;
                // At a pole the directions of a triangle's two sides meet; it gets the one between them.
                let turn = if pole { j as f64 + 0.5 } else { (j + step) as f64 } / segments as f64;
                let (sin, cos) = (TAU * turn).sin_cos();
                Corner {
                    vertex: if pole { rings[ring][0] } else { rings[ring][(j + step) % segments] },
                    normal: Vector3::new(normal[0] * cos, normal[0] * sin, normal[1]),
                    uv: [turn, v],
                }
            };
            let (from, to) = (profile[i].normal_out, profile[next].normal_in);
            let quad = [
                corner(i, from, v[0], 0),
                corner(i, from, v[0], 1),
                corner(next, to, v[1], 1),
                corner(next, to, v[1], 0),
            ];
            match (rings[i].len() == 1, rings[next].len() == 1) {
                (true, true) => {}
                (true, false) => builder.triangle([quad[0], quad[2], quad[3]]),
                (false, true) => builder.triangle([quad[0], quad[1], quad[2]]),
                (false, false) => builder.quad(quad),
            }
        }
    }
    builder.build()
}

/// A cylinder about z from −`half_height` to `half_height` \[m\].
///
/// # Errors
/// When a length is not positive or the segments are out of range.
pub fn cylinder(radius: f64, half_height: f64, segments: usize) -> Result<SurfaceData, ShapeError> {
    length("radius", radius)?;
    length("half_height", half_height)?;
    check_segments(segments)?;
    let (down, out, up) = ([0.0, -1.0], [1.0, 0.0], [0.0, 1.0]);
    let profile = [
        smooth(0.0, -half_height, down),
        ProfilePoint { r: radius, z: -half_height, normal_in: down, normal_out: out },
        ProfilePoint { r: radius, z: half_height, normal_in: out, normal_out: up },
        smooth(0.0, half_height, up),
    ];
    Ok(revolve(&profile, segments, false))
}

/// A quarter of a circle about (0, `center`), from `from` to `to` \[rad\] above the equator.
fn arc(radius: f64, center: f64, from: f64, to: f64, steps: usize) -> impl Iterator<Item = ProfilePoint> {
    (0..=steps).map(move |k| {
        let latitude = from + (to - from) * k as f64 / steps as f64;
        // On the axis exactly, or the pole would become a ring of coincident vertices.
        let cos = if (latitude.abs() - FRAC_PI_2).abs() < 1e-12 { 0.0 } else { latitude.cos() };
        let sin = latitude.sin();
        smooth(radius * cos, center + radius * sin, [cos, sin])
    })
}

/// A ball about the origin; `rings` segments from the equator to a pole.
///
/// # Errors
/// When the radius is not positive or the segments are out of range.
pub fn sphere(radius: f64, segments: usize, rings: usize) -> Result<SurfaceData, ShapeError> {
    length("radius", radius)?;
    check_segments(segments)?;
    check_segments(rings)?;
    let profile: Vec<ProfilePoint> = arc(radius, 0.0, -FRAC_PI_2, FRAC_PI_2, 2 * rings).collect();
    Ok(revolve(&profile, segments, false))
}

/// A capsule about z: a cylinder of twice `half_height` with hemispherical ends \[m\]; `rings` segments from the
/// equator to a pole.
///
/// # Errors
/// When a length is not positive or the segments are out of range.
pub fn capsule(
    radius: f64,
    half_height: f64,
    segments: usize,
    rings: usize,
) -> Result<SurfaceData, ShapeError> {
    length("radius", radius)?;
    length("half_height", half_height)?;
    check_segments(segments)?;
    check_segments(rings)?;
    let lower = arc(radius, -half_height, -FRAC_PI_2, 0.0, rings);
    let upper = arc(radius, half_height, 0.0, FRAC_PI_2, rings);
    let profile: Vec<ProfilePoint> = lower.chain(upper).collect();
    Ok(revolve(&profile, segments, false))
}

/// A ring about z; `tube_segments` around the tube.
///
/// # Errors
/// When a radius is not positive, the tube fills the hole, or the segments are out of range.
pub fn torus(
    ring_radius: f64,
    tube_radius: f64,
    segments: usize,
    tube_segments: usize,
) -> Result<SurfaceData, ShapeError> {
    length("ring_radius", ring_radius)?;
    length("tube_radius", tube_radius)?;
    check_segments(segments)?;
    check_segments(tube_segments)?;
    if ring_radius <= tube_radius {
        return Err(ShapeError::OutOfRange {
            field: "ring_radius",
            value: ring_radius,
            valid: "above tube_radius",
        });
    }
    let profile: Vec<ProfilePoint> = (0..tube_segments)
        .map(|k| {
            let (sin, cos) = (2.0 * PI * k as f64 / tube_segments as f64).sin_cos();
            smooth(ring_radius + tube_radius * cos, tube_radius * sin, [cos, sin])
        })
        .collect();
    Ok(revolve(&profile, segments, true))
}
