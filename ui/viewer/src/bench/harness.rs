//! The benchmark's scene, its renderer, and a bare loop beside it.

use trocar_scene::Snapshot;

use crate::bench::{BaselineRenderer, TestScene};
use crate::draw_list::DrawList;
use crate::error::ViewError;
use crate::gpu::surfaces::SurfaceCopies;
use crate::gpu::{Gpu, targets};
use crate::layout::Layout;
use crate::pacing::Pace;
use crate::picture::Picture;
use crate::quality::Quality;
use crate::renderer::Renderer;
use crate::view::View;

/// Draws a [`TestScene`] into a texture.
pub struct BenchRenderer {
    gpu: Gpu,
    test_scene: TestScene,
    view: View,
    renderer: Renderer,
    bare: BaselineRenderer,
    target: wgpu::Texture,
}

impl BenchRenderer {
    /// A test scene of about so many triangles, in a picture of that size.
    ///
    /// # Errors
    /// [`ViewError::NoAdapter`], [`ViewError::Refused`], [`ViewError::Size`].
    pub fn new(triangles: usize, size: [u32; 2]) -> Result<Self, ViewError> {
        let gpu = Gpu::headless()?;
        targets::check_size(&gpu, size)?;
        let test_scene = TestScene::new(triangles);
        let view = test_scene.view(f64::from(size[0]) / f64::from(size[1]));
        let target = targets::target(&gpu, size, targets::COLOR, 1);
        let mut renderer = Renderer::new(&gpu, None);
        renderer.update(&gpu, &test_scene.snapshot());
        let bare = BaselineRenderer::new(&gpu, renderer.draw_list(), &view, &target);
        Ok(Self { gpu, test_scene, view, renderer, bare, target })
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Moves the instruments and draws a frame; returns when the device has finished it.
    pub fn frame(&mut self, layout: &Layout, quality: Quality) {
        self.submit(layout, quality);
        self.finish();
    }

    /// As [`Self::frame`], without waiting for the device.
    pub fn submit(&mut self, layout: &Layout, quality: Quality) {
        self.test_scene.move_instruments();
        let scene = self.test_scene.snapshot();
        self.renderer.update(&self.gpu, &scene);
        self.renderer.draw(&self.gpu, &scene, &self.view, layout, quality, &self.target);
    }

    /// The same with the bare loop.
    pub fn bare_frame(&mut self) {
        self.test_scene.move_instruments();
        self.renderer.update(&self.gpu, &self.test_scene.snapshot());
        self.bare.draw(&self.gpu, self.renderer.draw_list(), &self.view);
        self.finish();
    }

    /// Checks for changes and draws them; returns whether there were any.
    pub fn look(&mut self, quality: Quality) -> bool {
        let (scene, pace) = (self.test_scene.snapshot(), Pace { quality, scale: 1.0 });
        let needed = self.renderer.needs_draw(&scene, &self.view, &Layout::Mono, pace, &self.target);
        if needed {
            self.renderer.update(&self.gpu, &scene);
            self.renderer.draw_scaled(&self.gpu, &scene, &self.view, &Layout::Mono, pace, &self.target);
            self.finish();
        }
        needed
    }

    /// Draws another scene through its first camera; returns when the device has finished it.
    pub fn watch(&mut self, scene: &Snapshot, quality: Quality) {
        let aspect = f64::from(self.target.width()) / f64::from(self.target.height());
        let view = View::default_of(scene, Some(aspect));
        self.renderer.update(&self.gpu, scene);
        self.renderer.draw(&self.gpu, scene, &view, &Layout::Mono, quality, &self.target);
        self.finish();
    }

    /// The last drawn picture.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub fn picture(&self) -> Result<Picture, ViewError> {
        let bytes = targets::read(&self.gpu, &self.target)?;
        let (width, height) = (self.target.width(), self.target.height());
        Ok(Picture { width, height, color: bytes.as_chunks().0.to_vec() })
    }

    /// Waits for the device; [`Gpu::check`] reports a lost one.
    pub fn finish(&self) {
        finish(&self.gpu);
    }
}

/// A deforming sheet, and its copy on the device.
pub struct Upload {
    gpu: Gpu,
    test_scene: TestScene,
    draw_list: DrawList,
    copies: SurfaceCopies,
}

impl Upload {
    /// A sheet of `side × side` vertices.
    pub fn new(gpu: &Gpu, side: usize) -> Self {
        let test_scene = TestScene::sheet_of(side);
        let mut upload = Self {
            gpu: gpu.clone(),
            test_scene,
            draw_list: DrawList::new(),
            copies: SurfaceCopies::default(),
        };
        upload.send();
        upload
    }

    /// Moves every vertex.
    pub fn deform(&mut self) {
        self.test_scene.deform();
    }

    /// Follows the scene and uploads changes; returns their number of bytes once the device has them.
    pub fn send(&mut self) -> u64 {
        let before = self.copies.bytes_sent;
        self.draw_list.update(&self.test_scene.snapshot());
        for item in self.draw_list.items() {
            self.copies.send(&self.gpu, &item.surface);
        }
        self.copies.sweep();
        self.gpu.queue.submit([]);
        finish(&self.gpu);
        self.copies.bytes_sent - before
    }
}

fn finish(gpu: &Gpu) {
    if let Err(error) = gpu.device.poll(wgpu::PollType::wait_indefinitely()) {
        tracing::debug!("nothing to wait for: {error}");
    }
}
