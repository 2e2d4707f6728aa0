//! Bodies coupled to the rod in one island: what it is swaged to, passes through or lies on. All of their forces are
//! solved in one problem per iteration. Nothing is exchanged between two solvers, so the coupling is stable for any
//! stiffness.

use nalgebra::{Point3, Vector3};

use crate::suture_thread::FailureCause;
use crate::suture_thread::contact::{ForceLaw, Motion, Rows};
use crate::suture_thread::discrete_elastic_rod::RodIterate;
use crate::suture_thread::elastic::SurfacePoint;

/// Convergence criteria of the iterations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tolerance {
    /// Without contact: largest displacement in the last iteration \[m\], and largest relative error of the edge
    /// lengths against the tensions.
    pub free: (f64, f64),
    /// The same with contacts, which come and go by less.
    pub touching: (f64, f64),
    /// At the iteration limit: a larger displacement than this divides the step \[m\].
    pub moved_at_most: f64,
    /// Iterations at most.
    pub iterations: usize,
}

/// A tie between a coupled body and the rod, or between coupled bodies.
#[derive(Clone, Debug)]
pub(crate) struct Tie {
    /// Its rows on the rod, with their three directions.
    pub rows: Rows,
    pub law: ForceLaw,
    /// Gap at the iterate without the forces of ties and contacts and without the rod's motion \[m\].
    pub gap: [f64; 3],
    /// Compliance \[m/N\].
    pub yields: [f64; 3],
    /// Initial force \[N\].
    pub force: [f64; 3],
    /// The obstacle that it presses on, if any: a led instrument gives way to it. The first direction points away from it.
    pub obstacle: Option<usize>,
}

/// Result of a tie.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TieResult {
    /// Forces of its rows \[N\].
    pub force: [f64; 3],
    /// Remaining gaps, its compliance included \[m\].
    pub gap: [f64; 3],
    /// Which rows yielded: their force is at its bound.
    pub gives_way: [bool; 3],
}

/// A point of the dense problem at which a coupled body moves.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Link {
    /// A tie, by its index in the coupled body's list.
    Tie(usize),
    /// A contact of the rod with the coupled body's surface, and its three directions in the world.
    Surface(SurfacePoint, [Vector3<f64>; 3]),
}

/// Compliance of coupled bodies at all links together: three rows each.
#[derive(Debug)]
pub(crate) struct ComplianceRows<'a> {
    /// Surface displacement of each row at the linearisation point \[m\]: along the normal from rest to the beginning
    /// of the step, tangentially from then to the beginning of this substep. 0 for ties.
    pub base: &'a mut [f64],
    /// Compliance between rows, column by column \[m/N\].
    pub compliance: &'a mut [f64],
}

/// A body coupled to the rod.
pub(crate) trait CoupledBody {
    /// The obstacle index of its surface, whose mesh is that at the beginning of the step.
    fn surface(&self) -> Option<usize>;

    /// A substep of `dt` seconds begins, or is repeated with a shorter one. The obstacles move like this, as far as it is
    /// known.
    fn begin(&mut self, _dt: f64, _motions: &[Motion]) {}

    /// Nodes of its surface at the beginning of the substep and at the iterate, in the world \[m\]; `None` for a
    /// surface that hardly moves in a step.
    fn swept(&self) -> Option<[&[Point3<f64>]; 2]> {
        None
    }

    /// An edge of the rod that passes through a part of the coupled body while its nodes move from the first to the
    /// second positions \[m\]; the first edge where the body itself passes through an obstacle.
    fn stops(&self, _way: [&[Point3<f64>]; 2], _motions: &[Motion]) -> Option<usize> {
        None
    }

    /// Whether the surface has a sharp ridge along an edge of a triangle, from its corner of this number to the next.
    fn is_sharp(&self, _triangle: u32, _rim: usize) -> bool {
        false
    }

    /// Convergence criteria other than those of a rod alone.
    fn tolerance(&self) -> Option<Tolerance> {
        None
    }

    /// Lists its ties at the iterate of rod and obstacles.
    fn tie(
        &mut self,
        _at: &RodIterate,
        _motions: &[Motion],
        _ties: &mut Vec<Tie>,
    ) -> Result<(), FailureCause> {
        Ok(())
    }

    /// Fills in its compliance.
    fn join(&mut self, links: &[Link], compliance_rows: ComplianceRows<'_>) -> Result<(), FailureCause>;

    /// Moves by the link forces, given as acting on the rod \[N\]; returns the largest displacement \[m\].
    fn advance(&mut self, links: &[Link], forces: &[[f64; 3]]) -> Result<f64, FailureCause>;

    /// Stores the forces of a completed substep.
    fn finish(&mut self, links: &[Link], forces: &[[f64; 3]]);
}

/// No coupled body.
pub(crate) struct NoCoupledBody;

impl CoupledBody for NoCoupledBody {
    fn surface(&self) -> Option<usize> {
        None
    }

    fn join(&mut self, _links: &[Link], _giving: ComplianceRows<'_>) -> Result<(), FailureCause> {
        Ok(())
    }

    fn advance(&mut self, _links: &[Link], _forces: &[[f64; 3]]) -> Result<f64, FailureCause> {
        Ok(0.0)
    }

    fn finish(&mut self, _links: &[Link], _forces: &[[f64; 3]]) {}
}
