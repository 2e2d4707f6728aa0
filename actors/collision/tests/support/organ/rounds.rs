//! Rounds of a hand about an organ, for timing: what is asked at each step, worked out beforehand.

use nalgebra::{Point3, Vector3};
use trocar_collision::Surface;
use trocar_collision::finger_proxy::{FingerProxy, ProxyConfig};
use trocar_collision::moving_surface::MovingSurface;

use super::Organ;

/// Speed of a hand times a period of 1 ms \[m\].
pub const STEP: f64 = 1e-4;

/// An organ at rest.
pub fn organ(triangles: usize) -> MovingSurface {
    let organ = Organ::with_triangles(triangles);
    let (vertices, triangles) = (organ.vertices(0.0), organ.triangles());
    MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"))
}

/// A shaft that lies across the organ and is drawn over it, no end of it more than 0.1 mm at a step, so that it touches
/// nearly always: it is let down onto the surface and lifted as that rises.
pub fn shafts(mesh: &MovingSurface, count: usize, length: f64) -> Vec<[Point3<f64>; 2]> {
    let along = Vector3::new(0.8, 0.6, 0.0) * (0.5 * length);
    let mut height = 0.03;
    let mut path = Vec::with_capacity(count);
    let mut touched = false;
    while path.len() < count {
        let turn = 0.7 * STEP / 0.05 * path.len() as f64;
        let middle = Point3::new(0.05 * turn.cos(), 0.05 * turn.sin(), 0.0);
        let at = |height: f64| [middle - along, middle + along].map(|end| end + Vector3::z() * height);
        let found = mesh.tree().nearest_to_segment(&mesh.surface(), &at(height), f64::INFINITY);
        let off = found.ok().flatten().map_or(0.0, |found| found.distance) - 0.0015;
        height -= off.clamp(-0.7 * STEP, 0.7 * STEP);
        touched |= off < 1e-4;
        if touched {
            path.push(at(height));
        }
    }
    path
}

/// Places of a device that is drawn over the organ's surface, 2 to 4 mm behind it, 0.1 mm at a step.
pub fn devices(mesh: &MovingSurface, count: usize) -> Vec<Point3<f64>> {
    // A proxy that is drawn along shows where the surface is.
    let mut guide = FingerProxy::new(ProxyConfig::default()).expect("a valid proxy");
    let mut device = Point3::new(0.07, 0.0, 0.03);
    guide.step(mesh, &device, 0.001).expect("a finite device");
    let mut heading = Vector3::new(0.3, 1.0, 0.1).normalize();
    let mut path = Vec::with_capacity(count);
    for step in 0..count + 600 {
        let place = guide.position();
        let normal = guide.contacts().next().map_or(-Vector3::z(), |contact| contact.normal);
        if step % 700 == 699 {
            heading = Vector3::new((step as f64).sin(), (1.7 * step as f64).cos(), 0.3 * (step as f64).cos());
        }
        let tangent = heading - normal * normal.dot(&heading);
        let wanted = if guide.contacts().next().is_some() {
            place + tangent.normalize() * STEP - normal * (0.003 + 0.001 * (0.01 * step as f64).sin())
        } else {
            device - Vector3::z() * STEP
        };
        let motion = wanted - device;
        device += motion * (2.0 * STEP / motion.norm().max(2.0 * STEP));
        guide.step(mesh, &device, 0.001).expect("a finite device");
        path.push(device);
    }
    path.split_off(600)
}
