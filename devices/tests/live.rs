//! The driver thread on a real clock: that it runs, obeys and stops. Nothing here judges how punctual it is.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::support::force;
use trocar_devices::{
    Capabilities, DeviceError, DeviceFaults, DeviceState, DriverConfig, DriverCore, DriverThread,
    DriverThreadConfig, DriverThreadError, HapticDevice, Scheduling, VirtualHand, VirtualHandConfig, Wrench,
    link,
};
use trocar_test_support::alone;

/// What the test sees of a device that a thread owns.
#[derive(Default)]
struct Seen {
    rendered: Mutex<Wrench>,
    reads: AtomicU64,
    closed: AtomicBool,
    panic_now: AtomicBool,
    hang_now: AtomicBool,
}

struct Watched {
    hand: VirtualHand,
    seen: Arc<Seen>,
}

impl HapticDevice for Watched {
    fn capabilities(&self) -> &Capabilities {
        self.hand.capabilities()
    }
    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.hand.open(now_ns)
    }
    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        self.seen.reads.fetch_add(1, Ordering::Relaxed);
        assert!(!self.seen.panic_now.load(Ordering::Relaxed), "the vendor's library is broken");
        while self.seen.hang_now.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.hand.read(now_ns)
    }
    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        *self.seen.rendered.lock().unwrap() = *wrench;
        self.hand.write(now_ns, wrench)
    }
    fn close(&mut self) {
        self.seen.closed.store(true, Ordering::Relaxed);
        self.hand.close();
    }
}

struct Rig {
    thread: DriverThread,
    slot: trocar_devices::DeviceSlot,
    seen: Arc<Seen>,
    start: Instant,
}

fn rig(configure: impl FnOnce(&mut DriverThreadConfig)) -> Rig {
    let seen = Arc::new(Seen::default());
    let hand = VirtualHand::new(VirtualHandConfig::default()).unwrap();
    let device = Watched { hand, seen: Arc::clone(&seen) };
    let (end, slot, _) = link();
    let core = DriverCore::new(DriverConfig::default(), &device, end, DeviceFaults::new());
    let start = Instant::now();
    let mut config = DriverThreadConfig::new("driver.test", start);
    configure(&mut config);
    let thread = DriverThread::spawn(core, Box::new(device), config).unwrap();
    Rig { thread, slot, seen, start }
}

impl Rig {
    fn now_ns(&self) -> u64 {
        self.start.elapsed().as_nanos() as u64
    }

    /// Commands a force until it is felt; bounded, since a loaded machine may starve either side.
    fn push_until_felt(&self, link: &mut trocar_devices::DeviceLink) {
        self.until("the force is felt", || {
            link.command(force(link.epoch(), self.now_ns(), 1.0));
            self.seen.rendered.lock().unwrap().force.x > 0.2
        });
    }

    fn until(&self, what: &str, mut holds: impl FnMut() -> bool) {
        let deadline = Instant::now() + Duration::from_secs(20);
        while !holds() {
            assert!(Instant::now() < deadline, "{what}: not within 20 s");
            std::thread::sleep(Duration::from_micros(500));
        }
    }

    fn rendered(&self) -> Wrench {
        *self.seen.rendered.lock().unwrap()
    }
}

#[test]
fn a_live_driver_renders_stops_and_tells() {
    let _alone = alone();
    let rig = rig(|_| {});
    let mut link = rig.slot.take(1).unwrap();
    rig.push_until_felt(&mut link);
    let sample = *link.sample();
    assert!(sample.state.connected && sample.published_at_ns <= rig.now_ns());
    assert_eq!(rig.thread.scheduling(), Some(&Scheduling::Ordinary));
    assert!(rig.thread.is_running());
    let seen = Arc::clone(&rig.seen);
    let statistics = rig.thread.stop().unwrap();
    assert!(seen.closed.load(Ordering::Relaxed));
    assert_eq!(*seen.rendered.lock().unwrap(), Wrench::ZERO);
    assert!(statistics.steps > 0 && statistics.accepted > 0 && statistics.force_newtons_max <= 3.3);
    assert!(!link.sample().state.connected);
}

#[test]
fn dropping_the_driver_leaves_no_force() {
    let _alone = alone();
    let rig = rig(|config| config.rate_hz = 10_000.0);
    let mut link = rig.slot.take(1).unwrap();
    rig.push_until_felt(&mut link);
    let Rig { thread, seen, .. } = rig;
    drop(thread);
    assert_eq!(*seen.rendered.lock().unwrap(), Wrench::ZERO);
    assert!(seen.closed.load(Ordering::Relaxed));
}

#[test]
fn an_emergency_from_another_thread_stops_all_force() {
    let _alone = alone();
    let rig = rig(|_| {});
    let mut link = rig.slot.take(1).unwrap();
    rig.push_until_felt(&mut link);
    rig.thread.zero_all_forces();
    let reads = rig.seen.reads.load(Ordering::Relaxed);
    rig.until("two more steps", || {
        link.command(force(1, rig.now_ns(), 1.0));
        rig.seen.reads.load(Ordering::Relaxed) >= reads + 2
    });
    assert_eq!(rig.rendered(), Wrench::ZERO);
}

#[test]
fn a_device_that_panics_ends_its_thread_only_and_feels_nothing() {
    let _alone = alone();
    let rig = rig(|_| {});
    let mut link = rig.slot.take(1).unwrap();
    rig.push_until_felt(&mut link);
    rig.seen.panic_now.store(true, Ordering::Relaxed);
    rig.until("the thread ends", || !rig.thread.is_running());
    assert_eq!(rig.rendered(), Wrench::ZERO);
    assert!(!link.sample().state.connected);
    let error = rig.thread.stop().unwrap_err();
    assert_eq!(error.to_string(), "the driver of the device panicked: the vendor's library is broken");
}

#[test]
fn a_device_that_hangs_is_abandoned() {
    let _alone = alone();
    let rig = rig(|_| {});
    rig.until("it runs", || rig.seen.reads.load(Ordering::Relaxed) > 0);
    rig.seen.hang_now.store(true, Ordering::Relaxed);
    let reads = rig.seen.reads.load(Ordering::Relaxed);
    rig.until("it hangs", || rig.seen.reads.load(Ordering::Relaxed) > reads);
    let seen = Arc::clone(&rig.seen);
    assert!(matches!(rig.thread.stop(), Err(DriverThreadError::Hung)));
    // Lets the abandoned thread end.
    seen.hang_now.store(false, Ordering::Relaxed);
}

#[test]
fn a_priority_is_granted_or_its_refusal_is_told() {
    let _alone = alone();
    let rig = rig(|config| config.priority = Some(80));
    rig.until("it has found out", || rig.thread.scheduling().is_some());
    match rig.thread.scheduling().unwrap() {
        Scheduling::Fifo(priority) => assert_eq!(*priority, 80),
        Scheduling::Refused { priority, reason } => assert!(*priority == 80 && !reason.is_empty()),
        Scheduling::Ordinary => panic!("a priority was asked for"),
    }
    // Granted or not, it runs.
    rig.until("it runs", || rig.seen.reads.load(Ordering::Relaxed) > 10);
}

#[test]
fn a_rate_out_of_range_is_refused() {
    let _alone = alone();
    for rate_hz in [0.0, -1.0, f64::NAN, 99.0, 10_001.0] {
        let hand = VirtualHand::new(VirtualHandConfig::default()).unwrap();
        let (end, _slot, _) = link();
        let core = DriverCore::new(DriverConfig::default(), &hand, end, DeviceFaults::new());
        let config = DriverThreadConfig { rate_hz, ..DriverThreadConfig::new("driver.test", Instant::now()) };
        let error = DriverThread::spawn(core, Box::new(hand), config).unwrap_err();
        assert!(error.to_string().contains("out of range (100 to 10000 Hz)"), "{error}");
    }
}
