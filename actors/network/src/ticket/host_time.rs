//! Host time: what a host's clocks show when it judges a ticket or a station that returns.
//!
//! | who | is judged by | so that |
//! |---|---|---|
//! | a ticket that nobody has used | the later one of the two clocks, and what later tickets show | a wall clock that is set back lets no expired ticket in |
//! | a station that returns | the steady clock | a wall clock that is set, in whatever direction, neither keeps it out nor lengthens its time |
//!
//! The steady clock begins with the wall clock when the program starts. Whoever sets the wall clock back *and* has the
//! program started again gains by that: an unused ticket or a stolen resume secret lives longer, as far as no later ticket
//! in the book shows what time it was. What is spent or withdrawn stays so, whatever the clocks show.

/// Seconds since 1970, by both clocks of a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostTime {
    /// By the wall clock, which somebody may set while the host runs.
    pub wall: u64,
    /// By a clock that nobody sets: the wall clock at the start of the program, and the time that has passed since.
    pub steady: u64,
}

impl HostTime {
    /// The later one.
    pub fn latest(self) -> u64 {
        self.wall.max(self.steady)
    }
}

/// Both clocks show the same.
impl From<u64> for HostTime {
    fn from(unix_secs: u64) -> Self {
        Self { wall: unix_secs, steady: unix_secs }
    }
}
