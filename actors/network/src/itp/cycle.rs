//! Sequence numbers of ITP: they run from 1 to 2³² − 1 and then begin again at 1, since 0 is not a number but a question.

/// Numbers in a round.
const ROUND: i64 = u32::MAX as i64;

/// The number after this one. What begins, begins after 0.
pub fn next(sequence: u32) -> u32 {
    match sequence.wrapping_add(1) {
        0 => 1,
        next => next,
    }
}

/// How many numbers `sequence` is ahead of `last`, the short way round; negative when it is behind. Both from 1.
pub fn ahead(sequence: u32, last: u32) -> i64 {
    let ahead = (i64::from(sequence) - i64::from(last)).rem_euclid(ROUND);
    if ahead > ROUND / 2 { ahead - ROUND } else { ahead }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_round_closes_and_leaves_out_zero() {
        assert_eq!([next(0), next(1), next(u32::MAX - 1), next(u32::MAX)], [1, 2, u32::MAX, 1]);
        assert_eq!([ahead(1, u32::MAX), ahead(u32::MAX, 1), ahead(3, u32::MAX - 1)], [1, -1, 4]);
        assert_eq!([ahead(7, 7), ahead(u32::MAX, u32::MAX), ahead(1, 5_001)], [0, 0, -5_000]);
    }

    proptest! {
        #[test]
        fn as_many_steps_as_were_gone_are_counted(
            start in prop_oneof![1..=u32::MAX, u32::MAX - 600..=u32::MAX],
            steps in 0..500_u32,
        ) {
            let end = (0..steps).fold(start, |sequence, _| next(sequence));
            prop_assert_eq!(ahead(end, start), i64::from(steps));
            prop_assert_eq!(ahead(start, end), -i64::from(steps));
        }
    }
}
