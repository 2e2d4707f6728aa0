//! Short texts from other machines, safe to show in a terminal.

use std::fmt;

use serde::{Deserialize, Serialize};
use trocar_scene::readable::is_hidden;

/// Most bytes of a text, in UTF-8.
pub const TEXT_MAX: usize = 256;

/// A text of at most [`TEXT_MAX`] bytes on one line, without characters that control a terminal or the direction of
/// writing. Texts that are not so are refused when they come from outside, and made so when they go out.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct PlainText(String);

impl PlainText {
    /// A text, with hidden characters replaced by spaces, and cut off at the last character that fits.
    pub fn new(text: impl AsRef<str>) -> Self {
        let mut plain = String::new();
        for character in text.as_ref().chars() {
            let character = if is_hidden(character) { ' ' } else { character };
            if plain.len() + character.len_utf8() > TEXT_MAX {
                break;
            }
            plain.push(character);
        }
        Self(plain)
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for PlainText {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        if text.len() > TEXT_MAX {
            return Err(format!("a text has {} bytes; at most {TEXT_MAX} are valid", text.len()));
        }
        match text.chars().find(|character| is_hidden(*character)) {
            Some(hidden) => {
                Err(format!("a text has the character U+{:04X}, which is not shown", u32::from(hidden)))
            }
            None => Ok(Self(text)),
        }
    }
}

impl From<PlainText> for String {
    fn from(text: PlainText) -> Self {
        text.0
    }
}

impl fmt::Display for PlainText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_text_from_outside_that_could_deceive_a_terminal_is_refused() {
        for text in ["a\u{1b}[31m".to_owned(), "a\u{202e}b".to_owned(), "x".repeat(TEXT_MAX + 1)] {
            let bytes = postcard::to_stdvec(&text).expect("it encodes");
            assert!(postcard::from_bytes::<PlainText>(&bytes).is_err(), "{text:?}");
        }
    }

    proptest! {
        #[test]
        fn what_goes_out_is_taken_in(text in any::<String>()) {
            let plain = PlainText::new(text);
            let bytes = postcard::to_stdvec(&plain).expect("it encodes");
            prop_assert_eq!(postcard::from_bytes::<PlainText>(&bytes), Ok(plain));
        }
    }
}
