//! What becomes of a ring that turns slippery while it is carried, beside what would have become of it.
//! `cargo run --release -p trocar --example slippery`.

use trocar::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut session = Session::builder().seed(7).open("peg-transfer")?;
    let held = |scene: &Snapshot| scene.iter::<Grasp>().next().map(|(_, grasp)| grasp.held);
    while held(&session.snapshot()).is_none() {
        session.step(SimTime::from_millis(10));
    }
    session.step(SimTime::from_millis(1_000));
    let ring = held(&session.snapshot()).ok_or("it was dropped")?;
    let mut slippery = session.branch()?;
    let mut body = session.snapshot().get::<RigidBody>(ring).cloned().ok_or("no body")?;
    body.friction = 0.0;
    slippery.apply(|out| out.put(ring, body))?;
    for future in [&mut session, &mut slippery] {
        future.step(SimTime::from_millis(500));
        let scene = future.snapshot();
        let height = scene.world_pose(ring).translation.z;
        println!("{}: {:.0} mm high, held: {}", scene.name(ring), height * 1e3, held(&scene) == Some(ring));
    }
    Ok(session.reset()?)
}
