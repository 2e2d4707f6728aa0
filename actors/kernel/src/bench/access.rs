//! Read benchmark: loads the latest snapshot and one component of a random entity.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use arc_swap::ArcSwap;
use trocar_scene::{Entity, Pose};

use super::scene::populated;
use super::{Better, Effort, Row, median_and_spread};

/// Reads in a row without looking at the clock.
const READS: usize = 4_096;

/// ns per `load` + `get::<Pose>` of a random entity.
fn block(published: &ArcSwap<trocar_scene::Snapshot>, order: &[Entity]) -> f64 {
    let begun = Instant::now();
    let mut sum = 0.0;
    for entity in order {
        let scene = published.load();
        sum += scene.get::<Pose>(*entity).map_or(0.0, |pose| pose.translation.x);
    }
    black_box(sum);
    begun.elapsed().as_nanos() as f64 / order.len() as f64
}

/// At 100 and at 10,000 populated entities.
pub(super) fn get(effort: Effort) -> Vec<Row> {
    let (blocks, repeats) = match effort {
        Effort::Smoke => (3, 5),
        Effort::Full => (15, 40),
    };
    let scenes: Vec<_> = [100, 10_000]
        .into_iter()
        .map(|entities| {
            let (store, all) = populated(entities);
            let mut state = 1_u64;
            let order: Vec<Entity> = (0..READS)
                .map(|_| {
                    // Knuth's MMIX generator: the high bits are random enough to defeat the prefetcher.
                    state =
                        state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                    all[(state >> 33) as usize % all.len()]
                })
                .collect();
            (ArcSwap::new(Arc::new(store.snapshot())), order, Vec::new())
        })
        .collect();
    let mut scenes = scenes;
    for _ in 0..blocks {
        for (published, order, results) in &mut scenes {
            // The best of a few repeats, because interruptions of a block are not the cost of reading.
            let best = (0..repeats).map(|_| block(published, order)).fold(f64::MAX, f64::min);
            results.push(best);
        }
    }
    let (small, large) = (median_and_spread(&scenes[0].2), median_and_spread(&scenes[1].2));
    vec![
        Row::on_value("snapshot_get_100_entities", "ns", small, Some(60.0), Better::Lower),
        Row::on_ratio("snapshot_get_10000_entities", "ns", large, small.0, Some(1.5), Better::Lower),
    ]
}
