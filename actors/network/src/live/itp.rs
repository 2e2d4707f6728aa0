//! ITP over sockets: a robot on its port, and a console that moves a robot somewhere else.
//!
//! Nothing of the protocol is protected. So sockets bind the loopback, and hear and reach nobody else, unless both ends are
//! named: then only datagrams from the other end's address are looked at.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Mutex, PoisonError};

use thiserror::Error;
use trocar_kernel::runtime::Clock;

use super::hands_thread::HandsThread;
use super::sockets::{SocketError, datagrams};
use crate::itp::{ARMS, ArmEnd, ConfigError, ConsoleArm, ConsoleConfig, ConsoleLink, RobotConfig, RobotLink};

/// Where a robot listens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ItpAddress {
    /// Its port; 0 is any.
    pub port: u16,
    /// Its own address; none: the loopback.
    pub bind: Option<IpAddr>,
    /// The address of the console; none: the loopback.
    pub peer: Option<IpAddr>,
    /// The port at the console that replies go to; none: the one that it sends from.
    pub reply_port: Option<u16>,
}

/// Why a robot is not on its port.
#[derive(Debug, Error)]
pub enum ItpPortError {
    /// Somebody else could reach it.
    #[error(
        "ITP protects nothing: whoever reaches the port moves the robot. It stays on the loopback unless both ends are \
         named: bind=OWN-ADDRESS beside the other end's, at the robot peer=ADDRESS-OF-THE-CONSOLE"
    )]
    Unprotected,
    /// The port.
    #[error("ITP: {0}")]
    Socket(#[from] SocketError),
    /// A parameter.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The system.
    #[error("ITP: {0}")]
    System(#[from] io::Error),
}

impl ItpAddress {
    /// The own address, if it may be used.
    fn own(&self) -> Result<IpAddr, ItpPortError> {
        let near: IpAddr = match self.peer {
            Some(IpAddr::V6(_)) => Ipv6Addr::LOCALHOST.into(),
            _ => Ipv4Addr::LOCALHOST.into(),
        };
        let own = self.bind.unwrap_or(near);
        let is_far = |address: IpAddr| !address.is_loopback();
        let both_named = self.bind.is_some() && self.peer.is_some();
        if (is_far(own) || self.peer.is_some_and(is_far)) && !both_named {
            return Err(ItpPortError::Unprotected);
        }
        Ok(own)
    }
}

/// A robot on its port, with a thread of its own; dropping it ends both.
pub struct RobotPort {
    local: SocketAddr,
    arms: Mutex<[Option<ArmEnd>; ARMS]>,
    _thread: HandsThread,
}

impl RobotPort {
    /// Takes the port.
    ///
    /// # Errors
    /// [`ItpPortError`].
    pub fn open(address: &ItpAddress, config: RobotConfig) -> Result<Self, ItpPortError> {
        let own = address.own()?;
        let (peer, reply_port) = (address.peer, address.reply_port);
        let admits = move |from: &SocketAddr| {
            let ip = from.ip().to_canonical();
            peer.map_or(ip.is_loopback(), |peer| ip == peer.to_canonical())
        };
        let reply_to = move |from: SocketAddr| SocketAddr::new(from.ip(), reply_port.unwrap_or(from.port()));
        let (link, [left, right]) = RobotLink::new(config, admits, reply_to)?;
        let socket = datagrams(own, address.port)?;
        let local = socket.local_addr()?;
        let thread = HandsThread::spawn(socket, Box::new(link), Clock::start())?;
        Ok(Self { local, arms: Mutex::new([Some(left), Some(right)]), _thread: thread })
    }

    /// Where it listens.
    pub fn local(&self) -> SocketAddr {
        self.local
    }

    /// An arm (0 left, 1 right), once.
    pub fn take(&self, arm: usize) -> Option<ArmEnd> {
        self.arms.lock().unwrap_or_else(PoisonError::into_inner).get_mut(arm)?.take()
    }
}

/// A console of a robot somewhere, with a thread of its own that sends a packet a millisecond; dropping it ends both.
pub struct ConsolePort {
    arms: Mutex<[Option<ConsoleArm>; ARMS]>,
    _thread: HandsThread,
}

impl ConsolePort {
    /// Begins to send. A robot beyond the loopback needs an own address to `bind`: nothing is protected.
    ///
    /// # Errors
    /// [`ItpPortError`].
    pub fn open(
        robot: SocketAddr,
        bind: Option<IpAddr>,
        config: ConsoleConfig,
    ) -> Result<Self, ItpPortError> {
        let peer = robot.ip().to_canonical();
        let own = ItpAddress { port: 0, bind, peer: Some(peer), reply_port: None }.own()?;
        let admits = move |from: &SocketAddr| from.ip().to_canonical() == peer;
        let (link, [left, right]) = ConsoleLink::new(config, robot, admits)?;
        let thread = HandsThread::spawn(datagrams(own, 0)?, Box::new(link), Clock::start())?;
        Ok(Self { arms: Mutex::new([Some(left), Some(right)]), _thread: thread })
    }

    /// An arm of the robot (0 left, 1 right), once.
    pub fn take(&self, arm: usize) -> Option<ConsoleArm> {
        self.arms.lock().unwrap_or_else(PoisonError::into_inner).get_mut(arm)?.take()
    }
}

#[cfg(test)]
#[path = "itp_tests.rs"]
mod tests;
