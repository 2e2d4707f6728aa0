//! Which knot a thread on a scene is tied into: its name, its throws in their order and with their hands, and what tells it
//! from others.
//!
//! What knot it is, and which throws it is the sum of, one look tells; the order of throws that are not all alike takes many
//! ([`Reading`]). `KnotWatch` (`knot_job.rs`) says when.

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError};

use crate::suture_thread::knot::{KnotKind, Reading, Throw, identify_joined, notation};

/// Throws of a knot at most.
const THROWS_MAX: usize = 8;

/// The knot as a measure: 0 none, 1 a single throw, 2 a figure-eight, 3 square, 4 granny, 5 surgeon's, 6 other throws one
/// after the other, 7 one without a name, −1 one that cannot be told.
#[must_use]
pub fn knot_code(kind: Option<&KnotKind>) -> f64 {
    match kind {
        Some(KnotKind::Unknot) => 0.0,
        Some(KnotKind::Trefoil(_)) => 1.0,
        Some(KnotKind::FigureEight) => 2.0,
        Some(KnotKind::Square) => 3.0,
        Some(KnotKind::Granny(_)) => 4.0,
        Some(KnotKind::Surgeon(_)) => 5.0,
        Some(KnotKind::Throws(_)) => 6.0,
        Some(KnotKind::Other) => 7.0,
        None => -1.0,
    }
}

/// What a thread was last found to be tied into.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KnotState {
    /// As [`knot_code`] tells.
    pub code: f64,
    /// What it is called.
    pub name: String,
    /// Half turns of each throw, positive for right-handed ones; the one that was tied first comes first once they are
    /// `in_order`, else the one of most turns.
    pub throws: Vec<i32>,
    /// Whether the order of the throws is known.
    pub in_order: bool,
    /// The throws as surgeons write them, once their order is known: `1=1x2`.
    pub notation: String,
    /// Of the knot: −2 for a right-handed single throw, 0 for what is its own mirror image.
    pub signature: i32,
    /// Of Alexander's polynomial at −1; the same for square knots and grannies.
    pub determinant: u64,
    /// Whether it is its own mirror image, as far as its Jones polynomial tells.
    pub amphichiral: bool,
    /// How far the order of the throws has been read.
    pub reading: Option<Reading>,
}

impl Component for KnotState {
    const NAME: &'static str = "knot_state";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        ComponentError::range("throws", self.throws.len() as f64, 0.0..=THROWS_MAX as f64, "0 to 8")
    }
}

impl KnotState {
    /// One look further at the order of its throws; `None` where they do not come undone one by one as they lie.
    pub(crate) fn read_on(mut self, points: &[Point3<f64>]) -> Option<Self> {
        let reading = self.reading.as_mut()?;
        if !reading.look(points) {
            return None;
        }
        if reading.is_done() {
            let throws = reading.throws();
            self.reading = None;
            self.order(&throws);
        }
        Some(self)
    }

    /// Of threads through these nodes, joined one to the other \[m\]; the order of throws is read of one alone.
    pub(crate) fn of(threads: &[&[Point3<f64>]]) -> Self {
        let Ok(knot) = identify_joined(threads) else {
            return Self { code: knot_code(None), ..Self::default() };
        };
        let reading = Reading::new(&knot.kind);
        let throws = reading.throws();
        let mut state = Self {
            code: knot_code(Some(&knot.kind)),
            name: knot.kind.to_string(),
            throws: throws.iter().map(Throw::half_turns).collect(),
            signature: knot.signature,
            determinant: knot.determinant,
            amphichiral: knot.is_amphichiral(),
            ..Self::default()
        };
        if reading.is_done() {
            state.order(&throws);
        } else if threads.len() == 1 {
            state.reading = Some(reading);
        }
        state
    }

    /// Their order is known.
    fn order(&mut self, throws: &[Throw]) {
        self.throws = throws.iter().map(Throw::half_turns).collect();
        self.notation = notation(throws);
        self.in_order = true;
    }

    /// Whether they are the same knot, and the sum of the same throws.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        let sorted = |throws: &[i32]| {
            let mut sorted = throws.to_vec();
            sorted.sort_unstable();
            sorted
        };
        (self.code, &self.name, self.signature, self.determinant)
            == (other.code, &other.name, other.signature, other.determinant)
            && sorted(&self.throws) == sorted(&other.throws)
    }

    /// Whether each of several throws is of the other hand than the one before.
    #[must_use]
    pub fn alternates(&self) -> bool {
        self.in_order
            && self.throws.len() > 1
            && self.throws.windows(2).all(|pair| pair[0].signum() != pair[1].signum())
    }

    /// Measures of the thread called `name`: which knot, how many throws, whether they alternate, the hand of the first one
    /// (1 right, −1 left, 0 not known), the signature.
    pub fn measure(&self, name: &str, values: &mut BTreeMap<String, f64>) {
        let first = self.throws.first().filter(|_| self.in_order);
        for (what, value) in [
            ("knot", self.code),
            ("knot_throws", self.throws.len() as f64),
            ("knot_alternates", f64::from(u8::from(self.alternates()))),
            ("knot_hand", first.map_or(0.0, |turns| f64::from(turns.signum()))),
            ("knot_signature", f64::from(self.signature)),
        ] {
            values.insert(format!("{name}.{what}"), value);
        }
    }
}
