//! Sessions in a window: the event loop runs on the program's first thread, the session on another.

mod actors;
mod faults;
mod link;
mod mentor;
mod playback;
mod player;
mod session_host;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};

use trocar::app::App;
use trocar::play::Bindings;
use trocar::summary::Exit;
use trocar_kernel::recorder::{Recording, Replay};
use trocar_scene::Snapshot;
use trocar_viewer::overlay::Overlays;
use trocar_viewer::window::{LoopMessage, Options, Player, StereoLayout, Subject, Windows, display};

use crate::args::{self, PictureArgs, PictureQuality, WindowArgs};
use crate::failure::Failure;
use crate::signals;

use link::{Shared, ViewerPresence, WindowLink};
pub use playback::Findings;
pub use session_host::{Next, SessionHost};
pub use trocar_viewer::window::subject::Verdict;

/// Connects to the display; `None` where there is none, or no window is wanted.
///
/// # Errors
/// When a window is requested and cannot be opened.
pub fn connect(args: &WindowArgs, by_default: bool) -> Result<Option<Windows>, Failure> {
    if !args.window && (!by_default || args.headless || !display::is_announced()) {
        return Ok(None);
    }
    match Windows::connect() {
        Ok(windows) => Ok(Some(windows)),
        Err(why) if args.window => Err(Failure::usage(format!("no window: {why}"))),
        Err(why) => {
            tracing::warn!("no window: {why}");
            Ok(None)
        }
    }
}

/// Runs a session on its own thread while windows show it on this one.
///
/// # Errors
/// Those of the session.
pub fn with_session(
    windows: Windows,
    pictures: &PictureArgs,
    show: Show,
    session: impl FnOnce(SessionHost) -> Result<Exit, Failure> + Send,
) -> Result<Exit, Failure> {
    let plays = show.play.is_some();
    let (link, window_link) = link::link(show.title, show.folder, show.first);
    let shared = window_link.shared().clone();
    let player =
        show.play.map(|bindings| Box::new(player::Person::new(shared.clone(), bindings)) as Box<dyn Player>);
    let viewers = Arc::new(faults::Viewers::new(windows.proxy(), windows.health()));
    with(windows, pictures, vec![window_link], player, move || {
        session(SessionHost::new(link, plays, viewers))
    })
}

/// The content of a window, and its player.
pub struct Show {
    /// Title for people.
    pub title: String,
    /// The scenario's folder.
    pub folder: Option<PathBuf>,
    /// The first scene.
    pub first: Arc<Snapshot>,
    /// The control bindings, if a person plays.
    pub play: Option<Bindings>,
}

/// Shows recordings beside each other while `check` verifies the first one on its own thread.
///
/// # Errors
/// Errors of the check, recordings that cannot be played, and the end by a signal.
pub fn with_recordings(
    app: &App,
    windows: Windows,
    pictures: &PictureArgs,
    folder: Option<&Path>,
    recordings: &[Recording],
    check: impl FnOnce(&SyncSender<Findings>) -> Result<Exit, Failure> + Send,
) -> Result<Exit, Failure> {
    let signals = signals::catch()?;
    let (mut links, mut window_links) = (Vec::new(), Vec::new());
    for recording in recordings {
        let first = Replay::new(recording, app.registry()).map_err(Failure::invalid)?.snapshot();
        let title = match recordings.len() {
            1 => recording.metadata().scenario.clone(),
            _ => recording.path().file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        let (link, window_link) = link::link(title, folder.map(Path::to_owned), first);
        links.push(link);
        window_links.push(window_link);
    }
    with(windows, pictures, window_links, None, move || {
        std::thread::scope(|scope| {
            let mut players = Vec::new();
            let (found, findings) = sync_channel(1);
            let mut findings = Some(findings);
            for (link, recording) in links.into_iter().zip(recordings) {
                // Only the first recording is checked: the others have no findings.
                let findings = findings.take().unwrap_or_else(|| sync_channel(1).1);
                let player =
                    move || playback::play(link, recording, app.registry(), &findings, signals.stop());
                let thread = std::thread::Builder::new().name("playback".into());
                players.push(thread.spawn_scoped(scope, player).map_err(Failure::internal)?);
            }
            let checked = check(&found);
            for player in players {
                match player.join() {
                    Ok(played) => played.map_err(Failure::invalid)?,
                    Err(_) => return Err(Failure::internal("the thread of a playback panicked")),
                }
            }
            match (checked, signals.arrived()) {
                (Ok(Exit::Ok), Some((name, exit))) => {
                    Err(Failure { exit, message: format!("{name} closed the window") })
                }
                (checked, _) => checked,
            }
        })
    })
}

/// Runs `body` on its own thread while windows show subjects on this one.
fn with(
    windows: Windows,
    pictures: &PictureArgs,
    window_links: Vec<WindowLink>,
    player: Option<Box<dyn Player>>,
    body: impl FnOnce() -> Result<Exit, Failure> + Send,
) -> Result<Exit, Failure> {
    let overlays = Overlays::parse(&pictures.show.join(",")).map_err(Failure::usage)?;
    let shared: Vec<Arc<Shared>> =
        window_links.iter().map(|window_link| window_link.shared().clone()).collect();
    let set_presence = |presence| shared.iter().for_each(|shared| shared.set_presence(presence));
    let proxy = windows.proxy();
    std::thread::scope(|scope| {
        let runner = std::thread::Builder::new().name("session".into()).spawn_scoped(scope, move || {
            let result = body();
            if display::is_gone() {
                // The first thread died with the display: this one ends the program.
                leave(&result);
            }
            // The windows may be closed already.
            let _ = proxy.send_event(LoopMessage::Quit);
            result
        });
        let runner = runner.map_err(Failure::internal)?;
        let options = Options {
            subjects: window_links
                .into_iter()
                .map(|window_link| Box::new(window_link) as Box<dyn Subject>)
                .collect(),
            hands: player.is_some(),
            player,
            quality: pictures.care.map(PictureQuality::quality),
            eyes: eyes(pictures.eyes),
            stereo: pictures.stereo(),
            overlays,
            cameras: pictures.camera.clone(),
            size: [1180.0, 760.0],
        };
        match windows.show(options) {
            Ok(()) => set_presence(ViewerPresence::Left),
            Err(why) => {
                tracing::warn!("no pictures any more, the session goes on: {why}");
                set_presence(ViewerPresence::Cut);
            }
        }
        runner.join().unwrap_or_else(|_| Err(Failure::internal("the session's own thread panicked")))
    })
}

/// The stereo layout of a window.
fn eyes(eyes: args::StereoLayout) -> StereoLayout {
    match eyes {
        args::StereoLayout::One => StereoLayout::One,
        args::StereoLayout::SideBySide => StereoLayout::SideBySide,
        args::StereoLayout::TopBottom => StereoLayout::TopBottom,
        args::StereoLayout::Rows => StereoLayout::Rows,
        args::StereoLayout::Anaglyph => StereoLayout::Anaglyph,
        args::StereoLayout::Quad => StereoLayout::Quad,
    }
}

fn leave(result: &Result<Exit, Failure>) -> ! {
    let code = match result {
        Ok(exit) => exit.code(),
        Err(failure) => {
            crate::say(&failure.message);
            failure.exit.code()
        }
    };
    // A failure can no longer be reported.
    let _ = std::io::stdout().flush();
    std::process::exit(i32::from(code))
}
