//! Joins: who comes in with what, and who does not.

use std::sync::Arc;

use proptest::prelude::*;
use ring::rand::SystemRandom;
use trocar_scene::{Commands, EntityAllocator, Registry, Revision, SimTime, Snapshot, Store};

use super::client::{ClientFacts, ClientState};
use super::component_list::{ComponentList, ListedComponent};
use super::credential::Credential;
use super::diagnosis::Diagnosed;
use super::error::{ControlError, Goodbye, Refusal};
use super::frame::{FrameDecoder, FrameError, WIRE_VERSION, preamble_of};
use super::host::{HostControl, HostState, PACE_BYTES};
use super::host_session::{Admitted, HostEvent, HostSession, SceneOffer};
use super::manifest::{HeldScene, SceneCounts, SceneKind, SceneManifest};
use super::message::{ClientMessage, HostMessage, RequestKind, SCENE_PART_MAX, Wish};
use super::outbox::Outbox;
use super::plain_text::PlainText;
use super::scene_assembly::SceneAssembly;
use super::session_testing::{Pair, TestSession, components, ms, name, ticket, wish};
use crate::ticket::{Admission, Identity, Offer, Refused, ResumeSecret, Role, TicketBook};

#[test]
fn a_station_joins_with_its_hand_and_gets_the_scene_and_what_changes_afterwards() {
    let mut pair = Pair::operating();
    pair.join();
    assert_eq!(pair.scene, pair.session.scene);
    let welcome = pair.client.welcome().expect("a welcome").clone();
    assert_eq!((welcome.station, welcome.role), (100, Role::Operate));
    assert_eq!(welcome.session.hands[0].station, Some(100));
    assert_eq!(welcome.session.stations[0].hands, [0]);
    assert_eq!(pair.session.heard, ["100: Joined(Revision(1))"]);
    let now = pair.now;
    for part in [&[1, 2][..], &[3], &[4, 5, 6]] {
        pair.host().send_delta(part, now).expect("it runs");
    }
    pair.client.write(&[9, 9], now).expect("it runs");
    pair.step();
    assert_eq!(
        (pair.deltas.as_slice(), pair.session.written.as_slice()),
        (&[1, 2, 3, 4, 5, 6][..], &[9, 9][..])
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn a_join_is_the_same_however_the_streams_are_split(
        down in 1_usize..700, up in 1_usize..200, entities in 0_usize..3_000,
    ) {
        let mut pair = Pair::new(TestSession::new(entities), ticket(1), wish("Ana", &["right"]));
        (pair.to_client.1, pair.to_host.1) = (down, up);
        pair.join();
        prop_assert_eq!(&pair.scene, &pair.session.scene);
        prop_assert_eq!(pair.connections, 1);
    }
}

#[test]
fn a_join_byte_by_byte_is_a_join() {
    let mut pair = Pair::operating();
    (pair.to_client.1, pair.to_host.1) = (1, 1);
    pair.join();
    assert_eq!(pair.scene, pair.session.scene);
}

#[test]
fn a_host_and_a_station_of_other_versions_tell_each_other_which() {
    // A newer station at this host.
    let mut session = TestSession::new(1);
    let facts = Arc::clone(&Pair::operating().facts);
    let mut host = HostControl::new(facts, SimTime::ZERO);
    let mut opening = preamble_of(WIRE_VERSION + 1).to_vec();
    opening.extend(b"what nobody here can read");
    let mut stream = (opening.len() as u32).to_le_bytes().to_vec();
    stream.extend(opening);
    host.receive(&stream, ms(1), &mut session);
    let newer =
        ControlError::Frame(FrameError::OtherVersion { theirs: WIRE_VERSION + 1, ours: WIRE_VERSION });
    assert_eq!(host.error(), Some(&newer));
    assert_eq!(session.redeemed, 0);
    // It is answered with this host's version, and nothing else.
    assert_eq!(&host.outgoing()[4..], preamble_of(WIRE_VERSION));
    // This station at an older host.
    let mut pair = Pair::operating();
    pair.say_hello();
    pair.deliver(&[8, 0, 0, 0]);
    pair.deliver(&preamble_of(0));
    let error = pair.end();
    assert_eq!(error, ControlError::Frame(FrameError::OtherVersion { theirs: 0, ours: WIRE_VERSION }));
    assert!(error.to_string().contains("the other one is older"), "{error}");
    assert_eq!(error.exit_class().code(), 76);
}

#[test]
fn a_station_with_other_components_is_told_their_names_and_keeps_its_ticket() {
    let mut ours = components().components().to_vec();
    ours[1].schema = 77;
    ours.push(ListedComponent { name: PlainText::new("laser"), schema: 3 });
    let facts = ClientFacts {
        program: PlainText::new("0.2.0"),
        components: ComponentList::new(ours),
        scenario: None,
        wish: wish("Ana", &[]),
    };
    let mut pair = Pair::with(TestSession::new(3), ticket(1), facts);
    let text = pair.end().to_string();
    assert!(text.contains("only this program has laser; these have other fields there: tissue"), "{text}");
    assert_eq!(pair.session.redeemed, 0, "the ticket is good for another try");
}

#[test]
fn what_speaks_against_a_station_is_said_before_its_ticket_is_spent() {
    let facts = |role, hands: &[&str], scenario| ClientFacts {
        program: PlainText::new("0.1.0"),
        components: components(),
        scenario,
        wish: Wish { role, ..wish("Ana", hands) },
    };
    for (number, facts, expected, code) in [
        (1, facts(None, &["third"], None), "the session has no hand 'third'; valid are left, right", 2),
        (1, facts(None, &["right"], None), "the hand 'right' is taken by 'Bo'", 75),
        (
            1,
            facts(Some(Role::Mentor), &[], None),
            "the ticket is for the role operate, and mentor was asked for",
            77,
        ),
        (2, facts(None, &["left"], None), "a station of the role watch may not serve a hand", 77),
        (1, facts(None, &[], Some([6; 32])), "the session's scenario 'peg-transfer' is another one", 4),
        (9, facts(None, &[], None), "the host does not know this ticket", 77),
    ] {
        let mut session = TestSession::new(3);
        session.roster.arrive(7, name("Bo"), Role::Operate);
        session.roster.take_hand(7, &name("right")).expect("free");
        let mut pair = Pair::with(session, ticket(number), facts);
        let error = pair.end();
        assert!(error.to_string().starts_with(expected), "{error}");
        assert_eq!((error.exit_class().code(), pair.session.redeemed), (code, 0), "{error}");
        assert!(pair.carried < 400, "no byte of the scene: {} bytes", pair.carried);
    }
}

#[test]
fn a_spent_expired_or_withdrawn_ticket_lets_nobody_in_and_says_why() {
    for (refused, expected) in [
        (Refused::Spent { at: 1_795_938_052 }, "the ticket was used already, at 2026-11-29"),
        (Refused::Expired { expired_at: 1_000, now: 4_600 }, "compare the clocks"),
        (Refused::Revoked { at: 7 }, "the host withdrew this ticket"),
    ] {
        let mut session = TestSession::new(3);
        session.tickets.insert(1, (Role::Operate, Some(refused)));
        let mut pair = Pair::new(session, ticket(1), wish("Ana", &[]));
        let error = pair.end();
        assert!(matches!(&error, ControlError::Refused { refusal: Refusal::Ticket(_), .. }), "{error:?}");
        assert!(error.to_string().contains(expected), "{error}");
        assert_eq!(pair.connections, 1, "a refusal is final");
    }
}

#[test]
fn a_scene_that_is_not_as_announced_is_found_by_the_station() {
    // The hash.
    let mut session = TestSession::new(1_000);
    session.tamper = |offer| offer.manifest.hash[31] ^= 1;
    let mut pair = Pair::new(session, ticket(1), wish("Ana", &[]));
    let error = pair.end();
    assert!(
        matches!(error, ControlError::Lost(..)) && error.to_string().contains("arrived damaged"),
        "{error}"
    );
    // The counts.
    let mut session = TestSession::new(1_000);
    session.tamper = |offer| offer.manifest.counts.entities += 2;
    let mut pair = Pair::new(session, ticket(1), wish("Ana", &[]));
    assert_eq!(pair.end().to_string(), "the scene is not complete: entities: 1000 instead of 1002");
    // The digest; the host is told.
    let mut session = TestSession::new(1_000);
    session.tamper = |offer| offer.manifest.digest[0] ^= 1;
    let mut pair = Pair::new(session, ticket(1), wish("Ana", &[]));
    let told = pair.host_end();
    assert!(
        matches!(&told, ControlError::Goodbye(Goodbye::Broken(text)) if text.as_str().contains("digests differ"))
    );
    assert_eq!(pair.end(), ControlError::SceneDigest { revision: 1 });
    assert!(pair.session.heard.is_empty(), "it never joined");
}

#[test]
fn a_station_that_builds_another_scene_is_not_let_into_the_session() {
    let mut pair = Pair::operating();
    pair.builds = false;
    pair.run_until(|pair| pair.host.as_ref().is_some_and(|host| host.state() == HostState::Awaiting));
    let now = pair.now;
    let mut outbox = Outbox::default();
    outbox.push(&ClientMessage::Joined { revision: Revision(1), digest: [0; 32] }, false, now).expect("room");
    let host = pair.host.as_mut().expect("a connection");
    host.receive(outbox.waiting(), now, &mut pair.session);
    assert_eq!(host.error(), Some(&ControlError::SceneDigest { revision: 1 }));
    assert!(matches!(pair.end(), ControlError::Goodbye(Goodbye::Broken(_))));
}

#[test]
fn a_station_that_cannot_build_the_scene_says_why_at_both_ends() {
    let mut pair = Pair::operating();
    pair.builds = false;
    pair.run_until(|pair| pair.client.state() == ClientState::Building);
    pair.client.scene_failed(Revision(1), "no memory for the liver", pair.now);
    let told = pair.host_end().to_string();
    assert!(told.contains("no memory for the liver"), "{told}");
}

fn scene_of(entities: u32) -> Snapshot {
    let registry = Registry::standard();
    let mut store = Store::new(Arc::clone(&registry));
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    for number in 0..entities {
        let entity = commands.spawn();
        commands.put(entity, trocar_scene::components::Name(format!("peg {number}")));
    }
    commands.seal();
    store.apply(&mut commands, ms(1));
    store.snapshot()
}

#[test]
fn a_scene_of_ten_thousand_entities_is_sent_in_parts_that_never_crowd_the_outbox_and_arrives_whole() {
    let snapshot = scene_of(10_000);
    let mut bytes = Vec::new();
    snapshot.encode(&mut bytes).expect("it encodes");
    // Two million bytes of meshes come along, as in a scene with organs.
    bytes.extend((0..2_000_000_u32).map(|number| (number * 7) as u8));
    let mut session = TestSession::new(0);
    session.scene = bytes;
    session.scene.resize(session.scene.len().next_multiple_of(8), 0);
    session.revisions.insert(1, session.scene.len());
    let mut pair = Pair::new(session, ticket(2), wish("Ana", &[]));
    // 10 Mbit/s.
    pair.to_client = (1_250, 1_250);
    pair.join();
    assert_eq!(pair.scene, pair.session.scene);
    assert!(pair.waited <= PACE_BYTES + SCENE_PART_MAX + 2_000, "{} bytes waited", pair.waited);
    let (loaded, _) = Store::load(snapshot.registry(), &pair.scene).expect("a scene");
    assert_eq!(SceneCounts::of(loaded.view()).compare(&SceneCounts::of(&snapshot)), Ok(()));
    assert!(SceneCounts::of(&snapshot).entities >= 10_000);
    let seconds = pair.now.as_secs_f64();
    assert!(seconds < 1.05 * pair.carried as f64 / 1.25e6, "{seconds} s for {} bytes", pair.carried);
}

#[test]
fn while_a_large_scene_goes_out_on_a_slow_link_the_host_still_answers_pings() {
    let mut pair = Pair::new(TestSession::new(400_000), ticket(2), wish("Ana", &[]));
    // 1 Mbit/s: the scene takes 26 s.
    pair.to_client = (125, 125);
    pair.run(ms(20_000));
    assert_eq!((pair.client.state(), pair.connections), (ClientState::Loading, 1));
    let round_trip = pair.client.round_trip().expect("answers");
    assert!(round_trip < ms(1_500), "{round_trip}");
    pair.join();
    assert_eq!(pair.scene, pair.session.scene);
}

#[test]
fn an_announced_scene_costs_no_memory_before_it_comes() {
    let manifest = SceneManifest {
        kind: SceneKind::Whole,
        revision: Revision(1),
        time: SimTime::ZERO,
        bytes: super::manifest::SCENE_BYTES_MAX,
        hash: [0; 32],
        counts: SceneCounts::default(),
        digest: [0; 32],
    };
    assert_eq!(manifest.check(), Ok(()));
    let mut assembly = SceneAssembly::new(manifest.clone());
    assembly.take(0, &[1; 10]).expect("a part");
    assert_eq!((assembly.arrived(), assembly.is_complete()), (10, false));
    let beyond = SceneManifest { bytes: super::manifest::SCENE_BYTES_MAX + 1, ..manifest };
    assert!(beyond.check().is_err());
}

#[test]
fn the_answer_to_a_stranger_is_one_refusal_and_nothing_else() {
    let mut pair = Pair::new(TestSession::new(100), ticket(9), wish("Eve", &[]));
    let (hello, now) = (pair.say_hello(), pair.now);
    let mut host = HostControl::new(Arc::clone(&pair.facts), now);
    host.receive(&hello, now, &mut pair.session);
    let mut answer = host.outgoing();
    let mut decoder = FrameDecoder::new(usize::MAX);
    let frame = decoder.next_frame(&mut answer).expect("a frame").expect("one").to_vec();
    let refused =
        HostMessage::decode(super::frame::after_preamble(&frame).expect("ours")).expect("a message");
    assert_eq!(refused, HostMessage::Refused(Refusal::Ticket(Refused::Unknown)));
    assert_eq!(decoder.next_frame(&mut answer), Ok(None));
    assert!(pair.session.roster.stations().is_empty());
}

/// A session whose tickets are those of a real book.
struct BookSession {
    inner: TestSession,
    book: TicketBook,
    unix_secs: u64,
}

impl HostSession for BookSession {
    fn check(&mut self, credential: &Credential, wish: &Wish) -> Result<Role, Refusal> {
        // On a copy, so that nothing is spent.
        let admission = redeem(&mut self.book.clone(), credential, self.unix_secs)?;
        self.inner.roster.check(Some(admission.station), &wish.name, &wish.hands)?;
        Ok(admission.role)
    }

    fn admit(
        &mut self,
        credential: &Credential,
        wish: &Wish,
        role: Role,
        _: SimTime,
    ) -> Result<Admitted, Refusal> {
        let admission = redeem(&mut self.book, credential, self.unix_secs)?;
        let arrival = self.inner.roster.arrive(admission.station, wish.name.clone(), role);
        Ok(Admitted { station: admission.station, connection: arrival.connection, role })
    }

    fn diagnose(&mut self, credential: &Credential) -> Result<Diagnosed, Refusal> {
        self.inner.diagnose(credential)
    }

    fn offer(&mut self, admitted: &Admitted, held: Option<HeldScene>) -> Result<SceneOffer, Refusal> {
        self.inner.offer(admitted, held)
    }

    fn request(&mut self, station: u16, what: &RequestKind, now: SimTime) -> Result<(), Refusal> {
        self.inner.request(station, what, now)
    }

    fn hear(&mut self, station: u16, event: HostEvent<'_>) {
        self.inner.hear(station, event);
    }
}

fn redeem(book: &mut TicketBook, credential: &Credential, now: u64) -> Result<Admission, Refusal> {
    match credential {
        Credential::Ticket { token, resume } => book.redeem(token, 3, resume, now),
        Credential::Resume { resume } => book.resume(resume, now),
    }
    .map_err(Refusal::Ticket)
}

#[test]
fn with_a_real_ticket_book_a_lost_answer_costs_no_second_ticket_and_a_stranger_gets_no_profit_from_a_used_one()
 {
    let now = 1_795_938_052;
    let mut book = TicketBook::new(Identity::create(&name("Saal 3")).expect("an identity"));
    let offer = Offer {
        role: Role::Watch,
        person: name("Ana"),
        expires: now + 60,
        session: name("liver"),
        addresses: vec!["192.0.2.1:4070".parse().expect("an address")],
    };
    let (_, issued) = book.issue(offer, now, &SystemRandom::new()).expect("a ticket");
    let mut session = BookSession { inner: TestSession::new(3), book, unix_secs: now };
    let facts = Arc::clone(&Pair::operating().facts);
    let mut say = |secret: u8, unix_secs| {
        session.unix_secs = unix_secs;
        let credential = Credential::Ticket {
            token: issued.token().clone(),
            resume: ResumeSecret::from_bytes([secret; 32]),
        };
        let hello = Pair::new(TestSession::new(3), credential, wish("Ana", &[])).say_hello();
        let mut host = HostControl::new(Arc::clone(&facts), ms(1));
        host.receive(&hello, ms(1), &mut session);
        (host.state(), host.error().cloned())
    };
    assert_eq!(say(1, now + 5).0, HostState::Sending);
    // The answer is lost, and the station says the same again, even after the ticket's expiry.
    assert_eq!(say(1, now + 3_600).0, HostState::Sending);
    // Who found the ticket in a bin has another secret.
    let (state, error) = say(2, now + 6);
    assert_eq!(state, HostState::Ended);
    assert!(error.expect("refused").to_string().contains("was used already"));
}
