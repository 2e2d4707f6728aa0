//! Pedal and jaws of a hand that changes its owner: neither may act by itself when somebody new holds it.

/// Buttons of a hand that was taken, given back or silent: each must be seen released before a press of it counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PedalGate {
    armed: u32,
}

impl PedalGate {
    /// Closes the gate for every button.
    pub fn close(&mut self) {
        self.armed = 0;
    }

    /// The buttons that count as pressed, of those that are.
    pub fn pass(&mut self, pressed: u32) -> u32 {
        self.armed |= !pressed;
        pressed & self.armed
    }
}

/// Jaws that follow the fingers at a bounded speed, and that hold what they hold until the fingers have closed to them.
///
/// When the hand changes its owner, the new fingers are rarely as far open as the jaws. Jaws that opened to them would
/// drop what they hold; so, as at the masters of surgical robots, the fingers first close to the jaws' own angle, and
/// from then on the jaws follow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripMatch {
    angle: f64,
    matched: bool,
}

impl GripMatch {
    /// Jaws at this angle \[rad\] that follow the fingers.
    pub fn following(angle: f64) -> Self {
        Self { angle, matched: true }
    }

    /// The angle of the jaws \[rad\].
    pub fn angle(&self) -> f64 {
        self.angle
    }

    /// Whether the jaws follow the fingers.
    pub fn is_matched(&self) -> bool {
        self.matched
    }

    /// Lets the jaws wait for the fingers.
    pub fn unmatch(&mut self) {
        self.matched = false;
    }

    /// One step towards the fingers' angle \[rad\], by at most `change_max` \[rad\]; fingers within `tolerance` \[rad\]
    /// above the jaws, or below them, have closed to them. True when the bound acted.
    pub fn step(&mut self, fingers: f64, change_max: f64, tolerance: f64) -> bool {
        self.matched |= fingers <= self.angle + tolerance;
        if !self.matched {
            return false;
        }
        let change = fingers - self.angle;
        if change.abs() <= change_max {
            self.angle = fingers;
            return false;
        }
        self.angle += change_max.copysign(change);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_button_counts_only_after_it_was_released() {
        let mut gate = PedalGate::default();
        assert_eq!(gate.pass(0b11), 0);
        assert_eq!(gate.pass(0b10), 0, "button 0 was released, button 1 is still down");
        assert_eq!(gate.pass(0b11), 0b01);
        gate.close();
        assert_eq!(gate.pass(0b01), 0);
    }

    #[test]
    fn jaws_hold_until_the_fingers_have_closed_to_them() {
        let mut jaws = GripMatch::following(0.3);
        jaws.unmatch();
        for _ in 0..1_000 {
            jaws.step(1.0, 0.01, 0.05);
        }
        assert_eq!((jaws.angle(), jaws.is_matched()), (0.3, false));
        assert!(!jaws.step(0.34, 0.05, 0.05));
        assert_eq!((jaws.angle(), jaws.is_matched()), (0.34, true));
        assert!(jaws.step(1.0, 0.01, 0.05));
        assert!((jaws.angle() - 0.35).abs() < 1e-15);
    }

    #[test]
    fn fingers_below_the_jaws_close_them_at_once_and_slowly() {
        let mut jaws = GripMatch::following(0.8);
        jaws.unmatch();
        assert!(jaws.step(0.0, 0.01, 0.05));
        assert!((jaws.angle() - 0.79).abs() < 1e-15);
    }
}
