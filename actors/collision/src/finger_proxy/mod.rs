//! The haptic proxy: what stands on the surface for the hand that has gone through it, and pulls it back (god-object:
//! Zilles and Salisbury, *A constraint-based god-object method for haptic display*, 1995; a finger of some size: Ruspini,
//! Kolarov and Khatib, *The haptic display of complex graphical environments*, 1997).
//!
//! The proxy is a sphere that seeks the device and never passes a triangle. What it touches are planes; it goes to the
//! place nearest to the device that up to three of them allow, as far as a sweep against all triangles about it lets it,
//! and looks again. It is held a *skin* off the surface, and swept with half of that skin: so rounding never decides
//! whether it passes, and sliding over a flat triangulation meets nothing. A touched edge or corner counts only where no
//! triangle that shares it is nearer, so that a flat or convex joint is no bump.
//!
//! When the surface moves it carries the proxy along: within each update the triangles about it go from where they were to
//! where they are in steps that are shorter than their distance, and push it before them.

mod carry;
mod config;
mod local_model;
mod neighbourhood;
mod planes;
mod rolling;

pub use config::{ProxyConfig, ProxyError};
pub use local_model::PlaneFeel;

use nalgebra::{Point3, Vector3};

use crate::moving_surface::MovingSurface;
use crate::primitive::closest_on_triangle;
use crate::pseudonormal::pseudonormal;
use neighbourhood::Neighbourhood;
use planes::{Held, Plane, Planes};
use rolling::Rolling;

/// Looks and moves of a step at most; what is left is done in the next.
const MOVES_MAX: usize = 6;
/// Of the skin: what counts as touching, beyond the skin itself.
const TOUCH: f64 = 0.25;
/// Of the skin: a move shorter than this is none.
const SETTLED: f64 = 1e-2;
/// Of the skin: what a plane may be violated by.
const EXACT: f64 = 1e-3;
/// Of the skin: a retreat that is always made, also in an acute wedge.
const RETREAT: f64 = 20.0;
/// Triangles told apart where the proxy touches.
const TOUCHED_MAX: usize = 24;

/// One of the planes that hold the proxy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProxyContact {
    /// Which triangle.
    pub triangle: u32,
    /// Weights of the touched point on its corners.
    pub weights: [f64; 3],
    /// The touched point, in the surface's frame \[m\].
    pub on_surface: Point3<f64>,
    /// Unit normal towards the proxy.
    pub normal: Vector3<f64>,
    /// How far it pushes the proxy away from the device \[m\]: its share of the force, over the stiffness.
    pub push: f64,
    /// Velocity of the surface there \[m/s\].
    pub surface_velocity: Vector3<f64>,
}

/// Counts since the proxy was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProxyStatistics {
    /// Steps.
    pub steps: u64,
    /// Looks at what is around, and moves.
    pub moves: u64,
    /// Times that the tree was asked.
    pub gathered: u64,
    /// Sweeps through the tree, for moves beyond the neighbourhood.
    pub long_sweeps: u64,
    /// Updates of the surface in which walls met where the proxy was, so that it could not stay on its side.
    pub squeezed: u64,
    /// Times that it was put in front of a surface that it had no path from: the first, or other triangles.
    pub placed: u64,
}

/// The proxy of one hand and one surface.
#[derive(Clone, Debug)]
pub struct FingerProxy {
    config: ProxyConfig,
    proxy: Point3<f64>,
    device: Point3<f64>,
    velocity: Vector3<f64>,
    contacts: [Option<ProxyContact>; 3],
    is_sticking: bool,
    /// What it touched at its last look.
    touched: Vec<Touched>,
    around: Neighbourhood,
    carried: carry::Carried,
    /// Topology revision and number of updates that the proxy has followed.
    seen: Option<(u64, u64)>,
    /// Whether its place is one that it had before, and not to be found yet.
    resumes: bool,
    statistics: ProxyStatistics,
}

/// A triangle that the proxy touches.
#[derive(Clone, Copy, Debug)]
struct Touched {
    triangle: u32,
    weights: [f64; 3],
    on_surface: Point3<f64>,
    normal: Vector3<f64>,
    distance: f64,
}

impl Touched {
    fn of(mesh: &MovingSurface, triangle: u32, proxy: &Point3<f64>) -> Option<Self> {
        let nearest = closest_on_triangle(proxy, &mesh.surface().triangle(triangle));
        let away = proxy - nearest.point;
        let distance = away.norm();
        (distance > 0.0).then(|| Self {
            triangle,
            weights: nearest.weights,
            on_surface: nearest.point,
            normal: away / distance,
            distance,
        })
    }

    /// Whether another triangle has the edge or the corner on which this is touched, and is nearer: then that is what is
    /// touched.
    fn is_part_of(&self, other: &Self, mesh: &MovingSurface) -> bool {
        if other.distance >= self.distance * (1.0 - 1e-12) || self.weights.iter().all(|weight| *weight > 0.0)
        {
            return false;
        }
        let surface = mesh.surface();
        let (own, others) =
            (surface.triangles()[self.triangle as usize], surface.triangles()[other.triangle as usize]);
        own.iter().zip(&self.weights).all(|(corner, weight)| *weight <= 0.0 || others.contains(corner))
    }
}

fn check_place(place: &Point3<f64>) -> Result<(), ProxyError> {
    if place.iter().all(|coordinate| coordinate.is_finite()) {
        return Ok(());
    }
    let [x, y, z] = (*place).into();
    Err(ProxyError::NotFinite([x, y, z]))
}

impl FingerProxy {
    /// A proxy that begins where the device is at its first step.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(config: ProxyConfig) -> Result<Self, ProxyError> {
        config.check()?;
        Ok(Self {
            config,
            proxy: Point3::origin(),
            device: Point3::origin(),
            velocity: Vector3::zeros(),
            contacts: [None; 3],
            is_sticking: false,
            touched: Vec::with_capacity(TOUCHED_MAX),
            around: Neighbourhood::new(config.radius + config.skin),
            carried: carry::Carried::default(),
            seen: None,
            resumes: false,
            statistics: ProxyStatistics::default(),
        })
    }

    /// A proxy that goes on from where it was, in the surface's frame \[m\]: it stays on its side of what the device is
    /// behind. What has moved over it in between, by less than its radius, pushes it out again.
    ///
    /// # Errors
    /// A parameter out of its range, or a place that is not finite.
    pub fn resumed(config: ProxyConfig, place: &Point3<f64>) -> Result<Self, ProxyError> {
        check_place(place)?;
        Ok(Self { proxy: *place, device: *place, resumes: true, ..Self::new(config)? })
    }

    /// What it is.
    #[must_use]
    pub fn config(&self) -> &ProxyConfig {
        &self.config
    }

    /// Where it is, in the surface's frame \[m\].
    #[must_use]
    pub fn position(&self) -> Point3<f64> {
        self.proxy
    }

    /// Its velocity over the last step \[m/s\]; 0 where no time was told.
    #[must_use]
    pub fn velocity(&self) -> Vector3<f64> {
        self.velocity
    }

    /// The planes that hold it away from the device, those that push most first.
    pub fn contacts(&self) -> impl Iterator<Item = &ProxyContact> {
        self.contacts.iter().flatten()
    }

    /// Whether friction held it in the last step.
    #[must_use]
    pub fn is_sticking(&self) -> bool {
        self.is_sticking
    }

    /// What a spring of this stiffness \[N/m\] from the device to the proxy pulls the device with \[N\].
    #[must_use]
    pub fn force(&self, stiffness: f64) -> Vector3<f64> {
        (self.proxy - self.device) * stiffness
    }

    /// What it has cost so far.
    #[must_use]
    pub fn statistics(&self) -> &ProxyStatistics {
        &self.statistics
    }

    /// Forgets where it is: it begins anew at the device.
    pub fn reset(&mut self) {
        self.seen = None;
        self.resumes = false;
    }

    /// Follows the surface to where it is now, and the device as far as the surface allows, `interval_secs` after the step
    /// before (0 where that is not known). Returns where the proxy is.
    ///
    /// It stays on its side through any number of steps as long as it sees every update of the surface. At first, after
    /// [`reset`](Self::reset), after missed updates and after a change of triangles it has no path to go by: at first it is
    /// put in front of the nearest triangle if it is behind that, later only where it overlaps one.
    ///
    /// # Errors
    /// A device or a time that is not finite; the proxy stays where it was.
    pub fn step(
        &mut self,
        mesh: &MovingSurface,
        device_in_surface: &Point3<f64>,
        interval_secs: f64,
    ) -> Result<Point3<f64>, ProxyError> {
        check_place(device_in_surface)?;
        if !(interval_secs >= 0.0 && interval_secs.is_finite()) {
            let valid = "0 s or more, and finite,";
            return Err(ProxyError::Parameter { what: "a time", value: interval_secs, valid });
        }
        self.device = *device_in_surface;
        self.statistics.steps += 1;
        let before = self.proxy;
        let now = (mesh.topology_revision(), mesh.updates());
        match self.seen {
            Some(seen) if seen == now => {}
            Some((revision, updates)) if revision == now.0 && updates + 1 == now.1 => self.carry(mesh),
            Some(_) => self.place(mesh, self.hold()),
            None if self.resumes => self.place(mesh, self.hold()),
            None => {
                self.proxy = self.device;
                self.place(mesh, f64::INFINITY);
            }
        }
        let begins = self.seen.is_none();
        self.seen = Some(now);
        self.follow(mesh);
        self.velocity = if begins || interval_secs == 0.0 {
            Vector3::zeros()
        } else {
            (self.proxy - before) / interval_secs
        };
        Ok(self.proxy)
    }

    /// Distance at which the planes hold its middle \[m\].
    fn hold(&self) -> f64 {
        self.config.radius + self.config.skin
    }

    /// Distance below which no sweep lets it come \[m\].
    fn guard(&self) -> f64 {
        self.config.radius + 0.5 * self.config.skin
    }

    /// Puts it in front of the nearest triangle, if it is behind it and nearer than `within` \[m\], or overlaps it.
    fn place(&mut self, mesh: &MovingSurface, within: f64) {
        self.statistics.placed += 1;
        self.around.forget();
        for attempt in 0..8 {
            let within = if attempt == 0 { within.max(self.hold()) } else { self.hold() };
            let nearest = mesh.tree().nearest_to_point(&mesh.surface(), &self.proxy, within);
            let Ok(Some(nearest)) = nearest else { return };
            let (surface, topology) = (mesh.surface(), mesh.topology());
            let outward = pseudonormal(&surface, topology, nearest.triangle, &nearest.nearest.weights);
            let away = self.proxy - nearest.nearest.point;
            let is_behind = outward.is_some_and(|outward| outward.dot(&away) < 0.0);
            if !is_behind && nearest.distance >= self.guard() {
                return;
            }
            let direction = if nearest.distance > 1e-3 * self.config.skin {
                away / if is_behind { -nearest.distance } else { nearest.distance }
            } else {
                outward.map_or_else(Vector3::z, |outward| outward.normalize())
            };
            self.proxy = nearest.nearest.point + direction * self.hold();
        }
    }

    /// Goes to the device as far as the surface lets it.
    fn follow(&mut self, mesh: &MovingSurface) {
        let mut blocked: [Option<u32>; 4] = [None; 4];
        let mut blocks = 0;
        let mut sticks = false;
        let mut rolling = Rolling::default();
        let mut ends = None;
        let tolerance = EXACT * self.config.skin;
        for _ in 0..MOVES_MAX {
            self.statistics.moves += 1;
            let wish = self.device - self.proxy;
            let (planes, nearest) = self.touch(mesh, &wish, &blocked);
            let retreat = planes.retreat(tolerance, RETREAT * self.config.skin);
            let held = match retreat {
                Some(_) => planes.nearest(&wish, tolerance),
                None => planes.without_retreat().nearest(&wish, tolerance),
            };
            let mut held = held.unwrap_or(Held { motion: Vector3::zeros(), active: [None; 3] });
            if retreat.is_none() {
                held.motion += planes.compromise();
            }
            let mut motion;
            (motion, sticks) = self.rub(&held, &retreat.unwrap_or_default());
            if held.active[0].is_some() {
                let slide = motion - retreat.unwrap_or_default();
                let longer = slide * (rolling.stretch(&slide, 0.25 * self.hold()) - 1.0);
                if planes.allow(&(motion + longer), tolerance) {
                    motion += longer;
                }
            }
            ends = Some(held);
            if motion.norm() <= SETTLED * self.config.skin {
                if motion == wish {
                    // The planes allow it, and it is far less than the skin.
                    self.around.travel(wish.norm());
                    self.proxy = self.device;
                }
                break;
            }
            let guard = if nearest > self.guard() - 0.1 * self.config.skin {
                // A rounding below the guard is no matter.
                self.guard().min(nearest) * (1.0 - 1e-12)
            } else {
                // In a gap narrower than itself it has less room, and may use some of what it has.
                0.9 * nearest
            };
            let (share, by) = self.around.sweep(mesh, &self.proxy, &motion, guard, &mut self.statistics);
            // Where nothing is in the way it is the device, to the last bit: no force in free space.
            self.proxy =
                if share >= 1.0 && motion == wish { self.device } else { self.proxy + motion * share };
            self.around.travel(motion.norm() * share);
            if let Some(by) = by {
                blocked[blocks % blocked.len()] = Some(by);
                blocks += 1;
            }
        }
        self.is_sticking = sticks;
        self.contacts = [None; 3];
        if let Some(held) = ends {
            let told = held.active.iter().flatten().filter(|(_, push)| *push > 0.0);
            for (slot, &(owner, push)) in self.contacts.iter_mut().zip(told) {
                let touched = &self.touched[owner];
                *slot = Some(ProxyContact {
                    triangle: touched.triangle,
                    weights: touched.weights,
                    on_surface: touched.on_surface,
                    normal: touched.normal,
                    push,
                    surface_velocity: mesh.velocity(touched.triangle, &touched.weights),
                });
            }
            self.contacts.sort_by(|a, b| {
                let push = |contact: &Option<ProxyContact>| contact.map_or(-1.0, |contact| contact.push);
                push(b).total_cmp(&push(a))
            });
        }
    }

    /// The planes of what it touches, and how near the nearest triangle is \[m\].
    fn touch(&mut self, mesh: &MovingSurface, wish: &Vector3<f64>, blocked: &[Option<u32>]) -> (Planes, f64) {
        let hold = self.hold();
        let reach = hold + TOUCH * self.config.skin;
        let mut nearest = f64::INFINITY;
        let touched = &mut self.touched;
        touched.clear();
        self.around.look(mesh, &self.proxy, reach, &mut self.statistics, |found| {
            nearest = nearest.min(found.distance);
            if found.distance <= reach && touched.len() < TOUCHED_MAX {
                touched.push(*found);
            }
        });
        let mut planes = Planes::none();
        for (owner, own) in touched.iter().enumerate() {
            let is_blocked = blocked.contains(&Some(own.triangle));
            let is_part = || touched.iter().any(|other| own.is_part_of(other, mesh));
            if is_blocked || !is_part() {
                planes.push(Plane { normal: own.normal, least: hold - own.distance, owner }, wish);
            }
        }
        (planes, nearest)
    }

    /// The motion that friction leaves, and whether it holds the proxy (the friction cone: Harwin and Melder, *Improved
    /// haptic rendering for multi-finger manipulation using friction cone based god-objects*, 2002).
    fn rub(&self, held: &Held, retreat: &Vector3<f64>) -> (Vector3<f64>, bool) {
        let pressed: f64 = held.active.iter().flatten().map(|(_, push)| push).sum();
        if self.config.static_friction <= 0.0 || pressed <= 0.0 {
            return (held.motion, false);
        }
        // A retreat from what came too near is no sliding.
        let slide = held.motion - retreat;
        let size = slide.norm();
        if size <= self.config.static_friction * pressed {
            return (*retreat, true);
        }
        (retreat + slide * (1.0 - self.config.dynamic_friction * pressed / size), false)
    }
}
