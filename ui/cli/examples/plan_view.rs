//! A viewer of one's own: the scene from above, in letters, four times per second.
//!
//! It has a thread of its own and reads snapshots; nobody knows that it is there. `cargo run --release --example
//! plan_view` shows five seconds of the peg transfer.

use std::time::Duration;

use trocar::prelude::*;
use trocar::run::{RunOptions, start};
use trocar::session::SceneReader;
use trocar_scene::{Instrument, Motion, RigidBody, Shape};

/// What is shown \[m\], and in how many letters.
const WIDTH: f64 = 0.24;
const COLUMNS: usize = 72;
const ROWS: usize = 24;

/// Draws the scene: `o` for what can move, `.` for what cannot, `L` and `R` for the tips of the instruments.
fn draw(scene: &Snapshot) -> String {
    let mut letters = vec![vec![' '; COLUMNS]; ROWS];
    let mut put = |entity: Entity, letter: char| {
        let at = scene.world_pose(entity).translation;
        // A letter is twice as high as it is wide.
        let column = (at.x / WIDTH + 0.5) * COLUMNS as f64;
        let row = ROWS as f64 / 2.0 - at.y / WIDTH * COLUMNS as f64 / 2.0;
        if (0.0..COLUMNS as f64).contains(&column) && (0.0..ROWS as f64).contains(&row) {
            letters[row as usize][column as usize] = letter;
        }
    };
    for (entity, _) in scene.iter::<Shape>() {
        let moves = scene.get::<RigidBody>(entity).is_some_and(|body| body.motion == Motion::Dynamic);
        put(entity, if moves { 'o' } else { '.' });
    }
    for (entity, _) in scene.iter::<Instrument>() {
        put(entity, if scene.name(entity).ends_with("left") { 'L' } else { 'R' });
    }
    letters.into_iter().map(String::from_iter).collect::<Vec<_>>().join("\n")
}

fn look(reader: &SceneReader) {
    for _ in 0..20 {
        let scene = reader.scene();
        println!("\x1b[H\x1b[2J{:.1} s\n{}", scene.time().as_secs_f64(), draw(&scene));
        std::thread::sleep(Duration::from_millis(250));
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let app = App::new();
    let mut session = start(&app, &app.scenario("peg-transfer")?, &RunOptions::default())?;
    let reader = session.reader().ok_or("a session in real time has a reader")?;
    let viewer = std::thread::spawn(move || look(&reader));
    session.run_until(SimTime::from_secs_f64(5.0));
    viewer.join().map_err(|_| "the viewer panicked")?;
    session.finish();
    Ok(())
}
