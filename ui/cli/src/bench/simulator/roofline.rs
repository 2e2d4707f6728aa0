//! Roofline share of a kernel (Williams, Waterman, Patterson, *Roofline*, 2009): the operations that its formulas need,
//! over those that this thread can do in the same time; or the bytes that it must read, over those that this thread can
//! read from as much memory. The larger share names the bottleneck.

use std::hint::black_box;

use trocar::summary::{BenchResult, Better};

use super::{BLOCKS, secs, told};

/// Lower bound on the work of a kernel's step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Work {
    /// Additions and multiplications.
    pub operations: f64,
    /// Whether numbers have 32 bits, four at a time where the machine supports it; otherwise 64.
    pub single: bool,
    /// Bytes read.
    pub bytes: f64,
}

/// The fastest of several runs, per second.
fn fastest(count: f64, mut work: impl FnMut()) -> f64 {
    count / (0..BLOCKS).map(|_| secs(&mut work)).fold(f64::INFINITY, f64::min)
}

/// Read bandwidth of this thread for a working set of so many bytes \[bytes/s\].
fn read_bandwidth(bytes: f64) -> f64 {
    let count = ((bytes / size_of::<f32>() as f64) as usize).clamp(1 << 12, 1 << 24);
    let memory = vec![1.0_f32; count];
    let rounds = (1_usize << 24).div_ceil(count);
    fastest((rounds * count * size_of::<f32>()) as f64, || {
        for _ in 0..rounds {
            // Sixteen independent sums, so that the additions are never the bottleneck.
            let sums = black_box(&memory).chunks_exact(16).fold([0.0_f32; 16], |mut sums, chunk| {
                sums.iter_mut().zip(chunk).for_each(|(sum, value)| *sum += value);
                sums
            });
            black_box(sums);
        }
    })
}

/// Peak additions and multiplications per second of this thread, with the widest registers that the kernels are
/// compiled for.
macro_rules! peak {
    ($name:ident, $number:ty, $lanes:literal) => {
        fn $name() -> f64 {
            const ROUNDS: usize = 1 << 19;
            let mut sums = black_box([1.0 as $number; $lanes]);
            let (factor, term) = black_box((0.999_999 as $number, 1e-6 as $number));
            fastest((2 * ROUNDS * $lanes) as f64, || {
                pulp::Arch::new().dispatch(
                    #[inline(always)]
                    || {
                        for _ in 0..ROUNDS {
                            sums.iter_mut().for_each(|sum| *sum = *sum * factor + term);
                        }
                    },
                );
                black_box(&mut sums);
            })
        }
    };
}
// As many sums as fill eight registers of 32 bytes, without dependencies between them.
peak!(peak_single, f32, 64);
peak!(peak_double, f64, 32);

/// The roofline share of a step that takes `step_secs`.
pub fn share(name: &str, step_secs: f64, work: Work) -> BenchResult {
    let peak = if work.single { peak_single() } else { peak_double() };
    let arithmetic = work.operations / step_secs / peak;
    let memory = if work.bytes > 0.0 { work.bytes / step_secs / read_bandwidth(work.bytes) } else { 0.0 };
    let (of, value) = if memory > arithmetic { ("bandwidth", memory) } else { ("arithmetic", arithmetic) };
    told(&format!("{name}_share_of_{of}"), "share", value, Better::Higher)
}
