//! Copies of surfaces on the device: created once, then only changes are uploaded.

use std::collections::BTreeMap;

use crate::draw_list::Surface;
use crate::gpu::Gpu;

/// One surface on the device.
pub struct SurfaceCopy {
    /// Positions.
    pub positions: wgpu::Buffer,
    /// Normals.
    pub normals: wgpu::Buffer,
    /// Texture coordinates.
    pub uvs: wgpu::Buffer,
    /// Indices.
    pub indices: wgpu::Buffer,
    /// Number of indices.
    pub index_count: u32,
    topology: u64,
    version: u64,
    used: bool,
}

/// All copies, by the numbers of the draw list.
#[derive(Default)]
pub struct SurfaceCopies {
    copies: BTreeMap<u64, SurfaceCopy>,
    /// Bytes uploaded since the start.
    pub bytes_sent: u64,
}

impl SurfaceCopies {
    /// Creates or updates the copy of a surface.
    pub fn send(&mut self, gpu: &Gpu, surface: &Surface) {
        let vertices = wgpu::BufferUsages::VERTEX;
        // The edge overlay reads them too.
        let places = vertices | wgpu::BufferUsages::STORAGE;
        let copy = self.copies.entry(surface.id).or_insert_with(|| SurfaceCopy {
            positions: room(gpu, 0, places),
            normals: room(gpu, 0, vertices),
            uvs: room(gpu, 0, vertices),
            indices: room(gpu, 0, wgpu::BufferUsages::INDEX),
            index_count: 0,
            // Forces an upload of both.
            topology: surface.topology.wrapping_sub(1),
            version: surface.version.wrapping_sub(1),
            used: true,
        });
        copy.used = true;
        let geometry = &surface.geometry;
        if copy.topology != surface.topology {
            let uvs = bytemuck::cast_slice(&geometry.uvs);
            let indices = bytemuck::cast_slice(&geometry.indices);
            self.bytes_sent += send(gpu, &mut copy.uvs, uvs, vertices);
            self.bytes_sent += send(gpu, &mut copy.indices, indices, wgpu::BufferUsages::INDEX);
            copy.index_count = geometry.indices.len() as u32;
            copy.topology = surface.topology;
        }
        if copy.version != surface.version {
            let positions = bytemuck::cast_slice(&geometry.positions);
            let normals = bytemuck::cast_slice(&geometry.normals);
            self.bytes_sent += send(gpu, &mut copy.positions, positions, places);
            self.bytes_sent += send(gpu, &mut copy.normals, normals, vertices);
            copy.version = surface.version;
        }
    }

    /// The copy of a surface that was sent.
    pub fn get(&self, id: u64) -> Option<&SurfaceCopy> {
        self.copies.get(&id)
    }

    /// Drops copies that were not used since the last call.
    pub fn sweep(&mut self) {
        self.copies.retain(|_, copy| std::mem::take(&mut copy.used));
    }
}

/// A buffer for so many bytes, at least one: an empty buffer cannot be bound.
fn room(gpu: &Gpu, bytes: usize, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: (bytes.max(16) as u64).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT),
        usage: usage | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// Uploads bytes, into a larger buffer if needed (a thread is divided more finely where it bends); returns their
/// number.
fn send(gpu: &Gpu, buffer: &mut wgpu::Buffer, bytes: &[u8], usage: wgpu::BufferUsages) -> u64 {
    if (buffer.size() as usize) < bytes.len() {
        let grown = if buffer.size() > 16 { bytes.len() + bytes.len() / 2 } else { bytes.len() };
        *buffer = room(gpu, grown, usage);
    }
    gpu.queue.write_buffer(buffer, 0, bytes);
    bytes.len() as u64
}
