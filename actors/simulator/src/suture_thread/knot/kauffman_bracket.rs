//! The Jones polynomial by Kauffman's bracket (Kauffman 1987), crossing by crossing over the pairings of open arcs
//! (Bar-Natan's planar algebra), so that its cost grows with the width of the diagram and not with `2ⁿ`.

use std::collections::BTreeMap;

use super::KnotError;
use super::diagram::Diagram;

/// Maximum number of crossings of a simplified diagram.
pub const CROSSINGS_MAX: usize = 40;
/// Maximum number of pairings at once.
const PAIRINGS_MAX: usize = 5_000;
/// Maximum number of arcs of a diagram.
const ARCS_MAX: usize = 2 * CROSSINGS_MAX;
/// No arc.
const NONE: u8 = u8::MAX;

/// A Laurent polynomial, with powers from `lowest` upwards.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Laurent {
    /// Power of the first coefficient.
    pub lowest: i32,
    /// Coefficients of consecutive powers; neither first nor last is 0.
    pub coefficients: Vec<i64>,
}

impl Laurent {
    /// A monomial.
    #[must_use]
    pub fn term(coefficient: i64, power: i32) -> Self {
        Self { lowest: power, coefficients: vec![coefficient] }.trimmed()
    }

    /// The sum of two polynomials.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        if self.coefficients.is_empty() || other.coefficients.is_empty() {
            return if self.coefficients.is_empty() { other.clone() } else { self.clone() };
        }
        let end = |of: &Self| of.lowest + of.coefficients.len() as i32;
        let lowest = self.lowest.min(other.lowest);
        let mut coefficients = vec![0; (end(self).max(end(other)) - lowest) as usize];
        for of in [self, other] {
            for (k, value) in of.coefficients.iter().enumerate() {
                coefficients[(of.lowest - lowest) as usize + k] += value;
            }
        }
        Self { lowest, coefficients }.trimmed()
    }

    /// The product of two polynomials.
    #[must_use]
    pub fn times(&self, other: &Self) -> Self {
        if self.coefficients.is_empty() || other.coefficients.is_empty() {
            return Self::default();
        }
        let mut coefficients = vec![0; self.coefficients.len() + other.coefficients.len() - 1];
        for (i, a) in self.coefficients.iter().enumerate() {
            for (j, b) in other.coefficients.iter().enumerate() {
                coefficients[i + j] += a * b;
            }
        }
        Self { lowest: self.lowest + other.lowest, coefficients }.trimmed()
    }

    /// Adds `other · times · xᵖᵒʷᵉʳ`. Zeros at the ends stay until it is [trimmed](Self::trimmed).
    fn add(&mut self, other: &Self, times: i64, power: i32) {
        if other.coefficients.is_empty() {
            return;
        }
        if self.coefficients.is_empty() {
            self.lowest = other.lowest + power;
        }
        let from = other.lowest + power;
        if from < self.lowest {
            let more = (self.lowest - from) as usize;
            self.coefficients.splice(..0, std::iter::repeat_n(0, more));
            self.lowest = from;
        }
        let at = (from - self.lowest) as usize;
        if self.coefficients.len() < at + other.coefficients.len() {
            self.coefficients.resize(at + other.coefficients.len(), 0);
        }
        for (sum, value) in self.coefficients[at..].iter_mut().zip(&other.coefficients) {
            *sum += times * value;
        }
    }

    /// The polynomial of the mirror image.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let highest = self.lowest + self.coefficients.len() as i32 - 1;
        Self { lowest: -highest, coefficients: self.coefficients.iter().rev().copied().collect() }
    }

    fn trimmed(mut self) -> Self {
        while self.coefficients.last() == Some(&0) {
            self.coefficients.pop();
        }
        let zeros = self.coefficients.iter().take_while(|&&value| value == 0).count();
        self.coefficients.drain(..zeros);
        self.lowest = if self.coefficients.is_empty() { 0 } else { self.lowest + zeros as i32 };
        self
    }
}

/// A pairing of open arcs: each open arc has the arc at its other end, all others [`NONE`].
type Pairing = [u8; ARCS_MAX];

/// The Jones polynomial of a diagram, in t.
///
/// # Errors
/// More crossings, or more pairings at once, than can be handled.
pub fn jones(diagram: &Diagram) -> Result<Laurent, KnotError> {
    let crossings = diagram.crossings();
    if crossings > CROSSINGS_MAX {
        return Err(KnotError::TooManyCrossings(crossings));
    }
    if crossings == 0 {
        return Ok(Laurent::term(1, 0));
    }
    let places = diagram.places();
    // Powers of −A² − A⁻², the factors for 0, 1 and 2 closed circles.
    let circles: [&[(i32, i64)]; 3] = [&[(0, 1)], &[(-2, -1), (2, -1)], &[(-4, 1), (0, 2), (4, 1)]];
    let mut states: BTreeMap<Pairing, Laurent> = BTreeMap::from([([NONE; ARCS_MAX], Laurent::term(1, 0))]);
    for crossing in order(diagram, &places) {
        let [a, b, c, d] = diagram.around(crossing, &places).map(|(arc, _)| arc as u8);
        let mut next: BTreeMap<Pairing, Laurent> = BTreeMap::new();
        for (pairing, value) in &states {
            for (power, joins) in [(1, [(a, b), (c, d)]), (-1, [(a, d), (b, c)])] {
                let mut pairing = *pairing;
                let closed = joins.map(|(one, other)| usize::from(join(&mut pairing, one, other)));
                let sum = next.entry(pairing).or_default();
                for (more, times) in circles[closed[0] + closed[1]] {
                    sum.add(value, *times, power + more);
                }
            }
        }
        states = next;
        if states.len() > PAIRINGS_MAX {
            return Err(KnotError::TooManyCrossings(crossings));
        }
    }
    let bracket = states.into_values().fold(Laurent::default(), |sum, value| sum.plus(&value));
    let writhe = diagram.writhe();
    let sign = if writhe % 2 == 0 { 1 } else { -1 };
    let framed = bracket.times(&Laurent::term(sign, -3 * writhe));
    // Divides out one circle; t is A⁻⁴.
    let framed = divided_by_circle(&framed);
    let mut jones = Laurent::default();
    for (k, &value) in framed.coefficients.iter().enumerate() {
        jones = jones.plus(&Laurent::term(value, -(framed.lowest + k as i32) / 4));
    }
    Ok(jones)
}

/// Order of the crossings in which each next one touches as many open arcs as possible.
fn order(diagram: &Diagram, places: &[[usize; 2]]) -> Vec<usize> {
    let crossings = diagram.crossings();
    let mut touched = vec![false; 2 * crossings];
    let mut left: Vec<_> = (0..crossings).collect();
    let mut order = Vec::with_capacity(crossings);
    while !left.is_empty() {
        let open = |crossing: usize| {
            diagram.around(crossing, places).iter().filter(|(arc, _)| touched[*arc]).count()
        };
        let best = (0..left.len()).max_by_key(|&k| (open(left[k]), usize::MAX - left[k])).unwrap_or(0);
        let crossing = left.remove(best);
        for (arc, _) in diagram.around(crossing, places) {
            touched[arc] = !touched[arc];
        }
        order.push(crossing);
    }
    order
}

/// Joins the ends of two arcs; true where that closes a circle. An arc that is already open is replaced by its other
/// end.
fn join(pairing: &mut Pairing, one: u8, other: u8) -> bool {
    let mut met = |arc: u8| std::mem::replace(&mut pairing[usize::from(arc)], NONE);
    let first = met(one);
    if one == other && first == NONE {
        // Both ends of the same open strand.
        return true;
    }
    let second = met(other);
    if first == other {
        return true;
    }
    let end = |far: u8, near: u8| if far == NONE { near } else { far };
    let (first, second) = (end(first, one), end(second, other));
    pairing[usize::from(first)] = second;
    pairing[usize::from(second)] = first;
    false
}

/// Divides by −A² − A⁻², without remainder.
fn divided_by_circle(of: &Laurent) -> Laurent {
    let mut rest = of.coefficients.clone();
    let mut quotient = vec![0; rest.len().saturating_sub(4)];
    for k in 0..quotient.len() {
        quotient[k] = -rest[k];
        rest[k + 4] += quotient[k];
    }
    Laurent { lowest: of.lowest + 2, coefficients: quotient }.trimmed()
}
