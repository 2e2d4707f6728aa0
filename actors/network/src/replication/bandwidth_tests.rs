//! Bytes that replication takes: of an organ that is pulled, of a join, and of a station that comes back.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{Entity, Name, Particles, Pose, SimTime, SurfaceMesh, Velocity, VertexPositions};

use super::scene_testing::Pair;
use super::*;

const STEP: SimTime = SimTime::from_millis(5);

/// Bytes a second of a liver of 5,000 nodes of which some move, 100 times a second, as payload of datagrams; and what
/// all its nodes as floats would take at the column's 30 Hz.
fn liver(moves: impl Fn(usize) -> bool) -> (f64, f64) {
    const NODES: usize = 5_000;
    let mut pair = Pair::new(1, FeedLimits { bytes_per_sec: 1e7, ..FeedLimits::default() });
    let liver = pair.host.commands.spawn();
    // Neighbours have neighbouring numbers, as the mesher of the organs numbers them.
    let at = |k: usize| Point3::new((k % 17) as f64, (k / 17 % 17) as f64, (k / 289) as f64) * 0.015;
    let rest: Vec<Point3<f64>> = (0..NODES).map(at).collect();
    pair.host.commands.put(liver, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]; 4_000]) });
    pair.host.commands.put(liver, VertexPositions { positions: Arc::new(rest.clone()) });
    pair.host.apply(SimTime::ZERO);
    pair.settle(SimTime::from_millis(1_000));
    let (begin, before) = (pair.now, pair.feed.rows().counts().bytes);
    for step in 0..400_u64 {
        if step % 2 == 0 {
            let pulled = 0.02 * (step as f64 * 0.02).sin();
            let positions = rest.iter().enumerate().map(|(k, at)| match moves(k) {
                true => at + nalgebra::Vector3::new(0.3, 0.1, 1.0) * pulled,
                false => *at,
            });
            pair.host.commands.put(liver, VertexPositions { positions: Arc::new(positions.collect()) });
            pair.host.apply(pair.now);
        }
        pair.step(STEP);
    }
    let secs = pair.now.since(begin).as_secs_f64();
    let rate = (pair.feed.rows().counts().bytes - before) as f64 / secs;
    pair.settle(SimTime::from_millis(1_000));
    pair.assert_equal();
    (rate, NODES as f64 * 24.0 * 30.0)
}

#[test]
fn a_pulled_liver_takes_a_share_of_the_bytes_of_all_its_nodes() {
    let (near, whole) = liver(|k| k < 250);
    let (scattered, _) = liver(|k| k % 20 == 0);
    let (all, _) = liver(|_| true);
    println!(
        "liver of 5,000 nodes [bytes/s]: 5 % near each other {near:.0}, scattered {scattered:.0}, all {all:.0}; \
              as floats {whole:.0}"
    );
    // 250 nodes of 6 bytes in five chunks; scattered, 79 chunks with a head of 25 bytes each.
    assert!(near < 0.02 * whole, "{near}");
    assert!(scattered < 0.05 * whole, "{scattered}");
    assert!(all < 0.30 * whole, "{all}");
}

#[test]
fn an_organ_that_hardly_trembles_takes_nothing() {
    let mut pair = Pair::new(2, FeedLimits::default());
    let organ = pair.host.commands.spawn();
    pair.host
        .commands
        .put(organ, VertexPositions { positions: Arc::new(vec![Point3::new(0.1, 0.0, 0.0); 500]) });
    pair.host.apply(SimTime::ZERO);
    pair.settle(SimTime::from_millis(1_000));
    let before = pair.feed.rows().counts().datagrams;
    for step in 0..200_u64 {
        let x = 0.1 + 1e-9 * (step as f64).sin();
        pair.host
            .commands
            .put(organ, VertexPositions { positions: Arc::new(vec![Point3::new(x, 0.0, 0.0); 500]) });
        pair.host.apply(pair.now);
        pair.step(STEP);
    }
    assert_eq!(pair.feed.rows().counts().datagrams, before);
    assert!(pair.feed.rows().counts().unchanged > 20);
}

/// Ten thousand entities with a name and a pose, and a tenth of them with a velocity.
fn crowd(count: usize) -> Pair {
    let mut pair = Pair::new(3, FeedLimits::default());
    for number in 0..count {
        let entity = pair.host.commands.spawn();
        let pose = pair.host.pose();
        pair.host.commands.put(entity, pose);
        pair.host.commands.put(entity, Name(format!("peg {number}")));
        if number % 10 == 0 {
            pair.host.commands.put(entity, Velocity::default());
        }
        pair.host.living.push(entity);
    }
    pair.host.apply(SimTime::ZERO);
    pair
}

#[test]
fn a_station_that_comes_back_to_ten_thousand_entities_gets_what_it_missed() {
    let mut pair = crowd(10_000);
    pair.settle(SimTime::from_millis(1_000));
    let (join, messages) = (pair.control_bytes, pair.control_messages);
    assert_eq!(pair.feed.rows().counts().datagrams, 0, "what came reliably does not come again");
    pair.cut();
    let living: Vec<Entity> = pair.host.living.clone();
    for entity in &living[..100] {
        let pose = pair.host.pose();
        pair.host.commands.put(*entity, pose);
    }
    living[100..110].iter().for_each(|entity| pair.host.commands.despawn(*entity));
    let born = pair.host.commands.spawn();
    pair.host.commands.put(born, Pose::at(0.5, 0.0, 0.0));
    pair.host.commands.remove::<Name>(living[200]);
    pair.host.apply(pair.now);
    pair.come_back();
    let took = pair.settle(SimTime::from_millis(1_000));
    pair.assert_equal();
    let (resume, resumed) = (pair.control_bytes - join, pair.control_messages - messages);
    // The same after the station's controller has died, or the host has forgotten what the station had.
    pair.cut();
    let view = pair.station.store.snapshot();
    pair.station.replica = Replica::adopt(pair.columns.clone(), &view, |entity| entity.station() == 1);
    pair.host.commands.put(living[5_000], Pose::at(0.1, 0.2, 0.3));
    pair.host.commands.despawn(living[6_000]);
    pair.host.apply(pair.now);
    let before = (pair.control_bytes, pair.control_messages);
    pair.feed = SceneFeed::new(pair.columns.clone(), FeedLimits::default());
    pair.come_back();
    pair.settle(SimTime::from_millis(1_000));
    pair.assert_equal();
    let (reconciled, in_messages) = (pair.control_bytes - before.0, pair.control_messages - before.1);
    println!(
        "10,000 entities [bytes of control]: join {join} in {messages}, resume {resume} in {resumed}, {took}, \
              reconciled {reconciled} in {in_messages}"
    );
    assert!(join < 500_000 && messages == join.div_ceil(PIECE_BYTES_MAX), "{join} in {messages}");
    assert!(resume < 300 && resumed == 1, "{resume} in {resumed}");
    // The digest, and two chunks of 64 entities.
    assert!(reconciled < 15_000 && in_messages == 1, "{reconciled} in {in_messages}");
}

#[test]
fn smoke_takes_a_third_of_its_floats_even_where_no_datagram_holds_it() {
    let mut pair = Pair::new(5, FeedLimits::default());
    let smoke = pair.host.commands.spawn();
    let (mut bytes, mut whole) = (0, 0);
    for step in 0..20 {
        let puffs = pair.host.body(1_000);
        let densities = Arc::new((0..1_000).map(|_| pair.host.random.unit()).collect::<Vec<f64>>());
        let particles = Particles { positions: puffs.positions, densities, ..Particles::default() };
        pair.host.commands.put(smoke, particles);
        pair.host.apply(pair.now);
        let before = pair.control_bytes;
        pair.settle(SimTime::from_millis(1_000));
        pair.assert_equal();
        if step > 0 {
            bytes += pair.control_bytes - before;
            whole += 1_000 * 4 * 8;
        }
    }
    assert!(bytes * 3 < whole, "{bytes} of {whole}");
    assert!(pair.feed.rows().counts().datagrams < 2);
}

#[test]
fn memory_is_bounded_by_rows_and_not_by_what_happens() {
    let mut pair = Pair::new(4, FeedLimits::default());
    for _ in 0..3_000 {
        pair.host.change(pair.now);
        pair.step(STEP);
    }
    pair.settle(SimTime::from_millis(5_000));
    let rows: usize = pair.columns.replicated().map(|id| pair.host.scene.erased_column(id).len()).sum();
    assert_eq!(pair.station.replica.known().len(), rows, "nothing is kept of what is gone");
    assert!(pair.feed.rows().places() < 1_000, "{}", pair.feed.rows().places());
}
