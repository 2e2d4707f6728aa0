//! The overlay layer of the renderer: computes, uploads and draws the overlays.

use nalgebra::Point3;
use trocar_scene::Snapshot;

use crate::draw_list::DrawList;
use crate::gpu::Gpu;
use crate::gpu::annotate::{Annotator, Note};
use crate::gpu::overlay::OverlayPass;
use crate::gpu::passes::Passes;
use crate::gpu::surfaces::SurfaceCopies;
use crate::layout::Shot;
use crate::overlay::{self, Legend, Overlay, Overlays, Seen, Trails};
use crate::view::View;

/// The scene below the overlays.
pub(super) struct SceneBelow<'a> {
    pub(super) draw_list: &'a DrawList,
    pub(super) copies: &'a SurfaceCopies,
    pub(super) passes: &'a Passes,
    /// Whether it has changed since the last frame.
    pub(super) anew: bool,
}

/// Empty until an overlay is shown.
#[derive(Default)]
pub(super) struct OverlayLayer {
    trails: Trails,
    /// The computed overlays, and their settings.
    seen: Option<(Overlays, Seen)>,
    pass: Option<OverlayPass>,
    annotator: Option<Annotator>,
}

impl OverlayLayer {
    pub(super) fn bytes_sent(&self) -> u64 {
        self.pass.as_ref().map_or(0, |pass| pass.bytes_sent)
    }

    pub(super) fn legends(&self) -> &[Legend] {
        self.seen.as_ref().map_or(&[], |(_, seen)| &seen.legends)
    }

    /// Records a snapshot for the trails.
    pub(super) fn watch(&mut self, overlays: &Overlays, scene: &Snapshot) {
        if overlays.shows(Overlay::Trails) {
            self.trails.watch(scene, overlays.trail_secs);
        } else {
            self.trails.clear();
        }
    }

    /// Recomputes the overlays if the scene or their settings changed.
    pub(super) fn follow(
        &mut self,
        gpu: &Gpu,
        overlays: &Overlays,
        scene: &Snapshot,
        below: &SceneBelow<'_>,
    ) {
        let SceneBelow { draw_list, copies, passes, anew } = *below;
        self.watch(overlays, scene);
        if overlays.show_nothing_of(scene) {
            self.seen = None;
            return;
        }
        if !anew && self.seen.as_ref().is_some_and(|(before, _)| before == overlays) {
            return;
        }
        let seen = overlay::look(overlays, scene, draw_list, &self.trails);
        let pass = self.pass.get_or_insert_with(|| OverlayPass::new(gpu, &passes.items_layout));
        pass.send(gpu, overlays, &seen, draw_list, copies);
        self.seen = Some((overlays.clone(), seen));
    }

    pub(super) fn prepare(
        &mut self,
        gpu: &Gpu,
        eye: usize,
        view: &View,
        pane: [u32; 2],
        (format, samples): (wgpu::TextureFormat, u32),
    ) {
        if let (Some(_), Some(pass)) = (&self.seen, &mut self.pass) {
            pass.prepare(gpu, eye, view, pane, format, samples);
        }
    }

    pub(super) fn draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        eye: usize,
        kind: (wgpu::TextureFormat, u32),
        draw_list: &DrawList,
        copies: &SurfaceCopies,
        items: &wgpu::BindGroup,
    ) {
        if let (Some(_), Some(own)) = (&self.seen, &self.pass) {
            own.draw(pass, eye, kind, draw_list, copies, items);
        }
    }

    /// Draws legends, names, captions and lines of text into the finished picture.
    pub(super) fn annotate(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        overlays: &Overlays,
        (target, format): (&wgpu::TextureView, wgpu::TextureFormat),
        size: [u32; 2],
        shots: &[Shot],
    ) {
        let Some((_, seen)) = &self.seen else { return };
        let legends: &[Legend] = if overlays.legends { &seen.legends } else { &[] };
        if legends.is_empty() && seen.has_no_text() {
            return;
        }
        let note = |shot: &Shot| {
            let view = if let [eye] = shot.eyes.as_slice() { eye } else { &shot.centre };
            let place = |point: &Point3<f64>| {
                let at = view.onto_lens(view.project(point)?.0);
                at.iter().all(|share| (0.0..=1.0).contains(share)).then_some(at)
            };
            fn placed(
                texts: &[(Point3<f64>, String)],
                place: impl Fn(&Point3<f64>) -> Option<[f64; 2]>,
            ) -> Vec<([f64; 2], &str)> {
                texts.iter().filter_map(|(point, words)| Some((place(point)?, words.as_str()))).collect()
            }
            // Both eyes of the first view get the legends; other views do not.
            let is_first = shot.centre == shots[0].centre;
            Note {
                pane: shot.pane.pixels(size),
                legends: if is_first { legends } else { &[] },
                labels: placed(&seen.labels, place),
                captions: placed(&seen.captions, place),
                banner: if is_first { &seen.banner } else { &[] },
                is_framed: seen.frozen,
            }
        };
        let notes: Vec<Note<'_>> = shots.iter().map(note).collect();
        if self.annotator.as_ref().is_none_or(|annotator| !annotator.is_for(format)) {
            self.annotator = Some(Annotator::new(gpu, format));
        }
        if let Some(annotator) = &mut self.annotator {
            annotator.draw(gpu, encoder, target, size, &notes);
        }
    }
}
