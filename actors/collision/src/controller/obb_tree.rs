//! Controller of OBB tree contacts: surfaces against surfaces, and self-collision.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, Primitive};
use trocar_scene::{Access, BuildContext, Commands, Controller, ControllerError, Snapshot, Tick};

use super::bodies::{self, Body, Change};
use super::report::{self, COLLISIONS_MAX, FoundContact, Report};
use super::tree_body::TreeBody;
use crate::moving_surface::MovingSurface;
use crate::obb_tree::{TouchingPair, TreeFront, TreeQuery};
use crate::penetration::{PenetrationSearch, VertexInside};
use crate::pseudonormal::face;

/// Configuration: pairs of bodies and stiffness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObbTreeConfig {
    /// Names of two bodies each; the same name twice means self-collision.
    pub pairs: Vec<[String; 2]>,
    /// Total stiffness of a pair of bodies, shared by its contacts \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
}

/// A body with the method's data.
struct Tree {
    of: TreeBody,
    moving: MovingSurface,
}

impl Tree {
    fn named(context: &BuildContext<'_>, name: &str) -> Result<Self, ControllerError> {
        let of = TreeBody::named(context, name)?;
        let moving = MovingSurface::new(&of.body.surface());
        Ok(Self { of, moving })
    }

    fn body(&self) -> &Body {
        &self.of.body
    }

    fn follow(&mut self, scene: &Snapshot, out: &mut Commands) {
        if self.of.follow(scene, out) != Change::None {
            self.moving.follow(&self.of.body.surface());
        }
    }
}

/// Two bodies, by index, with data cached between ticks, which affects only the cost.
struct Pair {
    bodies: [usize; 2],
    front: TreeFront,
    /// Searches for vertices of the second inside the first, and vice versa.
    searches: [PenetrationSearch; 2],
}

/// Finds contacts of penetrating surfaces.
pub struct ObbTreeController {
    trees: Vec<Tree>,
    pairs: Vec<Pair>,
    query: TreeQuery,
    report: Report,
}

impl ObbTreeController {
    /// Finds the bodies.
    ///
    /// # Errors
    /// A body does not exist or is invalid.
    pub fn new(config: &ObbTreeConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let (trees, pairs) = bodies::pairs(&config.pairs, |name| Tree::named(context, name))?;
        let pair = |bodies| Pair { bodies, front: TreeFront::new(), searches: Default::default() };
        Ok(Self {
            trees,
            pairs: pairs.into_iter().map(pair).collect(),
            query: TreeQuery::new(),
            report: Report::new(Detection::ObbTree, config.stiffness),
        })
    }
}

impl Pair {
    fn look(&mut self, trees: &[Tree], query: &mut TreeQuery, report: &mut Report) {
        let [first, second] = self.bodies;
        let (a, b) = (&trees[first], &trees[second]);
        if first == second {
            for pair in query.self_contacts(&a.of.tree) {
                report.add(fold(a, pair));
            }
            return;
        }
        let b_in_a = a.body().pose.inv_mul(&b.body().pose);
        let touching = self.front.all_contacts(&a.of.tree, &b.of.tree, &b_in_a).len();
        if touching == 0 {
            return;
        }
        // Without relative motion the vertices inside are unchanged.
        if !self.front.rested() {
            self.search(a, b, &b_in_a);
        }
        let [of_second, of_first] = &self.searches;
        of_second.found().iter().for_each(|inside| report.add(in_first(a, b, inside)));
        of_first.found().iter().for_each(|inside| report.add(in_second(a, b, inside)));
        if of_second.found().is_empty() && of_first.found().is_empty() {
            // Edges that cross, and no corner inside.
            for pair in self.front.pairs().iter().take(COLLISIONS_MAX) {
                report.add(crossing(a, b, &b_in_a, pair));
            }
        }
    }

    /// Finds vertices of the second inside the first, which exit along its outward direction, and vice versa.
    fn search(&mut self, a: &Tree, b: &Tree, b_in_a: &Isometry3<f64>) {
        let Self { front, searches: [of_second, of_first], .. } = self;
        let seeds = |side: usize| front.pairs().iter().map(move |pair| pair.triangles[side]);
        let (a, b, far) = (&a.moving, &b.moving, f64::INFINITY);
        of_second.vertices_inside(b, a, b_in_a, seeds(1), far, COLLISIONS_MAX);
        of_first.vertices_inside(a, b, &b_in_a.inverse(), seeds(0), far, COLLISIONS_MAX);
    }
}

fn in_first(a: &Tree, b: &Tree, inside: &VertexInside) -> FoundContact {
    FoundContact {
        parts: [
            (a.body().entity, Primitive::Triangle(inside.triangle)),
            (b.body().entity, Primitive::Vertex(inside.vertex)),
        ],
        on_second_in_world: a.body().pose * inside.point,
        normal_in_world: a.body().pose * inside.outwards,
        depth: inside.depth,
    }
}

fn in_second(a: &Tree, b: &Tree, inside: &VertexInside) -> FoundContact {
    FoundContact {
        parts: [
            (a.body().entity, Primitive::Vertex(inside.vertex)),
            (b.body().entity, Primitive::Triangle(inside.triangle)),
        ],
        on_second_in_world: b.body().pose * inside.on_surface,
        normal_in_world: b.body().pose * -inside.outwards,
        depth: inside.depth,
    }
}

/// Contact of two triangles that cross without a corner inside: they separate along the mean of their outward
/// directions, by half the length of their intersection segment, an upper bound of the depth if both are edges of flat
/// bodies.
fn crossing(a: &Tree, b: &Tree, b_in_a: &Isometry3<f64>, pair: &TouchingPair) -> FoundContact {
    let [of_a, of_b] = pair.triangles;
    let normal = apart(&face(&a.moving.surface(), of_a), &(b_in_a * face(&b.moving.surface(), of_b)));
    let [p, q] = pair.points_in_a;
    let depth = 0.5 * (q - p).norm();
    FoundContact {
        parts: [(a.body().entity, Primitive::Triangle(of_a)), (b.body().entity, Primitive::Triangle(of_b))],
        on_second_in_world: a.body().pose * (nalgebra::center(&p, &q) - normal * (0.5 * depth)),
        normal_in_world: a.body().pose * normal,
        depth,
    }
}

/// Contact of two triangles of one surface that cross at a fold. The depth along the mean of their outward directions
/// is the separating translation, at most half the length of their intersection segment: the first applies to sheets
/// lying on each other, the second to an edge through a sheet.
fn fold(a: &Tree, pair: &TouchingPair) -> FoundContact {
    let mut found = crossing(a, a, &Isometry3::identity(), pair);
    let surface = a.moving.surface();
    let normal = a.body().pose.inverse_transform_vector(&found.normal_in_world);
    let along = |triangle: u32| surface.triangle(triangle).map(|corner| normal.dot(&corner.coords));
    let [first, second] = pair.triangles.map(along);
    let furthest = first.into_iter().fold(f64::NEG_INFINITY, f64::max);
    let nearest = second.into_iter().fold(f64::INFINITY, f64::min);
    let depth = (furthest - nearest).clamp(0.0, found.depth);
    found.on_second_in_world += found.normal_in_world * (0.5 * (found.depth - depth));
    found.depth = depth;
    found
}

/// The direction between two outward directions; the first one if undefined.
fn apart(first: &Vector3<f64>, second: &Vector3<f64>) -> Vector3<f64> {
    let unit = |vector: &Vector3<f64>| vector.try_normalize(1e-9);
    unit(&(first - second)).or_else(|| unit(first)).or_else(|| unit(&-second)).unwrap_or_else(Vector3::z)
}

impl Controller for ObbTreeController {
    fn access(&self) -> Access {
        bodies::access()
    }

    fn tick(&mut self, _: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        for tree in &mut self.trees {
            tree.follow(scene, out);
        }
        self.report.begin();
        for pair in &mut self.pairs {
            pair.look(&self.trees, &mut self.query, &mut self.report);
            self.report.end_pair();
        }
        self.report.send(scene.time(), out);
        Ok(())
    }
}
