//! One subject as one window shows it: point of view, layout, quality.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::Point3;
use trocar_scene::annotation::{SurfaceHit, nearest_place};
use trocar_scene::{Camera, Entity, PersonView, SimTime, Snapshot};

use super::navigate::Orbit;
use super::subject::Subject;
use crate::draw_list::DrawList;
use crate::error::ViewError;
use crate::gpu::{Gpu, targets};
use crate::layout::{self, Layout, Stereo};
use crate::motion::Motion;
use crate::overlay::Overlays;
use crate::pacing::Pace;
use crate::picture::Picture;
use crate::quality::Quality;
use crate::renderer::Renderer;
use crate::still::StillPicture;
use crate::view::View;

/// The point of view.
#[derive(Clone, Debug, PartialEq)]
pub enum Look {
    /// A camera of the scene, by name, which other sessions of the same scenario have too.
    Camera(String),
    /// Several cameras, each in its own tile.
    Cameras(Vec<String>),
    /// The mouse's own camera.
    Free(Orbit),
}

/// Stereo layout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StereoLayout {
    /// One eye.
    #[default]
    One,
    /// Left and right beside each other.
    SideBySide,
    /// Left above right.
    TopBottom,
    /// Row by row: polarised monitors.
    Rows,
    /// Red and cyan glasses.
    Anaglyph,
    /// One eye, with views from above, from the front and from the right.
    Quad,
}

impl StereoLayout {
    /// All layouts, with names for people.
    pub const ALL: [(Self, &'static str); 6] = [
        (Self::One, "one eye"),
        (Self::SideBySide, "side by side"),
        (Self::TopBottom, "top and bottom"),
        (Self::Rows, "row by row"),
        (Self::Anaglyph, "red and cyan"),
        (Self::Quad, "four views"),
    ];

    /// The layout of a picture of a scene.
    pub fn layout(self, stereo: Stereo, draw_list: &DrawList, view: &View) -> Layout {
        match self {
            Self::One => Layout::Mono,
            Self::SideBySide => Layout::SideBySide(stereo),
            Self::TopBottom => Layout::TopBottom(stereo),
            Self::Rows => Layout::RowInterleaved(stereo),
            Self::Anaglyph => Layout::Anaglyph(stereo),
            Self::Quad => Layout::quad(draw_list, view),
        }
    }
}

/// Qualities, with names for people.
pub const QUALITIES: [(Option<Quality>, &str); 4] = [
    (None, "as fast as needed"),
    (Some(Quality::PLAIN), "plain"),
    (Some(Quality::FULL), "full"),
    (Some(Quality::FINE), "fine"),
];

/// A user's settings of a subject's view, which another view can take over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// Point of view; `None`: the first camera.
    pub look: Option<Look>,
    /// Stereo layout.
    pub eyes: StereoLayout,
    /// Distance and convergence of the eyes.
    pub stereo: Stereo,
    /// Quality; `None`: chosen by the pacer.
    pub quality: Option<Quality>,
    /// The overlays.
    pub overlays: Overlays,
}

/// A subject in a window.
pub struct SubjectView {
    /// The subject.
    pub subject: Box<dyn Subject>,
    /// Point of view.
    pub look: Look,
    /// Stereo layout.
    pub eyes: StereoLayout,
    /// Distance and convergence of the eyes.
    pub stereo: Stereo,
    /// Quality; `None`: chosen by the pacer.
    pub quality: Option<Quality>,
    /// The overlays.
    pub overlays: Overlays,
    /// The selected entity.
    pub selected: Option<Entity>,
    /// The latest scene.
    pub scene: Arc<Snapshot>,
    /// The displayed scene: interpolated between the previous and the latest one, or that of a moment while the picture is
    /// frozen.
    shown: Snapshot,
    motion: Motion,
    still: StillPicture,
    /// Origin of the clock for [`Motion`].
    since: Instant,
    renderer: Renderer,
    target: Option<wgpu::Texture>,
    /// The four views stay fixed while the scene moves.
    quad: Option<Layout>,
}

impl SubjectView {
    /// A view of a subject, with the user's settings.
    pub fn new(gpu: &Gpu, mut subject: Box<dyn Subject>, choice: &Choice) -> Self {
        let scene = subject.scene();
        let renderer = Renderer::new(gpu, subject.folder());
        let look = choice.look.clone().unwrap_or_else(|| match scene.iter::<Camera>().next() {
            Some((camera, _)) => Look::Camera(scene.name(camera)),
            None => Look::Free(Orbit::from_view(&View::default_of(&scene, None), 0.35)),
        });
        let mut subject_view = Self {
            subject,
            look,
            eyes: choice.eyes,
            stereo: choice.stereo,
            quality: choice.quality,
            overlays: choice.overlays.clone(),
            selected: None,
            shown: (*scene).clone(),
            scene,
            motion: Motion::new(),
            still: StillPicture::new(),
            since: Instant::now(),
            renderer,
            target: None,
            quad: None,
        };
        subject_view.feed();
        subject_view
    }

    /// The clock for [`Motion`].
    fn clock(&self) -> SimTime {
        SimTime(u64::try_from(self.since.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    fn feed(&mut self) {
        let now = self.clock();
        self.motion.feed(&self.scene, now);
    }

    /// The user's settings.
    pub fn choice(&self) -> Choice {
        Choice {
            look: Some(self.look.clone()),
            eyes: self.eyes,
            stereo: self.stereo,
            quality: self.quality,
            overlays: self.overlays.clone(),
        }
    }

    /// Recreates everything on another device; the user's settings stay.
    pub fn rebuild(&mut self, gpu: &Gpu) {
        self.renderer = Renderer::new(gpu, self.subject.folder());
        self.target = None;
    }

    /// Fetches a newer scene; returns whether there is one.
    pub fn follow(&mut self) -> bool {
        let scene = self.subject.scene();
        let newer = !Arc::ptr_eq(&scene, &self.scene);
        if newer {
            self.scene = scene;
            self.feed();
            if !self.still.is_held() {
                self.renderer.watch(&self.scene);
            }
        }
        if self.selected.is_some_and(|entity| !self.scene.contains(entity)) {
            self.selected = None;
        }
        newer || self.motion.is_moving()
    }

    /// Names of the cameras.
    pub fn cameras(&self) -> Vec<String> {
        self.scene.iter::<Camera>().map(|(camera, _)| self.scene.name(camera)).collect()
    }

    /// The view, for a picture of this aspect ratio.
    pub fn view(&self, aspect: f64) -> View {
        match &self.look {
            Look::Camera(name) => View::named(&self.shown, name, Some(aspect))
                .unwrap_or_else(|_| View::default_of(&self.shown, Some(aspect))),
            Look::Cameras(names) => names
                .first()
                .and_then(|name| View::named(&self.shown, name, Some(aspect)).ok())
                .unwrap_or_else(|| View::default_of(&self.shown, Some(aspect))),
            Look::Free(orbit) => orbit.view(aspect),
        }
    }

    /// The point of view of the player.
    pub fn person_view(&self) -> PersonView {
        let view = self.view(1.0);
        PersonView { world_from_view: view.world_from_eye.into(), field_of_view: view.lens.field_of_view }
    }

    /// The next or previous camera: `by` is 1 or −1.
    pub fn cycle_camera(&mut self, by: isize) {
        let cameras = self.cameras();
        if cameras.is_empty() {
            return;
        }
        let at = match &self.look {
            Look::Camera(name) => cameras.iter().position(|camera| camera == name),
            Look::Free(_) | Look::Cameras(_) => None,
        };
        let count = cameras.len() as isize;
        let next = at.map_or(0, |at| (at as isize + by).rem_euclid(count) as usize);
        self.look = Look::Camera(cameras[next].clone());
    }

    /// The mouse's own camera, starting from the present view.
    pub fn free(&mut self) -> &mut Orbit {
        if !matches!(self.look, Look::Free(_)) {
            let view = self.view(1.0);
            self.look = Look::Free(Orbit::from_view(&view, self.distance(&view)));
        }
        match &mut self.look {
            Look::Free(orbit) => orbit,
            Look::Camera(_) | Look::Cameras(_) => unreachable!("the camera was set free above"),
        }
    }

    /// Distance of the selected entity, or of the middle of the visible scene \[m\].
    fn distance(&self, view: &View) -> f64 {
        let depth = |point: Point3<f64>| (view.world_from_eye.inverse() * point).z;
        if let Some(entity) = self.selected {
            return depth(self.scene.world_pose(entity).translation.vector.into());
        }
        let mut depths: Vec<f64> = Vec::new();
        for item in self.renderer.draw_list().items() {
            let centre = Point3::from(item.world_from_item.translation.vector);
            let inside = |at: [f64; 2]| at.iter().all(|share| (0.1..=0.9).contains(share));
            if view.project(&centre).is_some_and(|(at, _)| inside(at)) {
                depths.push(depth(centre));
            }
        }
        depths.sort_by(f64::total_cmp);
        depths.get(depths.len() / 2).copied().unwrap_or(0.2)
    }

    /// Draws the picture in this size, with the quality of `pace` unless the user has chosen another. The texture stays
    /// the same as long as the size does. Returns whether anything was drawn.
    pub fn draw(&mut self, gpu: &Gpu, size: [u32; 2], pace: Pace) -> bool {
        let pace = self.quality.map_or(pace, |quality| Pace { quality, scale: 1.0 });
        let now = self.clock();
        if let Some(shown) = self.motion.at(now) {
            self.shown = self.still.show(&shown);
        }
        let fits = |texture: &wgpu::Texture| [texture.width(), texture.height()] == size;
        let target = self.target.take().filter(fits).unwrap_or_else(|| shown_target(gpu, size));
        self.renderer.overlays.clone_from(&self.overlays);
        self.renderer.update(gpu, &self.shown);
        let view = self.view(f64::from(size[0]) / f64::from(size[1]));
        let layout = self.layout(gpu, &view);
        let draws = self.renderer.needs_draw(&self.shown, &view, &layout, pace, &target);
        if draws {
            self.renderer.draw_scaled(gpu, &self.shown, &view, &layout, pace, &target);
        }
        self.target = Some(target);
        draws
    }

    fn layout(&mut self, gpu: &Gpu, view: &View) -> Layout {
        if let Look::Cameras(names) = &self.look {
            self.quad = None;
            let entities = || self.shown.iter::<Camera>().map(|(camera, _)| camera);
            let tiles =
                names.iter().filter_map(|name| entities().find(|camera| self.shown.name(*camera) == *name));
            // Four views are of one eye.
            let eyes = if self.eyes == StereoLayout::Quad { StereoLayout::One } else { self.eyes };
            let each = eyes.layout(self.stereo, self.renderer.draw_list(), view);
            return Layout::grid(tiles.map(layout::TileView::Camera)).each(&each);
        }
        if self.eyes != StereoLayout::Quad {
            self.quad = None;
            return self.eyes.layout(self.stereo, self.renderer.draw_list(), view);
        }
        if self.quad.is_none() {
            // The layout needs to know the items.
            self.renderer.update(gpu, &self.shown);
        }
        let (eyes, stereo, draw_list) = (self.eyes, self.stereo, self.renderer.draw_list());
        self.quad.get_or_insert_with(|| eyes.layout(stereo, draw_list, view)).clone()
    }

    /// The last drawn picture.
    pub fn target(&self) -> Option<&wgpu::Texture> {
        self.target.as_ref()
    }

    /// The displayed picture, for a file.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`]; `None` before anything was drawn.
    pub fn picture(&self, gpu: &Gpu) -> Result<Option<Picture>, ViewError> {
        let Some(target) = &self.target else { return Ok(None) };
        let bytes = targets::read(gpu, target)?;
        let (width, height) = (target.width(), target.height());
        Ok(Some(Picture { width, height, color: bytes.as_chunks().0.to_vec() }))
    }

    /// Corners of the boxes around an entity's parts in world; bits 0, 1, 2 of a corner's index tell whether it is at
    /// the upper end along x, y, z.
    pub fn boxes(&self, entity: Entity) -> Vec<[Point3<f64>; 8]> {
        let items = self.renderer.draw_list().items().iter().filter(|item| item.entity == entity);
        items
            .filter_map(|item| {
                let mut positions = item.surface.geometry.positions.iter();
                let first = *positions.next()?;
                let (low, high) = positions.fold((first, first), |(low, high), at| {
                    let pairs = |pick: fn(f32, f32) -> f32, a: [f32; 3]| {
                        [pick(a[0], at[0]), pick(a[1], at[1]), pick(a[2], at[2])]
                    };
                    (pairs(f32::min, low), pairs(f32::max, high))
                });
                Some(std::array::from_fn(|corner| {
                    let axis =
                        |axis: usize| f64::from(if corner >> axis & 1 == 1 { high[axis] } else { low[axis] });
                    item.world_from_item * Point3::new(axis(0), axis(1), axis(2))
                }))
            })
            .collect()
    }

    /// The entity at a position of the picture (0 to 1 from left and top); `None` in an interleaved one, where a
    /// position shows two.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub fn pick(&mut self, gpu: &Gpu, at: [f64; 2]) -> Result<Option<Entity>, ViewError> {
        let Some((eye, own, size)) = self.eye_at(gpu, at) else { return Ok(None) };
        let pixel = eye.pixel(eye.through_lens(own), size);
        let probe = self.renderer.probe(gpu, &self.shown, &pixel, [1, 1])?;
        Ok(probe.entity(0, 0))
    }

    /// The place on a surface at a position of the picture, as for [`Self::pick`]: what the mouse points at.
    pub fn place_at(&mut self, gpu: &Gpu, at: [f64; 2]) -> Option<SurfaceHit> {
        let (eye, own, _) = self.eye_at(gpu, at)?;
        let (origin, direction) = eye.ray(eye.through_lens(own));
        nearest_place(&self.shown, &origin, &direction)
    }

    /// The view of which the picture shows a part there, with the position in that part, and the size of the picture.
    fn eye_at(&mut self, gpu: &Gpu, at: [f64; 2]) -> Option<(View, [f64; 2], [u32; 2])> {
        let target = self.target.as_ref()?;
        let size = [target.width(), target.height()];
        let view = self.view(f64::from(size[0]) / f64::from(size[1]));
        let shots = self.layout(gpu, &view).shots(&self.shown, &view, size);
        let within = |share: f64, from: f64, size: f64| (share - from) / size;
        shots.iter().find_map(|shot| {
            let (pane, eye) = (shot.pane, *shot.eyes.first()?);
            let own = [within(at[0], pane.x, pane.width), within(at[1], pane.y, pane.height)];
            own.iter().all(|share| (0.0..1.0).contains(share)).then_some((eye, own, size))
        })
    }
}

/// A texture that the renderer writes linear light into and that the user interface reads as sRGB bytes, in which it
/// blends.
fn shown_target(gpu: &Gpu, size: [u32; 2]) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("sight"),
        size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: targets::COLOR,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT
            | wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[AS_SEEN],
    })
}

/// The format in which the user interface reads it.
pub const AS_SEEN: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
