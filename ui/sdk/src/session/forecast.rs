//! What a scenario asks for that its methods cannot bear, told before it starts.
//!
//! For each rigid body that lies above a soft one the static depth is estimated: that of a ball on a half-space (Sneddon
//! 1965) or of a flat punch (Boussinesq, in Johnson, *Contact Mechanics*, 1985, §3.4), and the compression of the column
//! below it. A soft volume that stands on its anchors and that its own weight makes fold is told as well.

use nalgebra::{Point3, Vector3};
use trocar_engine::EngineSoftBody;
use trocar_scene::{Anchors, Entity, Motion, RigidBody, Scenario, Shape, Snapshot, TetMesh, VertexPositions};
use trocar_simulator::controller::{DynamicFemBody, LinearFemBody, MassSpringBody, XpbdBody};

/// Share of a body's thickness down to which it bears what lies on it.
const DEPTH_SHARE: f64 = 0.3;
/// The same in cells for networks of springs: deeper, a body lies more than a quarter deeper than on a continuum, and the
/// network leans aside with it.
const DEPTH_CELLS: f64 = 0.25;
/// Lowest Young's modulus of a volume that stands on its anchors, over the pressure of its weight on them: softer springs
/// sag by a quarter more than a continuum and lean aside; by other methods softer volumes buckle.
const WEIGHTS_OF_SPRINGS: f64 = 10.0;
const WEIGHTS: f64 = 3.0;
/// Lowest rate of a controller of rigid bodies that soft ones bear \[Hz\].
const RIGID_HZ: f64 = 50.0;

/// A soft volume.
struct Soft {
    entity: Entity,
    young_modulus: f64,
    poisson_ratio: f64,
    /// \[kg/m³\]; 0 where its weight is left out.
    density: f64,
    /// Whether it is of springs.
    folds: bool,
}

/// The box of an entity's vertices or shape, in world \[m\]; `None` for an entity without extent.
fn bounds(scene: &Snapshot, entity: Entity) -> Option<[Point3<f64>; 2]> {
    let pose = scene.world_pose(entity);
    let places: Vec<Point3<f64>> = match (scene.get::<VertexPositions>(entity), scene.get::<Shape>(entity)) {
        (Some(vertices), _) => vertices.positions.iter().map(|at| pose * at).collect(),
        (None, Some(shape)) => {
            let half = match *shape {
                Shape::Box { half_extents } => half_extents,
                Shape::Sphere { radius } => [radius; 3],
                Shape::Cylinder { radius, half_height } => [radius, radius, half_height],
                Shape::Capsule { radius, half_height } => [radius, radius, half_height + radius],
                _ => return None,
            };
            let corner = |k: u32| {
                Point3::from(Vector3::from_fn(|i, _| if k >> i & 1 == 0 { -half[i] } else { half[i] }))
            };
            (0..8).map(|k| pose * corner(k)).collect()
        }
        _ => return None,
    };
    let first = *places.first()?;
    Some(places.iter().fold([first; 2], |[low, high], at| [low.inf(at), high.sup(at)]))
}

/// The soft volumes of a scene.
fn softs(scene: &Snapshot) -> Vec<Soft> {
    let mut softs = Vec::new();
    let mut add = |entity, [young_modulus, poisson_ratio]: [f64; 2], density, folds| {
        softs.push(Soft { entity, young_modulus, poisson_ratio, density, folds });
    };
    for (entity, of) in scene.iter::<DynamicFemBody>() {
        add(entity, [of.young_modulus, of.poisson_ratio], of.density, false);
    }
    for (entity, of) in scene.iter::<LinearFemBody>() {
        add(entity, [of.young_modulus, of.poisson_ratio], 0.0, false);
    }
    for (entity, of) in scene.iter::<EngineSoftBody>() {
        add(entity, [of.young_modulus, of.poisson_ratio], of.density, false);
    }
    for (entity, of) in scene.iter::<XpbdBody>() {
        if let (Some(elastic), Some(density)) = (of.volume(), of.volume_density()) {
            add(entity, elastic, density, false);
        }
    }
    for (entity, of) in scene.iter::<MassSpringBody>() {
        if let (Some(young_modulus), Some(density)) = (of.volume(), of.volume_density()) {
            // Springs of a volume are a continuum with this ratio (Van Gelder 1998).
            add(entity, [young_modulus, 0.25], density, true);
        }
    }
    softs
}

/// How high a soft body stands above its highest anchor \[m\]; 0 without anchors.
fn stands(scene: &Snapshot, entity: Entity) -> f64 {
    let (Some(anchors), Some(vertices)) =
        (scene.get::<Anchors>(entity), scene.get::<VertexPositions>(entity))
    else {
        return 0.0;
    };
    let pose = scene.world_pose(entity);
    let (mut top, mut held) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
    for at in vertices.positions.iter() {
        let height = (pose * at).z;
        top = top.max(height);
        if anchors.hold(at) {
            held = held.max(height);
        }
    }
    if held.is_finite() { top - held } else { 0.0 }
}

/// What a soft body that folds under its own weight is told.
fn folds(scene: &Snapshot, of: &Soft, gravity: f64) -> Option<String> {
    let pressure = of.density * gravity * stands(scene, of.entity);
    let least = pressure * if of.folds { WEIGHTS_OF_SPRINGS } else { WEIGHTS };
    (of.young_modulus < least).then(|| {
        format!(
            "{}: on its anchors it would fold under its own weight, which presses with {:.0} Pa: take a young_modulus of \
             {:.0} Pa or more, a smaller density, a lower body{}",
            scene.name(of.entity),
            pressure,
            least.ceil(),
            if of.folds { ", or 'dynamic_fem'" } else { "" },
        )
    })
}

/// Estimated static depth of a rigid body on a soft one \[m\].
fn depth(force: f64, rigid: &[Point3<f64>; 2], is_round: bool, soft: &[Point3<f64>; 2], of: &Soft) -> f64 {
    let plane_modulus = of.young_modulus / (1.0 - of.poisson_ratio * of.poisson_ratio);
    let (size, wide) = (rigid[1] - rigid[0], soft[1] - soft[0]);
    let radius = 0.5 * size.x.min(size.y);
    if is_round {
        return depth_of_ball(force / plane_modulus, radius);
    }
    let punch = force / (2.0 * radius * plane_modulus);
    let area = size.x.min(wide.x) * size.y.min(wide.y);
    let column = force * wide.z / (of.young_modulus * area);
    // Under a wide body it is the column that yields, under a narrow one the half-space.
    punch.min(column)
}

/// Depth of a ball of this radius in a half-space \[m\], for its force over the plane strain modulus \[m²\]: Sneddon (1965,
/// *The relation between load and penetration…*), which is Hertz's for small depths and goes on beyond.
fn depth_of_ball(force: f64, radius: f64) -> f64 {
    // By the radius of contact over the ball's: the force grows with it, without bound towards 1.
    let log = |a: f64| ((1.0 + a) / (1.0 - a)).ln();
    let force_of = |a: f64| radius * radius * (0.5 * (a * a + 1.0) * log(a) - a);
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        *if force_of(middle) < force { &mut low } else { &mut high } = middle;
    }
    0.5 * radius * low * log(low)
}

/// Warnings about a scenario at its beginning, one sentence each with the remedy.
#[must_use]
pub fn forecast(scene: &Snapshot, scenario: &Scenario) -> Vec<String> {
    let gravity = scenario.gravity_in_world;
    let softs = softs(scene);
    let mut told = Vec::new();
    let moving: Vec<(Entity, &RigidBody)> =
        scene.iter::<RigidBody>().filter(|(_, body)| body.motion == Motion::Dynamic).collect();
    // The weight acts along −z; scenarios with another direction are not estimated.
    if gravity.z < 0.0 && gravity.xy().norm() < 0.1 * gravity.norm() {
        let mut softs = softs;
        // Told once: what lies on such a body is not estimated.
        softs.retain(|of| {
            let fold = folds(scene, of, gravity.norm());
            let stands = fold.is_none();
            told.extend(fold);
            stands
        });
        for (entity, body) in &moving {
            let Some(rigid) = bounds(scene, *entity) else { continue };
            let size = rigid[1] - rigid[0];
            let is_round = (size.max() - size.min()) < 0.1 * size.max();
            let mut warned = false;
            for of in &softs {
                let Some(soft) = bounds(scene, of.entity) else { continue };
                let is_above = (0..2).all(|k| rigid[0][k] < soft[1][k] && rigid[1][k] > soft[0][k])
                    && rigid[0].z > 0.5 * (soft[0].z + soft[1].z);
                if !is_above || warned {
                    continue;
                }
                let thickness = soft[1].z - soft[0].z;
                let found = depth(body.mass * gravity.norm(), &rigid, is_round, &soft, of);
                let cell = if of.folds { cell(scene, of.entity) } else { f64::INFINITY };
                let most = (DEPTH_SHARE * thickness).min(DEPTH_CELLS * cell);
                if found > most {
                    warned = true;
                    told.push(format!(
                        "{}: on {} it would sink in by about {:.1} mm, and {} bears it down to {:.1} mm ({}): take a \
                         stiffer body (young_modulus), a lighter mass, a larger support{}",
                        scene.name(*entity),
                        scene.name(of.entity),
                        1e3 * found,
                        scene.name(of.entity),
                        1e3 * most,
                        if of.folds && DEPTH_CELLS * cell < DEPTH_SHARE * thickness {
                            "a quarter of its cells"
                        } else {
                            "30 % of its thickness"
                        },
                        if of.folds { ", or 'dynamic_fem'" } else { "" },
                    ));
                }
            }
        }
    }
    for entry in scenario.controllers.iter().filter(|_| !moving.is_empty()) {
        if matches!(entry.kind.as_str(), "rapier" | "rigid-bodies") && entry.rate_hz < RIGID_HZ {
            told.push(format!(
                "{}: at {} Hz soft bodies do not bear its bodies reliably: take {RIGID_HZ} Hz or more",
                entry.name, entry.rate_hz
            ));
        }
    }
    told
}

/// Mean edge of a volume's cells \[m\].
fn cell(scene: &Snapshot, entity: Entity) -> f64 {
    let (Some(mesh), Some(vertices)) = (scene.get::<TetMesh>(entity), scene.get::<VertexPositions>(entity))
    else {
        return f64::INFINITY;
    };
    let volume: f64 = mesh
        .tets
        .iter()
        .map(|tet| {
            let [a, b, c, d] = tet.map(|node| vertices.positions[node as usize]);
            (b - a).cross(&(c - a)).dot(&(d - a)).abs() / 6.0
        })
        .sum();
    // Five to six tetrahedra fill a cube.
    (volume / mesh.tets.len().max(1) as f64 * 5.5).cbrt()
}

#[cfg(test)]
mod tests {
    use super::depth_of_ball;

    #[test]
    fn a_ball_sinks_in_as_hertz_says_and_beyond_as_sneddon_says() {
        let hertz = |force: f64, radius: f64| (0.75 * force / radius.sqrt()).powf(2.0 / 3.0);
        for force in [1e-9, 1e-7, 1e-6] {
            assert!((depth_of_ball(force, 0.012) / hertz(force, 0.012) - 1.0).abs() < 0.01, "{force}");
        }
        // At 0.9 of the radius: 1.765 R² and 0.45 ln 19 R.
        let depth = depth_of_ball(1.7648 * 1.44e-4, 0.012);
        assert!((depth / (0.45 * 19.0_f64.ln() * 0.012) - 1.0).abs() < 1e-3, "{depth}");
        assert!(depth_of_ball(1.0, 0.012).is_finite());
    }
}
