//! Draws text into pictures: legends and names.

use egui::epaint::{Color32, CornerRadius, FontId, Pos2, Rect, Vec2};
use egui::{Align2, Context, LayerId, RawInput};
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
}

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
                let font = FontId::proportional(0.9 * legend::letters(high));
                for ([x, y], words) in &note.labels {
                    let at = pane.lerp_inside(Vec2::new(*x as f32, *y as f32)).round();
                    let ink = Color32::from_rgb(250, 250, 235);
                    let text = painter.layout_no_wrap((*words).to_owned(), font.clone(), ink);
                    let place = Align2::CENTER_CENTER.anchor_size(at, text.size());
                    let back = Color32::from_black_alpha(120);
                    painter.rect_filled(place.expand(2.0), CornerRadius::same(2), back);
                    painter.galley(place.min.round(), text, ink);
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
