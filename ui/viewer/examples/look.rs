//! A picture of how a scenario begins, its depths, and who is seen where: `look scenario.toml picture.png`.

use std::path::Path;
use std::time::Instant;

use trocar_scene::{RegistryBuilder, Scenario};
use trocar_viewer::{Layout, OffscreenRenderer, Quality, View};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let file = args.next().ok_or("usage: look SCENARIO.toml [PICTURE.png]")?;
    let picture = args.next().unwrap_or_else(|| "look.png".to_owned());
    let mut builder = RegistryBuilder::new();
    trocar_scene::register(&mut builder)?;
    let registry = builder.build();
    // Who acts in it, and with what, is not looked at.
    let scenario = Scenario::load(Path::new(&file), &registry)?;
    let scene = scenario.spawn(&registry)?.snapshot();
    let mut renderer = OffscreenRenderer::new(Some(scenario.folder().to_owned()))?;
    println!("drawn by {}", renderer.gpu().describe());
    let [width, height] = [960_u32, 720];
    let view = View::default_of(&scene, Some(f64::from(width) / f64::from(height)));
    for (name, quality) in [("plain", Quality::PLAIN), ("full", Quality::FULL), ("fine", Quality::FINE)] {
        renderer.quality = quality;
        // The first one compiles what is to be drawn with.
        renderer.picture(&scene, &view, &Layout::Mono, [width, height])?;
        let begun = Instant::now();
        let taken = renderer.picture(&scene, &view, &Layout::Mono, [width, height])?;
        println!("{name}: {:.1} ms", begun.elapsed().as_secs_f64() * 1e3);
        taken.save(Path::new(&picture))?;
    }
    let probe = renderer.probe(&scene, &view, [width, height])?;
    let middle = [width / 2, height / 2];
    let depth = probe.depth[(middle[1] * width + middle[0]) as usize];
    let who = probe.entity(middle[0], middle[1]).map(|entity| scene.name(entity));
    println!("in the middle: {}, {:.0} mm away", who.as_deref().unwrap_or("nothing"), depth * 1e3);
    Ok(())
}
