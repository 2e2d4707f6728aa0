//! Working ends of instruments without jaws: hooks, bent rods, prongs, each a rod along a polyline in the instrument's
//! frame.
//!
//! Viewers and simulators use the same polylines. They begin at the front of the shaft, z = −`jaw_length`, and none of
//! them reaches beyond z = 0.

use nalgebra::{Point3, Vector3};

use super::builder::{Builder, Corner};
use crate::components::{Instrument, InstrumentKind};
use crate::mesh::SurfaceData;

/// Pieces of an arc.
const PIECES: usize = 8;
/// Creases sharper than this stay sharp \[rad\].
const CREASE: f64 = 0.7;

/// A rod along a line.
#[derive(Clone, Debug, PartialEq)]
pub struct BentRod {
    /// Points of its axis, from the shaft to its end, in the instrument's frame \[m\].
    pub axis: Vec<Point3<f64>>,
    /// Radius \[m\].
    pub radius: f64,
}

/// The rods beyond the shaft of an instrument; none if its shaft reaches its tip or it has jaws.
pub fn working_end(instrument: &Instrument) -> Vec<BentRod> {
    let (long, wire) = (instrument.jaw_length, 0.5 * instrument.jaw_thickness);
    let rod = (0.5 * instrument.jaw_width).min(instrument.shaft_radius);
    // Sideways offset as a share `aside` of its length, at a given share along it.
    let arc = |radius: f64, aside: &dyn Fn(f64) -> f64| {
        let place = |piece: usize| {
            let share = piece as f64 / PIECES as f64;
            Point3::new(0.0, aside(share) * long, -long + share * (long - radius))
        };
        BentRod { axis: (0..=PIECES).map(place).collect(), radius }
    };
    match instrument.kind {
        // Along the shaft and then at a right angle to it; the heel is the active electrode.
        InstrumentKind::HookCautery => {
            let heel = Point3::new(0.0, 0.0, -wire);
            let toe = heel + Vector3::x() * (0.45 * long).max(2.0 * wire);
            vec![BentRod { axis: vec![Point3::new(0.0, 0.0, -long), heel, toe], radius: wire }]
        }
        // Bends to one side and back: the organ lies in the bow.
        InstrumentKind::Retractor => vec![arc(rod, &|share| 0.35 * (std::f64::consts::PI * share).sin())],
        // Curves increasingly to one side, to emerge behind an organ.
        InstrumentKind::BandPasser => vec![arc(rod, &|share| 0.4 * share * share)],
        // A thin tube from which the loop emerges.
        InstrumentKind::LoopApplier => vec![arc(0.5 * rod, &|_| 0.0)],
        // Two prongs, with the thread between them.
        InstrumentKind::KnotPusher => [1.0, -1.0]
            .map(|side| {
                let apart = side * 0.5 * instrument.jaw_width;
                let at = |z: f64| Point3::new(apart, 0.0, z);
                BentRod { axis: vec![at(-long), at(-wire)], radius: wire }
            })
            .to_vec(),
        InstrumentKind::Grasper
        | InstrumentKind::Scissors
        | InstrumentKind::NeedleDriver
        | InstrumentKind::BluntDissector
        | InstrumentKind::SutureGrasper
        | InstrumentKind::Probe => Vec::new(),
    }
}

impl BentRod {
    /// Its surface, a closed body with flat ends and `segments` around it.
    pub fn surface(&self, segments: usize) -> SurfaceData {
        let mut builder = Builder::default();
        let mut sections: Vec<Vec<Corner>> = Vec::with_capacity(self.axis.len());
        let last = self.axis.len().saturating_sub(1);
        for (at, centre) in self.axis.iter().enumerate() {
            // All bends are in one plane with the shaft: one direction is at a right angle to every piece.
            let towards = |from: usize, to: usize| {
                (self.axis[to] - self.axis[from]).try_normalize(0.0).unwrap_or_else(Vector3::z)
            };
            let (before, after) =
                (towards(at.saturating_sub(1), at.max(1)), towards(at.min(last - 1), (at + 1).min(last)));
            let along = (before + after).normalize();
            let across = self.normal();
            // Sections at a mitred bend are stretched, so that the rod keeps its thickness.
            let in_plane = along.cross(&across) / along.dot(&after);
            let section = (0..segments).map(|k| {
                let share = k as f64 / segments as f64;
                let (sin, cos) = (share * std::f64::consts::TAU).sin_cos();
                let place = centre + (in_plane * cos + across * sin) * self.radius;
                let vertex = builder.vertex(place.x, place.y, place.z);
                Corner { vertex, normal: Vector3::zeros(), uv: [share, at as f64 / last as f64] }
            });
            sections.push(section.collect());
        }
        for pair in sections.windows(2) {
            for k in 0..segments {
                let next = (k + 1) % segments;
                let seam = |corner: Corner| {
                    if next == 0 { Corner { uv: [1.0, corner.uv[1]], ..corner } } else { corner }
                };
                builder.quad([pair[0][k], pair[1][k], seam(pair[1][next]), seam(pair[0][next])]);
            }
        }
        for k in 1..segments - 1 {
            let (back, end) = (&sections[0], &sections[last]);
            builder.triangle([back[0], back[k], back[k + 1]]);
            builder.triangle([end[0], end[k + 1], end[k]]);
        }
        let mut surface = builder.build();
        surface.compute_normals(CREASE);
        surface
    }

    /// Unit normal of its bending plane.
    fn normal(&self) -> Vector3<f64> {
        let bent = self.axis.windows(3).map(|w| (w[1] - w[0]).cross(&(w[2] - w[1])));
        bent.max_by(|a, b| a.norm().total_cmp(&b.norm()))
            .and_then(|normal| normal.try_normalize(1e-15))
            .unwrap_or_else(Vector3::x)
    }
}
