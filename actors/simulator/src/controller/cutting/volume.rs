//! Topology changes of volumes: their saved state, and what a solver has to do for them. [`super::divisible_volume`]
//! makes them: elements that heat removes, faces that blades open, tears.
//!
//! Elements keep their numbers, including removed ones; of a split element one half keeps it. New nodes and elements
//! are numbered after all others. The solver is notified; surface, grasps and textures follow. Thermal damage refers to
//! elements of the first mesh, and holds for all parts of each.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::tet_mesh::{NodeOrigin, OpenCut, TetFace};
use trocar_scene::Component;

use super::scissors::Blades;
use crate::controller::thermal_damage::{CoagulatedElement, ThermalDamage};

/// State of a volume's topology changes that its mesh does not contain.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "volume_cuts")]
#[serde(default, deny_unknown_fields)]
pub struct VolumeCuts {
    /// Opened interior faces.
    pub opened: Arc<Vec<TetFace>>,
    /// Origins of the nodes added since the first mesh, in order.
    pub births: Arc<Vec<NodeOrigin>>,
    /// For each added element, the element that it is a part of.
    pub parts_of: Arc<Vec<u32>>,
    /// The elements of the first mesh, if some have been split.
    pub first: Arc<Vec<[u32; 4]>>,
    /// Unfinished cuts.
    pub slit: OpenCut,
    /// How many of the elements removed by heat have been taken out.
    pub taken: u32,
    /// How many of the opened faces tore.
    pub torn: u32,
    /// Previous blades of all scissors, in the frame of the body.
    pub blades: Vec<Blades>,
}

impl VolumeCuts {
    /// Checks the state against a mesh with this many nodes and elements.
    ///
    /// # Errors
    /// The part that does not match.
    pub(crate) fn fits(&self, nodes: usize, tets: usize) -> Result<(), String> {
        let first = (nodes.checked_sub(self.births.len()), tets.checked_sub(self.parts_of.len()));
        let (Some(first_node), Some(first_tet)) = first else {
            let (births, parts) = (self.births.len(), self.parts_of.len());
            return Err(format!(
                "its 'volume_cuts' tell of {births} new nodes of {nodes} and {parts} parts of {tets} elements"
            ));
        };
        let mut births = (first_node..).zip(self.births.iter());
        if let Some((node, birth)) =
            births.find(|(node, birth)| birth.of.iter().any(|&of| of as usize >= *node))
        {
            return Err(format!(
                "its 'volume_cuts' let node {node} come from nodes {:?}: only ones before it are valid",
                birth.of
            ));
        }
        if let Some(of) = self.parts_of.iter().find(|of| **of as usize >= first_tet) {
            return Err(format!(
                "its 'volume_cuts' name a part of element {of}: the first mesh has elements 0 to {}",
                first_tet.saturating_sub(1)
            ));
        }
        if !(self.first.is_empty() || self.first.len() == first_tet) {
            let given = self.first.len();
            return Err(format!(
                "its 'volume_cuts' have a first mesh of {given} elements, not of {first_tet}"
            ));
        }
        Ok(())
    }

    /// The elements of the first mesh, given the current ones.
    #[must_use]
    pub fn first_tets(&self, nodes: usize, tets: &[[u32; 4]]) -> Vec<[u32; 4]> {
        if !self.first.is_empty() {
            return self.first.to_vec();
        }
        let count = nodes.saturating_sub(self.births.len());
        let origin = |mut node: u32| {
            while let Some(birth) = (node as usize).checked_sub(count).and_then(|at| self.births.get(at)) {
                node = birth.of[0];
            }
            node
        };
        tets.iter().map(|tet| tet.map(origin)).collect()
    }
}

/// Interface of a solver whose elements can be removed, damaged and separated.
pub trait Elements {
    /// Node positions \[m\].
    fn positions(&self) -> &[Point3<f64>];
    /// Node velocities \[m/s\].
    fn velocities(&self) -> &[Vector3<f64>];
    /// Whether the nodes are in equilibrium after the last topology change: else nothing tears yet.
    fn can_tear(&self) -> bool {
        true
    }
    /// Removes elements.
    ///
    /// # Errors
    /// Why the solver cannot continue without them.
    fn remove(&mut self, elements: &[u32]) -> Result<(), String>;
    /// Sets stiffness and rest length of damaged elements.
    ///
    /// # Errors
    /// Why the solver cannot continue.
    fn alter(&mut self, elements: &[CoagulatedElement]) -> Result<(), String>;
    /// Continues with the body's new nodes and elements.
    ///
    /// # Errors
    /// Why the solver cannot continue.
    fn split(&mut self, body: &Deformable, split: &Split<'_>) -> Result<(), String>;
}

/// A topology change with new nodes.
#[derive(Clone, Copy)]
pub struct Split<'a> {
    /// Origins of the new nodes.
    pub born: &'a [NodeOrigin],
    /// Elements with changed corners and new elements; ascending, without removed ones.
    pub changed: &'a [u32],
    /// Thermal damage of a present element.
    pub altered: &'a dyn Fn(u32) -> Alteration,
    /// All thermal damage, by current elements.
    pub heated: &'a dyn Fn() -> ThermalDamage,
}

impl Split<'_> {
    /// Sets the state of the new nodes.
    pub fn carry(&self, state: &mut State) {
        for birth in self.born {
            state.positions.push(birth.mix(&state.positions, |a, b, share| a + (b - a) * share));
            state.velocities.push(birth.mix(&state.velocities, |a, b, share| a + (b - a) * share));
        }
    }
}

/// Cutting and tearing criteria of a volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FailureCriteria {
    /// Whether blades cut it.
    pub cut: bool,
    /// Whether a cut splits elements along the blade's path; else it opens faces between elements.
    pub halves: bool,
    /// Whether pieces connected only by nodes stay: the solver cannot let them fall.
    pub hangs_on: bool,
    /// Tensile strength \[Pa\], and Lamé's constants \[Pa\] for the stress.
    pub tears: Option<(f64, [f64; 2])>,
    /// Whether its stress is that of linear elasticity.
    pub is_linear: bool,
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
}
