//! Mesh components. Topology is separate from positions, so that a deforming body copies positions only.

use std::sync::Arc;

use nalgebra::{Point3, Vector2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Component, RecordPolicy};

/// Triangles of a surface, as indices into [`VertexPositions`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "surface_mesh", schema)]
#[serde(deny_unknown_fields)]
pub struct SurfaceMesh {
    /// Corner indices, counter-clockwise seen from outside.
    pub triangles: Arc<Vec<[u32; 3]>>,
}

/// Tetrahedra of a volume, as indices into [`VertexPositions`].
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "tet_mesh", schema)]
#[serde(deny_unknown_fields)]
pub struct TetMesh {
    /// Corner indices, positively oriented.
    pub tets: Arc<Vec<[u32; 4]>>,
}

/// Regions of a volume, as its file names them: physical groups, cell arrays such as `region` or `material`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "tet_regions", schema)]
#[serde(deny_unknown_fields)]
pub struct TetRegions {
    /// The regions' names; the number where the file has no name.
    pub names: Arc<Vec<String>>,
    /// The region of each tetrahedron of the body's [`TetMesh`], as an index into the names.
    pub of_tet: Arc<Vec<u16>>,
}

/// Segments of a thread or band, as indices into [`VertexPositions`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "line_mesh", schema)]
#[serde(deny_unknown_fields)]
pub struct LineMesh {
    /// End point indices.
    pub segments: Arc<Vec<[u32; 2]>>,
    /// Radius of the tube \[m\].
    pub radius: f64,
}

/// Vertices in the entity's frame \[m\].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "vertex_positions", record = RecordPolicy::sampled(30.0, 4e-6), schema)]
#[serde(deny_unknown_fields)]
pub struct VertexPositions {
    /// One point per vertex \[m\].
    #[schemars(with = "Vec<[f64; 3]>")]
    pub positions: Arc<Vec<Point3<f64>>>,
}

/// Texture coordinates, one per vertex, in \[0, 1\].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "texture_coordinates", schema)]
#[serde(deny_unknown_fields)]
pub struct TextureCoordinates {
    /// One `(u, v)` per vertex.
    #[schemars(with = "Vec<[f64; 2]>")]
    pub uv: Arc<Vec<Vector2<f64>>>,
}

/// A tree of axis-aligned boxes over an entity's primitives, for reuse or display.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "bounding_volume_tree", schema)]
#[serde(deny_unknown_fields)]
pub struct BoundingVolumeTree {
    /// Nodes, the root first.
    pub nodes: Arc<Vec<BoundingVolumeNode>>,
}

/// One box of a [`BoundingVolumeTree`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoundingVolumeNode {
    /// Smallest corner in the entity's frame \[m\].
    #[schemars(with = "[f64; 3]")]
    pub min: Point3<f64>,
    /// Largest corner in the entity's frame \[m\].
    #[schemars(with = "[f64; 3]")]
    pub max: Point3<f64>,
    /// First child (inner node) or first primitive (leaf).
    pub first: u32,
    /// 0 for an inner node (its children are `first` and `first + 1`), else the number of primitives.
    pub primitives: u32,
}
