//! Buttons whose symbols are drawn: fonts do not have them all.

use egui::{Color32, Pos2, Rect, Response, Sense, Shape, Stroke, Ui, Vec2};

/// A symbol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Icon {
    /// A triangle: go on.
    Play,
    /// Two bars: pause.
    Pause,
    /// A bar and a triangle that points to it: back to the beginning.
    Start,
}

/// Width and height of a button \[points\].
const SIZE: f32 = 22.0;
/// Half the height of a symbol \[points\].
const HALF: f32 = 5.5;

/// A button with a symbol, which `name` tells to people and to readers of screens.
pub(super) fn button(ui: &mut Ui, icon: Icon, name: &str) -> Response {
    let (rect, response) = ui.allocate_exact_size(Vec2::splat(SIZE), Sense::click());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Button, true, name));
    let visuals = ui.style().interact(&response);
    let painter = ui.painter();
    painter.rect_filled(rect.shrink(1.0), visuals.corner_radius, visuals.weak_bg_fill);
    for shape in shapes(icon, rect.center(), visuals.text_color()) {
        painter.add(shape);
    }
    response.on_hover_text(name)
}

/// The shapes of a symbol around its middle.
fn shapes(icon: Icon, middle: Pos2, color: Color32) -> Vec<Shape> {
    let at = |x: f32, y: f32| middle + Vec2::new(x, y);
    let bar = |x: f32, width: f32| {
        let rect = Rect::from_center_size(at(x, 0.0), Vec2::new(width, 2.0 * HALF));
        Shape::rect_filled(rect, 0.5, color)
    };
    let triangle = |corners: [Pos2; 3]| Shape::convex_polygon(corners.to_vec(), color, Stroke::NONE);
    match icon {
        Icon::Play => vec![triangle([at(-4.0, -HALF), at(5.5, 0.0), at(-4.0, HALF)])],
        Icon::Pause => vec![bar(-3.0, 3.5), bar(3.0, 3.5)],
        Icon::Start => vec![bar(-4.5, 2.5), triangle([at(-2.5, 0.0), at(5.5, -HALF), at(5.5, HALF)])],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_symbol_is_drawn_within_its_button_and_differs_from_the_others() {
        let button = Rect::from_center_size(Pos2::new(40.0, 30.0), Vec2::splat(SIZE));
        let mut seen = Vec::new();
        for icon in [Icon::Play, Icon::Pause, Icon::Start] {
            let shapes = shapes(icon, button.center(), Color32::WHITE);
            assert!(!shapes.is_empty(), "{icon:?}");
            for shape in &shapes {
                let bounds = shape.visual_bounding_rect();
                assert!(button.contains_rect(bounds) && bounds.area() > 10.0, "{icon:?}: {bounds:?}");
            }
            assert!(!seen.contains(&shapes), "{icon:?} looks like another one");
            seen.push(shapes);
        }
    }
}
