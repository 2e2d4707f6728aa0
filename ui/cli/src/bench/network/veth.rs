//! Where two ends of a bench are: in two network namespaces with a pair of virtual interfaces between them, where this user
//! may make them, and else both on the loopback.

use std::fs::File;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::os::fd::AsFd;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rustix::thread::{LinkNameSpaceType, move_into_link_name_space};
use trocar::network::live::sockets::{HostSockets, SocketError};

use crate::failure::Failure;

/// Addresses of both ends, of the block for benches of networks (RFC 2544).
const HERE: Ipv4Addr = Ipv4Addr::new(198, 18, 7, 1);
const THERE: Ipv4Addr = Ipv4Addr::new(198, 18, 7, 2);
/// After so many seconds the namespace ends by itself, should this process not come to it.
const LIFE_SECS: u32 = 600;
/// Longest wait for it.
const PATIENCE: Duration = Duration::from_secs(2);

/// The place of the host's end.
pub enum Place {
    /// The same as that of the stations.
    Loopback,
    /// A namespace, which ends with this process.
    Namespace(Child),
}

impl Place {
    /// A namespace, or the loopback where there can be none.
    pub fn new() -> Self {
        Self::namespace().unwrap_or(Self::Loopback)
    }

    /// Its name, as a part of the names of figures.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Loopback => "loopback",
            Self::Namespace(_) => "veth",
        }
    }

    fn namespace() -> Option<Self> {
        let mut keeper = Command::new("unshare");
        keeper.args(["--net", "sleep", &LIFE_SECS.to_string()]).stdin(Stdio::null());
        keeper.stdout(Stdio::null()).stderr(Stdio::null());
        let mut place = Self::Namespace(keeper.spawn().ok()?);
        let Self::Namespace(child) = &mut place else { return None };
        let own = std::fs::read_link("/proc/self/ns/net").ok()?;
        let theirs = format!("/proc/{}/ns/net", child.id());
        let begun = Instant::now();
        // It is in the old one until `unshare` has come so far.
        while std::fs::read_link(&theirs).ok()? == own {
            if begun.elapsed() > PATIENCE || child.try_wait().ok()?.is_some() {
                return None;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        let id = child.id().to_string();
        let (near, far) = interfaces(&id);
        let within = |arguments: &[&str]| {
            let inside = [&["--target", &id, "--net", "ip"], arguments].concat();
            succeeds("nsenter", &inside)
        };
        let is_made =
            succeeds("ip", &["link", "add", &near, "type", "veth", "peer", "name", &far, "netns", &id])
                && succeeds("ip", &["addr", "add", &format!("{HERE}/30"), "dev", &near])
                && succeeds("ip", &["link", "set", &near, "up"])
                && within(&["addr", "add", &format!("{THERE}/30"), "dev", &far])
                && within(&["link", "set", &far, "up"])
                && within(&["link", "set", "lo", "up"]);
        is_made.then_some(place)
    }

    /// The same with packets of so many bytes at most; the loopback where that cannot be set.
    #[cfg(test)]
    pub fn with_packets_of(self, bytes: u32) -> Self {
        let Self::Namespace(child) = &self else { return self };
        let (id, bytes) = (child.id().to_string(), bytes.to_string());
        let (near, far) = interfaces(&id);
        let set = |interface| ["ip", "link", "set", interface, "mtu", &bytes];
        let is_set = succeeds("ip", &set(near.as_str())[1..])
            && succeeds("nsenter", &[&["--target", &id, "--net"][..], &set(&far)].concat());
        if is_set { self } else { Self::Loopback }
    }

    /// Sockets of a host there, and where stations reach them.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn host(&self) -> Result<(HostSockets, SocketAddr), Failure> {
        let Self::Namespace(child) = self else {
            let address = IpAddr::from(Ipv4Addr::LOCALHOST);
            let sockets = HostSockets::bind(Some(address), 0).map_err(Failure::internal)?;
            let port = sockets.port;
            return Ok((sockets, SocketAddr::new(address, port)));
        };
        let namespace = format!("/proc/{}/ns/net", child.id());
        // A thread of its own, whose end also ends its stay there; its sockets remain where they were made.
        let made = std::thread::spawn(move || -> Result<HostSockets, Failure> {
            let namespace = File::open(namespace).map_err(Failure::internal)?;
            move_into_link_name_space(namespace.as_fd(), Some(LinkNameSpaceType::Network))
                .map_err(Failure::internal)?;
            HostSockets::bind(Some(THERE.into()), 0).map_err(|error: SocketError| Failure::internal(error))
        });
        let sockets =
            made.join().map_err(|_| Failure::internal("the thread of the namespace panicked"))??;
        let port = sockets.port;
        Ok((sockets, SocketAddr::new(THERE.into(), port)))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        if let Self::Namespace(child) = self {
            // The interfaces go with the namespace; if it cannot be ended now, it ends by itself.
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Names of the interfaces at both ends.
fn interfaces(id: &str) -> (String, String) {
    (format!("trb{id}a"), format!("trb{id}b"))
}

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}
