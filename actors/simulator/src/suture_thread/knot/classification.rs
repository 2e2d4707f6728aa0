//! Names of surgical knots, and the throws that they consist of.

use std::fmt;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::diagram::Diagram;
use super::goeritz::signature_and_determinant;
use super::kauffman_bracket::{Laurent, jones};
use super::polygon::{directions, turns_freely};
use super::{KnotError, close_towards, simplified};

/// Handedness of a throw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hand {
    /// Positive crossings.
    Right,
    /// Negative crossings.
    Left,
}

/// One throw: the ends wrapped around each other once, twice …
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Throw {
    /// Number of wraps: 1 for an overhand throw, 2 for a surgeon's throw.
    pub wraps: u32,
    /// Handedness.
    pub hand: Hand,
}

impl Throw {
    /// Half turns of the ends around each other, positive for a right-handed throw: 3 for a single one.
    #[must_use]
    pub fn half_turns(&self) -> i32 {
        let turns = 2 * self.wraps as i32 + 1;
        if self.hand == Hand::Right { turns } else { -turns }
    }
}

/// The name of a knot.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum KnotKind {
    /// No knot.
    Unknot,
    /// 3₁: a single throw, an overhand knot.
    Trefoil(Hand),
    /// 4₁.
    FigureEight,
    /// Two single throws of opposite hands, a reef knot.
    Square,
    /// Two single throws of one hand.
    Granny(Hand),
    /// A double throw and a single one of the opposite hand.
    Surgeon(Hand),
    /// Other sums of throws; a closed curve does not determine their order: most wraps first, right before left.
    Throws(Vec<Throw>),
    /// Any other knot.
    Other,
}

/// A knot and its invariants.
#[derive(Clone, Debug, PartialEq)]
pub struct Knot {
    /// Its name; the hand of a surgeon's knot is that of its double throw.
    pub kind: KnotKind,
    /// Signature: 0 for an amphichiral knot; −2 for the right-handed trefoil.
    pub signature: i32,
    /// Determinant: Alexander's polynomial at −1.
    pub determinant: u64,
    /// Jones polynomial in t.
    pub jones: Laurent,
    /// Crossings of the diagram that was read.
    pub crossings: usize,
}

/// Distance at which the ends of two threads are joined, in radii of all of them: outside of the threads, but nearer
/// than where the two remaining ends are joined.
const AWAY: f64 = 2.0;
/// Maximum number of throws in one knot.
const THROWS_MAX: usize = 5;
/// Maximum number of wraps in one throw.
const WRAPS_MAX: u32 = 3;

impl Knot {
    /// Whether the Jones polynomial equals that of the mirror image.
    #[must_use]
    pub fn is_amphichiral(&self) -> bool {
        self.signature == 0 && self.jones == self.jones.mirrored()
    }
}

impl fmt::Display for Hand {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Right => "right-handed",
            Self::Left => "left-handed",
        })
    }
}

impl fmt::Display for KnotKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Unknot => f.write_str("unknot"),
            Self::Trefoil(hand) => write!(f, "{hand} trefoil"),
            Self::FigureEight => f.write_str("figure-eight knot"),
            Self::Square => f.write_str("square knot"),
            Self::Granny(hand) => write!(f, "{hand} granny knot"),
            Self::Surgeon(hand) => write!(f, "{hand} surgeon's knot"),
            Self::Throws(throws) => write!(f, "knot of {} throws", throws.len()),
            Self::Other => f.write_str("knot without a name"),
        }
    }
}

/// Throws in order in surgical notation (Tera, Åberg 1976): wraps, with `=` between throws of opposite hands and `x`
/// between throws of the same hand.
#[must_use]
pub fn notation(throws: &[Throw]) -> String {
    let mut text = String::new();
    for (i, throw) in throws.iter().enumerate() {
        if i > 0 {
            text.push(if throws[i - 1].hand == throw.hand { 'x' } else { '=' });
        }
        text.push_str(&throw.wraps.to_string());
    }
    text
}

/// The knot of an open thread: the most frequent one over its closures, see [`close_towards`]; at a tie, the first
/// found.
///
/// # Errors
/// Why the crossings cannot be read in any closure.
pub fn identify(points: &[Point3<f64>]) -> Result<Knot, KnotError> {
    let mut found: Vec<(Knot, usize)> = Vec::new();
    // The directions tried, each with the index of the knot found.
    let mut closed: Vec<(Vector3<f64>, Option<usize>)> = Vec::new();
    let mut error = None;
    let all = directions().count();
    for direction in directions() {
        let same = closed.iter().find(|(other, _)| turns_freely(points, other, &direction));
        let of = match same {
            Some((_, of)) => *of,
            None => match identify_closed(&close_towards(points, &direction)?) {
                Ok(knot) => {
                    let same = |(of, _): &(Knot, usize)| (&of.kind, &of.jones) == (&knot.kind, &knot.jones);
                    Some(found.iter().position(same).unwrap_or_else(|| {
                        found.push((knot, 0));
                        found.len() - 1
                    }))
                }
                Err(other) => {
                    error = error.or(Some(other));
                    None
                }
            },
        };
        closed.push((direction, of));
        if let Some(of) = of {
            found[of].1 += 1;
            // The remaining directions cannot change the majority.
            if 2 * found[of].1 > all {
                break;
            }
        }
    }
    // The first of those with most votes.
    let most = found.iter().map(|(_, votes)| *votes).max();
    match (found.into_iter().find(|(_, votes)| Some(*votes) == most), error) {
        (Some((knot, _)), _) => Ok(knot),
        (None, error) => Err(error.unwrap_or(KnotError::Points(points.len()))),
    }
}

/// The knot of several threads taken as one: the end of each is extended and joined to the beginning of the next, and
/// the first and last end as for a single thread ([`identify`]). Two threads tied together by throws of their ends give
/// the same knot as one thread tied by such throws with its loop cut.
///
/// # Errors
/// Why the crossings cannot be read in any closure.
pub fn identify_joined(threads: &[&[Point3<f64>]]) -> Result<Knot, KnotError> {
    if let [one] = threads {
        return identify(one);
    }
    let places = threads.iter().flat_map(|thread| thread.iter());
    let middle =
        places.clone().map(|at| at.coords).sum::<Vector3<f64>>() / places.clone().count().max(1) as f64;
    let radius = places.map(|at| (at.coords - middle).norm()).fold(0.0, f64::max);
    let mut found: Vec<(Knot, usize)> = Vec::new();
    let mut error = None;
    for direction in directions() {
        let mut line: Vec<Point3<f64>> = Vec::new();
        for thread in threads {
            let [Some(first), Some(last)] = [thread.first(), thread.last()] else {
                return Err(KnotError::Points(thread.len()));
            };
            // Nearer than where the two remaining ends are joined, so that no two of the extensions cross there.
            let away = direction * (radius * AWAY);
            line.push(first + away);
            line.extend_from_slice(thread);
            line.push(last + away);
        }
        line.remove(0);
        line.pop();
        match identify_closed(&close_towards(&line, &direction)?) {
            Ok(knot) => {
                let same = |(of, _): &&mut (Knot, usize)| (&of.kind, &of.jones) == (&knot.kind, &knot.jones);
                match found.iter_mut().find(same) {
                    Some((_, votes)) => *votes += 1,
                    None => found.push((knot, 1)),
                }
            }
            Err(other) => error = error.or(Some(other)),
        }
    }
    let most = found.iter().map(|(_, votes)| *votes).max();
    match (found.into_iter().find(|(_, votes)| Some(*votes) == most), error) {
        (Some((knot, _)), _) => Ok(knot),
        (None, error) => Err(error.unwrap_or(KnotError::Points(threads.len()))),
    }
}

/// The knot of a closed curve; its last point is joined to its first.
///
/// # Errors
/// Why its crossings cannot be read.
pub fn identify_closed(points: &[Point3<f64>]) -> Result<Knot, KnotError> {
    // A self-intersecting curve is rejected before its corners are removed.
    if let Some(bad) = points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
        return Err(KnotError::NotFinite(bad));
    }
    let diagram = Diagram::of(&simplified(points))?.simplified();
    let (signature, determinant) = signature_and_determinant(&diagram);
    let jones = jones(&diagram)?;
    Ok(Knot { kind: kind(&jones, signature), signature, determinant, jones, crossings: diagram.crossings() })
}

/// The throws that a knot is the sum of, most wraps first.
pub(super) fn factors(kind: &KnotKind) -> Vec<Throw> {
    let single = |hand: Hand| Throw { wraps: 1, hand };
    match kind {
        KnotKind::Unknot | KnotKind::FigureEight | KnotKind::Other => Vec::new(),
        KnotKind::Trefoil(hand) => vec![single(*hand)],
        KnotKind::Square => vec![single(Hand::Right), single(Hand::Left)],
        KnotKind::Granny(hand) => vec![single(*hand); 2],
        KnotKind::Surgeon(hand) => {
            let other = if *hand == Hand::Right { Hand::Left } else { Hand::Right };
            vec![Throw { wraps: 2, hand: *hand }, single(other)]
        }
        KnotKind::Throws(throws) => throws.clone(),
    }
}

/// Jones polynomial of the torus knot of `2·wraps + 1` half turns (Jones 1987), right-handed:
/// `t^w (1 + t² − t³ + t⁴ … − t^{2w+1})`.
fn torus(wraps: u32) -> Laurent {
    let w = wraps as i32;
    let mut polynomial = Laurent::term(1, w);
    for k in 2..=2 * w + 1 {
        polynomial = polynomial.plus(&Laurent::term(if k % 2 == 0 { 1 } else { -1 }, w + k));
    }
    polynomial
}

fn of_throw(throw: &Throw) -> Laurent {
    let polynomial = torus(throw.wraps);
    if throw.hand == Hand::Right { polynomial } else { polynomial.mirrored() }
}

fn kind(jones: &Laurent, signature: i32) -> KnotKind {
    if *jones == Laurent::term(1, 0) {
        return KnotKind::Unknot;
    }
    if *jones == (Laurent { lowest: -2, coefficients: vec![1, -1, 1, -1, 1] }) && signature == 0 {
        return KnotKind::FigureEight;
    }
    let mut kinds = Vec::new();
    for wraps in (1..=WRAPS_MAX).rev() {
        kinds.extend([Hand::Right, Hand::Left].map(|hand| Throw { wraps, hand }));
    }
    let mut chosen = Vec::new();
    if !product(jones, signature, &Laurent::term(1, 0), &kinds, &mut chosen) {
        return KnotKind::Other;
    }
    match chosen[..] {
        [Throw { wraps: 1, hand }] => KnotKind::Trefoil(hand),
        [Throw { wraps: 1, hand: a }, Throw { wraps: 1, hand: b }] if a == b => KnotKind::Granny(a),
        [Throw { wraps: 1, .. }, Throw { wraps: 1, .. }] => KnotKind::Square,
        [Throw { wraps: 2, hand: a }, Throw { wraps: 1, hand: b }] if a != b => KnotKind::Surgeon(a),
        _ => KnotKind::Throws(chosen),
    }
}

/// Finds throws, in the order of `kinds`, whose polynomials multiply to `wanted` and whose signatures add up.
fn product(
    wanted: &Laurent,
    signature: i32,
    so_far: &Laurent,
    kinds: &[Throw],
    chosen: &mut Vec<Throw>,
) -> bool {
    if !chosen.is_empty() && so_far == wanted {
        let sum: i32 = chosen
            .iter()
            .map(|throw| throw.wraps as i32 * if throw.hand == Hand::Right { -2 } else { 2 })
            .sum();
        return sum == signature;
    }
    // The span of a product is the sum of the spans of its factors.
    if chosen.len() == THROWS_MAX || so_far.coefficients.len() >= wanted.coefficients.len() {
        return false;
    }
    for (k, throw) in kinds.iter().enumerate() {
        chosen.push(*throw);
        if product(wanted, signature, &so_far.times(&of_throw(throw)), &kinds[k..], chosen) {
            return true;
        }
        chosen.pop();
    }
    false
}
