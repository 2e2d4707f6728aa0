//! The asker's end of a diagnosis: it asks over the control channel, sends datagrams of two lengths, and counts what comes
//! back.

use trocar_scene::SimTime;

use crate::control::{
    ClientMessage, Credential, Diagnose, Diagnosed, EchoCounts, FrameDecoder, Goodbye, HostMessage,
    OPENING_MAX, Outbox, PlainText, Refusal, after_preamble,
};
use crate::datagram::{DATAGRAM_MAX, HEADER_BYTES, Kind, Opener, PAYLOAD_MAX, Sealer, Side, TAG_BYTES};
use crate::streams::{StationStream, StreamState};

/// Datagrams of each length.
pub const ECHOES: usize = 24;
/// Time between two datagrams.
pub const ECHO_EVERY: SimTime = SimTime::from_millis(10);
/// Time from the host's answer to the first datagram: its hands link hears of the diagnosis within an idle tick.
pub const FIRST_AFTER: SimTime = SimTime::from_millis(60);
/// Longest wait for what is under way, after the last datagram.
pub const WAIT_MAX: SimTime = SimTime::from_millis(2_000);
/// Longest time to a stream and its answer; the stream itself gives up before.
const ANSWER_TIME_MAX: SimTime = SimTime::from_millis(10_000);
/// Bytes of the payload of a short datagram.
const SHORT_PAYLOAD: usize = 24;
/// Bytes of a short datagram.
pub const SHORT_BYTES: usize = HEADER_BYTES + SHORT_PAYLOAD + TAG_BYTES;
/// Bytes of a long one: the longest that there is.
pub const LONG_BYTES: usize = DATAGRAM_MAX;
/// Bytes taken from the stream at a step.
const TAKEN_MAX: usize = 16 << 10;

/// What has become of the datagrams of one length.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Echoed {
    /// Those that the system took.
    pub sent: u32,
    /// Those that reached the host, as it says.
    pub there: u32,
    /// Those that came back.
    pub back: u32,
    /// Shortest round trip.
    pub shortest: Option<SimTime>,
    /// Longest round trip.
    pub longest: Option<SimTime>,
}

/// What an examination has found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Examined {
    /// What the host says of the ticket, and of the time.
    pub answer: Option<Result<Diagnosed, Refusal>>,
    /// Short datagrams.
    pub short: Echoed,
    /// Datagrams of [`LONG_BYTES`].
    pub long: Echoed,
    /// Why the control channel ended before its time.
    pub error: Option<String>,
}

/// Asks a host for a diagnosis. `A` is an address of datagrams.
pub struct Examination<A> {
    stream: Box<dyn StationStream<A>>,
    decoder: FrameDecoder,
    outbox: Outbox,
    ask: Option<Diagnose>,
    ends: Option<(Sealer, Opener)>,
    sent_at: [Option<SimTime>; 2 * ECHOES],
    is_back: [bool; 2 * ECHOES],
    next: usize,
    next_at: SimTime,
    until: SimTime,
    found: Examined,
    is_over: bool,
    received: Vec<u8>,
    out: [u8; DATAGRAM_MAX],
}

impl<A: Copy + PartialEq + 'static> Examination<A> {
    /// Begins to connect. The credential's token is not spent.
    pub fn begin(
        mut stream: Box<dyn StationStream<A>>,
        program: &str,
        credential: Credential,
        now: SimTime,
    ) -> Self {
        stream.connect(now);
        Self {
            stream,
            decoder: FrameDecoder::new(OPENING_MAX),
            outbox: Outbox::default(),
            ask: Some(Diagnose { program: PlainText::new(program), credential }),
            ends: None,
            sent_at: [None; 2 * ECHOES],
            is_back: [false; 2 * ECHOES],
            next: 0,
            next_at: now,
            until: now + ANSWER_TIME_MAX,
            found: Examined::default(),
            is_over: false,
            received: Vec::new(),
            out: [0; DATAGRAM_MAX],
        }
    }

    /// Whether there is nothing more to find.
    pub fn is_over(&self) -> bool {
        self.is_over
    }

    /// What was found so far.
    pub fn found(&self) -> &Examined {
        &self.found
    }

    /// Share of the datagrams that were sent.
    pub fn progress(&self) -> f64 {
        self.next as f64 / self.sent_at.len() as f64
    }

    /// Goes on; to be called every few milliseconds. `send` says whether the system took a datagram.
    pub fn step(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        if self.is_over {
            return;
        }
        match self.stream.work(now) {
            StreamState::None | StreamState::Connecting => {}
            StreamState::Closed(why) => return self.end(Some(why), now),
            StreamState::Open => {
                if let Some(ask) = self.ask.take() {
                    // An opening is far shorter than what an outbox takes.
                    let _ = self.outbox.push(&ClientMessage::Diagnose(Box::new(ask)), true, now);
                }
                let exchanged = self.exchange(now);
                if self.is_over {
                    return self.stream.close();
                }
                if let Err(why) = exchanged {
                    return self.end(Some(why), now);
                }
            }
        }
        self.send_due(now, send);
        if now >= self.until {
            let why = self.ends.is_none().then(|| "the host gave no answer in time".to_owned());
            self.end(why, now);
        } else if self.is_all_back() {
            self.end(None, now);
        }
    }

    /// A datagram came. It is decrypted in place.
    pub fn receive(&mut self, now: SimTime, datagram: &mut [u8]) {
        let Some((_, opener)) = self.ends.as_mut() else { return };
        let Ok((header, payload)) = opener.open(now, datagram) else { return };
        let number = payload.first().map(|number| usize::from(*number));
        let Some(number) = number.filter(|number| *number < self.next && header.kind == Kind::Echo) else {
            return;
        };
        let Some(sent_at) = self.sent_at[number] else { return };
        if std::mem::replace(&mut self.is_back[number], true) {
            return;
        }
        let round_trip = now.since(sent_at);
        let echoed = if is_long(number) { &mut self.found.long } else { &mut self.found.short };
        echoed.back += 1;
        echoed.shortest = Some(echoed.shortest.map_or(round_trip, |shortest| shortest.min(round_trip)));
        echoed.longest = Some(echoed.longest.map_or(round_trip, |longest| longest.max(round_trip)));
    }

    fn is_all_back(&self) -> bool {
        self.next == self.sent_at.len() && self.is_back.iter().all(|is_back| *is_back)
    }

    /// Takes what the host says, and gives it what waits.
    fn exchange(&mut self, now: SimTime) -> Result<(), String> {
        self.received.clear();
        let received = self.stream.receive(now, TAKEN_MAX, &mut self.received);
        let bytes = std::mem::take(&mut self.received);
        let heard = self.hear(&bytes, now);
        self.received = bytes;
        heard?;
        received.map_err(|closed| closed.0)?;
        if !self.outbox.is_empty() {
            let sent = self.stream.send(now, self.outbox.waiting()).map_err(|closed| closed.0)?;
            self.outbox.advance(sent, now);
        }
        Ok(())
    }

    fn hear(&mut self, mut bytes: &[u8], now: SimTime) -> Result<(), String> {
        while !self.is_over {
            let Some(frame) = self.decoder.next_frame(&mut bytes).map_err(|error| error.to_string())? else {
                break;
            };
            let is_answer = self.found.answer.is_none();
            let frame =
                if is_answer { after_preamble(frame).map_err(|error| error.to_string())? } else { frame };
            match HostMessage::decode(frame).map_err(|error| error.to_string())? {
                HostMessage::Diagnosed(diagnosed) if is_answer => {
                    self.found.answer = Some(Ok(diagnosed));
                    let keys = self.stream.keys(diagnosed.connection, 0).ok_or("no keys for datagrams")?;
                    let (send, receive) = keys.split(Side::Client);
                    self.ends = Some((Sealer::new(send), Opener::new(receive, SimTime::ZERO)));
                    self.next_at = now + FIRST_AFTER;
                    self.until = self.next_at + SimTime(ECHO_EVERY.0 * self.sent_at.len() as u64) + WAIT_MAX;
                }
                HostMessage::Refused(refusal) if is_answer => {
                    self.found.answer = Some(Err(refusal));
                    self.is_over = true;
                }
                HostMessage::Echoed(EchoCounts { short, long }) if !is_answer => {
                    (self.found.short.there, self.found.long.there) = (short, long);
                }
                HostMessage::Goodbye(goodbye) => return Err(goodbye.to_string()),
                other => return Err(format!("the host said '{}', which has no place there", other.name())),
            }
        }
        Ok(())
    }

    /// Sends the datagram that is due: a short one and a long one in turn.
    fn send_due(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool) {
        let (Some((sealer, _)), Some(to)) = (&mut self.ends, self.stream.peer()) else { return };
        if self.next >= self.sent_at.len() || now < self.next_at {
            return;
        }
        let mut payload = [0; PAYLOAD_MAX];
        // There are fewer than 256.
        payload[0] = self.next as u8;
        let bytes = if is_long(self.next) { PAYLOAD_MAX } else { SHORT_PAYLOAD };
        let sealed = sealer.seal(Kind::Echo, 0, now, &payload[..bytes], &mut self.out);
        if sealed.is_ok_and(|length| send(to, &self.out[..length])) {
            self.sent_at[self.next] = Some(now);
            let echoed = if is_long(self.next) { &mut self.found.long } else { &mut self.found.short };
            echoed.sent += 1;
        }
        self.next += 1;
        self.next_at = now + ECHO_EVERY;
    }

    fn end(&mut self, error: Option<String>, now: SimTime) {
        self.is_over = true;
        // What came back has been there, whether the host could still say so or not.
        for echoed in [&mut self.found.short, &mut self.found.long] {
            echoed.there = echoed.there.max(echoed.back);
        }
        self.found.error = error;
        let mut goodbye = Outbox::default();
        let pushed = goodbye.push(&ClientMessage::Goodbye(Goodbye::Leaves), false, now);
        if self.ends.is_some() && pushed.is_ok() {
            // A host that does not hear it sees the stream close.
            let _ = self.stream.send(now, goodbye.waiting());
        }
        self.stream.close();
    }
}

fn is_long(number: usize) -> bool {
    number % 2 == 1
}
