//! Bridge: a session on one side, Zenoh on the other, on a thread of its own.
//!
//! It reads snapshots as a guest and tells what is due; nothing waits for it. Commands of hands go to their doors as they
//! arrive, on the library's threads; batches and questions wait in a bounded inbox for this one.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use ring::rand::{SecureRandom, SystemRandom};
use serde_json::{Value, json};
use trocar_kernel::Submitted;
use trocar_kernel::live::Guest;
use trocar_kernel::runtime::guarded;
use trocar_scene::SimTime;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

use super::inbox::{Arrival, Inbox};
use super::node::{LOOK_EVERY, NodeError, open, without_sources};
use super::roster::tokens_of;
use crate::claim::ClaimCode;
use crate::hand::{COMMAND_MAX, HandBoard};
use crate::keys::SessionKeys;
use crate::node_config::{MESSAGE_MAX, NodeKind};
use crate::remote_controller::{BATCH_MAX, RemoteController};
use crate::rights::Rights;
use crate::settings::NodeSettings;
use crate::telemetry::{Telemetry, roster};

/// Longest wait between two looks at the scene.
const TICK: Duration = Duration::from_micros(16_667);
/// From one word on claims to the next.
const STATUS_EVERY: Duration = Duration::from_millis(100);
/// How long it is looked whether a name is free.
const NAME_WITHIN: Duration = Duration::from_millis(500);
/// The bridge is given up after this many panics.
const LIVES_MAX: u32 = 5;
/// Longest wait for the thread to end.
const END_MAX: Duration = Duration::from_millis(1_500);

/// What a session says of itself.
#[derive(Clone, Debug)]
pub struct SessionFacts {
    /// Its name among others.
    pub name: String,
    /// Its scenario.
    pub scenario: String,
    /// Whether others may join it.
    pub is_hosted: bool,
    /// The number of a station that has joined it: it tells that it is there, and the host tells the rest.
    pub station: Option<u16>,
}

/// How a session is reached.
pub struct SessionGuests {
    /// Reads for telemetry.
    pub reader: Guest,
    /// Controllers elsewhere, each with its own place among the writers, which gets answers.
    pub controllers: Vec<(RemoteController, Guest)>,
}

/// What a bridge has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BridgeCounts {
    /// Messages that were told.
    pub told: u64,
    /// Messages that the library refused.
    pub failed: u64,
    /// Questions and batches that found no room.
    pub refused: u64,
    /// Commands of hands that were refused.
    pub commands_refused: u64,
    /// Panics that it survived.
    pub restarts: u64,
}

#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    health: Mutex<Vec<(String, String)>>,
    inbox: Inbox,
    told: AtomicU64,
    failed: AtomicU64,
    commands_refused: AtomicU64,
    restarts: AtomicU64,
}

/// A session on Zenoh, until it is dropped.
pub struct Bridge {
    shared: Arc<Shared>,
    guests: SyncSender<SessionGuests>,
    thread: Option<JoinHandle<()>>,
}

impl Bridge {
    /// Opens the node of a session that does not run yet, or of a station, which is there at once. May be called from an
    /// actor, and takes up to seconds.
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn open(
        settings: &NodeSettings,
        rights: &Rights,
        facts: &SessionFacts,
        board: &HandBoard,
    ) -> Result<Self, NodeError> {
        let system = |error: &dyn std::fmt::Display| NodeError::System(error.to_string());
        let (settings, rights, facts, board) =
            (settings.clone(), rights.clone(), facts.clone(), board.clone());
        let shared = Arc::<Shared>::default();
        let (opened, is_open) = sync_channel(1);
        let (guests, given) = sync_channel(1);
        let of_thread = shared.clone();
        let run = move || {
            let node = Node::open(settings, rights, facts, board, of_thread);
            let (node, told) = match node {
                Ok(node) => (Some(node), Ok(())),
                Err(error) => (None, Err(error)),
            };
            let _ = opened.send(told);
            if let Some(node) = node {
                node.run(&given);
            }
        };
        let thread =
            thread::Builder::new().name("zenoh".into()).spawn(run).map_err(|error| system(&error))?;
        is_open.recv().map_err(|_| system(&"its thread panicked"))??;
        Ok(Self { shared, guests, thread: Some(thread) })
    }

    /// The session runs now.
    pub fn start(&self, guests: SessionGuests) {
        // Full only if it was started before.
        let _ = self.guests.try_send(guests);
    }

    /// How the actors of the session do.
    pub fn tell_health(&self, health: Vec<(String, String)>) {
        *self.shared.health.lock().unwrap_or_else(PoisonError::into_inner) = health;
    }

    /// Counts.
    pub fn counts(&self) -> BridgeCounts {
        let of = |count: &AtomicU64| count.load(Ordering::Relaxed);
        BridgeCounts {
            told: of(&self.shared.told),
            failed: of(&self.shared.failed),
            refused: self.shared.inbox.refused(),
            commands_refused: of(&self.shared.commands_refused),
            restarts: of(&self.shared.restarts),
        }
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else { return };
        let until = Instant::now() + END_MAX;
        while !thread.is_finished() && Instant::now() < until {
            thread::sleep(Duration::from_millis(5));
        }
        if thread.is_finished() {
            let _ = thread.join();
        }
    }
}

/// The node, on its thread.
struct Node {
    session: Session,
    rights: Rights,
    is_protected: bool,
    facts: SessionFacts,
    keys: SessionKeys,
    board: HandBoard,
    shared: Arc<Shared>,
    begun: Instant,
    /// That of a station.
    _own_token: Option<LivelinessToken>,
}

/// What is declared while a session runs.
struct Declared {
    _alive: LivelinessToken,
    _asked: Vec<Queryable<()>>,
    _heard: Vec<Subscriber<()>>,
}

impl Node {
    fn open(
        settings: NodeSettings,
        rights: Rights,
        facts: SessionFacts,
        board: HandBoard,
        shared: Arc<Shared>,
    ) -> Result<Self, NodeError> {
        let keys = SessionKeys::new(&facts.name);
        let session = open(&settings, &rights, NodeKind::Session(&keys))?;
        let mut own_token = None;
        if let Some(number) = facts.station {
            let token = session.liveliness().declare_token(keys.station(number)).wait();
            own_token = Some(token.map_err(|error| NodeError::System(without_sources(&error.to_string())))?);
        } else if !tokens_of(&session, &keys.alive(), NAME_WITHIN).is_empty() {
            return Err(NodeError::NameTaken(facts.name));
        }
        let is_protected = settings.is_protected();
        let begun = Instant::now();
        Ok(Self { session, rights, is_protected, facts, keys, board, shared, begun, _own_token: own_token })
    }

    fn is_over(&self) -> bool {
        self.shared.stop.load(Ordering::Relaxed)
    }

    /// Time for claims and cadences.
    fn now(&self) -> SimTime {
        SimTime(u64::try_from(self.begun.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    fn run(self, given: &Receiver<SessionGuests>) {
        let mut guests = loop {
            match given.recv_timeout(LOOK_EVERY) {
                Ok(guests) => break guests,
                Err(RecvTimeoutError::Timeout) if !self.is_over() => {}
                Err(_) => return self.close(),
            }
        };
        // The guests outlive a panic: the session goes on, and so does what is told of it.
        for life in 1..=LIVES_MAX {
            match guarded(|| self.serve(&mut guests)) {
                Ok(Ok(())) => break,
                Ok(Err(error)) => {
                    tracing::error!("Zenoh: {error}");
                    break;
                }
                Err(panic) => {
                    self.shared.restarts.fetch_add(1, Ordering::Relaxed);
                    tracing::error!("Zenoh: {panic}{}", if life == LIVES_MAX { "; given up" } else { "" });
                }
            }
        }
        self.close();
    }

    fn close(&self) {
        let _ = self.session.close().wait();
    }

    /// Serves a session until it ends.
    fn serve(&self, guests: &mut SessionGuests) -> Result<(), String> {
        let _declared = self.declare(guests)?;
        let reads: Vec<String> =
            guests.controllers.iter().flat_map(|(controller, _)| controller.right().reads.clone()).collect();
        let scene = guests.reader.snapshot();
        let mut telemetry =
            Telemetry::new(self.keys.clone(), scene.registry(), reads.iter().map(String::as_str))?;
        drop(scene);
        let mut status_at = Instant::now();
        while !self.is_over() && !guests.reader.has_ended() {
            let due = guests.controllers.iter().filter_map(|(controller, _)| controller.due()).min();
            let wait = due.map_or(TICK, |due| due.since(self.now()).to_duration().min(TICK));
            for arrival in self.shared.inbox.take(wait) {
                self.arrived(arrival, guests);
            }
            let now = self.now();
            for (controller, guest) in &mut guests.controllers {
                settle(controller, guest, now);
            }
            let scene = guests.reader.snapshot();
            let health = self.shared.health.lock().unwrap_or_else(PoisonError::into_inner).clone();
            telemetry.tell(&scene, now, &health, &mut |key, value| self.put(key, value));
            for hand in self.board.names() {
                let answer = self.board.with(&hand, |lane| lane.is_held().then(|| lane.answer()).flatten());
                if let Some(answer) = answer.flatten() {
                    self.put(&self.keys.hand(&hand, "answer"), &answer);
                }
            }
            if status_at.elapsed() >= STATUS_EVERY {
                status_at = Instant::now();
                for (controller, _) in &guests.controllers {
                    self.put(&self.keys.controller(&controller.right().name, "status"), &controller.status());
                }
            }
        }
        Ok(())
    }

    fn declare(&self, guests: &SessionGuests) -> Result<Declared, String> {
        let mut asked = Vec::new();
        let mut heard = Vec::new();
        let text = |error: zenoh::Error| without_sources(&error.to_string());
        let shared = || self.shared.clone();
        let mut ask = |key: String, arrival: Box<dyn Fn(Query) -> Arrival + Send + Sync>| {
            let shared = shared();
            let told = move |query: Query| shared.inbox.put(arrival(query));
            asked.push(self.session.declare_queryable(key).callback(told).wait().map_err(text)?);
            Ok::<(), String>(())
        };
        ask(self.keys.info(), Box::new(Arrival::Info))?;
        ask(self.keys.roster(), Box::new(Arrival::Roster))?;
        for hand in self.board.names() {
            let name = hand.clone();
            ask(
                self.keys.hand(&hand, "claim"),
                Box::new(move |query| Arrival::HandClaim(name.clone(), query)),
            )?;
            let (board, shared, begun) = (self.board.clone(), shared(), self.begun);
            let key = self.keys.hand(&hand, "command");
            let told = move |sample: zenoh::sample::Sample| {
                let payload = sample.payload();
                let now = SimTime(u64::try_from(begun.elapsed().as_nanos()).unwrap_or(u64::MAX));
                let taken = payload.len() <= COMMAND_MAX
                    && board.with(&hand, |lane| lane.command(now, &payload.to_bytes()).is_ok()) == Some(true);
                shared.commands_refused.fetch_add(u64::from(!taken), Ordering::Relaxed);
            };
            heard.push(self.session.declare_subscriber(key).callback(told).wait().map_err(text)?);
        }
        for (index, (controller, _)) in guests.controllers.iter().enumerate() {
            let name = &controller.right().name;
            let claim = self.keys.controller(name, "claim");
            ask(claim, Box::new(move |query| Arrival::ControllerClaim(index, query)))?;
            let shared = shared();
            let told = move |sample: zenoh::sample::Sample| {
                // One that is too long is refused by what reads it, and needs no room here.
                let payload = sample.payload();
                let kept =
                    if payload.len() > BATCH_MAX { Vec::new() } else { payload.to_bytes().into_owned() };
                shared.inbox.put(Arrival::Batch(index, kept));
            };
            let key = self.keys.controller(name, "batch");
            heard.push(self.session.declare_subscriber(key).callback(told).wait().map_err(text)?);
        }
        let alive = self.session.liveliness().declare_token(self.keys.alive()).wait().map_err(text)?;
        Ok(Declared { _alive: alive, _asked: asked, _heard: heard })
    }

    fn arrived(&self, arrival: Arrival, guests: &mut SessionGuests) {
        match arrival {
            Arrival::Info(query) => self.answer(&query, &self.keys.info(), Ok(self.info(guests))),
            Arrival::Roster(query) => {
                self.answer(&query, &self.keys.roster(), Ok(roster(&guests.reader.snapshot())));
            }
            Arrival::HandClaim(hand, query) => {
                let claimed = self.code().and_then(|code| {
                    let claim = self.board.with(&hand, |lane| lane.claim(self.now(), code));
                    let epoch = claim.ok_or("the hand is gone")?.map_err(|refusal| refusal.to_string())?;
                    Ok(json!({ "claim": code.to_string(), "epoch": epoch }))
                });
                self.answer(&query, &self.keys.hand(&hand, "claim"), claimed);
            }
            Arrival::ControllerClaim(index, query) => {
                let now = self.now();
                let Some((controller, _)) = guests.controllers.get_mut(index) else { return };
                let silence_secs = controller.right().silence_secs;
                let claimed = self.code().and_then(|code| {
                    let epoch = controller.claim(now, code)?;
                    Ok(json!({ "claim": code.to_string(), "epoch": epoch, "silence_secs": silence_secs }))
                });
                let key = self.keys.controller(&controller.right().name, "claim");
                self.answer(&query, &key, claimed);
            }
            Arrival::Batch(index, payload) => {
                let now = self.now();
                if let Some((controller, guest)) = guests.controllers.get_mut(index) {
                    submit(controller, guest, now, &payload);
                }
            }
        }
    }

    /// A number that nobody guesses.
    fn code(&self) -> Result<ClaimCode, String> {
        let mut bytes = [0; 8];
        SystemRandom::new().fill(&mut bytes).map_err(|_| "the system has no randomness".to_owned())?;
        Ok(ClaimCode(u64::from_le_bytes(bytes)))
    }

    fn answer(&self, query: &Query, key: &str, answer: Result<Value, String>) {
        let sent = match answer {
            Ok(value) => {
                let reply = query.reply(key, value.to_string());
                reply.encoding(Encoding::APPLICATION_JSON).wait()
            }
            Err(reason) => query.reply_err(json!({ "error": reason }).to_string()).wait(),
        };
        self.shared.failed.fetch_add(u64::from(sent.is_err()), Ordering::Relaxed);
    }

    fn info(&self, guests: &SessionGuests) -> Value {
        json!({
            "name": self.facts.name,
            "scenario": self.facts.scenario,
            "hosted": self.facts.is_hosted,
            "protected": self.is_protected,
            "hands": self.board.names(),
            "controllers": guests.controllers.iter().map(|(one, _)| &one.right().name).collect::<Vec<_>>(),
            "readers": if self.rights.tls.is_some() { Some(&self.rights.readers) } else { None },
            "time_secs": guests.reader.now().as_secs_f64(),
            "version": env!("CARGO_PKG_VERSION"),
        })
    }

    fn put(&self, key: &str, value: &Value) {
        let payload = value.to_string();
        let told = payload.len() <= MESSAGE_MAX
            && self
                .session
                .put(key, payload)
                .encoding(Encoding::APPLICATION_JSON)
                .congestion_control(CongestionControl::Drop)
                .wait()
                .is_ok();
        let count = if told { &self.shared.told } else { &self.shared.failed };
        count.fetch_add(1, Ordering::Relaxed);
    }
}

/// A batch of a controller elsewhere, to the Model.
fn submit(controller: &mut RemoteController, guest: &mut Guest, now: SimTime, payload: &[u8]) {
    let scene_time = guest.snapshot().time();
    let Ok(batch) = controller.admit(now, scene_time, payload) else { return };
    let mut read = Ok(());
    let sent = guest.write(|scene, out| {
        read = batch.write(scene, out);
        if read.is_err() {
            // All of it or nothing.
            out.clear();
        }
    });
    match (read, sent) {
        (Err(reason), _) => controller.judged(Err(&reason)),
        (_, Err(error)) => controller.judged(Err(&error.to_string())),
        (_, Ok(Submitted::Dropped)) => {
            controller.judged(Err("the Model has not taken the batches before it"))
        }
        // The Model's answer follows; nothing is asked of it by an empty one.
        (_, Ok(Submitted::Sent | Submitted::Empty)) => {}
    }
}

/// What the Model said of a controller's batches, and its silence.
fn settle(controller: &mut RemoteController, guest: &mut Guest, now: SimTime) {
    while let Some(answer) = guest.answer() {
        match answer {
            Ok(_) => controller.judged(Ok(())),
            Err(error) => controller.judged(Err(&error.to_string())),
        }
    }
    if controller.watch(now) {
        tracing::warn!(
            "Zenoh: controller '{}' has fallen silent; its commands stop",
            controller.right().name
        );
        let mut rests = Ok(());
        let sent = guest.write(|scene, out| rests = controller.rest(scene, out));
        if let Err(reason) = rests.and(sent.map(drop).map_err(|error| error.to_string())) {
            controller.judged(Err(&reason));
        }
    }
}
