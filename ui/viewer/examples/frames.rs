//! What frames of a generated scene cost beside a bare loop, and pictures of them:
//! `cargo run --release -p trocar-viewer --example frames -- [TRIANGLES] [WIDTHxHEIGHT] [FOLDER]`.

use std::cell::RefCell;
use std::path::Path;

use trocar_viewer::bench::{BenchRenderer, in_turns};
use trocar_viewer::layout::Stereo;
use trocar_viewer::{Layout, Quality};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let triangles = args.next().map_or(Ok(20_000), |text| text.parse())?;
    let size = args.next().unwrap_or_else(|| "800x600".into());
    let (width, height) = size.split_once('x').ok_or("a size is WIDTHxHEIGHT")?;
    let bench_renderer = RefCell::new(BenchRenderer::new(triangles, [width.parse()?, height.parse()?])?);
    println!("drawn by {}", bench_renderer.borrow().gpu().describe());
    let (mono, stereo) = (&Layout::Mono, &Layout::SideBySide(Stereo::default()));
    let kinds = [
        ("plain", mono, Quality::PLAIN),
        ("full", mono, Quality::FULL),
        ("full, no shadows", mono, Quality { shadows: false, ..Quality::FULL }),
        ("full, no maps", mono, Quality { maps: false, ..Quality::FULL }),
        ("fine", mono, Quality::FINE),
        ("plain, two eyes", stereo, Quality::PLAIN),
        ("full, two eyes", stereo, Quality::FULL),
    ];
    let mut bare = || bench_renderer.borrow_mut().bare_frame();
    let mut frames: Vec<_> = kinds
        .iter()
        .map(|(_, layout, quality)| || bench_renderer.borrow_mut().frame(layout, *quality))
        .collect();
    let mut contestants: Vec<&mut dyn FnMut()> = vec![&mut bare];
    contestants.extend(frames.iter_mut().map(|frame| frame as &mut dyn FnMut()));
    let times = in_turns(9, 3, &mut contestants);
    let median = |times: &[f64]| {
        let mut times = times.to_vec();
        times.sort_by(f64::total_cmp);
        times[times.len() / 2] * 1e3
    };
    let floor = median(&times[0]);
    let names = ["bare"].into_iter().chain(kinds.iter().map(|(name, _, _)| *name));
    for (name, times) in names.zip(&times) {
        println!("{name:>18}: {:8.2} ms, {:5.2} × bare", median(times), median(times) / floor);
    }
    if let Some(folder) = args.next() {
        for (name, layout, quality) in &kinds {
            bench_renderer.borrow_mut().frame(layout, *quality);
            bench_renderer.borrow().picture()?.save(&Path::new(&folder).join(format!("{name}.png")))?;
        }
    }
    Ok(())
}
