//! A membrane by XPBD attached to finite elements, each with its own controller: everything exchanged is in the scene,
//! so that either can restart.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::Vector3;
use trocar_dynamics::soft_body::coupling::{CouplingGiven, CouplingTaken};
use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, EntitySet, Frozen, Measured, Snapshot, Tick,
    VertexPositions, VertexVelocities,
};
use trocar_simulator::controller::{DynamicFemController, DynamicFemMemory, XpbdController};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
/// Steps of the membrane for one of the organ.
const RATE: u64 = 5;

/// Two controllers on one scene, the second at a fifth of the rate.
struct Both {
    fast: XpbdController,
    slow: DynamicFemController,
    bodies: Vec<trocar_scene::Entity>,
}

impl Both {
    fn new(context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        Ok(Self {
            fast: XpbdController::new(GRAVITY, context)?,
            slow: DynamicFemController::new(GRAVITY, context)?,
            bodies: context.scene.iter::<VertexPositions>().map(|(entity, _)| entity).collect(),
        })
    }
}

impl Controller for Both {
    fn access(&self) -> Access {
        let all = || EntitySet::Of(self.bodies.clone());
        let access = trocar_dynamics::soft_body::Deformable::access(&self.bodies);
        access
            .writes::<CouplingGiven>(all())
            .writes::<CouplingTaken>(all())
            .writes::<DynamicFemMemory>(all())
            .writes::<Measured>(EntitySet::Own)
            .contributes::<trocar_scene::CollisionList>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if tick.number.is_multiple_of(RATE) {
            let period = trocar_scene::SimTime(tick.period.0 * RATE);
            return self.slow.tick(&Tick { period, ..*tick }, scene, out);
        }
        // It steps in every tick; the organ's outputs arrive one tick late, as they may in live mode.
        self.fast.tick(tick, scene, out)
    }
}

fn grown(coupled: &str) -> String {
    format!(
        "[[entity]]\nname = \"organ\"\nmesh = {{ block = {{ size = [0.03, 0.03, 0.02], cells = [3, 3, 2] }} }}\n\
         dynamic_fem = {{ young_modulus = 5e3, poisson_ratio = 0.4, density = 1000.0 }}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] }} }}] }}\n\
         [[entity]]\nname = \"plain\"\nmesh = {{ sheet = {{ size = [0.02, 0.02], cells = [2, 2] }} }}\n\
         [[entity]]\nname = \"membrane\"\npose = {{ translation = [0.03, 0.0, 0.01] }}\n\
         mesh = {{ sheet = {{ size = [0.03, 0.02], cells = [6, 4] }} }}\n\
         xpbd = {{ matter = {{ cloth = {{ membrane_stiffness = 100.0, bending_stiffness = 1e-6, density = 0.5 }} }}, \
         parts = 8, damping = 5.0 }}\n{coupled}"
    )
}

const JOINED: &str = "coupled = { with = [{ body = \"organ\", joined = { within = 0.0005, stiffness = 100.0, damping = 0.01 } }] }\n";

fn lowest(stage: &Stage<Both>) -> f64 {
    stage.get::<VertexPositions>("membrane").positions.iter().map(|p| p.z).fold(f64::INFINITY, f64::min)
}

#[test]
fn either_side_of_a_coupling_begins_another_life_to_the_bit() {
    let run = |kill: bool| {
        let mut stage = Stage::new(scene(&grown(JOINED)), 500.0, Both::new);
        for tick in 0..400 {
            stage.tick();
            if kill && [37, 120, 121, 203].contains(&tick) {
                stage.rebuild(Both::new);
            }
        }
        assert!(!stage.has::<Frozen>("membrane") && !stage.has::<Frozen>("organ"));
        // It hangs from the organ by one of its edges.
        assert!((-0.06..-0.01).contains(&lowest(&stage)), "{} m", lowest(&stage));
        let state = |name: &str| {
            let (at, moving) = (stage.get::<VertexPositions>(name), stage.get::<VertexVelocities>(name));
            (at.positions, moving.velocities)
        };
        [state("organ"), state("membrane")]
    };
    assert_eq!(run(true), run(false));
}

#[test]
fn what_hangs_on_an_organ_weighs_on_it_and_what_nobody_moves_is_a_wall() {
    let mut stage = Stage::new(scene(&grown(JOINED)), 500.0, Both::new);
    (0..1500).for_each(|_| stage.tick());
    // The total impulse received in a second equals its weight.
    let given = |stage: &Stage<Both>| -> Vector3<f64> {
        stage.get::<CouplingGiven>("membrane").to[0].ghosts.given().iter().sum()
    };
    let before = given(&stage);
    (0..500).for_each(|_| stage.tick());
    // Four of five ticks are its own.
    let weight = GRAVITY * (0.5 * 0.03 * 0.02) * 0.8;
    let pulled = given(&stage) - before;
    assert!((pulled - weight).norm() < 0.02 * weight.norm(), "{pulled:?} of {weight:?} N·s");
    // The organ no longer gets any impulses: after half a second it acts as a wall for the membrane.
    let still = stage.get::<VertexPositions>("organ").positions;
    stage.put("organ", Frozen { reason: "a test".into(), since: stage.now() });
    stage.rebuild(Both::new);
    (0..600).for_each(|_| stage.tick());
    let told = given(&stage);
    let hangs = lowest(&stage);
    (0..200).for_each(|_| stage.tick());
    assert_eq!(given(&stage), told, "a wall is given nothing");
    assert!((lowest(&stage) - hangs).abs() < 1e-4, "and it holds");
    assert_eq!(stage.get::<VertexPositions>("organ").positions, still);
}

#[test]
fn what_cannot_be_coupled_is_refused_by_name() {
    let refused_in = |text: &str| {
        let store = scene(text);
        let context = BuildContext {
            scene: store.view(),
            time: trocar_scene::SimTime::ZERO,
            period: trocar_scene::SimTime::from_millis(1),
            name: "controller",
            me: trocar_scene::Entity::of_writer(0, 7),
            epoch: 1,
            seed: 1,
        };
        Both::new(&context).err().expect("it cannot be").to_string()
    };
    let refused = |coupled: &str| refused_in(&grown(coupled));
    let with = |body: &str, how: &str| format!("coupled = {{ with = [{{ body = \"{body}\", {how} }}] }}\n");
    let nobody = refused(&with("liver", "joined = {}"));
    assert!(
        nobody.contains("'membrane'") && nobody.contains("'liver'") && nobody.contains("no such"),
        "{nobody}"
    );
    let itself = refused(&with("membrane", "joined = {}"));
    assert!(itself.contains("itself"), "{itself}");
    let plain = refused(&with("plain", "joined = {}"));
    assert!(plain.contains("'dynamic_fem' or 'xpbd'"), "{plain}");
    let fem = refused_in(&grown("").replace(
        "dynamic_fem = {",
        "coupled = { with = [{ body = \"membrane\", joined = {} }] }\ndynamic_fem = {",
    ));
    assert!(fem.contains("'organ'") && fem.contains("goes with 'xpbd' only"), "{fem}");
    let far = refused_in(&grown(JOINED).replace("translation = [0.03", "translation = [0.05"));
    assert!(far.contains("none of its vertices is within 0.0005 m"), "{far}");
}

#[test]
fn what_cannot_be_stops_the_one_body_that_it_is_about() {
    // Besides the two, another organ and another cloth of the same controllers fall freely.
    let more = "[[entity]]\nname = \"other\"\npose = { translation = [1.0, 0.0, 0.0] }\n\
                mesh = { block = { size = [0.02, 0.02, 0.02], cells = [2, 2, 2] } }\n\
                dynamic_fem = { mass_damping = 0.0 }\n\
                [[entity]]\nname = \"cloth\"\npose = { translation = [2.0, 0.0, 0.0] }\n\
                mesh = { sheet = { size = [0.02, 0.02], cells = [2, 2] } }\n\
                xpbd = { matter = { cloth = { membrane_stiffness = 100.0, bending_stiffness = 1e-6, \
                density = 0.5 } }, damping = 0.0 }\n";
    let mut stage = Stage::new(scene(&(grown(JOINED) + more)), 500.0, Both::new);
    (0..50).for_each(|_| stage.tick());
    let height = |stage: &Stage<Both>, name: &str| stage.get::<VertexPositions>(name).positions[0].z;
    // Impulses that no longer have a finite sum.
    let mut given = stage.get::<CouplingGiven>("membrane");
    let text = serde_json::to_string(&given.to[0].ghosts).expect("numbers");
    let from = text.find("\"given\":[[").expect("they are told");
    let end = from + text[from..].find(',').expect("more of them");
    let huge = format!("{}\"given\":[[1e308{}", &text[..from], &text[end..]);
    given.to[0].ghosts = serde_json::from_str(&huge).expect("finite numbers");
    let (organ, membrane) = (stage.get::<VertexPositions>("organ"), height(&stage, "membrane"));
    let before = [height(&stage, "other"), height(&stage, "cloth")];
    stage.put("membrane", given);
    // The membrane publishes its own impulses again, and the organ takes them in the first of its own ticks after that.
    while !(stage.ticks + 1).is_multiple_of(RATE) {
        stage.ticks += 1;
    }
    (0..60).for_each(|_| stage.tick());
    let reason = stage.get::<Frozen>("organ").reason;
    assert!(reason.contains("force") || reason.contains("finite"), "{reason}");
    assert_eq!(stage.get::<VertexPositions>("organ"), organ, "it stays at its last good state");
    assert!(
        !stage.has::<Frozen>("membrane") && !stage.has::<Frozen>("other") && !stage.has::<Frozen>("cloth")
    );
    assert!((height(&stage, "membrane") - membrane).abs() < 0.02, "what hangs on it goes on");
    for (name, before) in ["other", "cloth"].into_iter().zip(before) {
        assert!(before - height(&stage, name) > 0.01, "'{name}' falls on");
    }
    // After a restart it is at rest.
    stage.rebuild(Both::new);
    (0..20).for_each(|_| stage.tick());
    assert_eq!(stage.get::<VertexPositions>("organ"), organ);
}

/// Steps of the membrane per step of an organ a hundred times as heavy.
const FLYING_RATE: u64 = 10;

/// Two controllers with free-flying bodies: ten ticks of the membrane, then one of the organ over the same time.
struct Flying(Both);

impl Flying {
    fn new(context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        Ok(Self(Both {
            fast: XpbdController::new(Vector3::zeros(), context)?,
            slow: DynamicFemController::new(Vector3::zeros(), context)?,
            bodies: context.scene.iter::<VertexPositions>().map(|(entity, _)| entity).collect(),
        }))
    }
}

impl Controller for Flying {
    fn access(&self) -> Access {
        self.0.access()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if tick.number.is_multiple_of(FLYING_RATE + 1) {
            let period = trocar_scene::SimTime(tick.period.0 * FLYING_RATE);
            return self.0.slow.tick(&Tick { period, ..*tick }, scene, out);
        }
        self.0.fast.tick(tick, scene, out)
    }
}

/// Masses of the vertices of the organ and of the membrane of [`flying`] \[kg\].
fn masses(stage: &Stage<Flying>) -> [Vec<f64>; 2] {
    let organ = stage.get::<VertexPositions>("organ").positions;
    let mut of_organ = vec![0.0; organ.len()];
    for tet in stage.get::<trocar_scene::TetMesh>("organ").tets.iter() {
        let [a, b, c, d] = tet.map(|node| organ[node as usize]);
        let share = 1000.0 * (b - a).cross(&(c - a)).dot(&(d - a)).abs() / 24.0;
        tet.iter().for_each(|&node| of_organ[node as usize] += share);
    }
    let membrane = stage.get::<VertexPositions>("membrane").positions;
    let mut of_membrane = vec![0.0; membrane.len()];
    for triangle in stage.get::<trocar_scene::SurfaceMesh>("membrane").triangles.iter() {
        let [a, b, c] = triangle.map(|node| membrane[node as usize]);
        let share = 0.3 * (b - a).cross(&(c - a)).norm() / 6.0;
        triangle.iter().for_each(|&node| of_membrane[node as usize] += share);
    }
    [of_organ, of_membrane]
}

#[test]
fn controllers_of_a_light_membrane_on_a_heavy_organ_lose_no_momentum_and_gain_no_energy() {
    let text = "[[entity]]\nname = \"organ\"\nmesh = { block = { size = [0.03, 0.03, 0.03], cells = [3, 3, 3] } }\n\
                dynamic_fem = { young_modulus = 5e3, poisson_ratio = 0.4, density = 1000.0, mass_damping = 0.0 }\n\
                [[entity]]\nname = \"membrane\"\npose = { translation = [0.0, 0.0, 0.015] }\n\
                mesh = { sheet = { size = [0.03, 0.03], cells = [6, 6] } }\n\
                xpbd = { matter = { cloth = { membrane_stiffness = 100.0, bending_stiffness = 1e-6, \
                density = 0.3 } }, parts = 4, damping = 0.0 }\n\
                coupled = { with = [{ body = \"organ\", joined = { within = 0.0005, stiffness = 50.0, \
                damping = 0.0 } }] }\n";
    let run = |kill: bool| {
        let mut stage = Stage::new(scene(text), 1000.0, Flying::new);
        let [of_organ, of_membrane] = masses(&stage);
        let total = |masses: &[f64]| masses.iter().sum::<f64>();
        assert!((total(&of_organ) / total(&of_membrane) - 100.0).abs() < 1e-6);
        // Until the organ has published its state, it acts as a wall.
        (0..2 * (FLYING_RATE + 1)).for_each(|_| stage.tick());
        let thrown = Vector3::new(0.2, 0.0, 0.3);
        let rest = stage.get::<VertexPositions>("membrane").positions;
        let spin = Vector3::new(0.0, 0.0, 10.0);
        let velocities = rest.iter().map(|at| thrown + spin.cross(&at.coords)).collect();
        stage.put("membrane", VertexVelocities { velocities: Arc::new(velocities) });
        stage.rebuild(Flying::new);
        // Sums over both bodies: momentum, including impulses in transit, and kinetic energy.
        let sums = |stage: &Stage<Flying>| {
            let (mut momentum, mut energy) = (Vector3::zeros(), 0.0);
            for (name, masses) in [("organ", &of_organ), ("membrane", &of_membrane)] {
                if !stage.has::<VertexVelocities>(name) {
                    continue;
                }
                let velocities = stage.get::<VertexVelocities>(name).velocities;
                for (velocity, mass) in velocities.iter().zip(masses) {
                    momentum += velocity * *mass;
                    energy += 0.5 * mass * velocity.norm_squared();
                }
            }
            if stage.has::<CouplingGiven>("membrane") {
                momentum +=
                    stage.get::<CouplingGiven>("membrane").to[0].ghosts.given().iter().sum::<Vector3<f64>>();
            }
            if stage.has::<CouplingTaken>("organ") {
                momentum -= stage.get::<CouplingTaken>("organ").from[0].taken.iter().sum::<Vector3<f64>>();
            }
            (momentum, energy)
        };
        let (before, first) = sums(&stage);
        let mut most = 0.0_f64;
        for tick in 0..11 * 40 {
            stage.tick();
            if kill && [100, 101, 257].contains(&tick) {
                stage.rebuild(Flying::new);
            }
            most = most.max(sums(&stage).1);
        }
        assert!(!stage.has::<Frozen>("membrane") && !stage.has::<Frozen>("organ"));
        let exchanged = stage.get::<CouplingGiven>("membrane").to[0].ghosts.exchanged();
        let organ: Vector3<f64> = stage
            .get::<VertexVelocities>("organ")
            .velocities
            .iter()
            .zip(&of_organ)
            .map(|(velocity, mass)| velocity * *mass)
            .sum();
        // The membrane's momentum is almost completely the organ's now.
        assert!((organ - before).norm() < 0.2 * before.norm(), "{organ:?} of {before:?} N·s");
        let lost = (sums(&stage).0 - before).norm();
        assert!(lost <= 1e-6 * exchanged, "{lost:e} N·s of {exchanged:e} N·s");
        assert!(most <= first * (1.0 + 1e-9), "{most:e} J of {first:e} J");
    };
    run(false);
    run(true);
}
