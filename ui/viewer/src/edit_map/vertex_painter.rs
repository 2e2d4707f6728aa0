//! Paints values per vertex into texels, only where they changed.

use nalgebra::Vector2;

use super::{Atlas, DirtyRect};

/// Quantisation steps between 0 and 1: finer than a byte, so that only visible changes are painted.
const STEPS: f32 = 1020.0;

/// `N` values per vertex, as last painted.
#[derive(Clone, Debug)]
pub(super) struct VertexPainter<const N: usize> {
    atlas: Atlas,
    triangles: Vec<[u32; 3]>,
    painted: Vec<[u16; N]>,
    changed: Vec<bool>,
    size: [u32; 2],
    /// After a change of topology: all triangles are painted, and the whole map is uploaded.
    fresh: bool,
}

impl<const N: usize> VertexPainter<N> {
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            atlas: Atlas::new(width, height),
            triangles: Vec::new(),
            painted: Vec::new(),
            changed: Vec::new(),
            size: [width, height],
            fresh: false,
        }
    }

    pub fn atlas(&self) -> &Atlas {
        &self.atlas
    }

    pub fn set_surface(&mut self, triangles: &[[u32; 3]], uv: &[Vector2<f64>]) {
        self.atlas.assign(triangles, uv);
        self.triangles.clear();
        self.triangles.extend_from_slice(triangles);
        self.painted.clear();
        self.painted.resize(uv.len(), [0; N]);
        self.changed.clear();
        self.changed.resize(uv.len(), false);
        self.fresh = true;
    }

    /// Calls `write` with the texels of each triangle with a vertex whose value has changed since it was last painted,
    /// and the values there.
    pub fn paint(
        &mut self,
        value: impl Fn(usize) -> [f32; N],
        mut write: impl FnMut(usize, [f32; N]),
    ) -> Option<DirtyRect> {
        let mut any = self.fresh;
        for (vertex, (painted, changed)) in self.painted.iter_mut().zip(&mut self.changed).enumerate() {
            let now = value(vertex).map(|x| (x.clamp(0.0, 1.0) * STEPS + 0.5) as u16);
            *changed = self.fresh || now != *painted;
            any |= *changed;
            *painted = now;
        }
        if !any {
            return None;
        }
        let mut dirty = None;
        for (index, triangle) in self.triangles.iter().enumerate() {
            let touched = triangle.iter().any(|vertex| self.changed.get(*vertex as usize) == Some(&true));
            if !touched {
                continue;
            }
            let corners = triangle.map(|vertex| {
                self.painted
                    .get(vertex as usize)
                    .map_or([0.0; N], |values| values.map(|x| f32::from(x) / STEPS))
            });
            let rect = self.atlas.visit(index, |texel, weights| {
                write(texel, std::array::from_fn(|k| (0..3).map(|c| corners[c][k] * weights[c]).sum()));
            });
            dirty = DirtyRect::union(dirty, rect);
        }
        if std::mem::take(&mut self.fresh) {
            return Some(DirtyRect { x: 0, y: 0, width: self.size[0], height: self.size[1] });
        }
        dirty
    }
}
