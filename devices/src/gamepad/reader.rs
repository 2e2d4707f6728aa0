//! Gamepad reader: a thread of ordinary priority that finds gamepads, reads their events and passes states through a
//! bounded queue.

use std::fs::File;
use std::io::{PipeWriter, Read};
use std::os::fd::AsFd;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::Instant;

use thiserror::Error;

use super::decoder::{GamepadDecoder, INPUT_EVENT_BYTES};
use super::evdev::wait;
use super::{GamepadState, InputFolder};

/// Period of the scan for newly plugged pads \[ns\].
pub const RESCAN_NS: u64 = 2_000_000_000;
/// Capacity of the state queue; when it is full, only the newest further state is kept.
const LANE: usize = 256;
/// Most pads at once.
const PADS_MAX: usize = 8;
/// Delay before a state refused by a full queue is offered again \[ns\].
const OFFER_AGAIN_NS: u64 = 20_000_000;
/// Bytes that are read at once.
const READ_BYTES: usize = 64 * INPUT_EVENT_BYTES;

/// A gamepad that can be read.
#[derive(Debug)]
pub struct PluggedGamepad {
    /// Its id at its source.
    pub id: String,
    /// The name that it reports.
    pub name: String,
    /// File that yields `struct input_event`s.
    pub file: File,
    /// Decodes the events and holds the pad's state.
    pub decoder: GamepadDecoder,
}

/// Source of gamepads: the system's device folder, or a test double.
pub trait GamepadSource: Send + 'static {
    /// The available pads that are not in `open`.
    fn scan(&mut self, open: &[&str]) -> Vec<PluggedGamepad>;
}

/// Why pads cannot be read.
#[derive(Debug, Error)]
#[error("the reader of gamepads cannot be started: {0}")]
pub struct GamepadReaderError(#[from] std::io::Error);

/// Reads every gamepad of this machine, also those that are plugged in later.
#[derive(Debug)]
pub struct GamepadReader {
    states: Receiver<Option<GamepadState>>,
    /// Closing it wakes the thread up and ends it.
    stop: Option<PipeWriter>,
    thread: Option<JoinHandle<()>>,
}

impl GamepadReader {
    /// Starts reading the system's event devices.
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn start() -> Result<Self, GamepadReaderError> {
        Self::start_on(InputFolder::default(), RESCAN_NS)
    }

    /// Starts reading the pads of another source, scanned for new pads with the period `rescan_ns` \[ns\].
    ///
    /// # Errors
    /// When the system starts no thread.
    pub fn start_on(source: impl GamepadSource, rescan_ns: u64) -> Result<Self, GamepadReaderError> {
        let (sender, states) = sync_channel(LANE);
        let (stopped, stop) = std::io::pipe()?;
        let mut work = Work {
            source: Box::new(source),
            pads: Vec::new(),
            sender,
            unsent: None,
            in_use: None,
            buffer: Box::new([0; READ_BYTES]),
        };
        let thread = std::thread::Builder::new()
            .name("gamepads".to_owned())
            .spawn(move || work.run(&stopped, rescan_ns.max(1)))?;
        Ok(Self { states, stop: Some(stop), thread: Some(thread) })
    }

    /// The next state of the active pad (the one with the latest event), in order, without blocking. `Some(None)`: it
    /// was unplugged.
    pub fn next(&self) -> Option<Option<GamepadState>> {
        self.states.try_recv().ok()
    }

    /// As [`GamepadReader::next`], but waits at most `at_most`.
    pub fn wait(&self, at_most: std::time::Duration) -> Option<Option<GamepadState>> {
        self.states.recv_timeout(at_most).ok()
    }
}

impl Drop for GamepadReader {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has already been reported.
            let _ = thread.join();
        }
    }
}

/// State of the reader thread.
struct Work {
    source: Box<dyn GamepadSource>,
    pads: Vec<PluggedGamepad>,
    sender: SyncSender<Option<GamepadState>>,
    /// The newest state, if the queue was full.
    unsent: Option<Option<GamepadState>>,
    /// The pad with the latest event.
    in_use: Option<String>,
    buffer: Box<[u8; READ_BYTES]>,
}

impl Work {
    fn run(&mut self, stopped: &impl AsFd, rescan_ns: u64) {
        let started = Instant::now();
        let now_ns = || u64::try_from(started.elapsed().as_nanos()).unwrap_or(u64::MAX);
        let mut scan_at = 0;
        loop {
            if now_ns() >= scan_at {
                self.scan();
                scan_at = now_ns().saturating_add(rescan_ns);
            }
            let until_scan = scan_at.saturating_sub(now_ns());
            let timeout = if self.unsent.is_some() { until_scan.min(OFFER_AGAIN_NS) } else { until_scan };
            let mut files = vec![stopped.as_fd()];
            files.extend(self.pads.iter().map(|pad| pad.file.as_fd()));
            let Ok(ready) = wait(&files, timeout) else { return };
            if ready[0] {
                return;
            }
            self.offer();
            // From the end, so that earlier indices stay valid.
            for index in (0..self.pads.len()).rev().filter(|index| ready[index + 1]) {
                self.read(index);
            }
        }
    }

    fn scan(&mut self) {
        let open: Vec<&str> = self.pads.iter().map(|pad| pad.id.as_str()).collect();
        let found = self.source.scan(&open);
        for pad in found.into_iter().take(PADS_MAX - self.pads.len().min(PADS_MAX)) {
            let state = pad.decoder.state();
            self.in_use = Some(pad.id.clone());
            self.pads.push(pad);
            self.send(Some(state));
        }
    }

    fn read(&mut self, index: usize) {
        let pad = &mut self.pads[index];
        match pad.file.read(&mut self.buffer[..]) {
            Ok(length) if length > 0 => {
                self.in_use = Some(pad.id.clone());
                let mut said = Vec::new();
                pad.decoder.feed(&self.buffer[..length], |state| said.push(state));
                said.into_iter().for_each(|state| self.send(Some(state)));
            }
            Err(error)
                if matches!(
                    error.kind(),
                    std::io::ErrorKind::WouldBlock | std::io::ErrorKind::Interrupted
                ) => {}
            // End of file or an error: the pad was unplugged.
            _ => {
                let gone = self.pads.remove(index).id;
                if self.in_use.as_ref() == Some(&gone) {
                    self.in_use = None;
                    self.send(None);
                }
            }
        }
    }

    fn send(&mut self, state: Option<GamepadState>) {
        self.unsent = Some(state);
        self.offer();
    }

    /// Offers the newest state when the queue was full, so that no released button stays pressed.
    fn offer(&mut self) {
        if let Some(state) = self.unsent.take()
            && let Err(TrySendError::Full(state)) = self.sender.try_send(state)
        {
            self.unsent = Some(state);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gamepad::{AbsRange, GamepadButton};
    use std::io::Write;
    use std::os::fd::OwnedFd;
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    /// Test double: pads whose events a test writes into pipes.
    #[derive(Clone, Default)]
    struct Double(Arc<Mutex<Vec<PluggedGamepad>>>);
    impl GamepadSource for Double {
        fn scan(&mut self, _: &[&str]) -> Vec<PluggedGamepad> {
            self.0.lock().expect("not poisoned").drain(..).collect()
        }
    }
    impl Double {
        fn plug(&self, id: &str) -> PipeWriter {
            let (reader, writer) = std::io::pipe().expect("a pipe");
            let axes = [0, 1].map(|code| AbsRange { code, min: -100, max: 100, ..AbsRange::default() });
            let pad = PluggedGamepad {
                id: id.to_owned(),
                name: id.to_owned(),
                file: File::from(OwnedFd::from(reader)),
                decoder: GamepadDecoder::new(&axes, &[]),
            };
            self.0.lock().expect("not poisoned").push(pad);
            writer
        }
    }
    fn event(kind: u16, code: u16, value: i32) -> Vec<u8> {
        let mut bytes = vec![0; INPUT_EVENT_BYTES - 8];
        bytes.extend(kind.to_ne_bytes().into_iter().chain(code.to_ne_bytes()).chain(value.to_ne_bytes()));
        bytes
    }
    fn press(down: bool) -> Vec<u8> {
        [event(1, 0x130, i32::from(down)), event(0, 0, 0)].concat()
    }
    fn next(reader: &GamepadReader) -> Option<GamepadState> {
        reader.wait(Duration::from_secs(60)).expect("something is said")
    }

    #[test]
    fn a_pad_is_read_unplugged_and_another_one_found_later() {
        let double = Double::default();
        let mut first = double.plug("event3");
        let reader = GamepadReader::start_on(double.clone(), 5_000_000).expect("starts");
        assert_eq!(next(&reader), Some(GamepadState::default()));
        // A press shorter than a display frame is not lost.
        first.write_all(&[press(true), press(false)].concat()).expect("written");
        assert!(next(&reader).expect("a pad").is_pressed(GamepadButton::South));
        assert_eq!(next(&reader), Some(GamepadState::default()));
        first.write_all(&[event(3, 0, 100), event(0, 0, 0)].concat()).expect("written");
        assert_eq!(next(&reader).expect("a pad").left_stick, [1.0, 0.0]);
        drop(first);
        assert_eq!(next(&reader), None, "unplugged");
        let mut second = double.plug("event4");
        assert_eq!(next(&reader), Some(GamepadState::default()));
        second.write_all(&press(true)).expect("written");
        assert!(next(&reader).expect("a pad").is_pressed(GamepadButton::South));
    }

    #[test]
    fn a_lane_that_nobody_empties_is_bounded_and_ends_with_the_newest_state() {
        let double = Double::default();
        let mut pad = double.plug("event0");
        let reader = GamepadReader::start_on(double, 5_000_000).expect("starts");
        for _ in 0..LANE {
            pad.write_all(&[press(true), press(false)].concat()).expect("written");
        }
        pad.write_all(&[event(1, 0x131, 1), event(0, 0, 0)].concat()).expect("written");
        let mut taken = 0;
        loop {
            let state = next(&reader).expect("a pad");
            taken += 1;
            if state.is_pressed(GamepadButton::East) {
                break;
            }
        }
        assert!(taken <= 2 * LANE + 2, "{taken}");
    }

    #[test]
    fn a_machine_without_pads_says_nothing_and_the_reader_ends_at_once() {
        let reader = GamepadReader::start_on(Double::default(), RESCAN_NS).expect("starts");
        assert_eq!(reader.next(), None);
    }
}
