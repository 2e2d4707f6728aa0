//! The suite `simulator` on one thread: beside finite elements of MuJoCo, position-based bodies of pypbd, rods of
//! PyElastica and cloth of Bullet where a Python has them; heat, liquid, and the growth of all costs with size.
//!
//! Times are processor times of the thread: other load on the machine is not counted.

mod bearing;
mod bodies;
mod fem;
mod flows;
mod growth;
mod live;
mod peers;
mod rigid;
mod roofline;
mod soft;
mod surgery;

use std::path::Path;

use rustix::time::{ClockId, clock_gettime};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;

use crate::failure::Failure;

/// Blocks over which the median is taken.
const BLOCKS: usize = 7;

/// Processor time of this thread so far \[s\].
fn thread_secs() -> f64 {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
}

/// Seconds of one run of `work`.
fn secs(work: impl FnOnce()) -> f64 {
    let begun = thread_secs();
    work();
    thread_secs() - begun
}

/// Median and spread of one run \[s\], over blocks of `runs`.
fn per_run(runs: usize, mut work: impl FnMut()) -> (f64, f64) {
    let blocks: Vec<f64> =
        (0..BLOCKS).map(|_| secs(|| (0..runs).for_each(|_| work())) / runs as f64).collect();
    median_and_spread(&blocks)
}

/// A figure in another unit.
fn scaled((value, spread): (f64, f64), factor: f64) -> (f64, f64) {
    (value * factor, spread)
}

/// A time against a bar.
fn at_most(name: &str, unit: &str, figure: (f64, f64), bar: f64) -> BenchResult {
    BenchResult::on_value(format!("simulator_{name}"), unit, figure, Some(bar), Better::Lower)
}

/// A rate against a bar, from the time of one step.
fn at_least_hz(name: &str, (secs, spread): (f64, f64), bar: f64) -> BenchResult {
    let rate = (1.0 / secs, spread);
    BenchResult::on_value(format!("simulator_{name}"), "steps/s", rate, Some(bar), Better::Higher)
}

/// A row without a bar.
fn told(name: &str, unit: &str, value: f64, better: Better) -> BenchResult {
    BenchResult::on_value(format!("simulator_{name}"), unit, (value, 0.0), None, better)
}

/// Runs a part with a single-thread pool.
fn alone(
    part: impl FnOnce() -> Result<Vec<BenchResult>, Failure> + Send,
) -> Result<Vec<BenchResult>, Failure> {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(Failure::internal)?.install(part)
}

/// Finite elements.
pub fn elements(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    alone(|| {
        let mut rows = fem::linear()?;
        rows.extend(fem::dynamic(python)?);
        Ok(rows)
    })
}

/// Rigid bodies, cloth and position-based bodies.
pub fn soft(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    alone(|| {
        let mut rows = vec![rigid::share_of_pile()?];
        rows.extend(soft::cloth(python)?);
        rows.extend(soft::position_based(python)?);
        Ok(rows)
    })
}

/// Thread, heat and liquid.
pub fn flows(python: Option<&Path>) -> Result<Vec<BenchResult>, Failure> {
    alone(|| {
        let mut rows = flows::thread(python)?;
        rows.extend(flows::heat()?);
        rows.extend(flows::liquid()?);
        Ok(rows)
    })
}

/// Growth of the costs with size.
pub fn growth() -> Result<Vec<BenchResult>, Failure> {
    alone(growth::growth)
}

/// Two rates in one scene, live.
pub fn live() -> Result<Vec<BenchResult>, Failure> {
    live::live()
}

/// Rigid bodies that lie on soft ones, live.
pub fn bearing() -> Result<Vec<BenchResult>, Failure> {
    bearing::bearing()
}

/// Every scene, live.
pub fn scenes() -> Result<Vec<BenchResult>, Failure> {
    live::scenes()
}
