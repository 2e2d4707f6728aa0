//! Tests of the payload of kind hands.

use proptest::prelude::*;

use super::*;

fn sample(hand: u8) -> HandSample {
    HandSample {
        hand,
        state: DeviceState {
            pose_in_device: Isometry3::from_parts(
                Translation3::new(1.0, 2.0, 3.0),
                UnitQuaternion::new_unchecked(Quaternion::new(0.8, 0.0, 0.6, 0.0)),
            ),
            linear_velocity: Vector3::new(4.0, 5.0, 6.0),
            angular_velocity: Vector3::new(7.0, 8.0, 9.0),
            gripper: 16.0,
            buttons: 0x8001 | Pedals::Energy.buttons(),
            connected: true,
        },
        wrench: Wrench { force: Vector3::new(10.0, 11.0, 12.0), torque: Vector3::new(13.0, 14.0, 15.0) },
        grabbed: Some((Entity::from_bits(0x1122_3344_5566_7788), 0x99aa_bbcc)),
        age_us: 0x0403_0201,
        clutch: 7,
    }
}

fn encoded(echo: Option<ClockEcho>, samples: &[HandSample]) -> Vec<u8> {
    let mut payload = [0xee; PAYLOAD_MAX];
    let length = encode_hands(echo, samples, &mut payload).expect("the samples are valid");
    payload[..length].to_vec()
}

fn decoded(payload: &[u8]) -> Result<Hands, HandsError> {
    let hands = (payload.len().saturating_sub(12) / 100) as u8;
    let mut out = Hands::default();
    out.decode(hands, payload).map(|()| out)
}

#[test]
fn fields_lie_where_the_table_says() {
    let echo = ClockEcho { sent_at: SimTime(0x0807_0605_0403_0201), held: SimTime::from_micros(0x0d0c_0b0a) };
    let bytes = encoded(Some(echo), &[sample(5), sample(6)]);
    assert_eq!(bytes.len(), 212);
    assert_eq!(bytes[..8], [1, 2, 3, 4, 5, 6, 7, 8]);
    assert_eq!(bytes[8..12], [0x0a, 0x0b, 0x0c, 0x0d]);
    for (hand, start) in [(5, 12), (6, 112)] {
        let of = |offset: usize| &bytes[start + offset..];
        let flags = 3 | 7 << 2 | 2 << 6;
        assert_eq!(of(0)[..8], [hand, flags, 0x01, 0x80, 1, 2, 3, 4]);
        let number = |offset: usize| f32::from_le_bytes(of(offset)[..4].try_into().expect("four bytes"));
        let rotation = [(20, 0.0), (24, 0.6), (28, 0.0), (32, 0.8)];
        let position = [(8, 1.0), (12, 2.0), (16, 3.0)];
        let others = (36..88).step_by(4).zip(4_u8..).map(|(offset, value)| (offset, f32::from(value)));
        for (offset, value) in position.into_iter().chain(rotation).chain(others) {
            assert_eq!(number(offset), value, "offset {offset}");
        }
        assert_eq!(of(88)[..8], [0x88, 0x77, 0x66, 0x55, 0x44, 0x33, 0x22, 0x11]);
        assert_eq!(of(96)[..4], [0xcc, 0xbb, 0xaa, 0x99]);
    }
}

#[test]
fn eleven_hands_fit_into_a_datagram_and_no_more() {
    assert_eq!((HANDS_MAX, PAYLOAD_MAX), (11, 1_160));
    let samples: Vec<_> = (0..12).map(sample).collect();
    assert_eq!(encoded(None, &samples[..11]).len(), 1_112);
    let mut payload = [0; PAYLOAD_MAX];
    assert_eq!(encode_hands(None, &samples, &mut payload), Err(HandsError::TooMany(12)));
    assert_eq!(Hands::default().decode(12, &[0; 1_212]), Err(HandsError::TooMany(12)));
}

#[test]
fn an_echo_alone_is_a_payload() {
    let echo = ClockEcho { sent_at: SimTime::ZERO, held: SimTime::ZERO };
    let hands = decoded(&encoded(Some(echo), &[])).expect("it is valid");
    assert_eq!((hands.echo(), hands.samples().len()), (Some(echo), 0));
    assert_eq!(decoded(&encoded(None, &[])).expect("it is valid").echo(), None);
}

#[test]
fn an_echo_is_rounded_to_microseconds_and_left_out_when_it_is_too_old_to_say() {
    let sent_at = SimTime(12_345);
    let received = |held_ns: u64| {
        let echo = ClockEcho { sent_at, held: SimTime(held_ns) };
        let hands = decoded(&encoded(Some(echo), &[])).expect("it is valid");
        hands.echo().map(|echo| (echo.sent_at, echo.held.as_nanos()))
    };
    assert_eq!(received(1_499), Some((sent_at, 1_000)));
    assert_eq!(received(1_500), Some((sent_at, 2_000)));
    let longest = u64::from(u32::MAX - 1) * 1_000;
    assert_eq!(received(longest + 499), Some((sent_at, longest)));
    assert_eq!(received(longest + 500), None);
    assert_eq!(received(u64::MAX), None);
}

#[test]
fn numbers_beyond_single_precision_become_its_greatest() {
    let mut huge = sample(0);
    huge.wrench.force = Vector3::new(1e300, -1e300, 3.402_823_5e38);
    let hands = decoded(&encoded(None, &[huge])).expect("it is valid");
    let most = f64::from(f32::MAX);
    assert_eq!(hands.samples()[0].wrench.force, Vector3::new(most, -most, most));
}

#[test]
fn a_sample_that_is_not_valid_is_not_encoded() {
    let refused = |change: fn(&mut HandSample)| {
        let mut samples = [sample(1), sample(2)];
        change(&mut samples[1]);
        encode_hands(None, &samples, &mut [0; PAYLOAD_MAX]).expect_err("it is not valid")
    };
    assert_eq!(refused(|sample| sample.state.gripper = f64::NAN), HandsError::NotFinite(2));
    assert_eq!(refused(|sample| sample.wrench.torque.y = f64::INFINITY), HandsError::NotFinite(2));
    assert_eq!(refused(|sample| sample.hand = 1), HandsError::Repeated(1));
    let long = refused(|sample| {
        sample.state.pose_in_device.rotation =
            UnitQuaternion::new_unchecked(Quaternion::new(2.0, 0.0, 0.0, 0.0));
    });
    assert_eq!(long, HandsError::Rotation { hand: 2, length: 2.0 });
}

#[test]
fn what_is_received_is_accepted_whole_or_refused_with_its_reason() {
    let echo = ClockEcho { sent_at: SimTime(9), held: SimTime::from_micros(9) };
    let good = encoded(Some(echo), &[sample(1), sample(2)]);
    let mut hands = Hands::default();
    let mut refused = |place: usize, bytes: &[u8]| {
        hands.decode(2, &good).expect("it is valid");
        assert_eq!(hands.samples().len(), 2);
        let mut bad = good.clone();
        bad[place..place + bytes.len()].copy_from_slice(bytes);
        let error = hands.decode(2, &bad).expect_err("it is not valid");
        assert!(hands.samples().is_empty() && hands.echo().is_none());
        error
    };
    // The second hand begins at 112.
    assert_eq!(refused(112, &[1]), HandsError::Repeated(1));
    assert_eq!(refused(113, &[1]), HandsError::Grabbed(2));
    assert_eq!(refused(8, &[0xff; 4]), HandsError::Echo(9));
    for offset in (112 + 8..112 + 88).step_by(4) {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!(refused(offset, &bad.to_le_bytes()), HandsError::NotFinite(2), "{bad} at {offset}");
        }
    }
    for w in [0.0_f32, 0.803, -0.797, f32::MAX] {
        let HandsError::Rotation { hand: 2, length } = refused(112 + 32, &w.to_le_bytes()) else {
            panic!("w = {w}");
        };
        assert!((length - 1.0).abs() > 1e-3);
    }
    // Without its flag, an entity or a node alone is refused, too.
    let mut free = sample(2);
    free.grabbed = None;
    let free = encoded(None, &[free]);
    for place in [12 + 88, 12 + 95, 12 + 96, 12 + 99] {
        let mut bad = free.clone();
        bad[place] = 1;
        assert_eq!(decoded(&bad).expect_err("it holds something"), HandsError::Grabbed(2));
    }
}

#[test]
fn a_length_that_is_not_that_of_the_count_is_refused() {
    let good = encoded(None, &[sample(1), sample(2)]);
    let mut hands = Hands::default();
    for length in 0..good.len() {
        let error = HandsError::Length { bytes: length, hands: 2 };
        assert_eq!(hands.decode(2, &good[..length]), Err(error));
    }
    for count in [0, 1, 3, 11] {
        assert_eq!(hands.decode(count, &good), Err(HandsError::Length { bytes: 212, hands: count }));
    }
}

#[test]
fn a_rotation_that_is_nearly_of_unit_length_is_normalised_in_double_precision() {
    let mut bytes = encoded(None, &[sample(1)]);
    for (offset, value) in [(20, 0.0_f32), (24, 0.6005), (28, 0.0), (32, 0.8005)] {
        bytes[12 + offset..12 + offset + 4].copy_from_slice(&value.to_le_bytes());
    }
    let hands = decoded(&bytes).expect("it is off by 0.7 per mille");
    let rotation = hands.samples()[0].state.pose_in_device.rotation;
    assert!((rotation.coords.norm() - 1.0).abs() < 1e-15);
    assert!(hands.samples()[0].is_valid());
}

fn any_sample() -> impl Strategy<Value = HandSample> {
    let numbers = || prop::array::uniform3(-1e3..1e3_f64).prop_map(Vector3::from);
    let rotation = prop::array::uniform4(-1.0..1.0_f64).prop_map(|coords| {
        UnitQuaternion::try_new(Quaternion::from(coords), 1e-3).unwrap_or(UnitQuaternion::identity())
    });
    let motion = (numbers(), rotation, numbers(), numbers(), -10.0..10.0_f64);
    let rest = (any::<u16>(), any::<bool>(), any::<Option<(u64, u32)>>(), any::<u32>(), 0..CLUTCHES);
    (motion, numbers(), numbers(), rest).prop_map(|(motion, force, torque, rest)| HandSample {
        hand: 0,
        state: DeviceState {
            pose_in_device: Isometry3::from_parts(motion.0.into(), motion.1),
            linear_velocity: motion.2,
            angular_velocity: motion.3,
            gripper: motion.4,
            buttons: u32::from(rest.0),
            connected: rest.1,
        },
        wrench: Wrench { force, torque },
        grabbed: rest.2.map(|(entity, node)| (Entity::from_bits(entity), node)),
        age_us: rest.3,
        clutch: rest.4,
    })
}

/// Whether one is the other rounded to single precision.
fn near(one: &[f64], other: &[f64]) -> bool {
    one.iter().zip(other).all(|(one, other)| (one - other).abs() <= 6e-8 * one.abs() + 1e-40)
}

proptest! {
    #[test]
    fn hands_arrive_as_they_were_sent_up_to_single_precision(
        mut samples in prop::collection::vec(any_sample(), 0..=HANDS_MAX),
        first in any::<u8>(),
        echo in any::<Option<(u64, u32)>>(),
    ) {
        for (sample, number) in samples.iter_mut().zip(0..) {
            sample.hand = first.wrapping_add(number * 17);
        }
        let echo = echo.filter(|(_, held)| *held < u32::MAX).map(|(sent_at, held)| ClockEcho {
            sent_at: SimTime(sent_at),
            held: SimTime::from_micros(u64::from(held)),
        });
        let hands = decoded(&encoded(echo, &samples)).expect("it is valid");
        prop_assert_eq!(hands.echo(), echo);
        prop_assert_eq!(hands.samples().len(), samples.len());
        for (sent, got) in samples.iter().zip(hands.samples()) {
            prop_assert!(got.is_valid());
            let (a, b) = (&sent.state, &got.state);
            prop_assert!(near(sent.position_in_device().as_slice(), got.position_in_device().as_slice()));
            prop_assert!(near(a.linear_velocity.as_slice(), b.linear_velocity.as_slice()));
            prop_assert!(near(a.angular_velocity.as_slice(), b.angular_velocity.as_slice()));
            prop_assert!(near(sent.wrench.force.as_slice(), got.wrench.force.as_slice()));
            prop_assert!(near(sent.wrench.torque.as_slice(), got.wrench.torque.as_slice()));
            prop_assert!(near(&[a.gripper], &[b.gripper]));
            let turned = (a.pose_in_device.rotation.coords - b.pose_in_device.rotation.coords).norm();
            prop_assert!(turned < 2e-7, "{turned}");
            let exact = |sample: &HandSample| {
                let HandSample { hand, state, grabbed, age_us, clutch, .. } = *sample;
                (hand, state.buttons, state.connected, grabbed, age_us, clutch)
            };
            prop_assert_eq!(exact(sent), exact(got));
        }
    }

    #[test]
    fn any_bytes_are_valid_hands_or_an_error(
        count in 0..=12_u8,
        mut bytes in prop::collection::vec(any::<u8>(), 0..1_300),
        change in 0..3_u8,
    ) {
        if change > 0 {
            bytes.resize(12 + 100 * usize::from(count), 0);
        }
        if change > 1 {
            // Most random bytes are no rotation; so that all checks are met, these get one.
            for (hand, number) in bytes[12..].as_chunks_mut::<100>().0.iter_mut().zip(0..) {
                (hand[0], hand[1]) = (number, hand[1] & 3);
                hand[20..32].fill(0);
                hand[32..36].copy_from_slice(&1.0_f32.to_le_bytes());
            }
        }
        let mut hands = Hands::default();
        match hands.decode(count, &bytes) {
            Ok(()) => {
                prop_assert_eq!(hands.samples().len(), usize::from(count));
                prop_assert!(hands.samples().iter().all(HandSample::is_valid));
                // All but the rotations, which are normalised, encode to the same bytes.
                let mut again = encoded(hands.echo(), hands.samples());
                prop_assert_eq!(again.len(), bytes.len());
                for bytes in [&mut again, &mut bytes] {
                    for hand in bytes[12..].as_chunks_mut::<100>().0 {
                        hand[20..36].fill(0);
                    }
                }
                prop_assert_eq!(again, bytes);
            }
            Err(_) => prop_assert!(hands.samples().is_empty()),
        }
    }
}
