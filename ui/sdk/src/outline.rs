//! Outlines of the scene's shapes as polylines in world, for vector drawings.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Shape, Snapshot};

/// Most outlines of one scene.
pub const OUTLINES_MAX: usize = 1024;
/// Points of a circle.
const CIRCLE_POINTS: usize = 24;

/// One stroke of a drawing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outline {
    /// The entity it belongs to.
    pub name: String,
    /// Its points in world \[m\], at least two.
    pub points_in_world: Vec<[f64; 3]>,
}

/// Outlines of every entity with a shape, at most [`OUTLINES_MAX`].
pub fn outlines(scene: &Snapshot) -> Vec<Outline> {
    let mut found = Vec::new();
    for (entity, shape) in scene.iter::<Shape>() {
        let world_from_entity = scene.world_pose(entity);
        for stroke in strokes(shape) {
            if found.len() == OUTLINES_MAX {
                return found;
            }
            found.push(Outline {
                name: scene.name(entity),
                points_in_world: placed(&stroke, &world_from_entity),
            });
        }
    }
    found
}

fn placed(stroke: &[Point3<f64>], world_from_entity: &Isometry3<f64>) -> Vec<[f64; 3]> {
    stroke.iter().map(|point| (world_from_entity * point).coords.into()).collect()
}

fn strokes(shape: &Shape) -> Vec<Vec<Point3<f64>>> {
    match shape {
        Shape::Box { half_extents: [x, y, z] } => vec![rectangle(*x, *y, *z), rectangle(*x, *y, -z)],
        Shape::Sphere { radius } => vec![circle(*radius, 0.0, 0.0, 0.0)],
        Shape::Cylinder { radius, half_height } => {
            vec![circle(*radius, 0.0, 0.0, *half_height), circle(*radius, 0.0, 0.0, -half_height)]
        }
        Shape::Capsule { radius, half_height } => {
            let end = half_height + radius;
            vec![
                vec![Point3::new(0.0, 0.0, -end), Point3::new(0.0, 0.0, end)],
                circle(*radius, 0.0, 0.0, 0.0),
            ]
        }
        Shape::Torus { ring_radius, tube_radius } => vec![
            circle(ring_radius + tube_radius, 0.0, 0.0, 0.0),
            circle((ring_radius - tube_radius).max(0.0), 0.0, 0.0, 0.0),
        ],
        Shape::PegBoard { half_extents: [x, y], thickness, pegs, peg_radius, peg_height } => {
            let mut strokes = vec![rectangle(*x, *y, 0.0), rectangle(*x, *y, -thickness)];
            for [px, py] in pegs {
                strokes.push(circle(*peg_radius, *px, *py, *peg_height));
                strokes.push(vec![Point3::new(*px, *py, 0.0), Point3::new(*px, *py, *peg_height)]);
            }
            strokes
        }
    }
}

fn rectangle(x: f64, y: f64, z: f64) -> Vec<Point3<f64>> {
    let corner = |sx: f64, sy: f64| Point3::new(sx * x, sy * y, z);
    vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0), corner(-1.0, -1.0)]
}

fn circle(radius: f64, x: f64, y: f64, z: f64) -> Vec<Point3<f64>> {
    (0..=CIRCLE_POINTS)
        .map(|i| {
            let angle = TAU * i as f64 / CIRCLE_POINTS as f64;
            Point3::new(x + radius * angle.cos(), y + radius * angle.sin(), z)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{Commands, EntityAllocator, Name, Pose, Registry, SimTime, Store};

    #[test]
    fn a_board_is_drawn_where_it_lies_with_its_pegs() {
        let registry = Registry::standard();
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let board = commands.spawn();
        commands.put(board, Name("board.left".to_owned()));
        commands.put(board, Pose::at(-0.04, 0.0, 0.0));
        commands.put(
            board,
            Shape::PegBoard {
                half_extents: [0.05, 0.03],
                thickness: 0.01,
                pegs: vec![[0.01, 0.02]],
                peg_radius: 0.001,
                peg_height: 0.02,
            },
        );
        commands.seal();
        let mut store = Store::new(registry);
        store.apply(&mut commands, SimTime::ZERO);
        let found = outlines(store.view());
        assert_eq!(found.len(), 4);
        let peg = &found[3].points_in_world;
        assert_eq!(found[3].name, "board.left");
        assert!((peg[1][0] + 0.03).abs() < 1e-12 && (peg[1][2] - 0.02).abs() < 1e-12, "{peg:?}");
        for stroke in &found {
            assert!(stroke.points_in_world.len() >= 2);
        }
    }
}
