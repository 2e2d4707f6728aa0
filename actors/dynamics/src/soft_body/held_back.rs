//! Instruments that hands lead, as a soft body holds them back: none passes through it.
//!
//! Up to a share of the distance between a rod's axis and the surface it touches, a contact is the spring of the body's
//! `contact_stiffness`, and the instrument stands where its hand leads it. Deeper, a much harder one stops the instrument:
//! a mass that its hand draws on by a coupling of bounded force (virtual coupling: Colgate, Stanley, Brown 1995), and whose
//! motion is solved together with the body's, as that of a rigid body which the soft one bears. It moves without turning:
//! the hand holds its direction.
//!
//! A step is linear: the instrument may not go far in it. The tick is divided into steps that can follow it, as long as
//! possible ([`HeldBack::step_max`], [`HeldBack::judge`]).
//!
//! Only instruments with an [`InstrumentDeflection`] give way here: others are moved by a world of rigid bodies.

use nalgebra::{Isometry3, Matrix3, Vector3};
use trocar_collision::primitive::closest_on_segment;
use trocar_scene::{Access, Commands, Entity, EntitySet, Instrument, SimTime, Snapshot, Velocity};

use super::bearing::rigid_response::{PlaneContact, RigidInStep};
use super::instrument_rods::Rod;
use super::rod_contact::{ContactSurface, RodContact, gap};
use super::tick_course::STEP_SHORTEST;
use crate::instrument::deflection::{InstrumentDeflection, InstrumentYield, InstrumentYields};
use crate::instrument::hand_coupling::HandCoupling;

/// Depth from which on a contact stops an instrument, as a share of the distance from the rod's axis to the surface. The
/// rest of it is the radius around which a sheet or a line bends: around a smaller one it slides off. Volumes do neither.
const SOFT: f64 = 0.3;
const SOFT_IN_VOLUME: f64 = 0.6;
/// Further depth, as such a share, at which one contact alone bears all that a hand can draw with. Of several on a sheet or
/// a line each is softer by the root of their number: some bear more than others.
const HARD: f64 = 0.1;
/// Way in which a contact stops an instrument that its hand's force alone would not, as such a share.
const BRAKING: f64 = 0.4;
/// How far an instrument and what it touches may go in one step, as such a share. Farther, contacts turn by more than they
/// may, or are lost, and what is light is thrown.
const STRIDE: f64 = 0.4;
/// By how much the depth of a contact after a step may differ from what the step has found, as such a share.
const MISSED: f64 = 0.05;
/// By how much it may change in a step, as such a share: where contacts ring, the steps are too long.
const JUMPS: f64 = 0.1;
/// By how much steps grow again.
const GROWS: f64 = 1.2;
/// A displacement below this is over \[m\].
const OVER: f64 = 1e-7;

/// An instrument in the current tick, in the body's frame.
#[derive(Clone, Copy, Debug)]
struct Led {
    instrument: Entity,
    coupling: HandCoupling,
    /// Its displacement from where its hand leads it \[m\], and the velocity of that \[m/s\].
    offset: Vector3<f64>,
    velocity: Vector3<f64>,
    /// Both at the beginning of the step.
    began: [Vector3<f64>; 2],
    /// Its velocity in the scene, without that of this body's displacement \[m/s\].
    speed: Vector3<f64>,
    /// Force on it by the contacts that stop it, in the last step as well, and of its coupling on the hand \[N\].
    pushed: Vector3<f64>,
    pushed_before: Vector3<f64>,
    pulled: Vector3<f64>,
    yields: YieldLaw,
    is_stopped: bool,
}

/// By how much an instrument's displacement changes in a step under a force of contacts \[m\]: `free` plus force over
/// `stiffness`. Its coupling is softer at the bound of its force: so the law is the tangent at the force of the last step.
/// The body is solved with it and the instrument is moved by it. If it were moved by another one, by that of its coupling
/// itself, it would be thrown where a step is long: without the coupling only its mass resists.
#[derive(Clone, Copy, Debug, Default)]
struct YieldLaw {
    free: Vector3<f64>,
    /// \[N/m\]
    stiffness: f64,
}

/// A contact that stops an instrument.
#[derive(Clone, Copy, Debug)]
struct Stop {
    touch: usize,
    led: usize,
    plane: PlaneContact,
}

/// All of them, for one body.
#[derive(Clone, Debug, Default)]
pub struct HeldBack {
    list: Vec<Led>,
    stops: Vec<Stop>,
    is_touched: bool,
    /// Longest step in which the body has followed them \[s\]; 0 where it need not be limited.
    step_max: f64,
    yields: InstrumentYields,
    is_told: bool,
}

impl HeldBack {
    /// Resumes from the scene.
    #[must_use]
    pub fn resume(scene: &Snapshot, body: Entity) -> Self {
        let known = scene.get::<InstrumentYields>(body);
        let is_told = known.is_some() || scene.iter::<Instrument>().next().is_none();
        let yields = known.cloned().unwrap_or_default();
        Self { step_max: yields.step_max, yields, is_told, ..Self::default() }
    }

    /// What a controller with these bodies reads and writes for them.
    #[must_use]
    pub fn access(access: Access, bodies: &[Entity]) -> Access {
        access.reads::<InstrumentDeflection>().writes::<InstrumentYields>(EntitySet::Of(bodies.to_vec()))
    }

    /// Begins a tick: rods stand where this body has displaced their instruments to.
    pub fn begin(
        &mut self,
        scene: &Snapshot,
        body: Entity,
        world_from_body: &Isometry3<f64>,
        rods: &mut [Rod],
    ) {
        self.list.clear();
        self.stops.clear();
        let own = |of: &Vector3<f64>| world_from_body.rotation.inverse_transform_vector(of);
        let mut entities: Vec<Entity> =
            scene.iter::<InstrumentDeflection>().map(|(entity, _)| entity).collect();
        entities.sort_unstable();
        for entity in entities {
            let (Some(told), Some(instrument)) =
                (scene.get::<InstrumentDeflection>(entity), scene.get::<Instrument>(entity))
            else {
                continue;
            };
            let known = self.yields.of(entity);
            let told_by = told.of(body);
            // By this body, as its pose in the scene contains them.
            let drawn = [own(&told_by.offset), own(&told_by.velocity)];
            let offset = known.map_or_else(Vector3::zeros, |known| own(&known.offset));
            let velocity = known.map_or_else(Vector3::zeros, |known| own(&known.velocity));
            let moving = scene.get::<Velocity>(entity).copied().unwrap_or_default();
            self.list.push(Led {
                instrument: entity,
                coupling: HandCoupling::of(instrument, told.force_max),
                offset,
                velocity,
                began: [offset, velocity],
                speed: own(&moving.linear) - drawn[1],
                pushed: Vector3::zeros(),
                pushed_before: known.map_or_else(Vector3::zeros, |known| own(&known.contact_force)),
                pulled: Vector3::zeros(),
                yields: YieldLaw::default(),
                is_stopped: false,
            });
            if drawn == [offset, velocity] {
                continue;
            }
            for rod in rods.iter_mut().filter(|rod| rod.instrument == entity) {
                rod.ends.iter_mut().for_each(|end| *end += offset - drawn[0]);
                rod.velocities.iter_mut().for_each(|speed| *speed += velocity - drawn[1]);
            }
        }
    }

    /// Displacement of an instrument by this body \[m\], and its velocity \[m/s\].
    pub(super) fn displacement(&self, instrument: Entity) -> [Vector3<f64>; 2] {
        let led = self.list.iter().find(|led| led.instrument == instrument);
        led.map_or([Vector3::zeros(); 2], |led| [led.offset, led.velocity])
    }

    /// Notes how fast an instrument is led in the body's own time, after missed steps \[m/s\].
    pub(super) fn is_led_at(&mut self, instrument: Entity, speed: Vector3<f64>) {
        let led = self.list.iter_mut().find(|led| led.instrument == instrument);
        led.into_iter().for_each(|led| led.speed = speed);
    }

    /// The longest step that can follow the instruments that are not let through, up to `within` \[s\]: none of them goes
    /// farther in it, into what it touches or will touch, than a share of its distance from that.
    pub fn step_max(
        &self,
        (touches, rods): (&[RodContact], &[Rod]),
        skin: &ContactSurface<'_>,
        velocities: &[Vector3<f64>],
        within: f64,
        passes: impl Fn(Entity) -> bool,
    ) -> f64 {
        let mut longest = if self.step_max > 0.0 { self.step_max.min(within) } else { within };
        for led in self.list.iter().filter(|led| !passes(led.instrument)) {
            let mut held = false;
            let mut approaches = 0.0_f64;
            for touch in touches.iter().filter(|touch| rods[touch.rod].instrument == led.instrument) {
                let own = touch.nodes.iter().zip(touch.weights);
                let body: Vector3<f64> =
                    own.filter_map(|(&node, weight)| Some(velocities.get(node as usize)? * weight)).sum();
                held |= touch.depth > 0.0;
                let [rod, body] = [touch.velocity, body].map(|speed| touch.normal.dot(&speed));
                approaches = approaches.max(rod).max(rod - body);
            }
            let drawn = led.coupling.force(&led.offset, &(led.velocity * within), within).0;
            let lacking = if held { led.pushed_before - drawn } else { -drawn };
            let pull = lacking.norm() / led.coupling.mass;
            for rod in rods.iter().filter(|rod| rod.instrument == led.instrument && !rod.is_open_jaw) {
                let reach = rod.radius + skin.thickness;
                let speed = rod.velocities.iter().map(Vector3::norm).fold(0.0, f64::max);
                let way = longest * (speed + 0.5 * longest * pull);
                let Some(gap) = gap(rod, skin, way) else { continue };
                let (way, speed) = match gap > 0.0 {
                    true => (gap + STRIDE * reach, speed),
                    false => (STRIDE * reach, approaches),
                };
                // v t + a t² / 2 = s.
                let fast = (speed * speed + 2.0 * pull * way).sqrt() + speed;
                longest = longest.min(2.0 * way / fast.max(f64::MIN_POSITIVE));
            }
        }
        longest
    }

    /// After a step of `step` \[s\]: moves the rods on, to where the next step of the tick begins.
    pub fn lead(&self, rods: &mut [Rod], step: f64) {
        for rod in rods {
            let led = self.list.iter().find(|led| led.instrument == rod.instrument);
            let [[offset, velocity], [offset_before, velocity_before]] =
                led.map_or([[Vector3::zeros(); 2]; 2], |led| [[led.offset, led.velocity], led.began]);
            for (end, speed) in rod.ends.iter_mut().zip(&mut rod.velocities) {
                *speed -= velocity_before;
                *end += *speed * step + (offset - offset_before);
                *speed += velocity;
            }
        }
    }

    /// After a step of `step` \[s\], with the body and the rods where it has moved them: takes shorter steps if contacts are
    /// not as deep as the step has found, since it was too long for its linear contacts; else slowly longer ones again.
    pub fn judge(&mut self, (touches, rods): (&[RodContact], &[Rod]), skin: &ContactSurface<'_>, step: f64) {
        let soft = if skin.closed { SOFT_IN_VOLUME } else { SOFT };
        let is_missed = |stop: &Stop| {
            let rod = &rods[touches[stop.touch].rod];
            let reach = rod.radius + skin.thickness;
            let place = stop.plane.place(skin.positions).into();
            let away = (place - rod.ends[0].lerp(&rod.ends[1], closest_on_segment(&place, &rod.ends))).norm();
            let found = soft * reach + stop.plane.force / stop.plane.stiffness;
            let (depth, before) = (reach - away, touches[stop.touch].depth);
            (depth - found).abs() > MISSED * reach || (depth - before).abs() > JUMPS * reach
        };
        let can_halve = step >= 2.0 * STEP_SHORTEST;
        if can_halve && self.stops.iter().any(|stop| stop.plane.force > 0.0 && is_missed(stop)) {
            self.step_max = 0.5 * step;
        } else if self.step_max > 0.0 {
            self.step_max *= GROWS;
        }
    }

    /// After a tick of `period` \[s\]: steps need no limit if they may be as long as that, or if nothing is stopped.
    pub fn forget_limit(&mut self, period: f64) {
        if self.step_max >= period || !self.list.iter().any(|led| led.is_stopped) {
            self.step_max = 0.0;
        }
    }

    /// Finds the contacts that stop instruments in a step of `step` \[s\]; `passes` are those that do not: jaws that hold
    /// the body.
    pub fn find(
        &mut self,
        (touches, rods): (&[RodContact], &[Rod]),
        skin: &ContactSurface<'_>,
        velocities: &[Vector3<f64>],
        step: f64,
        passes: impl Fn(Entity) -> bool,
    ) {
        self.stops.clear();
        self.is_touched = false;
        let soft = if skin.closed { SOFT_IN_VOLUME } else { SOFT };
        for (index, led) in self.list.iter_mut().enumerate() {
            (led.pushed, led.began) = (Vector3::zeros(), [led.offset, led.velocity]);
            led.is_stopped = led.offset != Vector3::zeros() || led.velocity != Vector3::zeros();
            let is_let_through = passes(led.instrument);
            let (first, was_stopped) = (self.stops.len(), led.is_stopped);
            let mut is_pressed = false;
            for (number, touch) in touches.iter().enumerate().filter(|_| !is_let_through) {
                let rod = &rods[touch.rod];
                let reach = rod.radius + skin.thickness;
                // A rod whose axis has crossed a sheet is in its hole, or carries it on its tip.
                let is_through = !skin.closed && touch.depth > reach;
                if rod.instrument != led.instrument || rod.is_open_jaw || is_through {
                    continue;
                }
                self.is_touched = true;
                let own = touch.nodes.iter().zip(touch.weights);
                let body: Vector3<f64> =
                    own.filter_map(|(&node, weight)| Some(velocities.get(node as usize)? * weight)).sum();
                is_pressed |= touch.depth > 0.0;
                let depth = touch.depth.min(reach);
                let nears = touch.normal.dot(&(touch.velocity - body)).max(0.0);
                led.is_stopped |= depth + nears * step > soft * reach;
                // Turning brings some parts of it nearer than others.
                let turns = touch.normal.dot(&(touch.velocity - led.speed - led.velocity));
                // It bears the hand's force, and stops the instrument's own momentum.
                let comes = touch.normal.dot(&(led.speed + led.velocity)).max(0.0) / (BRAKING * reach);
                let bears = led.coupling.force_max / (HARD * reach);
                let stiffness = bears.max(led.coupling.mass * comes * comes);
                let beyond = depth - soft * reach;
                let plane = PlaneContact {
                    nodes: touch.nodes,
                    weights: touch.weights,
                    normal: touch.normal,
                    depth: beyond + turns * step,
                    stiffness,
                    body: 0,
                    arm: Vector3::zeros(),
                    force: if was_stopped { stiffness * beyond.max(0.0) } else { 0.0 },
                };
                self.stops.push(Stop { touch: number, led: index, plane });
            }
            if led.is_stopped {
                led.yields = led.law(if is_pressed { led.pushed_before } else { Vector3::zeros() }, step);
            } else {
                self.stops.truncate(first);
            }
            let own = &mut self.stops[first..];
            let presses = |stop: &&Stop| touches[stop.touch].depth > 0.0;
            let softer = (own.iter().filter(presses).count().max(1) as f64).sqrt();
            for stop in own.iter_mut().filter(|_| !skin.closed) {
                stop.plane.stiffness /= softer;
                stop.plane.force /= softer;
            }
        }
    }

    /// Whether instruments that are not let through touch the body, or may within the tick.
    #[must_use]
    pub fn is_touched(&self) -> bool {
        self.is_touched
    }

    /// Adds them to a step of `step` \[s\].
    pub fn press(&self, step: f64, presses: &mut Vec<PlaneContact>, bodies: &mut Vec<RigidInStep>) {
        let mut last = None;
        for stop in &self.stops {
            if last != Some(stop.led) {
                last = Some(stop.led);
                bodies.push(self.list[stop.led].in_step(step));
            }
            presses.push(PlaneContact { body: bodies.len() as u32 - 1, ..stop.plane });
        }
    }

    /// After a step, with the forces of its contacts on the body \[N\].
    pub fn end_step(&mut self, forces: &[Vector3<f64>], step: f64) {
        for (stop, force) in self.stops.iter_mut().zip(forces) {
            stop.plane.force = force.norm();
            self.list[stop.led].pushed -= force;
        }
        self.list.iter_mut().filter(|led| led.is_stopped).for_each(|led| led.end_step(step));
    }

    /// For bodies without mass, whose forces balance at once: each instrument, with the bound of its coupling's force \[N\]
    /// and its displacement \[m\].
    pub fn instruments(&self) -> impl Iterator<Item = (Entity, f64, Vector3<f64>)> + '_ {
        self.list.iter().map(|led| (led.instrument, led.coupling.force_max, led.offset))
    }

    /// Displaces an instrument further, by its number among those, in a step of `step` \[s\]: there contacts push it with
    /// this force \[N\], which is its coupling's.
    pub fn balance(&mut self, number: usize, by: Vector3<f64>, force: Vector3<f64>, step: f64) {
        let led = &mut self.list[number];
        led.is_stopped |= led.offset != Vector3::zeros() || by != Vector3::zeros();
        (led.offset, led.velocity) = (led.offset + by, by / step);
        (led.pushed, led.pulled) = (force, force);
    }

    /// The contacts that stop instruments, by the numbers of their touches, with these forces on the body \[N\].
    pub fn stopping<'a>(
        &'a self,
        forces: &'a [Vector3<f64>],
    ) -> impl Iterator<Item = (usize, &'a Vector3<f64>)> + 'a {
        self.stops.iter().map(|stop| stop.touch).zip(forces)
    }

    /// Ends a tick: writes what has changed.
    pub fn end(&mut self, body: Entity, world_from_body: &Isometry3<f64>, now: SimTime, out: &mut Commands) {
        let world = |of: Vector3<f64>| world_from_body.rotation * of;
        let told = |led: &Led| InstrumentYield {
            instrument: led.instrument,
            offset: world(led.offset),
            velocity: world(led.velocity),
            coupling_force: world(led.pulled),
            contact_force: world(led.pushed),
        };
        let list: Vec<InstrumentYield> = self.list.iter().filter(|led| led.is_stopped).map(told).collect();
        // One more when nothing is held back any longer; then nothing until something is.
        self.is_told &= list.is_empty() && self.yields.list.is_empty();
        if !self.is_told {
            self.is_told = true;
            self.yields = InstrumentYields { list, at: now, step_max: self.step_max };
            out.put(body, self.yields.clone());
            self.is_told = self.yields.list.is_empty();
        }
    }
}

impl Led {
    /// How it yields in a step of `step` \[s\] about this force of contacts \[N\].
    fn law(&self, force: Vector3<f64>, step: f64) -> YieldLaw {
        let motion = [&self.offset, &self.velocity];
        let by = self.coupling.change(motion, (&force, &Matrix3::zeros()), &Vector3::zeros(), step);
        let (_, tangent) = self.coupling.needed(motion, &by, step);
        let along = (self.offset + by).try_normalize(0.0).unwrap_or_else(Vector3::x);
        let stiffness = along.dot(&(tangent * along));
        YieldLaw { free: by - force / stiffness, stiffness }
    }

    /// The instrument in a step of `step` \[s\]: what its coupling adds to its inertia, and where it is drawn.
    fn in_step(&self, step: f64) -> RigidInStep {
        RigidInStep {
            mass: self.yields.stiffness * step * step,
            // It does not turn, and no contact has a lever.
            inertia: Matrix3::identity(),
            velocity: [self.speed + self.velocity, Vector3::zeros()],
            pull: [(self.yields.free / step - self.velocity) / step, Vector3::zeros()],
            own_step: 0.0,
            is_led: true,
        }
    }

    fn end_step(&mut self, step: f64) {
        let by = self.yields.free + self.pushed / self.yields.stiffness;
        self.pulled = self.coupling.force(&self.offset, &by, step).0;
        self.pushed_before = self.pushed;
        self.offset += by;
        self.velocity = by / step;
        if self.pushed == Vector3::zeros() && self.offset.norm() < OVER {
            (self.offset, self.velocity) = (Vector3::zeros(), Vector3::zeros());
        }
    }
}
