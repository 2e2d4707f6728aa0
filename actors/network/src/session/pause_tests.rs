//! Tests of a pause of the host: stations stand still with it, and stay in.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_scene::SimTime;

use super::{Bench, Presence, Role, StationNews};
use crate::datagram::Keys;
use crate::impairments::Impairments;
use crate::streams::{Closed, HostStreams, StationStream, StreamId, StreamState};

/// Time between two calls while a session is paused \[ms\].
const REST: u64 = 50;

/// Time as it passes for streams, whose bytes travel on while session clocks stand still.
#[derive(Clone, Default)]
pub(super) struct Wall(Arc<AtomicU64>);

impl Wall {
    pub(super) fn set(&self, now: SimTime) {
        self.0.store(now.as_nanos(), Ordering::Relaxed);
    }

    pub(super) fn now(&self) -> SimTime {
        SimTime(self.0.load(Ordering::Relaxed))
    }
}

/// Streams that go by that time.
pub(super) struct ByTheWall<S>(pub(super) S, pub(super) Wall);

impl<S: HostStreams> HostStreams for ByTheWall<S> {
    fn work(&mut self, _: SimTime, opened: &mut Vec<StreamId>) {
        self.0.work(self.1.now(), opened);
    }
    fn receive(&mut self, id: StreamId, _: SimTime, most: usize, into: &mut Vec<u8>) -> Result<(), Closed> {
        self.0.receive(id, self.1.now(), most, into)
    }
    fn send(&mut self, id: StreamId, _: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        self.0.send(id, self.1.now(), bytes)
    }
    fn keys(&mut self, id: StreamId, connection: u32, phase: u32) -> Option<Keys> {
        self.0.keys(id, connection, phase)
    }
    fn close(&mut self, id: StreamId) {
        self.0.close(id);
    }
}

impl<S: StationStream<usize>> StationStream<usize> for ByTheWall<S> {
    fn peer(&self) -> Option<usize> {
        self.0.peer()
    }
    fn connect(&mut self, _: SimTime) {
        self.0.connect(self.1.now());
    }
    fn work(&mut self, _: SimTime) -> StreamState {
        self.0.work(self.1.now())
    }
    fn receive(&mut self, _: SimTime, most: usize, into: &mut Vec<u8>) -> Result<(), Closed> {
        self.0.receive(self.1.now(), most, into)
    }
    fn send(&mut self, _: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        self.0.send(self.1.now(), bytes)
    }
    fn keys(&mut self, connection: u32, phase: u32) -> Option<Keys> {
        self.0.keys(connection, phase)
    }
    fn close(&mut self) {
        self.0.close();
    }
}

impl Bench {
    /// So many milliseconds pass at which the host is paused; and the station, as long as it is told so.
    fn pause_host(&mut self, millis: u64, host_lives: bool) {
        for ms in 1..=millis {
            self.pass();
            self.host_behind += SimTime::from_millis(1);
            if host_lives && ms.is_multiple_of(REST) {
                // There was no other pause, so that this is how long it has lasted.
                self.host.machine.rest(self.host_behind, &self.host.scene);
            }
            if self.station.machine.host_course().is_paused() {
                self.rest_station();
            } else {
                self.step_station(None);
            }
        }
    }

    fn rest_station(&mut self) {
        self.station_behind += SimTime::from_millis(1);
        if self.station_behind.as_nanos().is_multiple_of(REST * 1_000_000) {
            self.station.machine.rest(self.station_behind);
            let news: Vec<_> = self.station.machine.take_news().collect();
            self.station.news.extend(news);
        }
    }
}

fn path() -> Impairments {
    Impairments::delay(SimTime::from_millis(30))
}

#[test]
fn a_pause_of_the_host_keeps_its_stations_in_and_nothing_jumps_afterwards() {
    let mut bench = Bench::new(&path(), 20, Role::Operate, &["left"]);
    bench.run_until(5_000, Bench::is_running);
    bench.run(1_500);
    bench.station.news.clear();
    bench.pause_host(60_000, true);
    assert!(bench.is_running());
    assert_eq!(bench.station.news, [StationNews::Paused(true)], "nothing else has happened");
    let lags = bench.host_behind.since(bench.station_behind);
    assert!(lags < SimTime::from_millis(150), "the station has stood still for as long: {lags}");

    let (mut moved, mut clutched) = (0.0_f64, None);
    for ms in 0..3_000 {
        let before = bench.host.device.x();
        bench.pass();
        bench.step_host();
        // The station stands still until it has heard that the session goes on.
        if bench.station.machine.host_course().is_paused() {
            bench.rest_station();
        } else {
            bench.step_station(None);
        }
        moved = moved.max((bench.host.device.x() - before).abs());
        let is_live = bench.host.device.hand.presence() == Presence::Live(1);
        clutched =
            clutched.or((is_live && bench.station.device.hand.presence() == Presence::Local).then_some(ms));
    }
    assert!(bench.is_running());
    assert_eq!(bench.station.news, [StationNews::Paused(true), StationNews::Paused(false)]);
    assert!(moved <= 1e-6, "{moved} m in a millisecond");
    assert!(clutched.is_some_and(|ms| ms < 1_000), "{clutched:?}");
    let (here, there) = (bench.host.device.x(), bench.station.device.x());
    assert!((here - there).abs() < 2e-4, "{here} and {there}");
    let info = &bench.host.machine.stations()[0];
    assert_eq!((info.is_here, &info.hands[..]), (true, &[0][..]));
}

#[test]
fn a_host_that_dies_within_a_pause_holds_no_station_for_ever() {
    let mut bench = Bench::new(&path(), 20, Role::Operate, &["left"]);
    bench.run_until(5_000, Bench::is_running);
    bench.run(500);
    bench.pause_host(2_000, true);
    assert!(bench.station.machine.host_course().is_paused());
    bench.pause_host(4_000, false);
    assert!(bench.station.machine.host_course().is_paused(), "a path may be bad for a while");
    bench.pause_host(2_500, false);
    assert!(!bench.station.machine.host_course().is_paused());
    assert!(!bench.is_running());
    assert!(bench.station.news.iter().any(|news| matches!(news, StationNews::Away(_))));
}

#[test]
fn who_joins_within_a_pause_gets_in_and_stands_still_as_well() {
    let mut bench = Bench::new(&path(), 20, Role::Watch, &[]);
    bench.run(20);
    bench.pause_host(4_000, true);
    assert!(bench.is_running(), "{:?}", bench.station.machine.error());
    assert!(bench.station.machine.host_course().is_paused());
}
