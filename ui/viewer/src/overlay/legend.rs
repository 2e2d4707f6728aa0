//! Legends: colour scales with numbers, and keys of single colours.

use egui::epaint::{Color32, CornerRadius, FontId, Mesh, Pos2, Rect, Shape, Vec2};
use egui::{Align2, Painter};

use crate::colormap::{Colormap, Ticks};

/// A legend of one colour or a colour scale, as data, so that a window may draw it in its own way.
#[derive(Clone, Debug, PartialEq)]
pub struct Legend {
    /// The quantity.
    pub title: String,
    /// Its unit; empty for none.
    pub unit: String,
    /// Values of the first and the last colour; `None` for the key of one colour.
    pub range: Option<[f64; 2]>,
    /// sRGB colours, evenly spaced over the range.
    pub colours: Vec<[u8; 3]>,
}

impl Legend {
    /// A colour scale.
    pub fn scale(title: &str, unit: &str, range: [f64; 2], colormap: Colormap) -> Self {
        let colours = colormap.table().map(|[r, g, b, _]| [r, g, b]).to_vec();
        Self { title: title.to_owned(), unit: unit.to_owned(), range: Some(range), colours }
    }

    /// The key of one colour.
    pub fn key(title: &str, [r, g, b, _]: [u8; 4]) -> Self {
        Self { title: title.to_owned(), unit: String::new(), range: None, colours: vec![[r, g, b]] }
    }

    /// The key of force arrows, with their length per newton.
    pub fn arrow(title: &str, color: [u8; 4], metres_per_newton: f64) -> Self {
        let millimetres = metres_per_newton * 1e3;
        let decimals = (1.0 - millimetres.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
        let length = format!("{millimetres:.decimals$}");
        let length =
            if length.contains('.') { length.trim_end_matches('0').trim_end_matches('.') } else { &length };
        Self { unit: format!("1 N = {length} mm"), ..Self::key(title, color) }
    }

    /// Title and unit, the text beside the colours.
    pub fn caption(&self) -> String {
        match (self.unit.as_str(), self.range) {
            ("", _) => self.title.clone(),
            (unit, Some(_)) => format!("{} [{unit}]", self.title),
            (unit, None) => format!("{}: {unit}", self.title),
        }
    }
}

/// Height of letters in a pane with that many rows \[pixels\].
pub(crate) fn letters(rows: f32) -> f32 {
    (rows / 42.0).clamp(9.0, 24.0).round()
}

/// Draws legends into the lower left corner of a pane, the first one lowest.
pub(crate) fn paint(legends: &[Legend], painter: &Painter, pane: Rect) {
    let letters = letters(pane.height());
    let font = FontId::proportional(letters);
    let ink = Color32::from_rgb(235, 235, 235);
    let (margin, width) = ((0.6 * letters).round(), (15.0 * letters).min(pane.width() - 2.0 * letters));
    let left = pane.left() + 2.0 * margin;
    let mut lower = pane.bottom() - 2.0 * margin;
    for legend in legends {
        let height = if legend.range.is_some() { 3.3 * letters } else { 1.25 * letters };
        let upper = (lower - height).round();
        if upper < pane.top() + margin || width < 4.0 * letters {
            return;
        }
        let caption = painter.layout_no_wrap(legend.caption(), font.clone(), ink);
        let wide = match legend.range {
            Some(_) => caption.size().x.max(width),
            None => caption.size().x + 1.4 * letters,
        };
        let back = Rect::from_min_size(Pos2::new(left, upper), Vec2::new(wide, height)).expand(margin);
        painter.rect_filled(back, CornerRadius::same(3), Color32::from_black_alpha(165));
        match legend.range {
            Some(range) => {
                painter.galley(Pos2::new(left, upper), caption, ink);
                let bar = Rect::from_min_size(
                    Pos2::new(left, upper + (1.35 * letters).round()),
                    Vec2::new(width.round(), (0.8 * letters).round()),
                );
                painter.add(Shape::mesh(ramp(&legend.colours, bar)));
                paint_ticks(range, painter, bar, letters, ink);
            }
            None => {
                let [r, g, b] = legend.colours.first().copied().unwrap_or_default();
                let side = (0.8 * letters).round();
                let at = Pos2::new(left, (upper + 0.5 * (height - side)).round());
                let swatch = Rect::from_min_size(at, Vec2::splat(side));
                painter.rect_filled(swatch, CornerRadius::ZERO, Color32::from_rgb(r, g, b));
                painter.galley(Pos2::new(left + 1.4 * letters, upper), caption, ink);
            }
        }
        lower = upper - 3.0 * margin;
    }
}

/// The colour bar, left to right; each colour is at the position of its value.
fn ramp(colours: &[[u8; 3]], bar: Rect) -> Mesh {
    let mut mesh = Mesh::default();
    let last = colours.len().saturating_sub(1).max(1) as f32;
    for (index, [r, g, b]) in colours.iter().enumerate() {
        let x = bar.left() + bar.width() * index as f32 / last;
        for y in [bar.top(), bar.bottom()] {
            mesh.colored_vertex(Pos2::new(x, y), Color32::from_rgb(*r, *g, *b));
        }
        if index > 0 {
            let at = 2 * index as u32;
            mesh.add_triangle(at - 2, at - 1, at);
            mesh.add_triangle(at - 1, at, at + 1);
        }
    }
    mesh
}

fn paint_ticks(range: [f64; 2], painter: &Painter, bar: Rect, letters: f32, ink: Color32) {
    let [low, high] = range;
    // Large and small numbers are shown with powers of a thousand.
    let power = (low.abs().max(high.abs()).log10() / 3.0).floor() as i32;
    let power = if (-1..=0).contains(&power) && high - low > 0.01 { 0 } else { 3 * power };
    let unit = 10_f64.powi(power);
    let ticks = Ticks::between(low / unit, high / unit, 5);
    let labels: Vec<String> = ticks.labels().collect();
    let font = FontId::proportional((0.85 * letters).max(8.0));
    let mut free = f32::NEG_INFINITY;
    for (value, label) in ticks.values.iter().zip(&labels) {
        let share = ((value * unit - low) / (high - low)) as f32;
        let x = (bar.left() + share * bar.width()).round().min(bar.right() - 1.0);
        let text = painter.layout_no_wrap(label.clone(), font.clone(), ink);
        let half = 0.5 * text.size().x;
        let centre = x.clamp(bar.left() + half, (bar.right() - half).max(bar.left() + half));
        painter.vline(x + 0.5, bar.bottom()..=bar.bottom() + 0.25 * letters, (1.0, ink));
        // A number that would overlap the previous one is left out.
        if centre - half > free {
            painter.galley(Pos2::new(centre - half, bar.bottom() + 0.25 * letters), text, ink);
            free = centre + half + 0.3 * letters;
        }
    }
    if power != 0 {
        let at = Pos2::new(bar.right(), bar.top() - 0.1 * letters);
        painter.text(at, Align2::RIGHT_BOTTOM, format!("× 10{}", superscript(power)), font, ink);
    }
}

fn superscript(number: i32) -> String {
    let raised = |digit| match digit {
        '-' => '⁻',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        // The other superscript digits are consecutive code points.
        digit => char::from_u32(0x2070 + digit as u32 - '0' as u32).unwrap_or(digit),
    };
    number.to_string().chars().map(raised).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_raised() {
        assert_eq!([3, -12, 6, 9].map(superscript), ["³", "⁻¹²", "⁶", "⁹"]);
    }

    #[test]
    fn captions_say_what_in_which_unit() {
        let scale = Legend::scale("temperature", "°C", [37.0, 100.0], Colormap::Inferno);
        assert_eq!(scale.caption(), "temperature [°C]");
        assert_eq!((scale.colours.len(), scale.colours[255]), (256, Colormap::Inferno.color(1.0)));
        assert_eq!(Legend::key("in contact", [1, 2, 3, 4]).caption(), "in contact");
        let arrow = |metres| Legend::arrow("force", [0; 4], metres).unit;
        assert_eq!(
            [0.01, 0.0025, 0.1, 1e-6].map(arrow),
            ["1 N = 10 mm", "1 N = 2.5 mm", "1 N = 100 mm", "1 N = 0.001 mm"]
        );
    }
}
