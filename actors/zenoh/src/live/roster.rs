//! Which sessions there are, who takes part in them, and who is alive.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::Value;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

use super::node::{NodeError, on_own_thread, open, without_sources};
use crate::keys::{ALL_INFOS, ALL_ROSTERS, ALL_SESSIONS, ALL_STATIONS, of_token};
use crate::node_config::NodeKind;
use crate::presence::{Change, Presence};
use crate::rights::Rights;
use crate::settings::NodeSettings;

/// Longest wait for answers.
const ANSWERS: Duration = Duration::from_millis(1_000);
/// From one question for all tokens to the next: what a subscription missed is found with the second answer.
const ASK_EVERY: Duration = Duration::from_millis(300);
/// Longest wait for tokens then.
const TOKENS_WITHIN: Duration = Duration::from_millis(250);
/// Most answers that are looked at.
const ANSWERS_MAX: usize = 4_096;
/// Most changes that wait to be taken.
const CHANGES_MAX: usize = 1_024;

/// A session that was found.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SeenSession {
    /// Its name.
    pub name: String,
    /// Whether its token is there.
    pub alive: bool,
    /// What it says of itself.
    pub info: Value,
    /// Its stations.
    pub roster: Value,
    /// Numbers of the stations whose tokens are there.
    pub stations_alive: Vec<u16>,
}

/// Whoever looks on calls where a session would listen, if nothing else is said.
fn calling(settings: &NodeSettings) -> NodeSettings {
    let mut settings = settings.clone();
    let listen = std::mem::take(&mut settings.listen);
    if settings.connect.is_empty() {
        settings.connect = listen;
    }
    settings
}

/// Looks once.
///
/// # Errors
/// [`NodeError`], such as when nobody is where it calls.
pub fn list(settings: &NodeSettings, rights: &Rights) -> Result<Vec<SeenSession>, NodeError> {
    let (settings, rights) = (calling(settings), rights.clone());
    on_own_thread(move || {
        let session = open(&settings, &rights, NodeKind::Client)?;
        let mut found: BTreeMap<String, SeenSession> = BTreeMap::new();
        for token in tokens(&session, ANSWERS) {
            let Some((name, station)) = of_token(&token) else { continue };
            let seen = found.entry(name.to_owned()).or_default();
            match station {
                Some(number) => seen.stations_alive.push(number),
                None => seen.alive = true,
            }
        }
        for (what, key) in [("info", ALL_INFOS), ("roster", ALL_ROSTERS)] {
            for (key, value) in ask(&session, key) {
                let Some(name) = key.split('/').nth(1) else { continue };
                let seen = found.entry(name.to_owned()).or_default();
                *(if what == "info" { &mut seen.info } else { &mut seen.roster }) = value;
            }
        }
        let _ = session.close().wait();
        Ok(found.into_iter().map(|(name, seen)| SeenSession { name, ..seen }).collect())
    })
}

/// JSON answers to a question.
fn ask(session: &Session, key: &str) -> Vec<(String, Value)> {
    let Ok(replies) = session.get(key).timeout(ANSWERS).wait() else { return Vec::new() };
    let mut answers = Vec::new();
    while let Ok(reply) = replies.recv() {
        if let Ok(sample) = reply.result()
            && answers.len() < ANSWERS_MAX
            && let Ok(value) = serde_json::from_slice(&sample.payload().to_bytes())
        {
            answers.push((sample.key_expr().as_str().to_owned(), value));
        }
    }
    answers
}

/// All tokens of sessions and stations.
pub(super) fn tokens(session: &Session, within: Duration) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for key in [ALL_SESSIONS, ALL_STATIONS] {
        found.extend(tokens_of(session, key, within));
    }
    found
}

/// Tokens that match a key.
pub(super) fn tokens_of(session: &Session, key: &str, within: Duration) -> BTreeSet<String> {
    let Ok(replies) = session.liveliness().get(key).timeout(within).wait() else { return BTreeSet::new() };
    let mut found = BTreeSet::new();
    while let Ok(reply) = replies.recv() {
        if let Ok(sample) = reply.result()
            && found.len() < ANSWERS_MAX
        {
            found.insert(sample.key_expr().as_str().to_owned());
        }
    }
    found
}

/// Looks on until it is dropped: who comes, and who goes.
pub struct Watch {
    changes: Receiver<Change>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// Begins to look.
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn open(settings: &NodeSettings, rights: &Rights) -> Result<Self, NodeError> {
        let (settings, rights) = (calling(settings), rights.clone());
        let session = on_own_thread(move || open(&settings, &rights, NodeKind::Client))?;
        let (changed, changes) = sync_channel(CHANGES_MAX);
        let stop = Arc::<AtomicBool>::default();
        let stopped = stop.clone();
        let run = move || watch(&session, &stopped, &changed);
        let thread = thread::Builder::new().name("zenoh watch".into()).spawn(run);
        let thread = thread.map_err(|error| NodeError::System(error.to_string()))?;
        Ok(Self { changes, stop, thread: Some(thread) })
    }

    /// The next change, within the time.
    pub fn next(&self, within: Duration) -> Option<Change> {
        self.changes.recv_timeout(within).ok()
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn watch(session: &Session, stop: &AtomicBool, changed: &SyncSender<Change>) {
    let mut presence = Presence::default();
    // A change that nobody takes is dropped; the next answer brings it again for who looks then.
    let tell = |change: Option<Change>| {
        if let Some(change) = change {
            let _ = changed.try_send(change);
        }
    };
    let (events, arrived) = sync_channel(CHANGES_MAX);
    let declare = |key: &'static str| {
        let events = events.clone();
        let told = move |sample: zenoh::sample::Sample| {
            // What finds no room is found by asking.
            let _ =
                events.try_send((sample.key_expr().as_str().to_owned(), sample.kind() == SampleKind::Put));
        };
        session.liveliness().declare_subscriber(key).history(true).callback(told).wait()
    };
    let subscriptions = [declare(ALL_SESSIONS), declare(ALL_STATIONS)];
    if let Some(error) = subscriptions.iter().find_map(|one| one.as_ref().err()) {
        let error = without_sources(&error.to_string());
        tracing::warn!("Zenoh: who comes and goes is found by asking only: {error}");
    }
    let mut next = Instant::now() + ASK_EVERY;
    while !stop.load(Ordering::Relaxed) {
        match arrived
            .recv_timeout(next.saturating_duration_since(Instant::now()).min(super::node::LOOK_EVERY))
        {
            Ok((key, came)) => {
                tell(if came { presence.came(&key) } else { presence.went(&key) });
                continue;
            }
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
        }
        if Instant::now() < next {
            continue;
        }
        // What arrives meanwhile is newer than the answer.
        let answer = tokens(session, TOKENS_WITHIN);
        let mut newer = BTreeMap::new();
        while let Ok((key, came)) = arrived.try_recv() {
            newer.insert(key, came);
        }
        presence.reconcile(&answer).into_iter().for_each(|change| tell(Some(change)));
        for (key, came) in newer {
            tell(if came { presence.came(&key) } else { presence.went(&key) });
        }
        next = Instant::now() + ASK_EVERY;
    }
    let _ = session.close().wait();
}
