//! Events, actions and incident records of the supervisor.

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
    /// No heartbeat within the limit.
    Stall,
    /// Construction exceeded its limit.
    StartTimeout,
}

impl Cause {
    /// Whether a transient child restarts after this cause.
    pub const fn is_abnormal(&self) -> bool {
        !matches!(self, Self::Stop)
    }
}

/// Input of the supervisor. Events with the number of an older incarnation are ignored.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// Construction ended well.
    Started {
        /// The child.
        child: ChildId,
        /// Its incarnation.
        incarnation: u32,
    },
    /// The first tick of this life ended well.
    Resumed {
        /// The child.
        child: ChildId,
        /// Its incarnation.
        incarnation: u32,
    },
    /// The child ended, and its thread is free again.
    Died {
        /// The child.
        child: ChildId,
        /// Its incarnation.
        incarnation: u32,
        /// Why.
        cause: Cause,
    },
    /// The watchdog missed its heartbeat.
    Stalled {
        /// The child.
        child: ChildId,
        /// Its incarnation.
        incarnation: u32,
    },
    /// The child began or ceased to miss ticks.
    Late {
        /// The child.
        child: ChildId,
        /// Whether it is late now.
        late: bool,
    },
    /// The child was paused on purpose, or resumed.
    Held {
        /// The child.
        child: ChildId,
        /// Whether it is held now.
        held: bool,
    },
    /// An abandoned thread ended.
    ZombieEnded,
    /// Time passed.
    Tick,
    /// A request to end the session.
    ShutdownRequested {
        /// Exit code of the session.
        code: i32,
    },
}

/// Actions for the driver, in the order given.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// First of all, refuse this writer's batches below `epoch`.
    Fence {
        /// The writer.
        child: ChildId,
        /// The lowest epoch still accepted.
        epoch: u32,
    },
    /// Build the child; its epoch is the incarnation.
    Start {
        /// The child.
        child: ChildId,
        /// Number of its life, from 1.
        incarnation: u32,
        /// Whether it needs a new thread, because the old one never returned.
        fresh: bool,
    },
    /// Ask the child to end; [`Event::Died`] reports its end.
    Stop {
        /// The child.
        child: ChildId,
    },
    /// Demote the child's thread and never wait for it again.
    Abandon {
        /// The child.
        child: ChildId,
        /// Its incarnation.
        incarnation: u32,
    },
    /// Set every device's force to zero.
    ZeroForces,
    /// Write out and close the recording.
    CloseRecording,
    /// End the session with this code.
    Exit(i32),
}

/// Health of a child.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Health {
    /// Being built for the first time.
    Starting,
    /// Ticks on time.
    Healthy,
    /// Runs, but misses some ticks.
    Late,
    /// No heartbeat; a replacement is being started.
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
    /// Time at which the supervisor detected it.
    pub detected: SimTime,
    /// Time at which the next life was built.
    pub restarted: Option<SimTime>,
    /// End of that life's first tick.
    pub resumed: Option<SimTime>,
}
