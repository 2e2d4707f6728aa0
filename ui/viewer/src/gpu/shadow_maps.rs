//! Shadow maps: depth textures of the lights.

use crate::gpu::Gpu;
use crate::gpu::targets::DEPTH;
use crate::lights::SHADOWS_MAX;

/// Side of a shadow map \[texels\].
pub const SHADOW_SIDE: u32 = 1024;

/// Two layers for each light with shadows: the shadow map for shading, and a cache of its still casters.
pub struct ShadowMaps {
    /// All shadow maps, as an array texture.
    pub all: wgpu::TextureView,
    /// Each of them as a render target.
    pub layers: Vec<wgpu::TextureView>,
    /// The caches of still casters.
    pub still_layers: Vec<wgpu::TextureView>,
    shown: wgpu::Texture,
    still: wgpu::Texture,
}

impl ShadowMaps {
    /// Empty shadow maps.
    pub fn new(gpu: &Gpu) -> Self {
        let maps = |usage| {
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("shadows"),
                size: wgpu::Extent3d {
                    width: SHADOW_SIDE,
                    height: SHADOW_SIDE,
                    depth_or_array_layers: SHADOWS_MAX as u32,
                },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: DEPTH,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | usage,
                view_formats: &[],
            })
        };
        let shown = maps(wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST);
        let still = maps(wgpu::TextureUsages::COPY_SRC);
        let layers = |texture: &wgpu::Texture| {
            let layer = |layer| {
                texture.create_view(&wgpu::TextureViewDescriptor {
                    dimension: Some(wgpu::TextureViewDimension::D2),
                    base_array_layer: layer,
                    array_layer_count: Some(1),
                    ..Default::default()
                })
            };
            (0..SHADOWS_MAX as u32).map(layer).collect()
        };
        let all = wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        };
        Self {
            all: shown.create_view(&all),
            layers: layers(&shown),
            still_layers: layers(&still),
            shown,
            still,
        }
    }

    /// Copies the still casters into a shadow map.
    pub fn begin_with_still(&self, encoder: &mut wgpu::CommandEncoder, layer: usize) {
        let place = |texture| wgpu::TexelCopyTextureInfo {
            texture,
            mip_level: 0,
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer as u32 },
            aspect: wgpu::TextureAspect::All,
        };
        let size = wgpu::Extent3d { width: SHADOW_SIDE, height: SHADOW_SIDE, depth_or_array_layers: 1 };
        encoder.copy_texture_to_texture(place(&self.still), place(&self.shown), size);
    }
}
