//! Render targets, and their readback.

use crate::error::ViewError;
use crate::gpu::Gpu;

/// Colour format of pictures: sRGB, opacity last.
pub const COLOR: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
/// Format of the depth buffer.
pub const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Depth of a probe \[m\].
pub const METRES: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Format of a probe's numbers.
pub const NUMBERS: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// An empty render target.
pub fn target(gpu: &Gpu, size: [u32; 2], format: wgpu::TextureFormat, samples: u32) -> wgpu::Texture {
    let mut usage = wgpu::TextureUsages::RENDER_ATTACHMENT;
    if samples == 1 {
        usage |= wgpu::TextureUsages::COPY_SRC | wgpu::TextureUsages::TEXTURE_BINDING;
    }
    if format == DEPTH {
        // Smoke samples the depth to fade at solid surfaces.
        usage |= wgpu::TextureUsages::TEXTURE_BINDING;
    }
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: samples,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage,
        view_formats: &[],
    })
}

/// Whether the device supports pictures of that size.
///
/// # Errors
/// [`ViewError::Size`].
pub fn check_size(gpu: &Gpu, size: [u32; 2]) -> Result<(), ViewError> {
    let limits = gpu.device.limits();
    let largest = largest_of_shape(size, limits.max_texture_dimension_2d, limits.max_buffer_size);
    let [width, height] = size;
    let is_sound = width >= 1 && height >= 1 && width <= largest[0] && height <= largest[1];
    if is_sound { Ok(()) } else { Err(ViewError::Size { width, height, largest }) }
}

/// The largest picture of the same shape: its sides are textures' sides, and a buffer takes all of its pixels.
fn largest_of_shape([width, height]: [u32; 2], side_max: u32, bytes_max: u64) -> [u32; 2] {
    let fits = |width: u32, height: u32| {
        width.max(height) <= side_max && u64::from(padded_row(width)) * u64::from(height) <= bytes_max
    };
    let whole = [width.max(1), height.max(1)];
    if fits(whole[0], whole[1]) {
        return whole;
    }
    let longer = u64::from(whole[0].max(whole[1]));
    let of_side = |side: u32| whole.map(|part| (u64::from(part) * u64::from(side) / longer).max(1) as u32);
    let (mut least, mut most) = (1, side_max.max(1));
    while least < most {
        let middle = least + (most - least).div_ceil(2);
        let [width, height] = of_side(middle);
        if fits(width, height) {
            least = middle;
        } else {
            most = middle - 1;
        }
    }
    of_side(least)
}

/// Bytes of a row in a buffer; callers have checked that the width is a texture's.
fn padded_row(width: u32) -> u32 {
    (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

/// The pixels of a texture of four bytes each, row by row from the top. Blocks until the device has finished.
///
/// # Errors
/// [`ViewError::DeviceLost`].
pub fn read(gpu: &Gpu, texture: &wgpu::Texture) -> Result<Vec<u8>, ViewError> {
    let (width, height) = (texture.width(), texture.height());
    let (row, padded) = (4 * width, padded_row(width));
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("picture"),
        size: u64::from(padded) * u64::from(height),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(padded), rows_per_image: Some(height) };
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
        texture.size(),
    );
    gpu.queue.submit([encoder.finish()]);
    let lost = |reason: &dyn std::fmt::Display| ViewError::DeviceLost(reason.to_string());
    let (told, answer) = std::sync::mpsc::sync_channel(1);
    buffer.slice(..).map_async(wgpu::MapMode::Read, move |result| {
        let _ = told.send(result);
    });
    gpu.device.poll(wgpu::PollType::wait_indefinitely()).map_err(|error| lost(&error))?;
    gpu.check()?;
    answer.recv().map_err(|error| lost(&error))?.map_err(|error| lost(&error))?;
    let bytes = buffer.slice(..).get_mapped_range().map_err(|error| lost(&format!("{error:?}")))?;
    let mut pixels = Vec::with_capacity(row as usize * height as usize);
    for line in bytes.chunks_exact(padded as usize) {
        pixels.extend_from_slice(&line[..row as usize]);
    }
    Ok(pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_picture_has_the_shape_of_the_one_asked_for() {
        const MIB: u64 = 1 << 20;
        for (asked, largest) in [
            ([960, 720], [960, 720]),
            ([8192, 8192], [8192, 8192]),
            ([16_384, 16_384], [8192, 8192]),
            ([40_000, 10], [16_384, 4]),
            ([u32::MAX, 1], [16_384, 1]),
            ([0, 10], [1, 10]),
        ] {
            assert_eq!(largest_of_shape(asked, 16_384, 256 * MIB), largest, "{asked:?}");
        }
        let [width, height] = largest_of_shape([30_000, 20_000], 16_384, 256 * MIB);
        assert!(width * height * 4 > 250 << 20 && width.abs_diff(height * 3 / 2) < 3, "{width} × {height}");
    }
}
