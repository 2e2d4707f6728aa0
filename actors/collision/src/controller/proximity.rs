//! Controller of proximity contacts by exact distances: surfaces push before they touch, as if each had a skin.

use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, Primitive};
use trocar_scene::{Access, BuildContext, Commands, Controller, ControllerError, Snapshot, Tick};

use super::bodies::{self, Change};
use super::report::{self, FoundContact, Report};
use super::tree_body::TreeBody;
use crate::obb_tree::{Proximity, TreeQuery};

/// Configuration: pairs of bodies, margin and stiffness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProximityConfig {
    /// Names of two bodies each.
    pub pairs: Vec<[String; 2]>,
    /// Distance from which on they push \[m\].
    #[serde(default = "margin")]
    pub margin: f64,
    /// Stiffness of a pair of bodies \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
}

fn margin() -> f64 {
    1e-3
}

/// Two bodies, with the warm start and the separation direction of the last result.
struct Pair {
    bodies: [usize; 2],
    last: Option<[u32; 2]>,
    found: Option<FoundContact>,
}

/// Finds the nearest points of nearby surfaces.
pub struct ProximityController {
    trees: Vec<TreeBody>,
    pairs: Vec<Pair>,
    margin: f64,
    query: TreeQuery,
    report: Report,
}

impl ProximityController {
    /// Finds the bodies.
    ///
    /// # Errors
    /// A body does not exist or is invalid; or the margin is not a length.
    pub fn new(config: &ProximityConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        if !(0.0..=1.0).contains(&config.margin) {
            let margin = config.margin;
            return Err(ControllerError::Scene(format!("a margin of {margin} m: 0 to 1 is valid")));
        }
        bodies::refuse_twins(&config.pairs, "the distance")?;
        let (trees, pairs) = bodies::pairs(&config.pairs, |name| TreeBody::named(context, name))?;
        Ok(Self {
            trees,
            pairs: pairs.into_iter().map(|bodies| Pair { bodies, last: None, found: None }).collect(),
            margin: config.margin,
            query: TreeQuery::new(),
            report: Report::new(Detection::Proximity, config.stiffness),
        })
    }
}

impl Pair {
    fn look(&mut self, trees: &[TreeBody], query: &mut TreeQuery, margin: f64) -> Option<FoundContact> {
        let [a, b] = self.bodies.map(|number| &trees[number]);
        let b_in_a = a.body.pose.inv_mul(&b.body.pose);
        let near = query.distance(&a.tree, &b.tree, &b_in_a, self.last)?;
        self.last = Some(near.triangles);
        if near.distance > margin {
            self.found = None;
            return None;
        }
        let Proximity { triangles: [of_a, of_b], points_in_a: [on_a, on_b], distance } = near;
        let apart = a.body.pose * (on_b - on_a);
        // If they overlap, their nearest points define no direction: the last separation direction is used.
        let normal = apart.try_normalize(1e-12).or(self.found.map(|found| found.normal_in_world))?;
        let found = FoundContact {
            parts: [(a.body.entity, Primitive::Triangle(of_a)), (b.body.entity, Primitive::Triangle(of_b))],
            on_second_in_world: a.body.pose * on_b,
            normal_in_world: normal,
            // Each has a skin of half the margin.
            depth: margin - distance,
        };
        self.found = Some(found);
        Some(found)
    }
}

impl Controller for ProximityController {
    fn access(&self) -> Access {
        bodies::access()
    }

    fn tick(&mut self, _: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.report.begin();
        for (number, tree) in self.trees.iter_mut().enumerate() {
            let change = tree.follow(scene, out);
            if matches!(change, Change::Remeshed | Change::Absent) {
                // Their triangle indices have changed.
                let concerned = self.pairs.iter_mut().filter(|pair| pair.bodies.contains(&number));
                concerned.for_each(|pair| (pair.last, pair.found) = (None, None));
            }
        }
        for pair in &mut self.pairs {
            if let Some(found) = pair.look(&self.trees, &mut self.query, self.margin) {
                self.report.add(found);
            }
            self.report.end_pair();
        }
        self.report.send(scene.time(), out);
        Ok(())
    }
}
