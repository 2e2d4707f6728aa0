//! Overlay of bounding volumes.

use nalgebra::Point3;
use trocar_scene::{BoundingVolumeTree, Snapshot};

use super::Overlays;
use super::sketch::{Sketch, Stroke};
use crate::colormap::Colormap;
use crate::draw_list::DrawList;
use crate::geometry::Geometry;

/// Most boxes drawn of one tree.
const NODES_MAX: usize = 4096;
/// Levels over which the colour map is spread.
const LEVELS: f64 = 12.0;

/// Draws the bounding-volume tree of every entity that has one, coloured by level, and the local bounding box of every
/// other surface.
pub fn boxes(overlays: &Overlays, scene: &Snapshot, draw_list: &DrawList, sketch: &mut Sketch) {
    let stroke = |level: u32, hidden: f32| {
        let [r, g, b] = Colormap::Turbo.color(0.12 + 0.8 * (f64::from(level) / LEVELS).min(1.0));
        Stroke { color: [r, g, b, 220], width: 0.75 * overlays.line_width, hidden }
    };
    for (entity, tree) in scene.iter::<BoundingVolumeTree>() {
        let world_from_entity = scene.world_pose(entity);
        for (min, max, level) in nodes(tree) {
            sketch.cuboid(&world_from_entity, &min, &max, &stroke(level, 0.15));
        }
    }
    for item in draw_list.items() {
        if scene.get::<BoundingVolumeTree>(item.entity).is_some() {
            continue;
        }
        if let Some((min, max)) = bounds(&item.surface.geometry) {
            sketch.cuboid(&item.world_from_item, &min, &max, &stroke(3, 0.3));
        }
    }
}

/// Boxes of a tree with their levels, the root first. Cyclic trees end too.
fn nodes(tree: &BoundingVolumeTree) -> Vec<(Point3<f64>, Point3<f64>, u32)> {
    let mut found = Vec::new();
    let mut due = vec![(0_u32, 0)];
    while let Some((index, level)) = due.pop() {
        let Some(node) = tree.nodes.get(index as usize) else { continue };
        if found.len() >= NODES_MAX.min(tree.nodes.len()) {
            break;
        }
        found.push((node.min, node.max, level));
        if node.primitives == 0 {
            due.extend([(node.first.saturating_add(1), level + 1), (node.first, level + 1)]);
        }
    }
    found
}

fn bounds(geometry: &Geometry) -> Option<(Point3<f64>, Point3<f64>)> {
    let first = *geometry.positions.first()?;
    let (mut min, mut max) = (first, first);
    for position in &geometry.positions {
        for axis in 0..3 {
            min[axis] = min[axis].min(position[axis]);
            max[axis] = max[axis].max(position[axis]);
        }
    }
    Some((Point3::from(min).cast(), Point3::from(max).cast()))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use trocar_scene::BoundingVolumeNode;

    use super::*;

    fn node(first: u32, primitives: u32) -> BoundingVolumeNode {
        BoundingVolumeNode { min: Point3::origin(), max: Point3::new(1.0, 1.0, 1.0), first, primitives }
    }

    #[test]
    fn a_tree_is_walked_by_levels_and_one_without_an_end_ends() {
        let levels = |nodes_of: Vec<BoundingVolumeNode>| {
            let tree = BoundingVolumeTree { nodes: Arc::new(nodes_of) };
            nodes(&tree).into_iter().map(|(_, _, level)| level).collect::<Vec<_>>()
        };
        assert_eq!(levels(vec![node(1, 0), node(0, 4), node(3, 0), node(0, 1), node(0, 1)]), [0, 1, 1, 2, 2]);
        assert_eq!(levels(vec![node(0, 0)]).len(), 1);
        assert_eq!(levels(vec![node(u32::MAX, 0)]), [0]);
        assert!(levels(Vec::new()).is_empty());
    }
}
