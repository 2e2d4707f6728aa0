//! Time-domain passivity of a coupling with delay: an observer and a controller of energy at each end.
//!
//! After Hannaford and Ryu, "Time-domain passivity control of haptic interfaces" (2002), and for two ends with a varying
//! delay Ryu, Artigas and Preusche (2010) and, with several axes, Panzirsch, Singh, Ryu and Ferre (2019). Position goes
//! from the master to the slave and force comes back; each end observes the energy at its own port, and what it puts out
//! is limited to what is in its [`EnergyTank`]:
//!
//! - at the master the force (impedance type): it is no greater than that of a spring of the device's greatest stiffness
//!   which stores the tank's level, and of a bearable damper against the hand's motion. The limit is smooth, where the
//!   controller of the first paper switches between two steps.
//! - at the slave the motion (admittance type): the commanded position moves towards the master's by as much as the tank
//!   pays for. Positions, not velocities, are sent, so that what was withheld is made up for when the tank allows it:
//!   there is no drift. Motion along a surface, which only accelerates the tool, is paid for first.
//!
//! A delayed contact has to be paid for before the hand has felt it. A damper at the master therefore fills both tanks
//! while they are low (the layer of Franken et al., 2011): a light drag in the first movements and after hard work.

use nalgebra::Vector3;

use super::energy_tank::EnergyTank;

/// Parameters of both ends of a coupling; both ends have the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CouplingConfig {
    /// Greatest stiffness that the master's device renders stably [N/m].
    pub stiffness_max: f64,
    /// Greatest damping that the master's device renders stably [N·s/m]: about 0.1 of its mass per step.
    pub damping_max: f64,
    /// Greatest force that the master's device may put on the hand \[N\].
    pub force_max: f64,
    /// Stiffness of the slave's coupling between the commanded position and its tool [N/m].
    pub coupling_stiffness: f64,
    /// Level below which the master fills its tank \[J\].
    pub fill_level: f64,
    /// Damping with which an empty tank is filled [N·s/m].
    pub fill_damping: f64,
    /// Largest speed of the slave's commanded position [m/s].
    pub speed_max: f64,
    /// Time constant of the remote force, as a share of the round trip. A hand softer than what it touches swings when
    /// the force comes late; a force that comes in slower than the delay lets it settle.
    pub force_lag: f64,
    /// Wave impedance [N·s/m], of the wave variables only.
    pub wave_impedance: f64,
}

impl Default for CouplingConfig {
    fn default() -> Self {
        Self {
            stiffness_max: 1_000.0,
            damping_max: 10.0,
            force_max: 20.0,
            coupling_stiffness: 1_000.0,
            fill_level: 0.04,
            fill_damping: 6.0,
            speed_max: 0.6,
            force_lag: 0.3,
            wave_impedance: 8.0,
        }
    }
}

/// Energy observer and passivity controller of the master's port.
#[derive(Clone, Debug)]
pub struct MasterPort {
    stiffness_max: f64,
    damping_max: f64,
    force_max: f64,
    tank: EnergyTank,
    position: Option<Vector3<f64>>,
    force: Vector3<f64>,
    energy: f64,
    energy_min: f64,
    withheld: f64,
}

impl MasterPort {
    /// A port without force.
    pub fn new(config: &CouplingConfig) -> Self {
        Self {
            stiffness_max: config.stiffness_max,
            damping_max: config.damping_max,
            force_max: config.force_max,
            tank: EnergyTank::default(),
            position: None,
            force: Vector3::zeros(),
            energy: 0.0,
            energy_min: 0.0,
            withheld: 0.0,
        }
    }

    /// Its tank.
    pub fn tank(&mut self) -> &mut EnergyTank {
        &mut self.tank
    }

    /// Energy in its tank \[J\].
    pub fn level(&self) -> f64 {
        self.tank.level()
    }

    /// The force that it holds on the hand \[N\].
    pub fn force(&self) -> &Vector3<f64> {
        &self.force
    }

    /// Position of the hand at the last step \[m\].
    pub fn position(&self) -> Option<&Vector3<f64>> {
        self.position.as_ref()
    }

    /// Net energy that the hand has put in, and its smallest value so far \[J\].
    pub fn energy(&self) -> (f64, f64) {
        (self.energy, self.energy_min)
    }

    /// Force withheld in the last step \[N\].
    pub fn withheld(&self) -> f64 {
        self.withheld
    }

    /// Adds the work of the force that was held since the last step: exact, since it was constant.
    pub fn observe(&mut self, position: &Vector3<f64>) {
        if let Some(last) = self.position.replace(*position) {
            let work = -self.force.dot(&(position - last));
            self.tank.put(work);
            self.energy += work;
            self.energy_min = self.energy_min.min(self.energy);
        }
    }

    /// Holds the part of a wanted force that the tank covers \[N\], at a hand of this velocity [m/s].
    pub fn hold(&mut self, wanted: &Vector3<f64>, velocity: &Vector3<f64>, step_secs: f64) -> Vector3<f64> {
        let size = wanted.norm();
        if !(size.is_finite() && size > 0.0) {
            self.force = Vector3::zeros();
            self.withheld = 0.0;
            return self.force;
        }
        let level = self.tank.level().max(0.0);
        let speed_along = wanted.dot(velocity) / size;
        let spring = (2.0 * self.stiffness_max * level).sqrt();
        let mut most = spring;
        if speed_along > 0.0 {
            // The hand moves on for a step, whatever happens.
            most = most.min(level / (speed_along * step_secs));
        } else {
            most += self.damping_max * -speed_along;
        }
        let most = most.min(self.force_max);
        self.force = wanted * (most / size).min(1.0);
        self.withheld = (size - most).max(0.0);
        self.force
    }
}

/// Energy observer and passivity controller of the slave's port: its commanded position.
#[derive(Clone, Debug)]
pub struct SlavePort {
    coupling_stiffness: f64,
    speed_max: f64,
    tank: EnergyTank,
    command: Option<Vector3<f64>>,
    /// Target after the first of two equal lags.
    followed: Vector3<f64>,
    /// Force on the port before this step's motion.
    force: Vector3<f64>,
    withheld: f64,
}

/// Time constant of each of the two lags with which the command follows the master's position \[s\]: they smooth the steps
/// that jitter and loss leave, which would cost energy in the coupling.
const FOLLOW_SECS: f64 = 0.005;
/// Energy kept for motion along a surface when motion into it is withheld \[J\].
const SLIDE_RESERVE: f64 = 2e-4;
/// Force \[N\] below which nothing is stored at the slave.
const CONTACT_FORCE: f64 = 0.05;

impl SlavePort {
    /// A port that takes the first position that it is told.
    pub fn new(config: &CouplingConfig) -> Self {
        Self {
            coupling_stiffness: config.coupling_stiffness,
            speed_max: config.speed_max,
            tank: EnergyTank::default(),
            command: None,
            followed: Vector3::zeros(),
            force: Vector3::zeros(),
            withheld: 0.0,
        }
    }

    /// Its tank.
    pub fn tank(&mut self) -> &mut EnergyTank {
        &mut self.tank
    }

    /// Energy in its tank \[J\].
    pub fn level(&self) -> f64 {
        self.tank.level()
    }

    /// Commanded position \[m\], once there is one.
    pub fn command(&self) -> Option<&Vector3<f64>> {
        self.command.as_ref()
    }

    /// Motion withheld in the last step \[m\].
    pub fn withheld(&self) -> f64 {
        self.withheld
    }

    /// Takes the force that the coupling puts on the port under the last command \[N\], as a hand there would feel it.
    pub fn observe(&mut self, force: &Vector3<f64>) {
        self.force = *force;
    }

    /// The step's motion from the command towards `target`, limited in speed \[m\]; the first target is taken as it is.
    pub fn towards(&mut self, target: &Vector3<f64>, step_secs: f64) -> Vector3<f64> {
        let part = (step_secs / FOLLOW_SECS).min(1.0);
        let command = *self.command.get_or_insert_with(|| {
            self.followed = *target;
            *target
        });
        self.followed += (target - self.followed) * part;
        let motion = (self.followed - command) * part;
        self.within_speed(motion, step_secs)
    }

    /// A motion limited to the largest speed \[m\].
    pub fn within_speed(&self, motion: Vector3<f64>, step_secs: f64) -> Vector3<f64> {
        let (length, most) = (motion.norm(), self.speed_max * step_secs);
        if length > most { motion * (most / length) } else { motion }
    }

    /// Moves the command by as much of `motion` as the tank covers.
    pub fn advance(&mut self, motion: &Vector3<f64>) {
        let size = self.force.norm();
        let normal = if size > CONTACT_FORCE { self.force / size } else { Vector3::zeros() };
        let across = normal * normal.dot(motion);
        let along = motion - across;
        let budget = self.tank.level();
        let along = along * self.share(&along, budget);
        let left = budget - self.cost(&along).max(0.0) - SLIDE_RESERVE;
        let across = across * self.share(&across, left);
        self.move_by(along + across);
        self.withheld = (motion - along - across).norm();
    }

    /// Moves the command whatever the tank covers; the debt is forgiven as soon as nothing is touched.
    pub fn advance_on_credit(&mut self, motion: &Vector3<f64>) {
        self.move_by(*motion);
        self.withheld = 0.0;
        if self.force.norm() < CONTACT_FORCE {
            self.tank.forgive();
        }
    }

    /// Moves the command by what has been paid for already.
    pub fn advance_delivered(&mut self, motion: &Vector3<f64>) {
        self.move_by(*motion);
    }

    fn move_by(&mut self, motion: Vector3<f64>) {
        if let Some(command) = &mut self.command {
            *command += motion;
            self.tank.put(-self.cost(&motion));
        }
    }

    /// Energy that a motion puts out \[J\]: against the force, and against its growth with the coupling's spring. The
    /// command moves at once at the beginning of a step, so this is exact; the force before and after the step alone would
    /// miss the growth, and show energy where there is none.
    fn cost(&self, motion: &Vector3<f64>) -> f64 {
        0.5 * self.coupling_stiffness * motion.norm_squared() - self.force.dot(motion)
    }

    /// The largest share of a motion, 0 to 1, that costs no more than `budget`.
    fn share(&self, motion: &Vector3<f64>, budget: f64) -> f64 {
        let growth = self.coupling_stiffness * motion.norm_squared();
        let along = self.force.dot(motion);
        if growth <= 0.0 || 0.5 * growth - along <= budget {
            return 1.0;
        }
        let root = along * along + 2.0 * growth * budget;
        // With a debt, only what takes energy in: as far as it takes the most.
        let share =
            if root >= 0.0 && budget >= 0.0 { (along + root.sqrt()) / growth } else { along / growth };
        share.clamp(0.0, 1.0)
    }
}

/// Force of the other end as it is held here: it comes in with a lag, and goes at once.
#[derive(Clone, Debug, Default)]
pub struct RemoteForce {
    force: Vector3<f64>,
}

/// Shortest lag of a remote force \[s\].
const LAG_MIN_SECS: f64 = 0.002;

impl RemoteForce {
    /// Takes a step towards the newest force that has arrived.
    pub fn step(&mut self, newest: &Vector3<f64>, lag_secs: f64, step_secs: f64) -> &Vector3<f64> {
        let grows = newest.norm_squared() > self.force.norm_squared();
        let lag = if grows { lag_secs.max(LAG_MIN_SECS) } else { LAG_MIN_SECS };
        self.force += (newest - self.force) * (step_secs / lag).min(1.0);
        &self.force
    }
}

/// Force of the damper that fills a low tank \[N\].
pub fn filling_force(config: &CouplingConfig, level: f64, velocity: &Vector3<f64>) -> Vector3<f64> {
    let missing = (1.0 - level / config.fill_level.max(1e-9)).clamp(0.0, 1.0);
    velocity * (-config.fill_damping * missing)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compensation::CAPITAL;

    const STEP: f64 = 1e-3;

    #[test]
    fn a_force_that_pushes_the_hand_gives_no_more_than_is_in_the_tank() {
        let mut port = MasterPort::new(&CouplingConfig::default());
        port.tank().put(0.005);
        let had = port.level();
        // The hand runs away from the force, ever faster.
        for ms in 0..2_000 {
            let time = f64::from(ms) * STEP;
            port.observe(&(Vector3::x() * (0.5 * time * time)));
            port.hold(&(Vector3::x() * 5.0), &(Vector3::x() * time), STEP);
        }
        let (energy, energy_min) = port.energy();
        assert!(energy_min >= -had - 1e-5 && energy == energy_min, "{energy_min} of {had}");
        assert!(energy < -0.9 * had, "what was there was given: {energy}");
        assert!(port.withheld() > 4.9);
    }

    #[test]
    fn a_wall_within_the_devices_stiffness_is_rendered_in_full_from_an_empty_tank() {
        let mut port = MasterPort::new(&CouplingConfig::default());
        port.tank().put(-CAPITAL);
        for ms in 0..2_000 {
            let phase = f64::from(ms) * STEP * 6.0;
            let (depth, speed) = (0.004 * (1.0 - phase.cos()), 0.004 * 6.0 * phase.sin());
            port.observe(&(Vector3::x() * -depth));
            let wanted = Vector3::x() * (600.0 * depth + 3.0 * speed).max(0.0);
            let force = port.hold(&wanted, &(Vector3::x() * -speed), STEP);
            assert!((force - wanted).norm() < 0.05 + 0.02 * wanted.norm(), "{ms} ms: {force} of {wanted}");
        }
        assert!(port.energy().1 > -1e-4, "{:?}", port.energy());
    }

    /// A wall of this stiffness at 0 that is felt through the command itself.
    fn felt(command: f64) -> Vector3<f64> {
        Vector3::x() * (500.0 * -command.min(0.0))
    }

    #[test]
    fn the_command_goes_into_a_wall_as_deep_as_is_paid_for_and_comes_back_whole() {
        let config = CouplingConfig { coupling_stiffness: 500.0, ..CouplingConfig::default() };
        let mut port = SlavePort::new(&config);
        port.towards(&Vector3::zeros(), STEP);
        let level = port.level();
        port.tank().put(0.003 - level);
        let mut side = 0.0;
        let mut go = |port: &mut SlavePort, to: f64| {
            for _ in 0..2_000 {
                let command = port.command().unwrap().x;
                port.observe(&felt(command));
                side = f64::min(side + 1e-5, 0.02);
                let motion = port.towards(&Vector3::new(to, side, 0.0), STEP);
                port.advance(&motion);
            }
        };
        go(&mut port, -0.02);
        let command = *port.command().unwrap();
        let stored = 0.5 * 500.0 * command.x * command.x;
        assert!(stored <= 0.003 && stored > 0.002, "{stored} at {command}");
        assert!(port.withheld() > 0.0 && port.level() < 2.1e-4, "{}", port.level());
        assert!((command.y - 0.02).abs() < 5e-4, "it goes along the surface all the same: {command}");
        // Paid for, it goes on by itself: nothing is lost but time.
        port.tank().put(0.2);
        go(&mut port, -0.02);
        assert!((port.command().unwrap().x + 0.02).abs() < 1e-4, "{:?}", port.command());
        let before = port.level();
        go(&mut port, 0.0);
        assert!(port.level() <= before + 0.1 + 1e-9 && port.level() > before.min(0.09), "{}", port.level());
    }

    #[test]
    fn a_debt_is_paid_by_what_comes_back_and_forgiven_in_the_free() {
        let config = CouplingConfig { coupling_stiffness: 500.0, ..CouplingConfig::default() };
        let mut port = SlavePort::new(&config);
        port.towards(&Vector3::zeros(), STEP);
        let level = port.level();
        port.tank().put(-level);
        let go = |port: &mut SlavePort, to: f64| {
            for _ in 0..500 {
                let command = port.command().unwrap().x;
                port.observe(&felt(command));
                let motion = port.towards(&(Vector3::x() * to), STEP);
                port.advance_on_credit(&motion);
            }
        };
        go(&mut port, -0.01);
        assert!((port.level() + 0.025).abs() < 1e-3, "{}", port.level());
        go(&mut port, -0.005);
        assert!((port.level() + 0.00625).abs() < 1e-3, "{}", port.level());
        go(&mut port, 0.01);
        assert!((0.0..1e-3).contains(&port.level()), "{}", port.level());
    }

    #[test]
    fn a_jump_of_the_master_by_a_metre_is_followed_at_the_limited_speed() {
        let mut port = SlavePort::new(&CouplingConfig::default());
        port.towards(&Vector3::zeros(), STEP);
        let motion = port.towards(&Vector3::x(), STEP);
        assert!(motion.norm() <= 0.6 * STEP + 1e-12, "{motion}");
    }
}
