//! The suite `network`: hands between stations beside bare datagrams, many stations at one host, joins, a scene that
//! moves, a slave's forces, and a stranger's flood. Hosts and stations are those of a session, over sockets of this machine.

mod architectures;
mod feedback;
mod flood;
mod link;
mod load;
mod pair;
mod raw;
mod round_trip;
mod rows;
mod scenes;
mod sealing;
mod sender;
#[cfg(test)]
mod smoke_tests;
mod stations;
mod veth;

pub use architectures::{architectures, thin_client};
pub use feedback::force_feedback;
pub use flood::flood;
pub use round_trip::round_trip;
pub use rows::liver;
pub use scenes::joins;
pub use sealing::sealing;
pub use sender::lossy_sender;
pub use stations::stations;

use trocar::summary::BenchResult;

use crate::failure::Failure;

type Rows = Result<Vec<BenchResult>, Failure>;
