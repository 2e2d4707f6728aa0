//! Bodies of different methods at different rates, joined at points: a mass ratio of 1:100 at a rate ratio of 10:1 loses
//! no momentum and gains no energy.

use nalgebra::{DMatrix, Point3, Vector3};
use trocar_simulator::coupling::{
    End, Link, LinkConfig, LinkError, PointWeights, RigidPoints, WeightedNodes, inverse_masses,
};
use trocar_simulator::dynamic_fem::{Config, DynamicFem, DynamicFemState, Inputs};
use trocar_simulator::elasticity::Elastic;
use trocar_simulator::mass_spring::NodeForce;
use trocar_simulator::rigid::{ContactConfig, Integrator, RigidBodies, RigidMass, RigidState};
use trocar_simulator::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::thread::{Load, Surroundings, Thread, ThreadMaterial};
use trocar_simulator::xpbd::{Body, Distance, Xpbd, XpbdConfig, XpbdInput};

const FAST: f64 = 1e-3;
const SLOW: f64 = 1e-2;
const RATE: usize = 10;
/// What momentum may be lost of what was exchanged.
const MOMENTUM: f64 = 1e-6;

/// A mass that flies.
struct Mass {
    mass: f64,
    place: Point3<f64>,
    velocity: Vector3<f64>,
}

impl Mass {
    fn pair(fast: f64, slow: f64) -> [Self; 2] {
        let at = |mass, velocity| Self { mass, place: Point3::origin(), velocity };
        [at(fast, Vector3::new(0.4, 0.0, -0.1)), at(slow, Vector3::new(-0.1, 0.2, 0.0))]
    }

    fn fly(&mut self, impulse: &Vector3<f64>, dt: f64) {
        self.velocity += impulse / self.mass;
        self.place += self.velocity * dt;
    }

    fn energy(&self) -> f64 {
        0.5 * self.mass * self.velocity.norm_squared()
    }
}

const SPRING: LinkConfig = LinkConfig { stiffness: 1000.0, damping: 0.0 };

/// Largest energy at any meeting over that at the beginning, momentum lost over what was exchanged, and how far apart the
/// masses were at most.
fn linked(masses: [f64; 2], config: LinkConfig) -> [f64; 3] {
    let [mut fast, mut slow] = Mass::pair(masses[0], masses[1]);
    let weightless = masses.map(|mass| DMatrix::identity(3, 3) / mass);
    let mut link =
        Link::new(config, [&[fast.place], &[slow.place]], &[slow.velocity], weightless).expect("a link");
    let before = fast.velocity * fast.mass + slow.velocity * slow.mass;
    let first = fast.energy() + slow.energy();
    let (mut most, mut apart, mut impulses) = (0.0_f64, 0.0_f64, Vec::new());
    let mut last = first;
    for _ in 0..500 {
        for _ in 0..RATE {
            let impulse = link.fast(FAST, &[fast.place], &[fast.velocity]).expect("numbers")[0];
            fast.fly(&impulse, FAST);
        }
        link.slow(&mut impulses);
        slow.fly(&impulses[0], SLOW);
        link.moved(&[slow.place], &[slow.velocity]).expect("numbers");
        let energy = fast.energy() + slow.energy() + link.energy() + link.state().tank;
        assert!(energy <= last * (1.0 + 1e-12), "{energy} J after {last} J");
        last = energy;
        most = most.max(fast.energy() + slow.energy() + link.energy());
        apart = apart.max((fast.place - slow.place).norm());
    }
    let lost = (fast.velocity * fast.mass + slow.velocity * slow.mass - before).norm();
    [most / first, lost / link.state().exchanged, apart]
}

/// The control: the faster mass on a spring to where the slower one was last, which takes the mean force.
fn held(masses: [f64; 2]) -> f64 {
    let mut pair = Mass::pair(masses[0], masses[1]);
    let first: f64 = pair.iter().map(Mass::energy).sum();
    let mut most = 0.0_f64;
    for _ in 0..500 {
        let [fast, slow] = &mut pair;
        let mut sum = Vector3::zeros();
        for _ in 0..RATE {
            let impulse = (slow.place - fast.place) * (SPRING.stiffness * FAST);
            fast.fly(&impulse, FAST);
            sum -= impulse;
        }
        slow.fly(&sum, SLOW);
        most = most.max(pair.iter().map(Mass::energy).sum());
    }
    most / first
}

#[test]
fn masses_of_one_to_a_hundred_at_rates_of_ten_to_one_keep_momentum_and_gain_no_energy() {
    for masses in [[1e-3, 0.1], [0.1, 1e-3], [0.1, 0.1]] {
        for damping in [0.0, 0.5] {
            let [energy, lost, apart] = linked(masses, LinkConfig { damping, ..SPRING });
            assert!(lost <= MOMENTUM, "{masses:?}: {lost:e} of the momentum exchanged");
            assert!(energy <= 1.0, "{masses:?}: {energy} of the energy there was");
            assert!(apart < 0.02, "{masses:?}: {apart} m apart");
        }
        assert!(held(masses) > 1.05, "the control gains: {} at {masses:?}", held(masses));
    }
}

/// A block of 30 mm and 27 g that flies and turns, stepped every 10 ms.
struct Organ {
    body: DynamicFem,
    inverse: Vec<f64>,
    points: Vec<PointWeights>,
    forces: Vec<(u32, Vector3<f64>)>,
}

const DENSITY: f64 = 1000.0;

impl Organ {
    fn new(points: impl Fn(&TetMesh) -> Vec<PointWeights>) -> Self {
        let grid = BoxCells { cells: [3; 3], size: Vector3::repeat(0.03), origin: Point3::origin() };
        let (nodes, tets) = box_cells(&grid);
        let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh");
        let points = points(&mesh);
        let config = Config { tolerance: 1e-10, density: DENSITY, ..Config::default() };
        let mut body = DynamicFem::new(mesh, &Elastic::new(5e3, 0.4).expect("a material"), &config, &[])
            .expect("a body");
        let spin = Vector3::new(0.5, 0.0, 2.0);
        let state = body.state();
        let velocities =
            state.positions.iter().map(|at| Vector3::new(0.1, 0.0, 0.0) + spin.cross(&at.coords));
        body.restore(&DynamicFemState { velocities: velocities.collect(), ..state.clone() })
            .expect("its own");
        let inverse = inverse_masses(&body, DENSITY, &[]);
        Self { body, inverse, points, forces: Vec::new() }
    }

    fn end(&self) -> WeightedNodes<'_> {
        WeightedNodes {
            points: &self.points,
            positions: self.body.positions(),
            velocities: self.body.velocities(),
            inverse_masses: &self.inverse,
        }
    }

    fn momentum(&self) -> Vector3<f64> {
        self.body.velocities().iter().zip(&self.inverse).map(|(velocity, inverse)| velocity / *inverse).sum()
    }

    fn energy(&self) -> f64 {
        let energies = self.body.energies();
        energies.kinetic + energies.elastic
    }

    fn step(&mut self, link: &mut Link, room: &mut Room) {
        link.slow(&mut room.impulses);
        self.forces.clear();
        WeightedNodes::forces(&self.points, &room.impulses, SLOW, &mut self.forces);
        let inputs = Inputs { forces: &self.forces, ..Inputs::default() };
        assert!(self.body.step(SLOW, &inputs).expect("a step").solved);
        let end = WeightedNodes {
            points: &self.points,
            positions: self.body.positions(),
            velocities: self.body.velocities(),
            inverse_masses: &self.inverse,
        };
        end.places(&mut room.places);
        end.velocities(&mut room.velocities);
        link.moved(&room.places, &room.velocities).expect("numbers");
    }
}

#[derive(Default)]
struct Room {
    places: Vec<Point3<f64>>,
    velocities: Vec<Vector3<f64>>,
    impulses: Vec<Vector3<f64>>,
}

fn link(config: LinkConfig, fast: &dyn End, slow: &dyn End) -> Link {
    let (mut room, mut other) = (Room::default(), Room::default());
    fast.places(&mut room.places);
    slow.places(&mut other.places);
    slow.velocities(&mut other.velocities);
    let mobilities = [fast.mobility(), slow.mobility()];
    Link::new(config, [&room.places, &other.places], &other.velocities, mobilities).expect("a link")
}

/// Runs for half a second. The faster body tells its momentum and its energy; where it cannot tell `all` of the latter,
/// which is least at the beginning then, what there is is compared with that.
fn run<F>(
    mut organ: Organ,
    mut link: Link,
    fast: &mut F,
    all: bool,
    step: impl Fn(&mut F, &mut Link, &mut Room),
    told: impl Fn(&F) -> (Vector3<f64>, f64),
) {
    let mut room = Room::default();
    let (momentum, energy) = told(fast);
    let (first, mut last) = (momentum + organ.momentum(), energy + organ.energy());
    let begin = last;
    for _ in 0..50 {
        for _ in 0..RATE {
            step(fast, &mut link, &mut room);
        }
        organ.step(&mut link, &mut room);
        let (momentum, energy) = told(fast);
        let lost = (momentum + organ.momentum() - first).norm();
        assert!(lost <= MOMENTUM * link.state().exchanged, "{lost:e} of {}", link.state().exchanged);
        let energy = energy + organ.energy() + link.energy() + link.state().tank;
        assert!(energy <= last + 1e-9 * begin, "{energy} J after {last} J");
        if all {
            last = energy;
        }
    }
    assert!(link.state().exchanged > 1e-5, "they pulled at each other: {} N·s", link.state().exchanged);
}

const TISSUE: LinkConfig = LinkConfig { stiffness: 200.0, damping: 0.01 };

#[test]
fn a_membrane_of_positions_is_carried_by_finite_elements() {
    let organ = Organ::new(|mesh| {
        let top = |node: &u32| mesh.rest()[*node as usize].z > 0.03 - 1e-9;
        (0..mesh.rest().len() as u32).filter(top).map(|node| vec![(node, 1.0)]).collect()
    });
    let mut room = Room::default();
    organ.end().places(&mut room.places);
    let rest = room.places.clone();
    // A hundredth of the organ's mass.
    let masses = vec![0.27e-3 / rest.len() as f64; rest.len()];
    let mut distances = Vec::new();
    for a in 0..rest.len() as u32 {
        for b in 0..a {
            let length = (rest[a as usize] - rest[b as usize]).norm();
            if length < 0.0145 {
                distances.push(Distance { nodes: [a, b], rest: length, compliance: 0.01 });
            }
        }
    }
    let body = Body { rest: &rest, masses: &masses, distances: &distances, ..Body::default() };
    let config = XpbdConfig { parts: 1, iterations: 20, ..XpbdConfig::default() };
    let mut membrane = Xpbd::new(&body, &[], config).expect("a membrane");
    let mut state = membrane.state().clone();
    state.velocities.iter_mut().for_each(|velocity| *velocity = Vector3::new(-0.2, 0.1, 0.5));
    membrane.restore(state).expect("its own nodes");
    let points: Vec<PointWeights> = (0..rest.len() as u32).map(|node| vec![(node, 1.0)]).collect();
    let inverse: Vec<f64> = masses.iter().map(|mass| mass.recip()).collect();
    let end = |membrane: &Xpbd, act: &mut dyn FnMut(&WeightedNodes<'_>)| {
        let state = membrane.state();
        act(&WeightedNodes {
            points: &points,
            positions: &state.positions,
            velocities: &state.velocities,
            inverse_masses: &inverse,
        });
    };
    let mut joined = None;
    end(&membrane, &mut |end| joined = Some(link(TISSUE, end, &organ.end())));
    let step = |membrane: &mut Xpbd, link: &mut Link, room: &mut Room| {
        let state = membrane.state();
        let impulses = link.fast(FAST, &state.positions, &state.velocities).expect("numbers");
        let forces = impulses.iter().enumerate();
        let forces: Vec<NodeForce> =
            forces.map(|(node, impulse)| NodeForce { node: node as u32, force: impulse / FAST }).collect();
        membrane.step(FAST, &XpbdInput { forces: &forces, ..XpbdInput::default() }).expect("a step");
        room.places.clear();
    };
    run(organ, joined.expect("a link"), &mut membrane, true, step, |membrane| {
        let state = membrane.state();
        let kinetic: f64 = state.velocities.iter().map(|v| 0.5 * masses[0] * v.norm_squared()).sum();
        let elastic = distances.iter().map(|distance| {
            let [a, b] = distance.nodes.map(|node| state.positions[node as usize]);
            0.5 * ((b - a).norm() - distance.rest).powi(2) / distance.compliance
        });
        (state.velocities.iter().map(|v| v * masses[0]).sum(), kinetic + elastic.sum::<f64>())
    });
}

#[test]
fn a_thread_pulls_at_finite_elements_with_its_end() {
    let organ = Organ::new(|mesh| {
        let (tet, weights) = mesh.locate(&Point3::new(0.014, 0.016, 0.027)).expect("inside");
        vec![mesh.tets()[tet].into_iter().zip(weights).collect()]
    });
    let mut room = Room::default();
    organ.end().places(&mut room.places);
    let begin = room.places[0];
    let positions: Vec<_> = (0..20).map(|k| begin + Vector3::new(0.0, 0.0, 0.004 * f64::from(k))).collect();
    // No air about it, so that nothing but the organ takes its momentum.
    let material = ThreadMaterial { drag: 0.0, mass_per_length: 3.5e-3, ..ThreadMaterial::silk_2_0() };
    let mut thread = Thread::new(material, &positions).expect("a thread");
    let mut state = thread.state().clone();
    state.velocities.iter_mut().for_each(|velocity| *velocity = Vector3::new(0.3, 0.0, 0.2));
    thread = Thread::restore(material, state).expect("its own state");
    let mass = |node: usize| {
        let length = thread_length(node, positions.len());
        material.mass_per_length * length
    };
    let inverse: Vec<f64> = (0..positions.len()).map(|node| mass(node).recip()).collect();
    let points: Vec<PointWeights> = vec![vec![(0, 1.0)]];
    let joined = {
        let state = thread.state();
        let end = WeightedNodes {
            points: &points,
            positions: &state.positions,
            velocities: &state.velocities,
            inverse_masses: &inverse,
        };
        link(TISSUE, &end, &organ.end())
    };
    let step = |thread: &mut Thread, link: &mut Link, _: &mut Room| {
        let state = thread.state();
        let impulse = link.fast(FAST, &state.positions[..1], &state.velocities[..1]).expect("numbers")[0];
        let loads = [Load { node: 0, force: impulse / FAST }];
        thread.step(FAST, &Surroundings { loads: &loads, ..Surroundings::default() }).expect("a step");
    };
    // Its springs are at rest in the beginning: without their energy it is to be less all the same.
    run(organ, joined, &mut thread, false, step, |thread| {
        let nodes = thread.state().velocities.iter().enumerate();
        let kinetic = nodes.clone().map(|(node, v)| 0.5 * mass(node) * v.norm_squared()).sum();
        (nodes.map(|(node, v)| v * mass(node)).sum(), kinetic)
    });
}

/// Length of thread that belongs to a node.
fn thread_length(node: usize, nodes: usize) -> f64 {
    if node == 0 || node + 1 == nodes { 0.002 } else { 0.004 }
}

#[test]
fn a_rigid_needle_sticks_in_finite_elements() {
    let deep = [0.012, 0.017, 0.022].map(|z| Point3::new(0.015, 0.014, z));
    let organ = Organ::new(|mesh| {
        deep.map(|at| {
            let (tet, weights) = mesh.locate(&at).expect("inside");
            mesh.tets()[tet].into_iter().zip(weights).collect()
        })
        .to_vec()
    });
    let mass = RigidMass { mass: 0.27e-3, inertia: Vector3::new(1e-8, 1e-8, 1e-10) };
    let middle = Point3::new(0.015, 0.014, 0.025);
    let in_body = deep.map(|at| Point3::from(at - middle));
    let state = RigidState {
        position: middle,
        rotation: nalgebra::UnitQuaternion::identity(),
        momentum: Vector3::new(0.0, 0.3, 0.2) * mass.mass,
        angular_momentum: Vector3::new(2e-7, 0.0, 0.0),
    };
    let bodies = || {
        RigidBodies::new(
            &[mass],
            &[state],
            Vector3::zeros(),
            Integrator::Symplectic,
            ContactConfig::default(),
        )
        .expect("a needle")
    };
    let mut needle = bodies();
    let joined =
        link(TISSUE, &RigidPoints { mass: &mass, state: &state, points_in_body: &in_body }, &organ.end());
    let slow = organ.end().mobility();
    let step = |needle: &mut RigidBodies, link: &mut Link, room: &mut Room| {
        let state = needle.states()[0];
        let end = RigidPoints { mass: &mass, state: &state, points_in_body: &in_body };
        end.places(&mut room.places);
        end.velocities(&mut room.velocities);
        link.set_mobilities(&end.mobility(), &slow).expect("of its size");
        let impulses = link.fast(FAST, &room.places, &room.velocities).expect("numbers");
        for (impulse, at) in impulses.iter().zip(&room.places) {
            needle.strike(0, impulse, at).expect("a needle");
        }
        needle.step(FAST, &[], &[]).expect("a step");
    };
    run(organ, joined, &mut needle, true, step, |needle| {
        (needle.states()[0].momentum, mass.kinetic_energy(&needle.states()[0]))
    });
}

#[test]
fn a_restored_link_continues_bit_for_bit_and_nonsense_is_refused() {
    let unit = || [DMatrix::identity(3, 3), DMatrix::identity(3, 3)];
    let at = [Point3::origin()];
    let still = [Vector3::zeros()];
    let make = || Link::new(SPRING, [&at, &at], &still, unit()).expect("a link");
    let mut one = make();
    let drive = |link: &mut Link, step: usize| {
        let place = Point3::new(0.01 * (step as f64 * 0.3).sin(), 0.0, 0.001);
        link.fast(FAST, &[place], &[Vector3::new(1.0, 0.1, 0.0)]).expect("numbers")[0]
    };
    (0..20).for_each(|step| {
        drive(&mut one, step);
    });
    let mut other = make();
    other.restore(one.state().clone()).expect("its own state");
    for step in 20..60 {
        assert_eq!(drive(&mut one, step), drive(&mut other, step));
    }
    let before = one.state().clone();
    let nan = [Vector3::repeat(f64::NAN)];
    assert_eq!(one.fast(FAST, &at, &nan), Err(LinkError::Number("a velocity")));
    assert_eq!(one.fast(0.0, &at, &still), Err(LinkError::Step(0.0)));
    let none: [Vector3<f64>; 0] = [];
    assert!(matches!(one.fast(FAST, &at, &none), Err(LinkError::Size { found: 0, expected: 1, .. })));
    assert!(matches!(one.moved(&[], &still), Err(LinkError::Size { .. })));
    assert_eq!(one.state(), &before);
    let wrong = LinkConfig { stiffness: -1.0, damping: 0.0 };
    assert!(matches!(Link::new(wrong, [&at, &at], &still, unit()), Err(LinkError::Config { .. })));
    assert!(matches!(Link::new(SPRING, [&[], &[]], &[], unit()), Err(LinkError::Points(0))));
}
