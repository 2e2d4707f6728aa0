//! A warmed datagram of hands, and a hand that it moves, allocate nothing and free nothing.

use trocar_devices::{HapticDevice, VirtualHand, VirtualHandConfig, Wrench};
use trocar_network::datagram::{
    ClockEcho, DATAGRAM_MAX, Hands, Keys, Kind, Opener, ReceiveKey, Sealer, SendKey, Side,
};
use trocar_network::hand_sample::HandSample;
use trocar_network::hands_link::Connection;
use trocar_network::haptic::SenderConfig;
use trocar_network::remote_hand::{DoorLimits, RemoteHand};
use trocar_scene::SimTime;
use trocar_test_support::allocations::counted;

/// Keys of one direction in a phase, as each side has them.
fn keys_of(phase: u32) -> (SendKey, ReceiveKey) {
    let made = || {
        Keys::from_exporter(7, phase, |_, _, out: &mut [u8]| {
            out.fill(9 + phase as u8);
            Ok::<(), ()>(())
        })
        .expect("keys")
    };
    (made().split(Side::Client).0, made().split(Side::Server).1)
}

/// One direction of a connection, each end as seen from its side.
fn keys() -> (Sealer, Opener) {
    let (send, receive) = keys_of(0);
    (Sealer::new(send), Opener::new(receive, SimTime::from_millis(100)))
}

fn sample(hand: u8, ms: u64) -> HandSample {
    let mut sample = HandSample::unknown(hand);
    sample.state.connected = true;
    sample.state.pose_in_device.translation.vector.x = 1e-5 * ms as f64;
    sample
}

#[test]
fn a_warmed_datagram_of_two_hands_allocates_and_frees_nothing() {
    let (mut sealer, mut opener) = keys();
    let (mut datagram, mut hands) = ([0; DATAGRAM_MAX], Hands::default());
    let mut total = (0, 0);
    for ms in 0..1_000 {
        let now = SimTime::from_millis(ms);
        let samples = [sample(0, ms), sample(1, ms)];
        let echo = Some(ClockEcho { sent_at: now, held: SimTime::from_micros(200) });
        let (allocations, frees) = counted(|| {
            let length = sealer.seal_hands(now, echo, &samples, &mut datagram).expect("it is sealed");
            let (header, payload) = opener.open(now, &mut datagram[..length]).expect("it is opened");
            hands.decode(header.hands, payload).expect("it is read");
        });
        if ms >= 10 {
            total = (total.0 + allocations, total.1 + frees);
        }
        assert_eq!(hands.samples().len(), 2);
    }
    assert_eq!(total, (0, 0));
}

#[test]
fn a_warmed_tick_of_the_hands_link_of_two_hands_allocates_and_frees_nothing() {
    let keys = || {
        let made = Keys::from_exporter(7, 0, |_, _, out: &mut [u8]| {
            out.fill(9);
            Ok::<(), ()>(())
        });
        made.expect("keys")
    };
    let end =
        |side| Connection::new(7, keys(), side, &[0, 1], &SenderConfig::default(), 1).expect("two hands");
    let (mut host, mut station) = (end(Side::Server), end(Side::Client));
    let mut out = [0; DATAGRAM_MAX];
    let mut total = (0, 0);
    let mut arrived = 0;
    for ms in 0..5_000 {
        let now = SimTime::from_millis(ms);
        let samples = [sample(0, ms), sample(1, ms)];
        let (allocations, frees) = counted(|| {
            for turn in 0..2 {
                let (from, to) =
                    if turn == 0 { (&mut station, &mut host) } else { (&mut host, &mut station) };
                if let Some(length) = from.tick(&samples, now, &mut out) {
                    from.sent(&samples, length, true, now);
                    arrived += u64::from(to.receive(now, turn, &mut out[..length]).is_ok());
                }
                if let Some(length) = from.report(now, &mut out) {
                    arrived += u64::from(to.receive(now, turn, &mut out[..length]).is_ok());
                }
                std::hint::black_box((to.read(0, now), to.read(1, now), to.point(now)));
            }
        });
        if ms >= 10 {
            total = (total.0 + allocations, total.1 + frees);
        }
    }
    assert!(arrived > 500, "{arrived}");
    assert_eq!(total, (0, 0));
}

#[test]
fn a_datagram_under_a_new_key_frees_none_of_the_keys_before() {
    let (mut sealer, mut opener) = keys();
    let mut datagram = [0; DATAGRAM_MAX];
    for phase in 1..10 {
        // Some changes come while the key before the last still opens, some long after.
        let begin = SimTime::from_millis(u64::from(phase * phase) * 20);
        let (send, receive) = keys_of(phase);
        opener.rekey(begin, receive).expect("the next phase");
        sealer.rekey(send).expect("the next phase");
        for ms in [0, 1, 150] {
            let now = begin + SimTime::from_millis(ms);
            let touched = counted(|| {
                let length = sealer.seal(Kind::Rows, 0, now, &[5; 40], &mut datagram).expect("it is sealed");
                opener.open(now, &mut datagram[..length]).expect("it is opened");
            });
            assert_eq!(touched, (0, 0), "phase {phase}, {ms} ms later");
        }
        assert_eq!(opener.phase(), phase);
    }
}

#[test]
fn a_remote_hand_that_is_taken_falls_silent_and_returns_allocates_and_frees_nothing() {
    let local = Box::new(VirtualHand::new(VirtualHandConfig::default()).expect("a valid hand"));
    let (mut hand, mut station) = RemoteHand::over(0, DoorLimits::default(), local).expect("valid limits");
    hand.open(0).expect("it opens");
    let mut total = (0, 0);
    for ms in 1..2_000_u64 {
        let now = SimTime::from_millis(ms);
        let (allocations, frees) = counted(|| {
            match ms {
                100 => station.control().take(2),
                1_800 => station.control().give_back(),
                _ => {}
            }
            let silent = (800..1_000).contains(&ms);
            if (100..1_800).contains(&ms) && !silent {
                station.post(2, now, &sample(0, ms));
            }
            let state = hand.read(now.as_nanos()).expect("a reading");
            hand.write(now.as_nanos(), &Wrench::ZERO).expect("it is rendered");
            std::hint::black_box((state, station.answer()));
        });
        if ms >= 10 {
            total = (total.0 + allocations, total.1 + frees);
        }
    }
    assert_eq!(total, (0, 0));
}
