//! Bodies that pull at each other across controllers: what a scene says of it, and what passes between those who move them.
//!
//! The faster of two bodies, which is one of positions, names the slower one. It tells all the impulses that it has given each
//! vertex of the other so far; the slower one takes what it has not taken, and tells what that was. Both are sums, so none is
//! lost or taken twice, whoever is late or begins another life.

use std::sync::Arc;

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, Entity, SimTime};

use crate::coupling::{Anchor, Ghosts};

/// Bodies that one is coupled with at most.
pub const BODIES_MAX: usize = 8;
/// Vertices of a body that are grown onto another at most.
pub const JOINED_MAX: usize = 2000;

/// Where a body has grown onto another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Joined {
    /// Its vertices that are nearer to the other's surface than this, both at rest, are joined to it \[m\].
    pub within: f64,
    /// Force per stretch of each vertex \[N/m\].
    pub stiffness: f64,
    /// Force per velocity of stretching of each vertex \[N·s/m\].
    pub damping: f64,
}

impl Default for Joined {
    /// Chosen: a tenth of a newton stretches a vertex's hold by half a millimetre.
    fn default() -> Self {
        Self { within: 1e-3, stiffness: 200.0, damping: 0.02 }
    }
}

/// How a body lies on another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Lies {
    /// Force per depth of each vertex \[N/m\].
    pub stiffness: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
}

impl Default for Lies {
    /// Chosen, as between instruments and tissue.
    fn default() -> Self {
        Self { stiffness: 300.0, friction: 0.3 }
    }
}

/// One of the bodies that a body is coupled with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoupledWith {
    /// Its name. It is moved by `dynamic_fem` or `xpbd`.
    pub body: String,
    /// Whether it has grown onto it.
    #[serde(default)]
    pub joined: Option<Joined>,
    /// Whether it lies on it, at its own thickness: its vertices stay outside. They are to be closer together than the other's.
    #[serde(default)]
    pub lies: Option<Lies>,
}

/// A body of `xpbd` that pulls and presses at others. Its controller is the faster one, or as fast.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoupledBody {
    /// With which bodies.
    pub with: Vec<CoupledWith>,
}

impl CoupledBody {
    fn partners(&self) -> Vec<&str> {
        self.with.iter().map(|with| with.body.as_str()).collect()
    }
}

impl Component for CoupledBody {
    const NAME: &'static str = "coupled";
    const PARTNERS: Option<fn(&Self) -> Vec<&str>> = Some(Self::partners);
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
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
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

/// A vertex that is joined to a place in an element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Graft {
    /// Of the body itself.
    pub vertex: u32,
    /// Of the other body: a tetrahedron of its volume.
    pub element: u32,
    /// Of its corners.
    pub weights: [f64; 4],
}

/// What a body has given one that it is coupled with, and what it needs to go on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GivenTo {
    /// The other body.
    pub body: Option<Entity>,
    /// Vertices of the other, in the order of the ghosts.
    pub vertices: Arc<Vec<u32>>,
    /// What it knows of them; in its own frame.
    pub ghosts: Ghosts,
    /// Ghosts that it pulls at or is near to.
    pub near: Vec<u32>,
    /// What is joined.
    pub grafts: Arc<Vec<Graft>>,
    /// Where friction holds it.
    pub anchors: Vec<Anchor>,
    /// The number of the last news.
    pub heard: u64,
}

/// What a body has given all that it is coupled with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CouplingGiven {
    /// Those that other controllers move, in the order of [`CoupledBody::with`].
    pub to: Vec<GivenTo>,
}
impl Component for CouplingGiven {
    const NAME: &'static str = "coupling_given";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}

/// What a body has taken from one that is coupled with it, by ghost.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TakenFrom {
    /// Who gave it.
    pub body: Option<Entity>,
    /// All so far, and in the last step, in the giver's frame \[N·s\].
    pub taken: Vec<Vector3<f64>>,
    /// In the last step.
    pub last: Vec<Vector3<f64>>,
    /// How each vertex would move after one more step like it, in the taker's frame \[m/s\].
    pub expected: Vec<Vector3<f64>>,
    /// How readily each follows more impulses \[1/kg\]; 0 for one that is held.
    pub mobilities: Vec<f64>,
    /// One over the mass of each \[1/kg\].
    pub masses_inverse: Vec<f64>,
    /// [`Ghosts::steps`] and [`Ghosts::work`] \[J\] of what was taken.
    pub steps: u64,
    /// See above.
    pub given_work: f64,
    /// What work that was here \[J\].
    pub received: f64,
}

/// What a body has taken from all that are coupled with it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CouplingTaken {
    /// How often it has taken something.
    pub number: u64,
    /// When the last time was.
    pub time: SimTime,
    /// Length of its steps \[s\].
    pub step: f64,
    /// By giver, in order.
    pub from: Vec<TakenFrom>,
}
impl Component for CouplingTaken {
    const NAME: &'static str = "coupling_taken";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}
