//! Time budget of a controller within its period: a pure rule, without a clock.

use trocar_scene::SimTime;

/// Largest share of a period that step and spin may take together.
pub const SHARE_MAX: f64 = 0.8;
/// Ticks over which breaches are counted.
pub const WINDOW: u32 = 64;
/// Breaches within the window that trigger a verdict.
pub const BREACHES_MAX: u32 = 32;

/// Consequence of the last tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// No change.
    Keep,
    /// Stop spinning: the ticker sleeps until the due time.
    StopSpinning,
    /// Give up real-time priority: the steps alone are too long, and the system would throttle all real-time threads.
    Demote,
    /// Spin again: a whole window was within budget.
    Spin,
}

/// Watches a controller's use of its periods.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    limit: SimTime,
    spin: SimTime,
    spins: bool,
    demoted: bool,
    ticks: u32,
    breaches: u32,
}

impl Budget {
    /// Budget for a period, with the ticker's longest spin.
    pub fn new(period: SimTime, spin: SimTime) -> Self {
        let limit = SimTime::from_secs_f64(period.as_secs_f64() * SHARE_MAX);
        Self { limit, spin, spins: spin < limit, demoted: false, ticks: 0, breaches: 0 }
    }
    /// Whether the ticker may spin at all.
    pub fn may_spin(&self) -> bool {
        self.spins
    }
    /// Whether real-time priority was given up.
    pub fn is_demoted(&self) -> bool {
        self.demoted
    }
    /// Judges one tick whose step took `step`.
    pub fn observe(&mut self, step: SimTime) -> Verdict {
        self.ticks += 1;
        // The check counts the spin even while it is off, so that spinning resumes only when it fits the budget.
        let with_spin = step + self.spin > self.limit;
        let alone = step > self.limit;
        if if self.spins { with_spin } else { alone } {
            self.breaches += 1;
        }
        if self.breaches > BREACHES_MAX {
            self.ticks = 0;
            self.breaches = 0;
            if self.spins {
                self.spins = false;
                return Verdict::StopSpinning;
            }
            if !self.demoted {
                self.demoted = true;
                return Verdict::Demote;
            }
            return Verdict::Keep;
        }
        if self.ticks >= WINDOW {
            let quiet = self.breaches == 0 && !with_spin && !self.spins && self.spin < self.limit;
            self.ticks = 0;
            self.breaches = 0;
            if quiet {
                self.spins = true;
                return Verdict::Spin;
            }
        }
        Verdict::Keep
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(micros: u64) -> SimTime {
        SimTime::from_micros(micros)
    }

    #[test]
    fn short_steps_change_nothing() {
        let mut budget = Budget::new(us(1_000), us(30));
        assert!((0..10_000).all(|_| budget.observe(us(700)) == Verdict::Keep));
        assert!(budget.may_spin());
    }

    #[test]
    fn a_single_long_step_is_forgiven() {
        let mut budget = Budget::new(us(1_000), us(30));
        for n in 0..1_000 {
            assert_eq!(budget.observe(if n % 10 == 0 { us(5_000) } else { us(100) }), Verdict::Keep);
        }
    }

    #[test]
    fn repeated_breach_stops_the_spin_first_and_demotes_next_and_only_once() {
        let mut budget = Budget::new(us(1_000), us(30));
        let verdicts: Vec<Verdict> =
            (0..1_000).map(|_| budget.observe(us(900))).filter(|v| *v != Verdict::Keep).collect();
        assert_eq!(verdicts, [Verdict::StopSpinning, Verdict::Demote]);
        assert!(budget.is_demoted());
    }

    #[test]
    fn spinning_comes_back_after_a_quiet_window() {
        let mut budget = Budget::new(us(1_000), us(30));
        while budget.observe(us(790)) != Verdict::StopSpinning {}
        assert!((0..WINDOW).any(|_| budget.observe(us(100)) == Verdict::Spin));
        assert!(budget.may_spin() && !budget.is_demoted());
    }

    #[test]
    fn a_period_too_short_for_the_spin_never_spins() {
        let budget = Budget::new(us(30), us(30));
        assert!(!budget.may_spin());
    }
}
