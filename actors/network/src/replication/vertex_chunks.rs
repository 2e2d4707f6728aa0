//! A body's vertices at the sender: which of them a station has not acknowledged yet.
//!
//! For each vertex the revision of its last change is kept, for each chunk the newest revision that was acknowledged.
//! A datagram holds those vertices of a chunk that have changed since; so whoever takes it has the whole chunk as it
//! was then, whatever was lost before.

use nalgebra::Point3;
use trocar_scene::Revision;

use super::positions::{
    ChunkHead, GridPoint, VERTICES_MAX, chunk_count, chunk_range, vertex_to_grid, write_chunk,
};

#[derive(Clone, Copy, Debug, Default)]
struct Chunk {
    /// Newest change of any of its vertices.
    newest: Revision,
    /// What was sent last, and in which datagram.
    sent: Revision,
    sequence: Option<u64>,
    acknowledged: Revision,
    is_lost: bool,
}

/// The vertices of one body.
#[derive(Clone, Debug)]
pub(super) struct VertexChunks {
    points: Vec<GridPoint>,
    changed: Vec<Revision>,
    chunks: Vec<Chunk>,
    /// Where the search for a chunk to send goes on, so that each has its turn.
    cursor: usize,
    scanned: Revision,
}

impl VertexChunks {
    /// Vertices that a station gets in whole; `None` when they do not fit on the grid.
    pub(super) fn new(positions: &[Point3<f64>], revision: Revision) -> Option<Self> {
        if positions.len() > VERTICES_MAX {
            return None;
        }
        let points: Option<Vec<GridPoint>> = positions.iter().map(vertex_to_grid).collect();
        let chunk = Chunk { acknowledged: revision, sent: revision, newest: revision, ..Chunk::default() };
        Some(Self {
            points: points?,
            changed: vec![Revision::ZERO; positions.len()],
            chunks: vec![chunk; chunk_count(positions.len())],
            cursor: 0,
            scanned: revision,
        })
    }

    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// Notes which vertices have moved to another point of the grid; false when they no longer fit.
    pub(super) fn scan(&mut self, positions: &[Point3<f64>], revision: Revision) -> bool {
        if positions.len() != self.points.len() {
            return false;
        }
        if revision <= self.scanned {
            return true;
        }
        self.scanned = revision;
        for chunk in 0..self.chunks.len() {
            for vertex in chunk_range(chunk, positions.len()) {
                let Some(point) = vertex_to_grid(&positions[vertex]) else { return false };
                if point != self.points[vertex] {
                    self.points[vertex] = point;
                    self.changed[vertex] = revision;
                    self.chunks[chunk].newest = revision;
                }
            }
        }
        true
    }

    /// The next chunk to send.
    pub(super) fn next(&self) -> Option<usize> {
        let count = self.chunks.len();
        let order = (0..count).map(|k| (self.cursor + k) % count);
        let needs = |chunk: &Chunk| chunk.is_lost || chunk.newest > chunk.sent;
        order.into_iter().find(|k| needs(&self.chunks[*k]))
    }

    /// Appends what a station lacks of a chunk.
    pub(super) fn write(&self, chunk: usize, out: &mut Vec<u8>) {
        let range = chunk_range(chunk, self.points.len());
        let acknowledged = self.chunks[chunk].acknowledged;
        let changed = self.changed[range.clone()].iter().enumerate();
        let mask = changed.fold(0, |mask, (k, changed)| mask | u64::from(*changed > acknowledged) << k);
        let over = self.scanned.0 - acknowledged.0.min(self.scanned.0);
        write_chunk(&ChunkHead { vertices: self.points.len(), chunk, over, mask }, &self.points[range], out);
    }

    /// A chunk was sent as it is at the last scan, whose revision is returned.
    pub(super) fn sent(&mut self, chunk: usize, sequence: u64) -> Revision {
        let place = &mut self.chunks[chunk];
        place.sent = self.scanned;
        place.sequence = Some(sequence);
        place.is_lost = false;
        self.cursor = (chunk + 1) % self.chunks.len();
        self.scanned
    }

    pub(super) fn acknowledged(&mut self, chunk: usize, revision: Revision) {
        if let Some(chunk) = self.chunks.get_mut(chunk) {
            chunk.acknowledged = chunk.acknowledged.max(revision);
        }
    }

    /// The datagram was lost; whether the chunk has to be sent again.
    pub(super) fn lost(&mut self, chunk: usize, sequence: u64) -> bool {
        let Some(chunk) = self.chunks.get_mut(chunk) else { return false };
        let is_newest = chunk.sequence == Some(sequence);
        chunk.is_lost |= is_newest;
        is_newest
    }
}
