//! Touch at a station of a network: what its hands meet, without the network's delay.
//!
//! The host's local contact models are as old as the round trip: a hand at 0.1 m/s is 15 mm inside of a board before a plane
//! comes over a path of 150 ms. So the station lets a proxy of its own (a god-object, Zilles and Salisbury 1995) meet the
//! bodies that never move, of which its copy of the scene is always true, and takes from the host what it cannot know:
//! the planes of what yields, what pulls at the instrument, how stiff walls are, and how far above the one that is touched the
//! blades stop the tip.
//! That is model-mediated teleoperation (Mitra and Niemeyer, *Model-mediated telemanipulation*, 2008), with the geometry known.

use nalgebra::{Point3, Vector3};
use trocar_scene::components::{
    ContactPlane, Instrument, InstrumentTarget, LocalContactModel, Parent, Pose, RigidBody, Shape,
    StationContactModel, SurfaceMesh, Velocity, VertexPositions,
};
use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Entity, EntitySet, Revision, SimTime,
    Snapshot, Tick,
};

use super::static_bodies::{StaticBodies, StaticPoint};
use crate::finger_proxy::{FingerProxy, PlaneProperties, ProxyConfig};

/// Distance within which surfaces are planes before they are met \[m\], beyond the way of two ticks.
const FORESIGHT: f64 = 2e-3;
/// Ticks of look-ahead: the current one, and one until haptics gets the model.
const TICKS_AHEAD: f64 = 2.0;
/// A plane of the host's this near to a static surface, and this alike in direction (cosine), is that surface \[m\].
const SAME_SURFACE: (f64, f64) = (4e-3, 0.8);
/// A wall of the host's is the one that is met here if it is the same plane, to this distance \[m\] and cosine, and no
/// further away along it \[m\].
const SAME_WALL: (f64, f64, f64) = (5e-4, 0.98, 0.05);
/// Largest difference between where the host stops a tip and the surface \[m\]: the blades have a thickness.
const STANDOFF_MAX: f64 = 4e-3;
/// Age by arrival at which a pull of the host's begins to fade, and at which it is gone \[s\].
const PULL_FADE: (f64, f64) = (0.05, 0.1);
/// The same of its planes, which hold where they are.
const PLANE_FADE: (f64, f64) = (0.5, 1.0);
/// Longest time for which a model counts as of the host's last one \[s\].
const STAMP_MAX_SECS: f64 = 0.1;
/// Friction of walls of which the host has told nothing yet.
const FRICTION: f64 = 0.2;

/// How static walls feel at the host, as far as it has told.
#[derive(Clone, Copy, Debug, PartialEq)]
struct WallFeel {
    properties: PlaneProperties,
    friction: f64,
}

/// A static wall that the instrument touches at the host.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TouchedWall {
    surface: StaticPoint,
    /// How far above the surface the tip is stopped \[m\].
    standoff: f64,
}

impl TouchedWall {
    /// Whether this plane, which lies on a surface, is the same wall.
    fn is(&self, plane: &ContactPlane) -> bool {
        let (apart, alike, along) = SAME_WALL;
        let way = plane.point_in_world - self.surface.point_in_world;
        self.surface.outwards_in_world.dot(&plane.normal_in_world) >= alike
            && self.surface.outwards_in_world.dot(&way).abs() <= apart
            && way.norm() <= along
    }
}

/// The touch of one instrument.
struct TouchedInstrument {
    instrument: Entity,
    proxy: FingerProxy,
    walls: WallFeel,
    /// The host's model that was seen last, and when it came.
    host: Option<(Revision, SimTime)>,
    before: Option<(SimTime, Point3<f64>)>,
}

/// Writes the station's own contact models of the instruments of its hands.
pub struct StationTouchController {
    instruments: Vec<TouchedInstrument>,
    bodies: StaticBodies,
}

impl StationTouchController {
    /// For these instruments. Proxies of an earlier life go on from where they were.
    ///
    /// # Errors
    /// One is no instrument.
    pub fn new(instruments: &[Entity], context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let scene = context.scene;
        let touched = |&instrument: &Entity| {
            let Some(tool) = scene.get::<Instrument>(instrument) else {
                return Err(ControllerError::Scene(format!("'{}' is no instrument", scene.name(instrument))));
            };
            let config = ProxyConfig { radius: 0.0, ..ProxyConfig::default() };
            let proxy = match scene.get::<StationContactModel>(instrument) {
                Some(own) => FingerProxy::resumed(config, &own.model.proxy_in_world.translation.into()),
                None => FingerProxy::new(config),
            };
            let proxy = proxy.map_err(|error| ControllerError::Scene(error.to_string()))?;
            let stiffness = tool.coupling_stiffness;
            let damping = 2.0 * (stiffness * tool.mass).sqrt();
            let properties = PlaneProperties { stiffness, damping };
            let walls = WallFeel { properties, friction: FRICTION };
            Ok(TouchedInstrument { instrument, proxy, walls, host: None, before: None })
        };
        let instruments = instruments.iter().map(touched).collect::<Result<_, _>>()?;
        Ok(Self { instruments, bodies: StaticBodies::new(scene) })
    }
}

impl TouchedInstrument {
    fn model(
        &mut self,
        tick: &Tick<'_>,
        scene: &Snapshot,
        target: &InstrumentTarget,
        bodies: &StaticBodies,
    ) -> Result<LocalContactModel, ControllerError> {
        let tip_in_world = target.tip_in_world.isometry();
        let tip = Point3::from(tip_in_world.translation.vector);
        let period_secs = tick.period.as_secs_f64();
        let place = self.proxy.step(bodies.surface(), &tip, period_secs);
        let place = place.map_err(|error| ControllerError::Failed(error.to_string()))?;
        let (host, touched) = self.of_the_host(scene, tick.time, bodies).unzip();
        let touched = touched.unwrap_or_default();
        let highest = touched.iter().flatten().fold(0.0_f64, |highest, wall| highest.max(wall.standoff));
        let foresight =
            FORESIGHT + highest + TICKS_AHEAD * period_secs * target.velocity_in_world.linear.norm();
        let WallFeel { properties, friction } = self.walls;
        let mut model = self.proxy.local_contact_model(
            bodies.surface(),
            &nalgebra::Isometry3::identity(),
            &properties,
            foresight,
            tick.time,
        );
        for plane in model.planes.iter_mut().flatten() {
            // Elsewhere the tip itself is what is stopped.
            if let Some(wall) = touched.iter().flatten().find(|wall| wall.is(plane)) {
                plane.point_in_world += plane.normal_in_world * wall.standoff;
            }
            plane.friction = friction;
        }
        if let Some(host) = host {
            // Haptics blends from one stamp to the next: what the host sends in steps must not be felt as steps. Walls that are
            // met meanwhile are in force at once.
            let came_at = self.host.map_or(tick.time, |(_, came_at)| came_at);
            let oldest = tick.time.since(SimTime::from_secs_f64(STAMP_MAX_SECS));
            model.at = came_at.max(oldest);
            model.base_force = host.base_force;
            // What yields goes before walls that are only near.
            for plane in host.planes.into_iter().flatten() {
                let free = model.planes.iter().position(Option::is_none).unwrap_or(model.planes.len() - 1);
                model.planes[free] = Some(plane);
            }
        }
        let linear = self.before.map_or(Vector3::zeros(), |(at, before)| {
            let secs = tick.time.since(at).as_secs_f64();
            if secs > 0.0 { (place - before) / secs } else { Vector3::zeros() }
        });
        self.before = Some((tick.time, place));
        model.proxy_velocity = Velocity { linear, angular: target.velocity_in_world.angular };
        model.proxy_in_world = Pose::new(place.coords, tip_in_world.rotation);
        Ok(model)
    }

    /// What the host's model has beyond the static walls, faded by the time since it came; and the walls that it has. How
    /// they feel is taken over.
    fn of_the_host(
        &mut self,
        scene: &Snapshot,
        now: SimTime,
        bodies: &StaticBodies,
    ) -> Option<(LocalContactModel, [Option<TouchedWall>; 4])> {
        let mut host = *scene.get::<LocalContactModel>(self.instrument)?;
        let revision = scene.changed::<LocalContactModel>(self.instrument)?;
        let came_at = match self.host {
            Some((known, came_at)) if known == revision => came_at,
            _ => now,
        };
        self.host = Some((revision, came_at));
        let age_secs = now.since(came_at).as_secs_f64();
        let share = |(start, end): (f64, f64)| ((end - age_secs) / (end - start)).clamp(0.0, 1.0);
        host.base_force *= share(PULL_FADE);
        let mut walls = [None; 4];
        for (slot, wall) in host.planes.iter_mut().zip(&mut walls) {
            let Some(plane) = slot else { continue };
            *wall = touched_wall(plane, bodies);
            if wall.is_some() {
                let properties = PlaneProperties { stiffness: plane.stiffness, damping: plane.damping };
                self.walls = WallFeel { properties, friction: plane.friction };
                *slot = None;
            } else {
                plane.stiffness *= share(PLANE_FADE);
            }
        }
        Some((host, walls))
    }
}

/// The static wall of which the host's plane is, if it is of one.
fn touched_wall(plane: &ContactPlane, bodies: &StaticBodies) -> Option<TouchedWall> {
    let (reach, alike) = SAME_SURFACE;
    let surface = bodies.nearest(&plane.point_in_world, reach)?;
    let is_same = surface.outwards_in_world.dot(&plane.normal_in_world) >= alike;
    let above = plane.normal_in_world.dot(&(plane.point_in_world - surface.point_in_world));
    is_same.then_some(TouchedWall { surface, standoff: above.clamp(-STANDOFF_MAX, STANDOFF_MAX) })
}

impl Controller for StationTouchController {
    fn access(&self) -> Access {
        let instruments = self.instruments.iter().map(|touched| touched.instrument).collect();
        Access::new()
            .reads::<RigidBody>()
            .reads::<Shape>()
            .reads::<SurfaceMesh>()
            .reads::<VertexPositions>()
            .reads::<Pose>()
            .reads::<Parent>()
            .reads::<Instrument>()
            .reads::<InstrumentTarget>()
            .reads::<LocalContactModel>()
            .writes::<StationContactModel>(EntitySet::Of(instruments))
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.bodies.follow(scene);
        for touched in &mut self.instruments {
            // Without a target of the hand there is nothing to touch with.
            let Some(target) = scene.get::<InstrumentTarget>(touched.instrument) else { continue };
            let model = touched.model(tick, scene, target, &self.bodies)?;
            out.put(touched.instrument, StationContactModel { model });
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "station_touch_tests.rs"]
mod tests;
