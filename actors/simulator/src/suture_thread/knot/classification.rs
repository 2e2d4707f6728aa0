//! Names of the knots that threads are tied into, and the throws that they are made of.

use std::fmt;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::diagram::Diagram;
use super::goeritz::signature_and_determinant;
use super::kauffman_bracket::{Laurent, jones};
use super::polygon::{directions, turns_freely};
use super::{KnotError, close_towards, simplified};

/// Which way a throw is twisted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Hand {
    /// Its crossings are positive.
    Right,
    /// Its crossings are negative.
    Left,
}

/// One throw: the ends led around each other once, twice …
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Throw {
    /// How often: 1 for an overhand throw, 2 for a surgeon's.
    pub wraps: u32,
    /// Which way.
    pub hand: Hand,
}

impl Throw {
    /// How often the ends are led half way around each other, positive for a right-handed throw: 3 for a single one.
    #[must_use]
    pub fn half_turns(&self) -> i32 {
        let turns = 2 * self.wraps as i32 + 1;
        if self.hand == Hand::Right { turns } else { -turns }
    }
}

/// What a knot is called.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum KnotKind {
    /// None at all.
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
    /// Other sums of throws; their order cannot be told from a closed curve: most wraps first, right before left.
    Throws(Vec<Throw>),
    /// None of these.
    Other,
}

/// A knot by its invariants.
#[derive(Clone, Debug, PartialEq)]
pub struct Knot {
    /// Its name; the hand of a surgeon's knot is that of its double throw.
    pub kind: KnotKind,
    /// 0 for what is its own mirror image; −2 for the right-handed trefoil.
    pub signature: i32,
    /// Of Alexander's polynomial at −1.
    pub determinant: u64,
    /// In t.
    pub jones: Laurent,
    /// Of the diagram in which it was read.
    pub crossings: usize,
}

/// How far out the ends of two threads are joined, in radii of all of them: beyond them, and nearer than the two ends that are
/// left.
const AWAY: f64 = 2.0;
/// Throws of one knot at most.
const THROWS_MAX: usize = 5;
/// Wraps of one throw at most.
const WRAPS_MAX: u32 = 3;

impl Knot {
    /// Whether the Jones polynomial takes it for its own mirror image.
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

/// Throws in order as surgeons write them (Tera, Åberg 1976): wraps, with `=` between throws of opposite hands and `x`
/// between throws of one hand.
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

/// The knot of a thread, open at both ends: the one that most of its closures have, see [`close_towards`]; of equally
/// many the one that was found first.
///
/// # Errors
/// What keeps the crossings of all closures from being read.
pub fn identify(points: &[Point3<f64>]) -> Result<Knot, KnotError> {
    let mut found: Vec<(Knot, usize)> = Vec::new();
    // Directions that were closed towards, and which of those that were found each gave.
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
            // Those that are left cannot change it any more.
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

/// The knot of several threads taken as one: the end of each is led away and joined to the beginning of the next, as the
/// first end and the last are joined of one alone ([`identify`]). Two threads tied together by throws of their ends are the
/// knot that one thread is which is tied into such throws, its loop cut through.
///
/// # Errors
/// What keeps the crossings of all closures from being read.
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
            // Nearer than where the two that are left are joined, so that no two of the lines there cross.
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
/// What keeps its crossings from being read.
pub fn identify_closed(points: &[Point3<f64>]) -> Result<Knot, KnotError> {
    // A curve that meets itself is refused before its corners are taken out.
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

/// Looks for throws, in the order of `kinds`, whose polynomials multiply to `wanted` and whose signatures add up.
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
    // Products are as broad as their factors together.
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
