//! A picture of a running session, what is seen in its middle, and how far away.

use trocar::prelude::*;
use trocar_viewer::{Layout, OffscreenRenderer, View};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut session = Session::open("peg-transfer")?;
    session.step(SimTime::from_secs_f64(9.0));
    let scene = session.snapshot();
    let mut renderer = OffscreenRenderer::new(None)?;
    let view = View::named(&scene, "camera", Some(4.0 / 3.0))?;
    renderer.picture(&scene, &view, &Layout::Mono, [960, 720])?.save("peg.png".as_ref())?;
    let seen = renderer.probe(&scene, &view, [960, 720])?;
    let far = seen.depth[360 * 960 + 480];
    println!(
        "in the middle: {:?}, {:.0} mm away",
        seen.entity(480, 360).map(|who| scene.name(who)),
        far * 1e3
    );
    Ok(())
}
