//! Lights of a scene, their shadow projections, and the exposure of the picture.

use nalgebra::{Isometry3, Matrix4, Perspective3, Point3, Vector3};
use trocar_scene::{Light, Snapshot};

use crate::view::View;

/// Most active lights; further ones are left out, the weakest first.
pub const LIGHTS_MAX: usize = 8;
/// Most lights with shadows.
pub const SHADOWS_MAX: usize = 2;
/// Exposed brightness of a white surface in the middle of the view, before the tone curve.
const KEY: f64 = 1.5;
/// Softness of a cone's edge, as a share of its half angle.
const SOFT_EDGE: f64 = 0.25;
/// Near and far plane of a shadow projection \[m\].
const SHADOW_NEAR: f64 = 0.01;
const SHADOW_FAR: f64 = 1.5;

/// A light, resolved for rendering.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shining {
    /// Position \[m\].
    pub position_in_world: Point3<f64>,
    /// Axis, of unit length.
    pub direction_in_world: Vector3<f64>,
    /// Luminous intensity per channel \[cd\].
    pub candela: Vector3<f64>,
    /// Cosines of the outer and inner angle between which the cone's edge fades.
    pub cone: [f64; 2],
    /// Layer of its shadow map, and that map's `clip_from_world`.
    pub shadow: Option<(usize, Matrix4<f64>)>,
}

impl Shining {
    /// Illuminance of a surface at a point that faces the light \[lx\].
    fn illuminance(&self, point: &Point3<f64>) -> f64 {
        let to_point = point - self.position_in_world;
        let distance = to_point.norm().max(1e-4);
        let cosine = to_point.dot(&self.direction_in_world) / distance;
        let [outer, inner] = self.cone;
        let edge = ((cosine - outer) / (inner - outer).max(1e-6)).clamp(0.0, 1.0);
        self.candela.sum() / 3.0 * edge / (distance * distance)
    }
}

/// The active lights of the scene, the strongest first. A scene without lights is lit from beside the eye.
pub fn shining(scene: &Snapshot, view: &View) -> Vec<Shining> {
    let mut lights: Vec<Shining> = Vec::new();
    for (entity, light) in scene.iter::<Light>() {
        lights.push(shine(&scene.world_pose(entity), light));
    }
    if lights.is_empty() {
        lights.push(shine(
            &view.world_from_eye,
            &Light { cone_angle: 1.2, shadows: false, ..Light::default() },
        ));
    }
    // Stable sort: equal lights stay in the order of entities.
    lights.sort_by(|a, b| b.candela.sum().total_cmp(&a.candela.sum()));
    lights.truncate(LIGHTS_MAX);
    let mut layer = 0;
    for light in &mut lights {
        if light.shadow.is_some() && layer < SHADOWS_MAX {
            light.shadow = light.shadow.map(|(_, clip_from_world)| (layer, clip_from_world));
            layer += 1;
        } else {
            light.shadow = None;
        }
    }
    lights
}

fn shine(world_from_light: &Isometry3<f64>, light: &Light) -> Shining {
    let half = light.cone_angle.clamp(0.01, std::f64::consts::PI);
    let throws = light.shadows && half < 1.4;
    let shadow = throws.then(|| (0, shadow_clip_from_world(world_from_light, half)));
    let cone = if half >= 3.0 { [-2.0, -1.5] } else { [half.cos(), (half * (1.0 - SOFT_EDGE)).cos()] };
    Shining {
        position_in_world: Point3::from(world_from_light.translation.vector),
        direction_in_world: world_from_light * Vector3::z(),
        candela: Vector3::from(light.color) * light.intensity,
        cone,
        shadow,
    }
}

/// The light's shadow projection from world to clip space: depth 0 to 1, x and y from −1 to 1.
fn shadow_clip_from_world(world_from_light: &Isometry3<f64>, half_angle: f64) -> Matrix4<f64> {
    let perspective = Perspective3::new(1.0, 2.0 * half_angle, SHADOW_NEAR, SHADOW_FAR);
    // nalgebra looks along −z and gives depths from −1 to 1.
    let turned = Matrix4::new_nonuniform_scaling(&Vector3::new(1.0, -1.0, -1.0));
    let half_depth = Matrix4::new_translation(&Vector3::new(0.0, 0.0, 0.5))
        * Matrix4::new_nonuniform_scaling(&Vector3::new(1.0, 1.0, 0.5));
    half_depth * perspective.to_homogeneous() * turned * world_from_light.inverse().to_homogeneous()
}

/// The exposure factor, like the automatic gain of a laparoscope's camera: a white surface at `focus` that faces the
/// lights appears bright, whatever their strength.
pub fn exposure(lights: &[Shining], focus: &Point3<f64>) -> f64 {
    let illuminance: f64 = lights.iter().map(|light| light.illuminance(focus)).sum();
    KEY * std::f64::consts::PI / illuminance.max(1e-3)
}
