//! Names of sessions and persons that are safe to show: short, on one line, without control characters.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::readable::is_hidden;

/// Most bytes of a name, in UTF-8.
pub const NAME_MAX: usize = 64;

/// A name that a person gave: 1 to [`NAME_MAX`] bytes of UTF-8.
///
/// It has no control characters and none that change the direction of writing: names come from other machines and are
/// shown in terminals, where such characters could make a name look like another one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct PlainName(String);

/// Why a text is no name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum NameError {
    /// Nothing but white space.
    #[error("a name is empty; 1 to {NAME_MAX} bytes are valid")]
    Empty,
    /// Longer than [`NAME_MAX`].
    #[error("a name has {0} bytes; 1 to {NAME_MAX} are valid")]
    TooLong(usize),
    /// A character that is not shown as such.
    #[error("a name has the character U+{:04X}; control characters and line breaks are not valid", u32::from(*.0))]
    Control(char),
}

impl PlainName {
    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for PlainName {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        let name = text.trim();
        if name.is_empty() {
            return Err(NameError::Empty);
        }
        if name.len() > NAME_MAX {
            return Err(NameError::TooLong(name.len()));
        }
        match name.chars().find(|character| is_hidden(*character)) {
            Some(character) => Err(NameError::Control(character)),
            None => Ok(Self(name.to_owned())),
        }
    }
}

impl TryFrom<String> for PlainName {
    type Error = NameError;

    fn try_from(text: String) -> Result<Self, NameError> {
        text.parse()
    }
}

impl From<PlainName> for String {
    fn from(name: PlainName) -> Self {
        name.0
    }
}

impl fmt::Display for PlainName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn names_of_all_languages_are_valid_and_trimmed() {
        for (text, name) in [("Ana", "Ana"), (" Öztürk 2 ", "Öztürk 2"), ("山田", "山田")] {
            assert_eq!(text.parse::<PlainName>().map(String::from), Ok(name.to_owned()));
        }
        assert!("x".repeat(NAME_MAX).parse::<PlainName>().is_ok());
    }

    #[test]
    fn a_name_that_could_deceive_a_terminal_is_refused() {
        assert_eq!(" \n".parse::<PlainName>(), Err(NameError::Empty));
        assert_eq!("é".repeat(33).parse::<PlainName>(), Err(NameError::TooLong(66)));
        for hidden in ['\u{1b}', '\n', '\u{202e}', '\u{200b}', '\0', '\u{85}'] {
            let refused = format!("a{hidden}b").parse::<PlainName>();
            assert_eq!(refused, Err(NameError::Control(hidden)));
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_name_that_comes_back_or_is_refused(text in any::<String>(), word in "[ \\PC]{0,80}") {
            for text in [text, word] {
                let Ok(name) = text.parse::<PlainName>() else { continue };
                prop_assert!((1..=NAME_MAX).contains(&name.as_str().len()));
                prop_assert!(name.as_str().trim() == name.as_str() && !name.as_str().chars().any(is_hidden));
                let bytes = postcard::to_stdvec(&name).expect("it encodes");
                prop_assert_eq!(postcard::from_bytes::<PlainName>(&bytes), Ok(name));
            }
        }
    }
}
