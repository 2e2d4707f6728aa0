//! Components of a position-based body, and the solver derived from them.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::method::{bearing_substep, pressure_wave_squared};
use trocar_scene::{Component, ComponentError, SoftAbilities};

use crate::controller::cutting::volume::FailureCriteria;
use crate::mass_spring::{LineMaterial, Network, NetworkError, SurfaceMaterial};
use crate::xpbd::{Body, Elasticity, Groups, Xpbd, XpbdConfig, distances_of};

/// Material of a position-based body, by the kind of its mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Matter {
    /// A volume, along its `tet_mesh`.
    Volume {
        /// Young's modulus \[Pa\].
        young_modulus: f64,
        /// Poisson's ratio.
        poisson_ratio: f64,
        /// Density \[kg/m³\].
        density: f64,
    },
    /// A cloth or the wall of a tube, along its `surface_mesh`.
    Cloth {
        /// Young's modulus times thickness \[N/m\].
        membrane_stiffness: f64,
        /// Flexural rigidity \[N·m\].
        bending_stiffness: f64,
        /// Mass per area \[kg/m²\].
        density: f64,
    },
    /// A rod, along its `line_mesh`.
    Rod {
        /// Axial stiffness EA \[N\].
        axial_stiffness: f64,
        /// Bending stiffness EI \[N·m²\].
        bending_stiffness: f64,
        /// Mass per length \[kg/m\].
        density: f64,
    },
}

impl Default for Matter {
    /// A soft organ, in round numbers; for measured values of each organ see [`trocar_scene::tissue`].
    fn default() -> Self {
        Self::Volume { young_modulus: 8e3, poisson_ratio: 0.45, density: 1060.0 }
    }
}

/// A position-based body. It needs a mesh, and `anchors` where it is to be fixed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(
    name = "xpbd", check = Self::ranges, schema,
    soft_body = SoftAbilities {
        responds_to_contacts: true,
        bears: true,
        couples: true,
        loses_elements: true,
        ..SoftAbilities::NONE
    },
)]
#[serde(default, deny_unknown_fields)]
pub struct XpbdBody {
    /// Its material.
    pub matter: Matter,
    /// Substeps per step, 1 to 1000. With too few it is softer than its material.
    pub parts: u32,
    /// Sweeps over its constraints per substep, 1 to 1000.
    pub iterations: u32,
    /// Velocity damping \[1/s\].
    pub damping: f64,
    /// Distance of its surface from its vertices \[m\]: half the thickness of a cloth. A rod takes it from its mesh.
    pub thickness: f64,
    /// Contact stiffness: force per penetration depth \[N/m\].
    pub contact_stiffness: f64,
    /// Coulomb friction against instruments and other bodies.
    pub friction: f64,
    /// Whether blades cut it; then they do not push it.
    pub cut: bool,
    /// Tensile strength of a volume \[Pa\]; absent: it never tears.
    pub strength: Option<f64>,
    /// Stretch (length over rest length) at which a cloth or a rod tears; absent: it never tears.
    pub tears_at: Option<f64>,
}

impl Default for XpbdBody {
    fn default() -> Self {
        Self {
            matter: Matter::default(),
            parts: 4,
            iterations: 1,
            damping: 2.0,
            thickness: 0.0,
            contact_stiffness: 300.0,
            friction: 0.3,
            cut: false,
            strength: None,
            tears_at: None,
        }
    }
}

impl XpbdBody {
    /// Young's modulus \[Pa\] and Poisson's ratio of a volume.
    #[must_use]
    pub fn volume(&self) -> Option<[f64; 2]> {
        match self.matter {
            Matter::Volume { young_modulus, poisson_ratio, .. } => Some([young_modulus, poisson_ratio]),
            _ => None,
        }
    }

    /// Mass per volume of a volume \[kg/m³\].
    #[must_use]
    pub fn volume_density(&self) -> Option<f64> {
        match self.matter {
            Matter::Volume { density, .. } => Some(density),
            _ => None,
        }
    }

    /// Cutting and tearing criteria of a volume.
    pub(super) fn failure_criteria(&self) -> FailureCriteria {
        let Matter::Volume { young_modulus, poisson_ratio, .. } = self.matter else {
            return FailureCriteria::default();
        };
        let mu = 0.5 * young_modulus / (1.0 + poisson_ratio);
        let lambda = 2.0 * mu * poisson_ratio / (1.0 - 2.0 * poisson_ratio);
        FailureCriteria {
            cut: self.cut,
            halves: true,
            hangs_on: false,
            tears: self.strength.map(|strength| (strength, [lambda, mu])),
            is_linear: false,
            young_modulus,
        }
    }

    /// Longest substep under a rigid body \[s\].
    pub(super) fn bearing_substep(&self, body: &Deformable) -> f64 {
        match self.matter {
            Matter::Volume { young_modulus, poisson_ratio, density } => {
                bearing_substep(pressure_wave_squared(young_modulus, poisson_ratio, density), body)
            }
            Matter::Cloth { membrane_stiffness, density, .. } => {
                bearing_substep(membrane_stiffness / density, body)
            }
            Matter::Rod { .. } => f64::INFINITY,
        }
    }

    /// Material of a cloth.
    pub(super) fn cloth(&self) -> Option<SurfaceMaterial> {
        match self.matter {
            Matter::Cloth { membrane_stiffness, bending_stiffness, density } => {
                Some(SurfaceMaterial { membrane_stiffness, bending_stiffness, density })
            }
            _ => None,
        }
    }

    /// The solver of a body without its removed elements, and for a cloth or a rod its network.
    pub(super) fn solver(
        &self,
        body: &Deformable,
        altered: &[Alteration],
        gone: &[u32],
        groups: &XpbdGroups,
    ) -> Result<(Xpbd, Option<Network>), NetworkError> {
        let XpbdBody { parts, iterations, damping, .. } = *self;
        let config = XpbdConfig { parts, iterations, damping, ..XpbdConfig::default() };
        let groups = groups.as_groups();
        let (mut solver, network) = match self.matter {
            Matter::Volume { young_modulus, poisson_ratio, density } => {
                let elasticity = Some(Elasticity { young_modulus, poisson_ratio, density });
                let (rest, tets) = (&body.rest[..], &body.tets[..]);
                let made = Body { rest, tets, elasticity, gone, groups, ..Body::default() };
                (Xpbd::new(&made, &body.pinned, config)?, None)
            }
            Matter::Cloth { membrane_stiffness, bending_stiffness, density } => {
                let material = SurfaceMaterial { membrane_stiffness, bending_stiffness, density };
                let network = Network::from_altered_surface(
                    &body.rest,
                    &body.triangles,
                    &material,
                    altered,
                    &body.loose,
                )?;
                (of_network(body, &network, config, groups)?, Some(network))
            }
            Matter::Rod { axial_stiffness, bending_stiffness, density } => {
                let material = LineMaterial { axial_stiffness, bending_stiffness, density };
                let network = Network::from_line(&body.rest, &body.segments, &material)?;
                (of_network(body, &network, config, groups)?, Some(network))
            }
        };
        let state = State { positions: body.positions.to_vec(), velocities: body.velocities.to_vec() };
        solver.restore(state)?;
        Ok((solver, network))
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("parts", f64::from(self.parts), 1.0..=1000.0, "1 to 1000")?;
        ComponentError::range("iterations", f64::from(self.iterations), 1.0..=1000.0, "1 to 1000")?;
        ComponentError::range("damping", self.damping, 0.0..=1e4, "0 to 1e4 1/s")?;
        ComponentError::range("thickness", self.thickness, 0.0..=0.1, "0 to 0.1 m")?;
        ComponentError::range("contact_stiffness", self.contact_stiffness, 0.0..=1e6, "0 to 1e6 N/m")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")?;
        ComponentError::range("strength", self.strength.unwrap_or(1.0), 1.0..=1e9, "1 to 1e9 Pa")?;
        ComponentError::range("tears_at", self.tears_at.unwrap_or(2.0), 1.01..=100.0, "1.01 to 100")
    }
}

fn of_network(
    body: &Deformable,
    network: &Network,
    config: XpbdConfig,
    groups: Groups<'_>,
) -> Result<Xpbd, NetworkError> {
    let distances = distances_of(network);
    let made = Body {
        rest: &body.rest,
        masses: &network.masses,
        distances: &distances,
        bends: &network.hinges,
        groups,
        ..Body::default()
    };
    Xpbd::new(&made, &body.staying(), config)
}

/// Constraint groups (colours) of a body whose mesh was cut, each in the order of its mesh: edges and hinges ascending
/// by their edges, tetrahedra by their numbers. They depend on the history of topology changes, and they determine the
/// order of a sweep, so a restart needs them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Component)]
#[component(name = "xpbd_groups")]
#[serde(default, deny_unknown_fields)]
pub struct XpbdGroups {
    /// Of a cloth's edges.
    pub distances: Arc<Vec<u16>>,
    /// Of its hinges.
    pub bends: Arc<Vec<u16>>,
    /// Of a volume's elements.
    pub tets: Arc<Vec<u16>>,
}

impl XpbdGroups {
    fn as_groups(&self) -> Groups<'_> {
        Groups { distances: &self.distances, bends: &self.bends, tets: &self.tets }
    }
}
