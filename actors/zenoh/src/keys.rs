//! Keys: where in Zenoh's space what a session tells and takes has its place.
//!
//! | key | what | who |
//! |---|---|---|
//! | `trocar/S/alive` | a liveliness token: session S is there | session |
//! | `trocar/S/station/NUMBER/alive` | a liveliness token: that station is there | station |
//! | `trocar/S/info`, `trocar/S/roster` | what it is, who takes part; asked for as well | session |
//! | `trocar/S/pose/ENTITY` | where it is in the world | session |
//! | `trocar/S/hand/HAND/force` | the force at a hand's device | session |
//! | `trocar/S/task/ENTITY`, `trocar/S/health` | exercises; how the actors do | session |
//! | `trocar/S/row/COMPONENT/ENTITY` | rows that controllers elsewhere read | session |
//! | `trocar/S/hand/HAND/claim`, `…/command`, `…/answer` | a hand that is commanded from elsewhere | who has the right |
//! | `trocar/S/controller/NAME/claim`, `…/batch`, `…/status` | a controller elsewhere | who has the right |

use std::fmt::Write as _;

/// The first part of every key.
pub const ROOT: &str = "trocar";
/// Longest name of a session, a hand or a controller \[bytes\].
pub const NAME_MAX: usize = 64;

/// A name as one part of a key: letters that mean something in keys are written as `%` and two digits.
///
/// ```
/// assert_eq!(trocar_zenoh::keys::part("ring.1"), "ring.1");
/// assert_eq!(trocar_zenoh::keys::part("a/b*"), "a%2fb%2a");
/// ```
pub fn part(name: &str) -> String {
    let mut part = String::with_capacity(name.len());
    for letter in name.bytes() {
        match letter {
            b'a'..=b'z'
            | b'A'..=b'Z'
            | b'0'..=b'9'
            | b'.'
            | b'-'
            | b'_'
            | b':'
            | b'@'
            | b'+'
            | b'='
            | b'~'
            | b'('
            | b')' => {
                part.push(char::from(letter));
            }
            // Writing to a text does not fail.
            _ => drop(write!(part, "%{letter:02x}")),
        }
    }
    // A part is never empty, and one that begins so is not matched by wildcards.
    if part.is_empty() || part.starts_with('@') { format!("%{part}") } else { part }
}

/// Whether a name can be chosen for a session, a hand or a controller: letters, digits, `.`, `-` and `_`.
///
/// # Errors
/// In words, with what is valid.
pub fn check_name(name: &str) -> Result<(), String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || ['.', '-', '_'].contains(&c);
    if (1..=NAME_MAX).contains(&name.len()) && name.chars().all(plain) {
        return Ok(());
    }
    Err(format!("{name:?} is no name; valid are 1 to {NAME_MAX} letters, digits, '.', '-' and '_'"))
}

/// Keys of one session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionKeys {
    base: String,
}

impl SessionKeys {
    /// Of the session of this name.
    pub fn new(session: &str) -> Self {
        Self { base: format!("{ROOT}/{}", part(session)) }
    }
    /// Everything of it.
    pub fn all(&self) -> String {
        format!("{}/**", self.base)
    }
    /// Its liveliness token.
    pub fn alive(&self) -> String {
        format!("{}/alive", self.base)
    }
    /// The liveliness token of a station.
    pub fn station(&self, number: u16) -> String {
        format!("{}/station/{number}/alive", self.base)
    }
    /// What the session is.
    pub fn info(&self) -> String {
        format!("{}/info", self.base)
    }
    /// Who takes part.
    pub fn roster(&self) -> String {
        format!("{}/roster", self.base)
    }
    /// Where an entity is.
    pub fn pose(&self, entity: &str) -> String {
        format!("{}/pose/{}", self.base, part(entity))
    }
    /// An exercise.
    pub fn task(&self, entity: &str) -> String {
        format!("{}/task/{}", self.base, part(entity))
    }
    /// How its actors do.
    pub fn health(&self) -> String {
        format!("{}/health", self.base)
    }
    /// A row that a controller elsewhere reads.
    pub fn row(&self, component: &str, entity: &str) -> String {
        format!("{}/row/{}/{}", self.base, part(component), part(entity))
    }
    /// What belongs to a hand: `force`, `claim`, `command`, `answer`.
    pub fn hand(&self, hand: &str, what: &str) -> String {
        format!("{}/hand/{}/{what}", self.base, part(hand))
    }
    /// What belongs to a controller elsewhere: `claim`, `batch`, `status`.
    pub fn controller(&self, name: &str, what: &str) -> String {
        format!("{}/controller/{}/{what}", self.base, part(name))
    }
}

/// Tokens of all sessions and of their stations.
pub const ALL_SESSIONS: &str = "trocar/*/alive";
/// See [`ALL_SESSIONS`].
pub const ALL_STATIONS: &str = "trocar/*/station/*/alive";
/// What all sessions are.
pub const ALL_INFOS: &str = "trocar/*/info";
/// Who takes part in all of them.
pub const ALL_ROSTERS: &str = "trocar/*/roster";

/// The session of a token, and the number of its station if it is the token of one.
pub fn of_token(key: &str) -> Option<(&str, Option<u16>)> {
    let parts: Vec<&str> = key.split('/').collect();
    match parts[..] {
        [ROOT, session, "alive"] => Some((session, None)),
        [ROOT, session, "station", number, "alive"] => Some((session, Some(number.parse().ok()?))),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn tokens_name_their_session_and_station() {
        let keys = SessionKeys::new("peg-transfer");
        assert_eq!(of_token(&keys.alive()), Some(("peg-transfer", None)));
        assert_eq!(of_token(&keys.station(3)), Some(("peg-transfer", Some(3))));
        for other in ["", "trocar", "trocar/a/station/x/alive", "trocar/a/b/alive", "other/a/alive"] {
            assert_eq!(of_token(other), None, "{other}");
        }
    }

    #[test]
    fn a_name_that_is_chosen_is_plain() {
        for name in ["peg-transfer", "a", "Site_B.2"] {
            assert_eq!(check_name(name), Ok(()));
            assert_eq!(part(name), name);
        }
        for name in ["", "a/b", "**", "a b", &"x".repeat(65)] {
            assert!(check_name(name).is_err_and(|told| told.contains("valid are")), "{name}");
        }
    }

    proptest! {
        #[test]
        fn any_name_is_one_part_of_a_key_and_no_two_are_the_same(a in "\\PC{0,12}", b in "\\PC{0,12}") {
            let special = |c: char| "/*$?# ".contains(c);
            prop_assert!(!part(&a).contains(special) && !part(&a).is_empty() && part(&a).is_ascii());
            prop_assert_eq!(part(&a) == part(&b), a == b);
        }
    }
}
