//! One subject as one window shows it: from where, in which layout, with how much care.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::Point3;
use trocar_scene::{Camera, Entity, PersonView, SimTime, Snapshot};

use super::navigate::Orbit;
use super::subject::Subject;
use crate::draw_list::Stage;
use crate::error::ViewError;
use crate::gpu::{Gpu, targets};
use crate::layout::{self, Layout, Stereo};
use crate::motion::Motion;
use crate::overlay::Overlays;
use crate::pacing::Pace;
use crate::picture::Picture;
use crate::quality::Quality;
use crate::renderer::Renderer;
use crate::view::View;

/// From where it is looked.
#[derive(Clone, Debug, PartialEq)]
pub enum Look {
    /// Through a camera of the scene, by name: another session of the same scenario has it too.
    Camera(String),
    /// Through several cameras, each in a tile of its own.
    Cameras(Vec<String>),
    /// From where the mouse led.
    Free(Orbit),
}

/// How eyes share the picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Eyes {
    /// One.
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
    /// One, and what it sees from above, from the front and from the right.
    Quad,
}

impl Eyes {
    /// All of them, with names for people.
    pub const ALL: [(Self, &'static str); 6] = [
        (Self::One, "one eye"),
        (Self::SideBySide, "side by side"),
        (Self::TopBottom, "top and bottom"),
        (Self::Rows, "row by row"),
        (Self::Anaglyph, "red and cyan"),
        (Self::Quad, "four views"),
    ];

    /// The layout of a picture of what is on a stage.
    pub fn layout(self, stereo: Stereo, stage: &Stage, view: &View) -> Layout {
        match self {
            Self::One => Layout::Mono,
            Self::SideBySide => Layout::SideBySide(stereo),
            Self::TopBottom => Layout::TopBottom(stereo),
            Self::Rows => Layout::RowInterleaved(stereo),
            Self::Anaglyph => Layout::Anaglyph(stereo),
            Self::Quad => Layout::quad(stage, view),
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

/// What a person has chosen of a sight, as another one takes it over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// From where; none: through the first camera.
    pub look: Option<Look>,
    /// For how many eyes.
    pub eyes: Eyes,
    /// How far they are apart.
    pub stereo: Stereo,
    /// With how much care; none: as the machine can.
    pub quality: Option<Quality>,
    /// What is shown over the scene.
    pub overlays: Overlays,
}

/// A subject in a window.
pub struct Sight {
    /// What is shown.
    pub subject: Box<dyn Subject>,
    /// From where.
    pub look: Look,
    /// For how many eyes.
    pub eyes: Eyes,
    /// How far they are apart.
    pub stereo: Stereo,
    /// With how much care; none: as the machine can.
    pub quality: Option<Quality>,
    /// What is shown over the scene.
    pub overlays: Overlays,
    /// What is selected.
    pub selected: Option<Entity>,
    /// The latest scene.
    pub scene: Arc<Snapshot>,
    /// What is shown: on its way from the one before to the latest.
    shown: Snapshot,
    motion: Motion,
    /// What [`Motion`] reads the time from.
    since: Instant,
    renderer: Renderer,
    target: Option<wgpu::Texture>,
    /// Four views stay where they are while things move.
    quad: Option<Layout>,
}

impl Sight {
    /// Of a subject, as chosen.
    pub fn new(gpu: &Gpu, mut subject: Box<dyn Subject>, choice: &Choice) -> Self {
        let scene = subject.scene();
        let renderer = Renderer::new(gpu, subject.folder());
        let look = choice.look.clone().unwrap_or_else(|| match scene.iter::<Camera>().next() {
            Some((camera, _)) => Look::Camera(scene.name(camera)),
            None => Look::Free(Orbit::from_view(&View::default_of(&scene, None), 0.35)),
        });
        let mut sight = Self {
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
            since: Instant::now(),
            renderer,
            target: None,
            quad: None,
        };
        sight.feed();
        sight
    }

    /// The time for [`Motion`].
    fn clock(&self) -> SimTime {
        SimTime(u64::try_from(self.since.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    fn feed(&mut self) {
        let now = self.clock();
        self.motion.feed(&self.scene, now);
    }

    /// What a person has chosen.
    pub fn choice(&self) -> Choice {
        Choice {
            look: Some(self.look.clone()),
            eyes: self.eyes,
            stereo: self.stereo,
            quality: self.quality,
            overlays: self.overlays.clone(),
        }
    }

    /// Everything on the device is made anew, on another one; what a person has chosen stays.
    pub fn rebuild(&mut self, gpu: &Gpu) {
        self.renderer = Renderer::new(gpu, self.subject.folder());
        self.target = None;
    }

    /// Looks for a newer scene; whether there is one.
    pub fn follow(&mut self) -> bool {
        let scene = self.subject.scene();
        let newer = !Arc::ptr_eq(&scene, &self.scene);
        if newer {
            self.scene = scene;
            self.feed();
            self.renderer.watch(&self.scene);
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

    /// The view, for a picture of this shape.
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

    /// From where a person who plays looks.
    pub fn person_view(&self) -> PersonView {
        let view = self.view(1.0);
        PersonView { world_from_view: view.world_from_eye.into(), field_of_view: view.lens.field_of_view }
    }

    /// The next camera, or the one before: `by` is 1 or −1.
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

    /// The camera that the mouse leads, from here on.
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

    /// How far away what is looked at is: what is selected, or the middle of what is in the picture \[m\].
    fn distance(&self, view: &View) -> f64 {
        let depth = |point: Point3<f64>| (view.world_from_eye.inverse() * point).z;
        if let Some(entity) = self.selected {
            return depth(self.scene.world_pose(entity).translation.vector.into());
        }
        let mut depths: Vec<f64> = Vec::new();
        for item in self.renderer.stage().items() {
            let centre = Point3::from(item.world_from_item.translation.vector);
            let inside = |at: [f64; 2]| at.iter().all(|share| (0.1..=0.9).contains(share));
            if view.project(&centre).is_some_and(|(at, _)| inside(at)) {
                depths.push(depth(centre));
            }
        }
        depths.sort_by(f64::total_cmp);
        depths.get(depths.len() / 2).copied().unwrap_or(0.2)
    }

    /// The picture in this size, drawn with that much care unless a person has chosen something else; the texture stays
    /// the same as long as the size does. Whether anything was drawn.
    pub fn draw(&mut self, gpu: &Gpu, size: [u32; 2], pace: Pace) -> bool {
        let pace = self.quality.map_or(pace, |quality| Pace { quality, scale: 1.0 });
        let now = self.clock();
        if let Some(shown) = self.motion.at(now) {
            self.shown = shown;
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
            // Four views are of one camera.
            let eyes = if self.eyes == Eyes::Quad { Eyes::One } else { self.eyes };
            let each = eyes.layout(self.stereo, self.renderer.stage(), view);
            return Layout::grid(tiles.map(layout::Sight::Camera)).each(&each);
        }
        if self.eyes != Eyes::Quad {
            self.quad = None;
            return self.eyes.layout(self.stereo, self.renderer.stage(), view);
        }
        if self.quad.is_none() {
            // What there is to see has to be known.
            self.renderer.update(gpu, &self.shown);
        }
        let (eyes, stereo, stage) = (self.eyes, self.stereo, self.renderer.stage());
        self.quad.get_or_insert_with(|| eyes.layout(stereo, stage, view)).clone()
    }

    /// What was drawn last.
    pub fn target(&self) -> Option<&wgpu::Texture> {
        self.target.as_ref()
    }

    /// The picture as it is shown now, for a file.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`]; `None` before anything was drawn.
    pub fn picture(&self, gpu: &Gpu) -> Result<Option<Picture>, ViewError> {
        let Some(target) = &self.target else { return Ok(None) };
        let bytes = targets::read(gpu, target)?;
        let (width, height) = (target.width(), target.height());
        Ok(Some(Picture { width, height, color: bytes.as_chunks().0.to_vec() }))
    }

    /// Corners of the boxes around an entity's parts in world; corner *i* is at the upper end along x, y, z as bits 0, 1,
    /// 2 of *i* say.
    pub fn boxes(&self, entity: Entity) -> Vec<[Point3<f64>; 8]> {
        let items = self.renderer.stage().items().iter().filter(|item| item.entity == entity);
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

    /// What is at a place of the picture (0 to 1 from left and top); nothing in a woven one, where two things are.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub fn pick(&mut self, gpu: &Gpu, at: [f64; 2]) -> Result<Option<Entity>, ViewError> {
        let Some(target) = &self.target else { return Ok(None) };
        let size = [target.width(), target.height()];
        let view = self.view(f64::from(size[0]) / f64::from(size[1]));
        let shots = self.layout(gpu, &view).shots(&self.shown, &view, size);
        let within = |share: f64, from: f64, size: f64| (share - from) / size;
        let found = shots.iter().find_map(|shot| {
            let (pane, eye) = (shot.pane, *shot.eyes.first()?);
            let own = [within(at[0], pane.x, pane.width), within(at[1], pane.y, pane.height)];
            own.iter().all(|share| (0.0..1.0).contains(share)).then_some((eye, own))
        });
        let Some((eye, own)) = found else { return Ok(None) };
        let pixel = eye.pixel(eye.through_lens(own), size);
        let probe = self.renderer.probe(gpu, &self.shown, &pixel, [1, 1])?;
        Ok(probe.entity(0, 0))
    }
}

/// A texture that the renderer draws light into and that a user interface shows as it is: it mixes colours as they are
/// seen, not as light adds up.
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

/// The format in which a user interface reads it.
pub const AS_SEEN: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
