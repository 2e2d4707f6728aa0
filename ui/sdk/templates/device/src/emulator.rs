//! An emulator of the device: its side of the cable, with a simulated hand. For the tests, and for people without a
//! stylus. Every driver should have one.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::protocol::{FrameReader, PERIOD_SECS, StateFrame};

/// Moving parts, the handle and the arm behind it: mass \[kg\], damping [N·s/m], stiffness [N/m].
const MASS: f64 = 0.2;
const DAMPING: f64 = 8.0;
const STIFFNESS: f64 = 200.0;
/// Final target position of the arm along the stylus \[m\].
const AIM: f64 = 0.02;
/// Without a new force for so many periods the motors are switched off: a device must not rely on the computer.
const WATCHDOG: u32 = 100;

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    unplugged: AtomicBool,
    garbled: AtomicBool,
    force_max_mn: AtomicU32,
    connections: AtomicU32,
}

/// An emulated device; dropping it switches it off.
pub struct Emulator {
    address: SocketAddr,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    /// Listens on this address; port 0 selects a free one.
    pub fn start(address: &str) -> std::io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let (address, shared) = (listener.local_addr()?, Arc::new(Shared::default()));
        let given = shared.clone();
        let thread = std::thread::Builder::new().name("emulator".to_owned()).spawn(move || {
            while !given.stop.load(Ordering::Relaxed) {
                // While the cable is unplugged, a terminal server hangs up on whoever calls.
                if let Ok((stream, _)) = listener.accept()
                    && !given.unplugged.load(Ordering::Relaxed)
                {
                    given.connections.fetch_add(1, Ordering::Relaxed);
                    serve(&stream, &given);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        })?;
        Ok(Self { address, shared, thread: Some(thread) })
    }

    /// Its address.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
    /// Unplugs the cable, or plugs it in again.
    pub fn set_unplugged(&self, unplugged: bool) {
        self.shared.unplugged.store(unplugged, Ordering::Relaxed);
    }
    /// Makes the cable faulty: noise between frames, and a flipped bit in every third frame.
    pub fn set_garbled(&self, garbled: bool) {
        self.shared.garbled.store(garbled, Ordering::Relaxed);
    }
    /// Largest force commanded so far \[N\].
    pub fn force_max(&self) -> f64 {
        1e-3 * f64::from(self.shared.force_max_mn.load(Ordering::Relaxed))
    }
    /// Number of connections so far, but for those that came while the cable was unplugged.
    pub fn connections(&self) -> u32 {
        self.shared.connections.load(Ordering::Relaxed)
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the emulator does not matter any more.
            let _ = thread.join();
        }
    }
}

/// One connection, until either side ends it.
fn serve(mut stream: &TcpStream, shared: &Shared) {
    if stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)).is_err() {
        return;
    }
    let (mut reader, mut sequence) = (FrameReader::new(), 0_u16);
    let (mut position, mut velocity, mut force, mut silent) = (0.0, 0.0, 0.0, 0);
    while !shared.stop.load(Ordering::Relaxed) && !shared.unplugged.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_secs_f64(PERIOD_SECS));
        match stream.read(reader.room()) {
            Ok(0) => return,
            Ok(bytes) => reader.filled(bytes),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(_) => return,
        }
        silent += 1;
        while let Some(frame) = reader.next_force() {
            let size = frame.newtons().iter().map(|axis| axis * axis).sum::<f64>().sqrt();
            shared.force_max_mn.fetch_max((1e3 * size) as u32, Ordering::Relaxed);
            (force, silent) = (frame.newtons()[2], 0);
        }
        if silent > WATCHDOG {
            force = 0.0;
        }
        sequence = sequence.wrapping_add(1);
        // The arm approaches slowly, like a hand.
        let aim = AIM * (f64::from(sequence.min(1_000)) / 1_000.0);
        velocity += PERIOD_SECS / MASS * (STIFFNESS * (aim - position) - DAMPING * velocity + force);
        position += PERIOD_SECS * velocity;
        let position_um = [0, 0, (1e6 * position).round() as i32];
        let mut bytes = StateFrame { sequence, position_um, gripper_mrad: 0, buttons: 0 }.encode();
        if shared.garbled.load(Ordering::Relaxed) {
            bytes[usize::from(sequence) % bytes.len()] ^= u8::from(sequence % 3 == 0) << (sequence % 8);
            if stream.write_all(&[0xA5, b'S', 17, 0xFF]).is_err() {
                return;
            }
        }
        if stream.write_all(&bytes).is_err() {
            return;
        }
    }
}
