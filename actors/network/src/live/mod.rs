//! The driver in real time: sockets, TLS, and the threads that move bytes. Nothing else in the crate touches a socket.
//!
//! [`TlsHostStreams`](tls_host_streams::TlsHostStreams) and [`TlsStationStream`](tls_station_stream::TlsStationStream) are
//! the [`streams`](crate::streams) of the control channel over TCP. Both work without threads and without waiting; only
//! names are looked up on a thread of their own, since the system's resolver waits.

mod dial;
pub mod hands_thread;
pub mod interfaces;
pub mod itp;
mod leaving;
mod lookup;
pub mod pair_door;
pub mod reach;
#[cfg(test)]
mod reach_tests;
pub mod reflected;
pub mod reflector;
pub mod relay;
pub mod sockets;
pub mod store_admissions;
pub mod tls;
#[cfg(test)]
mod tls_dial_tests;
pub mod tls_host_streams;
#[cfg(test)]
mod tls_join_tests;
mod tls_socket;
pub mod tls_station_stream;
#[cfg(test)]
mod tls_strangers_tests;
#[cfg(test)]
mod tls_streams_tests;
#[cfg(test)]
mod tls_testing;
mod unreached;
