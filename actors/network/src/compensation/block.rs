//! What both ends of a coupling tell each other beside position and force, and its layout in a datagram.
//!
//! A block of 44 bytes a hand, little-endian, after the hand's 100 bytes:
//!
//! | offset | bytes | content |
//! |---:|---:|---|
//! | 0 | 1 | method that is rendered: 0 passivity, 1 wave variables, 2 model-mediated |
//! | 1 | 1 | payload: 0 none, 1 wave, 2 contact |
//! | 2 | 2 | zero |
//! | 4 | 8 | energy given to the other end in all, u64 \[nJ\] |
//! | 12 | 8 | balance of the tank, i64 \[nJ\] |
//! | 20 | 24 | none: zero |
//! | 20 | 12 | wave: its integral, 3 × i32 \[2⁻²⁴ √W·s\], wrapping |
//! | 32 | 8 | wave: its energy, u64 \[nJ\] |
//! | 40 | 4 | wave: zero |
//! | 20 | 12 | contact: unit normal, 3 × f32 |
//! | 32 | 4 | contact: distance of the plane from the origin along the normal, f32 \[m\] |
//! | 36 | 4 | contact: stiffness, f32 [N/m] |
//! | 40 | 4 | contact: damping, f32 [N·s/m] |

use nalgebra::Vector3;
use thiserror::Error;

use super::Method;
use super::energy_tank::EnergyAccount;
use super::model_mediated::{ContactModel, DAMPING_MAX, OFFSET_MAX, STIFFNESS_LIMITS};
use super::wave_variables::WaveIntegrals;

/// Bytes of a block.
pub const BLOCK_BYTES: usize = 44;

/// Why a block was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum BlockError {
    /// No method has this number.
    #[error(
        "byte 0 of the compensation block is {0}, valid are 0 passivity, 1 wave variables, 2 model-mediated"
    )]
    Method(u8),
    /// No payload has this number.
    #[error("byte 1 of the compensation block is {0}, valid are 0 none, 1 wave, 2 contact")]
    Payload(u8),
    /// A byte that must be zero is not.
    #[error("byte {0} of the compensation block must be zero")]
    NotZero(usize),
    /// The contact has a number out of its limits.
    #[error(
        "the contact of the compensation block is out of its limits: unit normal, distance to {OFFSET_MAX} m, \
         stiffness {} to {} N/m, damping 0 to {DAMPING_MAX} N·s/m",
        STIFFNESS_LIMITS.0, STIFFNESS_LIMITS.1
    )]
    Contact,
}

/// What a method adds to the block.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Payload {
    /// Nothing.
    #[default]
    None,
    /// Integrals of the wave that leaves this end.
    Wave(WaveIntegrals),
    /// Contact at the slave.
    Contact(ContactModel),
}

/// What an end tells of its compensation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CompensationBlock {
    /// Method that this end uses: the master's choice, which the slave follows.
    pub method: Method,
    /// Energy of this end's tank.
    pub account: EnergyAccount,
    /// What the method adds.
    pub payload: Payload,
}

impl CompensationBlock {
    /// Writes the block.
    pub fn encode(&self) -> [u8; BLOCK_BYTES] {
        let mut bytes = [0; BLOCK_BYTES];
        let mut write = |at: usize, part: &[u8]| bytes[at..at + part.len()].copy_from_slice(part);
        write(0, &[self.method.number()]);
        write(4, &self.account.given_nj.to_le_bytes());
        write(12, &self.account.balance_nj.to_le_bytes());
        match &self.payload {
            Payload::None => {}
            Payload::Wave(integrals) => {
                write(1, &[1]);
                for (axis, integral) in integrals.wave.iter().enumerate() {
                    write(20 + 4 * axis, &integral.to_le_bytes());
                }
                write(32, &integrals.energy_nj.to_le_bytes());
            }
            Payload::Contact(ContactModel { normal, offset, stiffness, damping }) => {
                write(1, &[2]);
                let numbers = [normal.x, normal.y, normal.z, *offset, *stiffness, *damping];
                for (place, number) in numbers.iter().enumerate() {
                    write(20 + 4 * place, &(*number as f32).to_le_bytes());
                }
            }
        }
        bytes
    }

    /// Reads a block.
    ///
    /// # Errors
    /// When a number is none of those that [`Self::encode`] writes.
    pub fn decode(bytes: &[u8; BLOCK_BYTES]) -> Result<Self, BlockError> {
        let method = Method::from_number(bytes[0]).ok_or(BlockError::Method(bytes[0]))?;
        let account = EnergyAccount {
            given_nj: u64::from_le_bytes(part(bytes, 4)),
            balance_nj: i64::from_le_bytes(part(bytes, 12)),
        };
        zero(bytes, 2, 4)?;
        let payload = match bytes[1] {
            0 => {
                zero(bytes, 20, BLOCK_BYTES)?;
                Payload::None
            }
            1 => {
                zero(bytes, 40, BLOCK_BYTES)?;
                Payload::Wave(WaveIntegrals {
                    wave: [20, 24, 28].map(|at| i32::from_le_bytes(part(bytes, at))),
                    energy_nj: u64::from_le_bytes(part(bytes, 32)),
                })
            }
            2 => {
                let [x, y, z, offset, stiffness, damping] =
                    [20, 24, 28, 32, 36, 40].map(|at| f64::from(f32::from_le_bytes(part(bytes, at))));
                let contact = ContactModel { normal: Vector3::new(x, y, z), offset, stiffness, damping };
                if !contact.is_valid() {
                    return Err(BlockError::Contact);
                }
                Payload::Contact(contact)
            }
            other => return Err(BlockError::Payload(other)),
        };
        Ok(Self { method, account, payload })
    }
}

fn part<const N: usize>(bytes: &[u8; BLOCK_BYTES], at: usize) -> [u8; N] {
    let mut part = [0; N];
    part.copy_from_slice(&bytes[at..at + N]);
    part
}

fn zero(bytes: &[u8; BLOCK_BYTES], from: usize, to: usize) -> Result<(), BlockError> {
    match (from..to).find(|at| bytes[*at] != 0) {
        Some(at) => Err(BlockError::NotZero(at)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_payload() -> impl Strategy<Value = Payload> {
        prop_oneof![
            Just(Payload::None),
            (any::<[i32; 3]>(), any::<u64>())
                .prop_map(|(wave, energy_nj)| Payload::Wave(WaveIntegrals { wave, energy_nj })),
            (-1.0..1.0_f32, -1.0..1.0_f32, -9.0..9.0_f32, 5.0..5e3_f32, 0.0..20.0_f32).prop_map(
                |(x, y, offset, stiffness, damping)| {
                    let normal = Vector3::new(f64::from(x), f64::from(y), 0.5).normalize();
                    Payload::Contact(ContactModel {
                        // As it comes out of a datagram.
                        normal: normal.map(|part| f64::from(part as f32)),
                        offset: f64::from(offset),
                        stiffness: f64::from(stiffness),
                        damping: f64::from(damping),
                    })
                }
            ),
        ]
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(
            number in 0..3_u8, given_nj: u64, balance_nj: i64, payload in any_payload()
        ) {
            let method = Method::from_number(number).unwrap();
            let account = EnergyAccount { given_nj, balance_nj };
            let block = CompensationBlock { method, account, payload };
            prop_assert_eq!(CompensationBlock::decode(&block.encode()), Ok(block));
        }

        #[test]
        fn any_bytes_are_refused_or_are_what_would_be_written(
            mut bytes in prop::array::uniform32(any::<u8>()), tail in prop::array::uniform12(any::<u8>()),
            kind in 0..4_u8
        ) {
            (bytes[0], bytes[1], bytes[2], bytes[3]) = (bytes[0] % 4, kind, 0, 0);
            let mut block = [0; BLOCK_BYTES];
            block[..32].copy_from_slice(&bytes);
            block[32..].copy_from_slice(&tail);
            if let Ok(read) = CompensationBlock::decode(&block) {
                prop_assert_eq!(read.encode(), block);
            }
        }
    }

    #[test]
    fn the_layout_is_the_one_that_is_told() {
        let account = EnergyAccount { given_nj: 0x0102_0304, balance_nj: -2 };
        let integrals = WaveIntegrals { wave: [1, -1, 0], energy_nj: 7 };
        let payload = Payload::Wave(integrals);
        let bytes = CompensationBlock { method: Method::WaveVariables, account, payload }.encode();
        assert_eq!(bytes[..8], [1, 1, 0, 0, 4, 3, 2, 1]);
        assert_eq!(bytes[12..24], [254, 255, 255, 255, 255, 255, 255, 255, 1, 0, 0, 0]);
        assert_eq!(bytes[24..34], [255, 255, 255, 255, 0, 0, 0, 0, 7, 0]);
    }

    #[test]
    fn each_fault_is_named() {
        let account = EnergyAccount::default();
        let good = CompensationBlock { method: Method::Passivity, account, payload: Payload::None }.encode();
        let with = |changes: &[(usize, u8)]| {
            let mut bytes = good;
            changes.iter().for_each(|(at, byte)| bytes[*at] = *byte);
            CompensationBlock::decode(&bytes)
        };
        assert_eq!(with(&[(0, 3)]), Err(BlockError::Method(3)));
        assert_eq!(with(&[(1, 9)]), Err(BlockError::Payload(9)));
        assert_eq!(with(&[(3, 1)]), Err(BlockError::NotZero(3)));
        assert_eq!(with(&[(43, 1)]), Err(BlockError::NotZero(43)));
        assert_eq!(with(&[(1, 1), (41, 1)]), Err(BlockError::NotZero(41)));
        // A contact of zeros has no normal.
        assert_eq!(with(&[(1, 2)]), Err(BlockError::Contact));
        assert!(BlockError::Contact.to_string().contains("5000 N/m"), "{}", BlockError::Contact);
    }
}
