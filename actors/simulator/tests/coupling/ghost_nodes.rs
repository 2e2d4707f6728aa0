//! Coupling of bodies of different methods at different rates by ghost nodes: at a mass ratio of 1:100 and a rate ratio
//! of 10:1, no momentum is lost and no energy gained.

use nalgebra::{Point3, Vector3};
use trocar_collision::Surface;
use trocar_dynamics::coupling::external_nodes::{ExternalNodes, GhostMoved, GhostNode, NodeContact, Tie};
use trocar_dynamics::coupling::{
    GhostNodes, GhostNodesError, SlowBodyReport, SurfaceContactParams, SurfaceContacts,
};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::particles::State;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::dynamic_fem::{Config, DynamicFem, DynamicFemState, Inputs};
use trocar_simulator::xpbd::{Body, Distance, Xpbd, XpbdConfig, XpbdInput};

const FAST: f64 = 1e-3;
const SLOW: f64 = 1e-2;
const RATE: usize = 10;
/// Largest momentum loss relative to the exchanged momentum.
const MOMENTUM: f64 = 1e-6;

/// A faster body and its ghost nodes.
struct Faster {
    body: Xpbd,
    ghosts: GhostNodes,
    ties: Vec<Tie>,
    presses: Vec<NodeContact>,
    ghost_nodes: Vec<GhostNode>,
}

impl Faster {
    fn new(body: Xpbd, ghosts: &[Point3<f64>], ties: Vec<Tie>) -> Self {
        let ghosts = GhostNodes::new(ghosts).expect("numbers");
        Self { body, ghosts, ties, presses: Vec::new(), ghost_nodes: Vec::new() }
    }

    fn step(&mut self, gravity: Vector3<f64>) {
        let Self { body, ghosts, ties, presses, ghost_nodes } = self;
        let external_nodes = ExternalNodes { ghost_nodes: &[], ties, presses };
        ghost_nodes.clear();
        ghosts.begin_step(&external_nodes, &body.state().positions, ghost_nodes);
        let external_nodes = ExternalNodes { ghost_nodes, ..external_nodes };
        body.step(FAST, &XpbdInput { gravity, external_nodes, ..XpbdInput::default() }).expect("a step");
        let moved = body.external_nodes();
        let lost: f64 =
            moved.ties.iter().map(|tied| tied.lost).chain(moved.presses.iter().map(|p| p.lost)).sum();
        ghosts.end_step(FAST, &moved.ghost_nodes, lost);
    }

    fn momentum(&self) -> Vector3<f64> {
        self.body.state().velocities.iter().zip(self.body.masses()).map(|(v, mass)| v * *mass).sum()
    }

    /// Its own, and that of the springs.
    fn energy(&self) -> f64 {
        let apart = |tie: &Tie| {
            let at = tie.ghost_nodes.iter().fold(Vector3::zeros(), |sum, &(ghost, weight)| {
                sum + self.ghosts.positions()[ghost as usize].coords * weight
            });
            self.body.state().positions[tie.node as usize].coords - at
        };
        let ties: f64 = self.ties.iter().map(|tie| 0.5 * tie.stiffness * apart(tie).norm_squared()).sum();
        self.body.kinetic_energy() + self.body.elastic_energy() + ties
    }
}

fn tie(node: u32, ghost: u32, stiffness: f64, damping: f64) -> Tie {
    Tie { node, ghost_nodes: [(ghost, 1.0), (ghost, 0.0), (ghost, 0.0), (ghost, 0.0)], stiffness, damping }
}

/// Free-flying point masses.
fn loose(masses: &[f64], places: &[Point3<f64>], velocities: &[Vector3<f64>]) -> Xpbd {
    let body = Body { rest: places, masses, ..Body::default() };
    let config = XpbdConfig { parts: 1, ..XpbdConfig::default() };
    let mut body = Xpbd::new(&body, &[], config).expect("masses");
    let mut state = body.state().clone();
    state.velocities.copy_from_slice(velocities);
    body.restore(state).expect("its own nodes");
    body
}

/// A free-flying mass.
struct Mass {
    mass: f64,
    place: Point3<f64>,
    velocity: Vector3<f64>,
    taken: Vector3<f64>,
    last: Vector3<f64>,
    received: f64,
    given_work: f64,
}

impl Mass {
    fn new(mass: f64) -> Self {
        let velocity = Vector3::new(-0.1, 0.2, 0.0);
        let (place, taken) = (Point3::origin(), Vector3::zeros());
        Self { mass, place, velocity, taken, last: taken, received: 0.0, given_work: 0.0 }
    }

    fn tell(&self, ghosts: &mut GhostNodes) {
        let news = SlowBodyReport {
            positions: &[self.place],
            velocities: &[self.velocity],
            expected: &[self.velocity + self.last / self.mass],
            mobilities: &[self.mass.recip()],
            masses_inverse: &[self.mass.recip()],
            last: &[self.last],
            given_work: self.given_work,
            received: self.received,
            steps: ghosts.steps(),
            step: SLOW,
        };
        ghosts.receive(&news).expect("numbers");
    }

    fn step(&mut self, ghosts: &mut GhostNodes) {
        let impulse = ghosts.given()[0] - self.taken;
        let before = self.velocity;
        self.velocity += impulse / self.mass;
        self.place += self.velocity * SLOW;
        self.taken = ghosts.given()[0];
        self.last = impulse;
        self.received += impulse.dot(&(0.5 * (before + self.velocity)));
        self.given_work = ghosts.work();
        self.tell(ghosts);
    }

    fn energy(&self) -> f64 {
        0.5 * self.mass * self.velocity.norm_squared()
    }
}

const STIFFNESS: f64 = 1000.0;
const THROWN: Vector3<f64> = Vector3::new(0.4, 0.0, -0.1);

/// Largest relative energy at any exchange, momentum lost relative to the exchanged momentum, and largest distance of
/// the masses.
fn linked(masses: [f64; 2], damping: f64) -> [f64; 3] {
    let mut slow = Mass::new(masses[1]);
    let body = loose(&masses[..1], &[slow.place], &[THROWN]);
    let mut fast = Faster::new(body, &[slow.place], vec![tie(0, 0, STIFFNESS, damping)]);
    slow.tell(&mut fast.ghosts);
    let before = fast.momentum() + slow.velocity * slow.mass;
    let first = fast.energy() + slow.energy();
    let (mut most, mut apart, mut last) = (0.0_f64, 0.0_f64, first);
    for _ in 0..500 {
        (0..RATE).for_each(|_| fast.step(Vector3::zeros()));
        slow.step(&mut fast.ghosts);
        let energy = fast.energy() + slow.energy() + fast.ghosts.tank();
        assert!(energy <= last * (1.0 + 1e-9), "{energy} J after {last} J");
        last = energy;
        most = most.max(fast.energy() + slow.energy());
        apart = apart.max((fast.body.state().positions[0] - slow.place).norm());
    }
    let lost = (fast.momentum() + slow.velocity * slow.mass - before).norm();
    [most / first, lost / fast.ghosts.exchanged(), apart]
}

/// The control: the faster mass on a spring to the slower one's last position, with the mean force applied to the
/// slower one.
fn held(masses: [f64; 2]) -> f64 {
    let [mut fast, mut slow] = masses.map(Mass::new);
    fast.velocity = THROWN;
    let first = fast.energy() + slow.energy();
    let mut most = 0.0_f64;
    for _ in 0..500 {
        let mut sum = Vector3::zeros();
        for _ in 0..RATE {
            let impulse = (slow.place - fast.place) * (STIFFNESS * FAST);
            fast.velocity += impulse / fast.mass;
            fast.place += fast.velocity * FAST;
            sum -= impulse;
        }
        slow.velocity += sum / slow.mass;
        slow.place += slow.velocity * SLOW;
        most = most.max(fast.energy() + slow.energy());
    }
    most / first
}

#[test]
fn masses_of_one_to_a_hundred_at_rates_of_ten_to_one_keep_momentum_and_gain_no_energy() {
    for masses in [[1e-3, 0.1], [0.1, 1e-3], [0.1, 0.1]] {
        for damping in [0.0, 0.5] {
            let [energy, lost, apart] = linked(masses, damping);
            assert!(lost <= MOMENTUM, "{masses:?}: {lost:e} of the momentum exchanged");
            assert!(energy <= 1.0, "{masses:?}: {energy} of the energy there was");
            assert!(apart < 0.02, "{masses:?}: {apart} m apart");
        }
        assert!(held(masses) > 1.05, "the control gains: {} at {masses:?}", held(masses));
    }
}

/// A block of 30 mm and 27 g, stepped every 10 ms.
struct Organ {
    body: DynamicFem,
    masses: Vec<f64>,
    /// Its nodes with ghosts.
    ghosts: Vec<u32>,
    taken: Vec<Vector3<f64>>,
    /// The impulses that it took last.
    last: Vec<Vector3<f64>>,
    received: f64,
    given_work: f64,
    steps: u64,
    forces: Vec<(u32, Vector3<f64>)>,
}

const DENSITY: f64 = 1000.0;

impl Organ {
    fn new(fixed: impl Fn(&Point3<f64>) -> bool, config: Config) -> Self {
        let grid = BoxCells { cells: [3; 3], size: Vector3::repeat(0.03), origin: Point3::origin() };
        let (nodes, tets) = box_cells(&grid);
        let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh");
        let masses = mesh.lumped_masses(DENSITY);
        let on_top = |node: &u32| nodes[*node as usize].z > 0.03 - 1e-9;
        let ghosts: Vec<u32> = (0..nodes.len() as u32).filter(on_top).collect();
        let held: Vec<u32> = (0..nodes.len() as u32).filter(|&node| fixed(&nodes[node as usize])).collect();
        let config = Config { tolerance: 1e-10, density: DENSITY, ..config };
        let body = DynamicFem::new(mesh, &Elastic::new(5e3, 0.4).expect("a material"), &config, &held)
            .expect("a body");
        let taken = vec![Vector3::zeros(); ghosts.len()];
        Self {
            body,
            masses,
            ghosts,
            last: taken.clone(),
            taken,
            received: 0.0,
            given_work: 0.0,
            steps: 0,
            forces: Vec::new(),
        }
    }

    /// Flying and rotating.
    fn thrown() -> Self {
        let mut organ = Self::new(|_| false, Config::default());
        let spin = Vector3::new(0.5, 0.0, 2.0);
        let state = organ.body.state();
        let moving = |at: &Point3<f64>| Vector3::new(0.1, 0.0, 0.0) + spin.cross(&at.coords);
        let velocities = state.positions.iter().map(moving).collect();
        organ.body.restore(&DynamicFemState { velocities, ..state.clone() }).expect("its own");
        organ
    }

    fn places(&self) -> Vec<Point3<f64>> {
        self.ghosts.iter().map(|&node| self.body.positions()[node as usize]).collect()
    }

    /// Triangles of the top, by ghost number.
    fn top(&self) -> Vec<[u32; 3]> {
        let number = |node: u32| self.ghosts.iter().position(|&ghost| ghost == node).map(|at| at as u32);
        let surface = self.body.mesh().surface();
        let of_top = surface.iter().filter_map(|&[a, b, c]| Some([number(a)?, number(b)?, number(c)?]));
        of_top.collect()
    }

    fn momentum(&self) -> Vector3<f64> {
        self.body.velocities().iter().zip(&self.masses).map(|(velocity, mass)| velocity * *mass).sum()
    }

    fn energy(&self) -> f64 {
        let energies = self.body.energies();
        energies.kinetic + energies.elastic
    }

    fn tell(&mut self, ghosts: &mut GhostNodes, gravity: Vector3<f64>) {
        let inputs = Inputs { forces: &self.forces, acceleration: gravity, ..Inputs::default() };
        let mut all = Vec::new();
        self.body.expected(SLOW, &inputs, &mut all);
        let expected: Vec<_> = self.ghosts.iter().map(|&node| all[node as usize]).collect();
        let velocities: Vec<_> =
            self.ghosts.iter().map(|&node| self.body.velocities()[node as usize]).collect();
        let active: Vec<usize> =
            (0..self.ghosts.len()).filter(|&ghost| self.last[ghost] != Vector3::zeros()).collect();
        let masses_inverse: Vec<f64> =
            self.ghosts.iter().map(|&node| self.masses[node as usize].recip()).collect();
        let mut mobilities = masses_inverse.clone();
        let nodes: Vec<u32> = active.iter().map(|&ghost| self.ghosts[ghost]).collect();
        let yielding = self.body.yielding(SLOW, &nodes);
        active.iter().zip(yielding).for_each(|(&ghost, yielding)| mobilities[ghost] = yielding);
        let news = SlowBodyReport {
            positions: &self.places(),
            velocities: &velocities,
            expected: &expected,
            mobilities: &mobilities,
            masses_inverse: &masses_inverse,
            last: &self.last,
            given_work: self.given_work,
            received: self.received,
            steps: self.steps,
            step: SLOW,
        };
        ghosts.receive(&news).expect("numbers");
    }

    fn tell_when(&mut self, now: bool, ghosts: &mut GhostNodes, gravity: Vector3<f64>) {
        if now {
            self.tell(ghosts, gravity);
        }
    }

    fn step(&mut self, ghosts: &GhostNodes, gravity: Vector3<f64>) {
        self.forces.clear();
        let owed = ghosts.given().iter().zip(&self.taken).map(|(given, taken)| (given - taken) / SLOW);
        self.forces.extend(self.ghosts.iter().copied().zip(owed));
        let speeds = |body: &DynamicFem| -> Vec<Vector3<f64>> {
            self.ghosts.iter().map(|&node| body.velocities()[node as usize]).collect()
        };
        let before = speeds(&self.body);
        let inputs = Inputs { forces: &self.forces, acceleration: gravity, ..Inputs::default() };
        assert!(self.body.step(SLOW, &inputs).expect("a step").solved);
        for ((_, force), (after, before)) in self.forces.iter().zip(speeds(&self.body).iter().zip(&before)) {
            self.received += force.dot(&(0.5 * SLOW * (after + before)));
        }
        self.last.iter_mut().zip(ghosts.given().iter().zip(&self.taken)).for_each(|(l, (g, t))| *l = g - t);
        self.taken.copy_from_slice(ghosts.given());
        self.given_work = ghosts.work();
        self.steps = ghosts.steps();
    }
}

/// Delay of the slower body's state in steps of the faster one: none, and the largest in live mode.
const LATE: [usize; 2] = [0, 6];

/// A membrane of a hundredth of the organ's mass that covers its top.
fn membrane(organ: &Organ, velocity: Vector3<f64>) -> Faster {
    let rest = organ.places();
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
    let mut body = Xpbd::new(&body, &[], config).expect("a membrane");
    let mut state = body.state().clone();
    state.velocities.fill(velocity);
    body.restore(state).expect("its own nodes");
    let ties = (0..rest.len() as u32).map(|node| tie(node, node, 200.0, 0.01)).collect();
    Faster::new(body, &rest, ties)
}

#[test]
fn a_membrane_of_positions_is_carried_by_finite_elements() {
    for late in LATE {
        let mut organ = Organ::thrown();
        let mut fast = membrane(&organ, Vector3::new(-0.2, 0.1, 0.5));
        let first = fast.momentum() + organ.momentum();
        let begin = fast.energy() + organ.energy();
        let mut most = 0.0_f64;
        for _ in 0..50 {
            for step in 0..RATE {
                organ.tell_when(step == late, &mut fast.ghosts, Vector3::zeros());
                fast.step(Vector3::zeros());
            }
            organ.step(&fast.ghosts, Vector3::zeros());
            let lost = (fast.momentum() + organ.momentum() - first).norm();
            let exchanged = fast.ghosts.exchanged();
            assert!(lost <= MOMENTUM * exchanged, "{lost:e} of {exchanged} N·s");
            let energy = fast.energy() + organ.energy();
            most = most.max(energy);
        }
        assert!(most <= begin, "{most} J of {begin} J");
        let exchanged = fast.ghosts.exchanged();
        assert!(exchanged > 1e-5, "they pulled at each other: {exchanged} N·s");
        let apart = fast.body.state().positions.iter().zip(organ.places()).map(|(a, b)| (a - b).norm());
        let apart = apart.fold(0.0, f64::max);
        assert!(apart < 1e-4, "{apart} m apart");
    }
}

#[test]
fn what_hangs_from_finite_elements_hangs_still() {
    // The block is held at its lower side; a mass is pulled upwards at the middle of its top by 0.2 N.
    for (mass, late) in [0.02, 2e-5].into_iter().flat_map(|mass| LATE.map(|late| (mass, late))) {
        let config = Config { stiffness_damping: 0.005, ..Config::default() };
        let mut organ = Organ::new(|at| at.z < 1e-9, config);
        let (middle, _) = organ
            .places()
            .into_iter()
            .enumerate()
            .min_by(|a, b| (a.1.x - 0.01).hypot(a.1.y - 0.01).total_cmp(&(b.1.x - 0.01).hypot(b.1.y - 0.01)))
            .expect("a node");
        let place = organ.places()[middle];
        let body = loose(&[mass], &[place], &[Vector3::zeros()]);
        let mut fast = Faster::new(body, &organ.places(), vec![tie(0, middle as u32, 500.0, 0.1)]);
        let pull = Vector3::z() * (0.2 / mass);
        let mut heights = Vec::new();
        for period in 0..400 {
            for step in 0..RATE {
                organ.tell_when(step == late, &mut fast.ghosts, Vector3::zeros());
                fast.step(pull);
                if period >= 350 {
                    heights
                        .push([fast.body.state().positions[0].z, fast.body.external_nodes().ties[0].force.z]);
                }
            }
            organ.step(&fast.ghosts, Vector3::zeros());
        }
        let range = |k: usize| {
            let of = || heights.iter().map(|h| h[k]);
            [of().fold(f64::INFINITY, f64::min), of().fold(f64::NEG_INFINITY, f64::max)]
        };
        let [low, high] = range(0);
        let [weak, strong] = range(1);
        // The same under the same force without ghosts.
        let mut alone = Organ::new(|at| at.z < 1e-9, config);
        let force = [(alone.ghosts[middle], Vector3::z() * 0.2)];
        for _ in 0..400 {
            alone.body.step(SLOW, &Inputs { forces: &force, ..Inputs::default() }).expect("a step");
        }
        let expected = alone.places()[middle].z;
        let at = organ.places()[middle].z;
        assert!((at - expected).abs() < 1e-5 * (expected - 0.03), "{at} for {expected}");
        let off = (strong + 0.2).abs().max((weak + 0.2).abs());
        assert!(off < 1e-5, "{weak} to {strong} N");
        assert!(high - low < 1e-7, "{low} to {high} m");
        assert!(
            (high - at - 0.2 / 500.0).abs() < 1e-7,
            "the spring is as long as its force asks for: {}",
            high - at
        );
    }
}

/// Masses of a gram each just above the block, and gravity.
fn laid(organ: &Organ, tilt: f64) -> (Faster, Vector3<f64>) {
    let places: Vec<Point3<f64>> =
        [[0.012, 0.012], [0.019, 0.011], [0.014, 0.018]].map(|[x, y]| Point3::new(x, y, 0.031)).to_vec();
    let body = loose(&[1e-3; 3], &places, &[Vector3::zeros(); 3]);
    let gravity = Vector3::new(9.81 * tilt.sin(), 0.0, -9.81 * tilt.cos());
    (Faster::new(body, &organ.places(), Vec::new()), gravity)
}

#[test]
fn what_lies_on_finite_elements_weighs_on_them_and_stays_while_friction_holds_it() {
    let config = Config { stiffness_damping: 0.005, ..Config::default() };
    let cases = [(0.0, 0.3, true), (0.2, 0.4, true), (0.2, 0.1, false)];
    for ((tilt, friction, stays), late) in cases.into_iter().flat_map(|of| LATE.map(|late| (of, late))) {
        let mut organ = Organ::new(|at| at.z < 1e-9, config);
        let (mut fast, gravity) = laid(&organ, tilt);
        let top = organ.top();
        let rule = SurfaceContactParams { thickness: 5e-4, stiffness: 500.0, friction };
        let mut lying = SurfaceContacts::new(rule, &Surface::new(&organ.places(), &top).expect("the top"));
        let (mut pressed, mut fastest, mut count) = (Vector3::zeros(), 0.0_f64, 0);
        let mut settled = fast.body.state().positions.clone();
        let periods = if stays { 150 } else { 12 };
        for period in 0..periods {
            for step in 0..RATE {
                organ.tell_when(step == late, &mut fast.ghosts, Vector3::zeros());
                let places = fast.ghosts.positions().to_vec();
                let State { positions, velocities } = fast.body.state();
                let surface = Surface::new(&places, &top).expect("the top");
                lying.find(&surface, &[0, 1, 2], positions, velocities, FAST, &mut fast.presses);
                fast.step(gravity);
                let moved = fast.body.external_nodes();
                lying.end_step(
                    &fast.presses,
                    &moved.presses,
                    &moved.ghost_nodes,
                    &fast.body.state().positions,
                );
                if period >= 100 {
                    pressed += fast
                        .body
                        .external_nodes()
                        .presses
                        .iter()
                        .map(|pressed| pressed.force)
                        .sum::<Vector3<f64>>();
                    count += 1;
                    let speeds = fast.body.state().velocities.iter().map(|v| v.norm());
                    fastest = fastest.max(speeds.fold(0.0, f64::max));
                }
            }
            organ.step(&fast.ghosts, Vector3::zeros());
            if period == 100 {
                settled = fast.body.state().positions.clone();
            }
        }
        let gone = fast.body.state().positions.iter().zip(&settled).map(|(a, b)| (a - b).norm());
        let gone = gone.fold(0.0, f64::max);
        if stays {
            let force = pressed / f64::from(count);
            assert!((force + gravity * 3e-3).norm() < 1e-4 * 3e-3 * 9.81, "{force:?} N carry them");
            assert!(fastest < 1e-5, "they lie still: {fastest} m/s");
            assert!(gone < 1e-6, "they stay: {gone} m in half a second");
        } else {
            // Half of (sin − μ cos) g t²: 0.12 s after a millimetre's fall.
            assert!(gone > 4e-3, "they slide: {gone} m");
        }
    }
}

#[test]
fn ghosts_that_are_written_down_go_on_bit_for_bit_and_nonsense_is_refused() {
    let run = |kill: bool| {
        let mut organ = Organ::thrown();
        let mut fast = membrane(&organ, Vector3::new(-0.2, 0.1, 0.5));
        for period in 0..6 {
            organ.tell(&mut fast.ghosts, Vector3::zeros());
            (0..RATE).for_each(|_| fast.step(Vector3::zeros()));
            organ.step(&fast.ghosts, Vector3::zeros());
            if kill && period == 3 {
                let text = serde_json::to_string(&fast.ghosts).expect("numbers");
                fast.ghosts = serde_json::from_str(&text).expect("what was written");
                assert!(fast.ghosts.is_sound(16));
            }
        }
        (fast.body.state().clone(), fast.ghosts)
    };
    assert_eq!(run(true), run(false));
    let (_, mut ghosts) = run(false);
    let before = ghosts.clone();
    let (places, none) = ([Point3::origin(); 16], [Vector3::zeros(); 16]);
    let news = SlowBodyReport {
        positions: &places,
        velocities: &none,
        expected: &none,
        mobilities: &[1.0; 16],
        masses_inverse: &[1.0; 16],
        last: &none,
        given_work: 0.0,
        received: 0.0,
        steps: 0,
        step: SLOW,
    };
    let short = SlowBodyReport { velocities: &none[..3], ..news };
    assert_eq!(
        ghosts.receive(&short),
        Err(GhostNodesError::Size { what: "velocities", found: 3, expected: 16 })
    );
    let nan = [Vector3::repeat(f64::NAN); 16];
    assert_eq!(
        ghosts.receive(&SlowBodyReport { last: &nan, ..news }),
        Err(GhostNodesError::Number("an impulse"))
    );
    let negative = SlowBodyReport { mobilities: &[-1.0; 16], ..news };
    assert_eq!(ghosts.receive(&negative), Err(GhostNodesError::Number("a time or a mobility")));
    assert_eq!(
        ghosts.receive(&SlowBodyReport { step: f64::NAN, ..news }),
        Err(GhostNodesError::Number("a time or a mobility"))
    );
    assert_eq!(ghosts, before);
    assert_eq!(GhostNodes::new(&[Point3::new(f64::NAN, 0.0, 0.0)]), Err(GhostNodesError::Number("a place")));
}

/// A body that has not moved for a while has had no part in the impulses of that time: it takes their mean force.
#[test]
fn a_body_that_missed_steps_takes_the_mean_force_of_the_time() {
    for (fast, slow) in [(0.002, 0.01), (0.002, 0.05), (1.0 / 300.0, 1.0 / 60.0), (0.01, 0.01)] {
        for steps in 1..40_u64 {
            let mut ghosts = GhostNodes::new(&[Point3::origin()]).expect("numbers");
            let force = Vector3::new(0.0, 0.0, 2.0);
            for _ in 0..steps {
                let moved = GhostMoved { impulse: force * fast, ..GhostMoved::default() };
                ghosts.end_step(fast, &[moved], 0.0);
            }
            let share = ghosts.share_of_a_step(0, slow);
            let over = steps as f64 * fast;
            let taken = ghosts.given()[0] * share;
            if over <= 1.5 * slow + fast - 1e-9 {
                // Out of phase by less than a step: all of it, to the bit.
                assert_eq!(taken, ghosts.given()[0], "{steps} steps of {fast} s for {slow} s");
            } else if over > 1.5 * slow + fast + 1e-9 {
                assert!((taken / slow - force).norm() < 1e-9, "{taken} N·s in {slow} s");
            }
            // What it has taken before does not count.
            assert_eq!(ghosts.share_of_a_step(steps, slow), 1.0);
        }
    }
}
