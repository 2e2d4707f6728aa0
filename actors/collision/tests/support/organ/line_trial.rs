//! A long trial of the dynamic point against brute force: every segment of every step.

use nalgebra::Point3;
use trocar_collision::Surface;
use trocar_collision::dynamic_point::{DynamicPoint, LineConfig, LineStatistics};
use trocar_collision::moving_surface::MovingSurface;
use trocar_collision::primitive::closest_segment_triangle;

use super::{Organ, Wanderer};

/// What is tried.
#[derive(Clone, Copy, Debug)]
pub struct Trial {
    pub triangles: usize,
    pub steps: usize,
    pub seed: u64,
    /// Of how many steps the organ deforms in one.
    pub deforms_every: usize,
    /// Of how many steps the organ is cut, or closed again, in one.
    pub cuts_every: usize,
    /// Seconds that pass for the organ in a step.
    pub interval_secs: f64,
    /// Whether the hand keeps still but for leaps, so that only the organ comes to it.
    pub hand_rests: bool,
    pub config: LineConfig,
}

/// What came of it.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// Segments that brute force finds in contact.
    pub in_contact: u64,
    /// Those of them that the method told nothing of.
    pub missed: u64,
    /// Contacts that brute force does not find.
    pub invented: u64,
    /// Largest difference of a distance \[m\].
    pub error: f64,
    pub statistics: LineStatistics,
}

/// Contacts so near to the end of the reach are anybody's \[m\].
const TIE: f64 = 1e-12;

pub fn run(trial: &Trial, mut progress: impl FnMut(usize, &Outcome)) -> Outcome {
    let organ = Organ::with_triangles(trial.triangles);
    let whole = organ.triangles();
    let mut triangles = whole.clone();
    let mut time = 0.0;
    let mut vertices = organ.vertices(time);
    let mut mesh = MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"));
    let mut line = DynamicPoint::new(trial.config).expect("a valid line");
    let mut hand = Wanderer::new(trial.seed, 1e-4);
    if trial.hand_rests {
        hand.leaps = 150;
    }
    let mut outcome = Outcome::default();
    for step in 0..trial.steps {
        let cuts = step > 0 && step % trial.cuts_every == 0;
        if cuts {
            // A hole that wanders, and closes again.
            let hole = (step / trial.cuts_every) % 2 == 1;
            let from = (step * 7) % whole.len();
            let inside = |index: usize| (index + whole.len() - from) % whole.len() < whole.len() / 20;
            triangles = (0..whole.len())
                .filter(|&index| !(hole && inside(index)))
                .map(|index| whole[index])
                .collect();
        }
        if cuts || step % trial.deforms_every == 0 {
            time += trial.interval_secs * trial.deforms_every as f64;
            vertices = organ.vertices(time);
            let now = Surface::new(&vertices, &triangles).expect("a surface");
            mesh.update(&now, trial.interval_secs * trial.deforms_every as f64).expect("a time");
        }
        let shaft = hand.shaft();
        // Now and then at another speed: the certificate has to notice.
        hand.step = if trial.hand_rests { 0.0 } else { [1e-4, 1e-4, 5e-4, 2e-5][(step / 500) % 4] };
        let contacts = line.update(&mesh, &shaft).expect("a finite line").to_vec();
        let reach = trial.config.radius + trial.config.margin;
        for (index, exact) in
            brute_force(&vertices, &triangles, &shaft, trial.config.segments, reach).into_iter().enumerate()
        {
            let told = contacts[index].map(|contact| contact.distance);
            // What is crossed is in reach of a line without a radius, too.
            let surely = exact <= (reach - TIE).max(0.0);
            outcome.in_contact += u64::from(surely);
            match told {
                Some(told) if exact <= reach + TIE => outcome.error = outcome.error.max((told - exact).abs()),
                Some(_) => outcome.invented += 1,
                None if surely => outcome.missed += 1,
                None => {}
            }
        }
        outcome.statistics = line.statistics().clone();
        progress(step, &outcome);
    }
    outcome
}

/// Distance of each segment from all triangles, told exactly where it is within reach.
fn brute_force(
    vertices: &[Point3<f64>],
    triangles: &[[u32; 3]],
    shaft: &[Point3<f64>; 2],
    segments: usize,
    reach: f64,
) -> Vec<f64> {
    let mut nearest = vec![f64::INFINITY; segments];
    let along = shaft[1] - shaft[0];
    let axis = along.normalize();
    for corners in triangles {
        let triangle = corners.map(|vertex| vertices[vertex as usize]);
        // Further from the endless line than a corner can be from the rest of the triangle: out of reach.
        let [ab, ac] = [triangle[1] - triangle[0], triangle[2] - triangle[0]];
        let extent = ab.norm_squared().max(ac.norm_squared()).sqrt();
        let from = triangle[0] - shaft[0];
        let off_axis = (from - axis * axis.dot(&from)).norm();
        if off_axis > reach + extent + 1e-9 {
            continue;
        }
        for (index, nearest) in nearest.iter_mut().enumerate() {
            let at = |share: f64| shaft[0] + along * share;
            let segment = [at(index as f64 / segments as f64), at((index + 1) as f64 / segments as f64)];
            let distance = closest_segment_triangle(&segment, &triangle).distance_squared.sqrt();
            *nearest = nearest.min(distance);
        }
    }
    nearest
}
