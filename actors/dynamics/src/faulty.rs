//! Lists of invalid elements, for error messages.

/// Invalid elements that a message lists; the others are only counted.
const NAMED: usize = 16;

/// Indices with the same defect: the first few, and the count.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Faulty {
    /// The first 16, in ascending order.
    pub first: Vec<u32>,
    /// Their total number.
    pub count: usize,
}

impl Faulty {
    /// Collects the indices for which `bad` holds.
    pub fn among(count: usize, mut bad: impl FnMut(usize) -> bool) -> Self {
        let mut faulty = Self::default();
        for index in (0..count).filter(|&index| bad(index)) {
            if faulty.first.len() < NAMED {
                faulty.first.push(index as u32);
            }
            faulty.count += 1;
        }
        faulty
    }
    /// Returns an error if there are any.
    pub fn refuse<E>(self, error: impl FnOnce(Self) -> E) -> Result<(), E> {
        if self.count == 0 { Ok(()) } else { Err(error(self)) }
    }
}

impl std::fmt::Display for Faulty {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for (place, index) in self.first.iter().enumerate() {
            let comma = if place == 0 { "" } else { ", " };
            write!(formatter, "{comma}{index}")?;
        }
        match self.count.saturating_sub(self.first.len()) {
            0 => Ok(()),
            more => write!(formatter, " and {more} more"),
        }
    }
}
