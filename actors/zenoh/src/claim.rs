//! Claim: who commands a hand or a controller's rows from elsewhere, one at a time.
//!
//! Whoever wants to command asks for a claim and gets a number that nobody guesses; commands carry it, with a sequence that
//! rises. A claim ends by silence: a controller's at once (its commands are fenced, and it has to ask again, so that what a
//! path held back for seconds is not applied), and for anybody else to take it after [`LEAVES_AFTER`].

use std::fmt;

use thiserror::Error;
use trocar_scene::SimTime;

/// Silence after which somebody else may claim.
pub const LEAVES_AFTER: SimTime = SimTime::from_millis(2_000);

/// Number of a claim, as text of 16 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct ClaimCode(pub u64);

impl fmt::Display for ClaimCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

/// It is a secret of who commands.
impl fmt::Debug for ClaimCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ClaimCode(…)")
    }
}

impl ClaimCode {
    /// Reads the digits.
    pub fn parse(text: &str) -> Option<Self> {
        let is_hex = text.len() == 16 && text.bytes().all(|digit| digit.is_ascii_hexdigit());
        is_hex.then(|| u64::from_str_radix(text, 16).ok()).flatten().map(Self)
    }
}

/// Why a claim or a command is refused.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ClaimRefusal {
    /// Somebody else commands.
    #[error("somebody else commands it, and was heard {0} ms ago; it is free after {silence} ms of silence", silence = LEAVES_AFTER.0 / 1_000_000)]
    Taken(u64),
    /// It never claimed, or somebody else has since.
    #[error("the claim is not the newest; ask for one")]
    NoClaim,
    /// It was silent for too long.
    #[error("the claim ended by silence; ask for another one")]
    Fenced,
    /// A newer command came before.
    #[error("the sequence has to rise")]
    Older,
}

#[derive(Clone, Copy, Debug)]
struct Holder {
    code: ClaimCode,
    heard: SimTime,
    sequence: Option<u64>,
    is_fenced: bool,
}

/// The claims of one hand or controller.
#[derive(Clone, Debug)]
pub struct Claims {
    holder: Option<Holder>,
    /// Silence that fences; none: silence is somebody else's affair.
    silence: Option<SimTime>,
    epoch: u32,
}

impl Claims {
    /// Nobody's. `silence` is the time without a command after which a claim counts no longer.
    pub fn new(silence: Option<SimTime>) -> Self {
        Self { holder: None, silence, epoch: 0 }
    }

    /// How many claims there were.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// Gives a claim with this number.
    ///
    /// # Errors
    /// [`ClaimRefusal::Taken`].
    pub fn claim(&mut self, now: SimTime, code: ClaimCode) -> Result<u32, ClaimRefusal> {
        self.watch(now);
        if let Some(holder) = &self.holder {
            let age = now.since(holder.heard);
            if !holder.is_fenced && age < LEAVES_AFTER {
                return Err(ClaimRefusal::Taken(age.0 / 1_000_000));
            }
        }
        self.epoch = self.epoch.wrapping_add(1).max(1);
        self.holder = Some(Holder { code, heard: now, sequence: None, is_fenced: false });
        Ok(self.epoch)
    }

    /// Takes a command of a claim.
    ///
    /// # Errors
    /// [`ClaimRefusal`].
    pub fn admit(&mut self, now: SimTime, code: ClaimCode, sequence: u64) -> Result<(), ClaimRefusal> {
        self.watch(now);
        let holder =
            self.holder.as_mut().filter(|holder| holder.code == code).ok_or(ClaimRefusal::NoClaim)?;
        if holder.is_fenced {
            return Err(ClaimRefusal::Fenced);
        }
        if holder.sequence.is_some_and(|newest| sequence <= newest) {
            return Err(ClaimRefusal::Older);
        }
        holder.heard = holder.heard.max(now);
        holder.sequence = Some(sequence);
        Ok(())
    }

    /// Ends a claim by itself.
    pub fn give_back(&mut self, code: ClaimCode) {
        if self.holder.is_some_and(|holder| holder.code == code) {
            self.holder = None;
        }
    }

    /// Fences a claim that was silent for too long; true when it happens.
    pub fn watch(&mut self, now: SimTime) -> bool {
        let (Some(holder), Some(silence)) = (&mut self.holder, self.silence) else { return false };
        let falls_silent = !holder.is_fenced && now.since(holder.heard) >= silence;
        holder.is_fenced |= falls_silent;
        falls_silent
    }

    /// When [`Self::watch`] has something to do.
    pub fn due(&self) -> Option<SimTime> {
        let holder = self.holder.filter(|holder| !holder.is_fenced)?;
        Some(holder.heard + self.silence?)
    }

    /// Whether somebody commands now.
    pub fn is_held(&self) -> bool {
        self.holder.is_some_and(|holder| !holder.is_fenced)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const A: ClaimCode = ClaimCode(0xa);
    const B: ClaimCode = ClaimCode(0xb);

    fn ms(millis: u64) -> SimTime {
        SimTime::from_millis(millis)
    }

    #[test]
    fn one_commands_at_a_time_and_who_is_gone_leaves_room() {
        let mut claims = Claims::new(None);
        assert_eq!(claims.admit(ms(0), A, 1), Err(ClaimRefusal::NoClaim));
        assert_eq!(claims.claim(ms(0), A), Ok(1));
        assert_eq!(claims.admit(ms(500), A, 1), Ok(()));
        assert_eq!(claims.claim(ms(1_000), B), Err(ClaimRefusal::Taken(500)));
        assert_eq!(claims.admit(ms(1_000), B, 9), Err(ClaimRefusal::NoClaim));
        assert_eq!(claims.claim(ms(2_500), B), Ok(2));
        assert_eq!(claims.admit(ms(2_501), A, 2), Err(ClaimRefusal::NoClaim), "the old one is fenced");
        assert_eq!(claims.admit(ms(2_501), B, 1), Ok(()));
        claims.give_back(A);
        assert!(claims.is_held());
        claims.give_back(B);
        assert_eq!(claims.claim(ms(2_502), A), Ok(3));
    }

    #[test]
    fn a_sequence_that_does_not_rise_is_refused() {
        let mut claims = Claims::new(None);
        claims.claim(ms(0), A).expect("free");
        for (sequence, taken) in
            [(5, true), (5, false), (4, false), (u64::MAX, true), (u64::MAX, false), (0, false)]
        {
            assert_eq!(claims.admit(ms(1), A, sequence).is_ok(), taken, "{sequence}");
        }
    }

    #[test]
    fn silence_fences_a_claim_until_another_one_is_asked_for() {
        let mut claims = Claims::new(Some(ms(200)));
        claims.claim(ms(0), A).expect("free");
        assert_eq!(claims.due(), Some(ms(200)));
        assert_eq!(claims.admit(ms(150), A, 1), Ok(()));
        assert!(!claims.watch(ms(349)) && claims.is_held());
        assert!(claims.watch(ms(350)) && !claims.is_held());
        assert!(!claims.watch(ms(351)), "once");
        assert_eq!((claims.due(), claims.admit(ms(352), A, 2)), (None, Err(ClaimRefusal::Fenced)));
        assert_eq!(claims.claim(ms(353), A), Ok(2), "at once");
        assert_eq!(claims.admit(ms(354), A, 1), Ok(()));
    }

    #[test]
    fn a_command_that_comes_after_the_silence_is_refused_also_if_nobody_watched() {
        let mut claims = Claims::new(Some(ms(200)));
        claims.claim(ms(0), A).expect("free");
        assert_eq!(claims.admit(ms(1_000), A, 1), Err(ClaimRefusal::Fenced));
    }

    #[test]
    fn a_claim_is_sixteen_digits() {
        assert_eq!(ClaimCode::parse(&A.to_string()), Some(A));
        for text in ["", "a", "+00000000000000a", "00000000000000000a", "zzzzzzzzzzzzzzzz"] {
            assert_eq!(ClaimCode::parse(text), None, "{text}");
        }
        assert_eq!(format!("{A:?}"), "ClaimCode(…)", "it is a secret");
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

        /// Steps: how long after the one before \[ms\], what, by whom, and a sequence.
        #[test]
        fn only_the_newest_claim_commands_in_order_and_before_its_silence(
            has_silence: bool,
            steps in prop::collection::vec((0..900_u64, 0..4_u8, 0..3_u64, any::<u8>()), 1..60),
        ) {
            let silence = has_silence.then(|| ms(200));
            let mut claims = Claims::new(silence);
            let (mut now, mut holder, mut newest, mut epoch) = (ms(0), None, None, 0);
            let mut heard = now;
            for (pause, what, who, sequence) in steps {
                now += ms(pause);
                let code = ClaimCode(who);
                let is_silent = silence.is_some_and(|silence| now.since(heard) >= silence);
                match what {
                    0 => {
                        let is_free = holder.is_none() || is_silent || now.since(heard) >= LEAVES_AFTER;
                        let claimed = claims.claim(now, code);
                        prop_assert_eq!(claimed.is_ok(), is_free, "{:?}", claimed);
                        if let Ok(given) = claimed {
                            prop_assert!(given > epoch, "each claim has its own number");
                            (holder, newest, heard, epoch) = (Some(code), None, now, given);
                        }
                    }
                    1 => {
                        let sequence = u64::from(sequence);
                        let is_right = holder == Some(code)
                            && !is_silent
                            && newest.is_none_or(|newest| sequence > newest);
                        prop_assert_eq!(claims.admit(now, code, sequence).is_ok(), is_right);
                        if is_right {
                            (newest, heard) = (Some(sequence), now);
                        }
                    }
                    2 => {
                        claims.give_back(code);
                        if holder == Some(code) {
                            holder = None;
                        }
                    }
                    _ => {
                        claims.watch(now);
                    }
                }
            }
        }
    }
}
