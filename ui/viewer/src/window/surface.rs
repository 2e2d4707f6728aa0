//! The surface of one window, and the user interface drawn onto it.

use std::sync::Arc;

use winit::window::Window;

use crate::error::ViewError;
use crate::gpu::{Gpu, targets};

/// A window's surface with the renderer of the user interface.
pub struct WindowSurface {
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    egui: egui_wgpu::Renderer,
}

/// The outcome of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameOutcome {
    /// It is on the screen.
    Yes,
    /// There is nothing to draw on: the window has no size, or is not visible.
    NotNow,
    /// The surface has changed: try again.
    Again,
}

impl WindowSurface {
    /// The device that draws on this window, and its surface.
    ///
    /// # Errors
    /// [`ViewError::NoAdapter`], [`ViewError::Refused`].
    pub fn new(window: &Arc<Window>) -> Result<(Gpu, Self), ViewError> {
        super::display::quieten_wayland();
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
        let surface = instance
            .create_surface(Arc::clone(window))
            .map_err(|error| ViewError::NoAdapter(format!("no surface for a window: {error}")))?;
        let gpu = Gpu::on(instance, Some(&surface))?;
        let size = window.inner_size();
        let capabilities = surface.get_capabilities(&gpu.adapter);
        let refused = |reason: &str| ViewError::Refused {
            adapter: gpu.adapter.get_info().name.clone(),
            reason: reason.to_owned(),
        };
        // The user interface blends in sRGB: a format without conversion.
        let format = capabilities
            .formats
            .iter()
            .copied()
            .find(|format| !format.is_srgb())
            .or(capabilities.formats.first().copied())
            .ok_or_else(|| refused("it cannot draw on windows"))?;
        let mut config = surface
            .get_default_config(&gpu.adapter, size.width.max(1), size.height.max(1))
            .ok_or_else(|| refused("it cannot draw on this window"))?;
        config.format = format;
        config.present_mode = wgpu::PresentMode::AutoVsync;
        config.desired_maximum_frame_latency = 1;
        surface.configure(&gpu.device, &config);
        let options = egui_wgpu::RendererOptions { dithering: false, ..Default::default() };
        let egui = egui_wgpu::Renderer::new(&gpu.device, format, options);
        Ok((gpu, Self { surface, config, egui }))
    }

    /// Width and height \[pixels\].
    pub fn size(&self) -> [u32; 2] {
        [self.config.width, self.config.height]
    }

    /// Resizes the surface. A window without a size keeps the last one.
    pub fn resize(&mut self, gpu: &Gpu, [width, height]: [u32; 2]) {
        if targets::check_size(gpu, [width, height]).is_ok() && [width, height] != self.size() {
            (self.config.width, self.config.height) = (width, height);
            self.surface.configure(&gpu.device, &self.config);
        }
    }

    /// Registers a texture with the user interface, replacing `before`.
    pub fn register(
        &mut self,
        gpu: &Gpu,
        texture: &wgpu::Texture,
        format: wgpu::TextureFormat,
        before: Option<egui::TextureId>,
    ) -> egui::TextureId {
        let descriptor = wgpu::TextureViewDescriptor { format: Some(format), ..Default::default() };
        let view = texture.create_view(&descriptor);
        // Nearest filtering: rows of an interleaved picture must not be mixed.
        let filter = wgpu::FilterMode::Nearest;
        match before {
            Some(id) => {
                self.egui.update_egui_texture_from_wgpu_texture(&gpu.device, &view, filter, id);
                id
            }
            None => self.egui.register_native_texture(&gpu.device, &view, filter),
        }
    }

    /// Draws the user interface and shows the frame.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub fn show(
        &mut self,
        gpu: &Gpu,
        window: &Window,
        shapes: &[egui::ClippedPrimitive],
        mut changed: egui::TexturesDelta,
        pixels_per_point: f32,
    ) -> Result<FrameOutcome, ViewError> {
        gpu.check()?;
        // Also for a frame that is not shown: texture changes are reported only once.
        for (id, deltas) in changed.set.drain() {
            for delta in deltas {
                self.egui.update_texture(&gpu.device, &gpu.queue, id, &delta);
            }
        }
        let free: Vec<egui::TextureId> = changed.free.drain().collect();
        let shown = self.paint(gpu, window, shapes, pixels_per_point);
        free.iter().for_each(|id| self.egui.free_texture(id));
        // Polls even without work: only then is a device loss reported.
        let _ = gpu.device.poll(wgpu::PollType::Poll);
        gpu.check()?;
        Ok(shown)
    }

    fn paint(
        &mut self,
        gpu: &Gpu,
        window: &Window,
        shapes: &[egui::ClippedPrimitive],
        pixels_per_point: f32,
    ) -> FrameOutcome {
        use wgpu::CurrentSurfaceTexture as Current;
        let texture = match self.surface.get_current_texture() {
            Current::Success(texture) | Current::Suboptimal(texture) => texture,
            Current::Timeout | Current::Occluded | Current::Validation => return FrameOutcome::NotNow,
            Current::Outdated | Current::Lost => {
                self.surface.configure(&gpu.device, &self.config);
                return FrameOutcome::Again;
            }
        };
        let screen = egui_wgpu::ScreenDescriptor { size_in_pixels: self.size(), pixels_per_point };
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        let mut work = self.egui.update_buffers(&gpu.device, &gpu.queue, &mut encoder, shapes, &screen);
        {
            let view = texture.texture.create_view(&Default::default());
            let attachment = wgpu::RenderPassColorAttachment {
                view: &view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            };
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("window"),
                color_attachments: &[Some(attachment)],
                ..Default::default()
            });
            self.egui.render(&mut pass.forget_lifetime(), shapes, &screen);
        }
        work.push(encoder.finish());
        gpu.queue.submit(work);
        window.pre_present_notify();
        gpu.queue.present(texture);
        FrameOutcome::Yes
    }
}
