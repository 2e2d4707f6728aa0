//! Malformed input: mutations shared by the property tests of the readers.

use std::sync::Arc;

use proptest::prelude::*;
use proptest::sample::{Index, select};

/// A mutation of a valid file.
#[derive(Clone, Debug)]
pub enum Mutation {
    /// Flips a bit.
    Flip {
        /// Which byte.
        at: Index,
        /// Which of its bits.
        bit: u8,
    },
    /// Overwrites some bytes.
    Set {
        /// The first byte.
        at: Index,
        /// The new bytes.
        bytes: Vec<u8>,
    },
    /// Truncates the file.
    Cut {
        /// The first byte that is missing.
        at: Index,
    },
    /// Removes a piece.
    Remove {
        /// Its first byte.
        at: Index,
        /// Its length in bytes.
        length: usize,
    },
    /// Repeats a piece.
    Repeat {
        /// Its first byte.
        at: Index,
        /// Its length in bytes.
        length: usize,
    },
    /// Inserts a word with a meaning in some format.
    Insert {
        /// The byte before which it is inserted.
        at: Index,
        /// The word.
        word: &'static str,
    },
    /// Replaces a run of digits by another number.
    Number {
        /// The first digit after this byte begins the run.
        at: Index,
        /// The other number.
        with: &'static str,
    },
}

/// A random mutation.
pub fn mutation() -> impl Strategy<Value = Mutation> {
    let at = any::<Index>;
    let numbers = select(vec![
        "-1",
        "0",
        "4294967295",
        "4294967296",
        "9223372036854775807",
        "18446744073709551615",
        "nan",
        "inf",
        "-inf",
        "1e400",
        "-1e-400",
        "1e308",
    ]);
    let words = select(vec![
        "\0",
        "\n",
        "\r\n",
        "\t",
        ",",
        ";",
        "=",
        "\"",
        "'",
        "[",
        "]",
        "[[",
        "{",
        "}",
        "#",
        ":",
        ".",
        "/",
        "..",
        "../",
        "%s",
        "NaN",
        "\u{feff}",
        "\u{202e}",
        "é",
        "true",
        "null",
        "1e999",
        "0x",
        "-0",
        "a.b.c = 1\n",
    ]);
    let byte = || prop_oneof![Just(0u8), Just(0xff), Just(0x7f), Just(0x80), any::<u8>()];
    prop_oneof![
        (at(), 0..8u8).prop_map(|(at, bit)| Mutation::Flip { at, bit }),
        (at(), prop::collection::vec(byte(), 1..12)).prop_map(|(at, bytes)| Mutation::Set { at, bytes }),
        at().prop_map(|at| Mutation::Cut { at }),
        (at(), 1..64usize).prop_map(|(at, length)| Mutation::Remove { at, length }),
        (at(), 1..64usize).prop_map(|(at, length)| Mutation::Repeat { at, length }),
        (at(), words).prop_map(|(at, word)| Mutation::Insert { at, word }),
        (at(), numbers).prop_map(|(at, with)| Mutation::Number { at, with }),
    ]
}

/// Applies a mutation.
pub fn mutate(file: &mut Vec<u8>, mutation: &Mutation) {
    if file.is_empty() {
        return;
    }
    match mutation {
        Mutation::Flip { at, bit } => {
            let at = at.index(file.len());
            file[at] ^= 1 << bit;
        }
        Mutation::Set { at, bytes } => {
            let at = at.index(file.len());
            file.iter_mut().skip(at).zip(bytes).for_each(|(old, new)| *old = *new);
        }
        Mutation::Cut { at } => file.truncate(at.index(file.len())),
        Mutation::Remove { at, length } => {
            let at = at.index(file.len());
            file.drain(at..(at + length).min(file.len()));
        }
        Mutation::Repeat { at, length } => {
            let at = at.index(file.len());
            let piece = file[at..(at + length).min(file.len())].to_vec();
            file.splice(at..at, piece);
        }
        Mutation::Insert { at, word } => {
            let at = at.index(file.len());
            file.splice(at..at, word.bytes());
        }
        Mutation::Number { at, with } => {
            let digits = |b: &u8| b.is_ascii_digit();
            let start = at.index(file.len());
            let Some(begin) = file[start..].iter().position(digits).map(|offset| start + offset) else {
                return;
            };
            let end = begin + file[begin..].iter().position(|b| !digits(b)).unwrap_or(file.len() - begin);
            file.splice(begin..end, with.bytes());
        }
    }
}

/// One of these files after up to three mutations.
pub fn mutated(files: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    let files = Arc::new(files);
    (any::<Index>(), prop::collection::vec(mutation(), 1..4)).prop_map(move |(which, mutations)| {
        let mut file = files[which.index(files.len())].clone();
        mutations.iter().for_each(|m| mutate(&mut file, m));
        file
    })
}
