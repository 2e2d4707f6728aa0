//! Component of a suture thread: its suture, overridden parameters, its initial shape.

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::components::Parameter;
use trocar_scene::{Component, ComponentError, SoftAbilities};

use super::suture::{InDocument, Suture};
use crate::suture_thread::initial_shape::{Throws, resampled, throws};
use crate::suture_thread::{CLOSED_NODES_MIN, NODES_MAX, ThreadMaterial};

/// Maximum number of throws of a thread laid with knots, and of points that it goes through.
const THROWS_MAX: usize = 8;
const PLACES_MAX: usize = 1000;
/// Maximum number of threads that one can touch.
const THREADS_MAX: usize = 8;

/// Initial shape of a thread, in the entity's frame; without it the thread starts as its mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Laid {
    /// Straight lines through points.
    Through {
        /// The points \[m\].
        places: Vec<[f64; 3]>,
    },
    /// Loosely tied around something: see [`Throws`].
    Throws {
        /// Half turns of each throw, in tying order.
        half_turns: Vec<i32>,
        /// Points that the loop goes through, from the left (−x) to the right \[m\].
        around: Vec<[f64; 3]>,
        /// Distance between throws \[m\]; default: as close as possible.
        #[serde(default)]
        apart: f64,
        /// Distance between the knot and the beginning of the loop \[m\].
        arm: f64,
        /// Length of the ends beyond the last throw \[m\].
        ear: f64,
    },
}

/// A soft body that a thread lies on, or is wrapped around.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LiesOn {
    /// Its name. It must be a body of `dynamic_fem`.
    pub body: String,
    /// Coulomb friction coefficient of the thread on it.
    #[serde(default = "LiesOn::friction")]
    pub friction: f64,
}

impl LiesOn {
    /// Assumed, as between instruments and tissue.
    fn friction() -> f64 {
        0.3
    }
}

/// A suture thread. It needs a line mesh, and `anchors` where it is to be fixed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(
    name = "thread", check = Self::ranges, schema, partners = Self::partners, lays = Self::laid_nodes,
    soft_body = SoftAbilities { bears: true, ..SoftAbilities::NONE },
)]
#[serde(default, deny_unknown_fields)]
pub struct ThreadBody {
    /// The suture: a name, or a table with size and material.
    #[schemars(with = "InDocument")]
    pub suture: Suture,
    /// Coulomb friction coefficient on itself; absent: the suture's.
    pub friction: Option<Parameter>,
    /// Bending stiffness `EI` \[N·m²\]; absent: the suture's.
    pub bending_stiffness: Option<Parameter>,
    /// Torsional stiffness `GJ` \[N·m²\]; absent: the suture's.
    pub twisting_stiffness: Option<Parameter>,
    /// Breaking force \[N\]; absent: it never breaks. USP <881> requires 2-0 silk to bear at least 14.1 N, with a knot
    /// in it.
    pub breaks_at: Option<Parameter>,
    /// Coulomb friction coefficient on instruments.
    pub tool_friction: f64,
    /// Maximum step of the solver \[s\]: a tick is divided into such steps.
    pub step: f64,
    /// Edge length where it is tied, in diameters, and elsewhere \[m\]; for a thread that is laid or adaptive.
    pub edges: [f64; 2],
    /// Whether edges are refined where strands are close to each other or the thread bends sharply, and coarsened
    /// elsewhere.
    pub adaptive: bool,
    /// Whether it is closed: its last edge leads back to its first node, so that it is a loop without ends. Neither `adaptive`,
    /// laid in throws, tied around or lying on another body, nor stepped together with other threads.
    pub closed: bool,
    /// Its initial shape.
    pub laid: Option<Laid>,
    /// Names of other threads that it can touch and be tied to, each with a `thread` component, the same material and
    /// the same pose. They are stepped together as one problem, with this thread's step, edges and tool friction.
    pub together_with: Vec<String>,
    /// The soft body of another controller that it lies on or is wrapped around.
    pub lies_on: Option<LiesOn>,
    /// The name of the elastic body that it is tied around, with a `tied` component. It is stepped together with the
    /// thread.
    pub tied_around: Option<String>,
}

impl Default for ThreadBody {
    fn default() -> Self {
        Self {
            suture: Suture::default(),
            friction: None,
            bending_stiffness: None,
            twisting_stiffness: None,
            breaks_at: None,
            tool_friction: 0.2,
            step: 5e-4,
            edges: [1.5, 2e-3],
            adaptive: false,
            closed: false,
            laid: None,
            together_with: Vec::new(),
            lies_on: None,
            tied_around: None,
        }
    }
}

impl ThreadBody {
    /// Where its nodes are at the start, if it is laid and can be.
    fn laid_nodes(&self) -> Option<Vec<Point3<f64>>> {
        self.nodes().ok().flatten()
    }

    fn partners(&self) -> Vec<&str> {
        self.lies_on.iter().map(|on| on.body.as_str()).collect()
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        self.suture.check()?;
        for (field, known, range, valid) in [
            ("friction", &self.friction, 0.0..=10.0, "0 to 10"),
            ("bending_stiffness", &self.bending_stiffness, 1e-14..=1.0, "1e-14 to 1 N·m²"),
            ("twisting_stiffness", &self.twisting_stiffness, 1e-14..=1.0, "1e-14 to 1 N·m²"),
            ("breaks_at", &self.breaks_at, 1e-3..=1e4, "1e-3 to 1e4 N"),
        ] {
            if let Some(known) = known {
                ComponentError::range(field, known.value, range, valid)?;
            }
        }
        ComponentError::range("tool_friction", self.tool_friction, 0.0..=10.0, "0 to 10")?;
        ComponentError::range("step", self.step, 1e-5..=crate::suture_thread::STEP_MAX, "1e-5 to 2e-3 s")?;
        ComponentError::range("edges[0]", self.edges[0], 0.5..=20.0, "0.5 to 20 diameters")?;
        ComponentError::range("edges[1]", self.edges[1], 1e-4..=0.05, "1e-4 to 0.05 m")?;
        if let Some(lies) = &self.lies_on {
            ComponentError::range("lies_on.friction", lies.friction, 0.0..=10.0, "0 to 10")?;
            let around = f64::from(u8::from(self.tied_around.is_some()));
            ComponentError::range("lies_on", around, 0.0..=0.0, "not beside 'tied_around'")?;
        }
        self.check_closed()?;
        let others = self.together_with.len() as f64;
        ComponentError::range("together_with", others, 0.0..=THREADS_MAX as f64, "at most 8 threads")?;
        match &self.laid {
            None => Ok(()),
            Some(Laid::Through { places }) => {
                ComponentError::range("places", places.len() as f64, 2.0..=PLACES_MAX as f64, "2 to 1000")
            }
            Some(Laid::Throws { half_turns, around, apart, arm, ear }) => {
                ComponentError::range("apart", *apart, 0.0..=0.2, "0 to 0.2 m")?;
                let count = half_turns.len() as f64;
                ComponentError::range("half_turns", count, 1.0..=THROWS_MAX as f64, "1 to 8")?;
                for turns in half_turns {
                    ComponentError::range(
                        "half_turns",
                        f64::from(turns.unsigned_abs()),
                        1.0..=9.0,
                        "1 to 9",
                    )?;
                }
                ComponentError::range("around", around.len() as f64, 1.0..=PLACES_MAX as f64, "1 to 1000")?;
                ComponentError::range("arm", *arm, 1e-3..=0.2, "1e-3 to 0.2 m")?;
                ComponentError::range("ear", *ear, 1e-3..=0.5, "1e-3 to 0.5 m")
            }
        }
    }
}

impl ThreadBody {
    /// Refuses what no closed thread can be.
    fn check_closed(&self) -> Result<(), ComponentError> {
        let beside = [
            ("adaptive", self.adaptive, "its edges keep their number"),
            ("together_with", !self.together_with.is_empty(), "it is stepped by itself"),
            ("lies_on", self.lies_on.is_some(), "it lies on no soft body"),
            ("tied_around", self.tied_around.is_some(), "it is tied around no elastic body"),
            (
                "laid",
                matches!(self.laid, Some(Laid::Throws { .. })),
                "throws are tied with ends: 'through' is valid",
            ),
        ];
        match beside.into_iter().find(|(_, is_given, _)| self.closed && *is_given) {
            Some((field, _, why)) => {
                Err(ComponentError::Malformed(format!("'closed': not beside '{field}', since {why}")))
            }
            None => Ok(()),
        }
    }

    /// Its material.
    #[must_use]
    pub fn material(&self) -> ThreadMaterial {
        let mut material = self.suture.material();
        let known = |known: &Option<Parameter>, value: &mut f64| {
            if let Some(known) = known {
                *value = known.value;
            }
        };
        known(&self.friction, &mut material.friction);
        known(&self.bending_stiffness, &mut material.bending_stiffness);
        known(&self.twisting_stiffness, &mut material.twisting_stiffness);
        material
    }

    /// Its initial nodes \[m\], if it is laid.
    ///
    /// # Errors
    /// It would have too few or too many nodes.
    pub fn nodes(&self) -> Result<Option<Vec<Point3<f64>>>, String> {
        let radius = self.suture.material().radius;
        let edges = [self.edges[0] * 2.0 * radius, self.edges[1]];
        let points =
            |places: &[[f64; 3]]| -> Vec<Point3<f64>> { places.iter().map(|at| Point3::from(*at)).collect() };
        let nodes = match &self.laid {
            None => return Ok(None),
            Some(Laid::Through { places }) if self.closed => {
                let mut around = points(places);
                around.extend(around.first().copied());
                let mut nodes = resampled(&around, edges[0]);
                // The first one again.
                nodes.pop();
                nodes
            }
            Some(Laid::Through { places }) => resampled(&points(places), edges[0]),
            Some(Laid::Throws { half_turns, around, apart, arm, ear }) => throws(&Throws {
                half_turns,
                around: &points(around),
                radius,
                apart: *apart,
                arm: *arm,
                ear: *ear,
                edges,
            }),
        };
        let least = if self.closed { CLOSED_NODES_MIN } else { 3 };
        if !(least..=NODES_MAX).contains(&nodes.len()) {
            return Err(format!(
                "laid with edges of {edges:?} m it has {} nodes; valid: {least} to {NODES_MAX}",
                nodes.len()
            ));
        }
        Ok(Some(nodes))
    }
}
