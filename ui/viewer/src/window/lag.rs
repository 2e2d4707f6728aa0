//! Lag of the pictures: on a busy machine, or without a graphics card, a picture may show what was a second ago. Whoever
//! moves an instrument by what they see has to know that, and why.
//!
//! A [`LagWatch`] reads no clock: it is given how long each picture took and when it was shown.

use std::fmt;

/// Pictures that are later than this lag \[s\].
const LATE_SECS: f64 = 0.25;
/// They lag no more once they are less late than this \[s\].
const IN_TIME_SECS: f64 = 0.15;
/// It is told once they have been late for so long \[s\]: one slow picture is no lag.
const AFTER_SECS: f64 = 1.0;
/// Share of a new picture in the smoothed values.
const SMOOTHING: f64 = 0.35;
/// Longer pauses between two pictures are no lag: nothing has changed \[s\].
const PAUSE_SECS: f64 = 10.0;
/// Load per processor from which a machine is busy.
const BUSY: f64 = 1.25;

/// Watches how late pictures are.
#[derive(Clone, Debug, Default)]
pub(super) struct LagWatch {
    /// How late a picture was when it was shown, smoothed \[s\].
    late: f64,
    /// Time between two pictures, smoothed \[s\].
    interval: Option<f64>,
    /// When the last one was shown \[s\].
    shown: Option<f64>,
    /// Since when they have been late \[s\].
    since: Option<f64>,
    lags: bool,
}

/// How far pictures lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lag {
    /// Age of what a picture shows when the next one comes \[s\].
    pub(super) late_secs: f64,
    /// Pictures a second.
    pub(super) per_second: f64,
}

impl LagWatch {
    /// A picture of the scene of `took` seconds ago was shown at `now` \[s\], whose session moves on if `moves`.
    pub(super) fn shown(&mut self, now: f64, took: f64, moves: bool) {
        let passed = self.shown.replace(now).map(|before| now - before);
        if !moves || !took.is_finite() {
            *self = Self { shown: self.shown, ..Self::default() };
            return;
        }
        if let Some(passed) = passed.filter(|passed| (0.0..PAUSE_SECS).contains(passed)) {
            self.interval = Some(self.interval.map_or(passed, |known| known + SMOOTHING * (passed - known)));
        }
        self.late += SMOOTHING * (took - self.late);
        let late = self.late;
        if late > LATE_SECS {
            let since = *self.since.get_or_insert(now);
            self.lags |= now - since >= AFTER_SECS;
        } else if late < IN_TIME_SECS {
            (self.since, self.lags) = (None, false);
        }
    }

    /// How far they lag, if they do.
    pub(super) fn lag(&self) -> Option<Lag> {
        let interval = self.interval?.max(1e-3);
        self.lags.then(|| Lag { late_secs: self.late + interval, per_second: 1.0 / interval })
    }
}

impl fmt::Display for Lag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { late_secs, per_second } = self;
        match per_second {
            rate if *rate < 0.95 => write!(f, "pictures lag: one every {:.1} s", 1.0 / rate)?,
            rate => write!(f, "pictures lag: {rate:.0} a second")?,
        }
        write!(f, ", up to {late_secs:.1} s late")
    }
}

/// Why pictures lag, and what helps, in words.
pub(super) fn reason(software: bool, load: Option<(f64, usize)>, quality_is_fixed: bool) -> String {
    let busy = load
        .filter(|(load, cores)| *load > BUSY * *cores as f64)
        .map(|(load, cores)| format!("the machine is busy (load {load:.1} on {cores} processors)"));
    let drawn = software.then(|| "the processor draws them, for lack of a graphics card".to_owned());
    let mut why: Vec<String> = drawn.into_iter().chain(busy).collect();
    if why.is_empty() {
        why.push("the graphics card has too much to draw".to_owned());
    }
    let quality = if quality_is_fixed {
        "a lower quality draws faster (F7)"
    } else {
        "their quality is at its lowest already; a smaller window draws faster"
    };
    format!("{}; {quality}", why.join(", and "))
}

/// The load of the machine over the last minute, and its processors; `None` where the system does not tell.
pub(super) fn load() -> Option<(f64, usize)> {
    #[cfg(target_os = "linux")]
    {
        // The unit of the system's number is 1/65,536.
        let load = rustix::system::sysinfo().loads[0] as f64 / 65_536.0;
        let cores = std::thread::available_parallelism().ok()?.get();
        Some((load, cores))
    }
    #[cfg(not(target_os = "linux"))]
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pictures that take so long each \[s\], for some time \[s\], with 40 % of rest.
    fn draw(watch: &mut LagWatch, now: &mut f64, took: f64, secs: f64) {
        let until = *now + secs;
        while *now < until {
            *now += took / 0.6;
            watch.shown(*now, took, true);
        }
    }

    #[test]
    fn pictures_that_stay_late_lag_and_one_slow_picture_does_not() {
        let (mut watch, mut now) = (LagWatch::default(), 0.0);
        draw(&mut watch, &mut now, 0.02, 5.0);
        assert_eq!(watch.lag(), None);
        now += 1.5;
        watch.shown(now, 0.9, true);
        draw(&mut watch, &mut now, 0.02, 1.0);
        assert_eq!(watch.lag(), None, "a pipeline was compiled");

        draw(&mut watch, &mut now, 0.6, 12.0);
        let lag = watch.lag().expect("one picture a second lags");
        assert!((lag.per_second - 1.0).abs() < 0.05, "{lag:?}");
        assert!(
            (lag.late_secs - 1.6).abs() < 0.1,
            "0.6 s old when it comes, and there for a second: {lag:?}"
        );
        assert_eq!(lag.to_string(), "pictures lag: 1 a second, up to 1.6 s late");
        draw(&mut watch, &mut now, 0.02, 1.0);
        assert_eq!(watch.lag(), None, "the machine is free again");
    }

    #[test]
    fn a_session_that_stands_still_does_not_lag() {
        let (mut watch, mut now) = (LagWatch::default(), 0.0);
        draw(&mut watch, &mut now, 0.9, 9.0);
        assert!(watch.lag().is_some());
        watch.shown(now + 1.0, 0.9, false);
        assert_eq!(watch.lag(), None);
    }

    #[test]
    fn it_is_said_why_and_what_helps() {
        let slow = Lag { late_secs: 3.24, per_second: 0.4 };
        assert_eq!(slow.to_string(), "pictures lag: one every 2.5 s, up to 3.2 s late");
        let both = reason(true, Some((6.0, 2)), false);
        assert!(
            both.contains("for lack of a graphics card, and the machine is busy (load 6.0 on 2"),
            "{both}"
        );
        assert!(both.ends_with("a smaller window draws faster"), "{both}");
        let fixed = reason(true, Some((1.0, 2)), true);
        assert!(!fixed.contains("busy") && fixed.ends_with("(F7)"), "{fixed}");
        assert!(
            reason(false, None, false).starts_with("the graphics card"),
            "{}",
            reason(false, None, false)
        );
    }
}
