//! Events, in a bounded log with a cursor per reader.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::entity::Entity;
use crate::time::SimTime;

/// An instantaneous event, such as a button press or a drop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Name, such as `button_pressed`; a literal costs no allocation.
    pub name: Cow<'static, str>,
    /// Its subject.
    pub subject: Entity,
    /// The other entity involved.
    pub object: Option<Entity>,
    /// An attached number.
    pub value: f64,
    /// When.
    pub at: SimTime,
}

const CHUNK: usize = 64;
const CHUNKS: usize = 64;

/// About the last 4,096 events, numbered without gaps.
#[derive(Clone, Default)]
pub struct EventLog {
    first: u64,
    next: u64,
    chunks: VecDeque<Arc<Vec<Event>>>,
}

impl EventLog {
    /// The number that the next event will get: the cursor of a reader that has read everything.
    pub fn next(&self) -> u64 {
        self.next
    }
    /// The number of the oldest stored event.
    pub fn first(&self) -> u64 {
        self.first
    }
    /// A log whose oldest event has the number `first`.
    pub fn restore(first: u64, events: Vec<Event>) -> Self {
        let mut log = Self { first, next: first, chunks: VecDeque::new() };
        events.into_iter().for_each(|event| log.push(event));
        log
    }
    /// Appends an event and drops the oldest chunk when full.
    pub fn push(&mut self, event: Event) {
        let full = self.chunks.back().is_none_or(|chunk| chunk.len() == CHUNK);
        if full {
            if self.chunks.len() == CHUNKS
                && let Some(old) = self.chunks.pop_front()
            {
                self.first += old.len() as u64;
            }
            self.chunks.push_back(Arc::new(Vec::with_capacity(CHUNK)));
        }
        if let Some(chunk) = self.chunks.back_mut() {
            Arc::make_mut(chunk).push(event);
            self.next += 1;
        }
    }
    /// Events numbered `cursor` and above, oldest first.
    pub fn since(&self, cursor: u64) -> impl Iterator<Item = (u64, &Event)> {
        let skip = cursor.max(self.first) - self.first;
        let first = self.first;
        // Chunks are always full except the last, so an event's chunk follows from its number.
        let from_chunk = (skip as usize) / CHUNK;
        self.chunks
            .iter()
            .enumerate()
            .skip(from_chunk)
            .flat_map(move |(c, chunk)| {
                chunk.iter().enumerate().map(move |(i, event)| (first + (c * CHUNK + i) as u64, event))
            })
            .filter(move |(number, _)| *number >= cursor)
    }
}

/// A controller's view of the log: the events since its last tick.
#[derive(Clone, Copy)]
pub struct Events<'a> {
    log: &'a EventLog,
    cursor: u64,
}

impl<'a> Events<'a> {
    /// Events of `log` from `cursor` on.
    pub fn new(log: &'a EventLog, cursor: u64) -> Self {
        Self { log, cursor }
    }
    /// Oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &'a Event> + use<'a> {
        self.log.since(self.cursor).map(|(_, event)| event)
    }
    /// Number of events dropped before this reader read them.
    pub fn lost(&self) -> u64 {
        self.log.first().saturating_sub(self.cursor)
    }
}
