//! Bodies that share the island with the rod: what it is swaged to, goes through or lies on. They and the rod see each
//! other's forces in one problem per iteration, so nothing is exchanged between two solvers and nothing can build up between
//! them, however stiff either is.

use nalgebra::{Point3, Vector3};

use crate::suture_thread::Trouble;
use crate::suture_thread::contact::{Rows, Rule};
use crate::suture_thread::discrete_elastic_rod::Iterate;
use crate::suture_thread::elastic::SurfacePlace;

/// When iterations may end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tolerance {
    /// Nothing moves further in the last of them \[m\], and lengths of edges differ by no larger share from what their tension
    /// says, as long as the rod touches nothing.
    pub free: (f64, f64),
    /// The same once it does: contacts come and go by less.
    pub touching: (f64, f64),
    /// After as many as are allowed nothing moves further than this, or the step is divided \[m\].
    pub moved_at_most: f64,
    /// Iterations at most.
    pub iterations: usize,
}

/// A place between a companion and the rod, or of companions alone.
#[derive(Clone, Debug)]
pub(crate) struct Tie {
    /// What it does to the rod; the directions are those of its three rows.
    pub rows: Rows,
    pub rule: Rule,
    /// At the iterate, with all that moves the companion but the forces of ties and contacts; without the rod's motion \[m\].
    pub gap: [f64; 3],
    /// How far it gives way \[m/N\].
    pub yields: [f64; 3],
    /// To begin with \[N\].
    pub force: [f64; 3],
}

/// What a tie came to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Tied {
    /// Of its rows \[N\].
    pub force: [f64; 3],
    /// What is left of its gaps, what it gives way included \[m\].
    pub gap: [f64; 3],
    /// Which rows gave way: their force is as large as it may be.
    pub gives_way: [bool; 3],
}

/// A place of the dense problem at which a companion moves.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Link {
    /// A tie, by its place in the list that the companion gave.
    Tie(usize),
    /// A contact of the rod with the companion's surface, and its three directions in the world.
    Surface(SurfacePlace, [Vector3<f64>; 3]),
}

/// How companions give way at all links together: three rows of each.
#[derive(Debug)]
pub(crate) struct ComplianceRows<'a> {
    /// Of each row, how far the surface was displaced before \[m\]: along the normal since it was at rest until the step
    /// began, across it since then until this part began. Of ties 0.
    pub base: &'a mut [f64],
    /// Between rows, column by column \[m/N\].
    pub compliance: &'a mut [f64],
}

/// The rod's partner.
pub(crate) trait Companion {
    /// The place of its surface in the list of obstacles, which has it as it is when the step begins.
    fn surface(&self) -> Option<usize>;

    /// A part of a step of `dt` seconds begins, or does so anew for being shorter.
    fn begin(&mut self, _dt: f64) {}

    /// Where the nodes of its surface were when the part began and are at the iterate, in the world \[m\]; none of a surface
    /// that hardly moves in a step.
    fn swept(&self) -> Option<[&[Point3<f64>]; 2]> {
        None
    }

    /// An edge of the rod that passes through something of the companion's on the way of its nodes from the first to the second
    /// of these \[m\].
    fn stops(&self, _way: [&[Point3<f64>]; 2]) -> Option<usize> {
        None
    }

    /// Whether the surface has a ridge along a rim of a triangle, from its corner of this number to the next.
    fn is_sharp(&self, _triangle: u32, _rim: usize) -> bool {
        false
    }

    /// Another tolerance than that of a rod alone.
    fn tolerance(&self) -> Option<Tolerance> {
        None
    }

    /// Lists its ties at the iterate.
    fn tie(&mut self, _at: &Iterate, _ties: &mut Vec<Tie>) -> Result<(), Trouble> {
        Ok(())
    }

    /// How it gives way.
    fn join(&mut self, links: &[Link], giving: ComplianceRows<'_>) -> Result<(), Trouble>;

    /// Moves by the forces of all links, which are on the rod \[N\]; how far anything moved \[m\].
    fn advance(&mut self, links: &[Link], forces: &[[f64; 3]]) -> Result<f64, Trouble>;

    /// Takes down the forces of a part that has come to its end.
    fn finish(&mut self, links: &[Link], forces: &[[f64; 3]]);
}

/// No partner.
pub(crate) struct Alone;

impl Companion for Alone {
    fn surface(&self) -> Option<usize> {
        None
    }

    fn join(&mut self, _links: &[Link], _giving: ComplianceRows<'_>) -> Result<(), Trouble> {
        Ok(())
    }

    fn advance(&mut self, _links: &[Link], _forces: &[[f64; 3]]) -> Result<f64, Trouble> {
        Ok(0.0)
    }

    fn finish(&mut self, _links: &[Link], _forces: &[[f64; 3]]) {}
}
