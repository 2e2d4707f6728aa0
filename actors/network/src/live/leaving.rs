//! Streams that were closed, until their last words are out.
//!
//! A socket that is closed while bytes of the other end have not been read resets the connection, and what was sent
//! last may never arrive: a host's refusal, for instance, would get lost together with the words that it answers. So the
//! direction to the other end is closed first, and what still comes is thrown away until the other end closes its own.

use std::collections::VecDeque;

use trocar_scene::SimTime;

use super::tls_socket::TlsSocket;

/// Longest time that last words wait for a slow network.
pub const LEAVING_TIME_MAX: SimTime = SimTime::from_millis(2_000);

/// Closed streams, the oldest first.
#[derive(Debug)]
pub(super) struct Leaving {
    sockets: VecDeque<Gone>,
    most: usize,
}

#[derive(Debug)]
struct Gone {
    socket: TlsSocket,
    /// Set by the first call that knows the time.
    until: Option<SimTime>,
    is_shut_down: bool,
}

impl Leaving {
    /// Keeps at most `most` streams; when there are more, the oldest goes.
    pub fn new(most: usize) -> Self {
        Self { sockets: VecDeque::new(), most }
    }

    /// Ends a stream.
    pub fn add(&mut self, mut socket: TlsSocket) {
        socket.say_goodbye();
        let mut gone = Gone { socket, until: None, is_shut_down: false };
        if gone.is_still_there() {
            if self.sockets.len() >= self.most {
                self.sockets.pop_front();
            }
            self.sockets.push_back(gone);
        }
    }

    /// Whether none is under way.
    pub fn is_empty(&self) -> bool {
        self.sockets.is_empty()
    }

    /// Goes on.
    pub fn work(&mut self, now: SimTime) {
        self.sockets.retain_mut(|gone| {
            let until = *gone.until.get_or_insert(now + LEAVING_TIME_MAX);
            now < until && gone.is_still_there()
        });
    }
}

impl Gone {
    fn is_still_there(&mut self) -> bool {
        self.socket.flush();
        if !self.is_shut_down && !self.socket.has_unsent() {
            self.socket.shut_down_output();
            self.is_shut_down = true;
        }
        self.socket.discard()
    }
}
