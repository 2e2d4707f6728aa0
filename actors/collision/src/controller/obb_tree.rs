//! Surfaces against surfaces, and a surface that folds against itself, by trees of oriented boxes.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, Primitive};
use trocar_scene::{Access, BuildContext, Commands, Controller, ControllerError, Snapshot, Tick};

use super::bodies::{self, Body, Change};
use super::report::{self, COLLISIONS_MAX, Found, Report};
use super::tree_body::TreeBody;
use crate::moving_surface::MovingSurface;
use crate::obb_tree::{TouchingPair, TreeQuery};
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

/// Finds where surfaces are in each other.
pub struct ObbTreeController {
    trees: Vec<Tree>,
    /// By number.
    pairs: Vec<[usize; 2]>,
    query: TreeQuery,
    search: PenetrationSearch,
    report: Report,
}

impl ObbTreeController {
    /// Finds the bodies.
    ///
    /// # Errors
    /// A body that there is none of, or that cannot be used.
    pub fn new(config: &ObbTreeConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let (trees, pairs) = bodies::pairs(&config.pairs, |name| Tree::named(context, name))?;
        Ok(Self {
            trees,
            pairs,
            query: TreeQuery::new(),
            search: PenetrationSearch::new(),
            report: Report::new(Detection::ObbTree, config.stiffness),
        })
    }

    fn look(&mut self, [first, second]: [usize; 2]) {
        let (a, b) = (&self.trees[first], &self.trees[second]);
        if first == second {
            for pair in self.query.self_contacts(&a.of.tree) {
                self.report.add(fold(a, pair));
            }
            return;
        }
        let b_in_a = a.body().pose.inv_mul(&b.body().pose);
        let touching = self.query.all_contacts(&a.of.tree, &b.of.tree, &b_in_a);
        if touching.is_empty() {
            return;
        }
        let seeds = |side: usize| touching.iter().map(move |pair| pair.triangles[side]);
        let mut found = 0;
        // Vertices of the second inside of the first: they go out of it along its outward direction.
        let inside = self.search.vertices_inside(
            &b.moving,
            &a.moving,
            &b_in_a,
            seeds(1),
            f64::INFINITY,
            COLLISIONS_MAX,
        );
        for vertex in inside {
            self.report.add(in_first(a, b, vertex));
        }
        found += inside.len();
        let a_in_b = b_in_a.inverse();
        let inside = self.search.vertices_inside(
            &a.moving,
            &b.moving,
            &a_in_b,
            seeds(0),
            f64::INFINITY,
            COLLISIONS_MAX,
        );
        for vertex in inside {
            self.report.add(in_second(a, b, vertex));
        }
        found += inside.len();
        if found == 0 {
            // Edges that cross, and no corner inside.
            for pair in touching.iter().take(COLLISIONS_MAX) {
                self.report.add(crossing(a, b, &b_in_a, pair));
            }
        }
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
        for pair in 0..self.pairs.len() {
            self.look(self.pairs[pair]);
            self.report.end_pair();
        }
        self.report.send(scene.time(), out);
        Ok(())
    }
}
