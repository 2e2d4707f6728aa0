//! What becomes of an exercise when a ring turns slippery in the middle of it, beside what would have become of it.
//! `cargo run --release -p trocar --example slippery`.

use trocar::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut session = Session::builder().seed(7).open("peg-transfer")?;
    session.step(SimTime::from_millis(6_000));
    let ring = session.snapshot().find("ring.1").ok_or("no ring")?;
    let mut slippery = session.branch()?;
    let mut body = session.snapshot().get::<RigidBody>(ring).cloned().ok_or("no body")?;
    body.friction = 0.1;
    slippery.apply(|out| out.put(ring, body))?;
    for future in [&mut session, &mut slippery] {
        future.step(SimTime::from_millis(2_000));
        println!("{:?}", future.task().errors);
    }
    Ok(session.reset()?)
}
