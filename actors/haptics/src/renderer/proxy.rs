//! Constraint proxy on a local contact model.
//!
//! Zilles & Salisbury 1995, "A constraint-based god-object method for haptic display"; Ruspini, Kolarov & Khatib 1997,
//! "The haptic display of complex graphical environments". The simulation publishes up to four planes; the proxy is the
//! point nearest to the device on their allowed side, and a spring pulls the hand to it. Since the planes are evaluated
//! at the *present* device position, the delay of the wall is one haptic tick, even with slow physics.
//!
//! Each plane may be compliant. With coupling stiffness `K`, plane stiffness `k_i`, normals `n_i` and depths `δ_i` of
//! the device, the normal forces `λ_i` solve
//!
//! `0 ≤ λ_i  ⊥  Σ_j (n_i·n_j/K) λ_j + c_i λ_i − δ_i ≥ 0`,  `c_i = max(0, 1/k_i − 1/K)`:
//!
//! a rigid plane has the stiffness `K`, a softer one its own, and a plane reported by two detectors does not count
//! twice. Friction holds the proxy within Coulomb's cone.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_scene::{ContactPlane, LocalContactModel};

use super::{ForceRenderer, RenderInput, freshness};
use crate::spatial::Wrench;

/// Sweeps of the projected Gauss-Seidel iteration.
const SWEEPS: usize = 32;
/// Age of a model after which it fades \[s\]; physics at 10 Hz renews it every 0.1 s.
const FADE_SECS: f64 = 0.5;
/// Depth over which contact damping ramps up \[m\]: full damping right at the surface would chatter.
const DAMPING_DEPTH: f64 = 1e-4;

/// Parameters of the proxy.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProxyConfig {
    /// Stiffness between device and proxy \[N/m\], and so of a rigid wall; bounded by the device's stable stiffness.
    pub stiffness: f64,
    /// Damping ratio of the contact: device mass on the spring of the contact. A sampled and delayed spring generates
    /// energy, like a negative damping of about `K·1.5 ΔT`, which this damping must exceed. A plane with more damping
    /// keeps its own, up to the device's stable damping.
    pub damping_ratio: f64,
    /// Shortest and longest time constant with which a change of the model is blended in \[s\]; in between
    /// it is half of the time between two models.
    pub blend_secs: [f64; 2],
}

impl Default for ProxyConfig {
    fn default() -> Self {
        Self { stiffness: 800.0, damping_ratio: 0.5, blend_secs: [0.002, 0.02] }
    }
}

/// The proxy and the blend between models.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proxy {
    config: ProxyConfig,
    /// Friction anchor of the proxy, while in contact.
    anchor: Option<Vector3<f64>>,
    /// The previous tick's model.
    model: Option<LocalContactModel>,
    /// Remaining difference of the previous models' elastic force, being blended out.
    remainder: Vector3<f64>,
    /// The same for damping and base force.
    free_remainder: Vector3<f64>,
    blend_secs: f64,
}

impl Proxy {
    /// A proxy out of contact.
    pub fn new(config: ProxyConfig) -> Self {
        Self {
            config,
            anchor: None,
            model: None,
            remainder: Vector3::zeros(),
            free_remainder: Vector3::zeros(),
            blend_secs: config.blend_secs[0],
        }
    }

    /// Lets the remainders of the previous models decay.
    ///
    /// If the blend makes the planes' force *grow*, for instance when slow physics detects late that the hand is inside
    /// a wall, the growth pushes the hand out and gives it energy. It proceeds only as fast as the hand's energy covers
    /// it: until then the wall stays at the point of contact, with the same stiffness.
    fn blend(&mut self, force: &Vector3<f64>, input: &RenderInput<'_>) {
        let (size, missing) = (force.norm(), self.remainder.norm());
        let mut pace = 1.0;
        if self.remainder.dot(force) < 0.0 {
            // The hand may leave a wall that is too deep; it is never pulled back to it.
            if missing > size {
                self.remainder *= size / missing;
            }
            let price = size * missing / self.config.stiffness.min(input.stiffness_max).max(1e-6);
            if price > 0.0 {
                pace = (input.energy_available / price).clamp(0.0, 1.0);
            }
        }
        // An implicit step of exponential decay, because `exp` is not bit-identical on every machine.
        let rate = input.dt / self.blend_secs.max(1e-6);
        self.remainder /= 1.0 + pace * rate;
        // A held weight is rendered regardless of the hand's energy, and damping only dissipates.
        self.free_remainder /= 1.0 + rate;
    }

    /// Contact force of a model's planes at the device's current position.
    fn contact_force(&self, model: &LocalContactModel, input: &RenderInput<'_>) -> ContactForce {
        let tip = input.tip_in_world.translation.vector;
        let velocity = input.tip_twist.linear;
        let stiffness = self.config.stiffness.min(input.stiffness_max).max(1e-6);
        let contacts = Contacts::near(&model.planes, &tip, stiffness);
        let lambda = contacts.solve(stiffness);

        let (mut elastic, mut damped) = (Vector3::zeros(), Vector3::zeros());
        let mut friction = 0.0f64;
        for (contact, lambda) in contacts.iter().zip(lambda) {
            if lambda <= 0.0 {
                continue;
            }
            let onset = (contact.depth / DAMPING_DEPTH).clamp(0.0, 1.0);
            let spring = 1.0 / (contact.compliance + 1.0 / stiffness);
            let critical = 2.0 * (spring * input.apparent_mass).sqrt();
            let damping = contact.damping.max(self.config.damping_ratio * critical);
            let damping = damping.min(input.damping_max) * onset;
            let closing = -contact.normal.dot(&velocity);
            elastic += contact.normal * lambda;
            // Never negative: a pulling contact would feel like glue.
            damped += contact.normal * (lambda + damping * closing).max(0.0);
            friction = friction.max(contact.friction);
        }
        let size = elastic.norm();
        if size <= 0.0 {
            return ContactForce::default();
        }
        let normal = elastic / size;
        let slide = self.anchor.unwrap_or(tip) - tip;
        let tangential = (slide - normal * normal.dot(&slide)) * stiffness;
        let (stretch, limit) = (tangential.norm(), friction * damped.norm());
        let tangential = if stretch > limit { tangential * (limit / stretch) } else { tangential };
        ContactForce {
            elastic: elastic + tangential,
            viscous: damped - elastic,
            anchor: Some(tip + tangential / stiffness),
        }
    }
}

/// Contact force of planes at one position.
#[derive(Clone, Copy, Debug, Default)]
struct ContactForce {
    /// Position-dependent part, with friction \[N\].
    elastic: Vector3<f64>,
    /// Velocity-dependent part \[N\].
    viscous: Vector3<f64>,
    /// New friction anchor.
    anchor: Option<Vector3<f64>>,
}

impl ForceRenderer for Proxy {
    fn render(&mut self, input: &RenderInput<'_>) -> Wrench {
        let Some(model) = input.contact_model else {
            self.reset();
            return Wrench::ZERO;
        };
        let contact = self.contact_force(model, input);
        let free = contact.viscous + input.waited(model.base_force, model.at);
        if self.model.as_ref().map(|before| before.at) != Some(model.at) {
            // The old and the new model are compared at the same, current pose: a comparison with the previous tick's
            // force would also blend the hand's own motion, which delays the wall. Before the first model the force is
            // zero, so a hand that reconnects inside a wall is led out gently.
            let (elastic_before, free_before) = self.model.map_or(Default::default(), |before| {
                let [shortest, longest] = self.config.blend_secs;
                let renewal = model.at.since(before.at).as_secs_f64();
                self.blend_secs = (0.5 * renewal).min(longest).max(shortest);
                let contact = self.contact_force(&before, input);
                (contact.elastic, contact.viscous + input.waited(before.base_force, before.at))
            });
            self.remainder += elastic_before - contact.elastic;
            self.free_remainder += free_before - free;
            self.model = Some(*model);
        }
        self.anchor = contact.anchor;
        self.blend(&contact.elastic, input);
        let total = contact.elastic + self.remainder + free + self.free_remainder;
        let fresh = freshness(input.now.since(model.at).as_secs_f64(), FADE_SECS);
        Wrench::new(total * fresh, Vector3::zeros())
    }
    fn reset(&mut self) {
        *self = Self::new(self.config);
    }
    fn name(&self) -> &'static str {
        "proxy"
    }
}

/// One plane that the device is behind.
#[derive(Clone, Copy)]
struct Contact {
    normal: Vector3<f64>,
    depth: f64,
    compliance: f64,
    damping: f64,
    friction: f64,
}

/// The planes that the device is behind, at most as many as a model holds.
struct Contacts {
    list: [Option<Contact>; 4],
}

impl Contacts {
    fn near(planes: &[Option<ContactPlane>; 4], tip: &Vector3<f64>, stiffness: f64) -> Self {
        let mut list = [None; 4];
        for (slot, plane) in list.iter_mut().zip(planes.iter().flatten()) {
            let size = plane.normal_in_world.norm();
            if !(size > 0.5 && plane.stiffness > 0.0) {
                continue;
            }
            let normal = plane.normal_in_world / size;
            let depth = normal.dot(&(plane.point_in_world.coords - tip));
            // Planes not yet reached are kept: the proxy pushed out of one may meet another.
            *slot = Some(Contact {
                normal,
                depth,
                compliance: (1.0 / plane.stiffness - 1.0 / stiffness).max(0.0),
                damping: plane.damping.max(0.0),
                friction: plane.friction.max(0.0),
            });
        }
        Self { list }
    }

    fn iter(&self) -> impl Iterator<Item = &Contact> {
        self.list.iter().flatten()
    }

    /// Normal forces \[N\], in the order of [`Contacts::iter`].
    fn solve(&self, stiffness: f64) -> [f64; 4] {
        let mut lambda = [0.0f64; 4];
        if self.iter().all(|contact| contact.depth <= 0.0) {
            return lambda;
        }
        for _ in 0..SWEEPS {
            let mut change = 0.0f64;
            for (i, contact) in self.iter().enumerate() {
                let pressed: f64 = self
                    .iter()
                    .zip(lambda)
                    .map(|(other, force)| contact.normal.dot(&other.normal) * force)
                    .sum();
                let gap = pressed / stiffness + contact.compliance * lambda[i] - contact.depth;
                let updated = (lambda[i] - gap / (1.0 / stiffness + contact.compliance)).max(0.0);
                change = change.max((updated - lambda[i]).abs());
                lambda[i] = updated;
            }
            if change < 1e-9 {
                break;
            }
        }
        lambda
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::input_at;
    use super::*;
    use nalgebra::Point3;
    use trocar_scene::SimTime;

    fn plane(point: Vector3<f64>, normal: Vector3<f64>, stiffness: f64, friction: f64) -> ContactPlane {
        ContactPlane {
            point_in_world: Point3::from(point),
            normal_in_world: normal.normalize(),
            stiffness,
            damping: 0.0,
            friction,
        }
    }
    fn model(planes: &[ContactPlane]) -> LocalContactModel {
        let mut model = LocalContactModel::default();
        for (slot, plane) in model.planes.iter_mut().zip(planes) {
            *slot = Some(*plane);
        }
        model
    }
    /// The steady-state force at a position.
    fn force(proxy: &mut Proxy, model: &LocalContactModel, tip: Vector3<f64>) -> Vector3<f64> {
        let mut input = input_at(tip);
        input.contact_model = Some(model);
        (0..200).map(|_| proxy.render(&input).force).last().unwrap()
    }
    fn fresh() -> Proxy {
        Proxy::new(ProxyConfig { stiffness: 1000.0, ..ProxyConfig::default() })
    }

    #[test]
    fn a_rigid_plane_feels_like_the_coupling_and_a_soft_one_like_itself() {
        let up = Vector3::z();
        for (stiffness, felt) in [(1e9, 1000.0), (1000.0, 1000.0), (300.0, 300.0)] {
            let model = model(&[plane(Vector3::zeros(), up, stiffness, 0.0)]);
            let pushed = force(&mut fresh(), &model, Vector3::new(0.0, 0.0, -0.002));
            assert!((pushed - up * 0.002 * felt).norm() < 1e-6, "{stiffness}: {pushed:?}");
        }
        let model = model(&[plane(Vector3::zeros(), up, 1e9, 0.0)]);
        assert_eq!(force(&mut fresh(), &model, Vector3::new(0.0, 0.0, 0.001)), Vector3::zeros());
    }

    #[test]
    fn a_plane_reported_twice_is_one_plane() {
        let twice = plane(Vector3::zeros(), Vector3::z(), 1e6, 0.0);
        let pushed =
            force(&mut fresh(), &model(&[twice, twice, twice, twice]), Vector3::new(0.0, 0.0, -0.001));
        assert!((pushed.z - 1.0).abs() < 2e-3, "{pushed:?}");
    }

    #[test]
    fn an_obtuse_corner_holds_the_proxy_on_both_planes() {
        let (a, b) = (Vector3::new(0.6, 0.0, 0.8), Vector3::new(-0.6, 0.0, 0.8));
        let corner = model(&[plane(Vector3::zeros(), a, 1e9, 0.0), plane(Vector3::zeros(), b, 1e9, 0.0)]);
        let tip = Vector3::new(0.0002, 0.0, -0.002);
        // The nearest allowed point is the corner itself.
        assert!((force(&mut fresh(), &corner, tip) + tip * 1000.0).norm() < 1e-5);
        // Outside plane b only plane a pushes: the proxy is its foot point.
        let tip = Vector3::new(-0.01, 0.0, 0.0);
        let foot = a * (-tip.dot(&a)) * 1000.0;
        assert!((force(&mut fresh(), &corner, tip) - foot).norm() < 1e-5);
    }

    #[test]
    fn friction_sticks_within_the_cone_and_slides_beyond() {
        let rough = model(&[plane(Vector3::zeros(), Vector3::z(), 1e9, 0.5)]);
        let mut proxy = fresh();
        force(&mut proxy, &rough, Vector3::new(0.0, 0.0, -0.002));
        let stuck = force(&mut proxy, &rough, Vector3::new(0.0005, 0.0, -0.002));
        assert!((stuck - Vector3::new(-0.5, 0.0, 2.0)).norm() < 1e-6, "{stuck:?}");
        let sliding = force(&mut proxy, &rough, Vector3::new(0.01, 0.0, -0.002));
        assert!((sliding - Vector3::new(-1.0, 0.0, 2.0)).norm() < 1e-6, "{sliding:?}");
        // The anchor was dragged along: a small step back does not feel the old stretch.
        let back = force(&mut proxy, &rough, Vector3::new(0.009, 0.0, -0.002));
        assert!(back.x.abs() < 1e-6, "{back:?}");
    }

    #[test]
    fn a_change_of_model_is_blended() {
        let mut low = model(&[plane(Vector3::zeros(), Vector3::z(), 1e9, 0.0)]);
        low.base_force = Vector3::new(0.0, 0.0, -0.05);
        let mut proxy = fresh();
        let before = force(&mut proxy, &low, Vector3::new(0.0, 0.0, -0.001));
        assert!((before.z - 0.95).abs() < 1e-9);
        let mut high = model(&[plane(Vector3::new(0.0, 0.0, 0.002), Vector3::z(), 1e9, 0.0)]);
        high.at = SimTime::from_millis(100);
        let mut input = input_at(Vector3::new(0.0, 0.0, -0.001));
        input.now = high.at;
        input.contact_model = Some(&high);
        let mut last = before.z;
        for tick in 0..100 {
            let now = proxy.render(&input).force.z;
            // 2.05 N in 20 ms, exponentially: at most 0.1 N in a tick.
            assert!(now >= last && now - last < 0.11, "tick {tick}: {last} then {now}");
            last = now;
        }
        assert!((last - 3.0).abs() < 0.02);
    }

    #[test]
    fn a_wall_that_appears_around_the_hand_waits_until_the_hand_has_paid() {
        let wall = model(&[plane(Vector3::zeros(), Vector3::z(), 1e9, 0.0)]);
        let mut proxy = fresh();
        let mut at = |depth: f64, energy: f64, ticks: usize| {
            let mut input = input_at(Vector3::new(0.0, 0.0, -depth));
            input.contact_model = Some(&wall);
            input.energy_available = energy;
            (0..ticks).map(|_| proxy.render(&input).force.z).last().unwrap()
        };
        assert!(at(0.002, 0.0, 500).abs() < 1e-9, "nothing paid, nothing pushes");
        assert!((at(0.003, 0.0, 500) - 1.0).abs() < 1e-9, "deeper it is as stiff as ever");
        assert!(at(0.001, 0.0, 500).abs() < 1e-9, "it does not pull back");
        assert!((at(0.003, 0.0, 1) - 2.0).abs() < 1e-9, "and it has followed the hand out");
        assert!((at(0.003, 1.0, 500) - 3.0).abs() < 1e-6, "paid for, it comes back to its place");
    }

    #[test]
    fn contact_damping_opposes_entry_and_never_pulls() {
        let wall = model(&[plane(Vector3::zeros(), Vector3::z(), 1e9, 0.0)]);
        let mut input = input_at(Vector3::new(0.0, 0.0, -0.001));
        input.contact_model = Some(&wall);
        let settled = force(&mut fresh(), &wall, Vector3::new(0.0, 0.0, -0.001));
        let mut moving = |speed: f64| {
            let mut proxy = fresh();
            force(&mut proxy, &wall, Vector3::new(0.0, 0.0, -0.001));
            input.tip_twist.linear.z = speed;
            proxy.render(&input).force.z
        };
        // ζ = 0.5 of 45 g on 1,000 N/m.
        let damping = (0.045f64 * 1000.0).sqrt();
        assert!((moving(-0.1) - settled.z - 0.1 * damping).abs() < 1e-6);
        assert!(moving(10.0).abs() < 1e-12);
    }

    #[test]
    fn a_dead_simulation_lets_go() {
        let wall = model(&[plane(Vector3::zeros(), Vector3::z(), 1e9, 0.0)]);
        let mut proxy = fresh();
        let mut input = input_at(Vector3::new(0.0, 0.0, -0.001));
        input.contact_model = Some(&wall);
        input.now = SimTime::from_millis(2000);
        assert!((0..200).map(|_| proxy.render(&input).force.z).last().unwrap().abs() < 1e-9);
    }

    #[test]
    fn a_weight_told_by_another_station_lets_go_while_the_wall_stays() {
        let mut wall = model(&[plane(Vector3::zeros(), Vector3::z(), 1e9, 0.0)]);
        wall.base_force = Vector3::new(0.0, -0.5, 0.0);
        let at = |millis, remote| {
            let mut input = input_at(Vector3::new(0.0, 0.0, -0.001));
            input.contact_model = Some(&wall);
            input.remote = remote;
            let mut proxy = fresh();
            for _ in 0..200 {
                proxy.render(&input);
            }
            input.now = SimTime::from_millis(millis);
            proxy.render(&input).force
        };
        assert!((at(50, true) - Vector3::new(0.0, -0.5, 1.0)).norm() < 1e-6);
        assert!((at(100, true) - Vector3::new(0.0, 0.0, 1.0)).norm() < 1e-6);
        assert!((at(100, false) - Vector3::new(0.0, -0.5, 1.0)).norm() < 1e-6);
    }

    #[test]
    fn senseless_planes_are_ignored() {
        let null = ContactPlane {
            normal_in_world: Vector3::zeros(),
            ..plane(Vector3::zeros(), Vector3::z(), 1.0, 0.0)
        };
        let soft = plane(Vector3::zeros(), Vector3::z(), -5.0, 0.0);
        assert_eq!(
            force(&mut fresh(), &model(&[null, soft]), Vector3::new(0.0, 0.0, -1.0)),
            Vector3::zeros()
        );
    }
}
