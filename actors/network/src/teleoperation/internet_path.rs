//! A made trace of round trips through the Internet: a path of constant length, with a queue of other people's packets.
//!
//! The trace of the experiment that this project reproduces (a reflector in Seattle, seen from Troy: 150.57 ms in the mean)
//! is not public. This one has the same mean, to the nanosecond. Its variation is that of a queue, by Lindley's recursion
//! ("The theory of queues with a single server", 1952): bursts lengthen it, and it drains at a fifth of a millisecond per
//! millisecond. So no packet would have to overtake another, as on a real path. Only additions, multiplications and
//! comparisons: the same seed gives the same trace on every machine.

use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use crate::impairments::DelayTrace;

/// Mean round trip of the experiment.
pub const MEAN: SimTime = SimTime::from_micros(150_570);
/// Shortest mean for which a trace can be made: below it the queue would be longer than the path.
pub const MEAN_MIN: SimTime = SimTime::from_millis(10);
/// Length of a trace; it then repeats.
const LENGTH_MS: usize = 20_000;
/// Towards its end the queue drains, so that the repetition begins as the trace did.
const DRAINS_MS: usize = 500;
/// What drains in a millisecond \[ns\].
const DRAINED: i64 = 200_000;
/// Share of the milliseconds in which an ordinary burst comes, and its longest delay \[ns\].
const ORDINARY: (f64, f64) = (0.06, 4e6);
/// Share of those in which a long one comes, and its shortest and longest delay \[ns\].
const LONG: (f64, f64, f64) = (0.000_2, 10e6, 40e6);
/// The queue never adds more than this share of the mean.
const QUEUE_SHARE_MAX: f64 = 0.5;

/// A trace of one delay a millisecond with this mean, at least [`MEAN_MIN`].
pub fn trace(mean: SimTime, seed: u64) -> DelayTrace {
    let mean = mean.max(MEAN_MIN);
    let limit = (QUEUE_SHARE_MAX * mean.as_nanos() as f64) as i64;
    let mut random = SplitMix64::new(seed);
    let mut queue = 0_i64;
    let mut queues: Vec<i64> = Vec::with_capacity(LENGTH_MS);
    for ms in 0..LENGTH_MS {
        // Every millisecond draws as often, whatever comes of it.
        let [ordinary, length, long, long_length] = [(); 4].map(|()| random.unit());
        let mut burst = 0.0;
        if ordinary < ORDINARY.0 {
            burst += ORDINARY.1 * length;
        }
        if long < LONG.0 {
            burst += LONG.1 + (LONG.2 - LONG.1) * long_length;
        }
        let comes = if ms + DRAINS_MS < LENGTH_MS { burst as i64 } else { 0 };
        queue = (queue - DRAINED + comes).clamp(0, limit);
        queues.push(queue);
    }
    // The rest of the division goes to the first delays, a nanosecond each.
    let count = LENGTH_MS as i64;
    let missing = mean.as_nanos() as i64 * count - queues.iter().sum::<i64>();
    let (base, rest) = (missing.div_euclid(count), missing.rem_euclid(count));
    let delay = |(place, queue): (usize, &i64)| {
        let nanos = base + queue + i64::from((place as i64) < rest);
        SimTime(nanos.max(0) as u64)
    };
    DelayTrace { delays: queues.iter().enumerate().map(delay).collect(), every: SimTime::from_millis(1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trace_has_its_mean_to_the_nanosecond_and_lets_no_packet_overtake() {
        for (mean, seed) in
            [(MEAN, 1), (MEAN, 2), (SimTime::from_millis(10), 1), (SimTime::from_millis(900), 7)]
        {
            let trace = trace(mean, seed);
            assert_eq!(trace.mean(), mean);
            assert_eq!(trace.delays.len() as u64 * trace.every.as_nanos(), 20_000_000_000);
            let repeated = trace.delays.iter().zip(trace.delays.iter().cycle().skip(1));
            for (earlier, later) in repeated {
                assert!(earlier.since(*later) <= SimTime(201_000), "{earlier} then {later}");
            }
        }
    }

    #[test]
    fn it_varies_as_a_path_does_and_each_seed_has_its_own() {
        let one = trace(MEAN, 1);
        assert_eq!(one, trace(MEAN, 1));
        assert_ne!(one, trace(MEAN, 2));
        let mean = one.mean().as_secs_f64();
        let square = |delay: &SimTime| (delay.as_secs_f64() - mean).powi(2);
        let deviation = (one.delays.iter().map(square).sum::<f64>() / one.delays.len() as f64).sqrt();
        assert!((0.002..0.008).contains(&deviation), "{deviation} s");
        let longest = one.delays.iter().max().expect("it is not empty").as_secs_f64();
        let shortest = one.delays.iter().min().expect("it is not empty").as_secs_f64();
        assert!(longest > mean + 0.020 && longest < mean + 0.076, "{longest} s");
        assert!(shortest > 0.140 && shortest < mean, "{shortest} s");
    }
}
