//! Springs updated after cuts of their sheet.

use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::particles::State;
use trocar_simulator::cutting::{Sheet, TopologyChange};
use trocar_simulator::mass_spring::{ChangedMesh, MassSpring, NetworkChange, SurfaceMaterial};

/// Updates a spring solver to a changed sheet.
pub fn follow(
    solver: &mut MassSpring,
    sheet: &Sheet,
    change: &TopologyChange,
    material: &SurfaceMaterial,
) -> NetworkChange {
    let mut pinned = solver.pinned().to_vec();
    change.carry_members(&mut pinned, solver.state().positions.len());
    let patch = ChangedMesh {
        rest: sheet.rest(),
        elements: sheet.triangles(),
        altered: &|_| Alteration::NONE,
        about: &|vertex| sheet.about(vertex),
        stale: &change.stale,
    };
    let carry = |state: &mut State| {
        change.carry(&mut state.positions, |a, b, share| a + (b - a) * share);
        change.carry(&mut state.velocities, |a, b, share| a + (b - a) * share);
    };
    let stays = |node| pinned.contains(&node);
    solver
        .follow(&patch, stays, carry, |network, patch| network.follow_surface(patch, material))
        .expect("a network")
}
