//! Datagrams on their way: what each of them carried, until it is acknowledged or counts as lost.

use std::collections::VecDeque;

use trocar_scene::{Revision, SimTime};

use super::acknowledgement::RowWindow;

/// Most datagrams on their way. Further rows wait.
pub const SENT_MAX: usize = 2_048;

/// What a datagram carried of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Part {
    /// The row's place, and which of the rows that had it.
    pub(super) slot: u32,
    pub(super) generation: u32,
    /// The chunk, of vertices.
    pub(super) chunk: u32,
    pub(super) revision: Revision,
}

#[derive(Debug)]
struct Sent {
    at: SimTime,
    parts: Vec<Part>,
    /// Acknowledged, or given up.
    is_done: bool,
}

/// The datagrams on their way, oldest first; lists of parts are used again.
#[derive(Debug, Default)]
pub(super) struct SentDatagrams {
    sent: VecDeque<Sent>,
    /// Number of the oldest one.
    first: u64,
    spare: Vec<Vec<Part>>,
}

impl SentDatagrams {
    /// The number of the next one.
    pub(super) fn next_sequence(&self) -> u64 {
        self.first + self.sent.len() as u64
    }
    pub(super) fn is_full(&self) -> bool {
        self.sent.len() >= SENT_MAX
    }
    /// Whether all were acknowledged or given up.
    pub(super) fn is_empty(&self) -> bool {
        self.sent.iter().all(|sent| sent.is_done)
    }
    /// When the oldest one was sent.
    pub(super) fn oldest(&self) -> Option<SimTime> {
        self.sent.iter().find(|sent| !sent.is_done).map(|sent| sent.at)
    }
    /// An empty list for the parts of the next one.
    pub(super) fn spare(&mut self) -> Vec<Part> {
        self.spare.pop().unwrap_or_default()
    }
    /// Gives a list back.
    pub(super) fn give_back(&mut self, mut parts: Vec<Part>) {
        parts.clear();
        self.spare.push(parts);
    }
    /// The next one was sent with these parts.
    pub(super) fn push(&mut self, at: SimTime, parts: Vec<Part>) {
        self.sent.push_back(Sent { at, parts, is_done: false });
    }

    /// Takes one that is acknowledged, none older than `from`: its number, when it was sent, and its parts.
    pub(super) fn take_acknowledged(
        &mut self,
        from: u64,
        window: &RowWindow,
    ) -> Option<(u64, SimTime, Vec<Part>)> {
        let newest = window.newest()?;
        let begin = from.max(self.first);
        for sequence in begin..=newest.min(self.next_sequence().checked_sub(1)?) {
            let sent = &mut self.sent[(sequence - self.first) as usize];
            if !sent.is_done && window.has(sequence) {
                sent.is_done = true;
                return Some((sequence, sent.at, std::mem::take(&mut sent.parts)));
            }
        }
        None
    }

    /// Takes the oldest one, if it was sent at that time or before.
    pub(super) fn take_sent_until(&mut self, time: SimTime) -> Option<(u64, SimTime, Vec<Part>)> {
        self.drop_done();
        let sent = self.sent.front_mut().filter(|sent| sent.at <= time)?;
        sent.is_done = true;
        Some((self.first, sent.at, std::mem::take(&mut sent.parts)))
    }

    /// Makes room for what has been acknowledged or given up.
    pub(super) fn drop_done(&mut self) {
        while self.sent.pop_front_if(|sent| sent.is_done).is_some() {
            self.first += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_datagram_is_either_acknowledged_or_given_up_and_once() {
        let mut sent = SentDatagrams::default();
        for k in 0..100 {
            assert_eq!(sent.next_sequence(), k);
            let mut parts = sent.spare();
            parts.push(Part { slot: k as u32, generation: 0, chunk: 0, revision: Revision(k) });
            sent.push(SimTime(k), parts);
        }
        let mut window = RowWindow::default();
        (0..100).filter(|k| k % 3 == 0).for_each(|k| window.take(k));
        let (mut taken, mut from) = (Vec::new(), 0);
        while let Some((sequence, at, parts)) = sent.take_acknowledged(from, &window) {
            assert_eq!((at, parts[0].slot), (SimTime(sequence), sequence as u32));
            taken.push(sequence);
            from = sequence + 1;
            sent.give_back(parts);
        }
        assert!(taken.iter().copied().eq((0..100).filter(|k| k % 3 == 0)));
        assert!(sent.take_acknowledged(0, &window).is_none(), "it comes again");
        assert_eq!((sent.oldest(), sent.is_empty()), (Some(SimTime(1)), false));
        let mut lost = Vec::new();
        while let Some((sequence, ..)) = sent.take_sent_until(SimTime(50)) {
            lost.push(sequence);
        }
        assert!(lost.iter().copied().eq((0..=50).filter(|k| k % 3 != 0)));
        while sent.take_sent_until(SimTime(1_000)).is_some() {}
        sent.drop_done();
        assert!(sent.is_empty() && sent.next_sequence() == 100 && sent.oldest().is_none());
        assert!(sent.spare().is_empty());
        // A forged number of the far future takes nothing.
        window.take(u64::MAX - 1);
        assert!(sent.take_acknowledged(0, &window).is_none());
    }
}
