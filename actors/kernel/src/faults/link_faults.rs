//! Fault model of a network link: loss, also in bursts, delay, also along a measured trace, duplication, reordering,
//! corruption, a limited rate with its queue, and partition.
//!
//! Sans-IO and generic over the message, after NetEm (Hemminger, "Network emulation with NetEm", 2005): messages go in
//! with the time at which they were sent, and come out when they are due. Results depend only on the seeds of the
//! faults and on the messages, so the same messages at the same times give the same result.
//!
//! Corruption flips bits in a message's encoding, and its checksum then refuses it, as a receiver's would. A delayed
//! message keeps its place in the queue; only `reorder` and independent delays let later messages overtake. Bursts follow
//! the model of Gilbert (1960) and Elliott (1963): in its bad state the link loses every message, in its good state none.

use std::collections::VecDeque;

use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use crate::spec::{FaultKind, FaultOrder};

/// Most messages in flight on one link: those of two hands at 1 kHz for eight seconds. Further ones are lost and counted.
pub const LINK_WAITING_MAX: usize = 16_384;
/// Longest time that a message held for reordering waits for the next message.
const OVERTAKEN_MAX: SimTime = SimTime::from_millis(100);
/// Most bits flipped in a corrupted message.
const FLIPS_MAX: u64 = 3;

/// A message that can travel over a link.
pub trait Message: Sized {
    /// Bytes that it takes on the link.
    fn bytes(&self) -> usize;
    /// A duplicate; `None` when the message cannot be duplicated.
    fn duplicate(&self) -> Option<Self>;
    /// The message as received after `noise` changed its encoded bytes; `None` when the receiver refuses it.
    fn through(self, noise: &mut dyn FnMut(&mut [u8])) -> Option<Self>;
}

/// Counts of the messages that a fault affected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Messages that never arrived: dropped, partitioned, or over the in-flight limit.
    pub lost: u64,
    /// Messages corrupted and refused by their checksum; not counted in `lost`.
    pub corrupted: u64,
    /// Messages that arrived late.
    pub delayed: u64,
    /// Messages that arrived twice.
    pub duplicated: u64,
    /// Messages that were overtaken.
    pub reordered: u64,
}

impl LinkCounts {
    /// Sum of all counts.
    pub fn sum(&self) -> u64 {
        self.lost + self.corrupted + self.delayed + self.duplicated + self.reordered
    }
}

/// One active fault of the link.
#[derive(Clone, Debug)]
struct ActiveFault {
    order: FaultOrder,
    random: SplitMix64,
    /// When the first message met it.
    begun: Option<SimTime>,
    /// Whether a burst of losses goes on.
    in_burst: bool,
    /// When a limited link has sent what it was given.
    free_at: SimTime,
}

impl ActiveFault {
    fn new(order: &FaultOrder) -> Self {
        Self {
            random: SplitMix64::new(order.seed),
            begun: None,
            in_burst: false,
            free_at: SimTime::ZERO,
            order: order.clone(),
        }
    }

    fn strikes(&mut self, kind: FaultKind) -> bool {
        if self.order.kind != kind {
            return false;
        }
        let unit = self.random.unit();
        if self.order.burst < 1.0 {
            return unit < self.order.probability;
        }
        // So that bursts have their mean length, and the share of the time in them is the share that is lost.
        let lost = self.order.probability;
        let ends = 1.0 / self.order.burst;
        let begins = ends * lost / (1.0 - lost).max(f64::MIN_POSITIVE);
        self.in_burst = if self.in_burst { unit >= ends } else { unit < begins };
        self.in_burst
    }

    /// The latency that the fault adds to a message of `bytes` bytes that is sent at `now`; `None` when its queue is full.
    fn latency(&mut self, now: SimTime, bytes: impl Fn() -> usize) -> Option<SimTime> {
        let FaultOrder { kind, span, jitter, delays, every, bytes_per_sec, .. } = &self.order;
        match kind {
            FaultKind::Delay if !delays.is_empty() => {
                let since = now.since(*self.begun.get_or_insert(now));
                let place = since.as_nanos() / every.as_nanos().max(1);
                Some(delays[(place % delays.len() as u64) as usize])
            }
            FaultKind::Delay => {
                let spread = jitter.as_secs_f64() * (2.0 * self.random.unit() - 1.0);
                Some(SimTime::from_secs_f64(span.as_secs_f64() + spread))
            }
            FaultKind::RateLimit => {
                let begins = now.max(self.free_at);
                if begins.since(now) > *span {
                    return None;
                }
                self.free_at = begins + SimTime::from_secs_f64(bytes() as f64 / bytes_per_sec);
                Some(self.free_at.since(now))
            }
            _ => Some(SimTime::ZERO),
        }
    }
}

#[derive(Clone, Debug)]
struct Waiting<M> {
    due: SimTime,
    message: M,
}

/// The active faults of one link, and its messages in flight.
#[derive(Clone, Debug)]
pub struct LinkFaults<M> {
    active: Vec<ActiveFault>,
    /// Messages in flight, ordered by due time.
    waiting: VecDeque<Waiting<M>>,
    /// Message held for reordering until the next one passes, at most until its due time.
    overtaken: Option<Waiting<M>>,
    counts: LinkCounts,
}

impl<M> Default for LinkFaults<M> {
    fn default() -> Self {
        let (active, waiting) = (Vec::new(), VecDeque::new());
        Self { active, waiting, overtaken: None, counts: LinkCounts::default() }
    }
}

impl<M: Message> LinkFaults<M> {
    /// A fault begins or ends; a fault of another kind is ignored.
    pub fn apply(&mut self, order: &FaultOrder) {
        if !order.kind.is_of_link() {
            return;
        }
        self.active.retain(|fault| fault.order.index != order.index);
        if order.begins {
            self.active.push(ActiveFault::new(order));
        } else if let Some(overtaken) = &mut self.overtaken {
            // No later message may come, so the held one is due at once.
            overtaken.due = SimTime::ZERO;
        }
    }

    /// Whether the link has no active fault and no message in flight, so that messages can bypass it.
    pub fn is_idle(&self) -> bool {
        self.active.is_empty() && self.waiting.is_empty() && self.overtaken.is_none()
    }

    /// Copy of the link for a branch of a session: the same faults with the same random state, and the messages in
    /// flight, duplicated by `copy`. Messages that `copy` cannot duplicate are lost on the new link.
    pub fn fork(&self, copy: impl Fn(&M) -> Option<M>) -> Self {
        let mut lost = 0;
        let mut copied = |waiting: &Waiting<M>| {
            let message = copy(&waiting.message);
            lost += u64::from(message.is_none());
            message.map(|message| Waiting { due: waiting.due, message })
        };
        let waiting = self.waiting.iter().filter_map(&mut copied).collect();
        let overtaken = self.overtaken.as_ref().and_then(&mut copied);
        let counts = LinkCounts { lost, ..LinkCounts::default() };
        Self { active: self.active.clone(), waiting, overtaken, counts }
    }

    /// Counts of affected messages so far.
    pub fn counts(&self) -> &LinkCounts {
        &self.counts
    }

    /// Sends a message at `now`, which must not decrease. [`Self::due`] returns it if it arrives.
    pub fn send(&mut self, now: SimTime, message: M) {
        if self.active.iter().any(|fault| fault.order.kind == FaultKind::Partition)
            || self.strikes(FaultKind::Drop)
        {
            self.counts.lost += 1;
            return;
        }
        let Some(message) = self.pass_noise(message) else {
            self.counts.corrupted += 1;
            return;
        };
        let Some(late) = self.latency(now, &message) else {
            self.counts.lost += 1;
            return;
        };
        let due = now + late;
        if late > SimTime::ZERO {
            self.counts.delayed += 1;
        }
        if self.strikes(FaultKind::Reorder) && self.overtaken.is_none() {
            self.counts.reordered += 1;
            self.overtaken = Some(Waiting { due: due + OVERTAKEN_MAX, message });
            return;
        }
        let copy = if self.strikes(FaultKind::Duplicate) { message.duplicate() } else { None };
        self.line_up(due, message);
        if let Some(copy) = copy {
            self.counts.duplicated += 1;
            self.line_up(due, copy);
        }
        if let Some(Waiting { message, .. }) = self.overtaken.take() {
            self.line_up(due, message);
        }
    }

    /// The next message that has arrived by `now`; call it until it returns `None`.
    pub fn due(&mut self, now: SimTime) -> Option<M> {
        if let Some(Waiting { message, .. }) = self.overtaken.take_if(|overtaken| overtaken.due <= now) {
            self.line_up(now, message);
        }
        let arrived = self.waiting.front().is_some_and(|first| first.due <= now);
        if arrived { self.waiting.pop_front().map(|first| first.message) } else { None }
    }

    /// When the next message arrives.
    pub fn next_due(&self) -> Option<SimTime> {
        let first = self.waiting.front().map(|first| first.due);
        let overtaken = self.overtaken.as_ref().map(|overtaken| overtaken.due);
        first.into_iter().chain(overtaken).min()
    }

    /// Number of messages in flight.
    pub fn len(&self) -> usize {
        self.waiting.len() + usize::from(self.overtaken.is_some())
    }

    /// Whether no message is in flight.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Draws for every fault of this kind, so that one fault does not change another's random stream.
    fn strikes(&mut self, kind: FaultKind) -> bool {
        let mut struck = false;
        for fault in &mut self.active {
            struck |= fault.strikes(kind);
        }
        struck
    }

    fn pass_noise(&mut self, mut message: M) -> Option<M> {
        for fault in &mut self.active {
            if fault.strikes(FaultKind::Corrupt) {
                let random = &mut fault.random;
                message = message.through(&mut |bytes| {
                    let bits = 8 * bytes.len() as u64;
                    for _ in 0..=random.below(FLIPS_MAX) {
                        let bit = random.below(bits);
                        if let Some(byte) = bytes.get_mut((bit / 8) as usize) {
                            *byte ^= 1 << (bit % 8);
                        }
                    }
                })?;
            }
        }
        Some(message)
    }

    /// Sum of what all faults add to a message's latency; `None` when a queue is full.
    fn latency(&mut self, now: SimTime, message: &M) -> Option<SimTime> {
        let mut late = SimTime::ZERO;
        for fault in &mut self.active {
            late += fault.latency(now, || message.bytes())?;
        }
        Some(late)
    }

    /// Queues a message: behind all messages in flight, since a link is first-in, first-out, unless delays are independent.
    fn line_up(&mut self, due: SimTime, message: M) {
        if self.waiting.len() >= LINK_WAITING_MAX {
            self.counts.lost += 1;
            return;
        }
        if self.active.iter().any(|fault| fault.order.independent) {
            let place = self.waiting.partition_point(|waiting| waiting.due <= due);
            self.counts.reordered += u64::from(place < self.waiting.len());
            self.waiting.insert(place, Waiting { due, message });
            return;
        }
        let due = self.waiting.back().map_or(due, |last| due.max(last.due));
        self.waiting.push_back(Waiting { due, message });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::secs;

    /// A number with its checksum.
    #[derive(Clone, Debug, PartialEq)]
    struct Letter(u64);
    impl Message for Letter {
        fn bytes(&self) -> usize {
            100
        }
        fn duplicate(&self) -> Option<Self> {
            Some(self.clone())
        }
        fn through(self, noise: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
            let mut bytes = self.0.to_le_bytes();
            let sum = crc32fast::hash(&bytes);
            noise(&mut bytes);
            (crc32fast::hash(&bytes) == sum).then_some(self)
        }
    }

    fn order(index: u32, kind: FaultKind, probability: f64, span: f64, jitter: f64) -> FaultOrder {
        FaultOrder {
            index,
            target: "hand".to_owned(),
            kind,
            begins: true,
            span: secs(span),
            jitter: secs(jitter),
            independent: false,
            delays: Vec::new(),
            every: SimTime::ZERO,
            burst: 0.0,
            probability,
            bytes_per_sec: 0.0,
            seed: 7 + u64::from(index),
        }
    }

    /// Sends one message per millisecond for a second; returns each arrival time \[ms\].
    fn second(link: &mut LinkFaults<Letter>) -> Vec<(u64, u64)> {
        let mut arrived = Vec::new();
        for ms in 0..1_500 {
            let now = SimTime::from_millis(ms);
            if ms < 1_000 {
                link.send(now, Letter(ms));
            }
            while let Some(Letter(number)) = link.due(now) {
                arrived.push((number, ms));
            }
        }
        arrived
    }

    #[test]
    fn without_faults_everything_passes_at_once_and_in_order() {
        let mut link = LinkFaults::default();
        assert!(link.is_idle());
        assert!(second(&mut link).into_iter().eq((0..1_000).map(|ms| (ms, ms))));
        assert!(link.is_idle() && link.next_due().is_none() && link.counts().sum() == 0);
    }

    #[test]
    fn drops_follow_their_probability_and_their_seed() {
        let lossy = |seed: u64| {
            let mut link = LinkFaults::default();
            link.apply(&FaultOrder { seed, ..order(0, FaultKind::Drop, 0.05, 0.0, 0.0) });
            let arrived = second(&mut link);
            assert_eq!(arrived.len() as u64 + link.counts().lost, 1_000);
            arrived
        };
        assert_eq!(lossy(1), lossy(1));
        assert_ne!(lossy(1), lossy(2));
        let lost: usize = (0..20).map(|seed| 1_000 - lossy(seed).len()).sum();
        // Binomial, n = 20,000 and p = 0.05: four standard deviations are 123.
        assert!((877..1_123).contains(&lost), "{lost} of 20,000");
    }

    #[test]
    fn a_delay_keeps_the_order_and_its_jitter_stays_within_bounds() {
        let mut link = LinkFaults::default();
        link.apply(&order(0, FaultKind::Delay, 1.0, 0.020, 0.010));
        let arrived = second(&mut link);
        assert!(arrived.iter().map(|(number, _)| *number).eq(0..1_000));
        let late: Vec<u64> = arrived.iter().map(|(number, at)| at - number).collect();
        assert!(late.iter().all(|late| (10..=31).contains(late)), "{:?}", late.iter().max());
        assert!(late.iter().any(|late| *late < 18) && late.iter().any(|late| *late > 25));
        assert_eq!(link.counts().delayed, 1_000);
    }

    #[test]
    fn losses_in_bursts_have_their_share_and_their_length() {
        let mut link = LinkFaults::default();
        link.apply(&FaultOrder { burst: 8.0, ..order(0, FaultKind::Drop, 0.1, 0.0, 0.0) });
        let mut arrived = Vec::new();
        for number in 0..200_000 {
            link.send(SimTime::ZERO, Letter(number));
            arrived.extend(link.due(SimTime::ZERO).map(|Letter(number)| number));
        }
        let gaps: Vec<u64> =
            arrived.windows(2).map(|pair| pair[1] - pair[0] - 1).filter(|gap| *gap > 0).collect();
        let lost = gaps.iter().sum::<u64>() as f64;
        let (share, length) = (lost / 200_000.0, lost / gaps.len() as f64);
        // Of 2,500 bursts of 8 ± 7.5 each; three standard deviations.
        assert!((0.093..0.107).contains(&share) && (7.5..8.5).contains(&length), "{share} {length}");
    }

    #[test]
    fn with_independent_delays_messages_overtake_each_other() {
        let mut link = LinkFaults::default();
        link.apply(&FaultOrder { independent: true, ..order(0, FaultKind::Delay, 1.0, 0.020, 0.020) });
        let arrived = second(&mut link);
        assert_eq!(arrived.len(), 1_000);
        let late: Vec<u64> = arrived.iter().map(|(number, at)| at - number).collect();
        let mean = late.iter().sum::<u64>() as f64 / 1_000.0;
        // Uniform from 0 to 40 ms, seen half a millisecond later on average: no queue holds the others up.
        assert!(late.iter().all(|late| *late <= 41) && (19.0..22.0).contains(&mean), "{mean}");
        let overtaken = arrived.windows(2).filter(|pair| pair[0].0 > pair[1].0).count();
        assert!(overtaken > 300 && link.counts().reordered > 300, "{overtaken}");
    }

    #[test]
    fn delays_follow_their_trace_over_and_over() {
        let mut link = LinkFaults::default();
        let delays = [5, 20, 1].map(SimTime::from_millis).to_vec();
        let trace = FaultOrder { delays, every: secs(0.1), ..order(0, FaultKind::Delay, 1.0, 0.0, 0.0) };
        link.apply(&trace);
        let arrived = second(&mut link);
        assert!(arrived.iter().map(|(number, _)| *number).eq(0..1_000), "they keep their order");
        for (number, at) in arrived {
            let delay = [5, 20, 1][(number / 100 % 3) as usize];
            // What was sent just before keeps the next ones up.
            let earliest = number + delay;
            assert!(at == earliest || (number % 100 < 20 && at > earliest), "{number} at {at}");
        }
    }

    #[test]
    fn a_limited_link_passes_its_rate_and_queues_for_so_long() {
        let mut link = LinkFaults::default();
        // 100 bytes a millisecond come, 60 pass.
        let limit = FaultOrder { bytes_per_sec: 60_000.0, ..order(0, FaultKind::RateLimit, 1.0, 0.050, 0.0) };
        link.apply(&limit);
        let arrived = second(&mut link);
        assert!(arrived.is_sorted());
        // A second and the queue's 50 ms.
        assert!((625..=635).contains(&arrived.len()), "{}", arrived.len());
        assert_eq!(arrived.len() as u64 + link.counts().lost, 1_000);
        let late = arrived.iter().map(|(number, at)| at - number).max();
        assert!(late.is_some_and(|late| (50..=53).contains(&late)), "{late:?}");
        // Beneath its rate it is no hindrance but for the time that a message takes.
        link.apply(&FaultOrder { bytes_per_sec: 200_000.0, ..limit });
        assert!(second(&mut link).iter().all(|(number, at)| at - number <= 1));
    }

    #[test]
    fn some_come_twice_and_some_are_overtaken_by_exactly_one() {
        let mut link = LinkFaults::default();
        link.apply(&order(0, FaultKind::Duplicate, 0.1, 0.0, 0.0));
        let arrived = second(&mut link);
        assert_eq!(arrived.len() as u64, 1_000 + link.counts().duplicated);
        assert!((60..140).contains(&link.counts().duplicated));
        let mut link = LinkFaults::default();
        link.apply(&order(0, FaultKind::Reorder, 0.1, 0.0, 0.0));
        let arrived = second(&mut link);
        assert_eq!(arrived.len(), 1_000);
        let overtaken = arrived.windows(2).filter(|pair| pair[0].0 > pair[1].0).count() as u64;
        // The last message has no successor to overtake it.
        assert!(overtaken.abs_diff(link.counts().reordered) <= 1 && overtaken > 50, "{overtaken}");
        assert!(arrived.iter().all(|(number, at)| at - number <= 100));
    }

    #[test]
    fn what_is_garbled_is_refused_by_its_checksum_and_never_arrives() {
        let mut link = LinkFaults::default();
        link.apply(&order(0, FaultKind::Corrupt, 0.3, 0.0, 0.0));
        let arrived = second(&mut link);
        assert_eq!(arrived.len() as u64 + link.counts().corrupted, 1_000);
        assert!((220..380).contains(&link.counts().corrupted));
        assert!(arrived.iter().all(|(number, at)| number == at), "nothing wrong came through");
    }

    #[test]
    fn a_partition_lets_nothing_pass_and_heals() {
        let mut link = LinkFaults::default();
        let partition = order(3, FaultKind::Partition, 1.0, 0.0, 0.0);
        link.apply(&partition);
        assert!(second(&mut link).is_empty() && !link.is_idle());
        link.apply(&FaultOrder { begins: false, ..partition });
        assert!(link.is_idle());
        assert_eq!(second(&mut link).len(), 1_000);
    }

    #[test]
    fn a_fork_has_the_same_luck_and_the_same_messages_on_their_way() {
        let mut link = LinkFaults::default();
        link.apply(&order(0, FaultKind::Delay, 1.0, 0.020, 0.010));
        link.apply(&order(1, FaultKind::Drop, 0.3, 0.0, 0.0));
        link.apply(&order(2, FaultKind::Reorder, 0.3, 0.0, 0.0));
        second(&mut link);
        (0..5).for_each(|number| link.send(secs(2.0), Letter(number)));
        let mut fork = link.fork(Letter::duplicate);
        assert!(link.len() > 1 && fork.len() == link.len() && fork.counts().sum() == 0);
        let rest = |link: &mut LinkFaults<Letter>| {
            (5..100).for_each(|number| link.send(secs(2.1), Letter(number)));
            std::iter::from_fn(|| link.due(secs(3.0))).collect::<Vec<_>>()
        };
        assert_eq!(rest(&mut link), rest(&mut fork));
        link.send(secs(4.0), Letter(1));
        let waiting = link.len() as u64;
        assert_eq!(link.fork(|_| None).counts().lost, waiting);
    }

    #[test]
    fn the_line_is_bounded_and_what_does_not_fit_is_counted() {
        let mut link = LinkFaults::default();
        link.apply(&order(0, FaultKind::Delay, 1.0, 10.0, 0.0));
        for number in 0..20_000 {
            link.send(SimTime::ZERO, Letter(number));
        }
        assert_eq!((link.len(), link.counts().lost), (LINK_WAITING_MAX, 20_000 - LINK_WAITING_MAX as u64));
        assert_eq!(link.next_due(), Some(secs(10.0)));
    }

    #[test]
    fn an_overtaken_message_is_set_free_when_the_fault_ends_or_nobody_comes() {
        let mut link = LinkFaults::default();
        let reorder = order(0, FaultKind::Reorder, 1.0, 0.0, 0.0);
        link.apply(&reorder);
        link.send(secs(1.0), Letter(1));
        assert_eq!(link.due(secs(1.05)), None);
        assert_eq!(link.due(secs(1.1)), Some(Letter(1)));
        link.send(secs(2.0), Letter(2));
        link.apply(&FaultOrder { begins: false, ..reorder });
        assert_eq!(link.due(secs(2.0)), Some(Letter(2)));
        assert!(link.is_idle());
    }
}
