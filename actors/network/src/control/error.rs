//! Why a station is not let in, why it may not do something, and why a connection ended: with the words that a person
//! reads, and the class of the exit code.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::SimTime;

use super::component_list::{ComponentDifference, ComponentList};
use super::frame::FrameError;
use super::keep_alive::SILENCE_MAX;
use super::manifest::CountsDiffer;
use super::message_error::MessageError;
use super::note::NoteRefusal;
use super::outbox::OutboxError;
use super::plain_text::PlainText;
use crate::ticket::{PlainName, Refused, Role};

/// Within this difference \[s\] an expiry may be a clock's fault: one hour of summer time, and some.
const CLOCK_SUSPECTED_SECS: u64 = 2 * 3_600;

/// What the exit code of a program tells, as in BSD's `sysexits.h` where our own codes have no word for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExitClass {
    /// All went well: the session is over.
    Done,
    /// The request names something that is not there.
    Usage,
    /// The scenario does not fit.
    Scenario,
    /// The host cannot be reached, or is gone.
    Unavailable,
    /// A fault within the program.
    Internal,
    /// It may work later: full, taken, too slow.
    Later,
    /// The two programs do not understand each other.
    Protocol,
    /// Ticket or role do not allow it.
    NotAllowed,
}

impl ExitClass {
    /// The exit code.
    pub const fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Usage => 2,
            Self::Scenario => 4,
            Self::Unavailable => 69,
            Self::Internal => 70,
            Self::Later => 75,
            Self::Protocol => 76,
            Self::NotAllowed => 77,
        }
    }
}

/// Why a host does not do what a station asks for. It goes over the wire.
#[derive(Clone, Debug, PartialEq, Eq, Error, Serialize, Deserialize)]
pub enum Refusal {
    /// The ticket or the resume secret does not let in.
    #[error("{}{}", .0, clock_hint(.0))]
    Ticket(Refused),
    /// The programs know other components.
    #[error("the host's program knows other components ({} of them); use the same release and plugins", .0.components().len())]
    OtherRegistry(ComponentList),
    /// The station has another scenario.
    #[error(
        "the session's scenario '{name}' is another one than the station's; use the same file at both ends"
    )]
    ScenarioDiffers {
        /// Name of the host's.
        name: PlainText,
    },
    /// Somebody has the hand.
    #[error("the hand '{hand}' is taken by '{by}'; wait until it is given back, or ask for another one")]
    HandTaken {
        /// The hand.
        hand: PlainText,
        /// Name of the station.
        by: PlainName,
    },
    /// No such hand.
    #[error("the session has no hand '{hand}'; {}", valid_hands(valid))]
    HandUnknown {
        /// What was asked for.
        hand: PlainText,
        /// The hands of the session.
        valid: Vec<PlainName>,
    },
    /// The hand is not the station's own.
    #[error(
        "the hand '{hand}' is not served by this station, so that it cannot give it back or hand it over"
    )]
    HandNotServed {
        /// The hand.
        hand: PlainText,
    },
    /// No room.
    #[error("the session is full: {most} stations are there; try again when one has left")]
    SessionFull {
        /// How many fit.
        most: u16,
    },
    /// Another station of the same name is there.
    #[error("a station named '{name}' is there already; choose another name")]
    NameTaken {
        /// The name.
        name: PlainName,
    },
    /// The ticket gives fewer rights than asked for.
    #[error(
        "the ticket is for the role {granted}, and {wished} was asked for; ask the host for a ticket of that role"
    )]
    RoleTooHigh {
        /// Role of the ticket.
        granted: Role,
        /// Role that the station asked for.
        wished: Role,
    },
    /// The role does not allow it.
    #[error("a station of the role {role} may not {deed}")]
    NotAllowed {
        /// Role of the station.
        role: Role,
        /// What it tried.
        deed: PlainText,
    },
    /// The host has a trouble of its own.
    #[error("the host cannot do it now: {0}")]
    HostTrouble(PlainText),
    /// What the station shows cannot be shown.
    #[error(transparent)]
    Note(#[from] NoteRefusal),
}

impl Refusal {
    /// Class of the exit code.
    pub fn exit_class(&self) -> ExitClass {
        match self {
            Self::Ticket(_)
            | Self::RoleTooHigh { .. }
            | Self::NotAllowed { .. }
            | Self::HandNotServed { .. } => ExitClass::NotAllowed,
            Self::OtherRegistry(_) => ExitClass::Protocol,
            Self::ScenarioDiffers { .. } => ExitClass::Scenario,
            Self::HandUnknown { .. } | Self::NameTaken { .. } => ExitClass::Usage,
            Self::HandTaken { .. } | Self::SessionFull { .. } | Self::HostTrouble(_) | Self::Note(_) => {
                ExitClass::Later
            }
        }
    }

    /// A role that does not allow something.
    pub fn not_allowed(role: Role, deed: &str) -> Self {
        Self::NotAllowed { role, deed: PlainText::new(deed) }
    }
}

fn valid_hands(valid: &[PlainName]) -> String {
    if valid.is_empty() {
        return "it has none at all".to_owned();
    }
    let names: Vec<_> = valid.iter().map(PlainName::as_str).collect();
    format!("valid are {}", names.join(", "))
}

fn clock_hint(refused: &Refused) -> &'static str {
    match refused {
        Refused::Expired { expired_at, now } if now.saturating_sub(*expired_at) <= CLOCK_SUSPECTED_SECS => {
            " (by so little that a clock may be wrong: compare the clocks of both computers)"
        }
        Refused::ClockWentBack { issued_at, now }
            if issued_at.saturating_sub(*now) <= CLOCK_SUSPECTED_SECS =>
        {
            " (by so little that a clock may be wrong: compare the clocks of both computers)"
        }
        _ => "",
    }
}

/// Why one side ends the session with the other. It goes over the wire.
#[derive(Clone, Debug, PartialEq, Eq, Error, Serialize, Deserialize)]
pub enum Goodbye {
    /// The station leaves.
    #[error("the station left")]
    Leaves,
    /// The host's session is over.
    #[error("the host ended the session")]
    SessionOver,
    /// The station came back over another connection.
    #[error("the station came back over another connection, which replaces this one")]
    Superseded,
    /// The host withdrew the ticket.
    #[error("the host withdrew the ticket")]
    Revoked,
    /// The station does not follow.
    #[error("the station was too slow to follow: {0}")]
    TooSlow(PlainText),
    /// The other side broke the protocol.
    #[error("the other side gave up: {0}")]
    Broken(PlainText),
}

impl Goodbye {
    /// Class of the exit code.
    pub fn exit_class(&self) -> ExitClass {
        match self {
            Self::Leaves | Self::SessionOver | Self::Superseded => ExitClass::Done,
            Self::Revoked => ExitClass::NotAllowed,
            Self::TooSlow(_) => ExitClass::Later,
            Self::Broken(_) => ExitClass::Protocol,
        }
    }
}

/// Why a connection of the control channel, or a session over it, ended.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ControlError {
    /// No frame of ours, or of another version.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// A frame that is no message.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// A message that has no place there.
    #[error("the message '{message}' is not valid {state}")]
    Unexpected {
        /// The message.
        message: &'static str,
        /// Where in the session.
        state: &'static str,
    },
    /// The opening took too long.
    #[error("the other side did not finish its opening within {}", .0)]
    SlowOpening(SimTime),
    /// Getting and building the scene took too long.
    #[error("the station did not have the scene within {}", .0)]
    SlowJoin(SimTime),
    /// The other side does not take what is sent.
    #[error("the other side is too slow to follow: {0}")]
    TooSlow(OutboxError),
    /// A message of this side is beyond what can be sent.
    #[error("this program made a message that cannot be sent: {0}")]
    Unsendable(OutboxError),
    /// The stream takes nothing.
    #[error("the other side is too slow to follow: it took nothing for {0}")]
    Stalled(SimTime),
    /// Nothing was heard.
    #[error("nothing was heard from the other side for {SILENCE_MAX}")]
    Silent,
    /// The stream closed or failed.
    #[error("the connection broke: {0}")]
    Broke(PlainText),
    /// The host refused.
    #[error("{}", refused_text(refusal, difference))]
    Refused {
        /// What the host says.
        refusal: Refusal,
        /// For [`Refusal::OtherRegistry`]: in what the two differ.
        difference: ComponentDifference,
    },
    /// The other side ended it.
    #[error(transparent)]
    Goodbye(Goodbye),
    /// This side ended it.
    #[error("ended here: {0}")]
    Ended(Goodbye),
    /// The scene's bytes are not those that the host announced.
    #[error("the scene arrived damaged: its {bytes} bytes do not have the hash that the host announced")]
    SceneHash {
        /// How many.
        bytes: u32,
    },
    /// A part of the scene is not the next one.
    #[error("a part of the scene begins at byte {offset}; byte {expected} is next, of {bytes}")]
    ScenePart {
        /// Where it begins.
        offset: u32,
        /// Where the next one begins.
        expected: u32,
        /// Bytes of the scene.
        bytes: u32,
    },
    /// The scene that was built lacks something.
    #[error("the scene is not complete: {0}")]
    SceneCounts(CountsDiffer),
    /// The scene that was built is another one.
    #[error(
        "the scene of revision {revision} that the station built is not the host's: their digests differ"
    )]
    SceneDigest {
        /// The revision.
        revision: u64,
    },
    /// The station cannot build the scene.
    #[error("the station cannot build the scene: {0}")]
    SceneInvalid(PlainText),
    /// The station kept asking for what it may not do.
    #[error("{0} requests of the station were refused, which is no oversight any more")]
    TooManyRefusals(u32),
    /// No connection for too long; the last error.
    #[error("the host could not be reached for {0}; the last attempt: {1}")]
    Lost(SimTime, PlainText),
}

fn refused_text(refusal: &Refusal, difference: &ComponentDifference) -> String {
    match refusal {
        Refusal::OtherRegistry(_) => {
            format!(
                "the host's program knows other components: {difference}; use the same release and plugins"
            )
        }
        other => other.to_string(),
    }
}

impl ControlError {
    /// Class of the exit code.
    pub fn exit_class(&self) -> ExitClass {
        match self {
            Self::Refused { refusal, .. } => refusal.exit_class(),
            Self::Goodbye(goodbye) | Self::Ended(goodbye) => goodbye.exit_class(),
            Self::SlowOpening(_) | Self::SlowJoin(_) | Self::TooSlow(_) | Self::Stalled(_) => {
                ExitClass::Later
            }
            Self::Silent | Self::Broke(_) | Self::Lost(..) => ExitClass::Unavailable,
            Self::TooManyRefusals(_) => ExitClass::NotAllowed,
            Self::Unsendable(_) => ExitClass::Internal,
            Self::Frame(_)
            | Self::Message(_)
            | Self::Unexpected { .. }
            | Self::SceneHash { .. }
            | Self::ScenePart { .. }
            | Self::SceneCounts(_)
            | Self::SceneDigest { .. }
            | Self::SceneInvalid(_) => ExitClass::Protocol,
        }
    }

    /// Whether a program that begins anew cannot mend it either. What is left is a fault of one of the two programs.
    pub fn is_final(&self) -> bool {
        !matches!(self.exit_class(), ExitClass::Protocol | ExitClass::Internal)
    }

    /// What the other side is told of it; `None` where there is nobody to tell, or nothing to say.
    pub(super) fn farewell(&self) -> Option<Goodbye> {
        match self {
            Self::Ended(goodbye) => Some(goodbye.clone()),
            Self::TooSlow(_) | Self::Stalled(_) | Self::SlowJoin(_) => {
                Some(Goodbye::TooSlow(PlainText::new(self.to_string())))
            }
            Self::Goodbye(_) | Self::Broke(_) | Self::Lost(..) | Self::Refused { .. } => None,
            _ => Some(Goodbye::Broken(PlainText::new(self.to_string()))),
        }
    }

    /// Whether a new connection may mend it: the link is to blame, not one of its ends.
    pub fn is_of_the_link(&self) -> bool {
        match self {
            Self::Silent
            | Self::Broke(_)
            | Self::SlowOpening(_)
            | Self::Stalled(_)
            | Self::SceneHash { .. } => true,
            Self::Refused { refusal, .. } => matches!(refusal, Refusal::HostTrouble(_)),
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ticket_that_expired_less_than_two_hours_ago_makes_one_look_at_the_clocks() {
        let expired = |ago: u64| {
            Refusal::Ticket(Refused::Expired { expired_at: 1_795_938_052, now: 1_795_938_052 + ago })
        };
        assert!(expired(3_600).to_string().contains("compare the clocks"), "{}", expired(3_600));
        assert!(!expired(86_400).to_string().contains("compare the clocks"), "{}", expired(86_400));
        let back = Refusal::Ticket(Refused::ClockWentBack { issued_at: 7_200, now: 3_600 });
        assert!(back.to_string().contains("compare the clocks"), "{back}");
    }

    #[test]
    fn a_refusal_names_the_thing_and_what_is_valid() {
        let name = |text: &str| text.parse::<PlainName>().expect("a name");
        let unknown =
            Refusal::HandUnknown { hand: PlainText::new("third"), valid: vec![name("left"), name("right")] };
        assert_eq!(unknown.to_string(), "the session has no hand 'third'; valid are left, right");
        let taken = Refusal::HandTaken { hand: PlainText::new("left"), by: name("Ana") };
        assert!(taken.to_string().contains("'left' is taken by 'Ana'"), "{taken}");
        let role = Refusal::RoleTooHigh { granted: Role::Watch, wished: Role::Operate };
        assert!(role.to_string().contains("for the role watch, and operate"), "{role}");
        assert_eq!(
            Refusal::not_allowed(Role::Watch, "write").to_string(),
            "a station of the role watch may not write"
        );
    }

    #[test]
    fn refusals_have_exit_codes_by_what_a_person_can_do_about_them() {
        assert_eq!(Refusal::Ticket(Refused::Unknown).exit_class().code(), 77);
        assert_eq!(Refusal::SessionFull { most: 4 }.exit_class().code(), 75);
        assert_eq!(Refusal::ScenarioDiffers { name: PlainText::new("x") }.exit_class().code(), 4);
        assert_eq!(ControlError::Goodbye(Goodbye::SessionOver).exit_class().code(), 0);
        assert_eq!(ControlError::Frame(FrameError::NotTrocar).exit_class().code(), 76);
    }
}
