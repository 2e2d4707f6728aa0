//! Off-screen rendering for programs, without a window.

use std::path::PathBuf;

use trocar_scene::Snapshot;

use crate::error::ViewError;
use crate::gpu::{Gpu, targets};
use crate::layout::Layout;
use crate::picture::{Picture, Probe};
use crate::quality::Quality;
use crate::renderer::Renderer;
use crate::view::View;

/// A headless viewer: renders pictures, depths and segmentations of snapshots.
pub struct OffscreenRenderer {
    gpu: Gpu,
    renderer: Renderer,
    target: Option<wgpu::Texture>,
    folder: Option<PathBuf>,
    /// Quality of the pictures.
    pub quality: Quality,
}

impl OffscreenRenderer {
    /// On any adapter; `folder` is the scenario's, below which files of textures are.
    ///
    /// # Errors
    /// [`ViewError::NoAdapter`], [`ViewError::Refused`].
    pub fn new(folder: Option<PathBuf>) -> Result<Self, ViewError> {
        crate::window::display::quieten_wayland();
        let gpu = Gpu::headless()?;
        let renderer = Renderer::new(&gpu, folder.clone());
        Ok(Self { gpu, renderer, target: None, folder, quality: Quality::FINE })
    }

    /// Starts again on any available adapter after a device was lost. On an error everything stays unchanged.
    ///
    /// # Errors
    /// [`ViewError::NoAdapter`], [`ViewError::Refused`].
    pub fn renew(&mut self) -> Result<(), ViewError> {
        let mut anew = Self { quality: self.quality, ..Self::new(self.folder.clone())? };
        anew.renderer.overlays = self.renderer.overlays.clone();
        *self = anew;
        Ok(())
    }

    /// Whether a picture of that size can be drawn.
    ///
    /// # Errors
    /// [`ViewError::Size`], with the largest size that can.
    pub fn check_size(&self, size: [u32; 2]) -> Result<(), ViewError> {
        targets::check_size(&self.gpu, size)
    }

    /// The device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// The renderer.
    pub fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// The renderer, to change its overlays.
    pub fn renderer_mut(&mut self) -> &mut Renderer {
        &mut self.renderer
    }

    /// A picture of the scene through a view.
    ///
    /// # Errors
    /// [`ViewError::Size`], [`ViewError::DeviceLost`].
    pub fn picture(
        &mut self,
        scene: &Snapshot,
        view: &View,
        layout: &Layout,
        size: [u32; 2],
    ) -> Result<Picture, ViewError> {
        self.gpu.check()?;
        targets::check_size(&self.gpu, size)?;
        let fits = |texture: &wgpu::Texture| [texture.width(), texture.height()] == size;
        let target = self.target.take().filter(fits);
        let target = target.unwrap_or_else(|| targets::target(&self.gpu, size, targets::COLOR, 1));
        self.renderer.update(&self.gpu, scene);
        self.renderer.draw(&self.gpu, scene, view, layout, self.quality, &target);
        let bytes = targets::read(&self.gpu, &target)?;
        self.target = Some(target);
        Ok(Picture { width: size[0], height: size[1], color: bytes.as_chunks().0.to_vec() })
    }

    /// Depths and entities of the scene, through an undistorted view.
    ///
    /// # Errors
    /// [`ViewError::Size`], [`ViewError::DeviceLost`].
    pub fn probe(&mut self, scene: &Snapshot, view: &View, size: [u32; 2]) -> Result<Probe, ViewError> {
        self.gpu.check()?;
        targets::check_size(&self.gpu, size)?;
        self.renderer.update(&self.gpu, scene);
        self.renderer.probe(&self.gpu, scene, view, size)
    }
}
