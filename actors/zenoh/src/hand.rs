//! A hand that somebody elsewhere commands: `--hand right=zenoh:right`.
//!
//! ```text
//! node: command ─▶ HandLane { claim } ═ triple buffer ═▶ ZenohHand { RemoteHand { Door } } ─▶ driver ─▶ haptics
//! node: answer  ◀─ HandLane           ◀ triple buffer ══ ZenohHand
//! ```
//!
//! Commands pass the door of a remote hand: no jump, no place outside of the workspace, no number that is none, and after
//! 100 ms of silence the motion stops, buttons count as released and jaws hold. `read` and `write` allocate nothing, lock
//! nothing and do not block.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use serde_json::{Value, json};
use triple_buffer::{Input, Output, triple_buffer};
use trocar_devices::{Capabilities, DeviceError, DeviceState, Dofs, HapticDevice, Workspace, Wrench};
use trocar_network::hand_sample::HandSample;
use trocar_network::remote_hand::{DoorLimits, HandAnswer, HandControl, Presence, RemoteHand, StationEnd};
use trocar_scene::SimTime;

use crate::claim::{ClaimCode, ClaimRefusal, Claims};
use crate::keys::check_name;

/// The form for users.
pub const USAGE: &str = "zenoh:NAME";
/// What it is.
pub const ABOUT: &str = "a hand that is commanded from elsewhere by Zenoh, under this name; with --zenoh";
/// Longest command \[bytes\].
pub const COMMAND_MAX: usize = 1_024;
/// Name of the device, where only known people reach it.
const MODEL: &str = "hand commanded by Zenoh";
/// Name of the device otherwise: it says what `DeviceInfo::is_unprotected` looks for.
const UNPROTECTED_MODEL: &str = "hand commanded by Zenoh (unprotected)";
/// The hand's number; each has a door of its own.
const HAND: u8 = 0;

/// A command as it arrives: where the handle is to be, in the device's frame.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandCommand {
    /// The claim.
    pub claim: String,
    /// Rises with each command.
    pub sequence: u64,
    /// Position of the handle in the device's frame \[m\].
    pub position: [f64; 3],
    /// Rotation quaternion `[x, y, z, w]`, of unit length.
    #[serde(default = "upright")]
    pub rotation: [f64; 4],
    /// Opening of the gripper \[rad\].
    #[serde(default)]
    pub gripper: f64,
    /// Bit `n` is set while button `n` is pressed; pedals from 16.
    #[serde(default)]
    pub buttons: u32,
}

fn upright() -> [f64; 4] {
    [0.0, 0.0, 0.0, 1.0]
}

impl HandCommand {
    /// Reads a payload.
    ///
    /// # Errors
    /// In words.
    pub fn parse(payload: &[u8]) -> Result<Self, String> {
        if payload.len() > COMMAND_MAX {
            return Err(format!("{} bytes; a command has at most {COMMAND_MAX}", payload.len()));
        }
        serde_json::from_slice(payload).map_err(|error| error.to_string())
    }

    /// As a sample for the door, which judges the numbers.
    fn sample(&self) -> HandSample {
        let mut sample = HandSample::unknown(HAND);
        let [x, y, z, w] = self.rotation;
        sample.state.pose_in_device.translation = Translation3::from(Vector3::from(self.position));
        sample.state.pose_in_device.rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
        sample.state.gripper = self.gripper;
        sample.state.buttons = self.buttons;
        sample.state.connected = true;
        sample
    }
}

/// A sample on its way to the device.
#[derive(Clone, Copy, Debug)]
struct Post {
    number: u64,
    claimant: u16,
    sample: HandSample,
}

/// The node's end of a hand.
pub struct HandLane {
    claims: Claims,
    posts: Input<Option<Post>>,
    answers: Output<Option<HandAnswer>>,
    control: HandControl,
    posted: u64,
    refused: u64,
}

impl HandLane {
    /// Gives the hand to who asks for it.
    ///
    /// # Errors
    /// [`ClaimRefusal`].
    pub fn claim(&mut self, now: SimTime, code: ClaimCode) -> Result<u32, ClaimRefusal> {
        let epoch = self.claims.claim(now, code)?;
        self.control.take(claimant(epoch));
        Ok(epoch)
    }

    /// Brings a command to the device.
    ///
    /// # Errors
    /// In words; it is counted.
    pub fn command(&mut self, now: SimTime, payload: &[u8]) -> Result<(), String> {
        let taken = HandCommand::parse(payload).and_then(|command| {
            let code = ClaimCode::parse(&command.claim).ok_or("the claim is not 16 hexadecimal digits")?;
            self.claims.admit(now, code, command.sequence).map_err(|refusal| refusal.to_string())?;
            Ok(command)
        });
        let command = taken.inspect_err(|_| self.refused += 1)?;
        self.posted += 1;
        let claimant = claimant(self.claims.epoch());
        self.posts.write(Some(Post { number: self.posted, claimant, sample: command.sample() }));
        Ok(())
    }

    /// Whether somebody commands it, as far as claims go.
    pub fn is_held(&self) -> bool {
        self.claims.is_held()
    }

    /// What the hand answers: where it is behind the door, and the force that is felt there.
    pub fn answer(&mut self) -> Option<Value> {
        let answer = (*self.answers.read())?;
        let position: [f64; 3] = answer.state.pose_in_device.translation.vector.into();
        let rotation: [f64; 4] = answer.state.pose_in_device.rotation.coords.into();
        let (force, door) = (<[f64; 3]>::from(answer.wrench.force), answer.door);
        let presence = match answer.presence {
            Presence::Local => "local",
            Presence::Nobody => "nobody",
            Presence::Waiting(_) => "waiting",
            Presence::Live(_) => "live",
            Presence::Silent(_) => "silent",
            Presence::Unplugged(_) => "unplugged",
        };
        Some(json!({
            "time_secs": answer.at.as_secs_f64(),
            "presence": presence,
            "position": position,
            "rotation": rotation,
            "gripper": answer.state.gripper,
            "force": force,
            "epoch": self.claims.epoch(),
            "commands": self.posted,
            "refused": self.refused + door.refused_invalid + door.refused_older,
            "clamped": door.clamped_workspace + door.speed_limited,
        }))
    }
}

/// Number of the station that a claim counts as, at the door.
fn claimant(epoch: u32) -> u16 {
    (epoch % u32::from(u16::MAX)) as u16
}

/// The hands of a program that may be commanded: devices put themselves here, and the node finds them.
#[derive(Clone, Default)]
pub struct HandBoard(Arc<Mutex<Board>>);

#[derive(Default)]
struct Board {
    /// None: there is no node.
    is_protected: Option<bool>,
    lanes: BTreeMap<String, HandLane>,
}

impl fmt::Debug for HandBoard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("HandBoard").field(&self.lock().lanes.keys()).finish()
    }
}

impl HandBoard {
    fn lock(&self) -> MutexGuard<'_, Board> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says that there is a node, and whether only known people reach it; no hand is left from before.
    pub fn open(&self, is_protected: bool) {
        *self.lock() = Board { is_protected: Some(is_protected), lanes: BTreeMap::new() };
    }

    /// Says that there is none any more.
    pub fn close(&self) {
        *self.lock() = Board::default();
    }

    /// Makes the hand of a text: the name under which it is commanded.
    ///
    /// # Errors
    /// In words.
    pub fn device(&self, text: &str) -> Result<ZenohHand, String> {
        check_name(text)?;
        let mut board = self.lock();
        let is_protected = board.is_protected.ok_or(
            "it is commanded by Zenoh, of a session or its host: --zenoh says where (see docs/network.md)",
        )?;
        if board.lanes.contains_key(text) {
            return Err(format!("two hands are called '{text}'"));
        }
        let (hand, lane) = ZenohHand::new(is_protected)?;
        board.lanes.insert(text.to_owned(), lane);
        Ok(hand)
    }

    /// Names of the hands.
    pub fn names(&self) -> Vec<String> {
        self.lock().lanes.keys().cloned().collect()
    }

    /// Does something with a hand, if there is one of this name.
    pub fn with<T>(&self, name: &str, what: impl FnOnce(&mut HandLane) -> T) -> Option<T> {
        self.lock().lanes.get_mut(name).map(what)
    }
}

/// The device.
pub struct ZenohHand {
    hand: RemoteHand,
    end: StationEnd,
    posts: Output<Option<Post>>,
    answers: Input<Option<HandAnswer>>,
    /// Number of the newest post that was taken.
    taken: u64,
}

impl ZenohHand {
    /// What such a hand is: as large as the workspace of a Phantom Omni.
    fn capabilities_of(is_protected: bool) -> Capabilities {
        Capabilities {
            name: if is_protected { MODEL } else { UNPROTECTED_MODEL }.to_owned(),
            workspace: Workspace::centred(Vector3::new(0.16, 0.12, 0.07)),
            max_force_newtons: 3.3,
            max_torque: 0.0,
            max_stiffness: 2_000.0,
            input_dofs: Dofs::Six,
            output_dofs: Dofs::Three,
            apparent_mass: 0.045,
        }
    }

    /// The device, and the node's end of it.
    ///
    /// # Errors
    /// In words, when limits make no sense.
    pub fn new(is_protected: bool) -> Result<(Self, HandLane), String> {
        let capabilities = Self::capabilities_of(is_protected);
        let (hand, end) = RemoteHand::alone(HAND, DoorLimits::default(), capabilities)
            .map_err(|error| error.to_string())?;
        let (posts_in, posts) = triple_buffer(&None);
        let (answers, answers_out) = triple_buffer(&None);
        let lane = HandLane {
            claims: Claims::new(None),
            posts: posts_in,
            answers: answers_out,
            control: end.control().clone(),
            posted: 0,
            refused: 0,
        };
        Ok((Self { hand, end, posts, answers, taken: 0 }, lane))
    }

    fn publish(&mut self) {
        let answer = *self.end.answer();
        self.answers.write(Some(answer));
    }
}

impl HapticDevice for ZenohHand {
    fn capabilities(&self) -> &Capabilities {
        self.hand.capabilities()
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.hand.open(now_ns)
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        if let Some(post) = *self.posts.read()
            && post.number != self.taken
        {
            self.taken = post.number;
            self.end.post(post.claimant, SimTime(now_ns), &post.sample);
        }
        let state = self.hand.read(now_ns);
        self.publish();
        state
    }

    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        let written = self.hand.write(now_ns, wrench);
        self.publish();
        written
    }

    fn close(&mut self) {
        self.hand.close();
        self.publish();
    }
}

#[cfg(test)]
#[path = "hand_tests.rs"]
mod tests;
