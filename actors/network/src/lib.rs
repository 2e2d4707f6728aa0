//! Sessions over a network: several stations share a scene while every hand keeps its own kilohertz.
//!
//! All protocol logic is sans-IO: state machines that are given bytes and a time, and give bytes and a time at which they
//! want to be asked again. Two drivers move the bytes: `live` over sockets, on a thread of its own, and `lockstep` over
//! links inside the process, in virtual time with the same bits every time.

pub mod annotation;
pub mod compensation;
pub mod control;
pub mod datagram;
pub mod diagnosis;
pub mod faulty;
pub mod hand_sample;
pub mod hands_link;
pub mod haptic;
pub mod impairments;
pub mod itp;
pub mod live;
pub mod lockstep;
pub mod pairs;
pub mod peers;
pub mod reflector;
pub mod relay;
pub mod remote_hand;
pub mod replication;
pub mod session;
pub mod stream_path;
pub mod streams;
pub mod teleoperation;
pub mod ticket;
