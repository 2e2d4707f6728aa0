//! Sessions, clients and waiting.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use trocar_devices::{HapticDevice, Wrench};
use trocar_kernel::live::{Guest, LiveSession};
use trocar_kernel::spec::SessionSpec;
use trocar_scene::{
    Access, Commands, DeviceState, Entity, EntityAllocator, EntitySet, Hand, Name, Pose, Registry, Side,
    SimTime, Store, WriterId,
};
use trocar_zenoh::hand::{HandBoard, ZenohHand};
use trocar_zenoh::keys::SessionKeys;
use trocar_zenoh::live::{Bridge, SessionFacts, SessionGuests};
use trocar_zenoh::remote_controller::RemoteController;
use trocar_zenoh::rights::Rights;
use trocar_zenoh::settings::NodeSettings;
use zenoh::Wait;

/// Longest wait for what has to happen on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// A port that is free now.
pub fn free_port() -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("an address").port()
}

pub fn settings(text: &str) -> NodeSettings {
    text.parse().unwrap_or_else(|error| panic!("{text}: {error}"))
}

/// Waits until something holds.
pub fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let until = Instant::now() + PATIENCE;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < until, "within {PATIENCE:?}: {what}");
        thread::sleep(Duration::from_millis(10));
    }
}

/// A live session on Zenoh, without controllers: a wall, a camera, and a probe that its hand moves.
pub struct Running {
    pub live: LiveSession,
    pub bridge: Bridge,
    pub keys: SessionKeys,
    _hand: MovedHand,
}

impl Running {
    /// `hand` is the name under which the hand is commanded, if it is.
    pub fn start(text: &str, rights: &Rights, hand: Option<&str>) -> Self {
        let board = HandBoard::default();
        let node = settings(text);
        board.open(node.is_protected());
        let name = node.name.clone().unwrap_or_else(|| "wall".to_owned());
        let facts =
            SessionFacts { name: name.clone(), scenario: "wall".into(), is_hosted: false, station: None };
        let device = hand.map(|hand| board.device(hand).expect("a hand"));
        let bridge =
            Bridge::open(&node, rights, &facts, &board).unwrap_or_else(|error| panic!("{text}: {error}"));
        let live = LiveSession::start(SessionSpec::new("wall", 1, scene(), Vec::new())).expect("it runs");
        let reader = live.guest("zenoh", WriterId(200), &Access::new().reads::<Name>(), 4).expect("a guest");
        let engine = Access::new().writes::<Pose>(EntitySet::Of(vec![PROBE]));
        let engine = live.guest("engine", WriterId(199), &engine, 64).expect("a writer");
        let mut controllers = Vec::new();
        for (right, number) in rights.controllers.iter().zip(201..) {
            let controller = RemoteController::new(right.clone());
            let access = controller.access(&live.snapshot()).expect("names that there are");
            let name = format!("zenoh.{}", right.name);
            let guest = live.guest_with_answers(&name, WriterId(number), &access, 64).expect("a writer");
            controllers.push((controller, guest));
        }
        bridge.start(SessionGuests { reader, controllers });
        bridge.tell_health(vec![("engine".to_owned(), "healthy".to_owned())]);
        let hand = MovedHand::start(device, engine);
        Self { live, bridge, keys: SessionKeys::new(&name), _hand: hand }
    }
}

const WALL: Entity = Entity::new(0, 0, 1);
const PROBE: Entity = Entity::new(0, 0, 2);
const HAND: Entity = Entity::new(0, 0, 3);
const CAMERA: Entity = Entity::new(0, 0, 4);

fn scene() -> Store {
    let mut store = Store::new(Registry::standard());
    let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 0));
    let places = [
        (WALL, "wall", -0.01),
        (PROBE, "probe.right", 0.01),
        (HAND, "hand.right", 0.0),
        (CAMERA, "camera", 0.3),
    ];
    for (entity, name, z) in places {
        assert_eq!(out.spawn(), entity);
        out.put(entity, Name(name.into()));
        out.put(entity, Pose::at(0.0, 0.0, z));
    }
    let hand = Hand { side: Side::Right, instrument: PROBE, world_from_device: Pose::default(), scale: 1.0 };
    out.put(HAND, hand);
    out.put(HAND, DeviceState::default());
    assert_eq!(out.error(), None);
    out.seal();
    store.apply(&mut out, SimTime::ZERO);
    store
}

/// What a driver and an engine do with a hand: it is read each millisecond, and moves the probe.
struct MovedHand {
    stop: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl MovedHand {
    fn start(device: Option<ZenohHand>, mut engine: Guest) -> Self {
        let stop = Arc::<AtomicBool>::default();
        let stopped = stop.clone();
        let thread = thread::spawn(move || {
            let Some(mut device) = device else { return };
            let begun = Instant::now();
            let now = || u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX);
            device.open(now()).expect("it opens");
            while !stopped.load(Ordering::Relaxed) {
                let state = device.read(now()).expect("it is open");
                device.write(now(), &Wrench::ZERO).expect("it is open");
                let at = state.pose_in_device.translation.vector;
                let _ = engine.write(|_, out| out.put(PROBE, Pose::at(at.x, at.y, at.z)));
                thread::sleep(Duration::from_millis(1));
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for MovedHand {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(thread::JoinHandle::join);
    }
}

/// A client of the library itself.
pub struct Client {
    pub session: zenoh::Session,
}

impl Client {
    /// Calls an endpoint, with certificate files `(authority, certificate, key)` if there are any.
    ///
    /// # Errors
    /// What the library says.
    pub fn try_open(endpoint: &str, tls: Option<[&str; 3]>) -> zenoh::Result<Self> {
        let mut config = json!({
            "mode": "client",
            "connect": { "endpoints": [endpoint], "timeout_ms": 3_000, "exit_on_failure": true },
            "scouting": { "multicast": { "enabled": false } },
        });
        if let Some([authority, certificate, key]) = tls {
            config["transport"] = json!({ "link": { "tls": { "root_ca_certificate": authority } } });
            if !certificate.is_empty() {
                let tls = &mut config["transport"]["link"]["tls"];
                tls["enable_mtls"] = json!(true);
                tls["connect_certificate"] = json!(certificate);
                tls["connect_private_key"] = json!(key);
            }
        }
        let config = zenoh::Config::from_json5(&config.to_string())?;
        Ok(Self { session: zenoh::open(config).wait()? })
    }

    pub fn open(endpoint: &str) -> Self {
        Self::try_open(endpoint, None).unwrap_or_else(|error| panic!("{endpoint}: {error}"))
    }

    /// Messages of a key, as JSON.
    pub fn subscribe(&self, key: &str) -> Heard {
        let (heard, messages) = sync_channel(4_096);
        let told = move |sample: zenoh::sample::Sample| {
            let value = serde_json::from_slice(&sample.payload().to_bytes()).unwrap_or(Value::Null);
            let _ = heard.try_send((sample.key_expr().as_str().to_owned(), value));
        };
        let subscriber = self.session.declare_subscriber(key).callback(told).wait().expect("a subscription");
        Heard { messages, _subscriber: subscriber }
    }

    /// The first answer to a question; the refusal's words otherwise.
    pub fn ask(&self, key: &str) -> Result<Value, String> {
        let replies = self.session.get(key).timeout(Duration::from_secs(1)).wait().expect("a question");
        let mut refusal = "nobody answers".to_owned();
        while let Ok(reply) = replies.recv() {
            match reply.result() {
                Ok(sample) => return Ok(serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON")),
                Err(error) => refusal = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned(),
            }
        }
        Err(refusal)
    }

    pub fn put(&self, key: &str, value: &Value) {
        self.session.put(key, value.to_string()).wait().expect("it is put");
    }

    /// Claims a hand or a controller.
    pub fn claim(&self, key: &str) -> String {
        wait_for(key, || self.ask(key).ok())["claim"].as_str().expect("a claim").to_owned()
    }
}

/// What a subscription hears.
pub struct Heard {
    messages: Receiver<(String, Value)>,
    _subscriber: zenoh::pubsub::Subscriber<()>,
}

impl Heard {
    /// The next message for which this holds.
    pub fn until(&self, what: &str, holds: impl Fn(&str, &Value) -> bool) -> (String, Value) {
        let until = Instant::now() + PATIENCE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let message = self.messages.recv_timeout(left);
            let (key, value) = message.unwrap_or_else(|_| panic!("within {PATIENCE:?}: {what}"));
            if holds(&key, &value) {
                return (key, value);
            }
        }
    }

    /// The next message within a time for which this holds.
    pub fn next(&self, within: Duration, holds: impl Fn(&str, &Value) -> bool) -> Option<(String, Value)> {
        let until = Instant::now() + within;
        loop {
            let message = self.messages.recv_timeout(until.saturating_duration_since(Instant::now())).ok()?;
            if holds(&message.0, &message.1) {
                return Some(message);
            }
        }
    }

    /// Messages that come within a time.
    pub fn count(&self, within: Duration) -> usize {
        let until = Instant::now() + within;
        let mut count = 0;
        while self.messages.recv_timeout(until.saturating_duration_since(Instant::now())).is_ok() {
            count += 1;
        }
        count
    }
}

/// A path between two ends that can fall silent without closing: a cable that is pulled.
pub struct Cable {
    pub port: u16,
    pulled: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
}

impl Cable {
    pub fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let cable = Self {
            port: listener.local_addr().expect("an address").port(),
            pulled: Arc::default(),
            stop: Arc::default(),
        };
        let (pulled, stop) = (cable.pulled.clone(), cable.stop.clone());
        thread::spawn(move || {
            for near in listener.incoming().flatten() {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                let far = TcpStream::connect(SocketAddr::from(([127, 0, 0, 1], port)));
                // Who calls through a cable without another end is refused.
                let Ok(far) = far else { continue };
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (from, to) = (from.try_clone().expect("a stream"), to.try_clone().expect("a stream"));
                    let (pulled, stop) = (pulled.clone(), stop.clone());
                    thread::spawn(move || carry(from, to, &pulled, &stop));
                }
            }
        });
        cable
    }

    pub fn pull(&self) {
        self.pulled.store(true, Ordering::Relaxed);
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = TcpStream::connect(SocketAddr::from(([127, 0, 0, 1], self.port)));
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, pulled: &AtomicBool, stop: &AtomicBool) {
    let _ = from.set_read_timeout(Some(Duration::from_millis(20)));
    let mut bytes = [0; 65_536];
    while !stop.load(Ordering::Relaxed) {
        match from.read(&mut bytes) {
            Ok(0) => break,
            // What is sent into a pulled cable is gone.
            Ok(_) if pulled.load(Ordering::Relaxed) => {}
            Ok(count) => {
                if to.write_all(&bytes[..count]).is_err() {
                    break;
                }
            }
            Err(error)
                if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = to.shutdown(Shutdown::Both);
}
