//! Candidate triangles with a certificate, for an object moving near a moving surface: lower bounds of the distance of
//! each candidate and of all other triangles, reduced by the motion since the query. While the certificate holds, no
//! tree query is needed.

/// A triangle found by a query.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate<T> {
    pub(crate) triangle: u32,
    /// Lower bound of its distance \[m\].
    pub(crate) at_least: f64,
    /// Data of the caller.
    pub(crate) note: T,
}

/// Slots per block; each block keeps its earliest expiry, so that most blocks are skipped at once.
const BLOCK: usize = 16;
/// Most blocks; further slots are searched one by one.
const BLOCKS: usize = 16;

/// Number of nearest candidates stored first.
const FIRST: usize = 2 * BLOCK;

/// At most `KEPT` candidates, the nearest first.
#[derive(Clone, Debug)]
pub(crate) struct Candidates<T, const KEPT: usize> {
    triangle: [u32; KEPT],
    /// Lower bound of the distance plus the travelled distance at that time \[m\].
    due: [f64; KEPT],
    note: [T; KEPT],
    /// Lower bound of `due` in each block \[m\].
    soonest: [f64; BLOCKS],
    count: usize,
    /// The same for all triangles that are no candidates \[m\].
    others_due: f64,
    /// Upper bound of the motion of the object and the surface since the last gathering \[m\].
    travelled: f64,
    /// Upper limit of the stored distance bounds \[m\].
    horizon: f64,
}

impl<T: Copy + Default, const KEPT: usize> Candidates<T, KEPT> {
    /// No candidates and no certificate.
    pub(crate) fn none() -> Self {
        Self {
            triangle: [0; KEPT],
            due: [0.0; KEPT],
            note: [T::default(); KEPT],
            soonest: [f64::NEG_INFINITY; BLOCKS],
            count: 0,
            others_due: f64::NEG_INFINITY,
            travelled: 0.0,
            horizon: 0.0,
        }
    }

    /// Upper limit of the stored distance bounds \[m\], until the next gathering: motion that only approaches triangles
    /// beyond it need not be counted.
    pub(crate) fn horizon(&self) -> f64 {
        self.horizon
    }

    pub(crate) fn travel(&mut self, distance: f64) {
        self.travelled += distance;
    }

    /// Whether all triangles nearer than `distance` are candidates.
    pub(crate) fn certify(&self, distance: f64) -> bool {
        self.others_at_least() >= distance
    }

    /// Lower bound of the distance of all other triangles \[m\].
    pub(crate) fn others_at_least(&self) -> f64 {
        self.others_due - self.travelled
    }

    /// Drops candidates and certificate.
    pub(crate) fn forget(&mut self) {
        (self.count, self.others_due, self.travelled) = (0, f64::NEG_INFINITY, 0.0);
    }

    /// Stores the triangles found by a query; all others are not nearer than `limit`. Surplus ones count among the
    /// others. Returns how many are within the limit.
    pub(crate) fn gather(&mut self, found: &mut Vec<Candidate<T>>, limit: f64) -> usize {
        found.retain(|found| found.at_least < limit);
        self.travelled = 0.0;
        self.others_due = limit;
        self.horizon = limit;
        let order = |a: &Candidate<T>, b: &Candidate<T>| {
            a.at_least.total_cmp(&b.at_least).then(a.triangle.cmp(&b.triangle))
        };
        if found.len() > KEPT {
            let (_, first_out, _) = found.select_nth_unstable_by(KEPT, order);
            self.others_due = first_out.at_least;
        }
        let gathered = found.len();
        found.truncate(KEPT);
        // The nearest are tested most often, so they are stored together, and first.
        if found.len() > FIRST {
            found.select_nth_unstable_by(FIRST, order);
        }
        self.count = found.len();
        for (slot, found) in found.iter().enumerate() {
            self.triangle[slot] = found.triangle;
            self.due[slot] = found.at_least;
            self.note[slot] = found.note;
        }
        // Each is tested once before its bound is known.
        self.soonest = [f64::NEG_INFINITY; BLOCKS];
        gathered
    }

    /// The next slot from `from` on whose triangle may be within `distance` now.
    #[inline]
    pub(crate) fn next_within(&mut self, from: usize, distance: f64) -> Option<usize> {
        let due = distance + self.travelled;
        let mut slot = from;
        while slot < self.count {
            let block = slot / BLOCK;
            let end = ((block + 1) * BLOCK).min(self.count);
            if self.soonest.get(block).is_none_or(|soonest| *soonest <= due) {
                if let Some(found) = (slot..end).find(|&slot| self.due[slot] <= due) {
                    return Some(found);
                }
                let soonest = least(&self.due[block * BLOCK..end]);
                if let Some(known) = self.soonest.get_mut(block) {
                    *known = soonest;
                }
            }
            slot = end;
        }
        None
    }

    /// The slot of a triangle.
    pub(crate) fn place(&self, triangle: u32) -> Option<usize> {
        self.triangle[..self.count].iter().position(|&own| own == triangle)
    }

    /// Sets a triangle's current lower bound of the distance \[m\].
    pub(crate) fn set(&mut self, slot: usize, at_least: f64) {
        let due = at_least.min(self.horizon) + self.travelled;
        self.due[slot] = due;
        if let Some(soonest) = self.soonest.get_mut(slot / BLOCK) {
            *soonest = soonest.min(due);
        }
    }

    pub(crate) fn note(&self, slot: usize) -> &T {
        &self.note[slot]
    }

    pub(crate) fn set_note(&mut self, slot: usize, note: T) {
        self.note[slot] = note;
    }

    /// Whether a triangle may be as near as `distance` now.
    pub(crate) fn may_reach(&self, slot: usize, distance: f64) -> bool {
        self.due[slot] <= distance + self.travelled
    }

    pub(crate) fn len(&self) -> usize {
        self.count
    }

    pub(crate) fn triangle(&self, slot: usize) -> u32 {
        self.triangle[slot]
    }
}

/// Written as four-lane selects, one instruction each; `f64::min` takes several because of NaN.
#[inline]
fn least(values: &[f64]) -> f64 {
    let smaller = |a: f64, b: f64| if b < a { b } else { a };
    let (fours, rest) = values.as_chunks::<4>();
    let mut least = [f64::INFINITY; 4];
    for four in fours {
        for (least, value) in least.iter_mut().zip(four) {
            *least = smaller(*least, *value);
        }
    }
    rest.iter().chain(&least).fold(f64::INFINITY, |a, b| smaller(a, *b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]
        /// Blocks hide no candidate, for any sequence of updates and motions.
        #[test]
        fn the_next_ones_within_reach_are_those_that_may_reach(
            distances in prop::collection::vec(0.0..1.0_f64, 0..60),
            deeds in prop::collection::vec((0_usize..60, 0.0..1.0_f64, 0.0..0.1_f64, 0.0..0.5_f64), 0..20)
        ) {
            let mut candidates = Candidates::<(), 48>::none();
            let found = |(triangle, &at_least): (usize, &f64)| Candidate { triangle: triangle as u32, at_least, note: () };
            candidates.gather(&mut distances.iter().enumerate().map(found).collect(), 2.0);
            for (slot, at_least, motion, reach) in deeds {
                candidates.travel(motion);
                if slot < candidates.len() {
                    candidates.set(slot, 3.0 * at_least);
                    prop_assert!(candidates.may_reach(slot, candidates.horizon()));
                }
                let mut within = Vec::new();
                let mut next = candidates.next_within(0, reach);
                while let Some(slot) = next {
                    within.push(slot);
                    next = candidates.next_within(slot + 1, reach);
                }
                let expected: Vec<usize> =
                    (0..candidates.len()).filter(|&slot| candidates.may_reach(slot, reach)).collect();
                prop_assert_eq!(within, expected);
            }
        }
    }
}
