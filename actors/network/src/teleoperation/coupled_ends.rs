//! What a packet of hands with force feedback carries beside their samples, and its layout.
//!
//! A packet of kind coupled hands is one of kind hands, with 100 bytes more for each hand, in the order of the hands,
//! little-endian. Both ends are one machine, so one packet has both:
//!
//! | offset | bytes | content |
//! |---:|---:|---|
//! | 0 | 44 | compensation block of the master's end ([`CompensationBlock`]) |
//! | 44 | 12 | force of the coupling at the slave, as a hand there would feel it, along the device's axes, 3 × f32 \[N\] |
//! | 56 | 44 | compensation block of the slave's end |

use nalgebra::Vector3;

use crate::compensation::{BLOCK_BYTES, BlockError, CompensationBlock};

/// Bytes of both ends.
pub const COUPLED_BYTES: usize = BLOCK_BYTES + FORCE_BYTES + BLOCK_BYTES;
const FORCE_BYTES: usize = 12;

/// Why the ends of a hand's coupling were refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CoupledError {
    /// A block is no block.
    #[error(transparent)]
    Block(#[from] BlockError),
    /// The force is no force.
    #[error("the force at the slave is NaN or infinite")]
    NotFinite,
    /// The length is not that of the hands.
    #[error("{bytes} bytes do not hold the couplings of {hands} hands, which take {COUPLED_BYTES} each")]
    Length {
        /// Bytes after the hands.
        bytes: usize,
        /// Hands by the header.
        hands: u8,
    },
}

/// Both ends of a coupling at an instant: each tells the other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CoupledEnds {
    /// The master's energy, and its wave.
    pub master: CompensationBlock,
    /// Force at the slave, along the device's axes \[N\].
    pub slave_force: Vector3<f64>,
    /// The slave's energy, and its wave or its contact.
    pub slave: CompensationBlock,
}

impl CoupledEnds {
    /// Writes both.
    pub fn encode(&self) -> [u8; COUPLED_BYTES] {
        let mut bytes = [0; COUPLED_BYTES];
        let (master, rest) = bytes.split_at_mut(BLOCK_BYTES);
        let (force, slave) = rest.split_at_mut(FORCE_BYTES);
        master.copy_from_slice(&self.master.encode());
        for (place, part) in force.chunks_exact_mut(4).zip(&self.slave_force) {
            place.copy_from_slice(&(*part as f32).to_le_bytes());
        }
        slave.copy_from_slice(&self.slave.encode());
        bytes
    }

    /// Reads both.
    ///
    /// # Errors
    /// [`CoupledError`] when a number is none of those that [`Self::encode`] writes.
    pub fn decode(bytes: &[u8; COUPLED_BYTES]) -> Result<Self, CoupledError> {
        let (mut master, mut force, mut slave) = ([0; BLOCK_BYTES], Vector3::zeros(), [0; BLOCK_BYTES]);
        master.copy_from_slice(&bytes[..BLOCK_BYTES]);
        slave.copy_from_slice(&bytes[BLOCK_BYTES + FORCE_BYTES..]);
        for (part, number) in force.iter_mut().zip(bytes[BLOCK_BYTES..].chunks_exact(4)) {
            *part = f64::from(f32::from_le_bytes([number[0], number[1], number[2], number[3]]));
        }
        if !force.iter().all(|part| part.is_finite()) {
            return Err(CoupledError::NotFinite);
        }
        Ok(Self {
            master: CompensationBlock::decode(&master)?,
            slave_force: force,
            slave: CompensationBlock::decode(&slave)?,
        })
    }

    /// Reads those of all hands, from what follows them, into a place that is used again and again.
    ///
    /// # Errors
    /// [`CoupledError`]; there are none then.
    pub fn decode_all(hands: u8, bytes: &[u8], ends: &mut Vec<Self>) -> Result<(), CoupledError> {
        ends.clear();
        let (each, rest) = bytes.as_chunks();
        if each.len() != usize::from(hands) || !rest.is_empty() {
            return Err(CoupledError::Length { bytes: bytes.len(), hands });
        }
        for bytes in each {
            match Self::decode(bytes) {
                Ok(read) => ends.push(read),
                Err(error) => {
                    ends.clear();
                    return Err(error);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compensation::{ContactModel, EnergyAccount, Method, Payload, WaveIntegrals};
    use proptest::prelude::*;

    fn ends() -> CoupledEnds {
        let contact = ContactModel { normal: Vector3::z(), offset: 0.25, stiffness: 300.0, damping: 1.0 };
        CoupledEnds {
            master: CompensationBlock {
                method: Method::WaveVariables,
                account: EnergyAccount { given_nj: 7, balance_nj: -3 },
                payload: Payload::Wave(WaveIntegrals { wave: [1, -2, 3], energy_nj: 9 }),
            },
            slave_force: Vector3::new(0.5, -1.25, 2.0),
            slave: CompensationBlock {
                method: Method::ModelMediated,
                account: EnergyAccount { given_nj: 5, balance_nj: 4 },
                payload: Payload::Contact(contact),
            },
        }
    }

    #[test]
    fn what_is_written_is_read_and_lies_where_it_is_told() {
        let bytes = ends().encode();
        assert_eq!(CoupledEnds::decode(&bytes), Ok(ends()));
        assert_eq!(COUPLED_BYTES, 100);
        assert_eq!(bytes[..44], ends().master.encode());
        assert_eq!(bytes[44..48], 0.5_f32.to_le_bytes());
        assert_eq!(bytes[56..], ends().slave.encode());
        assert_eq!(
            CoupledEnds::decode(&[0; COUPLED_BYTES]),
            Ok(CoupledEnds::default()),
            "nothing was told yet"
        );
    }

    #[test]
    fn what_is_no_coupling_is_refused_and_leaves_none() {
        let good = ends().encode();
        let mut read = vec![ends()];
        let mut bad = good;
        bad[44..48].copy_from_slice(&f32::NAN.to_le_bytes());
        let two = [good, bad].concat();
        assert_eq!(CoupledEnds::decode_all(2, &two, &mut read), Err(CoupledError::NotFinite));
        assert!(read.is_empty());
        assert_eq!(CoupledEnds::decode_all(2, &[good, good].concat(), &mut read), Ok(()));
        assert_eq!(read, [ends(), ends()]);
        for bytes in [&two[..100], &two[..199], &two[..0]] {
            let length = CoupledError::Length { bytes: bytes.len(), hands: 2 };
            assert_eq!(CoupledEnds::decode_all(2, bytes, &mut read), Err(length));
        }
        bad = good;
        bad[56] = 3;
        assert_eq!(CoupledEnds::decode(&bad), Err(CoupledError::Block(BlockError::Method(3))));
    }

    proptest! {
        #[test]
        fn any_bytes_are_refused_or_are_what_would_be_written(bytes in prop::collection::vec(any::<u8>(), 0..301)) {
            let mut read = Vec::new();
            if CoupledEnds::decode_all((bytes.len() / 100) as u8, &bytes, &mut read).is_ok() {
                let written: Vec<u8> = read.iter().flat_map(CoupledEnds::encode).collect();
                prop_assert_eq!(written, bytes);
            }
        }
    }
}
