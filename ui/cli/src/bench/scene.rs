//! Reads of the scene: the latest snapshot, and a component of a random entity.

use std::hint::black_box;
use std::time::Instant;

use arc_swap::ArcSwap;
use trocar::summary::{BenchResult, Better};
use trocar_scene::{Commands, Entity, EntityAllocator, Name, Pose, Registry, SimTime, Store, Velocity};

use super::blocks::{interleaved, median};
use crate::failure::Failure;

const BLOCKS: usize = 15;
const READS: usize = 200_000;

/// A scene in which every entity has three components.
fn populated(entities: usize) -> (Store, Vec<Entity>) {
    let registry = Registry::of_the_field();
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 1));
    let all: Vec<Entity> = (0..entities).map(|_| commands.spawn()).collect();
    for (i, entity) in all.iter().enumerate() {
        commands.put(*entity, Pose::at(i as f64, 0.0, 0.0));
        commands.put(*entity, Velocity::default());
        commands.put(*entity, Name(format!("entity {i}")));
    }
    commands.seal();
    let mut store = Store::new(registry);
    store.apply(&mut commands, SimTime::ZERO);
    (store, all)
}

/// Entities in an order without a pattern (a linear congruential generator), for every block the same.
fn shuffled(all: &[Entity]) -> Vec<Entity> {
    let mut state = 12_345_u64;
    (0..READS)
        .map(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            all[(state >> 33) as usize % all.len()]
        })
        .collect()
}

/// `load` + `get::<Pose>` at 100 and at 10,000 entities.
pub fn reads() -> Result<Vec<BenchResult>, Failure> {
    let block = |entities: usize| {
        let (store, all) = populated(entities);
        let published = ArcSwap::from_pointee(store.snapshot());
        let order = shuffled(&all);
        move || {
            let begun = Instant::now();
            for entity in &order {
                black_box(published.load().get::<Pose>(black_box(*entity)));
            }
            Ok::<f64, Failure>(begun.elapsed().as_nanos() as f64 / READS as f64)
        }
    };
    let (large, small) = interleaved(BLOCKS, block(10_000), block(100))?;
    let at_small = median(&small);
    let name = "load + get::<Pose> of a random entity";
    Ok(vec![
        BenchResult::on_value(format!("{name}, 100 entities"), "ns", at_small, Some(60.0), Better::Lower),
        BenchResult::on_ratio(
            format!("{name}, 10,000 entities beside 100"),
            "ns",
            median(&large),
            at_small.0,
            Some(1.5),
            Better::Lower,
        ),
    ])
}
