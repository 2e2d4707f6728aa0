//! Presence: which sessions and stations are there, from liveliness tokens that may be repeated or missed.
//!
//! A change that a subscription tells counts at once. What it missed is found by asking for all tokens now and then: a token
//! that one answer has and we do not is new; one that [`MISSES_MAX`] answers in a row lack is gone.

use std::collections::{BTreeMap, BTreeSet};

/// Answers in a row without a token, after which it is gone: one may be incomplete.
pub const MISSES_MAX: u8 = 2;
/// Most tokens that are kept.
pub const TOKENS_MAX: usize = 4_096;

/// A change of who is there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Change {
    /// This token has come.
    Came(String),
    /// This token is gone.
    Went(String),
}

/// Who is there.
#[derive(Clone, Debug, Default)]
pub struct Presence {
    /// Tokens, with the answers in a row that lacked them.
    known: BTreeMap<String, u8>,
    /// Tokens beyond [`TOKENS_MAX`] that were not kept.
    left_out: u64,
}

impl Presence {
    /// A subscription tells that a token came.
    pub fn came(&mut self, token: &str) -> Option<Change> {
        if let Some(misses) = self.known.get_mut(token) {
            *misses = 0;
            return None;
        }
        if self.known.len() >= TOKENS_MAX {
            self.left_out += 1;
            return None;
        }
        self.known.insert(token.to_owned(), 0);
        Some(Change::Came(token.to_owned()))
    }

    /// A subscription tells that a token went.
    pub fn went(&mut self, token: &str) -> Option<Change> {
        self.known.remove(token).map(|_| Change::Went(token.to_owned()))
    }

    /// All tokens of an answer.
    pub fn reconcile(&mut self, answer: &BTreeSet<String>) -> Vec<Change> {
        let mut changes: Vec<Change> = answer.iter().filter_map(|token| self.came(token)).collect();
        self.known.retain(|token, misses| {
            if !answer.contains(token) {
                *misses += 1;
            }
            let stays = *misses < MISSES_MAX;
            if !stays {
                changes.push(Change::Went(token.clone()));
            }
            stays
        });
        changes
    }

    /// The tokens.
    pub fn tokens(&self) -> impl Iterator<Item = &str> {
        self.known.keys().map(String::as_str)
    }

    /// Tokens that were not kept, because there were too many.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(tokens: &[&str]) -> BTreeSet<String> {
        tokens.iter().map(|token| (*token).to_owned()).collect()
    }

    #[test]
    fn what_is_told_twice_is_one_change() {
        let mut presence = Presence::default();
        assert_eq!(presence.came("a"), Some(Change::Came("a".into())));
        assert_eq!(presence.came("a"), None);
        assert_eq!(presence.went("a"), Some(Change::Went("a".into())));
        assert_eq!((presence.went("a"), presence.went("b")), (None, None));
    }

    #[test]
    fn what_was_missed_is_found_by_asking_and_one_incomplete_answer_loses_nobody() {
        let mut presence = Presence::default();
        assert_eq!(presence.reconcile(&set(&["a", "b"])).len(), 2);
        assert_eq!(presence.reconcile(&set(&["b"])), [], "once may be a mistake");
        assert_eq!(presence.reconcile(&set(&["a", "b"])), []);
        assert_eq!(presence.reconcile(&set(&["b"])), []);
        assert_eq!(
            presence.reconcile(&set(&["b", "c"])),
            [Change::Came("c".into()), Change::Went("a".into())]
        );
        assert!(presence.tokens().eq(["b", "c"]));
    }

    #[test]
    fn there_is_a_bound_to_who_is_kept() {
        let mut presence = Presence::default();
        for number in 0..TOKENS_MAX + 10 {
            presence.came(&number.to_string());
        }
        assert_eq!((presence.tokens().count(), presence.left_out()), (TOKENS_MAX, 10));
    }
}
