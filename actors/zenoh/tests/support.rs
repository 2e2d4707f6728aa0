//! Sessions, clients and waiting.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use trocar::app::App;
use trocar::run::{RunOptions, start};
use trocar::session::Session;
use trocar_scene::{Access, Name};
use trocar_zenoh::hand::{ABOUT, HandBoard, USAGE};
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

/// A live session of the scenario `wall` on Zenoh.
pub struct Running {
    pub session: Session,
    pub bridge: Bridge,
    pub keys: SessionKeys,
}

impl Running {
    pub fn start(text: &str, rights: &Rights, hand: &str) -> Self {
        let board = HandBoard::default();
        let of_app = board.clone();
        let app = App::new().device_with(USAGE, ABOUT, move |text| of_app.device(text));
        let scenario = app.scenario("wall").expect("a scenario");
        let node = settings(text);
        board.open(node.is_protected());
        let name = node.name.clone().unwrap_or_else(|| scenario.name.clone());
        let facts = SessionFacts {
            name: name.clone(),
            scenario: scenario.name.clone(),
            is_hosted: false,
            station: None,
        };
        let bridge =
            Bridge::open(&node, rights, &facts, &board).unwrap_or_else(|error| panic!("{text}: {error}"));
        let hands = vec![("right".to_owned(), hand.to_owned())];
        let mut session =
            start(&app, &scenario, &RunOptions { hands, ..RunOptions::default() }).expect("it runs");
        let reader = session.guest("zenoh", &Access::new().reads::<Name>()).expect("a guest");
        let scene = session.snapshot();
        let controllers = rights
            .controllers
            .iter()
            .map(|right| {
                let controller = RemoteController::new(right.clone());
                let access = controller.access(&scene).expect("names that there are");
                let name = format!("zenoh.{}", right.name);
                let guest = session.guest_with_answers(&name, &access).expect("a writer");
                (controller, guest)
            })
            .collect();
        bridge.start(SessionGuests { reader, controllers });
        bridge.tell_health(vec![("engine".to_owned(), "healthy".to_owned())]);
        Self { session, bridge, keys: SessionKeys::new(&name) }
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
