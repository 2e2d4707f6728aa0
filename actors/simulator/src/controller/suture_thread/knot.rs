//! Classification of a thread's knot: its name, its throws in tying order with their handedness, and the knot
//! invariants that identify it.
//!
//! One evaluation gives the knot and the throws that it is composed of; the order of unequal throws takes several
//! ([`ThrowReader`]). `KnotWatch` (`knot_job.rs`) schedules them.

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, RecordPolicy};

use crate::suture_thread::knot::{
    Knot, KnotKind, Throw, ThrowReader, identify_closed, identify_joined, notation,
};

/// Maximum number of throws of a knot.
const THROWS_MAX: usize = 8;

/// The knot as a measure: 0 none, 1 a single throw, 2 a figure-eight, 3 square, 4 granny, 5 surgeon's, 6 another
/// sequence of throws, 7 unnamed, −1 not identified.
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

/// The last classification of a thread's knot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "knot_state", record = RecordPolicy::sampled(10.0, 1e-6), check = Self::ranges)]
#[serde(default, deny_unknown_fields)]
pub struct KnotState {
    /// Code as in [`knot_code`].
    pub code: f64,
    /// Its name.
    pub name: String,
    /// Half turns of each throw, positive for right-handed ones; in tying order once `in_order`, else by decreasing
    /// number of half turns.
    pub throws: Vec<i32>,
    /// Whether the order of the throws is known.
    pub in_order: bool,
    /// The throws in surgical notation, once their order is known: `1=1x2`.
    pub notation: String,
    /// Signature of the knot: −2 for a right-handed single throw, 0 for an amphichiral knot.
    pub signature: i32,
    /// Knot determinant: Alexander's polynomial at −1; equal for square knots and grannies.
    pub determinant: u64,
    /// Whether it is amphichiral, as far as its Jones polynomial tells.
    pub amphichiral: bool,
    /// Progress of reading the order of the throws.
    pub reading: Option<ThrowReader>,
}

impl KnotState {
    /// One more evaluation of the throws' order; `None` where they do not come undone one by one in this configuration.
    pub(crate) fn read_next(mut self, points: &[Point3<f64>]) -> Option<Self> {
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

    /// Classifies threads through these nodes, joined end to end \[m\]; the order of throws is read for a single thread
    /// only.
    pub(crate) fn of(threads: &[&[Point3<f64>]]) -> Self {
        match identify_joined(threads) {
            Ok(knot) => Self::named(&knot, threads.len() == 1),
            Err(_) => Self { code: knot_code(None), ..Self::default() },
        }
    }

    /// Classifies a closed thread through these nodes: it is closed already. The order of throws is not told: they are not
    /// tied with ends.
    pub(crate) fn of_closed(points: &[Point3<f64>]) -> Self {
        match identify_closed(points) {
            Ok(knot) => Self::named(&knot, false),
            Err(_) => Self { code: knot_code(None), ..Self::default() },
        }
    }

    fn named(knot: &Knot, has_ends: bool) -> Self {
        let reading = ThrowReader::new(&knot.kind);
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
        } else if has_ends {
            state.reading = Some(reading);
        }
        state
    }

    /// Stores the throws in their known order.
    fn order(&mut self, throws: &[Throw]) {
        self.throws = throws.iter().map(Throw::half_turns).collect();
        self.notation = notation(throws);
        self.in_order = true;
    }

    /// Whether both are the same knot, composed of the same throws.
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

    /// Whether the handedness of consecutive throws alternates.
    #[must_use]
    pub fn alternates(&self) -> bool {
        self.in_order
            && self.throws.len() > 1
            && self.throws.windows(2).all(|pair| pair[0].signum() != pair[1].signum())
    }

    /// Measures of the thread called `name`: the knot, the number of throws, whether they alternate, the handedness of
    /// the first one (1 right, −1 left, 0 not known), the signature.
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

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("throws", self.throws.len() as f64, 0.0..=THROWS_MAX as f64, "0 to 8")
    }
}
