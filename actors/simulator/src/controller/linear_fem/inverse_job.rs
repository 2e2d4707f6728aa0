//! Background jobs that compute the inverse of a linear organ.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_dynamics::elasticity::{Alteration, Elastic};
use trocar_dynamics::tet_mesh::TetMesh;
use trocar_scene::{Job, SimTime, Tick};

use super::Body;
use crate::linear_fem::{Cache, Limits, LinearFem, LinearFemError};

/// Duration of a job in lock-step, however long it takes \[s\].
const JOB: f64 = 0.5;

/// Result of a job.
type Built = Result<LinearFem, String>;

/// The result of the job of that number, if it is ready.
///
/// # Errors
/// Why it failed.
pub(crate) fn built(tick: &Tick<'_>, key: u64) -> Result<Option<LinearFem>, String> {
    let Some(output) = tick.jobs.take(key) else { return Ok(None) };
    let built = output.downcast::<Built>().map_err(|_| "its job delivered something else".to_owned())?;
    built.map(Some)
}

/// Creates the job that reads a body's inverse from the cache or computes it. Young's modulus \[Pa\], Poisson's ratio;
/// `progress` receives the fraction done, as the bits of an f64.
pub(crate) fn built_as_job(
    key: u64,
    mesh: &TetMesh,
    material: [f64; 2],
    pinned: &[u32],
    cache: Option<Cache>,
    progress: &Arc<AtomicU64>,
) -> Job {
    let (mesh, pinned) = (mesh.clone(), pinned.to_vec());
    job(key, material, progress, move |material, report_progress| {
        let limits = Limits::default();
        match &cache {
            Some(cache) => {
                cache.body(mesh, material, &pinned, &limits, report_progress).map(|(body, _)| body)
            }
            None => LinearFem::new(mesh, material, &pinned, &limits, report_progress),
        }
    })
}

/// Topology changes and thermal damage of a body.
pub(crate) struct MeshChange {
    /// Of its elements.
    pub alterations: Vec<Alteration>,
    /// Which node each of the added nodes duplicates.
    pub parents: Vec<u32>,
}

/// Creates the job that computes the inverse of the changed body.
pub(crate) fn altered_as_job(
    key: u64,
    mesh: &TetMesh,
    material: [f64; 2],
    pinned: &[u32],
    MeshChange { alterations, parents }: MeshChange,
    progress: &Arc<AtomicU64>,
) -> Job {
    let (mesh, pinned) = (mesh.clone(), pinned.to_vec());
    job(key, material, progress, move |material, report_progress| {
        LinearFem::parted(
            mesh,
            material,
            &alterations,
            &parents,
            &pinned,
            &Limits::default(),
            report_progress,
        )
    })
}

fn job(
    key: u64,
    [young_modulus, poisson_ratio]: [f64; 2],
    progress: &Arc<AtomicU64>,
    build: impl FnOnce(&Elastic, &mut dyn FnMut(f64) -> bool) -> Result<LinearFem, LinearFemError>
    + Send
    + 'static,
) -> Job {
    let progress = progress.clone();
    let work = move || {
        let mut report_progress = |share: f64| {
            progress.store(share.to_bits(), Ordering::Relaxed);
            true
        };
        let material = Elastic::new(young_modulus, poisson_ratio).map_err(|error| error.to_string());
        let built: Built = material
            .and_then(|material| build(&material, &mut report_progress).map_err(|error| error.to_string()));
        Box::new(built) as trocar_scene::JobOutput
    };
    Job { key, takes: SimTime::from_secs_f64(JOB), work: Box::new(work) }
}

impl Body {
    /// Submits the job for the inverse, once, and takes the result.
    pub(super) fn wait(&mut self, key: u64, cache: Option<&Cache>, tick: &Tick<'_>) -> Result<(), String> {
        if self.solver.is_some() {
            return Ok(());
        }
        if let Some(built) = built(tick, key)? {
            self.solver = Some(Box::new(built));
        } else if !self.submitted {
            let material = [self.kind.young_modulus, self.kind.poisson_ratio];
            let (pinned, progress) = (&self.body.pinned, &self.progress);
            let mesh_change = self.divisible.as_ref().and_then(|(_, altered)| altered.mesh_change());
            let job = match mesh_change {
                Some(mesh_change) => altered_as_job(key, &self.mesh, material, pinned, mesh_change, progress),
                None => built_as_job(key, &self.mesh, material, pinned, cache.cloned(), progress),
            };
            self.submitted = tick.jobs.submit(job);
        }
        Ok(())
    }
}
