use std::collections::BTreeMap;

use super::*;

const RADIUS: f64 = 0.002;

fn thread(count: u32) -> (Vec<[u32; 2]>, Vec<Point3<f64>>) {
    let points = (0..count).map(|k| {
        let t = f64::from(k) * 0.4;
        Point3::new(0.02 * t.cos(), 0.02 * t.sin(), 0.004 * t)
    });
    ((1..count).map(|k| [k - 1, k]).collect(), points.collect())
}

fn ring(count: u32) -> (Vec<[u32; 2]>, Vec<Point3<f64>>) {
    let angle = |k: u32| std::f64::consts::TAU * f64::from(k) / f64::from(count);
    let points = (0..count)
        .map(|k| Point3::new(0.02 * angle(k).cos(), 0.02 * angle(k).sin(), 0.003 * (2.0 * angle(k)).sin()));
    ((0..count).map(|k| [k, (k + 1) % count]).collect(), points.collect())
}

/// V − E + F after vertices at the same place are merged; also checks that each edge has two triangles with opposite
/// orientation.
fn euler_characteristic(tube: &Tube) -> i64 {
    let mut names: BTreeMap<[i64; 3], usize> = BTreeMap::new();
    let merged: Vec<usize> = tube
        .positions()
        .iter()
        .map(|p| {
            let next = names.len();
            *names.entry(p.map(|x| (f64::from(x) * 1e8).round() as i64)).or_insert(next)
        })
        .collect();
    let mut edges: BTreeMap<(usize, usize), i64> = BTreeMap::new();
    for triangle in tube.indices().chunks_exact(3) {
        for k in 0..3 {
            let (a, b) = (merged[triangle[k] as usize], merged[triangle[(k + 1) % 3] as usize]);
            assert_ne!(a, b, "a triangle has no area");
            *edges.entry((a, b)).or_default() += 1;
        }
    }
    for ((a, b), count) in &edges {
        assert_eq!((*count, edges.get(&(*b, *a))), (1, Some(&1)), "edge {a} {b}");
    }
    names.len() as i64 - edges.len() as i64 / 2 + tube.indices().len() as i64 / 3
}

fn volume(tube: &Tube) -> f64 {
    let at = |i: u32| Vector3::from(tube.positions()[i as usize].map(f64::from));
    tube.indices().chunks_exact(3).map(|t| at(t[0]).dot(&at(t[1]).cross(&at(t[2]))) / 6.0).sum()
}

#[test]
fn tubes_are_closed_and_face_outwards() {
    for (cap, ends) in [(Cap::Round, 4.0 / 3.0 * RADIUS), (Cap::Flat, 0.0)] {
        let mut tube = Tube::new(TubeStyle { around: 24, turn: 0.1, cap });
        let (segments, points) = thread(20);
        tube.update(&segments, &points, RADIUS);
        assert_eq!(euler_characteristic(&tube), 2, "{cap:?}: a thread is a ball");
        // Pappus: the cross-section times the length of the curve, and a ball for round caps.
        let expected = std::f64::consts::PI * RADIUS * RADIUS * (tube.curve.length() + ends);
        assert!((volume(&tube) / expected - 1.0).abs() < 0.03, "{cap:?}: {} and {expected}", volume(&tube));

        let (segments, points) = ring(9);
        tube.update(&segments, &points, RADIUS);
        assert_eq!(euler_characteristic(&tube), 0, "{cap:?}: a loop is a torus");
        let expected = std::f64::consts::PI * RADIUS * RADIUS * tube.curve.length();
        assert!((volume(&tube) / expected - 1.0).abs() < 0.03, "{cap:?}: {} and {expected}", volume(&tube));
    }
}

#[test]
fn every_vertex_is_one_radius_from_the_curve_along_its_normal() {
    let mut tube = Tube::new(TubeStyle::default());
    for (segments, points) in [thread(15), ring(7)] {
        tube.update(&segments, &points, RADIUS);
        for (position, normal) in tube.positions().iter().zip(tube.normals()) {
            let normal = Vector3::from(normal.map(f64::from));
            assert!((normal.norm() - 1.0).abs() < 1e-6);
            let center = Point3::from(position.map(f64::from)) - normal * RADIUS;
            let off = tube.curve.samples().iter().map(|s| (s.position - center).norm()).fold(1.0, f64::min);
            assert!(off < 1e-8, "{off}");
        }
    }
}

#[test]
fn textures_keep_their_scale_and_close_around_a_loop() {
    let mut tube = Tube::new(TubeStyle::default());
    let (segments, points) = thread(15);
    tube.update(&segments, &points, RADIUS);
    let circumference = std::f64::consts::TAU * RADIUS;
    let (low, high) = tube.uvs().iter().fold((f32::MAX, f32::MIN), |(l, h), uv| (l.min(uv[1]), h.max(uv[1])));
    // Each round cap goes on for a quarter of a circumference.
    assert!((f64::from(high - low) - 0.5 - tube.curve.length() / circumference).abs() < 1e-3);
    assert!(tube.uvs().iter().all(|uv| (0.0..=1.0).contains(&uv[0])));
    let (segments, points) = ring(7);
    tube.update(&segments, &points, RADIUS);
    let high = tube.uvs().iter().fold(0.0f32, |h, uv| h.max(uv[1]));
    assert!(high >= 1.0 && (high - high.round()).abs() < 1e-4, "{high}");
}

#[test]
fn branches_are_balls_that_meet() {
    let points: Vec<Point3<f64>> =
        [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.04, 0.01, 0.0], [0.04, -0.01, 0.0]].map(Point3::from).to_vec();
    let mut tube = Tube::new(TubeStyle { cap: Cap::Flat, ..TubeStyle::default() });
    tube.update(&[[0, 1], [1, 2], [1, 3]], &points, RADIUS);
    // Three tubes, each round at the branching: something reaches beyond it in every direction by the radius.
    let beyond = tube.positions().iter().map(|p| f64::from(p[0])).filter(|x| *x < 0.0201).fold(0.0, f64::max);
    assert!(beyond > 0.0195, "{beyond}");
    assert_eq!(tube.chains.chains().len(), 3);
    let loose = tube.positions().iter().map(|p| p[0]).fold(1.0, f32::min);
    assert!(loose.abs() < 1e-7, "the loose end is flat: {loose}");
}

#[test]
fn a_moving_thread_does_not_spin() {
    let mut tube = Tube::new(TubeStyle::default());
    let segments = [[0, 1], [1, 2]];
    let mut before: Option<Vec<[f32; 3]>> = None;
    // Its first segment turns through all directions in which the choice of an axis could flip.
    for step in 0..200 {
        let angle = f64::from(step) * 0.03;
        let tip = Vector3::new(angle.cos(), angle.sin(), (2.0 * angle).sin()).normalize() * 0.02;
        let points = [Point3::from(-tip), Point3::origin(), Point3::from(tip)];
        tube.update(&segments, &points, RADIUS);
        let now = tube.normals().to_vec();
        if let Some(before) = before.filter(|before| before.len() == now.len()) {
            for (a, b) in before.iter().zip(&now) {
                let turned = Vector3::from(*a).angle(&Vector3::from(*b));
                assert!(turned < 0.15, "step {step}: {turned}");
            }
        }
        before = Some(now);
    }
}

#[test]
fn updates_reuse_their_buffers() {
    let mut tube = Tube::new(TubeStyle::default());
    let (segments, mut points) = thread(30);
    tube.update(&segments, &points, RADIUS);
    let first = (tube.positions().to_vec(), tube.indices().to_vec());
    let buffers = |tube: &Tube| {
        (tube.positions.as_ptr(), tube.normals.as_ptr(), tube.uvs.as_ptr(), tube.indices.as_ptr())
    };
    let before = buffers(&tube);
    // A stretched helix is straighter: it needs no more rings.
    for _ in 0..10 {
        points.iter_mut().for_each(|p| p.z *= 1.1);
        tube.update(&segments, &points, RADIUS);
    }
    assert_eq!(buffers(&tube), before);
    let (segments, points) = thread(30);
    tube.update(&segments, &points, RADIUS);
    assert_eq!(tube.indices(), first.1);
    assert!(tube.positions().iter().zip(&first.0).all(|(a, b)| (0..3).all(|k| (a[k] - b[k]).abs() < 0.0041)));
}

#[test]
fn degenerate_input_gives_a_sound_tube_or_none() {
    let mut tube = Tube::new(TubeStyle { around: 0, turn: f64::NAN, cap: Cap::Round });
    let same = vec![Point3::new(1.0, 1.0, 1.0); 6];
    let (_, mut bent) = thread(6);
    bent[3] = bent[2];
    bent[5] = bent[4];
    let far = vec![Point3::new(1e300, 0.0, 0.0), Point3::origin(), Point3::new(0.01, 0.0, 0.0)];
    let lines = vec![[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 0], [2, 2], [3, 77], [u32::MAX, 0]];
    for points in [&same, &bent, &far, &Vec::new()] {
        for radius in [RADIUS, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e5] {
            tube.update(&lines, points, radius);
            let count = tube.positions().len() as u32;
            assert!(tube.indices().iter().all(|i| *i < count));
            assert!(tube.normals().len() == count as usize && tube.uvs().len() == count as usize);
            let finite = tube.positions().iter().chain(tube.normals()).flatten().all(|x| x.is_finite());
            assert!(finite && tube.uvs().iter().flatten().all(|x| !x.is_nan()), "{radius}");
        }
    }
    tube.update(&lines, &same, RADIUS);
    assert!(tube.positions().is_empty(), "all points are one");
    tube.update(&lines[..5], &bent, RADIUS);
    assert_eq!(euler_characteristic(&tube), 2, "points at the same place are skipped");
}

#[test]
fn random_threads_are_sound() {
    let mut random = trocar_scene::random::SplitMix64::new(77);
    let mut tube = Tube::new(TubeStyle::default());
    for round in 0..300 {
        let count = 2 + (random.next_u64() % 12) as u32;
        let points: Vec<Point3<f64>> = (0..count)
            .map(|_| Point3::from([0, 1, 2].map(|_| f64::from((random.unit_f32() * 6.0).floor()) * 0.01)))
            .collect();
        let closed = count > 2 && random.next_u64() & 1 == 0;
        let segments: Vec<[u32; 2]> =
            (0..if closed { count } else { count - 1 }).map(|k| [k, (k + 1) % count]).collect();
        tube.update(&segments, &points, 0.001);
        for normal in tube.normals() {
            assert!((Vector3::from(*normal).norm() - 1.0).abs() < 1e-4, "round {round}");
        }
        assert!(tube.positions().iter().flatten().all(|x| x.abs() < 1.0), "round {round}");
    }
}
