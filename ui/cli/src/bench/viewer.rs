//! The suite `viewer`: frames beside a bare loop that draws the same triangles, bytes sent, cost of an unchanged
//! picture, and the effect of a fully loaded rasteriser on the hands.

use std::cell::RefCell;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
use trocar::app::App;
use trocar::run::{self, RunOptions};
use trocar::summary::{BenchResult, Better};
use trocar_kernel::bench::median_and_spread;
use trocar_scene::SimTime;
use trocar_viewer::bench::{BenchRenderer, Upload, in_turns};
use trocar_viewer::layout::Stereo;
use trocar_viewer::{Layout, Quality, priority};

use super::exercise::SCENARIO;
use crate::failure::Failure;

/// Triangles of the test scene, and size of the picture.
const TRIANGLES: usize = 20_000;
const SIZE: [u32; 2] = [800, 600];
/// The same for a graphics card.
const GPU_TRIANGLES: usize = 200_000;
const GPU_SIZE: [u32; 2] = [1920, 1080];
const GPU_FRAMES: usize = 500;
/// Alternating blocks of each kind, and frames of a block.
const BLOCKS: usize = 11;
const FRAMES: usize = 5;
/// Vertices along a side of the deforming sheet: 5,041 of them; and uploads of it in a block.
const SHEET_SIDE: usize = 71;
const UPLOADS: usize = 60;
/// Duration of a block without changes, and interval at which the viewer checks for changes.
const IDLE: Duration = Duration::from_secs(2);
const LOOK: Duration = Duration::from_micros(16_667);
const IDLE_BLOCKS: usize = 5;
/// A block of the live exercise.
const LIVE: SimTime = SimTime::from_millis(5_000);
const LIVE_BLOCKS: usize = 5;

/// Processor time of the whole process \[s\].
fn cpu_secs() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Frames in each quality beside the bare loop, and two eyes beside one.
pub fn frames() -> Result<Vec<BenchResult>, Failure> {
    let bench_renderer = RefCell::new(BenchRenderer::new(TRIANGLES, SIZE)?);
    let stereo = Layout::SideBySide(Stereo::default());
    let frame = |layout: &Layout, quality| bench_renderer.borrow_mut().frame(layout, quality);
    let times = in_turns(
        BLOCKS,
        FRAMES,
        &mut [
            &mut || bench_renderer.borrow_mut().bare_frame(),
            &mut || frame(&Layout::Mono, Quality::PLAIN),
            &mut || frame(&Layout::Mono, Quality::FULL),
            &mut || frame(&stereo, Quality::FULL),
            &mut || frame(&Layout::Mono, Quality::FINE),
        ],
    );
    bench_renderer.borrow().gpu().check()?;
    let ms =
        |index: usize| median_and_spread(&times[index].iter().map(|secs| secs * 1e3).collect::<Vec<_>>());
    let beside = |name: &str, index: usize, floor: usize, bar: Option<f64>| {
        BenchResult::on_ratio(name, "ms", ms(index), ms(floor).0, bar, Better::Lower)
    };
    Ok(vec![
        beside("viewer_plain_frame", 1, 0, Some(1.2)),
        beside("viewer_full_frame", 2, 0, Some(2.5)),
        beside("viewer_fine_frame", 4, 0, None),
        beside("viewer_two_eyes_beside_one", 3, 2, Some(1.9)),
    ])
}

/// Upload of a mesh with every vertex moved: from the snapshot to the device.
pub fn uploads() -> Result<Vec<BenchResult>, Failure> {
    let bench_renderer = BenchRenderer::new(1_000, [64, 64])?;
    let mut upload = Upload::new(bench_renderer.gpu(), SHEET_SIDE);
    let mut blocks = Vec::with_capacity(BLOCKS);
    for block in 0..=BLOCKS {
        let (mut cpu, mut bytes) = (0.0, 0);
        for _ in 0..UPLOADS {
            upload.deform();
            let before = cpu_secs();
            bytes += upload.send();
            cpu += cpu_secs() - before;
        }
        if bytes < (UPLOADS * SHEET_SIDE * SHEET_SIDE * 24) as u64 {
            return Err(Failure::internal(format!("only {bytes} bytes of a mesh that deforms were sent")));
        }
        if block > 0 {
            blocks.push(cpu / UPLOADS as f64 * 1e3);
        }
    }
    bench_renderer.gpu().check()?;
    let figure = median_and_spread(&blocks);
    Ok(vec![BenchResult::on_value(
        "viewer_deforming_mesh_cpu",
        "ms per 5,041 vertices",
        figure,
        Some(1.0),
        Better::Lower,
    )])
}

/// Cost of a viewer while nothing changes: it checks 60 times a second, and draws nothing.
pub fn idle() -> Result<Vec<BenchResult>, Failure> {
    let mut bench_renderer = BenchRenderer::new(TRIANGLES, SIZE)?;
    bench_renderer.look(Quality::FULL);
    let share = |look: &mut dyn FnMut()| {
        let (before, begun) = (cpu_secs(), Instant::now());
        while begun.elapsed() < IDLE {
            look();
            thread::sleep(LOOK);
        }
        (cpu_secs() - before) / begun.elapsed().as_secs_f64()
    };
    let (mut ours, mut floor, mut drawn) = (Vec::new(), Vec::new(), 0);
    for _ in 0..IDLE_BLOCKS {
        floor.push(share(&mut || ()));
        ours.push(share(&mut || drawn += u32::from(bench_renderer.look(Quality::FULL))));
    }
    if drawn > 0 {
        return Err(Failure::internal(format!("{drawn} frames were drawn of a scene that does not change")));
    }
    let figure = median_and_spread(&ours);
    let mut row =
        BenchResult::on_value("viewer_idle_cpu", "share of a core", figure, Some(0.01), Better::Lower);
    row.floor = Some(median_and_spread(&floor).0);
    Ok(vec![row])
}

/// On-time share of the worse of the two hands; with a viewer, also the frames per second that it drew.
fn hands(app: &App, bench_renderer: Option<&mut BenchRenderer>) -> Result<(f64, f64), Failure> {
    let scenario = app.scenario(SCENARIO)?;
    let mut session = run::start(app, &scenario, &RunOptions::default())?;
    let reader = session.reader();
    let (stop, mut frames) = (AtomicBool::new(false), 0_u32);
    let begun = Instant::now();
    thread::scope(|scope| {
        let viewer = bench_renderer.zip(reader).map(|(bench_renderer, reader)| {
            let stop = &stop;
            scope.spawn(move || {
                priority::step_back();
                let mut frames = 0;
                while !stop.load(Ordering::Relaxed) {
                    bench_renderer.watch(&reader.scene(), Quality::FULL);
                    frames += 1;
                }
                frames
            })
        });
        session.run_until(LIVE);
        stop.store(true, Ordering::Relaxed);
        frames = viewer.map_or(Some(0), |viewer| viewer.join().ok()).unwrap_or(0);
    });
    let rate = f64::from(frames) / begun.elapsed().as_secs_f64();
    let on_time = session
        .reports()
        .iter()
        .filter(|row| row.name.starts_with("haptics."))
        .fold(1.0, |worst: f64, row| worst.min(row.on_time));
    session.finish();
    Ok((on_time, rate))
}

/// Two hands at 1 kHz while a rasteriser draws continuously, compared with the same without it.
pub fn full_load() -> Result<Vec<BenchResult>, Failure> {
    let app = App::new();
    let mut bench_renderer = BenchRenderer::new(TRIANGLES, SIZE)?;
    let (mut alone, mut watched, mut rates) = (Vec::new(), Vec::new(), Vec::new());
    for block in 0..=LIVE_BLOCKS {
        let floor = hands(&app, None)?.0;
        let (on_time, rate) = hands(&app, Some(&mut bench_renderer))?;
        // Pipelines are compiled in the first block.
        if block > 0 {
            alone.push(floor);
            watched.push(on_time);
            rates.push(rate);
        }
    }
    bench_renderer.gpu().check()?;
    let (floor, figure) = (median_and_spread(&alone).0, median_and_spread(&watched));
    let mut row = BenchResult::on_value(
        "viewer_hands_on_time_while_drawing",
        "share",
        figure,
        Some(floor - 0.005),
        Better::Higher,
    );
    row.floor = Some(floor);
    row.ratio = Some(figure.0 / floor).filter(|ratio| ratio.is_finite());
    let rate = BenchResult::on_value(
        "viewer_frame_rate_meanwhile",
        "frames per s",
        median_and_spread(&rates),
        None,
        Better::Higher,
    );
    Ok(vec![row, rate])
}

/// Figures of the graphics card, or that there is none.
pub fn card() -> Result<Vec<BenchResult>, Failure> {
    let mut bench_renderer = BenchRenderer::new(GPU_TRIANGLES, GPU_SIZE)?;
    if bench_renderer.gpu().is_software() {
        let none = |name: &str, better| BenchResult::on_value(name, "no GPU here", (0.0, 0.0), None, better);
        return Ok(vec![
            none("viewer_gpu_frame_rate", Better::Higher),
            none("viewer_gpu_snapshot_to_submitted", Better::Lower),
        ]);
    }
    let (mut rates, mut latencies) = (Vec::new(), Vec::new());
    for block in 0..=BLOCKS {
        let begun = Instant::now();
        let mut submitted = Vec::with_capacity(GPU_FRAMES);
        for frame in 0..GPU_FRAMES {
            let frame_begun = Instant::now();
            bench_renderer.submit(&Layout::Mono, Quality::FULL);
            submitted.push(frame_begun.elapsed().as_secs_f64() * 1e3);
            // As with a window: a few frames are in flight, not all of them.
            if frame % 3 == 2 {
                bench_renderer.finish();
            }
        }
        bench_renderer.finish();
        if block > 0 {
            rates.push(GPU_FRAMES as f64 / begun.elapsed().as_secs_f64());
            latencies.push(median_and_spread(&submitted).0);
        }
    }
    bench_renderer.gpu().check()?;
    Ok(vec![
        BenchResult::on_value(
            "viewer_gpu_frame_rate",
            "frames per s",
            median_and_spread(&rates),
            Some(1_000.0),
            Better::Higher,
        ),
        BenchResult::on_value(
            "viewer_gpu_snapshot_to_submitted",
            "ms",
            median_and_spread(&latencies),
            Some(2.0),
            Better::Lower,
        ),
    ])
}
