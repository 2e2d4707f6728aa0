//! Smoke and fluids of a scene, packed for the device; only changes since the last snapshot are processed.

use bytemuck::{Pod, Zeroable};
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::random::SplitMix64;
use trocar_scene::{Entity, ParticleKind, Particles, Revision, Snapshot};

use crate::view::View;

/// Most particles drawn; entities that do not fit are left out, the last ones first.
pub const DRAWN_MAX: usize = 4 * trocar_scene::PARTICLES_MAX;
/// Least capacity for an entity \[particles\].
const ROOM_MIN: usize = 64;

/// A particle, in the layout of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Particle {
    /// In the entity's frame \[m\].
    pub position: [f32; 3],
    /// \[m\].
    pub radius: f32,
    /// Peak extinction coefficient \[1/m\].
    pub extinction: f32,
    /// A random number in \[0, 1), so that no two puffs look the same.
    pub turn: f32,
    /// Index of its entity in the list.
    pub cloud: u32,
    /// Padding.
    pub unused: u32,
}

/// The particles of one entity.
#[derive(Clone, Debug)]
pub struct Cloud {
    /// Their entity.
    pub entity: Entity,
    /// Their kind.
    pub kind: ParticleKind,
    /// Pose of the entity in world.
    pub world_from_cloud: Isometry3<f64>,
    /// Linear RGB.
    pub color: [f32; 3],
    /// Index of the first in the list of all particles.
    pub first: usize,
    /// Their number.
    pub count: usize,
    /// Radius of the largest \[m\].
    pub radius: f64,
    /// A bounding sphere in the entity's frame: its centre, and its radius \[m\].
    pub ball: (Point3<f64>, f64),
    /// Whether its particles have to be uploaded.
    pub changed: bool,
    room: usize,
    revision: Option<Revision>,
}

/// All particles of a scene, kept in step with its snapshots.
#[derive(Default)]
pub struct Swarm {
    clouds: Vec<Cloud>,
    /// Every entity has some spare capacity.
    particles: Vec<Particle>,
    seen: Option<(Revision, u64)>,
}

impl Swarm {
    /// The entities with particles, in order.
    pub fn clouds(&self) -> &[Cloud] {
        &self.clouds
    }

    /// The particles of all entities, with gaps.
    pub fn particles(&self) -> &[Particle] {
        &self.particles
    }

    /// Whether the scene has particles of that kind.
    pub fn has(&self, kind: ParticleKind) -> bool {
        self.clouds.iter().any(|cloud| cloud.kind == kind && cloud.count > 0)
    }

    /// Radius of the largest drop of a fluid \[m\].
    pub fn drop_radius(&self) -> f64 {
        let fluids = self.clouds.iter().filter(|cloud| cloud.kind == ParticleKind::Fluid);
        fluids.map(|cloud| cloud.radius).fold(0.0, f64::max)
    }

    /// Follows the scene to this snapshot; `false` when nothing has changed. Changed clouds are marked for upload.
    pub fn update(&mut self, scene: &Snapshot) -> bool {
        let now = (scene.revision(), scene.retouches());
        if self.seen == Some(now) {
            return false;
        }
        let follows = self.seen.is_some_and(|seen| seen.0 <= now.0 && seen.1 <= now.1);
        self.seen = Some(now);
        self.clouds.iter_mut().for_each(|cloud| cloud.changed = false);
        let fits = |(cloud, (entity, row)): (&Cloud, (Entity, &Particles))| {
            cloud.entity == entity && row.positions.len() <= cloud.room
        };
        let same = scene.iter::<Particles>().count() == self.clouds.len()
            && self.clouds.iter().zip(scene.iter::<Particles>()).all(fits);
        if !same {
            self.lay_out(scene);
        }
        for index in 0..self.clouds.len() {
            let cloud = &mut self.clouds[index];
            cloud.world_from_cloud = scene.world_pose(cloud.entity);
            let revision = scene.changed::<Particles>(cloud.entity);
            if !follows || cloud.revision.is_none() || cloud.revision != revision {
                cloud.revision = revision;
                if let Some(row) = scene.get::<Particles>(cloud.entity) {
                    self.fill(index, row);
                }
            }
        }
        true
    }

    /// Reassigns the ranges of all entities in the list.
    fn lay_out(&mut self, scene: &Snapshot) {
        self.clouds.clear();
        self.particles.clear();
        for (entity, row) in scene.iter::<Particles>() {
            let (first, needed) = (self.particles.len(), row.positions.len());
            // A cloud that has grown will probably grow again.
            let room = if first + needed > DRAWN_MAX { 0 } else { needed.next_power_of_two().max(ROOM_MIN) };
            self.particles.resize((first + room).min(DRAWN_MAX), Particle::default());
            self.clouds.push(Cloud {
                entity,
                kind: row.kind,
                world_from_cloud: Isometry3::identity(),
                color: [0.0; 3],
                first,
                count: 0,
                radius: 0.0,
                ball: (Point3::origin(), 0.0),
                changed: true,
                room: self.particles.len() - first,
                revision: None,
            });
        }
    }

    fn fill(&mut self, index: usize, row: &Particles) {
        let cloud = &mut self.clouds[index];
        (cloud.kind, cloud.color) = (row.kind, row.color.map(|part| part as f32));
        cloud.count = row.positions.len().min(cloud.room);
        (cloud.changed, cloud.radius) = (true, 0.0);
        let mut random = SplitMix64::new(0);
        let (mut low, mut high) = (Point3::new(f64::MAX, f64::MAX, f64::MAX), Point3::origin());
        high.coords.fill(f64::MIN);
        let places = &mut self.particles[cloud.first..cloud.first + cloud.count];
        for (number, (place, position)) in places.iter_mut().zip(row.positions.iter()).enumerate() {
            let (radius, extinction) = row.particle(number);
            cloud.radius = cloud.radius.max(radius);
            (low, high) = (low.inf(position), high.sup(position));
            *place = Particle {
                position: position.coords.map(|part| part as f32).into(),
                radius: radius as f32,
                extinction: extinction as f32,
                turn: random.unit_f32(),
                cloud: index as u32,
                unused: 0,
            };
        }
        if cloud.count > 0 {
            cloud.ball = (nalgebra::center(&low, &high), 0.5 * (high - low).norm() + cloud.radius);
        }
    }

    /// The puffs of smoke in front of an eye, from back to front.
    pub fn sorted(&self, view: &View, keys: &mut Vec<(f32, u32)>, order: &mut Vec<u32>) {
        keys.clear();
        order.clear();
        let eye_from_world = view.world_from_eye.inverse();
        for cloud in self.clouds.iter().filter(|cloud| cloud.kind == ParticleKind::Smoke) {
            let eye_from_cloud = eye_from_world * cloud.world_from_cloud;
            let along: Vector3<f32> =
                eye_from_cloud.rotation.inverse().transform_vector(&Vector3::z()).cast();
            let offset = eye_from_cloud.translation.z as f32;
            for index in cloud.first..cloud.first + cloud.count {
                let depth = along.dot(&Vector3::from(self.particles[index].position)) + offset;
                if depth > view.lens.near as f32 {
                    keys.push((-depth, index as u32));
                }
            }
        }
        keys.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        order.extend(keys.iter().map(|(_, index)| *index));
    }

    /// All drops of the fluids.
    pub fn drops(&self, order: &mut Vec<u32>) {
        order.clear();
        for cloud in self.clouds.iter().filter(|cloud| cloud.kind == ParticleKind::Fluid) {
            order.extend(cloud.first as u32..(cloud.first + cloud.count) as u32);
        }
    }

    /// The part of a pane in which fluids may be visible \[pixels of the pane\]: left, top, width, height; `None` when
    /// there is none.
    pub fn fluid_bounds(&self, view: &View, [width, height]: [u32; 2]) -> Option<[u32; 4]> {
        let (mut low, mut high) = ([1.0_f64; 2], [0.0_f64; 2]);
        let eye_from_world = view.world_from_eye.inverse();
        for cloud in self.clouds.iter().filter(|cloud| cloud.kind == ParticleKind::Fluid && cloud.count > 0) {
            let (middle, radius) = cloud.ball;
            let centre = eye_from_world * (cloud.world_from_cloud * middle);
            if centre.z + radius < view.lens.near {
                continue;
            }
            if centre.z - radius < view.lens.near {
                return Some([0, 0, width, height]);
            }
            // The corners of a box around the sphere bound its projection.
            for corner in 0..8_u32 {
                let side = |bit: u32| if corner >> bit & 1 == 0 { -radius } else { radius };
                let at = centre + Vector3::new(side(0), side(1), side(2));
                let Some((place, _)) = view.project(&(view.world_from_eye * at)) else { continue };
                for axis in 0..2 {
                    low[axis] = low[axis].min(place[axis]);
                    high[axis] = high[axis].max(place[axis]);
                }
            }
        }
        let edge = |share: f64, side: u32| (share.clamp(0.0, 1.0) * f64::from(side)) as u32;
        let (left, top) = (edge(low[0], width), edge(low[1], height));
        let (right, bottom) = (
            edge(high[0], width).saturating_add(1).min(width),
            edge(high[1], height).saturating_add(1).min(height),
        );
        (left < right && top < bottom && low[0] < high[0] && low[1] < high[1])
            .then(|| [left, top, right - left, bottom - top])
    }
}
