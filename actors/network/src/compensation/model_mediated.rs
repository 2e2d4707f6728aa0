//! Model-mediated coupling for long delays: the master renders, at its own rate, a model of what the slave touches.
//!
//! After Mitra and Niemeyer, "Model-mediated telemanipulation" (2008), and Xu, Cizmeci, Schuwerk and Steinbach (2016,
//! 2017). The slave follows the master's position and estimates, at its own port, a plane with stiffness and damping;
//! only the model crosses the network. A contact known from before is as stiff as without delay, however long the delay
//! is; what is felt at the *first* contact comes a round trip late, as everything does.
//!
//! Estimated is `f = K·s + B·ṡ + c` along the normal by recursive least squares with forgetting, with the depth `s`
//! along the inward normal; the plane lies where the force is zero, `s₀ = −c/K`. Measurements are
//! forgotten only as far as new ones contradict them (Fortescue, Kershenbaum and Ydstie, 1981): a tremor during a long
//! hold carries little news, and must not push out what the way in has told. The normal is the direction of the
//! force in a slow average.
//!
//! A new model is not taken over at once. Away from the plane it moves freely, since there it exerts no force; in contact
//! plane, stiffness and normal change at limited rates, and the force stays within the energy in the master's tank. A
//! plane that rises under a resting hand is work that nobody did: it is only done with what the hand has put in.

use nalgebra::{Matrix3, Vector3};

use super::passivity::CouplingConfig;

/// Contact at the slave, in the frame of the ports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactModel {
    /// Unit normal, out of what is touched.
    pub normal: Vector3<f64>,
    /// Distance of the plane from the origin along the normal \[m\].
    pub offset: f64,
    /// Stiffness [N/m].
    pub stiffness: f64,
    /// Damping [N·s/m].
    pub damping: f64,
}

/// Limits of a model's stiffness [N/m].
pub const STIFFNESS_LIMITS: (f64, f64) = (5.0, 5_000.0);
/// Largest damping of a model [N·s/m].
pub const DAMPING_MAX: f64 = 20.0;
/// Largest distance of a plane from the origin \[m\].
pub const OFFSET_MAX: f64 = 10.0;

impl ContactModel {
    /// How deep a position is behind the plane \[m\]; negative in front of it.
    pub fn depth(&self, position: &Vector3<f64>) -> f64 {
        self.offset - self.normal.dot(position)
    }

    /// Whether every number is finite and within its limits, and the normal of unit length.
    pub fn is_valid(&self) -> bool {
        (self.normal.norm() - 1.0).abs() < 1e-3
            && self.offset.abs() <= OFFSET_MAX
            && (STIFFNESS_LIMITS.0..=STIFFNESS_LIMITS.1).contains(&self.stiffness)
            && (0.0..=DAMPING_MAX).contains(&self.damping)
    }
}

/// Force \[N\] above which something is touched, below half of it nothing is: the coupling also accelerates the tool.
const CONTACT_FORCE: f64 = 0.3;
/// How long it must be above \[s\]; no acceleration lasts so long.
const CONTACT_SECS: f64 = 0.02;
/// Time constant with which position, velocity and force are smoothed alike \[s\].
const SMOOTH_SECS: f64 = 0.01;
/// Motion \[m\] between two measurements that are learnt from: more than a tremor's.
const EXCITATION: f64 = 5e-5;
/// Share of the older measurements that a new one which contradicts them wholly makes forgotten.
const FORGETTING: f64 = 0.05;
/// Error of the prediction \[N\] that is such a contradiction: more than what jitter and tremor leave.
const CONTRADICTION: f64 = 0.2;
/// Speed [m/s] above which nothing is learnt: a command that makes up for a gap shakes the tool.
const LEARNT_SPEED: f64 = 0.15;
/// Measurements that must be learnt before anything is told.
const LEARNT_MIN: u32 = 12;
/// Largest variance of an estimate, in its scaled units.
const VARIANCE_MAX: f64 = 1e6;
/// Weight of the newest direction of the force in the normal, for each learnt measurement.
const NORMAL_GAIN: f64 = 0.02;
/// Depth behind a known plane, without force, at which it is forgotten \[m\].
const GONE_DEPTH: f64 = 0.004;
/// Metres in one unit of the estimator's depth, and metres per second in one of its speed: all columns are near 1.
const DEPTH_SCALE: f64 = 1e-3;
const SPEED_SCALE: f64 = 1e-2;

/// Estimator of the contact at the slave's port.
#[derive(Clone, Debug)]
pub struct ContactEstimator {
    coupling_stiffness: f64,
    normal: Option<Vector3<f64>>,
    /// Position at which the contact began: the depth is counted from here.
    origin: Vector3<f64>,
    /// Force per unit of depth, per unit of speed, and at the origin.
    parameters: Vector3<f64>,
    variance: Matrix3<f64>,
    learnt_depth: f64,
    /// Measurements of this contact.
    learnt: u32,
    touching: bool,
    /// How long the force has been that of a contact \[s\].
    pressed_secs: f64,
    /// Smoothed position, velocity and force.
    smooth: Option<[Vector3<f64>; 3]>,
    model: Option<ContactModel>,
}

impl ContactEstimator {
    /// An estimator that knows nothing.
    pub fn new(config: &CouplingConfig) -> Self {
        Self {
            coupling_stiffness: config.coupling_stiffness,
            normal: None,
            origin: Vector3::zeros(),
            parameters: Vector3::zeros(),
            variance: Matrix3::zeros(),
            learnt_depth: 0.0,
            learnt: 0,
            touching: false,
            pressed_secs: 0.0,
            smooth: None,
            model: None,
        }
    }

    /// What is known of the contact; it stays known while nothing is touched.
    pub fn model(&self) -> Option<&ContactModel> {
        self.model.as_ref()
    }

    /// Takes a measurement at the port: its commanded position, velocity, and the force on a hand there.
    pub fn step(
        &mut self,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        force: &Vector3<f64>,
        step_secs: f64,
    ) {
        let now = [*position, *velocity, *force];
        if !now.iter().flatten().all(|part| part.is_finite()) {
            return;
        }
        let part = (step_secs / SMOOTH_SECS).min(1.0);
        let mut smooth = self.smooth.unwrap_or(now);
        for (smooth, now) in smooth.iter_mut().zip(&now) {
            *smooth += (now - *smooth) * part;
        }
        self.smooth = Some(smooth);
        let [position, velocity, force] = smooth;
        let size = force.norm();
        if size < 0.5 * CONTACT_FORCE {
            self.touching = false;
        }
        self.pressed_secs = if size < CONTACT_FORCE { 0.0 } else { self.pressed_secs + step_secs };
        if self.touching {
            self.learn(&position, &velocity, &force, &(force / size));
        } else if self.pressed_secs > CONTACT_SECS {
            self.touch(&position, &(force / size));
        } else if size < 0.5 * CONTACT_FORCE {
            self.forget_if_gone(&position);
        }
    }

    /// A contact begins: with the surface that is known, or another one.
    fn touch(&mut self, position: &Vector3<f64>, direction: &Vector3<f64>) {
        self.touching = true;
        self.learnt_depth = f64::INFINITY;
        let known = self.model.is_some_and(|model| {
            model.normal.dot(direction) > 0.8 && model.depth(position).abs() < 2.0 * GONE_DEPTH
        });
        if !known {
            self.begin(position, direction);
        }
    }

    fn begin(&mut self, position: &Vector3<f64>, direction: &Vector3<f64>) {
        self.normal = Some(*direction);
        self.origin = *position;
        self.learnt = 0;
        // Expected is what the coupling itself would give at a rigid wall, half as stiff.
        self.parameters = Vector3::new(0.5 * self.coupling_stiffness * DEPTH_SCALE, 0.0, 0.0);
        self.variance = Matrix3::from_diagonal(&Vector3::new(1.0, 0.1, 1.0));
    }

    fn learn(
        &mut self,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        force: &Vector3<f64>,
        direction: &Vector3<f64>,
    ) {
        let Some(normal) = self.normal else { return };
        let depth = normal.dot(&(self.origin - position));
        if (depth - self.learnt_depth).abs() < EXCITATION || velocity.norm() > LEARNT_SPEED {
            return;
        }
        self.learnt_depth = depth;
        self.learnt = self.learnt.saturating_add(1);
        let speed = -normal.dot(velocity);
        let row = Vector3::new(depth / DEPTH_SCALE, speed / SPEED_SCALE, 1.0);
        let spread = self.variance * row;
        let error = normal.dot(force) - self.parameters.dot(&row);
        let contradiction = (error / CONTRADICTION).powi(2).min(1.0);
        let kept = 1.0 - FORGETTING * contradiction;
        let scale = kept + row.dot(&spread);
        self.parameters += spread * (error / scale);
        let variance = (self.variance - spread * spread.transpose() / scale) / kept;
        // Forgetting without news would let the variance grow for ever.
        if variance.trace() < VARIANCE_MAX && variance.iter().all(|number| number.is_finite()) {
            self.variance = 0.5 * (variance + variance.transpose());
        }
        self.turn(position, &normal, direction);
        self.tell();
    }

    /// The normal follows the force; the plane turns about the point that is touched now.
    fn turn(&mut self, position: &Vector3<f64>, normal: &Vector3<f64>, direction: &Vector3<f64>) {
        let turned = (normal + (direction - normal) * NORMAL_GAIN).try_normalize(1e-6).unwrap_or(*normal);
        let moved = normal.dot(&(self.origin - position)) - turned.dot(&(self.origin - position));
        self.parameters.z += self.parameters.x * moved / DEPTH_SCALE;
        self.normal = Some(turned);
    }

    fn tell(&mut self) {
        let Some(normal) = self.normal else { return };
        let stiffness = self.parameters.x / DEPTH_SCALE;
        if self.learnt < LEARNT_MIN || stiffness.is_nan() || stiffness <= STIFFNESS_LIMITS.0 {
            return;
        }
        let model = ContactModel {
            normal,
            offset: normal.dot(&self.origin) + self.parameters.z / stiffness,
            stiffness: stiffness.min(STIFFNESS_LIMITS.1),
            damping: (self.parameters.y / SPEED_SCALE).clamp(0.0, DAMPING_MAX),
        };
        if model.is_valid() {
            self.model = Some(model);
        }
    }

    /// A plane is not there any more when the port is behind it and feels nothing.
    fn forget_if_gone(&mut self, position: &Vector3<f64>) {
        if self.model.is_some_and(|model| model.depth(position) > GONE_DEPTH) {
            self.model = None;
        }
    }
}

/// Speed of the plane against and with the hand in contact [m/s].
const PLANE_SPEED: f64 = 0.02;
/// Rate of the stiffness in contact [N/m/s].
const STIFFNESS_RATE: f64 = 500.0;
/// Time constant of normal and damping in contact \[s\].
const TURN_SECS: f64 = 0.3;

/// The master's copy of the contact.
#[derive(Clone, Debug)]
pub struct RenderedContact {
    stiffness_max: f64,
    damping_max: f64,
    shown: Option<ContactModel>,
    known: Option<ContactModel>,
}

impl RenderedContact {
    /// Without a contact.
    pub fn new(config: &CouplingConfig) -> Self {
        Self {
            stiffness_max: config.stiffness_max,
            damping_max: 0.2 * config.damping_max,
            shown: None,
            known: None,
        }
    }

    /// Takes what the slave knows; a model that is not valid is ignored.
    pub fn receive(&mut self, model: Option<&ContactModel>) {
        if model.is_none_or(ContactModel::is_valid) {
            self.known = model.copied();
        }
    }

    /// What is rendered now.
    pub fn shown(&self) -> Option<&ContactModel> {
        self.shown.as_ref()
    }

    /// Shows what is known at once: for a hand-over that blends the forces itself.
    pub fn take_over(&mut self) {
        self.shown = self.known;
    }

    /// Takes a step towards what is known, and gives the force on the hand \[N\].
    pub fn step(&mut self, position: &Vector3<f64>, velocity: &Vector3<f64>, step_secs: f64) -> Vector3<f64> {
        self.change(position, step_secs);
        let Some(shown) = &self.shown else { return Vector3::zeros() };
        let depth = shown.depth(position);
        if depth <= 0.0 {
            return Vector3::zeros();
        }
        let speed = -shown.normal.dot(velocity);
        let spring = shown.stiffness.min(self.stiffness_max) * depth;
        // A damper never pulls.
        shown.normal * (spring + shown.damping.min(self.damping_max) * speed).max(0.0)
    }

    fn change(&mut self, position: &Vector3<f64>, step_secs: f64) {
        let Some(known) = self.known else {
            // What is gone recedes from the hand until it is free.
            if let Some(shown) = &mut self.shown {
                shown.offset -= PLANE_SPEED * step_secs;
                if shown.depth(position) <= 0.0 {
                    self.shown = None;
                }
            }
            return;
        };
        let Some(shown) = &mut self.shown else {
            // A plane that appears behind the hand begins at the hand.
            let depth = known.depth(position).max(0.0);
            self.shown = Some(ContactModel { offset: known.offset - depth, ..known });
            return;
        };
        if shown.depth(position) <= 0.0 && known.depth(position) <= 0.0 {
            *shown = known;
            return;
        }
        // The plane turns about the point under the hand.
        let part = (step_secs / TURN_SECS).min(1.0);
        let depth = shown.depth(position);
        shown.normal =
            (shown.normal + (known.normal - shown.normal) * part).try_normalize(1e-6).unwrap_or(known.normal);
        shown.damping += (known.damping - shown.damping) * part;
        let most = STIFFNESS_RATE * step_secs;
        shown.stiffness += (known.stiffness - shown.stiffness).clamp(-most, most);
        let most = PLANE_SPEED * step_secs;
        let wanted = known.depth(position);
        let depth = depth + (wanted - depth).clamp(-most, most);
        shown.offset = depth + shown.normal.dot(position);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = 1e-3;

    /// Presses a plane of this normal, offset, stiffness and damping up and down, and sideways.
    fn pressed(truth: &ContactModel, estimator: &mut ContactEstimator, secs: f64) {
        let height = |time: f64| 0.012 * (3.0 * time).cos() + 0.002;
        let side = truth.normal.cross(&Vector3::new(0.3, 0.1, 0.9)).normalize();
        let place = |time: f64| truth.normal * (truth.offset + height(time)) + side * (0.01 * time.sin());
        for step in 0..(secs / STEP) as u32 {
            let time = f64::from(step) * STEP;
            let (position, velocity) = (place(time), (place(time + STEP) - place(time)) / STEP);
            let depth = truth.depth(&position);
            let force = truth.stiffness * depth - truth.damping * truth.normal.dot(&velocity);
            let force = if depth > 0.0 { truth.normal * force.max(0.0) } else { Vector3::zeros() };
            estimator.step(&position, &velocity, &force, STEP);
        }
    }

    #[test]
    fn a_plane_is_found_with_its_stiffness_and_its_damping() {
        let normal = Vector3::new(1.0, -0.4, 0.3).normalize();
        for (stiffness, damping) in [(150.0, 0.5), (300.0, 3.0), (660.0, 1.0)] {
            let truth = ContactModel { normal, offset: 0.05, stiffness, damping };
            let mut estimator = ContactEstimator::new(&CouplingConfig::default());
            assert_eq!(estimator.model(), None);
            pressed(&truth, &mut estimator, 10.0);
            let model = *estimator.model().expect("a contact");
            assert!((model.stiffness / stiffness - 1.0).abs() < 0.05, "{model:?} for {truth:?}");
            assert!((model.damping - damping).abs() < 0.3, "{model:?} for {truth:?}");
            assert!((model.offset - truth.offset).abs() < 2e-4, "{model:?} for {truth:?}");
            assert!(model.normal.dot(&normal) > 0.999, "{model:?} for {truth:?}");
        }
    }

    #[test]
    fn a_plane_that_has_moved_away_is_forgotten() {
        let truth = ContactModel { normal: Vector3::z(), offset: 0.0, stiffness: 300.0, damping: 1.0 };
        let mut estimator = ContactEstimator::new(&CouplingConfig::default());
        pressed(&truth, &mut estimator, 5.0);
        let known = *estimator.model().expect("a contact");
        let place = |depth: f64| Vector3::z() * (known.offset - depth);
        (0..100).for_each(|_| estimator.step(&place(0.003), &Vector3::zeros(), &Vector3::zeros(), STEP));
        assert!(estimator.model().is_some(), "it may be soft");
        (0..100).for_each(|_| estimator.step(&place(0.005), &Vector3::zeros(), &Vector3::zeros(), STEP));
        assert_eq!(estimator.model(), None);
    }

    #[test]
    fn an_acceleration_in_the_free_is_no_contact() {
        let mut estimator = ContactEstimator::new(&CouplingConfig::default());
        for ms in 0..5_000 {
            // A tool of 50 g shaken at 3 Hz, 6 mm: 0.1 N, and short blows of the link.
            let phase = f64::from(ms) * STEP * 19.0;
            let blow = if ms % 100 < 10 { 0.6 } else { 0.0 };
            let force = Vector3::x() * (0.05 * 0.006 * 361.0 * phase.sin() + blow);
            let velocity = Vector3::x() * (0.006 * 19.0 * phase.cos());
            estimator.step(&(Vector3::x() * (0.006 * phase.sin())), &velocity, &force, STEP);
        }
        assert_eq!(estimator.model(), None);
    }

    #[test]
    fn a_new_plane_never_pushes_suddenly() {
        let model = ContactModel { normal: Vector3::x(), offset: 0.0, stiffness: 500.0, damping: 1.0 };
        let mut contact = RenderedContact::new(&CouplingConfig::default());
        let inside = Vector3::x() * -0.01;
        let rest = Vector3::zeros();
        // It appears 10 mm over a hand at rest, and then stands 5 mm higher, and turns.
        let turned = ContactModel { offset: 0.005, normal: Vector3::new(1.0, 0.3, 0.0).normalize(), ..model };
        let mut last = Vector3::zeros();
        for known in [model, turned, ContactModel { stiffness: 900.0, ..turned }] {
            contact.receive(Some(&known));
            for ms in 0..2_000 {
                let force = contact.step(&inside, &rest, STEP);
                // 20 mm/s at 900 N/m, 15 mm at 500 N/m/s, and the turn, within a millisecond.
                assert!((force - last).norm() < 0.05, "{ms} ms: {force} after {last}");
                last = force;
            }
            let expected = known.stiffness * known.depth(&inside);
            assert!((last.norm() - expected).abs() < 0.05 * expected, "{last} for {known:?}");
        }
        // What is gone recedes likewise.
        contact.receive(None);
        for _ in 0..2_000 {
            let force = contact.step(&inside, &rest, STEP);
            assert!((force - last).norm() < 0.05 && force.norm() <= last.norm() + 1e-9, "{force} {last}");
            last = force;
        }
        assert_eq!((last.norm(), contact.shown()), (0.0, None));
    }

    #[test]
    fn a_model_out_of_its_limits_is_ignored() {
        let good = ContactModel { normal: Vector3::x(), offset: 0.0, stiffness: 500.0, damping: 1.0 };
        let mut contact = RenderedContact::new(&CouplingConfig::default());
        for bad in [
            ContactModel { stiffness: f64::NAN, ..good },
            ContactModel { stiffness: 1e9, ..good },
            ContactModel { normal: Vector3::x() * 2.0, ..good },
            ContactModel { offset: 1e3, ..good },
            ContactModel { damping: -1.0, ..good },
        ] {
            contact.receive(Some(&bad));
            contact.step(&Vector3::zeros(), &Vector3::zeros(), STEP);
            assert_eq!(contact.shown(), None, "{bad:?}");
        }
    }
}
