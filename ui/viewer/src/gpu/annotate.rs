//! Draws text into pictures: legends, names, captions, lines at the top, and the frame of a picture that stands still.

use egui::epaint::{Color32, CornerRadius, FontId, Pos2, Rect, Vec2};
use egui::{Align2, Context, LayerId, Painter, RawInput, Stroke, StrokeKind};
use egui_wgpu::{Renderer, RendererOptions, ScreenDescriptor};

use crate::gpu::Gpu;
use crate::overlay::{Legend, legend};

/// The text of one pane.
pub struct Note<'a> {
    /// Pane in the picture \[pixels\]: left, top, width, height.
    pub pane: [u32; 4],
    /// Legends; the first one is at the bottom.
    pub legends: &'a [Legend],
    /// Labels, with the position of their middle in the pane, from 0 (left, top) to 1.
    pub labels: Vec<([f64; 2], &'a str)>,
    /// Captions, with the position in the pane that they stand above.
    pub captions: Vec<([f64; 2], &'a str)>,
    /// Lines at the top.
    pub banner: &'a [String],
    /// Whether the pane has a frame: it stands still.
    pub is_framed: bool,
}

/// Letters, and the plate behind them.
const INK: Color32 = Color32::from_rgb(250, 250, 235);
const PLATE: Color32 = Color32::from_black_alpha(120);
/// The frame of a picture that stands still, and the letters of the lines at the top.
const FRAME: Color32 = Color32::from_rgb(120, 200, 255);

/// Draws text into pictures of one format.
pub struct Annotator {
    format: wgpu::TextureFormat,
    context: Context,
    renderer: Renderer,
}

impl Annotator {
    /// For pictures of that format.
    pub fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Self {
        let renderer = Renderer::new(&gpu.device, format, RendererOptions::PREDICTABLE);
        Self { format, context: Context::default(), renderer }
    }

    /// Whether it draws into pictures of that format.
    pub fn is_for(&self, format: wgpu::TextureFormat) -> bool {
        self.format == format
    }

    /// Draws into a finished picture.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        size: [u32; 2],
        notes: &[Note<'_>],
    ) {
        let [width, height] = size.map(|pixels| pixels as f32);
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, Vec2::new(width, height))),
            max_texture_side: Some(gpu.device.limits().max_texture_dimension_2d as usize),
            ..RawInput::default()
        };
        let mut output = self.context.run_ui(input, |ui| {
            let painter = ui.ctx().layer_painter(LayerId::background());
            for note in notes {
                let [left, top, wide, high] = note.pane.map(|pixels| pixels as f32);
                let pane = Rect::from_min_size(Pos2::new(left, top), Vec2::new(wide, high));
                let painter = painter.with_clip_rect(pane);
                let letters = legend::letters(high);
                let font = FontId::proportional(0.9 * letters);
                let at = |[x, y]: [f64; 2]| pane.lerp_inside(Vec2::new(x as f32, y as f32)).round();
                for (place, words) in &note.labels {
                    write(&painter, at(*place), Align2::CENTER_CENTER, words, &font, INK);
                }
                for (place, words) in &note.captions {
                    let above = at(*place) - Vec2::new(0.0, (0.7 * letters).round());
                    write(&painter, above, Align2::CENTER_BOTTOM, words, &font, INK);
                }
                if note.is_framed {
                    let width = (0.25 * letters).round().max(2.0);
                    let stroke = Stroke::new(width, FRAME);
                    painter.rect_stroke(pane, CornerRadius::ZERO, stroke, StrokeKind::Inside);
                }
                let font = FontId::proportional(1.2 * letters);
                let mut top = pane.center_top() + Vec2::new(0.0, (0.8 * letters).round());
                for line in note.banner {
                    write(&painter, top, Align2::CENTER_TOP, line, &font, FRAME);
                    top.y += (1.8 * letters).round();
                }
                legend::paint(note.legends, &painter, pane);
            }
        });
        let screen = ScreenDescriptor { size_in_pixels: size, pixels_per_point: output.pixels_per_point };
        let jobs = self.context.tessellate(std::mem::take(&mut output.shapes), output.pixels_per_point);
        for (id, deltas) in &output.textures_delta.set {
            for delta in deltas {
                self.renderer.update_texture(&gpu.device, &gpu.queue, *id, delta);
            }
        }
        self.renderer.update_buffers(&gpu.device, &gpu.queue, encoder, &jobs, &screen);
        {
            let attachment = wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
            };
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("notes"),
                color_attachments: &[Some(attachment)],
                ..Default::default()
            });
            self.renderer.render(&mut pass.forget_lifetime(), &jobs, &screen);
        }
        for id in &output.textures_delta.free {
            self.renderer.free_texture(id);
        }
        output.textures_delta.clear();
    }
}

/// Writes a text on a dark plate.
fn write(painter: &Painter, at: Pos2, anchor: Align2, words: &str, font: &FontId, ink: Color32) {
    let text = painter.layout_no_wrap(words.to_owned(), font.clone(), ink);
    let place = anchor.anchor_size(at, text.size());
    painter.rect_filled(place.expand(2.0), CornerRadius::same(2), PLATE);
    painter.galley(place.min.round(), text, ink);
}
