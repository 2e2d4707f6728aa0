//! Frame-time benchmarks: a generated scene, a bare loop that draws the same triangles, and their timing.
//!
//! On a shared machine a time alone says little, so every figure is measured beside another in the same run, in
//! alternating blocks of frames.

mod baseline;
mod harness;
mod test_scene;

use std::time::Instant;

pub use baseline::BaselineRenderer;
pub use harness::{BenchRenderer, Upload};
pub use test_scene::TestScene;

/// Times alternating blocks: `blocks` times a block of `frames` frames of each contestant, after one warm-up block.
/// Returns the median frame time of every block \[s\], a list for each contestant.
pub fn in_turns(blocks: usize, frames: usize, contestants: &mut [&mut dyn FnMut()]) -> Vec<Vec<f64>> {
    let mut medians = vec![Vec::with_capacity(blocks); contestants.len()];
    let mut times = Vec::with_capacity(frames);
    for block in 0..=blocks {
        for (contestant, medians) in contestants.iter_mut().zip(&mut medians) {
            times.clear();
            for _ in 0..frames {
                let begun = Instant::now();
                contestant();
                times.push(begun.elapsed().as_secs_f64());
            }
            times.sort_by(f64::total_cmp);
            // The first block compiles pipelines and fills caches.
            if block > 0 {
                medians.extend(times.get(times.len() / 2));
            }
        }
    }
    medians
}
