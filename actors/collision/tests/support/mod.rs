//! What tests, benches and examples share, and the reference data, read.
#![allow(dead_code, reason = "benches and examples use a part of it")]

pub mod cuboid;
pub mod organ;
pub mod shapes;
pub mod surfaces;

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion};

/// Vertices and triangles.
pub struct Mesh {
    pub vertices: Vec<Point3<f64>>,
    pub triangles: Vec<[u32; 3]>,
}

/// What a pose is expected to give.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    pub hit: bool,
    pub pairs: usize,
    pub distance: f64,
}

pub fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn read(name: &str) -> String {
    std::fs::read_to_string(data(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

fn numbers(line: &str) -> Vec<f64> {
    line.split(',').map(|number| number.trim().parse().expect("a number")).collect()
}

pub fn mesh(name: &str) -> Mesh {
    let mut mesh = Mesh { vertices: Vec::new(), triangles: Vec::new() };
    for line in read(&format!("bumpy_{name}.obj")).lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let mut next = || words.next().expect("a coordinate").parse().expect("a number");
                mesh.vertices.push(Point3::new(next(), next(), next()));
            }
            Some("f") => {
                let mut next = || words.next().expect("a corner").parse::<u32>().expect("a number") - 1;
                mesh.triangles.push([next(), next(), next()]);
            }
            _ => {}
        }
    }
    mesh
}

pub fn poses() -> Vec<Isometry3<f64>> {
    read("poses.csv")
        .lines()
        .map(|line| {
            let n = numbers(line);
            let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&n[..9]));
            let translation = Translation3::new(n[9], n[10], n[11]);
            Isometry3::from_parts(translation, UnitQuaternion::from_rotation_matrix(&rotation))
        })
        .collect()
}

pub fn expected(name: &str) -> Vec<Expected> {
    let lines = read(&format!("expected_{name}.csv"));
    let lines = lines.lines().filter(|line| !line.starts_with('#'));
    lines
        .map(|line| {
            let n = numbers(line);
            Expected { hit: n[0] > 0.5, pairs: n[1] as usize, distance: n[2] }
        })
        .collect()
}

/// Poses of a second mesh that comes, slides past at a small distance and goes: steps of a few tenths of a thousandth
/// of the mesh, as between frames.
pub fn path(frames: u32) -> Vec<Isometry3<f64>> {
    (0..frames)
        .map(|frame| {
            let along = f64::from(frame) / f64::from(frames);
            let shift = Translation3::new(2.2, 0.4 * along - 0.2, 0.1 * along);
            Isometry3::from_parts(shift, UnitQuaternion::from_euler_angles(0.0, 0.0, 0.4 * along))
        })
        .collect()
}
