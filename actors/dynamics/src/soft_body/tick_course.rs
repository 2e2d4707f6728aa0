//! Division of a soft body's tick into steps: equal parts where it meets rigid bodies, each of them halved as often as
//! instruments ask for. Methods keep factors for a length of step, so that few lengths are better than the best ones.

/// Shortest step that a tick is divided into for instruments \[s\].
pub(super) const STEP_SHORTEST: f64 = 1.1e-3;
/// Longest tick in which instruments go on as they go at its beginning \[s\]. In a longer one the tremor of a hand alone
/// would lead them astray by half a millimetre and more: they stay, and the tick is not divided for them.
pub(super) const FORESEEN: f64 = 0.025;

/// Whether instruments go on in a tick of this period \[s\].
pub(super) fn foresees(period: f64) -> bool {
    period <= FORESEEN
}

/// The steps of one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TickCourse {
    /// Length of the smallest step \[s\]; their number in a part, and in the tick; how many of them are over.
    unit: f64,
    units_in_part: u32,
    units: u32,
    done: u32,
}

impl TickCourse {
    /// For a tick of `period` \[s\] with this many equal parts.
    pub fn new(period: f64, parts: u32) -> Self {
        let part = period / f64::from(parts);
        let halvings = (part / STEP_SHORTEST).max(1.0).log2().floor() as u32;
        let units_in_part = if foresees(period) { 1 << halvings } else { 1 };
        Self { unit: part / f64::from(units_in_part), units_in_part, units: units_in_part * parts, done: 0 }
    }

    /// Whether steps may be shorter than a part.
    pub fn is_divisible(&self) -> bool {
        self.units_in_part > 1
    }

    /// Whether the tick is over.
    pub fn is_over(&self) -> bool {
        self.done >= self.units
    }

    /// Whether the next step is the first of its part.
    pub fn begins_part(&self) -> bool {
        self.done.is_multiple_of(self.units_in_part)
    }

    /// What is left of the current part \[s\].
    pub fn left(&self) -> f64 {
        f64::from(self.units_in_part - self.done % self.units_in_part) * self.unit
    }

    /// What is over of the tick \[s\].
    pub fn done(&self) -> f64 {
        f64::from(self.done) * self.unit
    }

    /// Begins a step of at most `longest` \[s\], if the shortest is not longer; returns its length \[s\].
    pub fn next(&mut self, longest: f64) -> f64 {
        let within = self.done % self.units_in_part;
        let mut units = self.units_in_part;
        while units > 1
            && (!within.is_multiple_of(units) || f64::from(units) * self.unit > longest * (1.0 + 1e-9))
        {
            units /= 2;
        }
        self.done += units;
        f64::from(units) * self.unit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lengths of the steps of a tick, for what is asked for at the beginning of each \[s\].
    fn steps(period: f64, parts: u32, longest: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut course = TickCourse::new(period, parts);
        let mut steps = Vec::new();
        while !course.is_over() {
            let left = course.left();
            let step = course.next(longest(steps.len()));
            assert!(step <= left);
            steps.push(step);
        }
        assert!((steps.iter().sum::<f64>() - period).abs() < 1e-12 && (course.done() - period).abs() < 1e-12);
        steps
    }

    #[test]
    fn an_undivided_tick_is_one_step_to_the_bit() {
        for period in [1.0 / 3.0, 0.01, 0.003, 0.001, 1e-4] {
            assert_eq!(steps(period, 1, |_| period), [period]);
        }
    }

    #[test]
    fn steps_are_halved_as_asked_for_but_not_below_the_shortest_and_grow_again() {
        let asked = |at: usize| if at < 2 { 0.0 } else { 1.0 };
        assert_eq!(steps(0.016, 1, asked), [0.002, 0.002, 0.004, 0.008]);
        assert_eq!(steps(0.001, 1, |_| 0.0), [0.001]);
        // Nobody knows where a hand will be in a tenth of a second.
        assert_eq!(steps(0.1, 1, |_| 0.0), [0.1]);
    }

    #[test]
    fn no_step_goes_beyond_a_part() {
        let mut course = TickCourse::new(0.024, 3);
        let mut begins = 0;
        while !course.is_over() {
            begins += usize::from(course.begins_part());
            course.next(0.004);
        }
        assert_eq!(begins, 3);
        assert_eq!(steps(0.024, 3, |_| 1.0).len(), 3);
    }
}
