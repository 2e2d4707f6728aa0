//! Incremental updates after remeshing: springs, hinges, constraints, their colours, masses and the stable step equal
//! those rebuilt from the whole mesh, and the cost depends on the change, not on the size of the body.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::particles::State;
use trocar_dynamics::tet_mesh::{
    BoxCells, MeshRules, NodeAdjacency, NodeMotion, NodeOrigin, OpenCut, Sweep, TetMesh, Volume,
    VolumeChange, box_cells,
};
use trocar_simulator::cutting::{Sheet, TopologyChange};
use trocar_simulator::mass_spring::{
    ChangedMesh, Config, Input, Integrator, MassSpring, Network, SurfaceMaterial, TooLarge, VolumeMaterial,
};
use trocar_simulator::xpbd::{Body, Elasticity, SplitTets, Xpbd, XpbdConfig, XpbdInput, distances_of};

const SPRINGS: VolumeMaterial = VolumeMaterial { young_modulus: 2e4, density: 1000.0 };
const MATTER: Elasticity = Elasticity { young_modulus: 2e4, poisson_ratio: 0.3, density: 1000.0 };
const GAUZE: SurfaceMaterial =
    SurfaceMaterial { membrane_stiffness: 50.0, bending_stiffness: 1e-6, density: 0.15 };
const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

fn explicit() -> Config {
    let too_large = TooLarge::Divide { most: 1000 };
    Config { integrator: Integrator::Explicit { too_large }, lag: 1e-4, damping: 1.0, ..Config::default() }
}

fn carry(state: &mut State, born: &[NodeOrigin]) {
    for birth in born {
        state.positions.push(birth.mix(&state.positions, |a, b, share| a + (b - a) * share));
        state.velocities.push(birth.mix(&state.velocities, |a, b, share| a + (b - a) * share));
    }
}

/// A random change of a body: place and size as fractions.
#[derive(Clone, Copy, Debug)]
enum Event {
    Burn { at: f64 },
    Coagulate { at: f64, stiffness: f64, length: f64 },
    Open { at: f64, corner: u8 },
    Cut { from: [f64; 3], to: [f64; 3], along: [f64; 3] },
}

fn event() -> impl Strategy<Value = Event> {
    let place = || [0.0..1.0, 0.0..1.0, 0.0..1.0];
    prop_oneof![
        (0.0..1.0).prop_map(|at| Event::Burn { at }),
        (0.0..1.0, 1.0..5.0, 0.8..1.0).prop_map(|(at, stiffness, length)| Event::Coagulate {
            at,
            stiffness,
            length
        }),
        (0.0..1.0, 0..4_u8).prop_map(|(at, corner)| Event::Open { at, corner }),
        (place(), place(), place()).prop_map(|(from, to, along)| Event::Cut { from, to, along }),
    ]
}

/// A volume that is cut, with the two solvers updated incrementally.
struct Apart {
    volume: Volume,
    slit: OpenCut,
    size: f64,
    tets: Vec<[u32; 4]>,
    altered: Vec<Alteration>,
    stars: NodeAdjacency,
    held: usize,
    springs: MassSpring,
    positions: Xpbd,
    /// Edges, nodes and tetrahedra rebuilt in the last change.
    derived: usize,
}

impl Apart {
    fn new(cells: usize) -> Self {
        let size = 0.01 * cells as f64;
        let grid = BoxCells { cells: [cells; 3], size: Vector3::repeat(size), origin: Point3::origin() };
        let (rest, tets) = box_cells(&grid);
        let mesh = TetMesh::new(&rest, &tets, &MeshRules::default()).expect("a sound mesh");
        // One face is held.
        let held: Vec<u32> = (0..rest.len() as u32).filter(|&node| rest[node as usize].x == 0.0).collect();
        assert!(held.iter().copied().eq(0..held.len() as u32), "the first nodes");
        let network = Network::from_volume(&rest, &tets, &SPRINGS).expect("a network");
        let springs = MassSpring::new(network, rest.clone(), &held, explicit()).expect("a solver");
        let body = Body { rest: &rest, tets: &tets, elasticity: Some(MATTER), ..Body::default() };
        let positions = Xpbd::new(&body, &held, XpbdConfig::default()).expect("a solver");
        Self {
            volume: Volume::new(&mesh),
            slit: OpenCut::default(),
            size,
            altered: vec![Alteration::NONE; tets.len()],
            stars: NodeAdjacency::new(rest.len(), (0..).zip(tets.iter().copied())),
            tets,
            held: held.len(),
            springs,
            positions,
            derived: 0,
        }
    }

    fn tet(&self, at: f64) -> Option<u32> {
        let there: Vec<u32> = self.volume.tets().map(|(tet, _)| tet).collect();
        there.get((at * there.len() as f64) as usize).copied()
    }

    fn takes(&mut self, event: Event) {
        self.derived = 0;
        match event {
            Event::Burn { at } => {
                let Some(tet) = self.tet(at) else { return };
                self.volume.take_out(&[tet]).expect("it is there");
                let corners = self.tets[tet as usize];
                self.altered[tet as usize] = Alteration::GONE;
                self.stars.remove(tet, &corners);
                self.follow(corners.to_vec(), &[]);
                self.positions.remove(&[tet]);
            }
            Event::Coagulate { at, stiffness, length } => {
                let Some(tet) = self.tet(at) else { return };
                self.altered[tet as usize] = Alteration { stiffness, length };
                self.follow(self.tets[tet as usize].to_vec(), &[]);
                self.positions.alter(tet, stiffness, length);
            }
            Event::Open { at, corner } => {
                let Some(tet) = self.tet(at) else { return };
                let change = self.volume.open(&[(tet, corner)]).expect("it is there");
                self.split(&change);
            }
            Event::Cut { from, to, along } => {
                let size = self.size;
                let place = |share: [f64; 3]| Point3::from(share.map(|share| share * size));
                let blade = [place(from), place(to)];
                let by = Vector3::from(along.map(|share| (share - 0.5) * size));
                let sweep = Sweep { before: blade, after: blade.map(|end| end + by) };
                let moved = vec![Vector3::zeros(); self.volume.rest().len()];
                let mut nodes = NodeMotion { positions: self.springs.state().positions.clone(), moved };
                let mut change = VolumeChange::default();
                self.volume.cut(&mut nodes, &[sweep], &mut self.slit, &mut change).expect("a cut");
                self.split(&change);
            }
        }
    }

    fn split(&mut self, change: &VolumeChange) {
        let halves = change.halved.iter().flat_map(|halved| [halved.tet, halved.child]);
        let mut changed: Vec<u32> = change.renamed.iter().copied().chain(halves).collect();
        changed.sort_unstable();
        changed.dedup();
        for halved in &change.halved {
            self.altered.resize(self.altered.len().max(halved.child as usize + 1), Alteration::NONE);
            self.altered[halved.child as usize] = self.altered[halved.tet as usize];
        }
        let mut stale = Vec::new();
        for &tet in &changed {
            let corners = self.volume.tet(tet).expect("it is there");
            if let Some(was) = self.tets.get(tet as usize).copied() {
                self.stars.remove(tet, &was);
                stale.extend(was);
                self.tets[tet as usize] = corners;
            } else {
                assert_eq!(tet as usize, self.tets.len(), "numbered behind all others");
                self.tets.push(corners);
            }
            self.stars.add(tet, &corners);
            stale.extend(corners);
        }
        self.follow(stale, &change.born);
        let split = SplitTets { rest: self.volume.rest(), tets: &self.tets, changed: &changed };
        let held = self.held as u32;
        let put = self.positions.split(&split, |node| node < held, |state| carry(state, &change.born));
        self.derived += put.expect("it follows");
        for &tet in &changed {
            let Alteration { stiffness, length } = self.altered[tet as usize];
            self.positions.alter(tet, stiffness, length);
        }
    }

    fn follow(&mut self, mut stale: Vec<u32>, born: &[NodeOrigin]) {
        stale.sort_unstable();
        stale.dedup();
        let (altered, stars, held) = (&self.altered, &self.stars, self.held as u32);
        let patch = ChangedMesh {
            rest: self.volume.rest(),
            elements: &self.tets,
            altered: &|tet| altered[tet as usize],
            about: &|node| stars.about(node),
            stale: &stale,
        };
        let stays = |node: u32| node < held || stars.about(node).is_empty();
        let followed = self
            .springs
            .follow(
                &patch,
                stays,
                |state| carry(state, born),
                |network, patch| network.follow_volume(patch, &SPRINGS),
            )
            .expect("it follows");
        self.derived += followed.edges + followed.nodes;
    }

    /// Compares everything updated incrementally with a rebuild, and the motion of both.
    fn agrees(&mut self) {
        let rest = self.volume.rest();
        let loose = self.volume.orphans();
        let fresh = Network::from_altered_volume(rest, &self.tets, &SPRINGS, &self.altered, &loose);
        let fresh = fresh.expect("a network");
        assert!(fresh == *self.springs.network(), "springs and masses are those of the mesh");
        let mut pinned: Vec<u32> = (0..self.held as u32).chain(loose).collect();
        pinned.sort_unstable();
        pinned.dedup();
        assert_eq!(self.springs.pinned(), pinned);
        let state = self.springs.state().clone();
        let mut anew = MassSpring::restore(fresh, state, &pinned, explicit()).expect("a solver");
        assert_eq!(anew.safe_step().to_bits(), self.springs.safe_step().to_bits());
        let input = Input { gravity: GRAVITY, ..Input::default() };
        anew.step(1e-3, &input).expect("a step");
        self.springs.step(1e-3, &input).expect("a step");
        assert!(anew.state() == self.springs.state(), "springs move alike, to the bit");

        let gone = (0..self.tets.len() as u32).filter(|&tet| self.volume.tet(tet).is_none());
        let gone: Vec<u32> = gone.collect();
        let groups = self.positions.groups();
        let held: Vec<u32> = (0..self.held as u32).collect();
        let body =
            Body { rest, tets: &self.tets, elasticity: Some(MATTER), gone: &gone, groups, ..Body::default() };
        // Two elements of one colour at a node would be rejected.
        let mut anew = Xpbd::new(&body, &held, XpbdConfig::default()).expect("a solver");
        for (tet, of) in (0..).zip(&self.altered).filter(|(_, of)| **of != Alteration::GONE) {
            anew.alter(tet, of.stiffness, of.length);
        }
        anew.restore(self.positions.state().clone()).expect("its state");
        assert_eq!(anew.masses(), self.positions.masses());
        assert_eq!(anew.tets(), self.positions.tets());
        assert_eq!(anew.elastic_energy().to_bits(), self.positions.elastic_energy().to_bits());
        // With new colours the material is the same: only the order of sums differs.
        let other = Body { groups: Default::default(), ..body };
        let mut other = Xpbd::new(&other, &held, XpbdConfig::default()).expect("a solver");
        for (tet, of) in (0..).zip(&self.altered).filter(|(_, of)| **of != Alteration::GONE) {
            other.alter(tet, of.stiffness, of.length);
        }
        other.restore(self.positions.state().clone()).expect("its state");
        let (one, two) = (anew.elastic_energy(), other.elastic_energy());
        assert!((one - two).abs() <= 1e-12 * one.abs(), "{one} J, {two} J");
        let input = XpbdInput { gravity: GRAVITY, ..XpbdInput::default() };
        anew.step(1e-3, &input).expect("a step");
        self.positions.step(1e-3, &input).expect("a step");
        assert!(anew.state() == self.positions.state(), "positions move alike, to the bit");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_volume_that_burns_shrinks_parts_and_is_cut_is_followed_as_if_all_were_made_anew(
        events in prop::collection::vec(event(), 1..25)
    ) {
        let mut apart = Apart::new(3);
        for event in events {
            apart.takes(event);
            apart.agrees();
        }
    }

    #[test]
    fn a_membrane_that_burns_shrinks_and_is_cut_is_followed_as_if_all_were_made_anew(
        events in prop::collection::vec(event(), 1..30)
    ) {
        let mut cloth = Cloth::new(8);
        for event in events {
            cloth.takes(event);
            cloth.agrees();
        }
    }
}

/// A membrane that is cut, with the two solvers updated incrementally.
struct Cloth {
    sheet: Sheet,
    n: u32,
    /// Alteration of each triangle by heat.
    altered: Vec<Alteration>,
    springs: MassSpring,
    network: Network,
    positions: Xpbd,
    derived: usize,
}

/// Corners of a square of 1 cm for each of `n` × `n` cells.
fn grid(n: u32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    // Slightly uneven, so that hinges are bent at rest.
    let up = |i: u32, j: u32| 0.001 * f64::from(i).sin() * f64::from(j).cos();
    let point = |i: u32, j: u32| Point3::new(0.01 * f64::from(i), 0.01 * f64::from(j), up(i, j));
    let points = (0..=n).flat_map(|j| (0..=n).map(move |i| point(i, j))).collect();
    let triangles = (0..n).flat_map(|j| {
        (0..n).flat_map(move |i| {
            let [a, b, c, d] = [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]].map(|[i, j]| j * (n + 1) + i);
            [[a, b, d], [a, d, c]]
        })
    });
    (points, triangles.collect())
}

fn cloth_body<'a>(
    rest: &'a [Point3<f64>],
    network: &'a Network,
    distances: &'a [trocar_simulator::xpbd::Distance],
) -> Body<'a> {
    Body { rest, masses: &network.masses, distances, bends: &network.hinges, ..Body::default() }
}

impl Cloth {
    fn new(n: u32) -> Self {
        let (rest, triangles) = grid(n);
        let network = Network::from_surface(&rest, &triangles, &GAUZE).expect("a network");
        let held: Vec<u32> = (0..=n).collect();
        let distances = distances_of(&network);
        let body = cloth_body(&rest, &network, &distances);
        let positions = Xpbd::new(&body, &held, XpbdConfig::default()).expect("a solver");
        let springs = MassSpring::new(network.clone(), rest.clone(), &held, explicit()).expect("a solver");
        let altered = vec![Alteration::NONE; triangles.len()];
        let sheet = Sheet::new(rest, triangles).expect("a sheet");
        Self { sheet, n, altered, springs, network, positions, derived: 0 }
    }

    fn takes(&mut self, event: Event) {
        self.derived = 0;
        let count = self.sheet.triangles().len();
        let triangle = |at: f64| (at * count as f64) as usize;
        let none = TopologyChange::default();
        match event {
            Event::Burn { at } | Event::Open { at, .. } => {
                let gone = triangle(at);
                let stale = self.sheet.triangles()[gone].to_vec();
                self.sheet.take_out(|triangle| triangle == gone as u32);
                self.altered.remove(gone);
                self.follow(stale, &none);
            }
            Event::Coagulate { at, stiffness, length } => {
                let which = triangle(at);
                self.altered[which] = Alteration { stiffness, length };
                self.follow(self.sheet.triangles()[which].to_vec(), &none);
            }
            Event::Cut { from, along, .. } => {
                let size = 0.01 * f64::from(self.n);
                let edge = |x: f64, y: f64| [Point3::new(x, y, -0.1), Point3::new(x, y, 0.1)];
                let [x, y] = [0, 1].map(|k| from[k] * size);
                let [dx, dy] = [0, 1].map(|k| (along[k] - 0.5) * size);
                let sweep = Sweep { before: edge(x, y), after: edge(x + dx, y + dy) };
                let places = self.springs.state().positions.clone();
                let change = self.sheet.cut(&places, &[sweep]).expect("a cut");
                change.carry_triangles(&mut self.altered);
                self.follow(change.stale.clone(), &change);
            }
        }
    }

    /// Vertices on the border at rest are held.
    fn stays(sheet: &Sheet, vertex: u32) -> bool {
        sheet.rest()[vertex as usize].y == 0.0 || sheet.about(vertex).is_empty()
    }

    fn follow(&mut self, mut stale: Vec<u32>, change: &TopologyChange) {
        stale.sort_unstable();
        stale.dedup();
        let (altered, sheet) = (&self.altered, &self.sheet);
        let patch = ChangedMesh {
            rest: sheet.rest(),
            elements: sheet.triangles(),
            altered: &|triangle| altered[triangle as usize],
            about: &|vertex| sheet.about(vertex),
            stale: &stale,
        };
        let carry = |state: &mut State| {
            change.carry(&mut state.positions, |a, b, share| a + (b - a) * share);
            change.carry(&mut state.velocities, |a, b, share| a + (b - a) * share);
        };
        let stays = |vertex| Self::stays(sheet, vertex);
        let followed = self.network.follow_surface(&patch, &GAUZE).expect("it follows");
        let changed = self
            .positions
            .follow_network(&self.network, &followed, &patch, stays, carry)
            .expect("it follows");
        let followed = self
            .springs
            .follow(&patch, stays, carry, |network, patch| network.follow_surface(patch, &GAUZE))
            .expect("it follows");
        self.derived += followed.edges + followed.nodes + changed;
    }

    fn agrees(&mut self) {
        let (rest, triangles) = (self.sheet.rest(), self.sheet.triangles());
        let all = 0..rest.len() as u32;
        let loose: Vec<u32> = all.clone().filter(|&vertex| self.sheet.about(vertex).is_empty()).collect();
        let fresh = Network::from_altered_surface(rest, triangles, &GAUZE, &self.altered, &loose);
        let fresh = fresh.expect("a network");
        assert!(fresh == *self.springs.network(), "springs, hinges and masses are those of the mesh");
        assert!(fresh == self.network);
        let pinned: Vec<u32> = all.filter(|&vertex| Self::stays(&self.sheet, vertex)).collect();
        assert_eq!(self.springs.pinned(), pinned);
        let state = self.springs.state().clone();
        let mut anew = MassSpring::restore(fresh, state, &pinned, explicit()).expect("a solver");
        assert_eq!(anew.safe_step().to_bits(), self.springs.safe_step().to_bits());
        let input = Input { gravity: GRAVITY, ..Input::default() };
        anew.step(1e-4, &input).expect("a step");
        self.springs.step(1e-4, &input).expect("a step");
        assert!(anew.state() == self.springs.state(), "springs move alike, to the bit");

        let distances = distances_of(&self.network);
        let body = cloth_body(rest, &self.network, &distances);
        let known = Body { groups: self.positions.groups(), ..body.clone() };
        let mut anew = Xpbd::new(&known, &pinned, XpbdConfig::default()).expect("a solver");
        let mut other = Xpbd::new(&body, &pinned, XpbdConfig::default()).expect("a solver");
        anew.restore(self.positions.state().clone()).expect("its state");
        other.restore(self.positions.state().clone()).expect("its state");
        assert_eq!(anew.masses(), self.positions.masses());
        assert_eq!(anew.elastic_energy().to_bits(), self.positions.elastic_energy().to_bits());
        let (one, two) = (anew.elastic_energy(), other.elastic_energy());
        assert!((one - two).abs() <= 1e-12 * one.abs(), "{one} J, {two} J");
        let input = XpbdInput { gravity: GRAVITY, ..XpbdInput::default() };
        anew.step(1e-4, &input).expect("a step");
        self.positions.step(1e-4, &input).expect("a step");
        assert!(anew.state() == self.positions.state(), "positions move alike, to the bit");
    }
}

/// Cost of a change in the middle of a body, by the size of the body.
#[test]
fn what_it_takes_to_follow_is_a_matter_of_the_change_and_not_of_the_body() {
    let mut taken: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for cells in [4, 8, 16] {
        let mut apart = Apart::new(cells);
        let all = apart.tets.len();
        let middle = apart.volume.tets().find(|(_, nodes)| {
            let sum: Vector3<f64> = nodes.iter().map(|&node| apart.volume.rest()[node as usize].coords).sum();
            (sum / 4.0 - Vector3::repeat(0.5 * apart.size - 0.004)).norm() < 0.004
        });
        let at = (f64::from(middle.expect("one in the middle").0) + 0.5) / all as f64;
        // A blade of 8 mm that goes 8 mm far, whatever the size.
        let [low, high] = [-0.0041, 0.0039].map(|from| (0.5 * apart.size + from) / apart.size);
        let by = 0.5 + 0.008 / apart.size;
        let cut = Event::Cut {
            from: [low, low, low],
            to: [low, high, low],
            along: [by, 0.5, 0.5 + 0.001 / apart.size],
        };
        for (name, event) in [
            ("coagulate", Event::Coagulate { at, stiffness: 2.0, length: 0.9 }),
            ("cut", cut),
            ("burn", Event::Burn { at }),
        ] {
            apart.takes(event);
            taken.entry(name).or_default().push(apart.derived);
        }
        apart.agrees();
        let mut cloth = Cloth::new(cells as u32 * 2);
        let mid = 0.5 + 0.003 / (0.02 * cells as f64);
        let along = [0.025, 0.001, 0.0].map(|by| 0.5 + by / (0.02 * cells as f64));
        for (name, event) in [
            ("membrane coagulates", Event::Coagulate { at: 0.55, stiffness: 2.0, length: 0.9 }),
            ("membrane is cut", Event::Cut { from: [mid, mid, 0.0], to: [0.0; 3], along }),
            ("membrane burns", Event::Burn { at: 0.55 }),
        ] {
            cloth.takes(event);
            taken.entry(name).or_default().push(cloth.derived);
        }
        cloth.agrees();
    }
    for (what, taken) in &taken {
        let [small, middle, large] = taken[..] else { panic!("three bodies") };
        assert!(small > 0 && middle > 0 && large > 0, "{what}: {taken:?}");
        // A body with 64 times as many elements.
        assert!(large <= 2 * small && middle <= 2 * small && large < 400, "{what}: {taken:?}");
    }
}
