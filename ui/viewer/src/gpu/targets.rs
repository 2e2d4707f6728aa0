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
pub fn check_size(gpu: &Gpu, [width, height]: [u32; 2]) -> Result<(), ViewError> {
    let max = gpu.device.limits().max_texture_dimension_2d;
    let sound = (1..=max).contains(&width) && (1..=max).contains(&height);
    if sound { Ok(()) } else { Err(ViewError::Size { width, height, max }) }
}

/// The pixels of a texture of four bytes each, row by row from the top. Blocks until the device has finished.
///
/// # Errors
/// [`ViewError::DeviceLost`].
pub fn read(gpu: &Gpu, texture: &wgpu::Texture) -> Result<Vec<u8>, ViewError> {
    let (width, height) = (texture.width(), texture.height());
    let row = 4 * width;
    let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
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
