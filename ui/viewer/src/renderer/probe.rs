//! Probe pictures: depths and entities instead of colours.

use trocar_scene::Snapshot;

use crate::error::ViewError;
use crate::gpu::{Gpu, targets};
use crate::picture::Probe;
use crate::renderer::frames::Lighting;
use crate::renderer::{Renderer, cleared_depth};
use crate::view::View;

impl Renderer {
    /// Depths and entities through an undistorted view.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub fn probe(
        &mut self,
        gpu: &Gpu,
        scene: &Snapshot,
        view: &View,
        size: [u32; 2],
    ) -> Result<Probe, ViewError> {
        let lighting = Lighting { lights: &[], exposure: 1.0 };
        self.frames.set_eye(gpu, &self.passes, 0, scene, view, &lighting);
        let metres = targets::target(gpu, size, targets::METRES, 1);
        let numbers = targets::target(gpu, size, targets::NUMBERS, 1);
        let depth = targets::target(gpu, size, targets::DEPTH, 1).create_view(&Default::default());
        let views = [&metres, &numbers].map(|texture| texture.create_view(&Default::default()));
        let clear = [wgpu::Color { r: f64::from(f32::MAX), ..Default::default() }, wgpu::Color::TRANSPARENT];
        let attachment = |index: usize| {
            Some(wgpu::RenderPassColorAttachment {
                view: &views[index],
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(clear[index]),
                    store: wgpu::StoreOp::Store,
                },
            })
        };
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("probe"),
                color_attachments: &[attachment(0), attachment(1)],
                depth_stencil_attachment: Some(cleared_depth(&depth)),
                ..Default::default()
            });
            pass.set_pipeline(&self.passes.probe);
            pass.set_bind_group(0, self.frames.eye(0), &[]);
            for index in 0..self.items.draws.len() {
                self.draw_item(&mut pass, index, 1);
            }
        }
        let mut entities = self.items.entities.clone();
        let first_number = entities.len() as u32 + 1;
        let frame = (&self.passes, self.frames.eye(0));
        let textures = [&views[0], &views[1], &depth];
        entities.extend(self.particle_layer.measure(
            gpu,
            &mut encoder,
            frame,
            (view, size),
            first_number,
            textures,
        ));
        gpu.queue.submit([encoder.finish()]);
        let floats = targets::read(gpu, &metres)?;
        let whole = targets::read(gpu, &numbers)?;
        let far = |bytes: &[u8; 4]| {
            let metres = f32::from_le_bytes(*bytes);
            if metres == f32::MAX { f32::INFINITY } else { metres }
        };
        Ok(Probe {
            width: size[0],
            height: size[1],
            depth: floats.as_chunks().0.iter().map(far).collect(),
            numbers: whole.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect(),
            entities,
        })
    }
}
