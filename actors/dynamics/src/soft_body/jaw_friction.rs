//! Friction of the jaws that hold a soft body: both pads of an instrument hold what is between them with up to
//! 2 μ `jaw_force_max` in sum (Coulomb), whichever method moves the body. A grip is watched once its force comes near
//! that: its method then solves for what the jaws can hold, and what they cannot moves in them. Up to there held
//! vertices are prescribed, which costs nothing.

use nalgebra::{Isometry3, Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{
    Commands, Component, ComponentError, Entity, Instrument, RecordPolicy, SimTime, Snapshot, Tick,
};

use super::Deformable;
use crate::picking::{Pick, Picks};

/// Share of the force that jaws can hold, from which on a grip is watched.
const NEAR: f64 = 0.5;
/// A grip that has not slipped for so long is said to slip anew \[s\].
const ANEW: f64 = 0.1;

/// Friction of the jaws in a step of a body.
#[derive(Clone, Copy, Debug, Default)]
pub struct JawFriction<'a> {
    /// The grip of each prescribed vertex, in their order: an index of `limits`. Empty: whatever the force, all hold.
    pub grips: &'a [u32],
    /// The largest force of each grip \[N\]; infinite for one that is not watched.
    pub limits: &'a [f64],
}

impl JawFriction<'_> {
    /// The grip of a prescribed vertex, by its place among them, if it is watched, and its largest force \[N\].
    #[must_use]
    pub fn watched(&self, place: usize) -> Option<(usize, f64)> {
        let grip = *self.grips.get(place)? as usize;
        let limit = *self.limits.get(grip)?;
        limit.is_finite().then_some((grip, limit))
    }

    /// Whether any grip is watched.
    #[must_use]
    pub fn is_watching(&self) -> bool {
        !self.grips.is_empty() && self.limits.iter().any(|limit| limit.is_finite())
    }
}

/// What the jaws of a grip did in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GripForce {
    /// Their force on the body, of a watched grip \[N\].
    pub force: Vector3<f64>,
    /// Whether the body slipped in them.
    pub slipped: bool,
}

impl GripForce {
    /// The share of a force that jaws which hold up to `limit` bear.
    #[must_use]
    pub fn share(force: &Vector3<f64>, limit: f64) -> f64 {
        let size = force.norm();
        if size > limit { limit / size } else { 1.0 }
    }
}

/// The force that an instrument's jaws hold by friction \[N\].
#[must_use]
pub fn friction_limit(instrument: &Instrument) -> f64 {
    2.0 * instrument.jaw_friction * instrument.jaw_force_max
}

/// A grip whose force came near what its jaws hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct StrainedGrip {
    /// The instrument.
    pub instrument: u64,
    /// Whether it is near that now.
    pub is_near: bool,
    /// When it last slipped.
    pub slipped_at: Option<SimTime>,
    /// How far what it holds has slipped, in all \[m\].
    pub slip: f64,
}

/// The grips on a body whose jaws hold hardly enough: saved in the scene, so that a restart goes on with them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "strained_grips", record = RecordPolicy::sampled(10.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct StrainedGrips {
    /// By instrument.
    pub grips: Vec<StrainedGrip>,
}

/// Tissue that jaws crush where they press harder than this.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "crushable", check = Self::ranges, schema)]
#[serde(deny_unknown_fields)]
pub struct Crushable {
    /// The pressure between closed jaws that damages it \[Pa\]: `jaw_force_max` over the area of a pad, or of what it
    /// holds where that is less. Compare Heijnsdijk et al. (2004, Surg. Endosc. 18): 15 to 37 N of pinch force damage
    /// the caecum of pigs, the more the smaller the jaws.
    pub pressure: f64,
}

impl Crushable {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("pressure", self.pressure, 1.0..=1e9, "1 to 1e9 Pa")
    }
}

/// The grips of a body in a tick: where their jaws are, and what they hold.
#[derive(Default)]
pub struct TickGrips {
    /// For each pick, its jaws in the body's frame; `None` where nobody knows.
    pub jaws: Vec<Option<Isometry3<f64>>>,
    /// The largest force of each \[N\]; infinite for one that is not watched.
    pub limits: Vec<f64>,
    /// The same, whether it is watched or not.
    pub friction: Vec<f64>,
    /// The force on the body of those that are watched, in this tick \[N\].
    pub forces: Vec<Option<Vector3<f64>>>,
    /// Which of them slipped in it.
    pub slipped: Vec<bool>,
}

impl TickGrips {
    /// Begins a tick, for these picks and jaws.
    pub fn begin(
        &mut self,
        picks: &Picks,
        strained: &StrainedGrips,
        scene: &Snapshot,
        jaws: impl Fn(u64) -> Option<Isometry3<f64>>,
    ) {
        let all = || picks.picks.iter().map(|pick| pick.instrument);
        let friction = |instrument: u64| {
            scene.get::<Instrument>(Entity::from_bits(instrument)).map_or(f64::INFINITY, friction_limit)
        };
        self.jaws.clear();
        self.jaws.extend(all().map(jaws));
        self.friction.clear();
        self.friction.extend(all().map(friction));
        self.limits.clear();
        let watched = all().map(|instrument| strained.of(instrument).is_some_and(|grip| grip.is_near));
        let limits = self.friction.iter().zip(watched);
        self.limits.extend(limits.map(|(limit, watched)| if watched { *limit } else { f64::INFINITY }));
        self.forces.clear();
        self.forces.resize(self.jaws.len(), None);
        self.slipped.clear();
        self.slipped.resize(self.jaws.len(), false);
    }

    /// Takes over what the jaws of watched grips did in a step.
    pub fn take(&mut self, done: &[GripForce]) {
        let all = self.forces.iter_mut().zip(&mut self.slipped).zip(&self.limits).zip(done);
        for (((force, slipped), _), by) in all.filter(|((_, limit), _)| limit.is_finite()) {
            *force = Some(by.force);
            *slipped |= by.slipped;
        }
    }

    /// The force of a body on the jaws of a grip \[N\]: what its method reports of the vertices, as far as they hold it.
    #[must_use]
    pub fn pull(&self, grip: usize, reported: impl FnOnce() -> Vector3<f64>) -> Vector3<f64> {
        let pull = match self.forces.get(grip) {
            Some(Some(force)) => -force,
            _ => reported(),
        };
        pull.cap_magnitude(self.friction.get(grip).copied().unwrap_or(f64::INFINITY))
    }
}

impl StrainedGrips {
    /// The grip of an instrument, if it is strained.
    #[must_use]
    pub fn of(&self, instrument: u64) -> Option<&StrainedGrip> {
        self.grips.iter().find(|grip| grip.instrument == instrument)
    }

    /// Whether what an instrument holds has slipped in its jaws.
    #[must_use]
    pub fn has_slipped(&self, instrument: u64) -> bool {
        self.of(instrument).is_some_and(|grip| grip.slipped_at.is_some())
    }

    /// The longest way that anything has slipped in its jaws \[m\], if anything has.
    #[must_use]
    pub fn slip_max(&self) -> Option<f64> {
        let slipped = self.grips.iter().filter(|grip| grip.slipped_at.is_some());
        slipped.map(|grip| grip.slip).reduce(f64::max)
    }

    /// Takes over the pulls of a tick, in the order of the picks, with the weights of what they hold \[N\], and lets vertices
    /// that have slipped keep their new places in the jaws; those that have left them are let go. Tells of jaws that begin to slip. Returns whether the
    /// picks have changed.
    pub fn take(
        &mut self,
        (picks, grips, pulls): (&mut Picks, &TickGrips, &[(Vector3<f64>, f64)]),
        body: &Deformable,
        positions: &[Point3<f64>],
        (scene, tick): (&Snapshot, &Tick<'_>),
        out: &mut Commands,
    ) -> bool {
        let before = self.grips.len();
        self.grips.retain(|grip| picks.of(grip.instrument).is_some());
        let (mut changed, mut moved) = (before != self.grips.len(), false);
        for (index, (pull, weight)) in pulls.iter().enumerate() {
            let Some(pick) = picks.picks.get_mut(index) else { break };
            let slipped = grips.slipped[index];
            let is_near = slipped || pull.norm() + weight > NEAR * grips.friction[index];
            let place = self.grips.iter().position(|grip| grip.instrument == pick.instrument);
            if place.is_none() && !is_near {
                continue;
            }
            let place = place.unwrap_or_else(|| {
                self.grips.push(StrainedGrip { instrument: pick.instrument, ..StrainedGrip::default() });
                self.grips.len() - 1
            });
            let grip = &mut self.grips[place];
            changed |= grip.is_near != is_near;
            grip.is_near = is_near;
            if let (true, Some(jaw)) = (slipped, &grips.jaws[index]) {
                (changed, moved) = (true, true);
                let instrument = Entity::from_bits(pick.instrument);
                let since = grip.slipped_at.map(|at| tick.time.0.saturating_sub(at.0));
                if since.is_none_or(|since| SimTime(since).as_secs_f64() > ANEW) {
                    out.event("tissue_slips", body.entity, Some(instrument), pull.norm());
                }
                grip.slipped_at = Some(tick.time);
                grip.slip += pick.slip(jaw, positions);
                if let Some(instrument) = scene.get::<Instrument>(instrument) {
                    let midline = [Point3::origin(), Point3::new(0.0, 0.0, -instrument.jaw_length)];
                    let reach = instrument.jaw_width.max(instrument.jaw_thickness);
                    pick.let_go((jaw, &midline, reach), &body.holdable(), positions);
                }
            }
        }
        if moved {
            picks.picks.retain(|pick| !pick.triangles.is_empty());
        }
        if changed {
            out.put(body.entity, self.clone());
        }
        moved
    }
}

/// Tells of tissue that jaws crush as they close on it, by the pressure on it \[Pa\].
pub fn crush(pick: &Pick, body: &Deformable, scene: &Snapshot, out: &mut Commands) {
    let entity = Entity::from_bits(pick.instrument);
    let (Some(limit), Some(instrument)) =
        (scene.get::<Crushable>(body.entity), scene.get::<Instrument>(entity))
    else {
        return;
    };
    let pressure = instrument.jaw_force_max / held_area(pick, body, instrument);
    if pressure > limit.pressure && pressure.is_finite() {
        out.event("tissue_crushed", body.entity, Some(entity), pressure);
    }
}

/// The area that a pad presses on \[m²\].
fn held_area(pick: &Pick, body: &Deformable, instrument: &Instrument) -> f64 {
    let corner = |vertex: u32| body.rest[vertex as usize];
    let parts = pick.triangles.iter().map(|&part| part as usize);
    let held: f64 = if body.triangles.is_empty() {
        let of = |&[a, b]: &[u32; 2]| 2.0 * body.radius * (corner(b) - corner(a)).norm();
        parts.filter_map(|part| body.segments.get(part)).map(of).sum()
    } else {
        let of = |&[a, b, c]: &[u32; 3]| 0.5 * (corner(b) - corner(a)).cross(&(corner(c) - corner(a))).norm();
        parts.filter_map(|part| body.triangles.get(part)).map(of).sum()
    };
    held.min(instrument.jaw_length * instrument.jaw_width)
}
