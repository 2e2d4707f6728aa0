//! A warmed query asks for no memory: the refit of a surface, a shaft and a proxy, step after step.

use crate::support::organ::Organ;
use crate::support::organ::rounds::{devices, organ as organ_of, shafts};
use trocar_collision::Surface;
use trocar_collision::dynamic_point::{DynamicPoint, LineConfig};
use trocar_collision::finger_proxy::{FingerProxy, ProxyConfig};
use trocar_test_support::allocations::calls;

#[test]
fn a_step_of_shaft_and_proxy_and_a_refit_ask_for_no_memory_once_warm() {
    let shape = Organ::with_triangles(2_000);
    let mut mesh = organ_of(2_000);
    let (shafts, devices) = (shafts(&mesh, 600, 0.1), devices(&mesh, 600));
    let frames: Vec<_> = (0..10).map(|frame| shape.vertices(0.01 * f64::from(frame))).collect();
    let triangles = shape.triangles();
    let mut line =
        DynamicPoint::new(LineConfig { segments: 4, radius: 0.0025, margin: 0.001 }).expect("a valid line");
    let mut finger = FingerProxy::new(ProxyConfig::default()).expect("a valid proxy");
    let mut round = |touches: &mut u64| {
        for (step, (shaft, device)) in shafts.iter().zip(&devices).enumerate() {
            let turn = step / 10 % (2 * frames.len());
            let vertices = &frames[turn.min(2 * frames.len() - 1 - turn)];
            if step % 10 == 0 {
                let now = Surface::new(vertices, &triangles).expect("a surface");
                mesh.update(&now, 0.01).expect("a time");
            }
            let contacts = line.update(&mesh, shaft).expect("a finite shaft");
            *touches += contacts.iter().flatten().count() as u64;
            finger.step(&mesh, device, 0.001).expect("a finite device");
            *touches += finger.contacts().count() as u64;
        }
    };
    let mut touches = 0;
    round(&mut touches);
    round(&mut touches);
    let (before, _) = calls();
    round(&mut touches);
    let (after, _) = calls();
    assert_eq!(after - before, 0);
    assert!(before > 0, "the allocator does not count");
    assert!(touches > 1_000, "{touches}");
}
