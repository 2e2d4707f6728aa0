//! The haptic proxy: stays on the surface while the device penetrates it, and pulls the device back (god-object: Zilles
//! and Salisbury, *A constraint-based god-object method for haptic display*, 1995; a finger of finite size: Ruspini,
//! Kolarov and Khatib, *The haptic display of complex graphical environments*, 1997).
//!
//! The proxy is a sphere that moves towards the device and never passes a triangle. Touched triangles are constraint
//! planes; it moves to the position nearest to the device that up to three of them allow, as far as a sweep against all
//! nearby triangles allows, and repeats. It is kept a *skin* off the surface, and swept with half of that skin: so
//! rounding never lets it pass, and sliding over a flat triangulation hits nothing. A touched edge or corner counts
//! only if no triangle that shares it is nearer, so that a flat or convex joint is no bump.
//!
//! A moving surface carries the proxy along: within each update the nearby triangles move from their old to their new
//! positions in steps shorter than their distance, and push the proxy.

mod carry;
mod config;
mod local_model;
mod neighbourhood;
mod planes;
mod rolling;

pub use config::{ProxyConfig, ProxyError};
pub use local_model::PlaneProperties;

use nalgebra::{Point3, Vector3};

use crate::moving_surface::MovingSurface;
use crate::primitive::closest_on_triangle;
use crate::pseudonormal::pseudonormal;
use neighbourhood::Neighbourhood;
use planes::{ConstrainedMotion, Plane, Planes};
use rolling::Rolling;

/// Most moves of a step; the rest is done in the next step.
const MOVES_MAX: usize = 6;
/// Relative to the skin: contact tolerance beyond the skin itself.
const TOUCH: f64 = 0.25;
/// Relative to the skin: shortest move.
const SETTLED: f64 = 1e-2;
/// Relative to the skin: tolerated violation of a plane.
const EXACT: f64 = 1e-3;
/// Relative to the skin: a retreat that is always made, even in an acute wedge.
const RETREAT: f64 = 20.0;
/// Most triangles distinguished in contact.
const TOUCHED_MAX: usize = 24;

/// One of the active constraint planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProxyContact {
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of the touched point on its corners.
    pub weights: [f64; 3],
    /// The touched point, in the surface's frame \[m\].
    pub on_surface: Point3<f64>,
    /// Unit normal towards the proxy.
    pub normal: Vector3<f64>,
    /// Its push of the proxy away from the device \[m\]: its share of the force, divided by the stiffness.
    pub push: f64,
    /// Velocity of the surface there \[m/s\].
    pub surface_velocity: Vector3<f64>,
}

/// Counters since the proxy was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProxyStatistics {
    /// Steps.
    pub steps: u64,
    /// Queries and moves.
    pub moves: u64,
    /// Tree queries.
    pub gathered: u64,
    /// Sweeps through the tree, for moves beyond the neighbourhood.
    pub long_sweeps: u64,
    /// Surface updates in which walls closed on the proxy, so that it could not stay on its side.
    pub squeezed: u64,
    /// Times that it was placed in front of a surface without a path: at the first step, or after new triangles.
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
    /// Triangles touched at the last query.
    touched: Vec<TouchedTriangle>,
    around: Neighbourhood,
    carried: carry::Carried,
    /// Topology revision and number of updates that the proxy has followed.
    seen: Option<(u64, u64)>,
    /// Whether its position was restored, and needs no initial placement.
    resumes: bool,
    statistics: ProxyStatistics,
}

/// A triangle that the proxy touches.
#[derive(Clone, Copy, Debug)]
struct TouchedTriangle {
    triangle: u32,
    weights: [f64; 3],
    on_surface: Point3<f64>,
    normal: Vector3<f64>,
    distance: f64,
}

impl TouchedTriangle {
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

    /// Whether another triangle shares the touched edge or corner and is nearer: then only that one counts as touched.
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
    /// A proxy that starts at the device at its first step.
    ///
    /// # Errors
    /// A parameter is out of range.
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

    /// A proxy restored at an earlier position, in the surface's frame \[m\]: it stays on its side of the surface that
    /// the device penetrates. A surface that moved over it meanwhile, by less than its radius, pushes it out again.
    ///
    /// # Errors
    /// A parameter is out of range, or the position is not finite.
    pub fn resumed(config: ProxyConfig, place: &Point3<f64>) -> Result<Self, ProxyError> {
        check_place(place)?;
        Ok(Self { proxy: *place, device: *place, resumes: true, ..Self::new(config)? })
    }

    /// Its parameters.
    #[must_use]
    pub fn config(&self) -> &ProxyConfig {
        &self.config
    }

    /// Its position, in the surface's frame \[m\].
    #[must_use]
    pub fn position(&self) -> Point3<f64> {
        self.proxy
    }

    /// Its velocity over the last step \[m/s\]; 0 if the interval was unknown.
    #[must_use]
    pub fn velocity(&self) -> Vector3<f64> {
        self.velocity
    }

    /// The planes that keep it from the device, the strongest push first.
    pub fn contacts(&self) -> impl Iterator<Item = &ProxyContact> {
        self.contacts.iter().flatten()
    }

    /// Whether friction held it in the last step.
    #[must_use]
    pub fn is_sticking(&self) -> bool {
        self.is_sticking
    }

    /// Force on the device \[N\] of a spring of this stiffness \[N/m\] to the proxy.
    #[must_use]
    pub fn force(&self, stiffness: f64) -> Vector3<f64> {
        (self.proxy - self.device) * stiffness
    }

    /// Its cost so far.
    #[must_use]
    pub fn statistics(&self) -> &ProxyStatistics {
        &self.statistics
    }

    /// Resets it: it restarts at the device.
    pub fn reset(&mut self) {
        self.seen = None;
        self.resumes = false;
    }

    /// Follows the surface's last update, and the device as far as the surface allows, `interval_secs` after the
    /// previous step (0 if unknown). Returns the proxy's position.
    ///
    /// It stays on its side through any number of steps as long as it gets every update of the surface. In the first
    /// step, after [`reset`](Self::reset), after missed updates and after a change of triangles its path is unknown: in
    /// the first step it is placed in front of the nearest triangle if it is behind it, later only if it overlaps one.
    ///
    /// # Errors
    /// The device or the time is not finite; the proxy stays unchanged.
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

    /// Distance of its centre from the planes \[m\].
    fn hold(&self) -> f64 {
        self.config.radius + self.config.skin
    }

    /// Minimum distance kept by sweeps \[m\].
    fn guard(&self) -> f64 {
        self.config.radius + 0.5 * self.config.skin
    }

    /// Places it in front of the nearest triangle, if it is behind it and nearer than `within` \[m\], or overlaps it.
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

    /// Moves towards the device as far as the surface allows.
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
            let mut held = held.unwrap_or(ConstrainedMotion { motion: Vector3::zeros(), active: [None; 3] });
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
                // A rounding error below the guard is harmless.
                self.guard().min(nearest) * (1.0 - 1e-12)
            } else {
                // In a gap narrower than itself it may use part of the remaining room.
                0.9 * nearest
            };
            let (share, by) = self.around.sweep(mesh, &self.proxy, &motion, guard, &mut self.statistics);
            // In free space it equals the device's position bit for bit: no force.
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

    /// The planes of the touched triangles, and the distance of the nearest triangle \[m\].
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

    /// The motion that friction allows, and whether the proxy sticks (the friction cone: Harwin and Melder, *Improved
    /// haptic rendering for multi-finger manipulation using friction cone based god-objects*, 2002).
    fn rub(&self, held: &ConstrainedMotion, retreat: &Vector3<f64>) -> (Vector3<f64>, bool) {
        let pressed: f64 = held.active.iter().flatten().map(|(_, push)| push).sum();
        if self.config.static_friction <= 0.0 || pressed <= 0.0 {
            return (held.motion, false);
        }
        // A retreat from a too near triangle is not sliding.
        let slide = held.motion - retreat;
        let size = slide.norm();
        if size <= self.config.static_friction * pressed {
            return (*retreat, true);
        }
        (retreat + slide * (1.0 - self.config.dynamic_friction * pressed / size), false)
    }
}
