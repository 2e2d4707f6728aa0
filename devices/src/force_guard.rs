//! Force guard: limits every wrench before the passivity controller and the motors, by fade, ramp, damping, clamp and
//! slew limit.
//!
//! The age limits are fixed, because safety relies on them: a force that is not renewed fades from 5 ms and is zero at
//! 20 ms. The fade is linear, so that the support of a leaning hand decreases gradually. The viscous damping dissipates
//! the energy that a sampled virtual wall generates: a wall of stiffness K held over a period T is passive when
//! b > K·T/2 + |B| (Colgate and Schenkel, "Passivity of a class of sampled-data systems", 1997). Its force is capped, so that it
//!   never dominates the rendered force.

use nalgebra::Vector3;

use crate::device::{Capabilities, Dofs, Wrench};

/// Age of a force \[ns\] from which it fades.
pub const DECAY_START_NS: u64 = 5_000_000;
/// Age of a force \[ns\] at which it is zero.
pub const DECAY_END_NS: u64 = 20_000_000;

/// Longest step \[ns\] counted for the slew limit, so that a late driver gets no larger jump.
pub(crate) const SLEW_STEP_MAX_NS: u64 = 2_000_000;

/// Parameters of a [`ForceGuard`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuardConfig {
    /// Fastest growth and rotation of the force [N/s]; it may decrease at once. The default, 2,000 N/s, is a wall of
    /// 2,000 N/m met at 1 m/s.
    pub slew_force: f64,
    /// Fastest growth and turning of the torque [N·m/s].
    pub slew_torque: f64,
    /// Time over which force ramps up from zero after a start, a restart or an interruption \[ns\].
    pub ramp_ns: u64,
    /// Viscous damping against the measured velocity [N·s/m].
    pub damping: f64,
    /// Greatest force of that damping \[N\].
    pub damping_force_max: f64,
}

impl Default for GuardConfig {
    fn default() -> Self {
        Self {
            slew_force: 2_000.0,
            slew_torque: 25.0,
            ramp_ns: 50_000_000,
            damping: 0.2,
            damping_force_max: 0.5,
        }
    }
}

/// Input of the guard in one step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Request {
    /// The wrench commanded by the controller.
    pub wrench: Wrench,
    /// Time since the controller computed it \[ns\].
    pub command_age_ns: u64,
    /// Time since the device last gave a valid reading \[ns\].
    pub reading_age_ns: u64,
    /// Predicted time for which this step's wrench will be held \[ns\].
    pub hold_ns: u64,
    /// Measured velocity of the handle [m/s].
    pub linear_velocity: Vector3<f64>,
}

/// Limits the wrenches of one device; time is passed in, it reads no clock.
#[derive(Clone, Debug)]
pub struct ForceGuard {
    config: GuardConfig,
    max_force: f64,
    max_torque: f64,
    applied: Wrench,
    last_step_ns: Option<u64>,
    ramp_since_ns: Option<u64>,
    clamped: u64,
    slew_limited: u64,
    ramps: u64,
}

impl ForceGuard {
    /// Guard for a device with these limits. A negative or NaN limit or rate counts as zero.
    pub fn new(config: GuardConfig, capabilities: &Capabilities) -> Self {
        let torque_driven = capabilities.output_dofs == Dofs::Six;
        Self {
            config: GuardConfig {
                slew_force: at_least_zero(config.slew_force),
                slew_torque: at_least_zero(config.slew_torque),
                damping: at_least_zero(config.damping),
                damping_force_max: at_least_zero(config.damping_force_max),
                ..config
            },
            max_force: at_least_zero(capabilities.max_force_newtons),
            max_torque: if torque_driven { at_least_zero(capabilities.max_torque) } else { 0.0 },
            applied: Wrench::ZERO,
            last_step_ns: None,
            ramp_since_ns: None,
            clamped: 0,
            slew_limited: 0,
            ramps: 0,
        }
    }

    /// The wrench of the last step.
    pub fn applied(&self) -> &Wrench {
        &self.applied
    }

    /// Number of steps in which the commanded wrench exceeded the device's limits.
    pub fn clamped(&self) -> u64 {
        self.clamped
    }

    /// Number of steps in which the slew limit acted.
    pub fn slew_limited(&self) -> u64 {
        self.slew_limited
    }

    /// Number of ramps.
    pub fn ramps(&self) -> u64 {
        self.ramps
    }

    /// Continues from `applied` at `now_ns`, with the ramp completed.
    pub(crate) fn resume(&mut self, now_ns: u64, applied: &Wrench) {
        self.applied = Wrench {
            force: clamp_norm(applied.force, self.max_force),
            torque: clamp_norm(applied.torque, self.max_torque),
        };
        self.last_step_ns = Some(now_ns);
        self.ramp_since_ns = Some(now_ns.saturating_sub(self.config.ramp_ns));
    }

    /// Restarts the ramp from zero at the next step.
    pub(crate) fn restart_ramp(&mut self) {
        self.ramp_since_ns = None;
    }

    /// Scales the last step's wrench by `share`, at most 1.
    pub(crate) fn shorten(&mut self, share: f64) -> Wrench {
        if share < 1.0 {
            self.applied = self.applied * share.max(0.0);
        }
        self.applied
    }

    /// One step with zero force, at once regardless of the slew limit, and with a ramp afterwards.
    pub(crate) fn release(&mut self, now_ns: u64) -> Wrench {
        self.last_step_ns = Some(now_ns);
        self.ramp_since_ns = None;
        self.applied = Wrench::ZERO;
        self.applied
    }

    /// One step: the wrench that may be rendered.
    pub(crate) fn step(&mut self, now_ns: u64, request: &Request) -> Wrench {
        let fade = fade(request.command_age_ns) * fade(request.reading_age_ns);
        // The motors hold it until the next step, by which time it would be too old.
        let held_until = request.command_age_ns.max(request.reading_age_ns).saturating_add(request.hold_ns);
        if fade <= 0.0 || held_until > DECAY_END_NS || !request.wrench.is_finite() {
            return self.release(now_ns);
        }
        let elapsed = self.last_step_ns.map_or(0, |last| now_ns.saturating_sub(last)).min(SLEW_STEP_MAX_NS);
        self.last_step_ns = Some(now_ns);
        let ramp_since = *self.ramp_since_ns.get_or_insert_with(|| {
            self.ramps += 1;
            now_ns
        });
        let ramp_age = now_ns.saturating_sub(ramp_since);
        let ramp =
            if ramp_age >= self.config.ramp_ns { 1.0 } else { ramp_age as f64 / self.config.ramp_ns as f64 };
        let gain = fade * ramp;

        let damping =
            clamp_norm(-self.config.damping * request.linear_velocity, self.config.damping_force_max);
        let limited_force = clamp_norm(request.wrench.force, self.max_force);
        let limited_torque = clamp_norm(request.wrench.torque, self.max_torque);
        if limited_force != request.wrench.force
            || (self.max_torque > 0.0 && limited_torque != request.wrench.torque)
        {
            self.clamped += 1;
        }
        let wanted_force = gain * clamp_norm(limited_force + damping, self.max_force);
        let wanted_torque = gain * limited_torque;

        let seconds = elapsed as f64 * 1e-9;
        let force = approach(self.applied.force, wanted_force, self.config.slew_force * seconds);
        let torque = approach(self.applied.torque, wanted_torque, self.config.slew_torque * seconds);
        if force != wanted_force || torque != wanted_torque {
            self.slew_limited += 1;
        }
        // Rounding in `approach` could exceed the limit by one bit; the guarantee is exact.
        self.applied =
            Wrench { force: clamp_norm(force, self.max_force), torque: clamp_norm(torque, self.max_torque) };
        self.applied
    }
}

/// 1 up to [`DECAY_START_NS`], 0 from [`DECAY_END_NS`], linear between.
fn fade(age_ns: u64) -> f64 {
    let left = DECAY_END_NS.saturating_sub(age_ns) as f64 / (DECAY_END_NS - DECAY_START_NS) as f64;
    left.min(1.0)
}

/// Shortens a vector to a norm of at most `limit`, exactly; keeps its direction.
fn clamp_norm(vector: Vector3<f64>, limit: f64) -> Vector3<f64> {
    let norm = vector.norm();
    if norm <= limit {
        return vector;
    }
    if limit <= 0.0 {
        return Vector3::zeros();
    }
    // Divide by the largest component first: the norm of a huge vector overflows.
    let unit = (vector / vector.amax()).normalize();
    unit * (limit * (1.0 - 4.0 * f64::EPSILON))
}

/// Shortens `from` optimally, then moves it towards `to` by at most `step`: a decrease needs no limit.
fn approach(from: Vector3<f64>, to: Vector3<f64>, step: f64) -> Vector3<f64> {
    let length_squared = from.norm_squared();
    let kept = if length_squared > 0.0 { (from.dot(&to) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
    let from = from * kept;
    let change = to - from;
    let distance = change.norm();
    if distance <= step { to } else { from + change * (step / distance) }
}

fn at_least_zero(value: f64) -> f64 {
    if value.is_finite() { value.max(0.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Workspace;

    const MS: u64 = 1_000_000;

    fn capabilities(output_dofs: Dofs) -> Capabilities {
        Capabilities {
            name: "bench".into(),
            workspace: Workspace::centred(Vector3::repeat(0.1)),
            max_force_newtons: 3.3,
            max_torque: 0.2,
            max_stiffness: 1000.0,
            input_dofs: Dofs::Six,
            output_dofs,
            apparent_mass: 0.05,
        }
    }

    fn request(force_x: f64) -> Request {
        Request {
            wrench: Wrench::from_force(Vector3::new(force_x, 0.0, 0.0)),
            command_age_ns: 0,
            reading_age_ns: 0,
            hold_ns: 0,
            linear_velocity: Vector3::zeros(),
        }
    }

    fn ramped_in(config: GuardConfig, output_dofs: Dofs, force_x: f64) -> (ForceGuard, u64) {
        let mut guard = ForceGuard::new(config, &capabilities(output_dofs));
        for ms in 0..=100 {
            guard.step(ms * MS, &request(force_x));
        }
        (guard, 100 * MS)
    }

    #[test]
    fn fade_is_one_until_5_ms_and_zero_from_20_ms() {
        assert_eq!(fade(0), 1.0);
        assert_eq!(fade(5 * MS), 1.0);
        assert!(fade(5 * MS + 1) < 1.0);
        assert!((fade(12_500_000) - 0.5).abs() < 1e-12);
        assert!(fade(20 * MS - 1) > 0.0);
        assert_eq!(fade(20 * MS), 0.0);
        assert_eq!(fade(u64::MAX), 0.0);
    }

    #[test]
    fn clamp_never_exceeds_its_limit_by_a_bit() {
        let mut x = 0.37_f64;
        for _ in 0..10_000 {
            x = (x * 3.9) * (1.0 - x);
            let v = Vector3::new(x, 1.0 - x, x * x) * 1e3;
            assert!(clamp_norm(v, 3.3).norm() <= 3.3);
            assert!(clamp_norm(v, 3.3).norm() > 3.3 - 1e-12);
        }
        let huge = clamp_norm(Vector3::new(1e308, -1e308, 1e308), 3.3);
        assert!((huge.norm() - 3.3).abs() < 1e-12 && huge.y < 0.0);
        assert_eq!(clamp_norm(Vector3::x(), 0.0), Vector3::zeros());
    }

    #[test]
    fn force_ramps_in_linearly_over_50_ms() {
        let mut guard = ForceGuard::new(GuardConfig::default(), &capabilities(Dofs::Three));
        for ms in 0..=60_u64 {
            let applied = guard.step(ms * MS, &request(2.0)).force.x;
            let expected = 2.0 * (ms as f64 / 50.0).min(1.0);
            assert!((applied - expected).abs() < 1e-12, "{ms} ms: {applied} instead of {expected}");
        }
    }

    #[test]
    fn slew_limit_bounds_growth_even_after_a_late_step_and_lets_go_at_once() {
        let config = GuardConfig { slew_force: 500.0, ..GuardConfig::default() };
        let (mut guard, mut now) = ramped_in(config, Dofs::Three, 0.0);
        now += MS;
        assert!((guard.step(now, &request(3.0)).force.x - 0.5).abs() < 1e-12);
        now += 40 * MS;
        assert!((guard.step(now, &request(3.0)).force.x - 1.5).abs() < 1e-12);
        assert_eq!(guard.slew_limited(), 2);
        now += MS;
        assert!((guard.step(now, &request(1.0)).force.x - 1.0).abs() < 1e-12, "letting go needs no time");
        now += 2 * MS;
        assert!((guard.step(now, &request(-3.0)).force.x + 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_force_that_turns_keeps_what_points_the_same_way() {
        let from = Vector3::new(2.0, 0.0, 0.0);
        let turned = approach(from, Vector3::new(1.0, 3.0, 0.0), 0.5);
        assert!((turned - Vector3::new(1.0, 0.5, 0.0)).norm() < 1e-12, "{turned:?}");
        let grown = approach(from, Vector3::new(3.0, 0.0, 0.0), 0.5);
        assert!((grown - Vector3::new(2.5, 0.0, 0.0)).norm() < 1e-12, "{grown:?}");
    }

    #[test]
    fn torque_needs_six_outputs_and_is_clamped() {
        let twist =
            Request { wrench: Wrench { force: Vector3::zeros(), torque: Vector3::z() }, ..request(0.0) };
        for (dofs, expected) in [(Dofs::Three, 0.0), (Dofs::Six, 0.2)] {
            let (mut guard, mut now) = ramped_in(GuardConfig::default(), dofs, 0.0);
            for _ in 0..50 {
                now += MS;
                guard.step(now, &twist);
            }
            assert!((guard.applied().torque.z - expected).abs() < 1e-12);
            assert!(guard.applied().torque.norm() <= 0.2);
        }
    }

    #[test]
    fn damping_opposes_motion_and_is_capped() {
        let (mut guard, now) = ramped_in(GuardConfig::default(), Dofs::Three, 0.0);
        let moving = |x| Request { linear_velocity: Vector3::new(x, 0.0, 0.0), ..request(0.0) };
        assert!((guard.step(now + MS, &moving(0.5)).force.x + 0.1).abs() < 1e-12);
        assert!((guard.step(now + 2 * MS, &moving(50.0)).force.x + 0.5).abs() < 1e-12);
        let with_force = Request { wrench: Wrench::from_force(Vector3::new(-3.3, 0.0, 0.0)), ..moving(50.0) };
        for step in 3..40 {
            assert!(guard.step(now + step * MS, &with_force).force.norm() <= 3.3);
        }
    }

    #[test]
    fn a_guard_of_senseless_limits_renders_nothing() {
        let bad = Capabilities { max_force_newtons: f64::NAN, ..capabilities(Dofs::Three) };
        let mut guard =
            ForceGuard::new(GuardConfig { slew_force: f64::INFINITY, ..GuardConfig::default() }, &bad);
        for ms in 0..100 {
            assert_eq!(guard.step(ms * MS, &request(1.0)), Wrench::ZERO);
        }
    }
}
