//! Options of windows and pictures.

use std::path::PathBuf;

use clap::{Args, ValueEnum, ValueHint};
use trocar_viewer::Quality;
use trocar_viewer::layout::Stereo;

use crate::show::Show;

/// Whether there is a window.
#[derive(Clone, Copy, Debug, Args)]
#[command(next_help_heading = "Window")]
pub struct WindowArgs {
    /// Open a window, also where there would be none by default: there is one where there is a display, unless pictures
    /// or JSON are asked for, or time is virtual
    #[arg(long, conflicts_with = "headless")]
    pub window: bool,
    /// No window and no live table, whatever the display and the terminal
    #[arg(long)]
    pub headless: bool,
}

/// What is seen, in a window or drawn without one.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Pictures")]
pub struct PictureArgs {
    /// A picture of the last moment (PNG); `-` is stdout
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub picture: Option<PathBuf>,
    /// A film: FILE.gif, FILE.png (animated), or a folder for single frames
    #[arg(long, value_name = "FILE", value_hint = ValueHint::AnyPath)]
    pub film: Option<PathBuf>,
    /// Frames of the film per second of the session
    #[arg(long = "fps", value_name = "HZ", default_value_t = 25.0, allow_negative_numbers = true, value_parser = frames)]
    pub frames_per_second: f64,
    /// The camera to look through; several, separated by commas, stand beside each other [default: the first one]
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    pub camera: Vec<String>,
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "960x720", value_parser = size)]
    pub size: (u32, u32),
    /// One eye, how two of them share the picture, or four views
    #[arg(long, value_name = "LAYOUT", default_value = "one")]
    pub eyes: StereoLayout,
    /// What is shown over the scene, separated by commas; `field=NAME` picks one of several fields
    #[arg(long, value_name = "WHAT", value_delimiter = ',', value_parser = Show)]
    pub show: Vec<String>,
    /// Distance between the two eyes, in metres
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, default_value_t = 0.0048, value_parser = length)]
    pub interocular: f64,
    /// Depth at which both eyes see the same, in metres
    #[arg(long, value_name = "METRES", allow_negative_numbers = true, default_value_t = 0.2, value_parser = length)]
    pub convergence: f64,
    /// How much care goes into a picture [default: fine; in a window, what the machine can draw]
    #[arg(long = "quality", value_name = "QUALITY")]
    pub care: Option<PictureQuality>,
    /// Overwrite results that are named and there already; without it they are refused. An earlier one is whole until the
    /// new one is complete, a recording until the new session has begun
    #[arg(long, help_heading = "Output")]
    pub force: bool,
}

/// One eye, two of them in one picture, or four views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StereoLayout {
    /// One.
    One,
    /// Left and right beside each other.
    SideBySide,
    /// Left above right.
    TopBottom,
    /// Row by row: polarised monitors.
    Rows,
    /// Red and cyan glasses.
    Anaglyph,
    /// Four views: the camera's, from above, from the front, from the right.
    Quad,
}

/// How much care goes into a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PictureQuality {
    /// Base colours and one highlight: fast without a graphics card.
    Plain,
    /// Maps, wet highlights, shadows.
    Full,
    /// That with smooth edges.
    Fine,
}

impl PictureQuality {
    /// The viewer's quality of that name.
    pub fn quality(self) -> Quality {
        match self {
            Self::Plain => Quality::PLAIN,
            Self::Full => Quality::FULL,
            Self::Fine => Quality::FINE,
        }
    }
}

impl PictureArgs {
    /// The stereo settings.
    pub fn stereo(&self) -> Stereo {
        Stereo { interocular: self.interocular, convergence: self.convergence }
    }

    /// Whether the options ask for picture files.
    pub fn are_asked_for(&self) -> bool {
        self.picture.is_some() || self.film.is_some()
    }
}

pub fn size(text: &str) -> Result<(u32, u32), String> {
    let sides =
        text.split_once('x').and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    match sides {
        // How large a picture can be is known only to the graphics adapter.
        Some((width @ 1.., height @ 1..)) => Ok((width, height)),
        _ => Err("WIDTHxHEIGHT is expected, each side at least 1 pixel, such as 1280x960".to_owned()),
    }
}

fn frames(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.1..=240.0).contains(&value) => Ok(value),
        _ => Err("0.1 to 240 frames per second are possible".to_owned()),
    }
}

fn length(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (1e-6..=100.0).contains(&value) => Ok(value),
        _ => Err("a length above 0, at most 100 m, is expected".to_owned()),
    }
}
