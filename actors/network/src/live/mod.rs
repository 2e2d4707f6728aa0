//! The driver in real time: sockets, TLS, and the threads that move bytes. Nothing else in the crate touches a socket.

pub mod hands_thread;
pub mod reflector;
pub mod sockets;
pub mod tls;
