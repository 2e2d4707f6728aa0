//! Shadow maps, redrawn only when a caster has moved. Still casters are cached in a map of their own, so that an
//! instrument over tissue costs only the instrument.

use nalgebra::Matrix4;

use crate::gpu::Gpu;
use crate::lights::{SHADOWS_MAX, Shining};
use crate::renderer::Renderer;
use crate::renderer::items::{Casters, STILL_AFTER};

/// The content of the shadow maps.
#[derive(Default)]
pub(super) struct Shadows {
    layers: [Layer; SHADOWS_MAX],
}

/// The content of one shadow map.
#[derive(Clone, Copy, Default)]
struct Layer {
    clip_from_world: Option<Matrix4<f64>>,
    /// Frames since the light moved.
    rested: u32,
    /// Number of the list of casters that it shows.
    shown: Option<u64>,
    /// Number of the list of still casters.
    still: Option<u64>,
}

/// The work for one shadow map in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Plan {
    /// Nothing moved.
    Keep,
    /// Draw everything.
    All,
    /// Copy the still casters, redrawn first if they changed, and add the moving ones.
    Add { still: bool },
}

impl Layer {
    /// The work for this frame, which is recorded as done.
    fn follow(&mut self, clip_from_world: &Matrix4<f64>, casters: &Casters) -> Plan {
        if self.clip_from_world.as_ref() == Some(clip_from_world) {
            self.rested = self.rested.saturating_add(1);
        } else {
            *self = Self { clip_from_world: Some(*clip_from_world), ..Self::default() };
        }
        if self.shown.replace(casters.number) == Some(casters.number) {
            return Plan::Keep;
        }
        // Under a moving light nothing is still; and where most casters move, a cache does not pay.
        if self.rested < STILL_AFTER || casters.still_share() < 0.5 {
            self.still = None;
            return Plan::All;
        }
        let still = self.still.replace(casters.still_number) != Some(casters.still_number);
        Plan::Add { still }
    }
}

impl Renderer {
    /// Draws the shadow maps of the lights.
    pub(super) fn draw_shadows(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, lights: &[Shining]) {
        for (layer, clip_from_world) in lights.iter().filter_map(|light| light.shadow) {
            let plan = self.shadows.layers[layer].follow(&clip_from_world, &self.items.casters);
            if plan == Plan::Keep {
                continue;
            }
            self.frames.set_shadow(gpu, &self.passes, layer, &clip_from_world);
            let maps = &self.passes.shadow_maps;
            if plan == (Plan::Add { still: true }) {
                self.draw_casters(encoder, layer, &maps.still_layers[layer], true, Some(true));
            }
            match plan {
                Plan::Add { .. } => {
                    maps.begin_with_still(encoder, layer);
                    self.draw_casters(encoder, layer, &maps.layers[layer], false, Some(false));
                }
                _ => self.draw_casters(encoder, layer, &maps.layers[layer], true, None),
            }
        }
    }

    /// Draws all casters, or only still or moving ones.
    fn draw_casters(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        layer: usize,
        into: &wgpu::TextureView,
        clear: bool,
        still: Option<bool>,
    ) {
        let load = if clear { wgpu::LoadOp::Clear(1.0) } else { wgpu::LoadOp::Load };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow"),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: into,
                depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(&self.passes.shadow);
        pass.set_bind_group(0, self.frames.shadow(layer), &[]);
        for (index, caster) in self.items.casters.list.iter().enumerate() {
            if caster.throws && still.is_none_or(|still| still == caster.is_still()) {
                self.draw_item(&mut pass, index, 1);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::renderer::items::Caster;

    fn floor_and_tool(tool_age: u32, number: u64, still_number: u64) -> Casters {
        let caster = |id, triangles, age| Caster { id, triangles, age, throws: true, ..Caster::default() };
        Casters { list: vec![caster(1, 1_000, 100), caster(2, 50, tool_age)], number, still_number }
    }

    #[test]
    fn a_tool_over_tissue_is_all_that_is_drawn_and_nothing_while_it_rests() {
        let (mut layer, light) = (Layer::default(), Matrix4::identity());
        for frame in 0..STILL_AFTER {
            assert_eq!(layer.follow(&light, &floor_and_tool(0, u64::from(frame), 0)), Plan::All);
        }
        assert_eq!(layer.follow(&light, &floor_and_tool(0, 100, 0)), Plan::Add { still: true });
        assert_eq!(layer.follow(&light, &floor_and_tool(0, 101, 0)), Plan::Add { still: false });
        assert_eq!(layer.follow(&light, &floor_and_tool(1, 101, 0)), Plan::Keep);
        assert_eq!(layer.follow(&light, &floor_and_tool(0, 102, 0)), Plan::Add { still: false });
        // The floor moved once, and is still again somewhere else.
        assert_eq!(layer.follow(&light, &floor_and_tool(0, 103, 2)), Plan::Add { still: true });
    }

    #[test]
    fn everything_is_drawn_under_a_light_that_moves_and_where_most_of_it_moves() {
        let mut layer = Layer::default();
        for frame in 0..20 {
            let light = Matrix4::new_scaling(1.0 + f64::from(frame));
            assert_eq!(layer.follow(&light, &floor_and_tool(0, 7, 0)), Plan::All);
            assert_eq!(layer.follow(&light, &floor_and_tool(0, 7, 0)), Plan::Keep);
        }
        let light = Matrix4::identity();
        for frame in 0..20 {
            let mut casters = floor_and_tool(0, 1_000 + frame, 0);
            casters.list[0].age = 0;
            assert_eq!(layer.follow(&light, &casters), Plan::All);
        }
    }
}
