//! Components of couplings between bodies of different controllers: the scene's declaration, and the exchanged
//! quantities.
//!
//! The faster body, which is position-based, names the slower one. It publishes the cumulative impulse on each vertex
//! of the other. The slower one applies the difference to what it has taken before, and publishes what it took. Both
//! are sums, so no impulse is lost or applied twice, whatever the delays and restarts; only a body that missed steps takes
//! the mean force of that time.

use std::sync::Arc;

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, Entity, RecordPolicy, SimTime, Snapshot};

use crate::coupling::{GhostNodes, StickPoint};

/// Maximum number of bodies that one body is coupled with.
pub const BODIES_MAX: usize = 8;
/// Maximum number of vertices of a body that are joined to another.
pub const JOINED_MAX: usize = 2000;

/// A joint between a body and the surface of another that it has grown onto.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Joined {
    /// Vertices nearer than this to the other's surface, both at rest, are joined to it \[m\].
    pub within: f64,
    /// Stiffness of each vertex's joint: force per stretch \[N/m\].
    pub stiffness: f64,
    /// Damping of each vertex's joint \[N·s/m\].
    pub damping: f64,
}

impl Default for Joined {
    /// Assumed: a tenth of a newton stretches a vertex's joint by half a millimetre.
    fn default() -> Self {
        Self { within: 1e-3, stiffness: 200.0, damping: 0.02 }
    }
}

/// Contact of a body that lies on another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Lies {
    /// Contact stiffness of each vertex: force per penetration depth \[N/m\].
    pub stiffness: f64,
    /// Coulomb friction coefficient.
    pub friction: f64,
}

impl Default for Lies {
    /// Assumed, as between instruments and tissue.
    fn default() -> Self {
        Self { stiffness: 300.0, friction: 0.3 }
    }
}

/// A body that another is coupled with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoupledWith {
    /// Its name. It must be a body of `dynamic_fem` or `xpbd`, or a rigid body that moves.
    pub body: String,
    /// The joint, if the body has grown onto it.
    #[serde(default)]
    pub joined: Option<Joined>,
    /// The contact, if the body lies on it, at its own thickness: its vertices stay outside. They must be closer
    /// together than the other's.
    #[serde(default)]
    pub lies: Option<Lies>,
}

/// A body of `xpbd` coupled with others, of which its controller must be the faster one, or equally fast; or any soft
/// body joined to rigid ones that move.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "coupled", check = Self::ranges, schema, partners = Self::partners)]
#[serde(deny_unknown_fields)]
pub struct CoupledBody {
    /// The other bodies.
    pub with: Vec<CoupledWith>,
}

impl CoupledBody {
    /// The bodies that have grown onto this one, and those onto which it has grown.
    #[must_use]
    pub fn joined_with(scene: &Snapshot, body: Entity) -> Vec<Entity> {
        let onto = |of: Entity| {
            let all = scene.get::<Self>(of).into_iter().flat_map(|coupled| &coupled.with);
            all.filter(|with| with.joined.is_some()).filter_map(|with| scene.find(&with.body))
        };
        let grown =
            scene.iter::<Self>().map(|(other, _)| other).filter(|other| onto(*other).any(|it| it == body));
        onto(body).chain(grown).collect()
    }

    fn partners(&self) -> Vec<&str> {
        self.with.iter().map(|with| with.body.as_str()).collect()
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        let bodies = 1.0..=BODIES_MAX as f64;
        ComponentError::range("with", self.with.len() as f64, bodies, "1 to 8 bodies")?;
        for CoupledWith { joined, lies, .. } in &self.with {
            let any = f64::from(u8::from(joined.is_some() || lies.is_some()));
            ComponentError::range("with", any, 1.0..=1.0, "'joined', 'lies' or both")?;
            let joined = joined.unwrap_or_default();
            ComponentError::range("joined.within", joined.within, 0.0..=0.1, "0 to 0.1 m")?;
            ComponentError::range("joined.stiffness", joined.stiffness, 1e-3..=1e6, "1e-3 to 1e6 N/m")?;
            ComponentError::range("joined.damping", joined.damping, 0.0..=1e3, "0 to 1e3 N·s/m")?;
            let lies = lies.unwrap_or_default();
            ComponentError::range("lies.stiffness", lies.stiffness, 1e-3..=1e6, "1e-3 to 1e6 N/m")?;
            ComponentError::range("lies.friction", lies.friction, 0.0..=10.0, "0 to 10")?;
        }
        Ok(())
    }
}

/// A vertex joined to a point in an element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VertexAttachment {
    /// A vertex of the body itself.
    pub vertex: u32,
    /// A tetrahedron of the other body.
    pub element: u32,
    /// Barycentric weights of its corners.
    pub weights: [f64; 4],
}

/// State of the faster side of a coupling: impulses given, and what a restart needs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GivenImpulses {
    /// The other body.
    pub body: Option<Entity>,
    /// Vertices of the other body, in the order of the ghosts.
    pub vertices: Arc<Vec<u32>>,
    /// The ghost nodes, in the body's own frame.
    pub ghosts: GhostNodes,
    /// Ghosts with active or imminent forces.
    pub near: Vec<u32>,
    /// The joints.
    pub grafts: Arc<Vec<VertexAttachment>>,
    /// Stick points of friction.
    pub anchors: Vec<StickPoint>,
    /// Number of the last report from the slower body.
    pub heard: u64,
}

/// Faster sides of all couplings of a body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "coupling_given", record = RecordPolicy::sampled(10.0, 1e-9))]
#[serde(default, deny_unknown_fields)]
pub struct CouplingGiven {
    /// Couplings with bodies of other controllers, in the order of [`CoupledBody::with`].
    pub to: Vec<GivenImpulses>,
}

/// Impulses that a body has taken from one faster body, by ghost.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TakenImpulses {
    /// The giver.
    pub body: Option<Entity>,
    /// Cumulative impulses, in the giver's frame \[N·s\].
    pub taken: Vec<Vector3<f64>>,
    /// Impulses of the last step.
    pub last: Vec<Vector3<f64>>,
    /// Velocity of each vertex after one more step like the last, in the taker's frame \[m/s\].
    pub expected: Vec<Vector3<f64>>,
    /// Mobility of each vertex under further impulses \[1/kg\]; 0 where it is fixed.
    pub mobilities: Vec<f64>,
    /// Inverse mass of each vertex \[1/kg\].
    pub masses_inverse: Vec<f64>,
    /// [`GhostNodes::steps`] and [`GhostNodes::work`] \[J\] as of the impulses taken.
    pub steps: u64,
    /// See above.
    pub given_work: f64,
    /// Work of those impulses on this body \[J\].
    pub received: f64,
}

/// Impulses that a body has taken from all faster bodies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "coupling_taken", record = RecordPolicy::sampled(10.0, 1e-9))]
#[serde(default, deny_unknown_fields)]
pub struct CouplingTaken {
    /// Number of reports so far.
    pub number: u64,
    /// Time of the last one.
    pub time: SimTime,
    /// Length of its steps \[s\].
    pub step: f64,
    /// By giver, in order.
    pub from: Vec<TakenImpulses>,
}
