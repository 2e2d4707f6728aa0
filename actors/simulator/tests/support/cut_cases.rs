//! Cuts through volumes, each with what is right: a sample of them runs always, the whole grid in the thorough tests.

use std::ops::Range;

use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells, mean_ratio, refined};
use trocar_scene::organs::{Organ, tetrahedra};

use super::blade::{Bench, Cut, block, direction, section};
use super::delaunay;

/// Smallest piece of a cut through the middle, as a share of the whole.
const PIECE: f64 = 0.05;

fn middle() -> Point3<f64> {
    Point3::new(0.03, 0.025, 0.02)
}

/// Random planes: two pieces, and lips within bounds relative to the plane's section.
pub fn in_planes(name: &str, mesh: &TetMesh, ticks: u32, seeds: Range<u64>, lips: [f64; 2]) {
    for seed in seeds {
        let cut = Cut::random(mesh, &mut Pcg64Mcg::seed_from_u64(seed));
        let mut bench = Bench::new(mesh);
        bench.pass(&cut, ticks);
        let name = format!("{name}, {ticks} ticks, seed {seed}");
        bench.has_pieces(2, PIECE, &name);
        let lip = bench.lip() / section(mesh, &cut);
        assert!(lip > lips[0] && lip < lips[1], "{name}: a lip of {lip} of the section");
    }
}

/// A blade that pauses, one that goes back and forth, one that turns in its plane, one that turns about a point beside
/// the block, and one that turns about a point of its own inside.
pub fn goes_on_anyhow(mesh: &TetMesh, ticks: u32, seeds: Range<u64>) {
    for seed in seeds {
        let cut = Cut::random(mesh, &mut Pcg64Mcg::seed_from_u64(seed));
        let share = |tick: f64| (tick / f64::from(ticks)).min(1.0);
        let check = |bench: &Bench, name: &str| {
            bench.has_pieces(2, PIECE, &format!("{name}, {ticks} ticks, seed {seed}"));
        };
        let mut bench = Bench::new(mesh);
        for tick in 0..2 * ticks {
            let now = (tick / 2) + (tick % 2);
            let at = |tick: u32| cut.blade(share(f64::from(tick)), 0.0);
            bench.sweep(at(tick / 2), at(now));
        }
        check(&bench, "pauses");
        let (mut bench, mut at, mut tick) = (Bench::new(mesh), 0.0, 0);
        while at < f64::from(ticks) {
            let next: f64 = if tick % 3 == 2 { at - 0.7 } else { at + 1.0 };
            bench.sweep(cut.blade(share(at), 0.0), cut.blade(share(next), 0.0));
            (at, tick) = (next, tick + 1);
        }
        check(&bench, "back and forth");
        let mut bench = Bench::new(mesh);
        bench.follow(ticks, |share| cut.blade(share, 0.6 * (share - 0.5)));
        check(&bench, "turning");
        let across = cut.normal.cross(&cut.way);
        let turned =
            |angle: f64| UnitQuaternion::from_axis_angle(&Unit::new_normalize(cut.normal), angle) * across;
        let mut bench = Bench::new(mesh);
        let hinge = cut.point - across * 0.07;
        bench.follow(ticks, |share| [hinge, hinge + turned(3.0 * share - 1.5) * 0.3]);
        check(&bench, "fan");
        // Half a turn of a blade that is on both sides of its hinge sweeps the whole plane.
        let mut bench = Bench::new(mesh);
        let ends = |angle: f64| [cut.point - turned(angle) * 0.1, cut.point + turned(angle) * 0.1];
        bench.follow(ticks.max(20), |share| ends(3.3 * share));
        check(&bench, "propeller");
    }
}

/// A blade that turns in its plane about a point of its own inside the block: about its middle, about a point near its end
/// and about the end itself; by half a turn, by two turns, to and fro, and in tissue that moves in time with the turns.
pub fn turns_about_itself(mesh: &TetMesh, ticks: u32, seeds: Range<u64>) {
    const TURNS: [(&str, f64, f64, f64); 6] = [
        ("half a turn", 3.3, 0.1, 0.0),
        ("two turns", 12.8, 0.1, 0.0),
        ("near its end", 6.6, 0.01, 0.0),
        ("about its end", 6.6, 0.0, 0.0),
        ("to and fro", 3.4, 0.09, 0.15),
        ("backwards", -3.3, 0.085, 0.0),
    ];
    for seed in seeds {
        let cut = Cut::random(mesh, &mut Pcg64Mcg::seed_from_u64(seed));
        let along = cut.normal.cross(&cut.way);
        let blade = |angle: f64, behind: f64| {
            let along = UnitQuaternion::from_axis_angle(&Unit::new_normalize(cut.normal), angle) * along;
            [cut.point - along * behind, cut.point + along * (0.2 - behind)]
        };
        let check = |bench: &Bench, name: &str| {
            let name = format!("{name}, {ticks} ticks, seed {seed}");
            bench.has_pieces(2, PIECE, &name);
            let lip = bench.lip() / section(mesh, &cut);
            assert!((0.97..1.2).contains(&lip), "{name}: a lip of {lip} of the section");
        };
        for (name, turn, behind, sway) in TURNS {
            let mut bench = Bench::new(mesh);
            let steps = (f64::from(ticks) * (turn.abs() / 3.3).ceil()) as u32;
            bench.follow(steps, |share| blade(turn * share + sway * (40.0 * share).sin(), behind));
            check(&bench, name);
        }
        // Where the blade comes to its own cut again, the tissue is where it was.
        let (number, turn) = (Vector3::new(30.0, 40.0, -20.0), 3.6);
        let height = Vector3::new(0.3, -0.5, 0.4) * 2e-4;
        let place = |point: &Point3<f64>, share: f64| {
            point + height * (number.dot(&point.coords) + 2.0 * turn * share).sin()
        };
        let mut bench = Bench::new(mesh);
        for tick in 0..ticks {
            let [from, to] = [tick, tick + 1].map(|tick| f64::from(tick) / f64::from(ticks));
            let rest = bench.volume.rest();
            bench.nodes.positions = rest.iter().map(|point| place(point, to)).collect();
            bench.nodes.moved = rest.iter().map(|point| place(point, to) - place(point, from)).collect();
            bench.sweep(blade(turn * from, 0.1), blade(turn * to, 0.1));
        }
        check(&bench, "in tissue that moves");
    }
}

/// Planes along faces, edges and diagonals of a grid's cells, this part of a cell off the nodes.
pub fn through_nodes(cell: f64, off: f64, ticks: u32) {
    let mesh = block(cell);
    for normal in [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 1.0, 0.0],
        [1.0, -1.0, 0.0],
        [0.0, 1.0, -1.0],
        [1.0, 0.0, 1.0],
        [1.0, 1.0, 1.0],
        [1.0, -1.0, 1.0],
        [-1.0, 1.0, 1.0],
        [2.0, 1.0, 0.0],
        [1.0, 2.0, 3.0],
    ] {
        let normal = Vector3::from(normal).normalize();
        for (sign, way) in [(1.0, Vector3::x()), (-1.0, Vector3::z()), (1.0, Vector3::new(0.3, 0.5, 0.8))] {
            let way = way - normal * normal.dot(&way);
            if way.norm() < 0.1 {
                continue;
            }
            let point = Point3::new(0.03, 0.02, 0.02) + normal * (off * cell * sign);
            let cut = Cut { point, normal, way: way.normalize() };
            let mut bench = Bench::new(&mesh);
            bench.pass(&cut, ticks);
            let name = format!("{normal:?} off by {off} of {cell} m, along {way:?}, {ticks} ticks");
            bench.has_pieces(2, PIECE, &name);
            // The section of planes that faces lie in is ambiguous to the bit.
            let beside = Cut { point: cut.point + normal * 1e-7, ..cut };
            let lip = bench.lip() / section(&mesh, &beside);
            let bounds = if off < 1e-3 && normal.iter().all(|x| x.abs() < 1e-9 || x.abs() > 0.5) {
                0.999..1.001
            } else {
                0.94..1.12
            };
            assert!(bounds.contains(&lip), "{name}: a lip of {lip} of the section");
        }
    }
}

/// Two cuts that cross near the middle at an angle: four pieces.
pub fn crosses(cell: f64, ticks: u32, degrees: f64, seeds: Range<u64>) {
    let mesh = block(cell);
    for seed in seeds {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let normal = direction(&mut random);
        let along = normal.cross(&direction(&mut random));
        let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(along), degrees.to_radians());
        let point = middle() + direction(&mut random) * 0.003;
        let mut bench = Bench::new(&mesh);
        for normal in [normal, turn * normal] {
            let way = normal.cross(&direction(&mut random)).normalize();
            bench.pass(&Cut { point, normal, way }, ticks);
        }
        bench.has_pieces(4, 1e-3, &format!("crossing at {degrees}°, {ticks} ticks, seed {seed}"));
    }
}

/// Two parallel cuts this many cells from each other: three pieces.
pub fn beside(cell: f64, ticks: u32, cells: f64, seeds: Range<u64>) {
    let mesh = block(cell);
    for seed in seeds {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let normal = direction(&mut random);
        let way = normal.cross(&direction(&mut random)).normalize();
        let point = middle() + direction(&mut random) * 0.003;
        let first = Cut { point, normal, way };
        let mut bench = Bench::new(&mesh);
        bench.pass(&first, ticks);
        bench.pass(&Cut { point: point + normal * cells * cell, ..first }, ticks);
        bench.has_pieces(3, 1e-3, &format!("{cells} cells beside, {ticks} ticks, seed {seed}"));
    }
}

/// The same cut again, from two other sides.
pub fn twice(cell: f64, ticks: u32, seeds: Range<u64>) {
    let mesh = block(cell);
    for seed in seeds {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let cut = Cut::random(&mesh, &mut random);
        let mut bench = Bench::new(&mesh);
        bench.pass(&cut, ticks);
        let way = cut.normal.cross(&direction(&mut random)).normalize();
        bench.pass(&Cut { way, ..cut }, ticks);
        bench.pass(&Cut { normal: -cut.normal, ..cut }, ticks);
        bench.has_pieces(2, PIECE, &format!("three times, {ticks} ticks, seed {seed}"));
    }
}

/// A level blade comes from above to a depth.
pub fn partly(cell: f64, ticks: u32, seeds: Range<u64>) {
    let mesh = block(cell);
    for seed in seeds {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut tilt = |most: f64| random.random_range(-most..most);
        let normal = Vector3::new(1.0, tilt(0.4), tilt(0.3)).normalize();
        let down = (normal * normal.z - Vector3::z()).normalize();
        let level = 0.04 - random.random_range(0.012..0.03);
        let across = normal.cross(&down) * 0.1;
        let at = |height: f64| {
            let point = middle() + down * ((height - 0.02) / down.z);
            [point - across, point + across]
        };
        let mut bench = Bench::new(&mesh);
        bench.follow(ticks, |share| at(0.05 + (level - 0.05) * share));
        let name = format!("down to {level} m, cells of {cell} m, {ticks} ticks, seed {seed}");
        bench.has_pieces(1, PIECE, &name);
        let size = Vector3::new(0.06, 0.05, 0.04 - level);
        let origin = Point3::new(0.0, 0.0, level);
        let (nodes, tets) = box_cells(&BoxCells { cells: [1; 3], size, origin });
        let above = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a box");
        let cut = Cut { point: middle(), normal, way: down };
        let wanted = section(&above, &cut);
        let width = wanted * -down.z / size.z;
        // A lip is not smooth, so its area may be somewhat larger.
        let short = (wanted - bench.lip()) / width / cell;
        assert!((-0.2..1.2).contains(&short), "{name}: short by {short} cells");
        // Nodes that came apart are where the blade was, or a quarter of a cell further where the path snapped to them.
        let rest = bench.volume.rest();
        for (node, place) in rest.iter().enumerate().skip(mesh.rest().len()) {
            let comes_apart = rest[..node].iter().any(|other| other == place);
            assert!(!comes_apart || place.z > level - 0.3 * cell, "{name}: {place:?} is below the blade");
        }
    }
}

/// Along a U, a twist and a zigzag with this radius of bending \[m\].
pub fn bent(cell: f64, ticks: u32, radius: f64, seeds: Range<u64>) {
    let mesh = block(cell);
    for seed in seeds {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let axis = Unit::new_normalize(direction(&mut random));
        let turn = UnitQuaternion::from_axis_angle(&axis, random.random_range(0.0..0.5));
        let mut off = || random.random_range(-0.004..0.004);
        let base = middle() + Vector3::new(off(), 0.0, off());
        let blade = |at: Vector3<f64>, along: Vector3<f64>| {
            let (at, along) = (base + turn * at, turn * along * 0.08);
            [at - along, at + along]
        };
        let check = |bench: &Bench, name: &str| {
            bench.has_pieces(2, 0.01, &format!("{name} of {radius} m, {cell} m, {ticks} ticks, seed {seed}"));
        };
        let (leg, span) = (0.05, (0.07 / radius).min(1.57));
        let arc = |share: f64| {
            let along = (2.0 * share - 1.0) * (leg + span * radius);
            let angle = (along / radius).clamp(-span, span);
            let beyond = along - angle * radius;
            let bottom = Vector3::new(angle.sin(), 0.0, 1.0 - angle.cos()) * radius;
            blade(bottom + Vector3::new(angle.cos(), 0.0, angle.sin()) * beyond, Vector3::y())
        };
        let mut bench = Bench::new(&mesh);
        bench.follow(ticks, arc);
        check(&bench, "an arc");
        let twist = |share: f64| {
            let angle = (share - 0.5) * 0.06 / radius;
            let along = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle) * Vector3::y();
            blade(Vector3::x() * (0.12 * share - 0.06), along)
        };
        let mut bench = Bench::new(&mesh);
        bench.follow(ticks, twist);
        check(&bench, "a twist");
        let zigzag = |share: f64| {
            let x = 0.12 * share - 0.06;
            let phase = (x / radius).rem_euclid(1.0);
            let height = 0.15 * radius * ((2.0 * phase).min(2.0 - 2.0 * phase) - 0.5);
            blade(Vector3::new(x, 0.0, height), Vector3::y())
        };
        let mut bench = Bench::new(&mesh);
        bench.follow(ticks, zigzag);
        check(&bench, "a zigzag");
    }
}

/// Tissue that moves in two waves with strains of up to about this, while a blade goes through.
pub fn deforms(cell: f64, ticks: u32, strain: f64, seeds: Range<u64>) {
    let mesh = block(cell);
    for seed in seeds {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let normal = direction(&mut random);
        let point = middle() + direction(&mut random) * 0.006;
        let cut = Cut { point, normal, way: normal.cross(&direction(&mut random)).normalize() };
        let waves = [0.5, 1.5].map(|speed| {
            let number = direction(&mut random) * 60.0;
            let height = direction(&mut random) * (strain / 60.0 / 2.0);
            (number, height, speed * random.random_range(2.0..9.0), random.random_range(0.0..6.0))
        });
        let place = |point: &Point3<f64>, time: f64| {
            let by = |(number, height, speed, phase): &(Vector3<f64>, Vector3<f64>, f64, f64)| {
                height * (number.dot(&point.coords) + phase + speed * time).sin()
            };
            point + waves.iter().map(by).sum::<Vector3<f64>>()
        };
        let mut bench = Bench::new(&mesh);
        for tick in 0..ticks {
            let [from, to] = [tick, tick + 1].map(|tick| f64::from(tick) / f64::from(ticks));
            let rest = bench.volume.rest();
            bench.nodes.positions = rest.iter().map(|point| place(point, to)).collect();
            bench.nodes.moved = rest.iter().map(|point| place(point, to) - place(point, from)).collect();
            bench.sweep(cut.blade(from, 0.0), cut.blade(to, 0.0));
        }
        bench.has_pieces(2, PIECE, &format!("strains of {strain}, {cell} m, {ticks} ticks, seed {seed}"));
    }
}

/// A kidney, a block that is finer in the middle, and Delaunay tetrahedra of random points without flat ones.
pub fn meshes(edge: f64) -> [(&'static str, TetMesh); 3] {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let kidney = tetrahedra(&Organ::Kidney.implicit(), edge, 1).expect("a kidney");
    let (kidney, _) =
        TetMesh::repaired(&kidney.positions, &kidney.tets, &MeshRules::default()).expect("a mesh");
    let coarse = block(0.01);
    let size = |at: &Point3<f64>| 0.6 * edge + 0.2 * (at - middle()).norm();
    let (nodes, tets) = refined(coarse.rest(), coarse.tets(), size, 50_000).expect("not that many");
    let graded = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a mesh");
    let mut points = Vec::new();
    for at in 0..7 * 6 * 5 {
        let cell = Vector3::new(f64::from(at / 30), f64::from(at / 5 % 6), f64::from(at % 5));
        let off = Vector3::from([0; 3].map(|_| random.random_range(-0.3..0.3)));
        points.push(Point3::from((cell + off) * 0.01));
    }
    let mut tets = delaunay::tetrahedra(&points);
    tets.retain(|tet| mean_ratio(&points, tet) > 0.2);
    let (scattered, _) = TetMesh::repaired(&points, &tets, &MeshRules::default()).expect("a mesh");
    [("a kidney", kidney), ("a graded block", graded), ("random points", scattered)]
}
