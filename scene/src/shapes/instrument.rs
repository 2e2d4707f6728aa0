//! Instruments: a shaft and jaws of half-round, tapered blades, curved like those of a Maryland dissector, or a
//! [`working_end`] without jaws.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::builder::{Builder, Corner};
use super::lathe::cylinder;
use super::working_end::working_end;
use super::{ShapeError, length, segments as check_segments};
use crate::components::{Instrument, InstrumentKind};
use crate::mesh::SurfaceData;

/// Sections of a blade along its length.
const STATIONS: usize = 12;
/// Creases sharper than this stay sharp \[rad\].
const CREASE: f64 = 0.7;

/// The parts of an instrument, each a closed body.
#[derive(Clone, Debug, PartialEq)]
pub struct InstrumentSurface {
    /// The shaft with any working end that is no jaw, in the instrument's frame.
    pub shaft: SurfaceData,
    /// Jaw A, closed, in the hinge's frame: origin at the hinge, z towards the tip, the pad in the plane x = 0, the
    /// blade at x ≥ 0. `None` for an instrument with fewer jaws.
    pub jaw_a: Option<SurfaceData>,
    /// Jaw B, closed, in the hinge's frame: the mirror image of jaw A at x ≤ 0.
    pub jaw_b: Option<SurfaceData>,
    /// From the hinge to the tip \[m\].
    pub jaw_length: f64,
}

impl InstrumentSurface {
    /// `instrument_from_hinge` of jaw A (`side` +1) or jaw B (−1) at a full jaw opening of `jaw_angle` \[rad\].
    pub fn instrument_from_jaw(&self, side: f64, jaw_angle: f64) -> Isometry3<f64> {
        instrument_from_hinge(self.jaw_length, side, jaw_angle)
    }

    /// All parts in the instrument's frame at a full jaw opening of `jaw_angle` \[rad\]: one body each.
    pub fn assembled(&self, jaw_angle: f64) -> SurfaceData {
        let mut whole = self.shaft.clone();
        for (side, jaw) in [(1.0, &self.jaw_a), (-1.0, &self.jaw_b)] {
            if let Some(jaw) = jaw {
                whole.append(&jaw.clone().transformed(&self.instrument_from_jaw(side, jaw_angle)));
            }
        }
        whole
    }
}

/// `instrument_from_hinge` of jaw A (`side` +1) or jaw B (−1) of an instrument whose jaws are `jaw_length` \[m\] long
/// and fully open by `jaw_angle` \[rad\].
pub fn instrument_from_hinge(jaw_length: f64, side: f64, jaw_angle: f64) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), side.signum() * 0.5 * jaw_angle);
    Isometry3::from_parts(Translation3::new(0.0, 0.0, -jaw_length), rotation)
}

/// Shape of a blade as a share of its full size at the tip, and how far it bends sideways.
struct Blade {
    width_at_tip: f64,
    thickness_at_tip: f64,
    /// Sideways (y) offset of the tip as a share of the length.
    bend: f64,
}

/// The surface of an instrument with `segments` around its shaft and half as many around a blade.
///
/// # Errors
/// When a length is not positive, the jaws are longer than the shaft, or the segments are out of range.
pub fn instrument_surface(instrument: &Instrument, segments: usize) -> Result<InstrumentSurface, ShapeError> {
    length("shaft_length", instrument.shaft_length)?;
    length("shaft_radius", instrument.shaft_radius)?;
    check_segments(segments)?;
    let blade = match instrument.kind {
        InstrumentKind::Grasper => Some(Blade { width_at_tip: 0.5, thickness_at_tip: 0.5, bend: 0.18 }),
        InstrumentKind::Scissors => Some(Blade { width_at_tip: 0.3, thickness_at_tip: 0.7, bend: 0.12 }),
        InstrumentKind::NeedleDriver => Some(Blade { width_at_tip: 0.9, thickness_at_tip: 0.8, bend: 0.0 }),
        InstrumentKind::BluntDissector => {
            Some(Blade { width_at_tip: 0.9, thickness_at_tip: 0.8, bend: 0.25 })
        }
        InstrumentKind::SutureGrasper => {
            Some(Blade { width_at_tip: 0.35, thickness_at_tip: 0.5, bend: 0.10 })
        }
        InstrumentKind::HookCautery
        | InstrumentKind::Probe
        | InstrumentKind::LoopApplier
        | InstrumentKind::KnotPusher
        | InstrumentKind::Retractor
        | InstrumentKind::BandPasser => None,
    };
    let end = working_end(instrument);
    let has_end = !end.is_empty() || (blade.is_some() && instrument.jaws > 0);
    let jaw_length = if has_end { instrument.jaw_length } else { 0.0 };
    if jaw_length >= instrument.shaft_length {
        return Err(ShapeError::OutOfRange {
            field: "jaw_length",
            value: jaw_length,
            valid: "below shaft_length",
        });
    }
    let half_shaft = 0.5 * (instrument.shaft_length - jaw_length);
    let middle = Isometry3::translation(0.0, 0.0, -jaw_length - half_shaft);
    let mut shaft = cylinder(instrument.shaft_radius, half_shaft, segments)?.transformed(&middle);
    for rod in &end {
        length("jaw_length", instrument.jaw_length)?;
        length("radius", rod.radius)?;
        shaft.append(&rod.surface(segments));
    }
    let (jaw_a, jaw_b) = match blade {
        Some(blade) if instrument.jaws > 0 => {
            length("jaw_length", instrument.jaw_length)?;
            length("jaw_width", instrument.jaw_width)?;
            length("jaw_thickness", instrument.jaw_thickness)?;
            let jaw = jaw(instrument, &blade, (segments / 2).max(3));
            let mirror = (instrument.jaws > 1).then(|| mirrored(&jaw));
            (Some(jaw), mirror)
        }
        _ => (None, None),
    };
    Ok(InstrumentSurface { shaft, jaw_a, jaw_b, jaw_length })
}

/// Half-round sections from the hinge to the tip, with a flat cap at either end.
fn jaw(instrument: &Instrument, blade: &Blade, arc_segments: usize) -> SurfaceData {
    let around = arc_segments + 1;
    let mut builder = Builder::default();
    let mut sections: Vec<Vec<Corner>> = Vec::with_capacity(STATIONS + 1);
    for station in 0..=STATIONS {
        let s = station as f64 / STATIONS as f64;
        let half_width = 0.5 * instrument.jaw_width * (1.0 + (blade.width_at_tip - 1.0) * s);
        let thickness = instrument.jaw_thickness * (1.0 + (blade.thickness_at_tip - 1.0) * s);
        let bend = blade.bend * instrument.jaw_length * s * s;
        let section = (0..around)
            .map(|k| {
                // From (0, −w) over (t, 0) to (0, w); the pad closes the section.
                let angle = std::f64::consts::PI * (k as f64 / arc_segments as f64 - 0.5);
                let x = if k == 0 || k == arc_segments { 0.0 } else { thickness * angle.cos() };
                let y = half_width * angle.sin() + bend;
                let vertex = builder.vertex(x, y, s * instrument.jaw_length);
                Corner { vertex, normal: Vector3::zeros(), uv: [k as f64 / around as f64, s] }
            })
            .collect();
        sections.push(section);
    }
    for pair in sections.windows(2) {
        for k in 0..around {
            let next = (k + 1) % around;
            let seam = |corner: Corner| {
                if next == 0 { Corner { uv: [1.0, corner.uv[1]], ..corner } } else { corner }
            };
            builder.quad([pair[0][k], seam(pair[0][next]), seam(pair[1][next]), pair[1][k]]);
        }
    }
    for k in 1..around - 1 {
        let (hinge, tip) = (&sections[0], &sections[STATIONS]);
        builder.triangle([hinge[0], hinge[k + 1], hinge[k]]);
        builder.triangle([tip[0], tip[k], tip[k + 1]]);
    }
    let mut surface = builder.build();
    surface.compute_normals(CREASE);
    surface
}

/// The mirror image in the plane x = 0, with its outside kept outside.
fn mirrored(surface: &SurfaceData) -> SurfaceData {
    let mut mirror = surface.clone();
    for p in &mut mirror.positions {
        *p = Point3::new(-p.x, p.y, p.z);
    }
    for triangle in &mut mirror.triangles {
        triangle.swap(1, 2);
    }
    for corners in mirror.uvs.iter_mut().flatten() {
        corners.swap(1, 2);
    }
    for corners in mirror.normals.iter_mut().flatten() {
        corners.swap(1, 2);
        for normal in corners {
            normal.x = -normal.x;
        }
    }
    mirror
}
