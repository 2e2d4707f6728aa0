//! Cuts by scissors: the area that the two edges sweep while closing, and the sweep of closed blades.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::jaws::CLOSED;
use trocar_dynamics::tet_mesh::Sweep;
use trocar_scene::shapes::instrument_from_hinge;
use trocar_scene::{Entity, Instrument, InstrumentKind, JawState, Snapshot};

/// Where each edge stops, as a fraction of [`CLOSED`] from the middle: the edges overlap, so that nothing between them
/// stays uncut, and the second does not repeat the first one's cut.
const STOPS: [f64; 2] = [-0.02, 0.01];

/// Previous blades of a pair of scissors, in the frame of a body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Blades {
    /// The instrument.
    pub scissors: Entity,
    /// Full opening \[rad\].
    pub angle: f64,
    /// The hinge \[m\].
    pub hinge: Point3<f64>,
    /// The point where the closed tips meet \[m\].
    pub tip: Point3<f64>,
    /// Ends of their edges \[m\].
    pub edges: [Point3<f64>; 2],
}

impl Blades {
    fn of(scissors: Entity, instrument: &Instrument, angle: f64, body_from_tip: &Isometry3<f64>) -> Self {
        Self {
            scissors,
            angle,
            hinge: body_from_tip * Point3::new(0.0, 0.0, -instrument.jaw_length),
            tip: body_from_tip * Point3::origin(),
            edges: ends(instrument, angle).map(|end| body_from_tip * end),
        }
    }

    /// The area swept since `before`. An edge that moves sideways faster than it closes pushes instead of cutting, and
    /// so does one that opens.
    fn swept(&self, before: &Self, instrument: &Instrument, body_from_tip: &Isometry3<f64>) -> Vec<Sweep> {
        let mut sweeps = Vec::new();
        if self.angle < before.angle && instrument.jaws >= 2 {
            let open = ends(instrument, before.angle).map(|end| body_from_tip * end);
            for ((from, open), to) in before.edges.into_iter().zip(open).zip(self.edges) {
                let along = (open - self.hinge).normalize();
                let carried = open - from;
                let aside = carried - along * along.dot(&carried);
                let closes = (to - open).norm();
                if closes > 0.0 && closes >= aside.norm() {
                    sweeps.push(Sweep { before: [before.hinge, from], after: [self.hinge, to] });
                }
            }
        }
        if self.angle < CLOSED && before.angle < CLOSED {
            sweeps.push(Sweep { before: [before.hinge, before.tip], after: [self.hinge, self.tip] });
        }
        sweeps
    }
}

/// Ends of the edges in the instrument's frame \[m\]. Blades that count as closed have met.
fn ends(instrument: &Instrument, angle: f64) -> [Point3<f64>; 2] {
    let half = 0.5 * (angle - CLOSED);
    let end = |side: f64, stop: f64| {
        let jaw = instrument_from_hinge(instrument.jaw_length, side, 2.0 * half.max(stop * CLOSED));
        jaw * Point3::new(0.0, 0.0, instrument.jaw_length)
    };
    [end(1.0, STOPS[0]), end(-1.0, STOPS[1])]
}

/// Areas that all scissors have swept since `blades`, in the frame of a body; updates `blades`.
pub fn swept(blades: &mut Vec<Blades>, scene: &Snapshot, world_from_body: &Isometry3<f64>) -> Vec<Sweep> {
    let before = std::mem::take(blades);
    let mut sweeps = Vec::new();
    for (entity, instrument) in scene.iter::<Instrument>() {
        if instrument.kind != InstrumentKind::Scissors {
            continue;
        }
        let Some(jaws) = scene.get::<JawState>(entity) else { continue };
        let body_from_tip = world_from_body.inverse() * scene.world_pose(entity);
        let now = Blades::of(entity, instrument, jaws.angle, &body_from_tip);
        if let Some(before) = before.iter().find(|before| before.scissors == entity) {
            sweeps.extend(now.swept(before, instrument, &body_from_tip));
        }
        blades.push(now);
    }
    sweeps
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn scissors() -> Instrument {
        Instrument { kind: InstrumentKind::Scissors, jaw_length: 0.02, ..Instrument::default() }
    }

    fn sweeps(from: (f64, f64), to: (f64, f64), instrument: &Instrument) -> Vec<Sweep> {
        let [before, after] = [from, to].map(|(angle, x)| {
            let pose = Isometry3::translation(x, 0.0, 0.0);
            (Blades::of(Entity::new(0, 1, 1), instrument, angle, &pose), pose)
        });
        after.0.swept(&before.0, instrument, &after.1)
    }

    #[test]
    fn edges_that_close_sweep_what_is_between_them() {
        let found = sweeps((0.6, 0.0), (0.0, 0.0), &scissors());
        assert_eq!(found.len(), 2);
        let hinge = Point3::new(0.0, 0.0, -0.02);
        for (sweep, side) in found.iter().zip([1.0, -1.0]) {
            assert_eq!((sweep.before[0], sweep.after[0]), (hinge, hinge));
            let out = 0.02 * (0.24_f64).sin() * side;
            assert!((sweep.before[1].x - out).abs() < 1e-12, "{sweep:?}");
            assert!(sweep.after[1].x.abs() < 1e-4, "{sweep:?}");
        }
        // They overlap: nothing between them stays uncut.
        assert!(found[0].after[1].x < found[1].after[1].x);
        let bites =
            [(0.6, 0.4), (0.4, 0.1), (0.1, 0.0)].map(|(a, b)| sweeps((a, 0.0), (b, 0.0), &scissors()));
        assert_eq!(bites[0][0].after, bites[1][0].before);
        assert!((bites[1][0].after[1] - found[0].after[1]).norm() < 1e-12);
        // Once closed, the blades move as one.
        assert_eq!(bites[2].len(), 1);
    }

    #[test]
    fn edges_that_open_or_go_aside_sweep_nothing_and_closed_blades_all_that_they_pass() {
        assert!(sweeps((0.4, 0.0), (0.6, 0.0), &scissors()).is_empty());
        assert!(sweeps((0.4, 0.0), (0.4, 0.01), &scissors()).is_empty());
        // Jitter of the drive does not cut.
        assert!(sweeps((0.4001, 0.0), (0.4, 0.001), &scissors()).is_empty());
        assert_eq!(sweeps((0.5, 0.0), (0.4, 1e-4), &scissors()).len(), 2);
        let closed = sweeps((0.0, 0.0), (0.0, 0.01), &scissors());
        assert_eq!(closed.len(), 1);
        assert!((closed[0].after[1] - closed[0].before[1] - Vector3::x() * 0.01).norm() < 1e-12);
        // A single blade cannot shear.
        assert!(sweeps((0.6, 0.0), (0.2, 0.0), &Instrument { jaws: 1, ..scissors() }).is_empty());
    }
}
