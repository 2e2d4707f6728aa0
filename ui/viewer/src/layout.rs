//! Several views in one picture.

use crate::view::View;

/// A part of a picture, in shares of its width and height from the left and the top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pane {
    /// Left edge.
    pub x: f64,
    /// Upper edge.
    pub y: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
}

impl Pane {
    /// All of the picture.
    pub const WHOLE: Self = Self { x: 0.0, y: 0.0, width: 1.0, height: 1.0 };

    /// Its pixels in a picture of this size: left, top, width, height; at least one pixel.
    pub fn pixels(&self, [width, height]: [u32; 2]) -> [u32; 4] {
        let edge = |share: f64, side: u32| (share.clamp(0.0, 1.0) * f64::from(side)).round() as u32;
        let (left, top) = (edge(self.x, width).min(width - 1), edge(self.y, height).min(height - 1));
        let (right, bottom) = (edge(self.x + self.width, width), edge(self.y + self.height, height));
        [left, top, right.max(left + 1).min(width) - left, bottom.max(top + 1).min(height) - top]
    }
}

/// How views share a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Layout {
    /// One view.
    #[default]
    Mono,
    /// Left and right eye beside each other.
    SideBySide(Stereo),
    /// Left eye above the right one.
    TopBottom(Stereo),
    /// Even rows (counted from the top, beginning with 0) for the left eye, odd ones for the right: polarised monitors.
    RowInterleaved(Stereo),
    /// Red from the left eye, green and blue from the right.
    Anaglyph(Stereo),
}

/// Two eyes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stereo {
    /// Between the eyes \[m\]; that of a stereo laparoscope is a few millimetres.
    pub interocular: f64,
    /// Depth at which both eyes see the same \[m\].
    pub convergence: f64,
}

impl Default for Stereo {
    fn default() -> Self {
        Self { interocular: 0.0048, convergence: 0.2 }
    }
}

/// How two pictures become one, pixel by pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weave {
    /// Each in its own pane.
    Panes,
    /// By rows.
    Rows,
    /// By colour.
    Colors,
}

impl Layout {
    /// The eyes of a view, each with its pane, and how they become one picture.
    pub fn eyes(&self, view: &View) -> (Vec<(Pane, View)>, Weave) {
        let pair = |stereo: &Stereo, panes: [Pane; 2]| {
            let eyes = view.stereo(stereo.interocular, stereo.convergence);
            panes.into_iter().zip(eyes).collect::<Vec<_>>()
        };
        let half = |x, y, width, height| Pane { x, y, width, height };
        match self {
            Self::Mono => (vec![(Pane::WHOLE, *view)], Weave::Panes),
            Self::SideBySide(stereo) => {
                (pair(stereo, [half(0.0, 0.0, 0.5, 1.0), half(0.5, 0.0, 0.5, 1.0)]), Weave::Panes)
            }
            Self::TopBottom(stereo) => {
                (pair(stereo, [half(0.0, 0.0, 1.0, 0.5), half(0.0, 0.5, 1.0, 0.5)]), Weave::Panes)
            }
            Self::RowInterleaved(stereo) => (pair(stereo, [Pane::WHOLE; 2]), Weave::Rows),
            Self::Anaglyph(stereo) => (pair(stereo, [Pane::WHOLE; 2]), Weave::Colors),
        }
    }
}
