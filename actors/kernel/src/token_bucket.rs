//! Token bucket that limits a writer's commands at its own handle (Turner, "New directions in communications (or which
//! way to the information age?)", 1986).
//!
//! Commands cost the Model about the same each, and the Model processes whole batches. Therefore both the command rate
//! and the batch size are bounded, at the sender's handle.

use trocar_scene::{Commands, SimTime};

/// Flow limit of a writer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowLimit {
    /// Commands per second in the long run, > 0.
    pub commands_per_sec: f64,
    /// Most commands at once: a batch of more is never sent.
    pub burst: u32,
}

impl FlowLimit {
    /// No limit except the ring's capacity.
    pub const UNLIMITED: Self = Self { commands_per_sec: f64::INFINITY, burst: u32::MAX };
}

/// 250,000 commands per second, which takes the Model about a tenth of a core, and 8,192 at once, which delay the other
/// writers by about two milliseconds. The controllers of the peg transfer send 40,000 per second together.
impl Default for FlowLimit {
    fn default() -> Self {
        Self { commands_per_sec: 250_000.0, burst: 8_192 }
    }
}

/// Token bucket of one writer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TokenBucket {
    limit: FlowLimit,
    tokens: f64,
    at: SimTime,
}

impl TokenBucket {
    pub(crate) fn new(limit: FlowLimit) -> Self {
        Self { limit, tokens: f64::from(limit.burst), at: SimTime::ZERO }
    }

    /// Whether `count` commands may be sent at `now`; if so their tokens are spent.
    pub(crate) fn admit(&mut self, count: usize, now: SimTime) -> bool {
        if self.limit == FlowLimit::UNLIMITED {
            return true;
        }
        let earned = now.since(self.at).as_secs_f64() * self.limit.commands_per_sec;
        self.at = self.at.max(now);
        self.tokens = (self.tokens + earned).min(f64::from(self.limit.burst));
        let count = count as f64;
        if count > self.tokens {
            return false;
        }
        self.tokens -= count;
        true
    }
}

/// Number of commands in a batch.
pub(crate) fn count(commands: &Commands) -> usize {
    commands.puts().map(|(_, puts)| puts.len()).sum::<usize>()
        + commands.removes().len()
        + commands.spawns().len()
        + commands.despawns().len()
        + commands.events().len()
        + commands.transfers().len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_holds_in_the_long_run_and_the_burst_at_once() {
        let mut bucket = TokenBucket::new(FlowLimit { commands_per_sec: 1_000.0, burst: 50 });
        assert!(bucket.admit(50, SimTime::ZERO) && !bucket.admit(1, SimTime::ZERO));
        assert!(!bucket.admit(51, SimTime::from_millis(10_000)), "never more than the burst");
        let mut sent = 0;
        for ms in 10_000..20_000 {
            for _ in 0..5 {
                sent += u32::from(bucket.admit(1, SimTime::from_millis(ms)));
            }
        }
        assert!((10_000..=10_050).contains(&sent), "{sent}");
    }

    #[test]
    fn a_clock_that_goes_back_earns_nothing() {
        let mut bucket = TokenBucket::new(FlowLimit { commands_per_sec: 1_000.0, burst: 10 });
        assert!(bucket.admit(10, SimTime::from_millis(100)));
        assert!(!bucket.admit(1, SimTime::from_millis(50)));
        assert!(!bucket.admit(2, SimTime::from_millis(101)) && bucket.admit(1, SimTime::from_millis(101)));
    }

    #[test]
    fn no_limit_is_none() {
        let mut bucket = TokenBucket::new(FlowLimit::UNLIMITED);
        assert!(bucket.admit(usize::MAX, SimTime::ZERO));
    }
}
