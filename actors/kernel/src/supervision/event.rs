//! What the supervisor is told, what it orders, and what it keeps for the report.

use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

/// Position of a child in the start order of the whole tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChildId(pub u16);

/// Why a child ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", content = "message")]
pub enum Cause {
    /// It panicked; the text of the panic.
    Panic(String),
    /// It returned an error; its text.
    Error(String),
    /// It ended by itself or was asked to.
    Stop,
    /// Its heart did not beat within the limit.
    Stall,
    /// Its construction did not end within the limit.
    StartTimeout,
}

impl Cause {
    /// Whether a transient child restarts after it.
    pub const fn is_abnormal(&self) -> bool {
        !matches!(self, Self::Stop)
    }
}

/// What happened. Events that carry the number of an older incarnation come from a corpse and are ignored.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Construction ended well.
    Started {
        /// Who.
        child: ChildId,
        /// In which life.
        incarnation: u32,
    },
    /// The first tick of this life ended well.
    Resumed {
        /// Who.
        child: ChildId,
        /// In which life.
        incarnation: u32,
    },
    /// It ended, and its thread is free again.
    Died {
        /// Who.
        child: ChildId,
        /// In which life.
        incarnation: u32,
        /// Why.
        cause: Cause,
    },
    /// The watchdog missed its heartbeat.
    Stalled {
        /// Who.
        child: ChildId,
        /// In which life.
        incarnation: u32,
    },
    /// It began to miss ticks, or ceased to.
    Late {
        /// Who.
        child: ChildId,
        /// Whether it is late now.
        late: bool,
    },
    /// It is paused on purpose, or runs again.
    Held {
        /// Who.
        child: ChildId,
        /// Whether it is held now.
        held: bool,
    },
    /// A thread that had been abandoned came to its end after all.
    ZombieEnded,
    /// Time passed.
    Tick,
    /// The session shall end.
    ShutdownRequested {
        /// Exit code of the session.
        code: i32,
    },
}

/// What the driver must do, in the order given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// Refuse everything of this writer below `epoch`, before anything else.
    Fence {
        /// Whose words.
        child: ChildId,
        /// The lowest epoch that is still heard.
        epoch: u32,
    },
    /// Build it; its epoch is the incarnation.
    Start {
        /// Whom.
        child: ChildId,
        /// Number of its life, from 1.
        incarnation: u32,
        /// Whether it needs a fresh thread, because the old one never came back.
        fresh: bool,
    },
    /// Ask it to end; answered by [`Event::Died`].
    Stop {
        /// Whom.
        child: ChildId,
    },
    /// Demote its thread and never wait for it again.
    Abandon {
        /// Whom.
        child: ChildId,
        /// Which life.
        incarnation: u32,
    },
    /// Set every device's force to zero.
    ZeroForces,
    /// Write out and close the recording.
    CloseRecording,
    /// End the session with this code.
    Exit(i32),
}

/// How a child is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Health {
    /// Being built for the first time.
    Starting,
    /// Ticks on time.
    Healthy,
    /// Ticks, but misses some.
    Late,
    /// Its heart stands still; a replacement is on its way.
    Stalled,
    /// Ended, waiting for its next life.
    Restarting,
    /// Paused on purpose, or for having failed too often.
    Held,
    /// Ended for good by a failure.
    Failed,
    /// Ended for good as it should.
    Stopped,
}

impl Health {
    /// Its name in tables and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Healthy => "healthy",
            Self::Late => "late",
            Self::Stalled => "stalled",
            Self::Restarting => "restarting",
            Self::Held => "held",
            Self::Failed => "failed",
            Self::Stopped => "stopped",
        }
    }
}

/// One failure of one child, as the report shows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Incident {
    /// Name of the child.
    pub child: String,
    /// Why it ended.
    pub cause: Cause,
    /// When the supervisor learnt of it.
    pub detected: SimTime,
    /// When its next life was built.
    pub restarted: Option<SimTime>,
    /// When that life's first tick was done.
    pub resumed: Option<SimTime>,
}
