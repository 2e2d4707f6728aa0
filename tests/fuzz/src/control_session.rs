//! A session behind the control channel, in memory: three tickets, two hands, and a scene of numbers. It watches over what
//! the machine in front of it promises.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_network::control::{
    Admitted, Architecture, ClientFacts, ComponentList, Credential, Diagnosed, HandInfo, HeldScene,
    HostEvent, HostFacts, HostSession, ListedComponent, PlainText, Refusal, RequestKind, Roster, SceneCounts,
    SceneKind, SceneManifest, SceneOffer, SessionInfo, TicketVerdict, Wish,
};
use trocar_network::ticket::{PlainName, Refused, ResumeSecret, Role, Token};
use trocar_scene::{Entity, Revision, SimTime};

/// Bytes of an entity in this session's scene.
const ENTITY_BYTES: usize = 8;
/// Entities of the scene at its beginning.
const ENTITIES: u64 = 40;

/// A name that is valid.
///
/// # Panics
/// When it is not.
pub fn name(text: &str) -> PlainName {
    text.parse().expect("a name")
}

fn components() -> ComponentList {
    let listed = ["pose", "tissue"].map(|name| ListedComponent { name: PlainText::new(name), schema: 1 });
    ComponentList::new(listed.to_vec())
}

/// What the host is.
pub fn host_facts() -> HostFacts {
    HostFacts {
        components_digest: components().digest(),
        components: components(),
        scenario_name: PlainText::new("peg-transfer"),
        scenario: [5; 32],
    }
}

/// What a station is that wants this role and the left hand, if its role has hands.
pub fn client_facts(role: Role) -> ClientFacts {
    let hands = if role.may_operate() { vec![name("left")] } else { Vec::new() };
    ClientFacts {
        program: PlainText::new("0.1.0"),
        components: components(),
        scenario: None,
        wish: Wish { name: name("Ana"), role: None, devices: hands.clone(), hands, moves: false },
    }
}

/// The ticket for a role, and the secret of the station that has it.
pub fn ticket(role: Role) -> Credential {
    Credential::Ticket {
        token: Token::from_bytes([role as u8; 16]),
        resume: ResumeSecret::from_bytes([role as u8; 32]),
    }
}

/// What is in a scene of these bytes.
pub fn counts_of(scene: &[u8]) -> SceneCounts {
    let entities = (scene.len() / ENTITY_BYTES) as u32;
    SceneCounts { entities, rows: BTreeMap::from([(PlainText::new("pose"), entities)]) }
}

/// Digest of a scene of these bytes.
pub fn digest_of(scene: &[u8]) -> [u8; 32] {
    *blake3::hash(scene).as_bytes()
}

/// The session.
pub struct ControlSession {
    /// Whether the token of each role is spent.
    spent: BTreeMap<Role, bool>,
    /// Stations by the first byte of their secrets.
    known: BTreeMap<u8, (u16, Role)>,
    /// What was asked last, and found good.
    checked: Option<Credential>,
    /// Who is there.
    pub roster: Roster,
    /// Roles of those who were let in.
    roles: BTreeMap<u16, Role>,
    scene: Vec<u8>,
    /// Length of the scene at each revision.
    revisions: BTreeMap<u64, usize>,
}

impl Default for ControlSession {
    fn default() -> Self {
        let hand = |number: u8, text: &str| HandInfo {
            number,
            name: name(text),
            entity: Entity::new(0, 0, u32::from(number) + 1),
            station: None,
        };
        let mut session = Self {
            spent: Role::ALL.map(|role| (role, false)).into(),
            known: BTreeMap::new(),
            checked: None,
            roster: Roster::new(vec![hand(0, "left"), hand(1, "right")]),
            roles: BTreeMap::new(),
            scene: Vec::new(),
            revisions: BTreeMap::new(),
        };
        session.grow(ENTITIES);
        session
    }
}

impl ControlSession {
    /// The scene gets more entities.
    pub fn grow(&mut self, entities: u64) {
        self.scene.extend((0..entities).flat_map(u64::to_le_bytes));
        let revision = self.revisions.last_key_value().map_or(0, |(revision, _)| *revision) + 1;
        self.revisions.insert(revision, self.scene.len());
    }

    fn station(&self, credential: &Credential) -> Result<(Option<u16>, Role), Refusal> {
        match credential {
            Credential::Ticket { token, .. } => {
                let role = Role::ALL.into_iter().find(|role| *token.as_bytes() == [*role as u8; 16]);
                let role = role.ok_or(Refusal::Ticket(Refused::Unknown))?;
                if self.spent[&role] {
                    Err(Refusal::Ticket(Refused::Spent { at: 7 }))
                } else {
                    Ok((None, role))
                }
            }
            Credential::Resume { resume } => {
                let known = self.known.get(&resume.as_bytes()[0]);
                known.map(|(station, role)| (Some(*station), *role)).ok_or(Refusal::Ticket(Refused::Unknown))
            }
        }
    }
}

impl HostSession for ControlSession {
    fn check(&mut self, credential: &Credential, wish: &Wish) -> Result<Role, Refusal> {
        let (station, role) = self.station(credential)?;
        self.roster.check(station, &wish.name, &wish.hands)?;
        self.checked = Some(credential.clone());
        Ok(role)
    }

    fn diagnose(&mut self, credential: &Credential) -> Result<Diagnosed, Refusal> {
        let ticket = match self.station(credential) {
            Ok((_, role)) => TicketVerdict::LetsIn(role),
            Err(Refusal::Ticket(Refused::Spent { at })) => TicketVerdict::Spent { at },
            Err(refusal) => return Err(refusal),
        };
        Ok(Diagnosed { connection: self.roster.next_connection(), ticket, host_unix_secs: 7 })
    }

    fn admit(
        &mut self,
        credential: &Credential,
        wish: &Wish,
        role: Role,
        _: SimTime,
    ) -> Result<Admitted, Refusal> {
        assert_eq!(self.checked.take().as_ref(), Some(credential), "nobody comes in unchecked");
        let (station, granted) = self.station(credential)?;
        assert!(role <= granted, "{role} is more than {granted}");
        assert!(role.may_operate() || wish.hands.is_empty(), "a watcher serves no hand");
        let station = station.unwrap_or(100 + self.known.len() as u16);
        if let Credential::Ticket { resume, .. } = credential {
            assert_eq!(self.spent.insert(granted, true), Some(false), "a token lets in once");
            self.known.insert(resume.as_bytes()[0], (station, granted));
        }
        let arrival = self.roster.arrive(station, wish.name.clone(), role);
        self.roles.insert(station, role);
        for hand in &wish.hands {
            self.roster.take_hand(station, hand)?;
        }
        Ok(Admitted { station, connection: arrival.connection, role })
    }

    fn offer(&mut self, _: &Admitted, held: Option<HeldScene>) -> Result<SceneOffer, Refusal> {
        let (revision, _) = self.revisions.last_key_value().expect("a revision");
        let known = held.and_then(|held| Some((held, *self.revisions.get(&held.revision.0)?)));
        let known = known.filter(|(held, length)| digest_of(&self.scene[..*length]) == held.digest);
        let (kind, begin) = match known {
            Some((held, length)) => (SceneKind::Missed { since: held.revision }, length),
            None => (SceneKind::Whole, 0),
        };
        let scene: Arc<[u8]> = self.scene[begin..].into();
        let session = SessionInfo {
            scenario_name: PlainText::new("peg-transfer"),
            scenario_text: "schema = 1\n".into(),
            seed: 42,
            architecture: Architecture::ClientServer,
            hands: self.roster.hands().to_vec(),
            stations: self.roster.stations(),
        };
        let manifest = SceneManifest {
            kind,
            revision: Revision(*revision),
            time: SimTime::from_millis(1),
            bytes: scene.len() as u32,
            hash: digest_of(&scene),
            counts: counts_of(&self.scene),
            digest: digest_of(&self.scene),
        };
        Ok(SceneOffer { session, host_unix_secs: 1_795_938_052, manifest, scene })
    }

    fn request(&mut self, station: u16, what: &RequestKind, _: SimTime) -> Result<(), Refusal> {
        assert!(what.is_allowed_to(self.roles[&station]), "{what:?} is more than the role allows");
        match what {
            RequestKind::TakeHand(hand) => self.roster.take_hand(station, hand).map(|_| ()),
            RequestKind::GiveHand(hand) => self.roster.give_hand(station, hand).map(|_| ()),
            RequestKind::Note(note) => {
                assert_eq!(note.check(), Ok(()));
                Ok(())
            }
            RequestKind::PeerTicket { .. } | RequestKind::Repair(_) => Ok(()),
        }
    }

    fn hear(&mut self, station: u16, event: HostEvent<'_>) {
        let role = self.roles[&station];
        assert!(role.may_operate() || !matches!(event, HostEvent::Write(_)), "a watcher writes nothing");
    }
}
