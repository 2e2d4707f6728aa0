//! The relay over sockets: the program at which hosts call, and the host's part that calls it.

pub mod agent;
pub mod key_file;
pub mod server;
mod splice;
#[cfg(test)]
mod tests;
