//! The canvas: the scene between the panels.

use egui::{Color32, Pos2, Rect, Stroke, Ui, Vec2};

use super::surface::WindowSurface;
use super::view_state::{AS_SEEN, StereoLayout, SubjectView};
use crate::error::ViewError;
use crate::gpu::Gpu;
use crate::pacing::Pace;

/// Colour of the selection.
const SELECTED: Color32 = Color32::from_rgb(255, 200, 60);

/// The textures of a window's subjects.
#[derive(Default)]
pub(super) struct Canvas {
    textures: Vec<Option<(egui::TextureId, wgpu::Texture)>>,
    /// Where each subject was last shown \[pixels\].
    cells: Vec<Rect>,
}

impl Canvas {
    /// The subject at a position of the window \[pixels\], with that position in its picture (0 to 1 from left and top).
    pub(super) fn at(&self, place: Pos2) -> Option<(usize, [f64; 2])> {
        let index = self.cells.iter().position(|cell| cell.contains(place))?;
        let cell = self.cells[index];
        let share = (place - cell.min) / cell.size();
        Some((index, [f64::from(share.x), f64::from(share.y)]))
    }

    /// Height of a subject's picture \[pixels\], at least one.
    pub(super) fn height(&self, index: usize) -> f64 {
        self.cells.get(index).map_or(1.0, |cell| f64::from(cell.height()).max(1.0))
    }

    /// All subjects of the window beside each other.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub(super) fn show(
        &mut self,
        ui: &mut Ui,
        gpu: &Gpu,
        painter: &mut WindowSurface,
        subject_views: &mut [SubjectView],
        pace: Pace,
    ) -> Result<(), ViewError> {
        self.textures.resize(subject_views.len(), None);
        self.cells.clear();
        let whole = ui.available_rect_before_wrap();
        let width = whole.width() / subject_views.len().max(1) as f32;
        let scale = ui.ctx().pixels_per_point();
        for (index, subject_view) in subject_views.iter_mut().enumerate() {
            let left = whole.left() + width * index as f32;
            let cell = Rect::from_min_size(Pos2::new(left, whole.top()), Vec2::new(width, whole.height()));
            // Aligned to whole pixels: rows of an interleaved picture belong to one eye each.
            let edge = |at: f32| (at * scale).round() / scale;
            let cell = Rect::from_min_max(
                Pos2::new(edge(cell.left()), edge(cell.top())),
                Pos2::new(edge(cell.right()), edge(cell.bottom())),
            );
            let size = [cell.width(), cell.height()].map(|side| (side * scale).round() as u32);
            if size.contains(&0) {
                self.cells.push(Rect::NOTHING);
                continue;
            }
            self.cells.push(cell * scale);
            subject_view.draw(gpu, size, pace);
            gpu.check()?;
            let Some(target) = subject_view.target() else { continue };
            let slot = &mut self.textures[index];
            if slot.as_ref().is_none_or(|(_, shown)| shown != target) {
                let id = painter.register(gpu, target, AS_SEEN, slot.as_ref().map(|(id, _)| *id));
                *slot = Some((id, target.clone()));
            }
            let Some((id, _)) = slot else { continue };
            let all = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
            ui.painter().image(*id, cell, all, Color32::WHITE);
            outline(ui, cell, subject_view);
        }
        Ok(())
    }
}

/// A box around the selected entity, with its name.
fn outline(ui: &Ui, cell: Rect, subject_view: &SubjectView) {
    let Some(entity) = subject_view.selected.filter(|_| subject_view.eyes == StereoLayout::One) else {
        return;
    };
    let view = subject_view.view(f64::from(cell.width() / cell.height()));
    let place = |corner: &nalgebra::Point3<f64>| {
        let at = view.onto_lens(view.project(corner)?.0);
        Some(cell.min + Vec2::new(at[0] as f32, at[1] as f32) * cell.size())
    };
    let painter = ui.painter_at(cell);
    let mut top: Option<Pos2> = None;
    for corners in subject_view.boxes(entity) {
        let seen: Vec<Option<Pos2>> = corners.iter().map(place).collect();
        for (a, b) in (0..8usize).flat_map(|a| [1, 2, 4].map(|bit| (a, a ^ bit))).filter(|(a, b)| a < b) {
            if let (Some(a), Some(b)) = (seen[a], seen[b]) {
                painter.line_segment([a, b], Stroke::new(1.0, SELECTED));
            }
        }
        let highest = seen.into_iter().flatten().min_by(|a, b| a.y.total_cmp(&b.y));
        top = [top, highest].into_iter().flatten().min_by(|a, b| a.y.total_cmp(&b.y));
    }
    if let Some(at) = top {
        let name = subject_view.scene.name(entity);
        let font = egui::FontId::proportional(13.0);
        painter.text(at - Vec2::new(0.0, 4.0), egui::Align2::CENTER_BOTTOM, name, font, SELECTED);
    }
}
