//! Path of a connection: where the other side receives, and whether it does.
//!
//! A station's address changes when it goes to another network, or when a router forgets it. A host follows the newest
//! authentic datagram, but only after the new address has answered a challenge: otherwise whoever can copy a datagram and
//! send it from elsewhere would turn the stream of hands on a victim (as in QUIC, RFC 9000, section 9.3). Until then
//! datagrams go to the old address. The same challenge goes to an address again and again, since a long path has several of
//! them under way at once, and the answer to the first one counts.

use trocar_scene::SimTime;

/// Bytes of a challenge, and of its answer.
pub const CHALLENGE_BYTES: usize = 8;
/// Least time between two challenges.
pub const CHALLENGE_EVERY: SimTime = SimTime::from_millis(20);
/// How long the same challenge goes to an address: longer than the longest round trip.
const CHALLENGE_MAX: SimTime = SimTime::from_millis(5_000);

/// What a datagram's address means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathNews {
    /// It came along the known path, or is too old to tell of another.
    Known,
    /// It is the first one: from now on there is a path.
    First,
    /// It came from elsewhere, and a challenge is to go there.
    Challenge([u8; CHALLENGE_BYTES]),
}

/// An address that is being challenged.
#[derive(Clone, Copy, Debug)]
struct Candidate<A> {
    to: A,
    challenge: [u8; CHALLENGE_BYTES],
    since: SimTime,
    sent_at: SimTime,
}

/// The path to the other side; `A` is an address.
#[derive(Clone, Copy, Debug)]
pub struct Path<A> {
    address: Option<A>,
    newest: u64,
    candidate: Option<Candidate<A>>,
    /// What challenges are made of; secret, and different for each connection.
    secret: u64,
    challenges: u64,
    changes: u64,
}

impl<A: Copy + PartialEq> Path<A> {
    /// Without an address; `secret` is random, so that nobody can guess the challenges.
    pub fn new(secret: u64) -> Self {
        Self { address: None, newest: 0, candidate: None, secret, challenges: 0, changes: 0 }
    }

    /// Where datagrams go.
    pub fn address(&self) -> Option<A> {
        self.address
    }

    /// How often the address has changed.
    pub fn changes(&self) -> u64 {
        self.changes
    }

    /// An authentic datagram came from `from`.
    pub fn arrived(&mut self, from: A, sequence: u64, now: SimTime) -> PathNews {
        let is_newest = sequence > self.newest;
        self.newest = self.newest.max(sequence);
        match self.address {
            None => {
                self.address = Some(from);
                PathNews::First
            }
            Some(address) if address == from || !is_newest => PathNews::Known,
            Some(_) => self.challenge(from, now),
        }
    }

    fn challenge(&mut self, to: A, now: SimTime) -> PathNews {
        if let Some(Candidate { to: before, challenge, since, sent_at }) = &mut self.candidate {
            if now.since(*sent_at) < CHALLENGE_EVERY {
                return PathNews::Known;
            }
            if *before == to && now.since(*since) < CHALLENGE_MAX {
                *sent_at = now;
                return PathNews::Challenge(*challenge);
            }
        }
        self.challenges += 1;
        let mut text = [0; 16];
        text[..8].copy_from_slice(&self.secret.to_le_bytes());
        text[8..].copy_from_slice(&self.challenges.to_le_bytes());
        let mut challenge = [0; CHALLENGE_BYTES];
        challenge.copy_from_slice(&blake3::hash(&text).as_bytes()[..CHALLENGE_BYTES]);
        self.candidate = Some(Candidate { to, challenge, since: now, sent_at: now });
        PathNews::Challenge(challenge)
    }

    /// An authentic answer came from `from`; whether datagrams go there from now on.
    pub fn answered(&mut self, from: A, answer: &[u8]) -> bool {
        let is_asked = |candidate: &Candidate<A>| candidate.to == from && candidate.challenge == *answer;
        let is_right = self.candidate.as_ref().is_some_and(is_asked);
        if is_right {
            self.address = Some(from);
            self.candidate = None;
            self.changes += 1;
        }
        is_right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    #[test]
    fn datagrams_follow_a_new_address_once_it_has_answered() {
        let mut path = Path::new(7);
        assert_eq!(path.arrived('a', 1, MS(0)), PathNews::First);
        assert_eq!(path.arrived('a', 2, MS(1)), PathNews::Known);
        let PathNews::Challenge(first) = path.arrived('b', 3, MS(2)) else { panic!("not challenged") };
        assert_eq!(path.address(), Some('a'), "not before it answers");
        assert!(!path.answered('c', &first), "from elsewhere");
        assert!(!path.answered('b', &[0; 8]), "guessed");
        assert!(!path.answered('b', &first[..7]));
        assert!(path.answered('b', &first));
        assert_eq!((path.address(), path.changes()), (Some('b'), 1));
        assert!(!path.answered('b', &first), "once");
    }

    #[test]
    fn a_copy_that_comes_late_challenges_nobody_and_challenges_are_few() {
        let mut path = Path::new(7);
        path.arrived('a', 10, MS(0));
        assert_eq!(path.arrived('b', 9, MS(1)), PathNews::Known, "overtaken");
        let mut challenges = Vec::new();
        for ms in 0..10_000 {
            if let PathNews::Challenge(challenge) = path.arrived('b', 11 + ms, MS(ms)) {
                challenges.push(challenge);
            }
        }
        assert_eq!(challenges.len(), 500);
        // Another one each 5 s.
        challenges.dedup();
        assert_eq!(challenges.len(), 2);
    }

    #[test]
    fn an_answer_counts_that_takes_longer_than_until_the_next_challenge() {
        let mut path = Path::new(7);
        path.arrived('a', 1, MS(0));
        let PathNews::Challenge(first) = path.arrived('b', 2, MS(0)) else { panic!("not challenged") };
        // The other side sends on meanwhile, from its new address.
        for ms in 1..1_500 {
            path.arrived('b', 2 + ms, MS(ms));
        }
        assert!(path.answered('b', &first));
        assert_eq!(path.address(), Some('b'));
    }

    #[test]
    fn whoever_answers_an_older_challenge_is_challenged_again() {
        let mut path = Path::new(7);
        path.arrived('a', 1, MS(0));
        let PathNews::Challenge(first) = path.arrived('b', 2, MS(0)) else { panic!("not challenged") };
        let PathNews::Challenge(second) = path.arrived('c', 3, MS(30)) else { panic!("not challenged") };
        assert!(!path.answered('b', &first));
        assert!(path.answered('c', &second));
    }
}
