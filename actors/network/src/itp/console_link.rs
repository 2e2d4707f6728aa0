//! Console of ITP as a link of hands: a packet a millisecond to a robot somewhere else, and its replies back.

use std::collections::VecDeque;

use nalgebra::Isometry3;
use triple_buffer::{Input, Output, triple_buffer};
use trocar_scene::SimTime;

use super::packet::CONSOLE_MATRIX_BYTES;
use super::{ARMS, ConfigError, Console, ConsoleConfig, ConsoleHand, RobotReport};
use crate::hands_link::HandsLink;

/// Packets whose time of sending is remembered: eight seconds at 1 kHz.
const SENT_MAX: usize = 8_192;

/// What a surgeon's hand does at a console.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LedHand {
    /// The hand.
    pub hand: ConsoleHand,
    /// Whether it is to be followed. The console has one pedal: it is down while all hands that lead an arm say so.
    pub pedal_down: bool,
}

/// What a console knows of its robot, and of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsoleReport {
    /// What the robot replied last.
    pub robot: RobotReport,
    /// Time from sending the packet that the robot applied last to its reply; `None` before it has applied one, and when that
    /// was too long ago.
    pub round_trip: Option<SimTime>,
    /// Packets that were sent.
    pub sent: u64,
    /// Replies that came, the newest each.
    pub received: u64,
    /// Datagrams that were no reply, or an older one.
    pub refused: u64,
}

/// An arm of the robot, as a hand at the console has it.
pub struct ConsoleArm {
    led: Input<Option<LedHand>>,
    reports: Output<Option<ConsoleReport>>,
}

impl ConsoleArm {
    /// Says what the hand does from now on; `None`: it leaves the arm.
    pub fn lead(&mut self, led: Option<LedHand>) {
        self.led.write(led);
    }

    /// What the robot replied last.
    pub fn report(&mut self) -> Option<ConsoleReport> {
        *self.reports.read()
    }
}

struct LinkedArm {
    led: Output<Option<LedHand>>,
    reports: Input<Option<ConsoleReport>>,
    /// Where the hand was last: there it stays while nobody leads.
    hand: ConsoleHand,
}

/// The link.
pub struct ConsoleLink<A> {
    console: Console,
    robot: A,
    /// Whose datagrams are replies.
    admits: Box<dyn Fn(&A) -> bool + Send>,
    arms: [LinkedArm; ARMS],
    /// Numbers and times of packets, the newest last.
    sent_at: VecDeque<(u32, SimTime)>,
    sent: u64,
    received: u64,
    refused: u64,
}

impl<A: Copy> ConsoleLink<A> {
    /// A console of the robot at this address, with its arms. `admits` says whose datagrams are looked at.
    ///
    /// # Errors
    /// [`ConfigError`] when a parameter makes no sense.
    pub fn new(
        config: ConsoleConfig,
        robot: A,
        admits: impl Fn(&A) -> bool + Send + 'static,
    ) -> Result<(Self, [ConsoleArm; ARMS]), ConfigError> {
        let console = Console::new(config)?;
        let arm = || {
            let (led_in, led) = triple_buffer(&None);
            let (reports_in, reports) = triple_buffer(&None);
            let hand =
                ConsoleHand { pose_in_console: Isometry3::identity(), jaw: 0.0, squeeze: 0.0, buttons: 0 };
            (LinkedArm { led, reports: reports_in, hand }, ConsoleArm { led: led_in, reports })
        };
        let ((left, left_arm), (right, right_arm)) = (arm(), arm());
        let link = Self {
            console,
            robot,
            admits: Box::new(admits),
            arms: [left, right],
            sent_at: VecDeque::with_capacity(SENT_MAX),
            sent: 0,
            received: 0,
            refused: 0,
        };
        Ok((link, [left_arm, right_arm]))
    }

    /// When the packet of this number was sent, if that is remembered.
    fn sent_at(&self, number: u32) -> Option<SimTime> {
        let (newest, _) = self.sent_at.back()?;
        // Numbers follow each other: its place is known.
        let behind = usize::try_from(newest.checked_sub(number)?).ok()?;
        let place = self.sent_at.len().checked_sub(behind + 1)?;
        self.sent_at.get(place).filter(|(sent, _)| *sent == number).map(|(_, at)| *at)
    }
}

impl<A: Copy + Send + 'static> HandsLink<A> for ConsoleLink<A> {
    fn receive(&mut self, now: SimTime, from: A, datagram: &mut [u8], _: &mut dyn FnMut(A, &[u8]) -> bool) {
        if !(self.admits)(&from) {
            return;
        }
        // What is no reply, or an older one, changes nothing.
        if self.console.receive(datagram, now) != Ok(true) {
            self.refused += 1;
            return;
        }
        self.received += 1;
        let Some(robot) = self.console.report().copied() else { return };
        let round_trip = self.sent_at(robot.last_sequence).map(|sent| now.since(sent));
        let report = ConsoleReport {
            robot,
            round_trip,
            sent: self.sent,
            received: self.received,
            refused: self.refused,
        };
        self.arms.iter_mut().for_each(|arm| arm.reports.write(Some(report)));
    }

    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        let led = self.arms.each_mut().map(|arm| *arm.led.read());
        for (arm, led) in self.arms.iter_mut().zip(led) {
            arm.hand = led.map_or(ConsoleHand { buttons: 0, ..arm.hand }, |led| led.hand);
        }
        let mut leading = led.iter().flatten().peekable();
        let pedal_down = leading.peek().is_some() && leading.all(|led| led.pedal_down);
        let mut out = [0; CONSOLE_MATRIX_BYTES];
        let packet = self.console.command(&self.arms.each_ref().map(|arm| arm.hand), pedal_down);
        if self.sent_at.len() >= SENT_MAX {
            self.sent_at.pop_front();
        }
        self.sent_at.push_back((packet.sequence, now));
        self.sent += 1;
        // A packet that the system does not take is lost, and with it its increments: the protocol's own fault.
        send(self.robot, packet.encode(&mut out));
    }

    fn is_idle(&self) -> bool {
        false
    }
}

#[cfg(test)]
#[path = "console_link_tests.rs"]
mod tests;
