//! What the library is told: its own configuration, from our settings, with the defaults that do not suit replaced.
//!
//! | setting | the library's | ours | why |
//! |---|---|---|---|
//! | lease of a link | 10 s | 0.7 s | who is lost is known within a second |
//! | largest message | 1 GiB | 1 MiB | nothing of ours is larger |
//! | wait before a message that may be lost is dropped | 1 ms, 50 ms in pieces | 0, 5 ms | the newest wins |
//! | wait before a link that does not drain is closed | 5 s | 0.5 s | one slow peer holds up nobody |
//! | links at a time, links being opened | 1,000, 100 | 64, 16 | everything is bounded |
//! | multicast, gossip | on | off | a node calls those that it was told of, and no others |
//! | shared memory | on | off | its watchdogs race under load |

use serde_json::{Value, json};

use crate::keys::SessionKeys;
use crate::rights::Rights;
use crate::settings::NodeSettings;

/// Time without a sign after which a link counts as lost \[ms\].
pub const LEASE_MS: u64 = 700;
/// Signs within that time.
const KEEP_ALIVES: u64 = 5;
/// Largest message \[bytes\].
pub const MESSAGE_MAX: usize = 1 << 20;

/// What a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NodeKind<'a> {
    /// A session, with its rights.
    Session(&'a SessionKeys),
    /// A router between sites.
    Router,
    /// Somebody who looks on.
    Client,
}

/// The library's configuration of a node.
pub fn node_config(settings: &NodeSettings, rights: &Rights, kind: NodeKind<'_>) -> Value {
    let endpoints = |list: &[crate::settings::Endpoint]| -> Vec<String> {
        list.iter().map(ToString::to_string).collect()
    };
    let mode = match kind {
        NodeKind::Router => "router",
        // Who listens nowhere is a client of what it calls; so is who looks on.
        NodeKind::Session(_) if settings.listen.is_empty() => "client",
        NodeKind::Session(_) => "peer",
        NodeKind::Client => "client",
    };
    let mut config = json!({
        "mode": mode,
        "listen": {
            "endpoints": if mode == "client" { Vec::new() } else { endpoints(&settings.listen) },
            "timeout_ms": 0,
            "exit_on_failure": true,
        },
        "connect": {
            "endpoints": endpoints(&settings.connect),
            "timeout_ms": if mode == "client" { 3_000 } else { -1 },
            "exit_on_failure": mode == "client",
            "retry": { "period_init_ms": 200, "period_max_ms": 1_000, "period_increase_factor": 2 },
        },
        "scouting": {
            "timeout": 500,
            "delay": 0,
            "multicast": { "enabled": false },
            "gossip": { "enabled": false },
        },
        "queries_default_timeout": 2_000,
        "adminspace": { "enabled": false },
        "routing": { "interests": { "timeout": 2_000 } },
        "transport": {
            "unicast": {
                "open_timeout": 3_000,
                "accept_timeout": 3_000,
                "accept_pending": 16,
                "max_sessions": 64,
                "max_links": 1,
                "compression": { "enabled": false },
            },
            "link": {
                "protocols": ["tcp", "tls", "udp"],
                "tx": {
                    "lease": LEASE_MS,
                    "keep_alive": KEEP_ALIVES,
                    "queue": { "congestion_control": {
                        "drop": { "wait_before_drop": 0, "max_wait_before_drop_fragments": 5_000 },
                        "block": { "wait_before_close": 500_000 },
                    } },
                },
                "rx": { "max_message_size": MESSAGE_MAX },
            },
            "shared_memory": { "enabled": false },
        },
    });
    if let Some(tls) = &rights.tls {
        let path = |path: &std::path::Path| path.display().to_string();
        config["transport"]["link"]["tls"] = json!({
            "root_ca_certificate": path(&tls.authority),
            "enable_mtls": true,
            "listen_certificate": path(&tls.certificate),
            "listen_private_key": path(&tls.key),
            "connect_certificate": path(&tls.certificate),
            "connect_private_key": path(&tls.key),
            "verify_name_on_connect": true,
            "close_link_on_expiration": true,
        });
        let control = match kind {
            NodeKind::Session(keys) => rights.access_control(keys),
            NodeKind::Router => rights.router_access_control(),
            NodeKind::Client => None,
        };
        if let Some(control) = control {
            config["access_control"] = control;
        }
    }
    config
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_that_do_not_suit_are_replaced() {
        let keys = SessionKeys::new("s");
        let config = node_config(&"".parse().expect("valid"), &Rights::default(), NodeKind::Session(&keys));
        assert_eq!(
            (&config["mode"], &config["listen"]["endpoints"][0]),
            (&json!("peer"), &json!("tcp/127.0.0.1:7447"))
        );
        assert!(config["transport"]["link"]["tx"]["lease"].as_u64().is_some_and(|lease| lease < 1_000));
        assert_eq!(config["scouting"]["multicast"]["enabled"], json!(false));
        assert_eq!(config["transport"]["link"]["tls"], Value::Null);
        let calls = "connect=tcp/127.0.0.1:1".parse().expect("valid");
        assert_eq!(node_config(&calls, &Rights::default(), NodeKind::Session(&keys))["mode"], "client");
        assert_eq!(node_config(&calls, &Rights::default(), NodeKind::Router)["mode"], "router");
    }

    #[test]
    fn with_certificates_both_ends_show_theirs_and_what_is_not_allowed_is_denied() {
        let rights =
            Rights::parse("[tls]\nauthority = \"a\"\ncertificate = \"c\"\nkey = \"k\"").expect("valid");
        let keys = SessionKeys::new("s");
        let settings = "tls/0.0.0.0:7447".parse().expect("valid");
        for kind in [NodeKind::Session(&keys), NodeKind::Router] {
            let config = node_config(&settings, &rights, kind);
            assert_eq!(config["transport"]["link"]["tls"]["enable_mtls"], json!(true));
            assert_eq!(config["access_control"]["default_permission"], "deny");
        }
    }
}
