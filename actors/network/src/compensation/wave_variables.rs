//! Wave variables, with a passive reconstruction from what arrives and a position channel against drift.
//!
//! Niemeyer and Slotine, "Stable adaptive teleoperation" (1991) and "Telemanipulation with time delays" (2004). With the
//! wave impedance `b`, velocity `v` and resisting force `f` are sent as the waves
//!
//! ```text
//! u = (b·v + f) / √2b      from the master,      w = (b·v − f) / √2b      from the slave,
//! ```
//!
//! so that the power at a port is `½u² − ½w²`: a constant delay only stores energy. A varying delay or a loss creates or
//! destroys parts of a wave. Not the wave is sent, therefore, but its integral and the integral of its energy, as whole
//! numbers (Niemeyer and Slotine, "Using wave variables for system analysis and robot control", 1998; Chopra, Berestesky
//! and Spong, "Bilateral teleoperation over unreliable communication networks", 2008): a receiver puts out what is missing
//! of the integral, no faster than the energy received allows. By the Cauchy-Schwarz inequality a wave averaged over a gap
//! needs no more energy than the wave that was lost in it. So a loss neither creates energy nor leaves an offset.
//!
//! The slave's end is matched to the line with a damper of `b`, so that in the free nothing is reflected. The line itself
//! is a spring of `b / T` for a delay `T` one way, in series with what is touched: at 100 ms round trip and `b` = 8 N·s/m
//! only 160 N/m. The energy that the matching damper takes pays for a correction of the slave's position towards the
//! master's (Niemeyer and Slotine, 2004), which removes that compliance at rest. What remains is the drag of `b` in the
//! free, which the other methods do not have.

use nalgebra::Vector3;

use super::passivity::{CouplingConfig, MasterPort, SlavePort};

/// Units of a wave's integral in one √W·s: half of one is 0.03 µm of a hand's motion.
const INTEGRAL_UNITS: f64 = 16_777_216.0;
/// Nanojoules per joule.
const NANO: f64 = 1e9;
/// Shortest time constant with which a wave is put out \[s\]: it spreads what jitter bunches.
const SPREAD_SECS: f64 = 0.004;
/// Most energy that a receiver keeps of waves \[J\]; it bounds how suddenly a long gap is made up for.
const RESERVE_MAX: f64 = 0.05;
/// Largest wave that is sent, by component [√W]: 10 N at any sensible impedance.
const WAVE_MAX: f64 = 20.0;
/// Time constant of the correction of the slave's position \[s\].
const CORRECTION_SECS: f64 = 0.1;

/// Integrals of a wave, as sent: wrapping, since only differences count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WaveIntegrals {
    /// Integral of the wave, in units of 2⁻²⁴ √W·s by axis; wraps around.
    pub wave: [i32; 3],
    /// Integral of its energy \[nJ\]; never decreases.
    pub energy_nj: u64,
}

/// Sender of a wave.
#[derive(Clone, Debug, Default)]
pub struct WaveSender {
    integrals: WaveIntegrals,
    /// Fractions of a unit by axis, and of a nanojoule, that the integrals do not show yet.
    rest: Vector3<f64>,
    rest_nj: f64,
}

impl WaveSender {
    /// Adds a step of a wave [√W].
    pub fn step(&mut self, wave: &Vector3<f64>, step_secs: f64) {
        for axis in 0..3 {
            let part = if wave[axis].is_finite() { wave[axis].clamp(-WAVE_MAX, WAVE_MAX) } else { 0.0 };
            let units = part * step_secs * INTEGRAL_UNITS + self.rest[axis];
            let whole = units.round();
            self.rest[axis] = units - whole;
            self.integrals.wave[axis] = self.integrals.wave[axis].wrapping_add(whole as i32);
            self.rest_nj += 0.5 * part * part * step_secs * NANO;
        }
        let whole = self.rest_nj.floor();
        self.rest_nj -= whole;
        self.integrals.energy_nj = self.integrals.energy_nj.saturating_add(whole as u64);
    }

    /// What is sent.
    pub fn integrals(&self) -> &WaveIntegrals {
        &self.integrals
    }
}

/// Receiver of a wave: puts out what has arrived of its integral, within the energy that has arrived.
#[derive(Clone, Debug, Default)]
pub struct WaveReceiver {
    last: WaveIntegrals,
    missing: Vector3<f64>,
    reserve: f64,
}

impl WaveReceiver {
    /// Takes integrals, newer than those before: the order is the datagram channel's to keep.
    pub fn receive(&mut self, sent: &WaveIntegrals) {
        if sent.energy_nj < self.last.energy_nj {
            return;
        }
        for axis in 0..3 {
            let units = sent.wave[axis].wrapping_sub(self.last.wave[axis]);
            self.missing[axis] += f64::from(units) / INTEGRAL_UNITS;
        }
        self.reserve = (self.reserve + (sent.energy_nj - self.last.energy_nj) as f64 / NANO).min(RESERVE_MAX);
        self.last = *sent;
    }

    /// Drops what has arrived and was not put out.
    pub fn drop_missing(&mut self) {
        (self.missing, self.reserve) = (Vector3::zeros(), 0.0);
    }

    /// The wave of the next step [√W]: the constant one that makes up for what is missing with the energy there is.
    pub fn step(&mut self, step_secs: f64) -> Vector3<f64> {
        let missing = self.missing.norm_squared();
        if missing <= 0.0 || self.reserve <= 0.0 {
            return Vector3::zeros();
        }
        let rate = (1.0 / SPREAD_SECS.max(step_secs)).min(2.0 * self.reserve / missing);
        let mut wave = self.missing * rate;
        let (energy, most) = (0.5 * wave.norm_squared() * step_secs, self.reserve);
        if energy > most {
            wave *= (most / energy).sqrt();
        }
        self.missing -= wave * step_secs;
        self.reserve = (self.reserve - 0.5 * wave.norm_squared() * step_secs).max(0.0);
        wave
    }
}

/// Master's end: turns the incoming wave into a force.
#[derive(Clone, Debug)]
pub struct WaveMaster {
    impedance: f64,
    sender: WaveSender,
    receiver: WaveReceiver,
    /// Incoming wave of this step.
    incoming: Vector3<f64>,
}

impl WaveMaster {
    /// An end at rest.
    pub fn new(config: &CouplingConfig) -> Self {
        Self {
            impedance: config.wave_impedance,
            sender: WaveSender::default(),
            receiver: WaveReceiver::default(),
            incoming: Vector3::zeros(),
        }
    }

    /// Takes integrals of the slave's wave.
    pub fn receive(&mut self, sent: &WaveIntegrals) {
        self.receiver.receive(sent);
    }

    /// The force on the hand that the incoming wave asks for \[N\].
    pub fn force(&mut self, velocity: &Vector3<f64>, step_secs: f64) -> Vector3<f64> {
        self.incoming = self.receiver.step(step_secs);
        self.incoming * (2.0 * self.impedance).sqrt() - velocity * self.impedance
    }

    /// Sends the wave that goes with the force that the hand really gets.
    pub fn send(&mut self, port: &MasterPort, velocity: &Vector3<f64>, step_secs: f64) -> &WaveIntegrals {
        let wave = (velocity * self.impedance - port.force()) / (2.0 * self.impedance).sqrt();
        self.sender.step(&wave, step_secs);
        self.sender.integrals()
    }
}

/// Slave's end: turns the incoming wave into a motion.
#[derive(Clone, Debug)]
pub struct WaveSlave {
    impedance: f64,
    sender: WaveSender,
    receiver: WaveReceiver,
}

impl WaveSlave {
    /// An end at rest.
    pub fn new(config: &CouplingConfig) -> Self {
        Self {
            impedance: config.wave_impedance,
            sender: WaveSender::default(),
            receiver: WaveReceiver::default(),
        }
    }

    /// Takes integrals of the master's wave.
    pub fn receive(&mut self, sent: &WaveIntegrals) {
        self.receiver.receive(sent);
    }

    /// Drops the waves that have come: the slave stands, and moves from there. Its own wave is none meanwhile, as of an end
    /// that takes all that comes.
    pub fn rest(&mut self) -> &WaveIntegrals {
        self.receiver.drop_missing();
        self.sender.integrals()
    }

    /// Moves the port's command by the wave, and by as much of the correction towards `target` as is paid for. `force` is
    /// what the coupling puts on the port \[N\], as a hand there would feel it.
    pub fn step(
        &mut self,
        port: &mut SlavePort,
        target: &Vector3<f64>,
        force: &Vector3<f64>,
        step_secs: f64,
    ) -> &WaveIntegrals {
        let root = (2.0 * self.impedance).sqrt();
        let incoming = self.receiver.step(step_secs);
        // Line, matching damper and coupling in balance: root·u = b·v + b·v − force.
        let by_wave = (incoming * root + force) * (step_secs / (2.0 * self.impedance));
        let by_wave = port.within_speed(by_wave, step_secs);
        // The wave that goes back is that of the velocity which is really commanded.
        let outgoing = by_wave * (root / step_secs) - incoming;
        self.sender.step(&outgoing, step_secs);
        // What the line delivers pays for the wave's motion; the rest is what the damper took, and is never negative.
        port.tank().put(0.5 * (incoming.norm_squared() - outgoing.norm_squared()) * step_secs);
        port.towards(target, step_secs);
        let command = *port.command().unwrap_or(target);
        let correction = (target - command) * (step_secs / CORRECTION_SECS).min(1.0);
        let correction = port.within_speed(by_wave + correction, step_secs) - by_wave;
        port.advance_delivered(&by_wave);
        port.advance(&correction);
        self.sender.integrals()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::random::SplitMix64;

    const STEP: f64 = 1e-3;

    #[test]
    fn lost_and_late_waves_give_no_energy_and_leave_no_offset() {
        let mut random = SplitMix64::new(3);
        let (mut sender, mut receiver) = (WaveSender::default(), WaveReceiver::default());
        let (mut sent, mut came) = (Vector3::zeros(), Vector3::zeros());
        let (mut put_in, mut put_out) = (0.0, 0.0);
        for ms in 0..20_000 {
            let phase = f64::from(ms) * STEP * 9.0;
            // A wave that ends: then all of it comes.
            let wave =
                Vector3::new(phase.sin(), 0.3 * phase.cos(), -0.2) * if ms < 15_000 { 1.0 } else { 0.0 };
            sender.step(&wave, STEP);
            sent += wave * STEP;
            put_in += 0.5 * wave.norm_squared() * STEP;
            // Eight of ten are lost, and an old one comes now and then.
            if random.below(10) < 2 {
                receiver.receive(sender.integrals());
            }
            if random.below(10) == 0 {
                receiver.receive(&WaveIntegrals::default());
            }
            let out = receiver.step(STEP);
            came += out * STEP;
            put_out += 0.5 * out.norm_squared() * STEP;
            assert!(put_out <= put_in + 1e-9, "{ms} ms: {put_out} of {put_in}");
        }
        assert!((sent - came).norm() < 1e-4, "{sent} {came}");
        assert!(put_out > 0.9 * put_in, "a loss takes little: {put_out} of {put_in}");
    }

    #[test]
    fn integrals_wrap_around_without_a_jump() {
        let (mut sender, mut receiver) = (WaveSender::default(), WaveReceiver::default());
        let mut last = Vector3::zeros();
        let mut wrapped = false;
        let wave = Vector3::new(2.0, -2.0, 0.0);
        for ms in 0..100_000 {
            let before = sender.integrals().wave[0];
            sender.step(&wave, STEP);
            wrapped |= sender.integrals().wave[0] < before;
            receiver.receive(sender.integrals());
            last = receiver.step(STEP);
            assert!(last.norm() < 2.9, "{ms} ms: {last}");
        }
        assert!(wrapped && (last - wave).norm() < 1e-3, "{last}");
    }

    #[test]
    fn nothing_that_is_received_makes_a_wave_without_energy() {
        let mut receiver = WaveReceiver::default();
        receiver.receive(&WaveIntegrals { wave: [i32::MAX, i32::MIN, 7], energy_nj: 0 });
        assert_eq!(receiver.step(STEP), Vector3::zeros());
        receiver.receive(&WaveIntegrals { wave: [0; 3], energy_nj: u64::MAX });
        let energy: f64 = (0..1_000).map(|_| 0.5 * receiver.step(STEP).norm_squared() * STEP).sum();
        assert!(energy <= RESERVE_MAX, "{energy}");
        let mut sender = WaveSender::default();
        sender.step(&Vector3::new(f64::NAN, f64::INFINITY, 1e9), STEP);
        let integrals = *sender.integrals();
        assert_eq!(integrals.wave, [0, 0, (WAVE_MAX * STEP * INTEGRAL_UNITS).round() as i32]);
    }
}
