//! Payload of kind hands: an echo of the other side's clock, and every hand of a station.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use thiserror::Error;
use trocar_devices::{DeviceState, Pedals, Wrench};
use trocar_scene::{Entity, SimTime};

use super::PAYLOAD_MAX;
use super::little_endian::{Reader, Writer};
use crate::hand_sample::{CLUTCHES, HandSample};

/// Bytes of the clock echo.
const ECHO_BYTES: usize = 12;
/// Bytes of a hand.
pub const HAND_BYTES: usize = 100;
/// Most hands in a datagram.
pub const HANDS_MAX: usize = (PAYLOAD_MAX - ECHO_BYTES) / HAND_BYTES;
/// Most hands in a datagram that also carries both ends of each one's coupling, as long as a hand.
pub const COUPLED_HANDS_MAX: usize = (PAYLOAD_MAX - ECHO_BYTES) / (2 * HAND_BYTES);
/// How far a received rotation may be off unit length. Rounding to single precision is 10⁴ times less.
pub const ROTATION_TOLERANCE: f64 = 1e-3;

/// Bytes of a payload with so many hands.
pub const fn hands_bytes(hands: usize) -> usize {
    ECHO_BYTES + HAND_BYTES * hands
}

const CONNECTED: u8 = 1 << 0;
const GRABBED: u8 = 1 << 1;
/// Where the count of clutches lies in the flags.
const CLUTCH_SHIFT: u32 = 2;
const CLUTCH: u8 = (CLUTCHES - 1) << CLUTCH_SHIFT;
/// Where the pedals lie in the flags.
const PEDALS_SHIFT: u32 = 6;
/// In place of the time held when there is nothing to echo.
const NO_ECHO: u32 = u32::MAX;

/// What the other side needs to know its round trip: when it sent the newest datagram that has arrived here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockEcho {
    /// When that datagram was sent, by the clock of the side that sent it.
    pub sent_at: SimTime,
    /// How long ago it had arrived when this one was sent; whole microseconds travel.
    pub held: SimTime,
}

/// Why hands cannot be encoded, or a payload is not accepted.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum HandsError {
    /// The length does not fit the header's count.
    #[error(
        "a payload of {bytes} bytes does not hold {hands} hands, which take {ECHO_BYTES} + {HAND_BYTES} × {hands}"
    )]
    Length {
        /// Bytes of the payload.
        bytes: usize,
        /// Hands by the header.
        hands: u8,
    },
    /// There are more than fit.
    #[error("{0} hands are too many for a datagram; {HANDS_MAX} fit")]
    TooMany(usize),
    /// A time was echoed without the other field.
    #[error("the echo of the clock says that there is none, but has a time of {0} ns; it must be 0")]
    Echo(u64),
    /// A hand comes twice.
    #[error("hand {0} comes twice in one datagram")]
    Repeated(u8),
    /// It holds something without saying so.
    #[error("hand {0} names a grabbed entity or node, but its flag for grabbed is not set; both must be 0")]
    Grabbed(u8),
    /// A number is NaN or infinite.
    #[error("hand {0} has a number that is NaN or infinite")]
    NotFinite(u8),
    /// A rotation is no rotation.
    #[error("hand {hand} has a rotation of length {length}; it must be 1 within {ROTATION_TOLERANCE}")]
    Rotation {
        /// Number of the hand.
        hand: u8,
        /// Length of its quaternion.
        length: f64,
    },
}

/// Which hands have been met.
#[derive(Default)]
struct Met([u64; 4]);

impl Met {
    fn first_time(&mut self, hand: u8) -> Result<(), HandsError> {
        let (word, bit) = (&mut self.0[usize::from(hand / 64)], 1 << (hand % 64));
        if *word & bit != 0 {
            return Err(HandsError::Repeated(hand));
        }
        *word |= bit;
        Ok(())
    }
}

/// Writes a payload of kind hands, and returns its length.
///
/// Numbers are rounded to single precision, and those beyond its range become its greatest. Of the buttons, 0 to 15
/// and the pedals travel. An echo held for longer than the field can say (71 minutes) is left out.
///
/// # Errors
/// When there are more than [`HANDS_MAX`] samples, a hand comes twice, or a sample is not valid. Nothing that the payload
/// then contains may be sent.
pub fn encode_hands(
    echo: Option<ClockEcho>,
    samples: &[HandSample],
    payload: &mut [u8; PAYLOAD_MAX],
) -> Result<usize, HandsError> {
    if samples.len() > HANDS_MAX {
        return Err(HandsError::TooMany(samples.len()));
    }
    let mut fields = Writer(payload);
    let (sent_at, held_us) = echo.and_then(echo_fields).unwrap_or((0, NO_ECHO));
    fields.u64(sent_at).u32(held_us);
    let mut met = Met::default();
    for sample in samples {
        met.first_time(sample.hand)?;
        encode_hand(sample, &mut fields)?;
    }
    Ok(hands_bytes(samples.len()))
}

fn echo_fields(echo: ClockEcho) -> Option<(u64, u32)> {
    let held_us =
        (echo.held.as_nanos() / 1_000).saturating_add(u64::from(echo.held.as_nanos() % 1_000 >= 500));
    let held_us = u32::try_from(held_us).ok()?;
    (held_us != NO_ECHO).then_some((echo.sent_at.as_nanos(), held_us))
}

fn encode_hand(sample: &HandSample, fields: &mut Writer<'_>) -> Result<(), HandsError> {
    let HandSample { hand, state, wrench, grabbed, age_us, clutch } = sample;
    let Isometry3 { rotation, translation } = &state.pose_in_device;
    if !sample.is_valid() {
        let length = rotation.coords.norm();
        let bent = length.is_finite() && (length - 1.0).abs() > 1e-6;
        let hand = *hand;
        return Err(if bent { HandsError::Rotation { hand, length } } else { HandsError::NotFinite(hand) });
    }
    let flag = |is_set: bool, bit: u8| if is_set { bit } else { 0 };
    let (entity, node) = grabbed.map_or((0, 0), |(entity, node)| (entity.to_bits(), node));
    fields
        .u8(*hand)
        .u8(flag(state.connected, CONNECTED)
            | flag(grabbed.is_some(), GRABBED)
            | (clutch % CLUTCHES) << CLUTCH_SHIFT
            | pedal_bits(Pedals::of(state.buttons)) << PEDALS_SHIFT)
        .u16(state.buttons as u16)
        .u32(*age_us)
        .f32s(translation.vector.as_slice())
        .f32s(rotation.coords.as_slice())
        .f32s(state.linear_velocity.as_slice())
        .f32s(state.angular_velocity.as_slice())
        .f32s(wrench.force.as_slice())
        .f32s(wrench.torque.as_slice())
        .f32s(&[state.gripper])
        .u64(entity)
        .u32(node);
    Ok(())
}

/// What the two bits of the pedals say.
const PEDALS: [Pedals; 4] = [Pedals::None, Pedals::Released, Pedals::Energy, Pedals::Coagulate];

fn pedal_bits(pedals: Pedals) -> u8 {
    match pedals {
        Pedals::None => 0,
        Pedals::Released => 1,
        Pedals::Energy => 2,
        Pedals::Coagulate => 3,
    }
}

/// Hands that have been received, in a place that is used again and again.
#[derive(Clone, Debug)]
pub struct Hands {
    echo: Option<ClockEcho>,
    samples: [HandSample; HANDS_MAX],
    count: usize,
}

impl Default for Hands {
    fn default() -> Self {
        Self { echo: None, samples: [HandSample::unknown(0); HANDS_MAX], count: 0 }
    }
}

impl Hands {
    /// When our newest datagram that has arrived at the other side was sent; `None` before one has.
    pub fn echo(&self) -> Option<ClockEcho> {
        self.echo
    }

    /// The hands, each at most once, all valid.
    pub fn samples(&self) -> &[HandSample] {
        &self.samples[..self.count]
    }

    /// Reads the payload of an authenticated datagram that announces `hands` hands. All of it is accepted, or none: after
    /// an error there are no samples and no echo.
    ///
    /// # Errors
    /// When its length is not that of so many hands, a hand comes twice, a number is NaN or infinite, a rotation is off
    /// unit length by more than [`ROTATION_TOLERANCE`], or what must be zero is not.
    pub fn decode(&mut self, hands: u8, payload: &[u8]) -> Result<(), HandsError> {
        (self.echo, self.count) = (None, 0);
        let count = usize::from(hands);
        if count > HANDS_MAX {
            return Err(HandsError::TooMany(count));
        }
        let wrong_length = HandsError::Length { bytes: payload.len(), hands };
        if payload.len() != hands_bytes(count) {
            return Err(wrong_length);
        }
        let mut fields = Reader(payload);
        let echo = decode_echo(&mut fields).ok_or(wrong_length)??;
        let mut met = Met::default();
        for place in &mut self.samples[..count] {
            *place = decode_hand(&mut fields).ok_or(wrong_length)??;
            met.first_time(place.hand)?;
        }
        (self.echo, self.count) = (echo, count);
        Ok(())
    }
}

/// `None` when the bytes do not suffice.
type Decoded<T> = Option<Result<T, HandsError>>;

fn decode_echo(fields: &mut Reader<'_>) -> Decoded<Option<ClockEcho>> {
    let (sent_at, held_us) = (fields.u64()?, fields.u32()?);
    Some(match (sent_at, held_us) {
        (0, NO_ECHO) => Ok(None),
        (_, NO_ECHO) => Err(HandsError::Echo(sent_at)),
        _ => {
            Ok(Some(ClockEcho { sent_at: SimTime(sent_at), held: SimTime::from_micros(u64::from(held_us)) }))
        }
    })
}

fn decode_hand(fields: &mut Reader<'_>) -> Decoded<HandSample> {
    let (hand, flags, buttons, age_us) = (fields.u8()?, fields.u8()?, fields.u16()?, fields.u32()?);
    let position: [f64; 3] = fields.f32s()?;
    let rotation: [f64; 4] = fields.f32s()?;
    let motion: [[f64; 3]; 2] = [fields.f32s()?, fields.f32s()?];
    let wrench: [[f64; 3]; 2] = [fields.f32s()?, fields.f32s()?];
    let [gripper] = fields.f32s()?;
    let (entity, node) = (fields.u64()?, fields.u32()?);
    if flags & GRABBED == 0 && (entity, node) != (0, 0) {
        return Some(Err(HandsError::Grabbed(hand)));
    }
    let numbers = position.iter().chain(&rotation).chain(motion.as_flattened()).chain(wrench.as_flattened());
    if !numbers.chain([&gripper]).all(|number| number.is_finite()) {
        return Some(Err(HandsError::NotFinite(hand)));
    }
    let rotation = Quaternion::from(rotation);
    // Squares of the greatest numbers of single precision are finite in double precision.
    let length = rotation.norm();
    if (length - 1.0).abs() > ROTATION_TOLERANCE {
        return Some(Err(HandsError::Rotation { hand, length }));
    }
    let pose_in_device =
        Isometry3::from_parts(Translation3::from(position), UnitQuaternion::new_unchecked(rotation / length));
    let [linear_velocity, angular_velocity] = motion.map(Vector3::from);
    let [force, torque] = wrench.map(Vector3::from);
    Some(Ok(HandSample {
        hand,
        state: DeviceState {
            pose_in_device,
            linear_velocity,
            angular_velocity,
            gripper,
            buttons: u32::from(buttons) | PEDALS[usize::from(flags >> PEDALS_SHIFT)].buttons(),
            connected: flags & CONNECTED != 0,
        },
        wrench: Wrench { force, torque },
        grabbed: (flags & GRABBED != 0).then_some((Entity::from_bits(entity), node)),
        age_us,
        clutch: (flags & CLUTCH) >> CLUTCH_SHIFT,
    }))
}

#[cfg(test)]
#[path = "hands_tests.rs"]
mod tests;
