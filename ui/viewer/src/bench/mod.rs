//! What frames cost: a generated scene, a bare loop that draws the same triangles, and how both are timed.
//!
//! On a shared machine a time alone says little, so every figure is measured beside another in the same run: a block of
//! frames of each, in turns.

mod baseline;
mod harness;
mod test_scene;

use std::time::Instant;

pub use baseline::Bare;
pub use harness::{Studio, Upload};
pub use test_scene::Theatre;

/// Times of blocks in turns: `blocks` times a block of `frames` frames of each contestant, after one block that is not
/// counted. Gives the median frame of every block \[s\], a list for each contestant.
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
