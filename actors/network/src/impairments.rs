//! What a path does to datagrams, as numbers: delay, loss, bursts, reordering, duplication, corruption, a limited rate.
//!
//! The faults themselves are the kernel's ([`LinkFaults`]); fault plans begin and end them at their times. Here they hold
//! from the start, for the packet reflector, for links in virtual time, and for benches.

use thiserror::Error;
use trocar_kernel::faults::{LinkFaults, Message};
use trocar_kernel::spec::{FaultKind, FaultOrder};
use trocar_scene::SimTime;

/// Longest delay of a path.
pub const DELAY_MAX: SimTime = SimTime::from_millis(60_000);
/// Most delays of a trace.
pub const TRACE_MAX: usize = 1_000_000;
/// Time between two delays of a trace that does not tell times.
pub const TRACE_EVERY: SimTime = SimTime::from_millis(10);
/// Least time between two delays of a trace that does \[s\].
const TRACE_STEP_MIN: f64 = 1e-6;

/// A path between two stations, one way.
#[derive(Clone, Debug, PartialEq)]
pub struct Impairments {
    /// Delay of every datagram; without effect beside a trace.
    pub delay: SimTime,
    /// Largest deviation from the delay, evenly spread.
    pub jitter: SimTime,
    /// Whether each datagram has its own delay, so that later ones overtake; otherwise a path keeps the order.
    pub independent: bool,
    /// Delays along time, over and over.
    pub trace: DelayTrace,
    /// Share of lost datagrams.
    pub loss: f64,
    /// Mean length of a burst of losses, in datagrams; below 1 each is lost for itself.
    pub burst: f64,
    /// Share that arrives twice.
    pub duplicate: f64,
    /// Share that is overtaken by the next one.
    pub reorder: f64,
    /// Share of which bits flip.
    pub corrupt: f64,
    /// Bytes per second that pass; `None` for any number.
    pub bytes_per_sec: Option<f64>,
    /// How long a datagram waits for a limited rate before it is lost.
    pub queue: SimTime,
}

impl Default for Impairments {
    fn default() -> Self {
        Self {
            delay: SimTime::ZERO,
            jitter: SimTime::ZERO,
            independent: false,
            trace: DelayTrace::default(),
            loss: 0.0,
            burst: 0.0,
            duplicate: 0.0,
            reorder: 0.0,
            corrupt: 0.0,
            bytes_per_sec: None,
            queue: SimTime::from_millis(200),
        }
    }
}

impl Impairments {
    /// A path that only takes time.
    pub fn delay(delay: SimTime) -> Self {
        Self { delay, ..Self::default() }
    }

    /// A link with these faults; the same seed gives the same luck.
    pub fn link<M: Message>(&self, seed: u64) -> LinkFaults<M> {
        let mut link = LinkFaults::default();
        self.orders(seed).iter().for_each(|order| link.apply(order));
        link
    }

    /// The faults as orders that begin at once.
    pub fn orders(&self, seed: u64) -> Vec<FaultOrder> {
        let mut orders = Vec::new();
        let mut add = |kind: FaultKind, fill: &dyn Fn(&mut FaultOrder)| {
            let index = orders.len() as u32;
            let mut order = FaultOrder {
                index,
                target: String::new(),
                kind,
                begins: true,
                span: SimTime::ZERO,
                jitter: SimTime::ZERO,
                independent: false,
                delays: Vec::new(),
                every: SimTime::ZERO,
                burst: 0.0,
                probability: 1.0,
                bytes_per_sec: 0.0,
                seed: seed.wrapping_add(u64::from(index)),
            };
            fill(&mut order);
            orders.push(order);
        };
        if !self.trace.delays.is_empty() {
            add(FaultKind::Delay, &|order| {
                order.delays.clone_from(&self.trace.delays);
                order.every = self.trace.every;
                order.independent = self.independent;
            });
        } else if self.delay > SimTime::ZERO || self.jitter > SimTime::ZERO {
            add(FaultKind::Delay, &|order| {
                (order.span, order.jitter) = (self.delay, self.jitter);
                order.independent = self.independent;
            });
        }
        let shares = [
            (FaultKind::Drop, self.loss),
            (FaultKind::Duplicate, self.duplicate),
            (FaultKind::Reorder, self.reorder),
            (FaultKind::Corrupt, self.corrupt),
        ];
        for (kind, share) in shares.into_iter().filter(|(_, share)| *share > 0.0) {
            add(kind, &|order| {
                order.probability = share;
                order.burst = if kind == FaultKind::Drop { self.burst } else { 0.0 };
            });
        }
        if let Some(bytes_per_sec) = self.bytes_per_sec {
            add(FaultKind::RateLimit, &|order| {
                (order.bytes_per_sec, order.span) = (bytes_per_sec, self.queue);
            });
        }
        orders
    }
}

/// Delays along time, measured or made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DelayTrace {
    /// One after the other.
    pub delays: Vec<SimTime>,
    /// Time from one to the next.
    pub every: SimTime,
}

/// Why a text is no trace of delays.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TraceError {
    /// Nothing in it.
    #[error("no delay in it; valid: a line for each, in seconds, or two columns time,delay in seconds")]
    Empty,
    /// Too long.
    #[error("more than {TRACE_MAX} delays")]
    TooLong,
    /// A line that is no number, or one out of range.
    #[error("line {line}: '{text}'; valid: a delay from 0 to 60 s, or time,delay in seconds")]
    Line {
        /// Number of the line.
        line: usize,
        /// What it says.
        text: String,
    },
    /// Times that do not grow evenly.
    #[error(
        "line {line}: {found} s after the line before, the first two are {expected} s apart; valid: even steps of 1 µs or more"
    )]
    Uneven {
        /// Number of the line.
        line: usize,
        /// Seconds between it and the line before.
        found: f64,
        /// Seconds between the first two.
        expected: f64,
    },
}

impl DelayTrace {
    /// Reads a trace: a delay \[s\] a line, each for 10 ms, or `time,delay` in even steps of time. Empty lines, lines with
    /// `#` and a first line of names are passed over.
    ///
    /// # Errors
    /// [`TraceError`] with the line.
    pub fn parse(text: &str) -> Result<Self, TraceError> {
        let mut trace = Self { delays: Vec::new(), every: TRACE_EVERY };
        let mut before: Option<f64> = None;
        let mut step: Option<f64> = None;
        for (index, whole) in text.lines().enumerate() {
            let line = index + 1;
            let content = whole.trim();
            if content.is_empty() || content.starts_with('#') {
                continue;
            }
            let wrong = || TraceError::Line { line, text: content.chars().take(60).collect() };
            let mut numbers = content.split(',').map(|part| part.trim().parse::<f64>());
            let columns = match (numbers.next(), numbers.next(), numbers.next()) {
                (Some(Ok(delay)), None, _) => (None, delay),
                (Some(Ok(time)), Some(Ok(delay)), None) => (Some(time), delay),
                // Names of columns.
                _ if trace.delays.is_empty()
                    && before.is_none()
                    && content.starts_with(char::is_alphabetic) =>
                {
                    continue;
                }
                _ => return Err(wrong()),
            };
            let (time, delay) = columns;
            if !(0.0..=DELAY_MAX.as_secs_f64()).contains(&delay) || time.is_some_and(|time| !time.is_finite())
            {
                return Err(wrong());
            }
            if !trace.delays.is_empty() && time.is_some() != before.is_some() {
                return Err(wrong());
            }
            if let (Some(time), Some(before)) = (time, before) {
                let found = time - before;
                let expected = *step.get_or_insert(found);
                if !(found >= TRACE_STEP_MIN && (found - expected).abs() <= 1e-3 * expected + 1e-6) {
                    return Err(TraceError::Uneven { line, found, expected });
                }
            }
            before = time;
            if trace.delays.len() >= TRACE_MAX {
                return Err(TraceError::TooLong);
            }
            trace.delays.push(SimTime::from_secs_f64(delay));
        }
        if trace.delays.is_empty() {
            return Err(TraceError::Empty);
        }
        trace.every = step.map_or(TRACE_EVERY, SimTime::from_secs_f64);
        Ok(trace)
    }

    /// Mean of the delays.
    pub fn mean(&self) -> SimTime {
        let sum: u128 = self.delays.iter().map(|delay| u128::from(delay.as_nanos())).sum();
        SimTime((sum / self.delays.len().max(1) as u128) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_trace_is_a_column_of_delays_or_times_with_delays() {
        let plain = DelayTrace::parse("# measured\n0.070\n\n0.080\n").expect("a trace");
        assert_eq!(plain.delays, [70, 80].map(SimTime::from_millis));
        assert_eq!((plain.every, plain.mean()), (TRACE_EVERY, SimTime::from_millis(75)));
        let timed = DelayTrace::parse("time,delay\n0,0.1\n0.5,0.2\n1.0,0.3\n").expect("a trace");
        assert_eq!((timed.delays.len(), timed.every), (3, SimTime::from_millis(500)));
    }

    #[test]
    fn what_is_no_trace_is_refused_with_its_line() {
        assert_eq!(DelayTrace::parse("# nothing\n"), Err(TraceError::Empty));
        for (text, line) in
            [("0.1\nx\n", 2), ("0.1\n-0.1", 2), ("61", 1), ("0.1\n0.2,0.3", 2), ("1,2,3", 1), ("nan", 1)]
        {
            let error = DelayTrace::parse(text).expect_err(text);
            assert!(
                matches!(error, TraceError::Line { line: found, .. } if found == line),
                "{text}: {error}"
            );
        }
        let uneven = DelayTrace::parse("0,0.1\n1,0.1\n3,0.1").expect_err("uneven");
        assert_eq!(uneven, TraceError::Uneven { line: 3, found: 2.0, expected: 1.0 });
        // A step that would round to no time at all.
        let short = DelayTrace::parse("0,0.1\n1e-10,0.1").expect_err("too short");
        assert_eq!(short, TraceError::Uneven { line: 2, found: 1e-10, expected: 1e-10 });
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn any_text_is_a_trace_or_refused(text in "[-0-9.,e#\n a-z]{0,80}") {
            if let Ok(trace) = DelayTrace::parse(&text) {
                prop_assert!(!trace.delays.is_empty() && trace.every > SimTime::ZERO);
                prop_assert!(trace.delays.iter().all(|delay| *delay <= DELAY_MAX));
            }
        }

        #[test]
        fn times_in_even_steps_are_a_trace_of_that_step(
            exponent in -14_i32..9, digit in 1_u32..10, delays in prop::collection::vec(-0.1_f64..61.0, 2..20),
        ) {
            let step = f64::from(digit) * 10_f64.powi(exponent);
            let lines = delays.iter().enumerate().map(|(k, delay)| format!("{:e},{delay}\n", k as f64 * step));
            match DelayTrace::parse(&lines.collect::<String>()) {
                Ok(trace) => {
                    prop_assert!(trace.every >= SimTime::from_micros(1) && trace.delays.len() == delays.len());
                    prop_assert!((trace.every.as_secs_f64() - step).abs() <= 1e-9 + 1e-6 * step);
                }
                Err(TraceError::Uneven { .. }) => prop_assert!(step < 1.01e-6),
                Err(_) => prop_assert!(delays.iter().any(|delay| !(0.0..=60.0).contains(delay))),
            }
        }
    }
}
