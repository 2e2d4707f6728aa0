//! Where a node of Zenoh listens and whom it calls: the text of `--zenoh`.
//!
//! ```text
//! (nothing)                                          listens at tcp/127.0.0.1:7447
//! tcp/127.0.0.1:7500                                 listens there
//! connect=tcp/127.0.0.1:7447,name=site-a             calls a router or a session
//! listen=tls/192.0.2.4:7447,config=zenoh.toml        beyond this machine: with certificates
//! ```

use std::fmt;
use std::net::IpAddr;
use std::path::PathBuf;
use std::str::FromStr;

use thiserror::Error;

use crate::keys::check_name;

/// Where a node listens if nothing else is said.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";
/// Most endpoints of a node.
const ENDPOINTS_MAX: usize = 8;
/// The keys.
const KEYS: &str = "connect, listen, name, config";

/// How bytes go to an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transport {
    /// TCP, unprotected.
    Tcp,
    /// TLS over TCP.
    Tls,
    /// UDP, unprotected.
    Udp,
}

/// Where a node listens, or what it calls: `tcp/127.0.0.1:7447`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    transport: Transport,
    host: String,
    port: u16,
}

/// Why a text is no setting of a node, or one that is refused.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum SettingsError {
    /// Not an endpoint.
    #[error(
        "{0:?} is no endpoint; valid are tcp/ADDRESS:PORT, tls/ADDRESS:PORT and udp/ADDRESS:PORT, such as {DEFAULT_ENDPOINT}"
    )]
    Endpoint(String),
    /// Not a key.
    #[error("unknown key {0:?}; valid are {KEYS}, or one endpoint alone to listen at")]
    Key(String),
    /// A name that cannot be one.
    #[error("name: {0}")]
    Name(String),
    /// Too much of something.
    #[error("at most {ENDPOINTS_MAX} endpoints, and one name and one file, can be given")]
    TooMany,
    /// Others could read and write without being known.
    #[error(
        "{0} is beyond this machine and unprotected: whoever reaches it reads the session. Beyond the loopback \
         endpoints are tls/…, with certificates in a file: config=FILE (see docs/network.md)"
    )]
    Unprotected(Endpoint),
    /// TLS without certificates.
    #[error("{0} needs certificates: config=FILE with a table [tls] (see docs/network.md)")]
    NoCertificates(Endpoint),
}

impl Endpoint {
    /// How bytes go there.
    pub fn transport(&self) -> Transport {
        self.transport
    }

    /// Whether only this machine reaches it.
    pub fn is_loopback(&self) -> bool {
        let host = self.host.trim_start_matches('[').trim_end_matches(']');
        host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.to_canonical().is_loopback())
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let transport = match self.transport {
            Transport::Tcp => "tcp",
            Transport::Tls => "tls",
            Transport::Udp => "udp",
        };
        write!(f, "{transport}/{}:{}", self.host, self.port)
    }
}

impl FromStr for Endpoint {
    type Err = SettingsError;

    fn from_str(text: &str) -> Result<Self, SettingsError> {
        let wrong = || SettingsError::Endpoint(text.to_owned());
        let (transport, place) = text.split_once('/').ok_or_else(wrong)?;
        let transport = match transport {
            "tcp" => Transport::Tcp,
            "tls" => Transport::Tls,
            "udp" => Transport::Udp,
            _ => return Err(wrong()),
        };
        let (host, port) = place.rsplit_once(':').ok_or_else(wrong)?;
        let port = port.parse().map_err(|_| wrong())?;
        let is_v6 = host.strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
        let is_named = !host.is_empty()
            && host.len() <= 253
            && host.chars().all(|c| c.is_ascii_alphanumeric() || ['.', '-'].contains(&c));
        if !is_named && is_v6.is_none_or(|ip| ip.parse::<IpAddr>().is_err()) {
            return Err(wrong());
        }
        Ok(Self { transport, host: host.to_owned(), port })
    }
}

/// What `--zenoh` says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NodeSettings {
    /// Where the node listens. With nothing here it is a client of what it calls.
    pub listen: Vec<Endpoint>,
    /// What it calls.
    pub connect: Vec<Endpoint>,
    /// The session's name among others; none: the scenario's.
    pub name: Option<String>,
    /// File with certificates and rights.
    pub config: Option<PathBuf>,
}

impl NodeSettings {
    /// Whether every byte to and from the node is read and written by those only who are known.
    pub fn is_protected(&self) -> bool {
        self.listen.iter().chain(&self.connect).all(|endpoint| endpoint.transport == Transport::Tls)
    }

    /// Refuses what strangers could reach.
    ///
    /// # Errors
    /// [`SettingsError::Unprotected`] and [`SettingsError::NoCertificates`].
    pub fn check(&self, has_certificates: bool) -> Result<(), SettingsError> {
        for endpoint in self.listen.iter().chain(&self.connect) {
            if endpoint.transport == Transport::Tls {
                if !has_certificates {
                    return Err(SettingsError::NoCertificates(endpoint.clone()));
                }
            } else if !endpoint.is_loopback() {
                return Err(SettingsError::Unprotected(endpoint.clone()));
            }
        }
        Ok(())
    }
}

impl FromStr for NodeSettings {
    type Err = SettingsError;

    fn from_str(text: &str) -> Result<Self, SettingsError> {
        let mut settings = Self::default();
        for part in text.split(',').map(str::trim).filter(|part| !part.is_empty()) {
            let (key, value) = match part.split_once('=') {
                Some(pair) => pair,
                None if part.contains('/') || !text.contains('=') => ("listen", part),
                None => return Err(SettingsError::Key(part.to_owned())),
            };
            match key {
                "listen" => settings.listen.push(value.parse()?),
                "connect" => settings.connect.push(value.parse()?),
                "name" if settings.name.is_none() => {
                    check_name(value).map_err(SettingsError::Name)?;
                    settings.name = Some(value.to_owned());
                }
                "config" if settings.config.is_none() => settings.config = Some(PathBuf::from(value)),
                "name" | "config" => return Err(SettingsError::TooMany),
                _ => return Err(SettingsError::Key(key.to_owned())),
            }
        }
        if settings.listen.len() + settings.connect.len() > ENDPOINTS_MAX {
            return Err(SettingsError::TooMany);
        }
        if settings.listen.is_empty() && settings.connect.is_empty() {
            settings.listen.push(DEFAULT_ENDPOINT.parse()?);
        }
        Ok(settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(text: &str) -> NodeSettings {
        text.parse().unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    #[test]
    fn a_text_names_where_to_listen_whom_to_call_and_the_session() {
        assert_eq!(settings("").listen[0].to_string(), DEFAULT_ENDPOINT);
        assert_eq!(settings("tcp/127.0.0.1:7500").listen[0].to_string(), "tcp/127.0.0.1:7500");
        let all = settings("connect=tcp/localhost:7447,listen=tls/[::1]:0,name=site-a,config=z.toml");
        assert_eq!((all.connect.len(), all.listen[0].transport()), (1, Transport::Tls));
        assert_eq!((all.name.as_deref(), all.config), (Some("site-a"), Some(PathBuf::from("z.toml"))));
        assert!(settings("connect=tcp/localhost:7447").listen.is_empty(), "a client listens nowhere");
        for (text, says) in [
            ("peg-transfer", "is no endpoint"),
            ("tcp/127.0.0.1", "is no endpoint"),
            ("quic/127.0.0.1:7447", "tls/ADDRESS:PORT"),
            ("tcp/:7447", "is no endpoint"),
            ("tcp/127.0.0.1:99999", "is no endpoint"),
            ("tcp/a b:1", "is no endpoint"),
            ("nmae=x", "unknown key \"nmae\"; valid are connect"),
            ("name=a/b", "letters, digits"),
            ("name=a,name=b", "one name"),
            ("listen=tcp/127.0.0.1:1,here", "unknown key"),
        ] {
            let error = text.parse::<NodeSettings>().expect_err(text).to_string();
            assert!(error.contains(says), "{text}: {error}");
        }
        let many = ["connect=tcp/127.0.0.1:1"; 9].join(",");
        assert_eq!(many.parse::<NodeSettings>(), Err(SettingsError::TooMany));
    }

    #[test]
    fn beyond_this_machine_nothing_goes_without_certificates() {
        for near in
            ["", "tcp/localhost:1", "udp/127.0.0.9:1", "tcp/[::1]:1", "connect=tcp/[::ffff:127.0.0.1]:1"]
        {
            assert_eq!(settings(near).check(false), Ok(()), "{near}");
            assert!(!settings(near).is_protected());
        }
        for far in
            ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "connect=udp/192.0.2.7:7447", "connect=tcp/site-b:7447"]
        {
            let error = settings(far).check(true).expect_err(far).to_string();
            assert!(error.contains("unprotected") && error.contains("tls/"), "{error}");
        }
        let tls = settings("tls/0.0.0.0:7447");
        assert!(matches!(tls.check(false), Err(SettingsError::NoCertificates(_))));
        assert_eq!(tls.check(true), Ok(()));
        assert!(tls.is_protected());
        assert!(!settings("listen=tls/0.0.0.0:1,connect=tcp/127.0.0.1:2").is_protected());
    }
}
