//! Component of a mass-spring body, and the solver configuration derived from it.

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::rod_contact::ContactSurface;
use trocar_scene::{Component, ComponentError, SoftAbilities};

use crate::controller::cutting::volume::FailureCriteria;
use crate::mass_spring::{
    Config, Integrator, LineMaterial, LinearSolver, Network, SurfaceMaterial, TooLarge, VolumeMaterial,
};

/// Maximum number of substeps.
const PARTS_MAX: u32 = 200;

/// Time integration of the springs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Symplectic Euler, in as many substeps as stability needs.
    #[default]
    Explicit,
    /// Backward Euler, for any step.
    Implicit,
}

/// Linear solver of an implicit step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SolvedBy {
    /// Surfaces in steps of up to 5 ms as `warped`, all else as `node_blocks`.
    #[default]
    Auto,
    /// Conjugate gradients with a block-Jacobi preconditioner: no preparation, so a cut costs nothing.
    NodeBlocks,
    /// Preconditioned by the factor of the sheet at rest, rotated to its current pose: an order of magnitude fewer
    /// iterations at steps of about a millisecond. While the sheet is being cut it falls back to block Jacobi; a job
    /// computes the next factor in the background once nothing has been cut for a while.
    Warped,
}

/// Longest step \[s\] for which the factor pays off for a surface.
const WARPED_STEP: f64 = 5e-3;

/// Material, by the kind of the mesh.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Springs {
    /// A thread, along its `line_mesh`.
    Line {
        /// Axial stiffness EA \[N\].
        axial_stiffness: f64,
        /// Bending stiffness EI \[N·m²\].
        bending_stiffness: f64,
        /// Mass per length \[kg/m\].
        density: f64,
    },
    /// A cloth or the wall of a tube, along its `surface_mesh`.
    Surface {
        /// Young's modulus times thickness \[N/m\].
        membrane_stiffness: f64,
        /// Flexural rigidity \[N·m\].
        bending_stiffness: f64,
        /// Mass per area \[kg/m²\].
        density: f64,
    },
    /// A volume, along its `tet_mesh`.
    Volume {
        /// Young's modulus \[Pa\].
        young_modulus: f64,
        /// Mass per volume \[kg/m³\].
        density: f64,
    },
}

impl Default for Springs {
    /// Cotton gauze, in round numbers.
    fn default() -> Self {
        Self::Surface { membrane_stiffness: 150.0, bending_stiffness: 2e-6, density: 0.05 }
    }
}

/// A mass-spring body. It needs a mesh, and `anchors` where it is to be fixed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(
    name = "mass_spring", check = Self::ranges, schema,
    soft_body = SoftAbilities {
        responds_to_contacts: true,
        bears: true,
        loses_elements: true,
        ..SoftAbilities::NONE
    },
)]
#[serde(default, deny_unknown_fields)]
pub struct MassSpringBody {
    /// Its material.
    pub springs: Springs,
    /// Time integration.
    pub method: Method,
    /// Linear solver of an implicit step.
    pub solver: SolvedBy,
    /// Damping along springs \[s\]: damping over stiffness.
    pub lag: f64,
    /// Velocity damping \[1/s\].
    pub damping: f64,
    /// Distance of its surface from its vertices \[m\]: half the thickness of a cloth.
    pub thickness: f64,
    /// Contact stiffness: force per penetration depth \[N/m\].
    pub contact_stiffness: f64,
    /// Coulomb friction against instruments and other bodies.
    pub friction: f64,
    /// Stretch (length over rest length) at which a surface or a line tears; absent: it never tears.
    pub tears_at: Option<f64>,
    /// Tensile strength of a volume \[Pa\]; absent: it never tears.
    pub strength: Option<f64>,
}

impl Default for MassSpringBody {
    fn default() -> Self {
        Self {
            springs: Springs::default(),
            method: Method::Explicit,
            solver: SolvedBy::Auto,
            lag: 2e-4,
            damping: 2.0,
            thickness: 0.0005,
            contact_stiffness: 200.0,
            friction: 0.3,
            tears_at: None,
            strength: None,
        }
    }
}

impl MassSpringBody {
    /// Young's modulus of a volume \[Pa\].
    #[must_use]
    pub fn volume(&self) -> Option<f64> {
        match self.springs {
            Springs::Volume { young_modulus, .. } => Some(young_modulus),
            _ => None,
        }
    }

    /// Mass per volume of a volume \[kg/m³\].
    #[must_use]
    pub fn volume_density(&self) -> Option<f64> {
        match self.springs {
            Springs::Volume { density, .. } => Some(density),
            _ => None,
        }
    }

    /// Linear solver for steps of this length \[s\].
    pub(crate) fn solver(&self, period: f64) -> LinearSolver {
        let (tolerance, iterations_max) = (1e-3, 100);
        let is_warped = match self.solver {
            SolvedBy::Auto => matches!(self.springs, Springs::Surface { .. }) && period <= WARPED_STEP,
            SolvedBy::NodeBlocks => false,
            SolvedBy::Warped => true,
        };
        match is_warped {
            true => LinearSolver::Warped { tolerance, iterations_max },
            false => LinearSolver::ConjugateGradients { tolerance, iterations_max },
        }
    }

    /// Configuration before the length of the steps is known.
    pub(crate) fn config(&self) -> Config {
        let integrator = match self.method {
            Method::Explicit => Integrator::Explicit { too_large: TooLarge::Divide { most: PARTS_MAX } },
            Method::Implicit => Integrator::Implicit { solver: self.solver(f64::INFINITY), newton: 1 },
        };
        Config { integrator, lag: self.lag, damping: self.damping, ..Config::default() }
    }

    pub(crate) fn network(&self, body: &Deformable, altered: &[Alteration]) -> Result<Network, String> {
        let network = match self.springs {
            Springs::Line { axial_stiffness, bending_stiffness, density } => Network::from_line(
                &body.rest,
                &body.segments,
                &LineMaterial { axial_stiffness, bending_stiffness, density },
            ),
            Springs::Surface { membrane_stiffness, bending_stiffness, density } => {
                Network::from_altered_surface(
                    &body.rest,
                    &body.triangles,
                    &SurfaceMaterial { membrane_stiffness, bending_stiffness, density },
                    altered,
                    &body.loose,
                )
            }
            Springs::Volume { young_modulus, density } => {
                let material = VolumeMaterial { young_modulus, density };
                Network::from_altered_volume(&body.rest, &body.tets, &material, altered, &body.loose)
            }
        };
        network.map_err(|error| error.to_string())
    }

    /// Cutting and tearing criteria of a volume. Its stress is that of the continuum that the springs represent, with
    /// Poisson's ratio 1/4.
    pub(crate) fn failure_criteria(&self) -> FailureCriteria {
        let Springs::Volume { young_modulus, .. } = self.springs else { return FailureCriteria::default() };
        let shear = 0.4 * young_modulus;
        FailureCriteria {
            cut: true,
            // Split elements would need shorter steps.
            halves: self.method == Method::Implicit,
            tears: self.strength.map(|strength| (strength, [shear, shear])),
            young_modulus,
            ..FailureCriteria::default()
        }
    }

    pub(crate) fn contact_surface<'a>(
        &self,
        body: &'a Deformable,
        positions: &'a [Point3<f64>],
    ) -> ContactSurface<'a> {
        let is_line = matches!(self.springs, Springs::Line { .. });
        ContactSurface {
            positions,
            triangles: if is_line { &[] } else { &body.triangles },
            segments: if is_line { &body.segments } else { &[] },
            thickness: if is_line { body.radius } else { self.thickness },
            closed: matches!(self.springs, Springs::Volume { .. }),
        }
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("lag", self.lag, 0.0..=1.0, "0 to 1 s")?;
        ComponentError::range("damping", self.damping, 0.0..=1e4, "0 to 1e4 1/s")?;
        ComponentError::range("thickness", self.thickness, 0.0..=0.1, "0 to 0.1 m")?;
        ComponentError::range("contact_stiffness", self.contact_stiffness, 0.0..=1e6, "0 to 1e6 N/m")?;
        ComponentError::range("friction", self.friction, 0.0..=10.0, "0 to 10")?;
        ComponentError::range("strength", self.strength.unwrap_or(1.0), 1.0..=1e9, "1 to 1e9 Pa")?;
        ComponentError::range("tears_at", self.tears_at.unwrap_or(2.0), 1.01..=100.0, "1.01 to 100")
    }
}
