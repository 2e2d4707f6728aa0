//! Times of the wall clock, which only expiries need: how they are shown, and how wrong a clock may be.

/// How much later than its expiry a ticket or a resume secret is still taken \[s\], and how far two clocks may differ
/// without a word about it. Clocks that a network sets differ by less than a second, those set by hand by a minute.
pub const CLOCK_TOLERANCE_SECS: u64 = 120;

/// Last time that can be shown: the end of the year 9999.
const SHOWN_MAX_SECS: u64 = 253_402_300_799;
const DAY_SECS: u64 = 86_400;

/// A time in seconds since 1970 as a date: `2026-11-29 07:40:52 UTC`.
pub fn utc(unix_secs: u64) -> String {
    if unix_secs > SHOWN_MAX_SECS {
        return "after the year 9999".to_owned();
    }
    let (year, month, day) = civil(unix_secs / DAY_SECS);
    let (hour, minute, second) = (unix_secs % DAY_SECS / 3_600, unix_secs / 60 % 60, unix_secs % 60);
    format!("{year:04}-{month:02}-{day:02} {hour:02}:{minute:02}:{second:02} UTC")
}

/// Year, month and day of a number of days since 1970. Years are counted from March, so that the leap day is the last
/// one of its year (Hinnant, "chrono-compatible low-level date algorithms", 2013).
fn civil(days: u64) -> (u64, u64, u64) {
    // Days since 0000-03-01, and within the era of 400 years, whose days are always as many.
    let days = days + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (of_era - of_era / 1_460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = if from_march < 10 { from_march + 3 } else { from_march - 9 };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day)
}

/// A span in its two largest units: `59 s`, `1 h 0 min`, `2 d 5 h`.
pub(super) fn span(secs: u64) -> String {
    match secs {
        0..60 => format!("{secs} s"),
        60..3_600 => format!("{} min {} s", secs / 60, secs % 60),
        3_600..DAY_SECS => format!("{} h {} min", secs / 3_600, secs / 60 % 60),
        _ => format!("{} d {} h", secs / DAY_SECS, secs / 3_600 % 24),
    }
}

/// In words how a station's clock differs from its host's; `None` within [`CLOCK_TOLERANCE_SECS`]. Nothing but expiries
/// depends on these clocks.
pub fn clock_difference(host_unix_secs: u64, station_unix_secs: u64) -> Option<String> {
    let differs = host_unix_secs.abs_diff(station_unix_secs);
    let way = if station_unix_secs > host_unix_secs { "ahead of" } else { "behind" };
    (differs > CLOCK_TOLERANCE_SECS).then(|| {
        format!(
            "the clock of this station is {} {way} the host's ({} here, {} there); set the one that is wrong, or tickets \
             expire at another time than they say",
            span(differs),
            utc(station_unix_secs),
            utc(host_unix_secs)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        for (secs, date) in [
            (0, "1970-01-01 00:00:00 UTC"),
            (951_827_696, "2000-02-29 12:34:56 UTC"),
            (1_709_164_800, "2024-02-29 00:00:00 UTC"),
            (1_709_251_200, "2024-03-01 00:00:00 UTC"),
            (1_795_938_052, "2026-11-29 07:40:52 UTC"),
            (4_107_542_399, "2100-02-28 23:59:59 UTC"),
            (4_107_542_400, "2100-03-01 00:00:00 UTC"),
            (SHOWN_MAX_SECS, "9999-12-31 23:59:59 UTC"),
            (u64::MAX, "after the year 9999"),
        ] {
            assert_eq!(utc(secs), date);
        }
    }

    #[test]
    fn a_clock_that_is_wrong_by_an_hour_is_told_with_its_direction() {
        let host = 1_795_938_052;
        assert_eq!(clock_difference(host, host + CLOCK_TOLERANCE_SECS), None);
        let ahead = clock_difference(host, host + 3_600).expect("it differs");
        assert!(ahead.contains("1 h 0 min ahead of the host's"), "{ahead}");
        let behind = clock_difference(host, host - 3_661).expect("it differs");
        assert!(behind.contains("1 h 1 min behind the host's"), "{behind}");
        assert!(behind.contains("06:39:51 UTC here, 2026-11-29 07:40:52 UTC there"), "{behind}");
        assert!(clock_difference(0, u64::MAX).is_some(), "no time makes it fail");
    }
}
