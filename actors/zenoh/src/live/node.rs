//! Node: one end of Zenoh, opened and used on a thread of its own.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use thiserror::Error;
use zenoh::{Config, Session, Wait};

use crate::node_config::{NodeKind, node_config};
use crate::rights::Rights;
use crate::settings::{NodeSettings, SettingsError};

/// How often a thread that only waits looks whether it should end.
pub(super) const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Why there is no node.
#[derive(Debug, Error)]
pub enum NodeError {
    /// What it was told.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A port is taken, a router is not there, a certificate is refused.
    #[error("Zenoh: {reason}{}", hint(endpoints, reason))]
    Open {
        /// Where it listens and what it calls.
        endpoints: String,
        /// What the library says.
        reason: String,
    },
    /// Another session has this name.
    #[error("Zenoh: a session called '{0}' is there already; --zenoh name=NAME gives this one another name")]
    NameTaken(String),
    /// What a controller elsewhere declares.
    #[error("{0}")]
    Controller(String),
    /// The system starts no thread, or the node's thread has ended.
    #[error("Zenoh: {0}")]
    System(String),
}

/// What may help.
fn hint(endpoints: &str, reason: &str) -> String {
    if reason.contains("in use") {
        return format!(
            "; another session or router may be there: --zenoh connect={} joins it",
            endpoints.split(", ").next().unwrap_or_default()
        );
    }
    format!(" ({endpoints})")
}

/// What the library says, without the lines of its sources where it says so.
pub(super) fn without_sources(reason: &str) -> String {
    let mut plain: Vec<String> = Vec::new();
    let mut words = reason.split_whitespace().peekable();
    while let Some(word) = words.next() {
        let Some(place) = words.next_if(|next| word == "at" && next.contains(".rs:")) else {
            plain.push(word.to_owned());
            continue;
        };
        // A bracket that ends there belongs to the sentence.
        if let Some(last) = plain.last_mut().filter(|_| place.ends_with(']')) {
            last.push(']');
        }
    }
    plain.join(" ")
}

/// Opens a session of the library. On a plain thread only.
pub(super) fn open(
    settings: &NodeSettings,
    rights: &Rights,
    kind: NodeKind<'_>,
) -> Result<Session, NodeError> {
    settings.check(rights.tls.is_some())?;
    let all: Vec<String> = settings.listen.iter().chain(&settings.connect).map(ToString::to_string).collect();
    let endpoints = all.join(", ");
    let wrong = |error: zenoh::Error| NodeError::Open {
        endpoints: endpoints.clone(),
        reason: without_sources(&error.to_string()),
    };
    let config = Config::from_json5(&node_config(settings, rights, kind).to_string()).map_err(&wrong)?;
    zenoh::open(config).wait().map_err(&wrong)
}

/// Does something on a thread of its own, and waits for it: whoever calls may be an actor.
pub(super) fn on_own_thread<T: Send + 'static>(
    what: impl FnOnce() -> Result<T, NodeError> + Send + 'static,
) -> Result<T, NodeError> {
    let system = |error: &dyn std::fmt::Display| NodeError::System(error.to_string());
    let thread = thread::Builder::new().name("zenoh".into()).spawn(what).map_err(|error| system(&error))?;
    thread.join().map_err(|_| system(&"its thread panicked"))?
}

/// A router between sites, until it is dropped.
pub struct Router {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Router {
    /// Opens it.
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn open(settings: &NodeSettings, rights: &Rights) -> Result<Self, NodeError> {
        let (settings, rights) = (settings.clone(), rights.clone());
        let session = on_own_thread(move || open(&settings, &rights, NodeKind::Router))?;
        let stop = Arc::<AtomicBool>::default();
        let stopped = stop.clone();
        let run = move || {
            while !stopped.load(Ordering::Relaxed) {
                thread::park_timeout(LOOK_EVERY);
            }
            // An end that the others are not told of is one that they see.
            let _ = session.close().wait();
        };
        let thread = thread::Builder::new().name("zenoh router".into()).spawn(run);
        let thread = thread.map_err(|error| NodeError::System(error.to_string()))?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_names_no_line_of_the_library() {
        let told = without_sources(
            "Can not listen: [127.0.0.1:7447: Address already in use (os error 98) at /x/y/tcp.rs:61.] at /x/unicast.rs:338.",
        );
        assert_eq!(told, "Can not listen: [127.0.0.1:7447: Address already in use (os error 98)]");
        assert!(hint("tcp/127.0.0.1:7447", &told).contains("connect=tcp/127.0.0.1:7447"));
        assert_eq!(without_sources("nobody is at home"), "nobody is at home");
    }
}
