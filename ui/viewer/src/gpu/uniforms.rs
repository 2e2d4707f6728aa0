//! Uniforms of frames, lights and items, in the byte layout of the shaders.

use bytemuck::{Pod, Zeroable};

use crate::lights::LIGHTS_MAX;

/// A light.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct GpuLight {
    pub(crate) position: [f32; 3],
    pub(crate) cone_scale: f32,
    pub(crate) direction: [f32; 3],
    pub(crate) cone_bias: f32,
    pub(crate) candela: [f32; 3],
    pub(crate) unused: u32,
    pub(crate) clip_from_world: [[f32; 4]; 4],
}

/// Per-frame uniforms.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct GpuFrame {
    pub(crate) clip_from_world: [[f32; 4]; 4],
    pub(crate) eye: [f32; 4],
    pub(crate) forward: [f32; 4],
    pub(crate) above: [f32; 4],
    pub(crate) below: [f32; 4],
    pub(crate) light_count: u32,
    pub(crate) shadow_texel: f32,
    pub(crate) unused: [u32; 2],
    pub(crate) lights: [GpuLight; LIGHTS_MAX],
}

/// Per-item uniforms. Items have the stride of the offset alignment that every adapter supports, so each ends with
/// padding.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct GpuItem {
    pub(crate) world_from_item: [[f32; 4]; 4],
    pub(crate) base_color: [f32; 4],
    pub(crate) surface: [f32; 4],
    pub(crate) tiling: [f32; 2],
    pub(crate) number: u32,
    pub(crate) flags: u32,
    pub(crate) mean_color: [f32; 4],
    pub(crate) empty: [[f32; 4]; 8],
}

/// Bytes of an item that shaders read.
pub(crate) const ITEM_BYTES: u64 = 128;
const _: () =
    assert!(size_of::<GpuItem>() == 256 && std::mem::offset_of!(GpuItem, empty) == ITEM_BYTES as usize);
