//! Pictures and films of a run or a replay, drawn without a window.

use std::path::{Path, PathBuf};

use trocar::summary::RunSummary;
use trocar_scene::output_file::{self, Claim};
use trocar_scene::{SimTime, Snapshot};
use trocar_viewer::draw_list::DrawList;
use trocar_viewer::layout::TileView;
use trocar_viewer::{
    Film, Layout, Motion, OffscreenRenderer, Overlays, Picture, Quality, StillPicture, View, ViewError,
};

use crate::args::{PictureArgs, PictureQuality, StereoLayout};
use crate::failure::Failure;
use crate::output::{self, numbered};

/// Takes pictures and film frames during a run.
pub struct Photographer {
    renderer: OffscreenRenderer,
    /// `None` for four views, until the first picture fits them to the scene.
    layout: Option<Layout>,
    cameras: Vec<String>,
    size: [u32; 2],
    picture: Option<Claim>,
    film: Option<(Film, PathBuf)>,
    motion: Motion,
    still: StillPicture,
    frame: SimTime,
    next: SimTime,
    failed: Option<ViewError>,
}

impl Photographer {
    /// `folder` is the scenario's, below which files of textures are. Returns `None` when no picture is asked for.
    ///
    /// # Errors
    /// When there is no graphics adapter, the size is impossible, a file cannot be written, or a camera or overlay is
    /// unknown.
    pub fn new(args: &PictureArgs, folder: Option<&Path>, scene: &Snapshot) -> Result<Option<Self>, Failure> {
        Self::repeated(args, 1, folder, scene)
    }

    /// The same for the run `number` of a window's session, which replaces no pictures of the runs before it.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn repeated(
        args: &PictureArgs,
        number: u32,
        folder: Option<&Path>,
        scene: &Snapshot,
    ) -> Result<Option<Self>, Failure> {
        if !args.are_asked_for() {
            return Ok(None);
        }
        if let Some(file) = &args.picture {
            Picture::check_name(file)?;
        }
        for camera in &args.camera {
            View::named(scene, camera, None)?;
        }
        if args.eyes == StereoLayout::Quad && args.camera.len() > 1 {
            return Err(Failure::usage("--eyes quad shows four views of one camera; several are named"));
        }
        let overlays = Overlays::parse(&args.show.join(",")).map_err(Failure::usage)?;
        let mut renderer = OffscreenRenderer::new(folder.map(Path::to_owned))?;
        renderer.quality = args.care.map_or(Quality::FINE, PictureQuality::quality);
        renderer.renderer_mut().overlays = overlays;
        let (width, height) = args.size;
        let stereo = args.stereo();
        let layout = match args.eyes {
            StereoLayout::One => Some(Layout::Mono),
            StereoLayout::SideBySide => Some(Layout::SideBySide(stereo)),
            StereoLayout::TopBottom => Some(Layout::TopBottom(stereo)),
            StereoLayout::Rows => Some(Layout::RowInterleaved(stereo)),
            StereoLayout::Anaglyph => Some(Layout::Anaglyph(stereo)),
            StereoLayout::Quad => None,
        };
        renderer.check_size([width, height])?;
        let replace = output::replace(args.force);
        let picture = args.picture.as_deref().map(|file| output::claim(file, replace, number)).transpose()?;
        let film = args.film.as_deref().map(|file| {
            let file = free_name(file, number);
            let film = Film::create(&file, [width, height], args.frames_per_second, replace)?;
            Ok::<_, ViewError>((film, file))
        });
        let film = film.transpose()?;
        Ok(Some(Self {
            renderer,
            layout,
            cameras: args.camera.clone(),
            size: [width, height],
            picture,
            film,
            motion: Motion::new(),
            still: StillPicture::new(),
            frame: SimTime::from_secs_f64(1.0 / args.frames_per_second),
            next: SimTime::ZERO,
            failed: None,
        }))
    }

    /// Adds the frames that are due to the film. Frequent calls also capture the past that slow overlays such as trails
    /// show.
    pub fn look(&mut self, scene: &Snapshot, now: SimTime) {
        if !self.still.is_held() {
            self.renderer.renderer_mut().watch(scene);
        }
        if self.film.is_none() || self.failed.is_some() {
            return;
        }
        self.motion.feed(scene, now);
        if now < self.next {
            return;
        }
        let Some(shown) = self.motion.at(now) else { return };
        let shown = self.still.show(&shown);
        let taken = self.take(&shown);
        let Some((film, _)) = &mut self.film else { return };
        let mut shot = Ok(());
        // After a delay the current picture fills the frames that were missed.
        while self.next <= now && shot.is_ok() {
            shot = match &taken {
                Ok(picture) => film.frame(picture),
                Err(_) => break,
            };
            self.next += self.frame;
        }
        self.failed = taken.err().or(shot.err());
    }

    fn take(&mut self, scene: &Snapshot) -> Result<Picture, ViewError> {
        let aspect = Some(f64::from(self.size[0]) / f64::from(self.size[1]));
        let view = match self.cameras.first() {
            Some(name) => View::named(scene, name, aspect)?,
            None => View::default_of(scene, aspect),
        };
        let layout = self.layout.get_or_insert_with(|| {
            let mut stage = DrawList::new();
            stage.update(scene);
            Layout::quad(&stage, &view)
        });
        if let [_, _, ..] = self.cameras.as_slice() {
            let mut tiles = Vec::with_capacity(self.cameras.len());
            for name in &self.cameras {
                tiles.push(TileView::Free(View::named(scene, name, None)?));
            }
            let layout = Layout::grid(tiles).each(layout);
            return self.renderer.picture(scene, &view, &layout, self.size);
        }
        self.renderer.picture(scene, &view, layout, self.size)
    }

    /// Takes the last picture, and completes the film. What could not be made or written is added to the summary's losses,
    /// and returned; score, recording and report of the session are kept.
    pub fn finish(mut self, scene: &Snapshot, summary: &mut RunSummary) -> Vec<String> {
        let mut lost = Vec::new();
        if let Some(error) = self.failed.take() {
            // An incomplete film is discarded.
            self.film = None;
            lost.push(format!("no film: {error}"));
        }
        if let Some(claim) = self.picture.take() {
            let file = claim.file().display().to_string();
            let shown = self.still.show(scene);
            let png = self.take(&shown).and_then(|picture| picture.png());
            match png.and_then(|png| Ok(claim.write(&png)?)) {
                Ok(()) => summary.pictures.push(file),
                Err(error) => lost.push(format!("no picture: {error}")),
            }
        }
        if let Some((film, file)) = self.film.take() {
            match film.finish() {
                Ok(_) => summary.pictures.push(file.display().to_string()),
                Err(error) => lost.push(format!("no film: {error}")),
            }
        }
        summary.losses.extend(lost.iter().cloned());
        lost
    }
}

/// The name of the film of a repetition.
fn free_name(file: &Path, number: u32) -> PathBuf {
    if number <= 1 || output_file::is_stream(file) {
        return file.to_owned();
    }
    let is_free = |file: &PathBuf| file.symlink_metadata().is_err();
    (number..u32::MAX).map(|number| numbered(file, number)).find(is_free).unwrap_or_else(|| file.to_owned())
}
