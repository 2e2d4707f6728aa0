//! Pictures and films of a run or a replay, drawn without a window.

use std::path::{Path, PathBuf};

use trocar::summary::RunSummary;
use trocar_scene::{SimTime, Snapshot};
use trocar_viewer::layout::Stereo;
use trocar_viewer::{Eye, Film, Layout, Quality, View, ViewError};

use crate::args::{Care, Eyes, PictureArgs};
use crate::failure::Failure;
use crate::output;

/// Looks on while time passes, and leaves what was asked for.
pub struct Photographer {
    eye: Eye,
    layout: Layout,
    camera: Option<String>,
    size: [u32; 2],
    picture: Option<PathBuf>,
    film: Option<(Film, PathBuf)>,
    frame: SimTime,
    next: SimTime,
    failed: Option<ViewError>,
}

impl Photographer {
    /// `folder` is the scenario's, below which files of textures are. `None` when no picture is asked for, or when there is no graphics adapter: that is said, and the rest goes on.
    ///
    /// # Errors
    /// When a file cannot be written, or there is no such camera.
    pub fn new(args: &PictureArgs, folder: Option<&Path>, scene: &Snapshot) -> Result<Option<Self>, Failure> {
        if args.picture.is_none() && args.film.is_none() {
            return Ok(None);
        }
        if let Some(file) = &args.picture {
            output::check_writable(file)?;
        }
        if let Some(camera) = &args.camera {
            View::named(scene, camera, None).map_err(Failure::usage)?;
        }
        let mut eye = match Eye::new(folder.map(Path::to_owned)) {
            Ok(eye) => eye,
            Err(error) => {
                tracing::warn!("no pictures: {error}");
                return Ok(None);
            }
        };
        eye.quality = match args.care {
            Care::Plain => Quality::PLAIN,
            Care::Full => Quality::FULL,
            Care::Fine => Quality::FINE,
        };
        let (width, height) = args.size;
        let stereo = Stereo { interocular: args.interocular, convergence: args.convergence };
        let layout = match args.eyes {
            Eyes::One => Layout::Mono,
            Eyes::SideBySide => Layout::SideBySide(stereo),
            Eyes::TopBottom => Layout::TopBottom(stereo),
            Eyes::Rows => Layout::RowInterleaved(stereo),
            Eyes::Anaglyph => Layout::Anaglyph(stereo),
        };
        let film = args.film.as_ref().map(|file| {
            Film::create(file, [width, height], args.frames_per_second).map(|film| (film, file.clone()))
        });
        let film = film.transpose().map_err(Failure::invalid)?;
        Ok(Some(Self {
            eye,
            layout,
            camera: args.camera.clone(),
            size: [width, height],
            picture: args.picture.clone(),
            film,
            frame: SimTime::from_secs_f64(1.0 / args.frames_per_second),
            next: SimTime::ZERO,
            failed: None,
        }))
    }

    /// Adds frames to the film, as many as are due.
    pub fn look(&mut self, scene: &Snapshot, now: SimTime) {
        if self.film.is_none() || self.failed.is_some() || now < self.next {
            return;
        }
        let taken = self.take(scene);
        let Some((film, _)) = &mut self.film else { return };
        let mut shot = Ok(());
        // Whoever was kept away from looking shows what is now for as long as that took.
        while self.next <= now && shot.is_ok() {
            shot = match &taken {
                Ok(picture) => film.frame(picture),
                Err(_) => break,
            };
            self.next += self.frame;
        }
        self.failed = taken.err().or(shot.err());
    }

    fn take(&mut self, scene: &Snapshot) -> Result<trocar_viewer::Picture, ViewError> {
        let aspect = Some(f64::from(self.size[0]) / f64::from(self.size[1]));
        let view = match &self.camera {
            Some(name) => View::named(scene, name, aspect)?,
            None => View::default_of(scene, aspect),
        };
        self.eye.picture(scene, &view, &self.layout, self.size)
    }

    /// Takes the last picture, and completes the film. What could not be drawn or written is a loss that the summary
    /// tells of: score, recording and report of the session are kept all the same.
    pub fn finish(mut self, scene: &Snapshot, summary: &mut RunSummary) {
        if let Some(error) = self.failed.take() {
            // Half a film is none.
            self.film = None;
            summary.losses.push(format!("no film: {error}"));
        }
        if let Some(file) = self.picture.take() {
            match self.take(scene).and_then(|picture| picture.save(&file)) {
                Ok(()) => summary.pictures.push(file.display().to_string()),
                Err(error) => summary.losses.push(format!("no picture: {error}")),
            }
        }
        if let Some((film, file)) = self.film.take() {
            match film.finish() {
                Ok(_) => summary.pictures.push(file.display().to_string()),
                Err(error) => summary.losses.push(format!("no film: {error}")),
            }
        }
    }
}
