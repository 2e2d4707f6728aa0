//! The two ends of a coupling over a network, with the method that their choice and the round trip ask for.

use nalgebra::Vector3;
use trocar_scene::SimTime;

use super::block::{CompensationBlock, Payload};
use super::model_mediated::{ContactEstimator, ContactModel, RenderedContact};
use super::passivity::{CouplingConfig, MasterPort, RemoteForce, SlavePort, filling_force};
use super::wave_variables::{WaveMaster, WaveSlave};
use super::{Compensation, Method};
use crate::haptic::fade;

/// Silence after which the contact known at the master recedes.
pub const FORGET_AFTER: SimTime = SimTime::from_millis(1_000);
/// Round trip above which `automatic` is model-mediated.
pub const LONG_ROUND_TRIP: SimTime = SimTime::from_millis(300);
/// Round trip below which `automatic` goes back to passivity.
pub const SHORT_ROUND_TRIP: SimTime = SimTime::from_millis(250);
/// How long the round trip must ask for the other method before `automatic` changes to it.
pub const CHANGE_AFTER: SimTime = SimTime::from_millis(1_000);
/// How long the force takes from one method's to the other's.
pub const HAND_OVER: SimTime = SimTime::from_millis(500);
/// Bounds of a step \[s\]: a longer pause is counted as the longest step.
const STEP_SECS: (f64, f64) = (1e-4, 0.02);
/// A step when there was none before \[s\].
const FIRST_STEP_SECS: f64 = 1e-3;

/// What an end sends with each hand: position, velocity and force belong to the hand's own 100 bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CouplingSample {
    /// Position of the port \[m\]: of the device at the master, the commanded one at the slave.
    pub position: Vector3<f64>,
    /// Velocity of the port [m/s].
    pub velocity: Vector3<f64>,
    /// Force on the hand \[N\]: as rendered at the master, as the coupling asks for at the slave.
    pub force: Vector3<f64>,
    /// The rest.
    pub block: CompensationBlock,
}

impl CouplingSample {
    fn is_finite(&self) -> bool {
        [&self.position, &self.velocity, &self.force].into_iter().flatten().all(|part| part.is_finite())
    }
}

/// Clock of an end: lengths of its steps, and the silence of the other end.
#[derive(Clone, Debug, Default)]
struct StepClock {
    last: Option<SimTime>,
    heard: Option<SimTime>,
}

impl StepClock {
    fn step(&mut self, now: SimTime, heard: bool) -> f64 {
        if heard {
            self.heard = Some(now);
        }
        let secs = self.last.replace(now).map_or(FIRST_STEP_SECS, |last| now.since(last).as_secs_f64());
        secs.clamp(STEP_SECS.0, STEP_SECS.1)
    }

    /// Share of a remote force that its age allows, 1 to 0.
    fn freshness(&self, now: SimTime) -> f64 {
        fade(self.silence(now))
    }

    /// Time since something was heard last, or since the start.
    fn silence(&self, now: SimTime) -> SimTime {
        now.since(self.heard.unwrap_or_default())
    }
}

/// What a master's device measures, and the link's round trip.
#[derive(Clone, Copy, Debug)]
pub struct MasterReading {
    /// Position of the hand \[m\].
    pub position: Vector3<f64>,
    /// Velocity of the hand [m/s].
    pub velocity: Vector3<f64>,
    /// Measured round trip of the link.
    pub round_trip: SimTime,
}

/// Master's end: a hand at a device that shows forces.
#[derive(Clone, Debug)]
pub struct MasterEnd {
    config: CouplingConfig,
    choice: Compensation,
    method: Method,
    /// Since when the round trip asks for the other method.
    doubtful: Option<SimTime>,
    /// When the method changed, and the force that was shown beyond the new method's.
    changed: Option<(SimTime, Vector3<f64>)>,
    clock: StepClock,
    port: MasterPort,
    newest: Option<CouplingSample>,
    remote: RemoteForce,
    wave: WaveMaster,
    contact: RenderedContact,
}

impl MasterEnd {
    /// An end at rest.
    pub fn new(choice: Compensation, config: CouplingConfig) -> Self {
        Self {
            choice,
            method: choice.first_method(),
            doubtful: None,
            changed: None,
            clock: StepClock::default(),
            port: MasterPort::new(&config),
            newest: None,
            remote: RemoteForce::default(),
            wave: WaveMaster::new(&config),
            contact: RenderedContact::new(&config),
            config,
        }
    }

    /// The method that is rendered now.
    pub fn method(&self) -> Method {
        self.method
    }

    /// The contact that is rendered, or would be.
    pub fn shown(&self) -> Option<&ContactModel> {
        self.contact.shown()
    }

    /// The port, with its energy.
    pub fn port(&self) -> &MasterPort {
        &self.port
    }

    /// A step of the local loop at `now`, with the newest sample if one has arrived since the last step. Returns what is
    /// sent; its `force` is what the device shows until the next step. A reading or sample that is not finite is ignored.
    pub fn step(
        &mut self,
        now: SimTime,
        reading: &MasterReading,
        received: Option<&CouplingSample>,
    ) -> CouplingSample {
        let received = received.filter(|sample| sample.is_finite());
        let step_secs = self.clock.step(now, received.is_some());
        let finite = |vector: &Vector3<f64>| vector.iter().all(|part| part.is_finite());
        let velocity = if finite(&reading.velocity) { reading.velocity } else { Vector3::zeros() };
        let position = if finite(&reading.position) {
            reading.position
        } else {
            self.port.position().copied().unwrap_or_default()
        };
        self.port.observe(&position);
        if let Some(sample) = received {
            self.receive(sample);
        }
        self.port.tank().settle(step_secs);
        let change = self.choose(now, reading.round_trip);
        let mut wanted = self.wanted(now, &position, &velocity, reading.round_trip, step_secs);
        if change {
            self.changed = Some((now, self.port.force() - wanted));
        }
        wanted += self.left_over(now);
        self.port.hold(&wanted, &velocity, step_secs);
        let payload = if self.method == Method::WaveVariables {
            Payload::Wave(*self.wave.send(&self.port, &velocity, step_secs))
        } else {
            Payload::None
        };
        if self.method == Method::Passivity {
            self.port.tank().share(step_secs);
        }
        let account = self.port.tank().account();
        let block = CompensationBlock { method: self.method, account, payload };
        CouplingSample { position, velocity, force: *self.port.force(), block }
    }

    fn receive(&mut self, sample: &CouplingSample) {
        self.port.tank().receive(&sample.block.account);
        match &sample.block.payload {
            Payload::None => self.contact.receive(None),
            Payload::Contact(contact) => self.contact.receive(Some(contact)),
            Payload::Wave(integrals) => self.wave.receive(integrals),
        }
        self.newest = Some(*sample);
    }

    /// Whether the method changes in this step.
    fn choose(&mut self, now: SimTime, round_trip: SimTime) -> bool {
        if self.choice != Compensation::Automatic {
            return false;
        }
        let other = match self.method {
            Method::Passivity if round_trip > LONG_ROUND_TRIP => Method::ModelMediated,
            Method::ModelMediated if round_trip < SHORT_ROUND_TRIP => Method::Passivity,
            _ => {
                self.doubtful = None;
                return false;
            }
        };
        if now.since(*self.doubtful.get_or_insert(now)) < CHANGE_AFTER {
            return false;
        }
        self.doubtful = None;
        self.method = other;
        self.contact.take_over();
        true
    }

    /// What is left of the old method's force \[N\].
    fn left_over(&mut self, now: SimTime) -> Vector3<f64> {
        let Some((changed, force)) = self.changed else { return Vector3::zeros() };
        let share = 1.0 - now.since(changed).as_secs_f64() / HAND_OVER.as_secs_f64();
        if share <= 0.0 {
            self.changed = None;
        }
        force * share.max(0.0)
    }

    fn wanted(
        &mut self,
        now: SimTime,
        position: &Vector3<f64>,
        velocity: &Vector3<f64>,
        round_trip: SimTime,
        step_secs: f64,
    ) -> Vector3<f64> {
        let fresh = self.clock.freshness(now);
        if self.clock.silence(now) > FORGET_AFTER {
            self.contact.receive(None);
        }
        let contact = self.contact.step(position, velocity, step_secs);
        let newest = self.newest.map_or(Vector3::zeros(), |sample| sample.force);
        // In a gap the hand leans on the contact as it is known here, and does not sink in and have to be pushed back.
        let newest = newest * fresh + contact * (1.0 - fresh);
        let lag = self.config.force_lag * round_trip.as_secs_f64();
        // Steps in every method, so that a change of method finds the force of now.
        let remote = *self.remote.step(&newest, lag, step_secs);
        let level = self.port.tank().level();
        match self.method {
            Method::Passivity => remote + filling_force(&self.config, level, velocity),
            Method::WaveVariables => self.wave.force(velocity, step_secs),
            Method::ModelMediated => contact + filling_force(&self.config, level, velocity),
        }
    }
}

/// Slave's end: a port in the scene whose position is commanded.
#[derive(Clone, Debug)]
pub struct SlaveEnd {
    clock: StepClock,
    port: SlavePort,
    newest: Option<CouplingSample>,
    wave: WaveSlave,
    contact: ContactEstimator,
    velocity: Vector3<f64>,
}

impl SlaveEnd {
    /// An end that waits for the first position; it follows the master's method.
    pub fn new(config: CouplingConfig) -> Self {
        Self {
            clock: StepClock::default(),
            port: SlavePort::new(&config),
            newest: None,
            wave: WaveSlave::new(&config),
            contact: ContactEstimator::new(&config),
            velocity: Vector3::zeros(),
        }
    }

    /// The port, with its command.
    pub fn port(&self) -> &SlavePort {
        &self.port
    }

    /// A step of the local loop at `now`, with the force on the port under the last command, and the newest sample if one
    /// has arrived since the last step. Returns what is sent, with the commanded position and velocity, once the master
    /// has been heard. A force or sample that is not finite is ignored.
    pub fn step(
        &mut self,
        now: SimTime,
        force: &Vector3<f64>,
        received: Option<&CouplingSample>,
    ) -> Option<CouplingSample> {
        let received = received.filter(|sample| sample.is_finite());
        let step_secs = self.clock.step(now, received.is_some());
        let force = if force.iter().all(|part| part.is_finite()) { *force } else { Vector3::zeros() };
        self.port.observe(&force);
        let newest = self.receive(received, step_secs)?;
        let method = newest.block.method;
        let before = self.port.command().copied().unwrap_or(newest.position);
        self.contact.step(&before, &self.velocity, &force, step_secs);
        let contact = self.contact.model().map_or(Payload::None, |model| Payload::Contact(*model));
        let payload = match method {
            Method::Passivity => {
                let motion = self.port.towards(&newest.position, step_secs);
                self.port.advance(&motion);
                self.port.tank().share(step_secs);
                contact
            }
            Method::WaveVariables => {
                Payload::Wave(*self.wave.step(&mut self.port, &newest.position, &force, step_secs))
            }
            Method::ModelMediated => {
                let motion = self.port.towards(&newest.position, step_secs);
                self.port.advance_on_credit(&motion);
                contact
            }
        };
        let position = self.port.command().copied().unwrap_or(newest.position);
        self.velocity = (position - before) / step_secs;
        let account = self.port.tank().account();
        let block = CompensationBlock { method, account, payload };
        Some(CouplingSample { position, velocity: self.velocity, force, block })
    }

    /// Takes what the master has sent. Returns the newest of it, once there is any.
    fn receive(&mut self, received: Option<&CouplingSample>, step_secs: f64) -> Option<CouplingSample> {
        if let Some(sample) = received {
            self.port.tank().receive(&sample.block.account);
            if let Payload::Wave(integrals) = &sample.block.payload {
                self.wave.receive(integrals);
            }
            self.newest = Some(*sample);
        }
        let newest = self.newest?;
        self.port.tank().settle(step_secs);
        Some(newest)
    }

    /// A step at which the slave stands where it is, whatever the master does: its pedal is up, or it was stopped. It tells
    /// no force and no contact, and what the master has sent meanwhile is not made up for.
    pub fn rest(&mut self, now: SimTime, received: Option<&CouplingSample>) -> Option<CouplingSample> {
        let received = received.filter(|sample| sample.is_finite());
        let step_secs = self.clock.step(now, received.is_some());
        let newest = self.receive(received, step_secs)?;
        self.velocity = Vector3::zeros();
        let wave = *self.wave.rest();
        let method = newest.block.method;
        let payload = if method == Method::WaveVariables { Payload::Wave(wave) } else { Payload::None };
        let position = *self.port.command()?;
        let account = self.port.tank().account();
        let block = CompensationBlock { method, account, payload };
        Some(CouplingSample { position, velocity: Vector3::zeros(), force: Vector3::zeros(), block })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compensation::{ContactModel, EnergyAccount, WaveIntegrals};

    fn reading(x: f64, round_trip_ms: u64) -> MasterReading {
        let round_trip = SimTime::from_millis(round_trip_ms);
        MasterReading { position: Vector3::x() * x, velocity: Vector3::zeros(), round_trip }
    }

    fn sample(method: Method, force: f64, payload: Payload) -> CouplingSample {
        // Enough for any force of these tests.
        let account = EnergyAccount { given_nj: 100_000_000, balance_nj: 0 };
        let block = CompensationBlock { method, account, payload };
        let zero = Vector3::zeros();
        CouplingSample { position: zero, velocity: zero, force: Vector3::x() * force, block }
    }

    #[test]
    fn a_remote_force_is_gone_when_nothing_arrives() {
        let mut master = MasterEnd::new(Compensation::Passivity, CouplingConfig::default());
        let held = sample(Method::Passivity, 2.0, Payload::None);
        let force = |master: &mut MasterEnd, ms: u64| {
            let heard = (ms < 1_000).then_some(&held);
            master.step(SimTime::from_millis(ms), &reading(0.0, 20), heard).force.x
        };
        let forces: Vec<f64> = (0..1_200).map(|ms| force(&mut master, ms)).collect();
        assert!((forces[999] - 2.0).abs() < 1e-3, "{}", forces[999]);
        assert!(forces[1_045] > 1.99, "a short gap is bridged: {}", forces[1_045]);
        assert!(forces[1_080] < 1.0, "{}", forces[1_080]);
        assert!(forces[1_120] < 1e-3, "{}", forces[1_120]);
        // It comes back by and by.
        master.step(SimTime::from_millis(1_200), &reading(0.0, 20), Some(&held));
        assert!(master.port().force().x < 1.1, "{}", master.port().force().x);
    }

    #[test]
    fn a_silent_link_takes_the_known_contact_away_slowly() {
        let contact = ContactModel { normal: Vector3::x(), offset: 0.0, stiffness: 300.0, damping: 0.0 };
        let held = sample(Method::ModelMediated, 0.0, Payload::Contact(contact));
        let mut master = MasterEnd::new(Compensation::ModelMediated, CouplingConfig::default());
        let mut last = 0.0_f64;
        for ms in 0..4_000 {
            // The hand is 5 mm deep in what was touched.
            let heard = (ms < 1_000).then_some(&held);
            let force = master.step(SimTime::from_millis(ms), &reading(-0.005, 500), heard).force.x;
            assert!((force - last).abs() < 0.02, "{ms} ms: {force} after {last}");
            assert!(!(900..1_900).contains(&ms) || (force - 1.5).abs() < 0.05, "{ms} ms: {force}");
            last = force;
        }
        assert_eq!(last, 0.0);
    }

    #[test]
    fn automatic_changes_beyond_its_limits_only_and_not_for_a_moment() {
        let mut master = MasterEnd::new(Compensation::Automatic, CouplingConfig::default());
        let mut ms = 0;
        let mut after = |round_trip_ms: u64, secs: u64| {
            for _ in 0..secs * 1_000 {
                master.step(SimTime::from_millis(ms), &reading(0.0, round_trip_ms), None);
                ms += 1;
            }
            master.method()
        };
        assert_eq!(after(300, 5), Method::Passivity);
        for _ in 0..5 {
            assert_eq!((after(400, 1), after(290, 1)), (Method::Passivity, Method::Passivity));
        }
        assert_eq!(after(310, 2), Method::ModelMediated);
        assert_eq!(after(260, 5), Method::ModelMediated);
        assert_eq!(after(240, 2), Method::Passivity);
    }

    #[test]
    fn authenticated_nonsense_moves_little_and_poisons_nothing() {
        for choice in [Compensation::Passivity, Compensation::WaveVariables, Compensation::ModelMediated] {
            let mut master = MasterEnd::new(choice, CouplingConfig::default());
            let mut slave = SlaveEnd::new(CouplingConfig::default());
            let method = choice.first_method();
            let mut strong = sample(method, 1_000.0, Payload::None);
            let mut last = Vector3::zeros();
            for ms in 0..2_000 {
                let now = SimTime::from_millis(ms);
                strong.force.y = if ms % 3 == 0 { f64::NAN } else { -1e30 };
                strong.position = Vector3::x() * if ms % 2 == 0 { 1.0 } else { -1e6 };
                strong.block.account.given_nj = u64::MAX;
                let at = MasterReading {
                    position: Vector3::repeat(if ms == 7 { f64::NAN } else { 0.0 }),
                    ..reading(0.0, 100)
                };
                let sent = master.step(now, &at, Some(&strong));
                // What the fullest tank lets through: a spring of 1,000 N/m with 0.2 J.
                assert!(sent.force.norm() <= 20.0 + 1e-9, "{choice:?} {ms} ms: {}", sent.force);
                let force = Vector3::repeat(if ms % 5 == 0 { f64::INFINITY } else { 0.0 });
                let told = slave.step(now, &force, Some(&strong));
                let Some(told) = told else { continue };
                assert!(told.velocity.norm() < 0.61 || ms < 3, "{choice:?} {ms} ms: {}", told.velocity);
                assert!(told.is_finite() && sent.is_finite());
                assert!(ms < 3 || (told.position - last).norm() < 7e-4, "{choice:?} {ms} ms");
                last = told.position;
            }
        }
    }

    #[test]
    fn a_slave_that_rested_goes_on_from_where_it_stood_in_every_method() {
        for method in [Method::Passivity, Method::WaveVariables, Method::ModelMediated] {
            let mut slave = SlaveEnd::new(CouplingConfig::default());
            let mut sent = sample(method, 0.0, Payload::None);
            let mut wave = WaveIntegrals::default();
            let mut told = |ms: u64, x: f64, rests: bool| {
                if method == Method::WaveVariables {
                    // A wave that moves the slave by 0.1 m/s.
                    wave.wave[0] += (0.4 * 1e-3 * 16_777_216.0) as i32;
                    wave.energy_nj += 80_000;
                    sent.block.payload = Payload::Wave(wave);
                }
                sent.position = Vector3::x() * x;
                let now = SimTime::from_millis(ms);
                if rests {
                    slave.rest(now, Some(&sent))
                } else {
                    slave.step(now, &Vector3::zeros(), Some(&sent))
                }
            };
            assert!(told(0, 0.0, true).is_none(), "it has no place yet");
            let stood = (1..100).filter_map(|ms| told(ms, 0.0, false)).last().expect("it was heard").position;
            for ms in 100..1_100 {
                // The hand goes 0.1 m far with its pedal up.
                let rests = told(ms, 1e-4 * (ms - 100) as f64, true).expect("it was heard");
                assert_eq!(
                    (rests.position, rests.velocity, rests.force),
                    (stood, Vector3::zeros(), Vector3::zeros())
                );
                assert!(!matches!(rests.block.payload, Payload::Contact(_)));
            }
            // The clutch has closed: it is wanted where it stands.
            let goes_on = told(1_100, stood.x, false).expect("it was heard");
            assert!((goes_on.position - stood).norm() < 3e-4, "{method:?}: {}", goes_on.position - stood);
        }
    }
}
