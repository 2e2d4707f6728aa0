//! Peg transfer bench, recognised by its parts: rings are dynamic bodies with a torus shape, pegs are on `peg_board`
//! shapes, and each side has a hand. The exercise and the virtual trainee share this search, so that both use the same
//! parts.

use nalgebra::{Point3, Vector3};
use thiserror::Error;
use trocar_scene::{Entity, Hand, Motion, RigidBody, Shape, Side, Snapshot};

/// Why a scene is not a valid bench.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum BenchError {
    /// There is no ring.
    #[error("the scene has no dynamic body with a torus shape")]
    NoRing,
    /// Rings have different sizes.
    #[error("ring '{0}' differs in size from the first one")]
    RingSize(String),
    /// The number of boards is not two.
    #[error("the scene has {0} peg_board shapes, the exercise needs 2")]
    Boards(usize),
    /// A hand is missing.
    #[error("the scene has no {} hand", .0.as_str())]
    NoHand(Side),
}

/// The rings of a bench, all of one size.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchRings {
    /// In entity order, at least one.
    pub entities: Vec<Entity>,
    /// Radius of the centre line \[m\].
    pub ring_radius: f64,
    /// Radius of the tube \[m\].
    pub tube_radius: f64,
}

/// A peg of a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BenchPeg {
    /// Index of its board: 0 or 1, in entity order.
    pub board: usize,
    /// Its foot on the board's face, in world \[m\].
    pub foot_in_world: Point3<f64>,
    /// Unit direction from foot to head, in world.
    pub axis_in_world: Vector3<f64>,
    /// From foot to head \[m\].
    pub height: f64,
    /// Its radius \[m\].
    pub radius: f64,
}

/// The rings.
///
/// # Errors
/// When there are none, or of several sizes.
pub fn find_rings(scene: &Snapshot) -> Result<BenchRings, BenchError> {
    let moves = |entity| scene.get::<RigidBody>(entity).is_some_and(|body| body.motion == Motion::Dynamic);
    let mut found: Option<BenchRings> = None;
    for (entity, shape) in scene.iter::<Shape>() {
        let Shape::Torus { ring_radius, tube_radius } = *shape else { continue };
        if !moves(entity) {
            continue;
        }
        let rings =
            found.get_or_insert_with(|| BenchRings { entities: Vec::new(), ring_radius, tube_radius });
        if (rings.ring_radius, rings.tube_radius) != (ring_radius, tube_radius) {
            return Err(BenchError::RingSize(scene.name(entity)));
        }
        rings.entities.push(entity);
    }
    found.ok_or(BenchError::NoRing)
}

/// The pegs of the two boards, board by board.
///
/// # Errors
/// When there are not two boards.
pub fn find_pegs(scene: &Snapshot) -> Result<Vec<BenchPeg>, BenchError> {
    let mut found = Vec::new();
    let mut boards = 0;
    for (entity, shape) in scene.iter::<Shape>() {
        let Shape::PegBoard { pegs, peg_radius, peg_height, .. } = shape else { continue };
        let world_from_board = scene.world_pose(entity);
        found.extend(pegs.iter().map(|[x, y]| BenchPeg {
            board: boards,
            foot_in_world: world_from_board * Point3::new(*x, *y, 0.0),
            axis_in_world: world_from_board.rotation * Vector3::z(),
            height: *peg_height,
            radius: *peg_radius,
        }));
        boards += 1;
    }
    if boards == 2 { Ok(found) } else { Err(BenchError::Boards(boards)) }
}

/// The hand of a side, with its component.
///
/// # Errors
/// When there is none.
pub fn find_hand(scene: &Snapshot, side: Side) -> Result<(Entity, &Hand), BenchError> {
    scene.iter::<Hand>().find(|(_, hand)| hand.side == side).ok_or(BenchError::NoHand(side))
}
