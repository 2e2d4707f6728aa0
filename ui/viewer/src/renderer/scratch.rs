//! Intermediate textures, kept while their sizes stay the same.

use crate::gpu::{Gpu, targets};

/// Most sizes kept; a window that is being resized asks for new sizes all the time.
const KEPT_MAX: usize = 4;

/// A depth texture, and a multisampled colour target.
pub(super) struct Scratch {
    size: [u32; 2],
    samples: u32,
    format: wgpu::TextureFormat,
    pub(super) depth: wgpu::TextureView,
    /// The multisampled colour target.
    pub(super) smooth: Option<wgpu::TextureView>,
}

/// Scratch textures of recent sizes, and the pictures of eyes that are composed afterwards.
#[derive(Default)]
pub(super) struct Scratches {
    kept: Vec<Scratch>,
    eyes: Vec<(wgpu::Texture, wgpu::TextureView)>,
}

impl Scratches {
    /// Scratch textures of this kind.
    pub(super) fn get(
        &mut self,
        gpu: &Gpu,
        size: [u32; 2],
        samples: u32,
        format: wgpu::TextureFormat,
    ) -> &Scratch {
        let fits = |scratch: &Scratch| {
            scratch.size == size && scratch.samples == samples && scratch.format == format
        };
        let at = self.kept.iter().position(fits).unwrap_or_else(|| {
            if self.kept.len() >= KEPT_MAX {
                self.kept.remove(0);
            }
            let view = |format| targets::target(gpu, size, format, samples).create_view(&Default::default());
            let smooth = (samples > 1).then(|| view(format));
            self.kept.push(Scratch { size, samples, format, depth: view(targets::DEPTH), smooth });
            self.kept.len() - 1
        });
        &self.kept[at]
    }

    /// The picture of that eye.
    pub(super) fn eye(
        &mut self,
        gpu: &Gpu,
        index: usize,
        size: [u32; 2],
        format: wgpu::TextureFormat,
    ) -> wgpu::TextureView {
        let fits = |(texture, _): &(wgpu::Texture, wgpu::TextureView)| {
            [texture.width(), texture.height()] == size && texture.format() == format
        };
        if !self.eyes.get(index).is_some_and(fits) {
            let texture = targets::target(gpu, size, format, 1);
            let view = texture.create_view(&Default::default());
            self.eyes.truncate(index);
            self.eyes.push((texture, view));
        }
        self.eyes[index].1.clone()
    }
}
