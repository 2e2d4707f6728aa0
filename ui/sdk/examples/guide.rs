//! A virtual fixture that draws a hand to a point: `cargo run --release -p trocar --example guide`.

use trocar::prelude::*;

/// Draws a hand to the middle of the plate.
struct Guide(Entity);
impl Controller for Guide {
    fn access(&self) -> Access {
        Access::new().writes::<VirtualFixture>(EntitySet::Of(vec![self.0]))
    }
    fn tick(&mut self, tick: &Tick, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let there =
            VirtualFixture { stiffness: 50.0, damping: 1.0, at: tick.time, ..VirtualFixture::default() };
        out.put(self.0, there);
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let app = App::new().controller_with("guide", |(): &(), context: &BuildContext| {
        let hand = context.scene.find("hand.right");
        Ok(Guide(hand.ok_or_else(|| ControllerError::Scene("no right hand".into()))?))
    });
    let app = app.joins("guide", 100.0);
    let mut session = Session::builder().app(&app).open("wall")?;
    for _ in 0..5 {
        session.step(SimTime::from_millis(200));
        for (_, force) in session.snapshot().iter::<DeviceForce>() {
            println!("{:.1} s: {:.2} N", session.now().as_secs_f64(), force.force.norm());
        }
    }
    Ok(())
}
