//! Jaws that hold a body of finite elements by friction: a step is tried with all held nodes where the jaws have them.
//! A grip that would need more force than its jaws bear slips: its nodes are stepped again, free and under as much of
//! that force as there is (a return mapping). A smaller force of the same direction lets them move with the tissue that
//! draws them, and never against it.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::soft_body::jaw_friction::GripForce;
use trocar_dynamics::soft_body::method::StepContext;

use crate::dynamic_fem::{DynamicFem, Motion};

/// The grips of a step.
#[derive(Default)]
pub(super) struct JawStep {
    /// What the jaws of each watched grip did.
    pub grips: Vec<GripForce>,
    /// The motion before the step.
    pub before: Motion,
}

impl JawStep {
    /// Begins a step; returns whether any grip is watched.
    pub fn begin(&mut self, solver: &DynamicFem, site: &StepContext<'_>) -> bool {
        self.grips.clear();
        self.grips.resize(site.grip_limits.len(), GripForce::default());
        let driven = site.driven.iter();
        let watches = driven.into_iter().any(|driven| limit(site, driven.grip).is_finite());
        if watches {
            solver.store(&mut self.before);
        }
        watches
    }

    /// After a tried step: whether anything slips. Then its nodes are free, under the forces of their jaws.
    pub fn slips(
        &mut self,
        solver: &DynamicFem,
        site: &StepContext<'_>,
        prescribed: &mut Vec<(u32, Point3<f64>)>,
        forces: &mut Vec<(u32, Vector3<f64>)>,
    ) -> bool {
        let held_by = |node: u32| {
            let place = site.driven.binary_search_by_key(&node, |driven| driven.vertex).ok()?;
            Some(site.driven[place].grip).filter(|grip| limit(site, *grip).is_finite())
        };
        let reactions = || {
            let all = solver.reactions().iter();
            all.filter_map(|&(node, force)| Some((node, held_by(node)? as usize, force)))
        };
        reactions().for_each(|(_, grip, force)| self.grips[grip].force += force);
        for (grip, limit) in self.grips.iter_mut().zip(site.grip_limits) {
            grip.slipped = GripForce::share(&grip.force, *limit) < 1.0;
        }
        let of = |grip: usize| (self.grips[grip].slipped, site.grip_limits[grip]);
        for (node, grip, force) in reactions().filter(|(_, grip, _)| of(*grip).0) {
            forces.push((node, force * GripForce::share(&self.grips[grip].force, of(grip).1)));
        }
        prescribed.retain(|(node, _)| !held_by(*node).is_some_and(|grip| of(grip as usize).0));
        for (grip, limit) in self.grips.iter_mut().zip(site.grip_limits) {
            grip.force *= GripForce::share(&grip.force, *limit);
        }
        self.grips.iter().any(|grip| grip.slipped)
    }
}

/// The largest force of a grip \[N\].
fn limit(site: &StepContext<'_>, grip: u32) -> f64 {
    site.grip_limits.get(grip as usize).copied().unwrap_or(f64::INFINITY)
}
