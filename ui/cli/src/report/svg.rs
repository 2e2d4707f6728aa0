//! Charts as inline SVG whose colours come from the page's style sheet, so that light and dark both fit.

use std::fmt::Write as _;

use super::scale::Scale;
use crate::escape::escape;

/// A chart under construction: axes first, then its marks.
pub struct Chart {
    svg: String,
    height: f64,
    /// Horizontal axis.
    pub x: Scale,
    /// Vertical axis.
    pub y: Scale,
}

/// Space around the plot area \[px\].
#[derive(Clone, Copy, Debug)]
pub struct Margins {
    /// Left, for the labels of the vertical axis.
    pub left: f64,
    /// Right.
    pub right: f64,
    /// Above.
    pub top: f64,
    /// Below, for the labels of the horizontal axis.
    pub bottom: f64,
}

/// Room for labels on both axes.
pub const MARGINS: Margins = Margins { left: 68.0, right: 14.0, top: 12.0, bottom: 38.0 };

impl Chart {
    /// An empty chart of a size \[px\]; `describe` is its text alternative for screen readers.
    pub fn new(width: f64, height: f64, describe: &str, x: Scale, y: Scale) -> Self {
        let describe = escape(describe);
        let svg = format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{describe}\" \
             xmlns=\"http://www.w3.org/2000/svg\">"
        );
        Self { svg, height, x, y }
    }

    /// Grid, ticks and labels of both axes.
    pub fn axes(&mut self, x_label: &str, y_label: &str, x_ticks: usize, y_ticks: usize) -> &mut Self {
        self.x_axis(x_label, x_ticks);
        let (left, right) = self.x.pixels();
        for (value, text) in self.y.ticks(y_ticks) {
            let y = self.y.pixel(value);
            self.segment("grid", (left, y), (right, y));
            self.text("tick end", (left - 7.0, y + 4.0), &text);
        }
        let middle = 0.5 * (self.y.pixels().0 + self.y.pixels().1);
        let _ = write!(
            self.svg,
            "<text class=\"axis mid\" transform=\"translate(13 {middle:.1}) rotate(-90)\">{}</text>",
            escape(y_label)
        );
        self
    }

    /// Grid, ticks and label of the horizontal axis only.
    pub fn x_axis(&mut self, label: &str, ticks: usize) -> &mut Self {
        let (bottom, top) = self.y.pixels();
        for (value, text) in self.x.ticks(ticks) {
            let x = self.x.pixel(value);
            self.segment("grid", (x, bottom), (x, top));
            self.text("tick mid", (x, bottom + 16.0), &text);
        }
        let middle = 0.5 * (self.x.pixels().0 + self.x.pixels().1);
        let below = self.height - 5.0;
        self.text("axis mid", (middle, below), label);
        self
    }

    /// A line through points given in values; a point that is not finite breaks it.
    pub fn line(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) -> &mut Self {
        let mut path = String::new();
        let mut pen_down = false;
        for (x, y) in points {
            if !(x.is_finite() && y.is_finite()) {
                pen_down = false;
                continue;
            }
            let command = if pen_down { 'L' } else { 'M' };
            let _ = write!(path, "{command}{:.1} {:.1}", self.x.pixel(x), self.y.clamped(y));
            pen_down = true;
        }
        if !path.is_empty() {
            let _ = write!(self.svg, "<path class=\"line {class}\" d=\"{path}\"/>");
        }
        self
    }

    /// The area between a lower and an upper value: (x, low, high).
    pub fn band(&mut self, class: &str, points: &[(f64, f64, f64)]) -> &mut Self {
        if points.len() < 2 {
            return self;
        }
        let mut path = String::new();
        for (i, (x, _, high)) in points.iter().enumerate() {
            let command = if i == 0 { 'M' } else { 'L' };
            let _ = write!(path, "{command}{:.1} {:.1}", self.x.pixel(*x), self.y.clamped(*high));
        }
        for (x, low, _) in points.iter().rev() {
            let _ = write!(path, "L{:.1} {:.1}", self.x.pixel(*x), self.y.clamped(*low));
        }
        let _ = write!(self.svg, "<path class=\"band {class}\" d=\"{path}Z\"/>");
        self
    }

    /// A horizontal line at a value, with a label at its right end.
    pub fn level(&mut self, class: &str, value: f64, label: &str) -> &mut Self {
        let (left, right) = self.x.pixels();
        let y = self.y.clamped(value);
        self.segment(class, (left, y), (right, y));
        self.text("note end", (right - 2.0, y - 5.0), label);
        self
    }

    /// A rectangle between two corners in pixels, with a tooltip.
    pub fn rect(&mut self, class: &str, (x0, y0): (f64, f64), (x1, y1): (f64, f64), tip: &str) -> &mut Self {
        let (x, y) = (x0.min(x1), y0.min(y1));
        let (width, height) = ((x1 - x0).abs().max(0.8), (y1 - y0).abs().max(0.8));
        let _ = write!(
            self.svg,
            "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             rx=\"1.5\"><title>{}</title></rect>",
            escape(tip)
        );
        self
    }

    /// A circle about a point in pixels, with a tooltip.
    pub fn dot(&mut self, class: &str, (x, y): (f64, f64), radius: f64, tip: &str) -> &mut Self {
        let _ = write!(
            self.svg,
            "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\"><title>{}</title></circle>",
            escape(tip)
        );
        self
    }

    /// A cross at a point in pixels, with a tooltip.
    pub fn cross(&mut self, class: &str, (x, y): (f64, f64), tip: &str) -> &mut Self {
        let r = 4.5;
        let _ = write!(
            self.svg,
            "<path class=\"line {class}\" d=\"M{:.1} {:.1}L{:.1} {:.1}M{:.1} {:.1}L{:.1} {:.1}\"><title>{}</title></path>",
            x - r,
            y - r,
            x + r,
            y + r,
            x - r,
            y + r,
            x + r,
            y - r,
            escape(tip)
        );
        self
    }

    /// A straight line between two points in pixels.
    pub fn segment(&mut self, class: &str, (x0, y0): (f64, f64), (x1, y1): (f64, f64)) -> &mut Self {
        let _ = write!(
            self.svg,
            "<line class=\"{class}\" x1=\"{x0:.1}\" y1=\"{y0:.1}\" x2=\"{x1:.1}\" y2=\"{y1:.1}\"/>"
        );
        self
    }

    /// Text at a point in pixels.
    pub fn text(&mut self, class: &str, (x, y): (f64, f64), text: &str) -> &mut Self {
        let _ = write!(self.svg, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escape(text));
        self
    }

    /// The whole element.
    pub fn finish(mut self) -> String {
        self.svg.push_str("</svg>");
        self.svg
    }
}
