//! Sealing and opening the hands of a station, and what a warmed tick of both hands links allocates.

use std::time::Instant;

use trocar::network::datagram::{ClockEcho, DATAGRAM_MAX, Hands, Opener, Sealer, Side};
use trocar::network::hands_link::{
    HandNumbers, HandsHost, HandsLink, HandsOrder, HandsStation, HostHand, StationHand, hands_channel,
};
use trocar::network::haptic::SenderConfig;
use trocar::network::remote_hand::{DoorLimits, RemoteHand};
use trocar::summary::{BenchResult, Better};
use trocar_devices::{HandIntent, HapticDevice, VirtualHand, VirtualHandConfig, Wrench};
use trocar_kernel::bench::median_and_spread;
use trocar_scene::SimTime;

use super::super::counting::{counts, is_counting};
use super::Rows;
use super::link::{HANDS, connection_of, end, first_hand, hands_at, keys};
use crate::failure::Failure;

/// Datagrams of a block, and blocks.
const DATAGRAMS: u32 = 100_000;
const BLOCKS: usize = 5;
/// Bar on sealing and opening \[µs\].
const SEALED_MAX_US: f64 = 2.0;
/// Ticks until everything is warm, and those that are counted.
const WARM: u64 = 4_000;
const COUNTED: u64 = 6_000;
/// Place for datagrams under way.
const UNDER_WAY: usize = 16;

/// Both figures.
pub fn sealing() -> Rows {
    let mut times = Vec::new();
    for _ in 0..BLOCKS {
        times.push(seal_and_open()?);
    }
    let sealed = median_and_spread(&times);
    let mut rows = vec![BenchResult::on_value(
        "network_seal_and_open_two_hands",
        "us",
        sealed,
        Some(SEALED_MAX_US),
        Better::Lower,
    )];
    rows.extend(allocations()?);
    Ok(rows)
}

/// Time to seal two hands, open them and read them \[µs\].
fn seal_and_open() -> Result<f64, Failure> {
    let id = connection_of(0);
    let (mut sealer, mut opener) = (
        Sealer::new(keys(id).split(Side::Client).0),
        Opener::new(keys(id).split(Side::Server).1, SimTime::ZERO),
    );
    let (mut out, mut hands) = ([0; DATAGRAM_MAX], Hands::default());
    let samples = hands_at(first_hand(0), SimTime::ZERO);
    let begun = Instant::now();
    for number in 0..DATAGRAMS {
        let now = SimTime::from_millis(u64::from(number));
        let echo = Some(ClockEcho { sent_at: now, held: SimTime::from_micros(200) });
        let length = sealer.seal_hands(now, echo, &samples, &mut out).map_err(Failure::internal)?;
        let (header, payload) = opener.open(now, &mut out[..length]).map_err(Failure::internal)?;
        hands.decode(header.hands, payload).map_err(Failure::internal)?;
    }
    std::hint::black_box(&hands);
    Ok(begun.elapsed().as_secs_f64() * 1e6 / f64::from(DATAGRAMS))
}

/// Datagrams under way, in place.
struct Way {
    datagrams: Vec<([u8; DATAGRAM_MAX], usize)>,
    lost: u64,
}

impl Way {
    fn new() -> Self {
        Self { datagrams: Vec::with_capacity(UNDER_WAY), lost: 0 }
    }

    fn take(&mut self, bytes: &[u8]) -> bool {
        if self.datagrams.len() == UNDER_WAY {
            self.lost += 1;
            return false;
        }
        let mut place = ([0; DATAGRAM_MAX], bytes.len());
        place.0[..bytes.len()].copy_from_slice(bytes);
        self.datagrams.push(place);
        true
    }
}

/// Hands of one end: the devices, and what their links have of them.
fn hands() -> Result<Vec<(RemoteHand, trocar::network::remote_hand::StationEnd)>, Failure> {
    let hand = |number: u8| {
        let local = VirtualHand::new(VirtualHandConfig::default()).map_err(Failure::internal)?;
        let (mut hand, end) =
            RemoteHand::over(number, DoorLimits::default(), Box::new(local)).map_err(Failure::internal)?;
        hand.open(0).map_err(Failure::internal)?;
        Ok((hand, end))
    };
    (0..HANDS as u8).map(hand).collect()
}

/// Allocations and frees of a tick of both hands links, with all datagrams between them.
pub(super) fn allocations() -> Rows {
    if !is_counting() {
        return Err(Failure::usage(
            "this program's allocator counts nothing; its main file needs trocar_cli::CountingAllocator",
        ));
    }
    let config = SenderConfig::default();
    let id = connection_of(0);
    let numbers = HandNumbers::new(0..HANDS as u8);
    let (mut devices, mut at_host, mut at_station) = (Vec::new(), Vec::new(), Vec::new());
    for (number, (device, end)) in hands()?.into_iter().enumerate() {
        end.control().take(1);
        devices.push(device);
        at_host.push(HostHand { number: number as u8, end, playout: None });
    }
    for (number, (device, end)) in hands()?.into_iter().enumerate() {
        devices.push(device);
        at_station.push(StationHand::new(number as u8, end));
    }
    let (to_host, link) = hands_channel::<u8>();
    let mut host = HandsHost::new(at_host, link);
    let (to_station, link) = hands_channel::<u8>();
    let mut station = HandsStation::new(at_station, link);
    for (controller, side, peer) in [(&to_host, Side::Server, None), (&to_station, Side::Client, Some(0))] {
        let connection = Box::new(end::<u8>(0, side, &config)?);
        controller.order(HandsOrder::Open { station: 1, connection, peer });
        controller.order(HandsOrder::Serve { connection: id, hands: numbers });
    }
    let (mut there, mut back) = (Way::new(), Way::new());
    let (mut total, mut carried) = ((0, 0), 0);
    for tick in 1..=WARM + COUNTED {
        let now = SimTime::from_millis(tick);
        for (index, device) in devices.iter_mut().enumerate() {
            // Device and driver are other threads of a session, and are not counted here.
            let sample = hands_at(first_hand(0), now)[index % HANDS];
            let intent = HandIntent::at(sample.state.pose_in_device, 0.0);
            if index >= HANDS {
                device.set_intent(now.as_nanos(), &intent);
            }
            device.read(now.as_nanos()).map_err(Failure::internal)?;
            device.write(now.as_nanos(), &Wrench::ZERO).map_err(Failure::internal)?;
        }
        let before = counts();
        for (datagram, length) in &mut there.datagrams {
            host.receive(now, 1, &mut datagram[..*length], &mut |_, out| back.take(out));
        }
        carried += there.datagrams.len();
        there.datagrams.clear();
        for (datagram, length) in &mut back.datagrams {
            station.receive(now, 0, &mut datagram[..*length], &mut |_, out| there.take(out));
        }
        back.datagrams.clear();
        host.tick(now, &mut |_, out| back.take(out));
        station.tick(now, &mut |_, out| there.take(out));
        let after = counts();
        if tick > WARM {
            total = (total.0 + after.0 - before.0, total.1 + after.1 - before.1);
        }
        for controller in [&to_host, &to_station] {
            while controller.next_news().is_some() {}
        }
    }
    if carried < 100 || there.lost + back.lost > 0 {
        return Err(Failure::internal(format!("the hands links have exchanged {carried} datagrams only")));
    }
    let row = |name: &str, count: u64| {
        let value = (count as f64 / COUNTED as f64, 0.0);
        BenchResult::on_value(name, "per tick", value, Some(0.0), Better::Lower)
    };
    Ok(vec![row("network_hands_link_allocations", total.0), row("network_hands_link_frees", total.1)])
}
