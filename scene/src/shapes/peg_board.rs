//! A board with upright pegs, as one closed body.

use std::f64::consts::TAU;

use nalgebra::{Point2, Vector3};

use super::builder::{Builder, Corner};
use super::{ShapeError, length, segments as check_segments};
use crate::mesh::SurfaceData;
use crate::polygon::triangulate;

/// Dimensions of a peg board whose top face is z = 0. Lengths \[m\].
#[derive(Clone, Debug, PartialEq)]
pub struct PegBoard {
    /// Half edge lengths of the board in x and y.
    pub half_extents: [f64; 2],
    /// Thickness, downwards from z = 0.
    pub thickness: f64,
    /// Foot of each peg (x, y).
    pub pegs: Vec<[f64; 2]>,
    /// Radius of a peg.
    pub peg_radius: f64,
    /// Height of a peg above the top face.
    pub peg_height: f64,
    /// Segments of a peg's circle.
    pub segments: usize,
}

/// The surface of the board and its pegs: one body, whose top face has a hole where each peg stands.
///
/// # Errors
/// When a length is not positive, or pegs overlap each other or the edge.
pub fn peg_board(board: &PegBoard) -> Result<SurfaceData, ShapeError> {
    check(board)?;
    let [hx, hy] = board.half_extents;
    let (n, r) = (board.segments, board.peg_radius);
    let outer = [[-hx, -hy], [hx, -hy], [hx, hy], [-hx, hy]].map(Point2::from);
    let rim = |[x, y]: [f64; 2], k: usize| {
        let (sin, cos) = (TAU * k as f64 / n as f64).sin_cos();
        [x + r * cos, y + r * sin]
    };
    // Holes run clockwise.
    let holes: Vec<Vec<Point2<f64>>> =
        board.pegs.iter().map(|&peg| (0..n).rev().map(|k| Point2::from(rim(peg, k))).collect()).collect();
    let face = triangulate(&outer, &holes)
        .ok_or(ShapeError::Peg { peg: 0, problem: "leaves no room for a top face" })?;

    let mut builder = Builder::default();
    let plan_uv = |x: f64, y: f64| [0.5 + 0.5 * x / hx, 0.5 + 0.5 * y / hy];
    let flat: Vec<Corner> = outer
        .iter()
        .chain(holes.iter().flatten())
        .map(|p| Corner {
            vertex: builder.vertex(p.x, p.y, 0.0),
            normal: Vector3::z(),
            uv: plan_uv(p.x, p.y),
        })
        .collect();
    for triangle in face {
        builder.triangle(triangle.map(|v| flat[v as usize]));
    }
    sides_and_bottom(&mut builder, &outer, board.thickness, &plan_uv);
    for (index, &peg) in board.pegs.iter().enumerate() {
        // The hole's vertices run backwards.
        let foot = |k: usize| (4 + index * n + (n - 1 - k % n)) as u32;
        add_peg(&mut builder, board, peg, foot);
    }
    Ok(builder.build())
}

fn sides_and_bottom(
    builder: &mut Builder,
    outer: &[Point2<f64>; 4],
    thickness: f64,
    plan_uv: &impl Fn(f64, f64) -> [f64; 2],
) {
    let low: Vec<u32> = outer.iter().map(|p| builder.vertex(p.x, p.y, -thickness)).collect();
    for k in 0..4 {
        let next = (k + 1) % 4;
        let along = outer[next] - outer[k];
        let normal = Vector3::new(along.y, -along.x, 0.0).normalize();
        let corner = |vertex: u32, u: f64, v: f64| Corner { vertex, normal, uv: [u, v] };
        builder.quad([
            corner(low[k], 0.0, 0.0),
            corner(low[next], 1.0, 0.0),
            corner(next as u32, 1.0, 1.0),
            corner(k as u32, 0.0, 1.0),
        ]);
    }
    let bottom = [0, 3, 2, 1].map(|k: usize| Corner {
        vertex: low[k],
        normal: -Vector3::z(),
        uv: plan_uv(outer[k].x, outer[k].y),
    });
    builder.quad(bottom);
}

fn add_peg(builder: &mut Builder, board: &PegBoard, [x, y]: [f64; 2], foot: impl Fn(usize) -> u32) {
    let n = board.segments;
    let direction = |k: usize| {
        let (sin, cos) = (TAU * (k % n) as f64 / n as f64).sin_cos();
        Vector3::new(cos, sin, 0.0)
    };
    let head: Vec<u32> = (0..n)
        .map(|k| {
            let d = direction(k) * board.peg_radius;
            builder.vertex(x + d.x, y + d.y, board.peg_height)
        })
        .collect();
    let center = builder.vertex(x, y, board.peg_height);
    for k in 0..n {
        let wall = |vertex: u32, at: usize, v: f64| Corner {
            vertex,
            normal: direction(at),
            uv: [at as f64 / n as f64, v],
        };
        builder.quad([
            wall(foot(k), k, 0.0),
            wall(foot(k + 1), k + 1, 0.0),
            wall(head[(k + 1) % n], k + 1, 1.0),
            wall(head[k], k, 1.0),
        ]);
        let cap = |vertex: u32, d: Vector3<f64>| Corner {
            vertex,
            normal: Vector3::z(),
            uv: [0.5 + 0.5 * d.x, 0.5 + 0.5 * d.y],
        };
        builder.triangle([
            cap(center, Vector3::zeros()),
            cap(head[k], direction(k)),
            cap(head[(k + 1) % n], direction(k + 1)),
        ]);
    }
}

fn check(board: &PegBoard) -> Result<(), ShapeError> {
    board.half_extents.iter().try_for_each(|half| length("half_extents", *half))?;
    length("thickness", board.thickness)?;
    length("peg_radius", board.peg_radius)?;
    length("peg_height", board.peg_height)?;
    check_segments(board.segments)?;
    for (peg, [x, y]) in board.pegs.iter().enumerate() {
        let [hx, hy] = board.half_extents;
        // Written so that a NaN fails.
        if !(x.abs() + board.peg_radius < hx && y.abs() + board.peg_radius < hy) {
            return Err(ShapeError::Peg { peg, problem: "reaches over the edge of the board" });
        }
        let touches = |[ox, oy]: &[f64; 2]| (x - ox).hypot(y - oy) <= 2.0 * board.peg_radius;
        if board.pegs[..peg].iter().any(touches) {
            return Err(ShapeError::Peg { peg, problem: "overlaps an earlier peg" });
        }
    }
    Ok(())
}
