//! Robot of ITP as a link of hands: datagrams of one console in, both arms to whoever moves them, and replies back.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::Vector3;
use triple_buffer::{Input, Output, triple_buffer};
use trocar_scene::SimTime;

use super::{ARMS, ArmPose, Condition, ConfigError, Robot, RobotConfig, RobotCounts, Runlevel};
use crate::hands_link::HandsLink;

/// Silence after which another console may take the robot.
pub const CONSOLE_LEAVES_AFTER: SimTime = SimTime::from_millis(2_000);

/// What the protocol asks of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmPost {
    /// How many were posted before.
    pub number: u64,
    /// Where it has to go.
    pub pose: ArmPose,
    /// Whether it follows the console now.
    pub follows: bool,
    /// Buttons of the hand.
    pub buttons: u32,
    /// Counts of the robot.
    pub counts: RobotCounts,
}

/// An arm of a robot as whoever moves it has it.
pub struct ArmEnd {
    posts: Output<Option<ArmPost>>,
    forces: Input<Vector3<f64>>,
    stop: Arc<AtomicBool>,
}

impl ArmEnd {
    /// What is asked of it; none before a console was heard.
    pub fn post(&mut self) -> Option<ArmPost> {
        *self.posts.read()
    }

    /// Tells the console of the force at the arm, in the robot's frame \[N\].
    pub fn feel(&mut self, force_in_robot: &Vector3<f64>) {
        self.forces.write(*force_in_robot);
    }

    /// Emergency stop of this arm, or its end. The robot stands, and says so in its replies, while any of its arms is
    /// stopped.
    pub fn set_stop(&mut self, stop: bool) {
        self.stop.store(stop, Ordering::Release);
    }
}

struct LinkedArm {
    posts: Input<Option<ArmPost>>,
    forces: Output<Vector3<f64>>,
    stop: Arc<AtomicBool>,
}

/// The link.
pub struct RobotLink<A> {
    robot: Robot,
    condition: Condition,
    arms: [LinkedArm; ARMS],
    /// Who may be the console.
    admits: Box<dyn Fn(&A) -> bool + Send>,
    /// Where replies to a console go.
    reply_to: Box<dyn Fn(A) -> A + Send>,
    /// The console, and when it was heard last.
    console: Option<(A, SimTime)>,
    posted: u64,
}

impl<A: Copy + PartialEq> RobotLink<A> {
    /// A robot that is ready, with its arms. `admits` says whose datagrams are looked at, `reply_to` where replies to a
    /// console go.
    ///
    /// # Errors
    /// [`ConfigError`] when a parameter makes no sense.
    pub fn new(
        config: RobotConfig,
        admits: impl Fn(&A) -> bool + Send + 'static,
        reply_to: impl Fn(A) -> A + Send + 'static,
    ) -> Result<(Self, [ArmEnd; ARMS]), ConfigError> {
        let mut robot = Robot::new(config)?;
        robot.set_condition(Condition::Ready);
        let arm = || {
            let (posts_in, posts) = triple_buffer(&None);
            let (forces_in, forces) = triple_buffer(&Vector3::zeros());
            let stop = Arc::<AtomicBool>::default();
            let linked = LinkedArm { posts: posts_in, forces, stop: stop.clone() };
            (linked, ArmEnd { posts, forces: forces_in, stop })
        };
        let ((left, left_end), (right, right_end)) = (arm(), arm());
        let link = Self {
            robot,
            condition: Condition::Ready,
            arms: [left, right],
            admits: Box::new(admits),
            reply_to: Box::new(reply_to),
            console: None,
            posted: 0,
        };
        Ok((link, [left_end, right_end]))
    }

    /// Stops the robot, or makes it ready again, as its arms ask.
    fn obey(&mut self) {
        let stop = self.arms.iter().any(|arm| arm.stop.load(Ordering::Acquire));
        let asked = if stop { Condition::Stopped } else { Condition::Ready };
        if asked != self.condition {
            self.condition = asked;
            self.robot.set_condition(asked);
        }
    }

    fn post(&mut self) {
        let follows = self.robot.runlevel() == Runlevel::PedalDown;
        for (number, arm) in self.arms.iter_mut().enumerate() {
            arm.posts.write(Some(ArmPost {
                number: self.posted,
                pose: *self.robot.arm(number),
                follows,
                buttons: self.robot.buttons(number),
                counts: *self.robot.counts(),
            }));
        }
        self.posted += 1;
    }
}

impl<A: Copy + PartialEq + Send + 'static> HandsLink<A> for RobotLink<A> {
    fn receive(
        &mut self,
        now: SimTime,
        from: A,
        datagram: &mut [u8],
        send: &mut dyn FnMut(A, &[u8]) -> bool,
    ) {
        let left = |heard: SimTime| now.since(heard) >= CONSOLE_LEAVES_AFTER;
        let is_other = self.console.is_some_and(|(console, heard)| console != from && !left(heard));
        if is_other || !(self.admits)(&from) {
            return;
        }
        self.obey();
        // The robot counts what it refuses, and nothing is answered to that.
        if self.robot.receive(datagram, now).is_err() {
            return;
        }
        self.console = Some((from, now));
        self.post();
        let forces = self.arms.each_mut().map(|arm| *arm.forces.read());
        let reply = self.robot.reply(&forces, 0).encode();
        // A reply that the system does not take is lost, as on any path.
        send((self.reply_to)(from), &reply);
    }

    fn tick(&mut self, now: SimTime, _: &mut dyn FnMut(A, &[u8]) -> bool) {
        let followed = self.robot.runlevel();
        self.obey();
        self.robot.poll(now);
        if self.robot.runlevel() != followed {
            self.post();
        }
    }

    fn is_idle(&self) -> bool {
        self.console.is_none()
    }
}

#[cfg(test)]
#[path = "robot_link_tests.rs"]
mod tests;
