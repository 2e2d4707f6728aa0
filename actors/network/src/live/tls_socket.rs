//! One end of a TLS connection over a non-blocking TCP socket: what both ends have in common.

use std::io::{self, BufRead, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustls::Connection;

use crate::datagram::Keys;
use crate::streams::Closed;

/// Encrypted bytes of a stream that wait for the system \[bytes\]. While so many wait, nothing more is taken.
pub const SEND_BUFFER: usize = 64 << 10;
/// Most bytes that are taken by one `send` \[bytes\], so that one stream does not keep the others waiting.
pub const SENT_MAX: usize = 256 << 10;
/// Most bytes that come from one `receive` \[bytes\], whatever the caller asks for.
pub const RECEIVED_MAX: usize = 256 << 10;
/// Most reads of the socket in one call. The other end chooses the size of its records: without this limit, small and
/// empty ones could hold a call for as long as they come.
const READS_MAX: usize = 128;

/// Why a handshake failed.
#[derive(Debug)]
pub(super) enum HandshakeError {
    /// The other end closed the connection.
    HungUp,
    /// The socket failed.
    Socket(io::Error),
    /// The bytes are not those of the TLS that both ends speak, or the certificate is not the right one.
    Tls(rustls::Error),
}

/// A socket and its TLS session.
#[derive(Debug)]
pub(super) struct TlsSocket {
    tcp: TcpStream,
    tls: Box<Connection>,
    /// Why nothing more comes. Bytes that came before may still wait in the session.
    input_end: Option<String>,
    /// Why nothing more goes out. It is told after the last bytes that came: they may be the reason in better words.
    output_end: Option<String>,
    /// Whether the end was told to the caller.
    is_over: bool,
}

impl TlsSocket {
    /// The socket is connected and does not block.
    pub fn new(tcp: TcpStream, mut tls: Connection) -> Self {
        // Small messages go out at once. A system without the option only sends them a little later.
        let _ = tcp.set_nodelay(true);
        tls.set_buffer_limit(Some(SEND_BUFFER));
        Self { tcp, tls: Box::new(tls), input_end: None, output_end: None, is_over: false }
    }

    /// Goes on with the handshake, and returns whether it is done.
    ///
    /// # Errors
    /// [`HandshakeError`].
    pub fn shake_hands(&mut self) -> Result<bool, HandshakeError> {
        for _ in 0..READS_MAX {
            while self.tls.wants_write() {
                match self.tls.write_tls(&mut self.tcp) {
                    Ok(0) => return Err(HandshakeError::HungUp),
                    Ok(_) => {}
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    Err(error) if error.kind() == ErrorKind::Interrupted => {}
                    Err(error) => return Err(HandshakeError::Socket(error)),
                }
            }
            if !self.tls.is_handshaking() {
                return Ok(true);
            }
            if !self.tls.wants_read() {
                return Ok(false);
            }
            match self.tls.read_tls(&mut self.tcp) {
                Ok(0) => return Err(HandshakeError::HungUp),
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(false),
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(HandshakeError::Socket(error)),
            }
            if let Err(error) = self.tls.process_new_packets() {
                // The alert tells the other end why.
                self.flush();
                return Err(HandshakeError::Tls(error));
            }
        }
        Ok(false)
    }

    /// Appends bytes that have come, at most `most` and [`RECEIVED_MAX`].
    ///
    /// # Errors
    /// [`Closed`] after the last bytes.
    pub fn receive(&mut self, most: usize, into: &mut Vec<u8>) -> Result<(), Closed> {
        let begin = into.len();
        let most = begin + most.min(RECEIVED_MAX);
        for _ in 0..READS_MAX {
            self.take_plain(most, into);
            if into.len() == most {
                return Ok(());
            }
            if self.input_end.is_none() && !self.read() {
                // Nothing comes now; and if nothing goes out any more either, nothing ever will.
                self.input_end = self.output_end.clone();
                if self.input_end.is_none() {
                    return Ok(());
                }
            } else if self.input_end.is_some() && !self.has_plain() {
                if into.len() > begin {
                    return Ok(());
                }
                self.is_over = true;
                return Err(Closed(self.input_end.clone().unwrap_or_default()));
            }
        }
        Ok(())
    }

    /// Moves decrypted bytes until `into` has `most`.
    fn take_plain(&mut self, most: usize, into: &mut Vec<u8>) {
        let mut reader = self.tls.reader();
        while into.len() < most {
            // An error says that there are none, or that none will come, which `read` has noted.
            let Ok(bytes) = reader.fill_buf() else { return };
            if bytes.is_empty() {
                return;
            }
            let count = bytes.len().min(most - into.len());
            into.extend_from_slice(&bytes[..count]);
            reader.consume(count);
        }
    }

    fn has_plain(&mut self) -> bool {
        self.tls.reader().fill_buf().is_ok_and(|bytes| !bytes.is_empty())
    }

    /// Reads once, and notes the end; false when nothing has come.
    fn read(&mut self) -> bool {
        match self.tls.read_tls(&mut self.tcp) {
            Ok(0) => self.input_end = Some("the other side was cut off".to_owned()),
            Ok(_) => match self.tls.process_new_packets() {
                Ok(state) if state.peer_has_closed() => {
                    self.input_end = Some("the other side closed the stream".to_owned());
                }
                Ok(_) => {}
                Err(error) => {
                    self.flush();
                    self.input_end = Some(format!("the stream is damaged: {error}"));
                }
            },
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => self.input_end = Some(in_words(&error)),
        }
        true
    }

    /// Takes at most [`SENT_MAX`] of the bytes, as many as there is room for, and returns how many.
    ///
    /// # Errors
    /// [`Closed`] once [`Self::receive`] has told it. Before that a broken stream takes nothing.
    pub fn send(&mut self, bytes: &[u8]) -> Result<usize, Closed> {
        if let Some(why) = self.over() {
            return Err(Closed(why.to_owned()));
        }
        let most = bytes.len().min(SENT_MAX);
        let mut taken = 0;
        loop {
            self.flush();
            if taken == most || self.output_end.is_some() || self.input_end.is_some() {
                return Ok(taken);
            }
            match self.tls.writer().write(&bytes[taken..most]) {
                Ok(count @ 1..) => taken += count,
                Ok(0) | Err(_) => return Ok(taken),
            }
        }
    }

    /// Sends what waits, as far as the system takes it.
    pub fn flush(&mut self) {
        while self.output_end.is_none() && self.tls.wants_write() {
            match self.tls.write_tls(&mut self.tcp) {
                Ok(0) => self.output_end = Some("the system takes no bytes".to_owned()),
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => self.output_end = Some(in_words(&error)),
            }
        }
    }

    /// Whether bytes wait for the system that it may still take.
    pub fn has_unsent(&self) -> bool {
        self.output_end.is_none() && self.tls.wants_write()
    }

    /// Why it is over, once the caller was told.
    pub fn over(&self) -> Option<&str> {
        self.input_end.as_deref().filter(|_| self.is_over)
    }

    /// Tells the other end that nothing more comes.
    pub fn say_goodbye(&mut self) {
        self.tls.send_close_notify();
        self.flush();
    }

    /// Closes the direction to the other end.
    pub fn shut_down_output(&self) {
        // A socket that is not connected any more needs no shutting down.
        let _ = self.tcp.shutdown(Shutdown::Write);
    }

    /// Throws away what comes; true while more may come.
    pub fn discard(&mut self) -> bool {
        let mut bytes = [0; 16 << 10];
        for _ in 0..READS_MAX {
            match self.tcp.read(&mut bytes) {
                Ok(0) => return false,
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return true,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
        }
        true
    }

    /// Keys for datagrams of a connection and phase, from the session's exporter.
    pub fn keys(&self, connection: u32, phase: u32) -> Option<Keys> {
        let export = |label: &[u8], context: &[u8], out: &mut [u8]| {
            self.tls.export_keying_material(out, label, Some(context)).map(drop)
        };
        Keys::from_exporter(connection, phase, export).ok()
    }

    /// What is to be waited for.
    pub fn poll_fd(&self) -> PollFd<'_> {
        let flags = match (self.tls.wants_write(), self.tls.is_handshaking()) {
            (false, _) => PollFlags::IN,
            // Until its own part is out, a handshake reads nothing.
            (true, true) => PollFlags::OUT,
            (true, false) => PollFlags::IN | PollFlags::OUT,
        };
        PollFd::new(&self.tcp, flags)
    }
}

/// Asks the system which sockets are ready, without waiting; false when none is.
pub(super) fn poll_now(sockets: &mut [PollFd<'_>]) -> bool {
    // An interrupted call finds what it did not find next time.
    poll(sockets, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })).is_ok_and(|ready| ready > 0)
}

/// Why a connection that stood has failed.
fn in_words(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => {
            "the other side broke off the connection".to_owned()
        }
        ErrorKind::TimedOut => "the network has carried nothing for too long".to_owned(),
        _ => error.to_string(),
    }
}
