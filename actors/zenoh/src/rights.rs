//! Who may what: the file that `--zenoh config=FILE` names.
//!
//! ```toml
//! readers = ["ana", "site-b"]         # names in certificates; they see telemetry
//!
//! [tls]                               # paths from the folder of this file
//! authority = "authority.pem"
//! certificate = "host.pem"
//! key = "host.key"
//!
//! [[hand]]                            # who may command a hand (`--hand right=zenoh:right`)
//! name = "right"
//! who = ["ana"]
//!
//! [[controller]]                      # a controller on another machine: one more writer, that the Model checks
//! name = "breathing"
//! who = ["site-b"]
//! reads = ["jaw_state"]
//! writes = ["pose", "velocity"]
//! entities = ["table"]
//! silence_secs = 0.2
//! rest = [{ entity = "table", component = "velocity", value = {} }]
//! ```
//!
//! On the loopback, without `[tls]`, nobody is known by a name: whoever is on this machine reads, and commands what the
//! file and `--hand` leave to be commanded.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Value, json};
use thiserror::Error;

use crate::keys::{ALL_INFOS, ALL_ROSTERS, ALL_SESSIONS, ALL_STATIONS, SessionKeys, check_name};

/// Most hands, controllers, and names of a list.
pub const ENTRIES_MAX: usize = 64;
/// Longest name in a certificate \[bytes\].
const WHO_MAX: usize = 256;
/// Largest file \[bytes\].
const FILE_MAX: u64 = 64 * 1024;
/// Everything that passes between nodes, as access control names it.
const MESSAGES: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Why a file of rights is not used.
#[derive(Debug, Error)]
pub enum RightsError {
    /// It cannot be read.
    #[error("{file}: {reason}")]
    File {
        /// The file.
        file: String,
        /// Why.
        reason: String,
    },
    /// An entry makes no sense.
    #[error("{place}: {reason}")]
    Entry {
        /// Where.
        place: String,
        /// Why, with what is valid.
        reason: String,
    },
}

/// Certificates of a node.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsFiles {
    /// The authority that has signed everybody's certificate.
    pub authority: PathBuf,
    /// The node's certificate.
    pub certificate: PathBuf,
    /// Its key.
    pub key: PathBuf,
}

/// A hand that may be commanded.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandRight {
    /// The name in `zenoh:NAME`.
    pub name: String,
    /// Names in certificates.
    #[serde(default)]
    pub who: Vec<String>,
}

/// A controller on another machine.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerRight {
    /// Its name.
    pub name: String,
    /// Names in certificates.
    #[serde(default)]
    pub who: Vec<String>,
    /// Components whose rows are told to it.
    #[serde(default)]
    pub reads: Vec<String>,
    /// Components that it may write.
    pub writes: Vec<String>,
    /// Names of the entities on which it may write them.
    pub entities: Vec<String>,
    /// Silence after which its commands stop \[s\].
    #[serde(default = "silence_secs")]
    pub silence_secs: f64,
    /// What is written then.
    #[serde(default)]
    pub rest: Vec<RestingRow>,
}

fn silence_secs() -> f64 {
    0.2
}

/// A row that is written when a controller has fallen silent.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RestingRow {
    /// Name of the entity.
    pub entity: String,
    /// The component.
    pub component: String,
    /// Its value.
    pub value: Value,
}

/// Who may what.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rights {
    /// Who sees telemetry, by names in certificates.
    pub readers: Vec<String>,
    /// Certificates.
    pub tls: Option<TlsFiles>,
    /// Hands that may be commanded.
    #[serde(rename = "hand")]
    pub hands: Vec<HandRight>,
    /// Controllers on other machines.
    #[serde(rename = "controller")]
    pub controllers: Vec<ControllerRight>,
}

impl Rights {
    /// Reads a file.
    ///
    /// # Errors
    /// [`RightsError`], with the place in the file.
    pub fn read(file: &Path) -> Result<Self, RightsError> {
        let wrong = |reason: String| RightsError::File { file: file.display().to_string(), reason };
        let length = file.metadata().map_err(|error| wrong(error.to_string()))?.len();
        if length > FILE_MAX {
            return Err(wrong(format!("{length} bytes; at most {FILE_MAX} are read")));
        }
        let text = std::fs::read_to_string(file).map_err(|error| wrong(error.to_string()))?;
        let mut rights = Self::parse(&text).map_err(|error| wrong(error.to_string()))?;
        if let Some(tls) = &mut rights.tls {
            let folder = file.parent().unwrap_or(Path::new(""));
            for path in [&mut tls.authority, &mut tls.certificate, &mut tls.key] {
                *path = folder.join(&*path);
                std::fs::File::open(&*path)
                    .map_err(|error| wrong(format!("[tls]: {}: {error}", path.display())))?;
            }
        }
        Ok(rights)
    }

    /// Reads a text.
    ///
    /// # Errors
    /// [`RightsError`].
    pub fn parse(text: &str) -> Result<Self, RightsError> {
        let wrong = |place: &str, reason: String| RightsError::Entry { place: place.to_owned(), reason };
        let rights: Self = toml::from_str(text).map_err(|error| wrong("the file", error.to_string()))?;
        let lists = [rights.readers.len(), rights.hands.len(), rights.controllers.len()];
        if lists.into_iter().any(|length| length > ENTRIES_MAX) {
            return Err(wrong("the file", format!("a list has more than {ENTRIES_MAX} entries")));
        }
        if let Some(name) =
            rights.everybody().iter().find(|name| name.trim().is_empty() || name.len() > WHO_MAX)
        {
            let reason = format!("{name:?} is the name in no certificate; valid are 1 to {WHO_MAX} bytes");
            return Err(wrong("readers and who", reason));
        }
        let mut names = BTreeSet::new();
        for hand in &rights.hands {
            check_name(&hand.name).map_err(|reason| wrong("[[hand]] name", reason))?;
            if !names.insert(&hand.name) {
                return Err(wrong(
                    &format!("[[hand]] '{}'", hand.name),
                    "there are two of this name".to_owned(),
                ));
            }
        }
        let mut names = BTreeSet::new();
        for controller in &rights.controllers {
            let place = format!("[[controller]] '{}'", controller.name);
            check_name(&controller.name).map_err(|reason| wrong("[[controller]] name", reason))?;
            if !names.insert(&controller.name) {
                return Err(wrong(&place, "there are two of this name".to_owned()));
            }
            if !(0.05..=10.0).contains(&controller.silence_secs) {
                let reason = format!("silence_secs = {}: valid are 0.05 to 10 s", controller.silence_secs);
                return Err(wrong(&place, reason));
            }
            if controller.writes.is_empty() || controller.entities.is_empty() {
                let reason = "writes and entities name what it may write, at least one each".to_owned();
                return Err(wrong(&place, reason));
            }
            let lists = [
                controller.who.len(),
                controller.reads.len(),
                controller.writes.len(),
                controller.entities.len(),
                controller.rest.len(),
            ];
            if lists.into_iter().any(|length| length > ENTRIES_MAX) {
                return Err(wrong(&place, format!("a list has more than {ENTRIES_MAX} entries")));
            }
        }
        Ok(rights)
    }

    /// Zenoh's access control for a session, by the names in the certificates of those that it is connected to; what is not
    /// allowed here is refused. None without certificates: nobody has a name then.
    pub fn access_control(&self, keys: &SessionKeys) -> Option<Value> {
        self.tls.as_ref()?;
        let (mut rules, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
        let mut allow = |id: &str, who: &[String], rights: &[(&[&str], &str, &[String])]| {
            if who.is_empty() {
                return;
            }
            let mut of_policy = Vec::new();
            for (number, (messages, flow, keys)) in rights.iter().enumerate() {
                let rule = format!("{id}-{number}");
                rules.push(json!({
                    "id": rule, "messages": messages, "flows": [flow], "permission": "allow", "key_exprs": keys,
                }));
                of_policy.push(rule);
            }
            subjects.push(json!({ "id": id, "cert_common_names": who }));
            policies.push(json!({ "id": id, "rules": of_policy, "subjects": [id] }));
        };
        // Who only reads puts nothing, answers nothing, and asks for no claim. Questions to all sessions are answered with what
        // belongs to this one.
        let hears: &[&str] = &["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"];
        let tells: &[&str] = &["put", "delete", "reply", "liveliness_token", "declare_queryable"];
        let own = [keys.all()];
        let heard = [keys.all(), ALL_SESSIONS.to_owned(), ALL_STATIONS.to_owned()];
        let asked = [keys.info(), keys.roster(), ALL_INFOS.to_owned(), ALL_ROSTERS.to_owned()];
        allow(
            "readers",
            &self.everybody(),
            &[(hears, "ingress", &heard), (&["query"], "ingress", &asked), (tells, "egress", &own)],
        );
        let commands: &[&str] = &["put", "query", "declare_subscriber"];
        let takes: &[&str] = &["declare_subscriber", "declare_queryable", "reply", "put"];
        for hand in &self.hands {
            let own = ["claim", "command"].map(|what| keys.hand(&hand.name, what));
            let id = format!("hand-{}", hand.name);
            allow(&id, &hand.who, &[(commands, "ingress", &own), (takes, "egress", &own)]);
        }
        for controller in &self.controllers {
            let own = ["claim", "batch"].map(|what| keys.controller(&controller.name, what));
            let id = format!("controller-{}", controller.name);
            allow(&id, &controller.who, &[(commands, "ingress", &own), (takes, "egress", &own)]);
        }
        Some(json!({
            "enabled": true,
            "default_permission": "deny",
            "rules": rules,
            "subjects": subjects,
            "policies": policies,
        }))
    }

    /// Access control of a router that carries sessions between these names and for nobody else.
    pub fn router_access_control(&self) -> Option<Value> {
        self.tls.as_ref()?;
        let known = self.everybody();
        if known.is_empty() {
            return Some(
                json!({ "enabled": true, "default_permission": "deny", "rules": [], "subjects": [], "policies": [] }),
            );
        }
        Some(json!({
            "enabled": true,
            "default_permission": "deny",
            "rules": [{
                "id": "sessions", "messages": MESSAGES, "flows": ["ingress", "egress"], "permission": "allow",
                "key_exprs": ["trocar/**"],
            }],
            "subjects": [{ "id": "known", "cert_common_names": known }],
            "policies": [{ "id": "known", "rules": ["sessions"], "subjects": ["known"] }],
        }))
    }

    /// Whoever may command something sees what it does.
    fn everybody(&self) -> Vec<String> {
        let hands = self.hands.iter().flat_map(|hand| &hand.who);
        let controllers = self.controllers.iter().flat_map(|controller| &controller.who);
        let all: BTreeSet<&String> = self.readers.iter().chain(hands).chain(controllers).collect();
        all.into_iter().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
        readers = ["bo"]
        [tls]
        authority = "a.pem"
        certificate = "c.pem"
        key = "k.pem"
        [[hand]]
        name = "right"
        who = ["ana"]
        [[controller]]
        name = "wind"
        who = ["lab"]
        writes = ["velocity"]
        entities = ["ring.1"]
    "#;

    #[test]
    fn the_file_of_the_manual_is_read() {
        let page = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/network.md");
        let page = std::fs::read_to_string(page).expect("a readable page");
        let shown =
            page.split("```\n").find(|block| block.starts_with("readers = ")).expect("the page shows a file");
        let rights = Rights::parse(shown).expect("which is valid");
        assert!(rights.tls.is_some() && rights.controllers[0].rest.len() == 1);
    }

    #[test]
    fn without_certificates_nobody_has_a_name() {
        let keys = SessionKeys::new("s");
        assert_eq!(Rights::default().access_control(&keys), None);
        assert_eq!(Rights::parse("readers = [\"a\"]").expect("valid").access_control(&keys), None);
    }

    #[test]
    fn what_nobody_is_allowed_is_denied_and_a_reader_puts_nothing() {
        let rights = Rights::parse(TEXT).expect("valid");
        let control = rights.access_control(&SessionKeys::new("s")).expect("there are certificates");
        assert_eq!((&control["enabled"], &control["default_permission"]), (&json!(true), &json!("deny")));
        let rules = control["rules"].as_array().expect("rules");
        let of = |rule: &&Value, message: &str| {
            rule["messages"].as_array().is_some_and(|all| all.contains(&json!(message)))
        };
        let ingress = || rules.iter().filter(|rule| rule["flows"] == json!(["ingress"]));
        let may_put: Vec<&Value> = ingress().filter(|rule| of(rule, "put")).collect();
        // A question to a key that is wider than these is refused whole: nobody asks for a claim by the way.
        let asked: Vec<String> = ingress()
            .filter(|rule| of(rule, "query") && !of(rule, "put"))
            .map(|rule| rule["key_exprs"].to_string())
            .collect();
        assert_eq!(asked, [r#"["trocar/s/info","trocar/s/roster","trocar/*/info","trocar/*/roster"]"#]);
        let keys: Vec<&Value> =
            may_put.iter().flat_map(|rule| rule["key_exprs"].as_array()).flatten().collect();
        assert_eq!(
            keys,
            ["hand/right/claim", "hand/right/command", "controller/wind/claim", "controller/wind/batch"]
                .map(|end| json!(format!("trocar/s/{end}")))
                .iter()
                .collect::<Vec<_>>()
        );
        let readers =
            control["subjects"].as_array().expect("subjects").iter().find(|one| one["id"] == "readers");
        assert_eq!(readers.expect("readers")["cert_common_names"], json!(["ana", "bo", "lab"]));
    }

    #[test]
    fn a_file_that_makes_no_sense_is_refused_with_the_place() {
        for (text, says) in [
            ("raeders = []", "raeders"),
            ("[[hand]]\nname = \"a/b\"", "[[hand]] name"),
            ("readers = [\" \"]", "name in no certificate"),
            ("[[controller]]\nname = \"w\"\nwrites = []\nentities = [\"a\"]", "at least one"),
            (
                "[[controller]]\nname = \"w\"\nwrites = [\"pose\"]\nentities = [\"a\"]\nsilence_secs = 0.0",
                "0.05 to 10",
            ),
        ] {
            let error = Rights::parse(text).expect_err(text).to_string();
            assert!(error.contains(says), "{text}: {error}");
        }
        let twice =
            format!("{TEXT}\n[[controller]]\nname = \"wind\"\nwrites = [\"pose\"]\nentities = [\"a\"]");
        assert!(Rights::parse(&twice).expect_err("two").to_string().contains("two of this name"));
        let missing = Rights::read(Path::new("/nonexistent/zenoh.toml")).expect_err("missing").to_string();
        assert!(missing.contains("zenoh.toml"), "{missing}");
    }
}
