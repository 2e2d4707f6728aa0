//! Surfaces against surfaces, and a surface that folds against itself, by trees of oriented boxes.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, Primitive};
use trocar_scene::{Access, BuildContext, Commands, Controller, ControllerError, Snapshot, Tick};

use super::bodies::{self, Body, Change};
use super::report::{self, COLLISIONS_MAX, Found, Report};
use super::tree_body::TreeBody;
use crate::moving_surface::MovingSurface;
use crate::obb_tree::{TouchingPair, TreeFront, TreeQuery};
use crate::penetration::{PenetrationSearch, VertexInside};
use crate::pseudonormal::face;

/// Which bodies are watched, and how hard they press.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObbTreeConfig {
    /// Names of two bodies each; the same one twice is a body against itself.
    pub pairs: Vec<[String; 2]>,
    /// Stiffness of a pair of bodies, whatever the number of its contacts \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
}

/// A body with what the method needs of it.
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

/// Two bodies, by number, and what is known of them from one tick to the next: it decides only what a tick costs.
struct Pair {
    bodies: [usize; 2],
    front: TreeFront,
    /// For vertices of the second inside of the first, and the other way round.
    searches: [PenetrationSearch; 2],
}

/// Finds where surfaces are in each other.
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
    /// A body that there is none of, or that cannot be used.
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
        // Where nothing has moved against each other, what is inside is what was.
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

    /// Vertices of the second inside of the first, which go out of it along its outward direction, and of the first.
    fn search(&mut self, a: &Tree, b: &Tree, b_in_a: &Isometry3<f64>) {
        let Self { front, searches: [of_second, of_first], .. } = self;
        let seeds = |side: usize| front.pairs().iter().map(move |pair| pair.triangles[side]);
        let (a, b, far) = (&a.moving, &b.moving, f64::INFINITY);
        of_second.vertices_inside(b, a, b_in_a, seeds(1), far, COLLISIONS_MAX);
        of_first.vertices_inside(a, b, &b_in_a.inverse(), seeds(0), far, COLLISIONS_MAX);
    }
}

fn in_first(a: &Tree, b: &Tree, inside: &VertexInside) -> Found {
    Found {
        parts: [
            (a.body().entity, Primitive::Triangle(inside.triangle)),
            (b.body().entity, Primitive::Vertex(inside.vertex)),
        ],
        on_second_in_world: a.body().pose * inside.point,
        normal_in_world: a.body().pose * inside.outwards,
        depth: inside.depth,
    }
}

fn in_second(a: &Tree, b: &Tree, inside: &VertexInside) -> Found {
    Found {
        parts: [
            (a.body().entity, Primitive::Vertex(inside.vertex)),
            (b.body().entity, Primitive::Triangle(inside.triangle)),
        ],
        on_second_in_world: b.body().pose * inside.on_surface,
        normal_in_world: b.body().pose * -inside.outwards,
        depth: inside.depth,
    }
}

/// Two triangles that cross without a corner inside: they part along the mean of their outward directions, by as much as
/// half of what they have in common is long; it is no more than that deep where both are edges of something flat.
fn crossing(a: &Tree, b: &Tree, b_in_a: &Isometry3<f64>, pair: &TouchingPair) -> Found {
    let [of_a, of_b] = pair.triangles;
    let normal = apart(&face(&a.moving.surface(), of_a), &(b_in_a * face(&b.moving.surface(), of_b)));
    let [p, q] = pair.points_in_a;
    let depth = 0.5 * (q - p).norm();
    Found {
        parts: [(a.body().entity, Primitive::Triangle(of_a)), (b.body().entity, Primitive::Triangle(of_b))],
        on_second_in_world: a.body().pose * (nalgebra::center(&p, &q) - normal * (0.5 * depth)),
        normal_in_world: a.body().pose * normal,
        depth,
    }
}

/// Two triangles of one surface that cross where it folds. Along the mean of their outward directions they are as deep as
/// parts them, and no deeper than half of what they have in common is long: sheets that lie on each other part by the
/// first, an edge that has gone through a sheet by the second.
fn fold(a: &Tree, pair: &TouchingPair) -> Found {
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

/// Between two outward directions; the first where they say nothing.
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
