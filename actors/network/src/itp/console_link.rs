//! Console of ITP as a link of hands: a packet a millisecond to a robot somewhere else, and its replies back.

use nalgebra::Isometry3;
use triple_buffer::{Input, Output, triple_buffer};
use trocar_scene::SimTime;

use super::packet::CONSOLE_MATRIX_BYTES;
use super::{ARMS, ConfigError, Console, ConsoleConfig, ConsoleHand, RobotReport};
use crate::hands_link::HandsLink;

/// What a surgeon does at a console.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surgeon {
    /// The hands.
    pub hands: [ConsoleHand; ARMS],
    /// Whether the pedal is down.
    pub pedal_down: bool,
}

impl Surgeon {
    /// Hands at the origin, jaws closed, pedal up.
    pub fn at_rest() -> Self {
        let hand = ConsoleHand { pose_in_console: Isometry3::identity(), jaw: 0.0, squeeze: 0.0, buttons: 0 };
        Self { hands: [hand; ARMS], pedal_down: false }
    }
}

/// A console as its surgeon has it.
pub struct ConsoleEnd {
    surgeon: Input<Surgeon>,
    reports: Output<Option<RobotReport>>,
}

impl ConsoleEnd {
    /// Says what the surgeon does from now on.
    pub fn lead(&mut self, surgeon: &Surgeon) {
        self.surgeon.write(*surgeon);
    }

    /// What the robot replied last.
    pub fn report(&mut self) -> Option<RobotReport> {
        *self.reports.read()
    }
}

/// The link.
pub struct ConsoleLink<A> {
    console: Console,
    robot: A,
    /// Whose datagrams are replies.
    admits: Box<dyn Fn(&A) -> bool + Send>,
    surgeon: Output<Surgeon>,
    reports: Input<Option<RobotReport>>,
}

impl<A: Copy> ConsoleLink<A> {
    /// A console of the robot at this address. `admits` says whose datagrams are looked at.
    ///
    /// # Errors
    /// [`ConfigError`] when a parameter makes no sense.
    pub fn new(
        config: ConsoleConfig,
        robot: A,
        admits: impl Fn(&A) -> bool + Send + 'static,
    ) -> Result<(Self, ConsoleEnd), ConfigError> {
        let console = Console::new(config)?;
        let (surgeon_in, surgeon) = triple_buffer(&Surgeon::at_rest());
        let (reports_in, reports) = triple_buffer(&None);
        let link = Self { console, robot, admits: Box::new(admits), surgeon, reports: reports_in };
        Ok((link, ConsoleEnd { surgeon: surgeon_in, reports }))
    }
}

impl<A: Copy + Send + 'static> HandsLink<A> for ConsoleLink<A> {
    fn receive(&mut self, now: SimTime, from: A, datagram: &mut [u8], _: &mut dyn FnMut(A, &[u8]) -> bool) {
        // What is no reply, or an older one, changes nothing.
        if (self.admits)(&from) && self.console.receive(datagram, now) == Ok(true) {
            self.reports.write(self.console.report().copied());
        }
    }

    fn tick(&mut self, _: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        let Surgeon { hands, pedal_down } = *self.surgeon.read();
        let mut out = [0; CONSOLE_MATRIX_BYTES];
        // A packet that the system does not take is lost, and with it its increments: the protocol's own fault.
        send(self.robot, self.console.command(&hands, pedal_down).encode(&mut out));
    }

    fn is_idle(&self) -> bool {
        false
    }
}
