//! Pedals: foot switches that switch on the energy of a hand's instrument.
//!
//! They are bits of [`DeviceState::buttons`](crate::DeviceState::buttons) above those of the handle, so that they pass every
//! link, door and recording as buttons do. A device that has pedals says so: they alone then switch its instrument.

/// Set while the device has pedals.
pub const HAS_PEDALS: u32 = 1 << 16;
/// Set while the pedal for the instrument's own current is pressed.
pub const PEDAL_ENERGY: u32 = 1 << 17;
/// Set while the pedal for coagulation is pressed; it goes before the other.
pub const PEDAL_COAGULATE: u32 = 1 << 18;

/// What the pedals of a hand say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pedals {
    /// There are none.
    #[default]
    None,
    /// None is pressed.
    Released,
    /// The instrument's own current is on.
    Energy,
    /// The instrument coagulates.
    Coagulate,
}

impl Pedals {
    /// All bits that pedals use.
    pub const MASK: u32 = HAS_PEDALS | PEDAL_ENERGY | PEDAL_COAGULATE;

    /// The pedals among the buttons of a device.
    pub fn of(buttons: u32) -> Self {
        match buttons & Self::MASK {
            bits if bits & HAS_PEDALS == 0 => Self::None,
            bits if bits & PEDAL_COAGULATE != 0 => Self::Coagulate,
            bits if bits & PEDAL_ENERGY != 0 => Self::Energy,
            _ => Self::Released,
        }
    }

    /// The same as bits of the buttons.
    pub fn buttons(self) -> u32 {
        match self {
            Self::None => 0,
            Self::Released => HAS_PEDALS,
            Self::Energy => HAS_PEDALS | PEDAL_ENERGY,
            Self::Coagulate => HAS_PEDALS | PEDAL_COAGULATE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pedals_are_bits_that_no_handle_has_and_without_pedals_none_is_pressed() {
        for pedals in [Pedals::None, Pedals::Released, Pedals::Energy, Pedals::Coagulate] {
            assert_eq!(Pedals::of(pedals.buttons()), pedals);
            assert_eq!(Pedals::of(pedals.buttons() | 0xffff), pedals);
            assert_eq!(pedals.buttons() & 0xffff, 0);
        }
        assert_eq!(Pedals::of(PEDAL_ENERGY | PEDAL_COAGULATE), Pedals::None);
        assert_eq!(Pedals::of(Pedals::MASK), Pedals::Coagulate);
    }
}
