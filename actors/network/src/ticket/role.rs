//! What a person may do in a session.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// What the holder of a ticket may do. The host decides by it, and the Model enforces it.
///
/// | role | sees | points, draws, labels | moves hands of its own | takes over others' instruments |
/// |---|---|---|---|---|
/// | `watch` | yes | – | – | – |
/// | `operate` | yes | yes | yes | – |
/// | `mentor` | yes | yes | yes | yes |
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Sees everything and changes nothing.
    Watch,
    /// Has hands in the scene.
    Operate,
    /// Has hands in the scene, and may take over an instrument of somebody else.
    Mentor,
}

/// A word that names no role.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("'{0}' is no role; valid are operate, mentor and watch")]
pub struct NoRole(String);

impl Role {
    /// Every role, from the least to the most rights.
    pub const ALL: [Self; 3] = [Self::Watch, Self::Operate, Self::Mentor];

    /// Whether hands of the station may move instruments.
    pub const fn may_operate(self) -> bool {
        matches!(self, Self::Operate | Self::Mentor)
    }

    /// Whether the station may point, draw strokes and set labels.
    pub const fn may_annotate(self) -> bool {
        matches!(self, Self::Operate | Self::Mentor)
    }

    /// Whether the station may take over an instrument of another one.
    pub const fn may_take_over(self) -> bool {
        matches!(self, Self::Mentor)
    }

    /// The word for it, as in files and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Watch => "watch",
            Self::Operate => "operate",
            Self::Mentor => "mentor",
        }
    }

    /// Its number in a ticket.
    pub(super) const fn to_byte(self) -> u8 {
        match self {
            Self::Watch => 0,
            Self::Operate => 1,
            Self::Mentor => 2,
        }
    }

    /// The role of a number in a ticket.
    pub(super) fn from_byte(byte: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.to_byte() == byte)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Role {
    type Err = NoRole;

    fn from_str(word: &str) -> Result<Self, NoRole> {
        let named = Self::ALL.into_iter().find(|role| role.name() == word);
        named.ok_or_else(|| NoRole(word.chars().take(32).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_role_comes_back_from_its_word_and_its_number() {
        for role in Role::ALL {
            assert_eq!(role.name().parse(), Ok(role));
            assert_eq!(Role::from_byte(role.to_byte()), Some(role));
        }
        assert_eq!(Role::from_byte(3), None);
        assert!("Operate ".parse::<Role>().is_err());
    }

    #[test]
    fn a_watcher_may_change_nothing_and_only_a_mentor_takes_over() {
        let rights = Role::ALL.map(|role| (role.may_operate(), role.may_annotate(), role.may_take_over()));
        assert_eq!(rights, [(false, false, false), (true, true, false), (true, true, true)]);
    }
}
