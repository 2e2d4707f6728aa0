//! Tests of a reflected link with the packet reflector.

use trocar_devices::DeviceState;

use super::super::exchange::{MasterSample, exchange};
use super::super::internet_path;
use super::*;
use crate::impairments::Impairments;
use crate::reflector::{Parcel, Reflector};

/// A link over a path, run for so long with a master that moves along x at 0.1 m/s. Calls `look` at every arrival that the
/// device sees, and returns the last report.
fn over(
    path: &Impairments,
    trace: Option<DelayTrace>,
    ms: u64,
    mut look: impl FnMut(&Arrival),
) -> LinkReport {
    let (mut device, linked, _) = exchange(0);
    let (mut link, mut watched) = ReflectedLink::new((), vec![linked], trace).expect("a key");
    let mut reflector = Reflector::new(path, 3);
    for step in 0..ms {
        let now = SimTime::from_millis(step);
        let mut state = DeviceState { connected: true, ..DeviceState::unknown() };
        state.pose_in_device.translation.x = 1e-4 * step as f64;
        device.masters.write(Some(MasterSample { sampled_at: now, state, coupled: None }));
        while let Some(due) = reflector.next_due().filter(|due| *due <= now) {
            let Some(Parcel { mut bytes, .. }) = reflector.due(due) else { break };
            link.receive(due, (), &mut bytes, &mut |(), _| panic!("nothing is answered"));
        }
        link.tick(now, &mut |(), datagram| {
            reflector.receive(datagram, (), now);
            true
        });
        if device.arrivals.update()
            && let Some(arrival) = *device.arrivals.output_buffer()
        {
            look(&arrival);
        }
    }
    watched.report()
}

#[test]
fn every_packet_takes_the_traces_time_and_says_where_the_master_was() {
    let trace = internet_path::trace(internet_path::MEAN, 1);
    let path = Impairments { trace: trace.clone(), ..Impairments::default() };
    let mut newest = SimTime::ZERO;
    let report = over(&path, Some(trace), 21_000, |arrival| {
        assert!(arrival.sampled_at > newest || newest == SimTime::ZERO, "it never goes back");
        newest = arrival.sampled_at;
        let place = 0.1 * arrival.sampled_at.as_secs_f64();
        // Poses travel in single precision.
        assert!((arrival.sample.position_in_device().x - place).abs() < 2e-7);
    });
    let [mean, min, p99, max] = report.round_trips.expect("packets came");
    assert!((mean - 0.150_57).abs() < 0.001 && min > 0.14 && p99 <= max && max < 0.2, "{report:?}");
    assert_eq!(report.delay_errors, Some([0.0, 0.0]));
    assert_eq!((report.late, report.refused), (0, 0));
    assert!(report.sent > 20_900 && report.sent - report.received < 200, "{report:?}");
}

#[test]
fn what_is_overtaken_is_counted_and_not_applied_and_what_is_damaged_is_refused() {
    let path = Impairments {
        delay: SimTime::from_millis(50),
        jitter: SimTime::from_millis(20),
        independent: true,
        loss: 0.1,
        duplicate: 0.1,
        corrupt: 0.1,
        ..Impairments::default()
    };
    let mut newest = SimTime::ZERO;
    let report = over(&path, None, 10_000, |arrival| {
        assert!(arrival.sampled_at > newest || newest == SimTime::ZERO, "it never goes back");
        newest = arrival.sampled_at;
    });
    assert_eq!(report.delay_errors, None, "of a reflector that is not known");
    // A tenth is damaged, of what arrives a tenth comes twice.
    assert!((1_400..2_200).contains(&report.refused), "{report:?}");
    assert!(report.late > 2_000 && (7_900..8_300).contains(&report.received), "{report:?}");
}

#[test]
fn a_stranger_and_an_old_key_are_not_heard() {
    let (_device, linked, _) = exchange(0);
    let (mut link, mut watched) = ReflectedLink::new(7, vec![linked], None).expect("a key");
    let (_other_device, other, _) = exchange(0);
    let (mut stranger, _) = ReflectedLink::new(7, vec![other], None).expect("another key");
    let mut forged = Vec::new();
    let mut send = |_: i32, bytes: &[u8]| {
        forged = bytes.to_vec();
        true
    };
    stranger.samples[0].state.connected = true;
    stranger.sampled[0] = Some(SimTime::ZERO);
    let mut out = [0; DATAGRAM_MAX];
    let length = stranger.sealer.seal_hands(SimTime::ZERO, None, &stranger.samples, &mut out).expect("seals");
    send(7, &out[..length]);
    let nobody = &mut |_: i32, _: &[u8]| panic!("nothing is answered");
    link.receive(SimTime::from_millis(1), 8, &mut forged.clone(), nobody);
    link.receive(SimTime::from_millis(1), 7, &mut forged.clone(), nobody);
    link.receive(SimTime::from_millis(1), 7, &mut [0; 3], nobody);
    link.tick(SimTime::from_millis(1), nobody);
    let report = watched.report();
    assert_eq!((report.received, report.refused), (0, 2), "the other address is not looked at");
}
