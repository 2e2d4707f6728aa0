//! The driver in real time: sockets, TLS, and the threads that move bytes. Nothing else in the crate touches a socket.

pub mod hands_thread;
pub mod interfaces;
pub mod reflector;
pub mod sockets;
pub mod store_admissions;
pub mod tls;
