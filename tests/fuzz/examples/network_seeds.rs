//! Writes the part of the corpus that is about networks, of real messages and datagrams.
//!
//! `cargo run --release --example network_seeds` in this folder; what it writes is committed.

use std::path::Path;

use nalgebra::{Isometry3, Vector3};
use trocar_fuzz::control_session::{client_facts, digest_of, host_facts, name, ticket};
use trocar_fuzz::peer_scene::{BODIES, PEER_COLUMNS, PEER_SCENES, sketches};
use trocar_fuzz::replica_scene::{FIRST_DELTA, SCENES, feed};
use trocar_fuzz::{pause_of, push_step};
use trocar_network::compensation::{
    CompensationBlock, ContactModel, EnergyAccount, Method, Payload, WaveIntegrals,
};
use trocar_network::control::{
    ClientControl, ClientMessage, Goodbye, HostMessage, Note, NoteKind, PREAMBLE_BYTES, Ping, PlainText,
    Pong, Refusal, Request, RequestKind, TakeOver,
};
use trocar_network::datagram::{ClockEcho, Header, Kind, PAYLOAD_MAX, encode_hands};
use trocar_network::hand_sample::HandSample;
use trocar_network::haptic::LinkReport;
use trocar_network::itp::packet::CONSOLE_MATRIX_BYTES;
use trocar_network::itp::{Console, ConsoleConfig, ConsoleHand, Dialect, Robot, RobotConfig};
use trocar_network::pairs::{Invitation, TOKEN_BYTES};
use trocar_network::peers::{repair, sketch};
use trocar_network::replication::{Replica, StateDigest, pieces};
use trocar_network::ticket::{ResumeSecret, Role, SecretHash, Token};
use trocar_scene::{
    Commands, Entity, EntityAllocator, Name, Revision, SimTime, Store, SurfacePlace, SurfacePoint, varint,
};

const MS: u64 = 1_000_000;

/// An input that grows step by step.
#[derive(Default)]
struct Input(Vec<u8>);

impl Input {
    fn of(first: &[u8]) -> Self {
        Self(first.to_vec())
    }

    fn step(mut self, what: u8, pause_ms: u64, bytes: &[u8]) -> Self {
        push_step(&mut self.0, what, pause_of(pause_ms * MS), bytes);
        self
    }
}

fn hands() -> Vec<u8> {
    let mut samples = [HandSample::unknown(0), HandSample::unknown(1)];
    samples[0].state.connected = true;
    samples[0].state.pose_in_device.translation.x = 0.01;
    samples[1].wrench.force.z = 1.5;
    samples[1].grabbed = Some((Entity::new(0, 0, 3), 17));
    let mut out = [0; PAYLOAD_MAX];
    let echo = Some(ClockEcho { sent_at: SimTime(5 * MS), held: SimTime(MS) });
    let length = encode_hands(echo, &samples, &mut out).expect("they are valid");
    out[..length].to_vec()
}

fn block(method: Method, payload: Payload) -> Vec<u8> {
    let account = EnergyAccount { given_nj: 1_000_000, balance_nj: -5 };
    let mut bytes = CompensationBlock { method, account, payload }.encode().to_vec();
    // Position, velocity and force, round trip, and steps.
    bytes.extend([0.01_f32, 0.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, -2.0].iter().flat_map(|x| x.to_le_bytes()));
    bytes.extend([40, 0, 0, 0]);
    bytes
}

fn datagram() -> Vec<(&'static str, Input)> {
    let sealed = |kind: Kind, hands: u8, payload: &[u8]| {
        [&[kind as u8, hands][..], &(9 * MS).to_le_bytes(), payload].concat()
    };
    let summed = |kind: Kind, hands: u8, phase: u8, sequence: u64, payload: &[u8]| {
        let sent_at = SimTime(7 * MS);
        let header = Header { kind, phase, hands, connection: 7, sequence, sent_at };
        [&header.encode(), payload].concat()
    };
    let report = LinkReport { newest: 900, expected: 250, received: 240, queueing_us: 300 };
    let session = Input::default()
        .step(6, 1, &[0, 0, 0, 1])
        .step(1, 10, &sealed(Kind::Hands, 2, &hands()))
        .step(6, 1, &[1, 9, 20, 1])
        .step(3, 1, &[])
        .step(4, 5, &[0, 0, 0, 0, 1])
        .step(1, 90, &sealed(Kind::Rows, 0, b"rows"))
        .step(1, 300, &sealed(Kind::Hands, 2, &hands()))
        .step(5, 1, &report.encode())
        .step(8, 1, &[7])
        .step(0, 1, &summed(Kind::Hands, 2, 0, 2, &hands()));
    let mut numbers = Input::default();
    for sequence in [1, 2, 1, 0, u64::MAX, 5_000, 903, 904, u64::MAX - 1, u64::MAX, 1 << 32] {
        numbers = numbers.step(2, 1, &summed(Kind::Hands, 2, 0, sequence, &hands()));
    }
    let phases = Input::default()
        .step(4, 0, &[1, 0, 0, 0, 0])
        .step(2, 1, &summed(Kind::Rows, 0, 1, 1, &[]))
        .step(2, 99, &summed(Kind::RowAcks, 0, 0, 2, &[0; 48]))
        .step(2, 5, &summed(Kind::PathChallenge, 0, 0, 3, &[0; 8]));
    let wave = WaveIntegrals { wave: [1 << 20, -(1 << 20), 0], energy_nj: 77 };
    let contact = ContactModel { normal: Vector3::x(), offset: 0.0, stiffness: 300.0, damping: 1.0 };
    let coupling = Input::default()
        .step(7, 1, &block(Method::Passivity, Payload::None))
        .step(7, 1, &block(Method::WaveVariables, Payload::Wave(wave)))
        .step(7, 1, &block(Method::ModelMediated, Payload::Contact(contact)));
    vec![("session", session), ("numbers", numbers), ("phases", phases), ("coupling", coupling)]
}

fn encoded(message: &impl serde::Serialize) -> Vec<u8> {
    postcard::to_stdvec(message).expect("it encodes")
}

fn notes() -> [NoteKind; 5] {
    let on = SurfacePoint::Triangle { corners: [7, 8, 9], barycentric: [0.25, 0.25, 0.5] };
    let place = SurfacePlace { entity: Entity::new(0, 0, 7), on };
    [
        NoteKind::Pointer(Some(place)),
        NoteKind::Stroke { stroke: 1, colour: [255, 0, 9], width: 0.002, places: vec![place; 3] },
        NoteKind::Label { label: 1, place, text: PlainText::new("vessel") },
        NoteKind::Freeze(true),
        NoteKind::TakeOver { hand: 0, step: TakeOver::Ask },
    ]
}

fn control() -> Vec<(&'static str, Input)> {
    let (operate, mentor) = ([Role::Operate as u8], [Role::Mentor as u8]);
    let join = |role: &[u8]| Input::of(role).step(1, 1, &[]).step(1, 1, &[]).step(1, 1, &[]).step(1, 1, &[]);
    let mut session = join(&mentor).step(7, 1, &[0, 1, 2, 3]).step(8, 1, &[0, 4, 5, 6]).step(1, 1, &[]);
    for what in 1..6 {
        session = session.step(7, 1, &[what, 0]).step(8, 1, &[what.min(3), 0]);
    }
    session = session.step(7, 1, &[7, 1, 2, 3]).step(1, 1, &[]).step(8, 1, &[4]).step(1, 1, &[]);
    for note in notes() {
        let request = [&[1][..], &encoded(&RequestKind::Note(note.clone()))].concat();
        session = session.step(8, 1, &request).step(7, 1, &[&[3][..], &encoded(&note)].concat());
    }
    session =
        session.step(1, 1, &[]).step(1, 1_100, &[]).step(1, 1_100, &[]).step(7, 1, &[6]).step(1, 1, &[]);
    let breaks = join(&operate)
        .step(11, 0, &[9])
        .step(9, 1, &[0])
        .step(1, 100, &[])
        .step(1, 1, &[])
        .step(1, 1, &[])
        .step(9, 1, &[1])
        .step(0, 500, &[])
        .step(9, 0, &[0])
        .step(2, 2_000, &[100])
        .step(2, 1, &[200])
        .step(1, 6_000, &[])
        .step(8, 1, &[7])
        .step(1, 1, &[]);
    // Every message, between two that are in a session.
    let mut frames = join(&operate);
    for message in client_messages() {
        frames = frames.step(10, 0, &encoded(&message)).step(5, 1, &encoded(&message));
    }
    let mut from_host = join(&operate);
    for message in host_messages() {
        from_host = from_host.step(10, 0, &encoded(&message)).step(6, 1, &encoded(&message));
    }
    // What a stranger sends: the bytes of a hello, and of another version.
    let mut station = ClientControl::new(client_facts(Role::Operate), ticket(Role::Operate), SimTime::ZERO);
    station.poll(SimTime::ZERO);
    station.connected(None, SimTime::ZERO).expect("it asked for a stream");
    let hello = station.outgoing().to_vec();
    let mut other = hello.clone();
    other[4 + PREAMBLE_BYTES - 2] = 9;
    let strangers = Input::of(&operate)
        .step(0, 1, &[])
        .step(3, 1, &hello[..20])
        .step(3, 1, &hello[20..])
        .step(9, 1, &[0])
        .step(1, 60, &[])
        .step(9, 1, &[0])
        .step(0, 200, &[])
        .step(3, 1, &other)
        .step(2, 1, &[255]);
    vec![
        ("session", session),
        ("breaks", breaks),
        ("frames", frames),
        ("from_host", from_host),
        ("strangers", strangers),
    ]
}

fn invitation() -> Invitation {
    Invitation { token: [7; TOKEN_BYTES], door: b"198.51.100.7:40001".to_vec() }
}

/// A peer asks for the first body.
fn repair_request() -> repair::RepairRequest {
    repair::request(&PEER_SCENES[1], &PEER_COLUMNS, BODIES[0])
}

fn client_messages() -> Vec<ClientMessage<'static>> {
    let sent_at = SimTime(u64::MAX);
    vec![
        ClientMessage::Request(Request { number: u32::MAX, what: RequestKind::TakeHand(name("right")) }),
        ClientMessage::Request(Request { number: 1, what: RequestKind::GiveHand(name("left")) }),
        ClientMessage::Request(Request {
            number: 2,
            what: RequestKind::PeerTicket { to: 3, ticket: invitation().to_bytes() },
        }),
        ClientMessage::Request(Request { number: 3, what: RequestKind::Repair(repair_request()) }),
        ClientMessage::Write((&[1, 2, 3][..]).into()),
        ClientMessage::Ping(Ping { sent_at }),
        ClientMessage::Pong(Pong { ping_sent_at: sent_at, received_at: sent_at, sent_at }),
        ClientMessage::Rekeyed { phase: 1 },
        ClientMessage::Joined { revision: Revision(u64::MAX), digest: [9; 32] },
        ClientMessage::Goodbye(Goodbye::TooSlow(PlainText::new("slow"))),
    ]
}

fn host_messages() -> Vec<HostMessage<'static>> {
    let facts = host_facts();
    let hand = PlainText::new("left");
    vec![
        HostMessage::Delta((&[1, 2, 3][..]).into()),
        HostMessage::Roster(Vec::new()),
        HostMessage::HandServed { hand: 0, station: None, at: SimTime(u64::MAX) },
        HostMessage::Note(Note { station: 1, at: SimTime(1), what: NoteKind::Erase { stroke: 1 } }),
        HostMessage::PeerTicket { from: 1, ticket: b"trocar1".to_vec() },
        HostMessage::Answer { request: Some(1), refusal: Some(Refusal::HandNotServed { hand }) },
        HostMessage::Ping(Ping { sent_at: SimTime(7) }),
        HostMessage::Repair((&[7, 0, 0, 0, 0, 0, 0, 0, 0][..]).into()),
        HostMessage::Rekey { phase: 1 },
        HostMessage::ScenePart { offset: 0, bytes: (&[0; 8][..]).into() },
        HostMessage::Refused(Refusal::OtherRegistry(facts.components)),
        HostMessage::Goodbye(Goodbye::Broken(PlainText::new("nonsense"))),
    ]
}

fn peers() -> Vec<(&'static str, Input)> {
    let [owner, peer] = &*PEER_SCENES;
    let mut asks = Input::default().step(2, 0, &[]);
    for number in 1..4 {
        for payload in sketch::write(number, &sketches(owner, number)) {
            asks = asks.step(0, 1, &payload);
        }
        asks = asks.step(1, 1, &[number as u8, 9, 1]);
    }
    asks = asks.step(3, 1, &[]).step(2, 10, &[]).step(1, 1, &[8, 0, 0]).step(3, 3_000, &[]);
    let mut repairs = Input::default();
    for body in BODIES.iter() {
        let asked = repair::request(peer, &PEER_COLUMNS, *body);
        repairs = repairs.step(6, 1, &encoded(&asked));
        if let Some(answer) = repair::answer(owner, &PEER_COLUMNS, &asked) {
            repairs = repairs.step(4, 1, &answer).step(5, 1, &[&[1], &answer[8..]].concat());
        }
    }
    let invitations = Input::default().step(7, 1, &invitation().to_bytes());
    // A number beyond all counting, before and after.
    let mut numbers = Input::default().step(2, 0, &[]);
    for number in [u64::MAX, 0, u64::MAX - 1, u64::MAX] {
        for payload in sketch::write(number, &sketches(owner, number)[..2]) {
            numbers = numbers.step(0, 1, &payload);
        }
    }
    numbers = numbers.step(3, 1, &[]);
    vec![("asks", asks), ("repairs", repairs), ("invitations", invitations), ("numbers", numbers)]
}

fn replica() -> Vec<(&'static str, Input)> {
    let registry = SCENES[0].registry().clone();
    let mut host = feed();
    let first = host.delta(SimTime::ZERO, &SCENES[0]).expect("it encodes").expect("there is much");
    // The station confirms, so that rows of the next scene go in datagrams.
    let mut station = Replica::new(trocar_fuzz::replica_scene::COLUMNS.clone());
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(2, 9));
    station.apply(&first, &mut commands).expect("it is the host's");
    commands.seal();
    let mut store = Store::new(registry);
    store.apply(&mut commands, SimTime::ZERO);
    let mut acknowledgement = Vec::new();
    station.write_acknowledgement(&mut acknowledgement);
    host.acknowledge(SimTime(MS), &acknowledgement).expect("it is the station's");
    let mut rows = Vec::new();
    assert!(host.datagram(SimTime(20 * MS), &SCENES[1], &mut rows), "something moves");
    let changes = host.delta(SimTime(60 * MS), &SCENES[1]).expect("it encodes").expect("there is something");
    let digest = station.digest(store.view()).expect("it encodes");
    let mut digest_bytes = Vec::new();
    digest.write(&mut digest_bytes);
    let mut last = Vec::new();
    varint::write(u64::MAX, &mut last);
    last.extend_from_slice(&rows[1..]);
    let mut far = Vec::new();
    StateDigest { revision: Revision(u64::MAX), chunks: [(0, 1), (u64::MAX, 2)].into() }.write(&mut far);
    let joins = Input::of(&[0])
        .step(0, 1, &FIRST_DELTA)
        .step(3, 1, &rows)
        .step(3, 1, &rows)
        .step(5, 1, &[])
        .step(0, 1, &changes)
        .step(9, 1, &[]);
    let mut in_pieces = Input::of(&[0]);
    for piece in FIRST_DELTA.chunks(FIRST_DELTA.len().div_ceil(2)).scan(0, |begin, body| {
        let head = [(FIRST_DELTA.len() as u64).to_le_bytes(), (*begin as u64).to_le_bytes()].concat();
        *begin += body.len();
        Some([head, body.to_vec()].concat())
    }) {
        in_pieces = in_pieces.step(2, 1, &piece);
    }
    for piece in pieces::split(&changes) {
        in_pieces = in_pieces.step(2, 1, &piece);
    }
    let head = changes.iter().position(|byte| *byte == 1).map_or(2, |at| at + 1);
    let since =
        Input::of(&[1]).step(1, 1, &changes[head..]).step(8, 20, &[0]).step(8, 60, &[1]).step(9, 1, &[]);
    // A name that is put and removed, what is put of an entity that goes, and events beyond all counting.
    let registry = SCENES[0].registry();
    let name = registry.id::<Name>().expect("it is there").0 as u8;
    let organ = SCENES[0].find("organ").expect("it is there");
    let (mut an_organ, mut a_writer) = (Vec::new(), Vec::new());
    for (entity, out) in [(organ, &mut an_organ), (Entity::of_writer(1, 77), &mut a_writer)] {
        varint::write(varint::zigzag(entity.to_bits().cast_signed()), out);
    }
    let put = |entity: &[u8]| [&[1, name, 1][..], entity, &[0, 1, b'x', 0, 0]].concat();
    let events = [&[9, 0, 0, 0, 0, 0][..], &[0xff; 9], &[1, 1, 1, b'e', 0, 0], &[0; 9]].concat();
    let contradictions = Input::of(&[1])
        .step(1, 1, &[&[2, 0, 0, 0, 1, name, 1][..], &an_organ, &put(&an_organ)].concat())
        .step(1, 1, &[&[2, 0, 1][..], &a_writer, &[0, 0, 0, 0, 0]].concat())
        .step(1, 1, &[&[3, 0, 0, 1][..], &a_writer, &[0], &put(&a_writer)].concat())
        .step(1, 1, &events)
        .step(1, 1, &events)
        .step(9, 1, &[]);
    let datagrams = Input::of(&[1])
        .step(4, 1, &[&[1][..], &rows[3..]].concat())
        .step(3, 1, &last)
        .step(8, 20, &[0])
        .step(5, 1, &[])
        .step(6, 1, &acknowledgement)
        .step(6, 1, &[0xff; 48])
        .step(7, 1, &digest_bytes)
        .step(7, 1, &far)
        .step(9, 1, &[]);
    vec![
        ("joins", joins),
        ("in_pieces", in_pieces),
        ("since", since),
        ("contradictions", contradictions),
        ("datagrams", datagrams),
    ]
}

fn itp() -> Vec<(&'static str, Input)> {
    let packets = |number: [u8; 2], dialect: Dialect| {
        let config = ConsoleConfig { dialect, ..ConsoleConfig::default() };
        let mut console = Console::new(config).expect("it is valid");
        let mut robot = Robot::new(RobotConfig { dialect, ..RobotConfig::default() }).expect("it is valid");
        let mut input = Input::of(&number);
        for k in 0..4 {
            let pose_in_console = Isometry3::translation(1e-4 * f64::from(k), 0.0, 0.0);
            let hand = ConsoleHand { pose_in_console, jaw: 0.1, squeeze: 0.5, buttons: 1 };
            let packet = console.command(&[hand, hand], k > 0);
            let mut out = [0; CONSOLE_MATRIX_BYTES];
            input = input.step(k as u8 % 2, 1, packet.encode(&mut out));
            input = input.step(2, 1, &robot.reply(&[Vector3::x(); 2], 5).encode());
            input = input.step(3, 1, &[&(1e-4 * f64::from(k)).to_le_bytes()[..], &[0; 8], &[1]].concat());
        }
        input.step(5, 200, &[]).step(4, 1, &[1]).step(4, 1, &[0]).step(3, 1, &[0; 17])
    };
    vec![("raven", packets([16, 5], Dialect::RAVEN)), ("raven_sim", packets([15, 2], Dialect::RAVEN_SIM))]
}

fn tickets() -> Vec<(&'static str, Vec<u8>)> {
    let with = |kind: u8, bytes: &[u8]| [&[kind], bytes].concat();
    let mut content = vec![1];
    content.extend(&1_795_938_052_u64.to_le_bytes()[..5]);
    content.extend(digest_of(b"a certificate"));
    content.extend(b"sixteen bytes, y");
    content.extend(b"\x05liver\x04");
    content.extend([0, 192, 0, 2, 1, 0xe6, 0x0f]);
    content.extend([&[1][..], &[0x20, 1, 0xd, 0xb8], &[0; 11], &[1, 0xe6, 0x0f]].concat());
    content.extend([&[2][..], &[0xfe, 0x80], &[0; 13], &[1, 4], b"eth0", &[0xe6, 0x0f]].concat());
    content.extend(b"\x03\x0cor-3.example\xe6\x0f");
    let (token, resume) = (Token::from_bytes([1; 16]).hash(), ResumeSecret::from_bytes([3; 32]).hash());
    type Entry =
        (u32, Role, &'static str, u64, u64, SecretHash, Option<(u64, u16, SecretHash, u64)>, Option<u64>);
    let entries: [Entry; 3] = [
        (1, Role::Operate, "Ana", 100, 9_000, token, None, None),
        (2, Role::Watch, "Bo", 100, 9_000, resume, Some((200, 4, resume, 50_000)), None),
        (5, Role::Mentor, "Cy", 100, u64::MAX, resume, None, Some(300)),
    ];
    let book = [&1_000_u16.to_le_bytes()[..], &encoded(&(5_u32, entries.to_vec()))].concat();
    vec![
        ("name", with(0, "Öl-Leber 山田".as_bytes())),
        ("address", with(0, b"[fe80::1%eth0]:4070")),
        ("dns", with(0, b"or-3.example.org:4070")),
        ("content", with(1, &content)),
        ("delays", with(2, b"# measured\n0.070\n\n0.080\n1e-9\n60\n")),
        ("times", with(2, b"time,delay\n0,0.1\n0.5,0.2\n1.0,0.3\n")),
        ("short_steps", with(2, b"0,0.1\n1e-10,0.1\n2e-10,0.1\n")),
        ("short", with(3, b"trcrbook\x01\0\0\0\xff\xff\xff\xff\0\0\0\0")),
        ("content_of_book", with(4, &book)),
        ("book", with(5, &book)),
    ]
}

fn main() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let save = |target: &str, name: &str, bytes: &[u8]| {
        let folder = corpus.join(target);
        std::fs::create_dir_all(&folder).expect("the corpus can be written to");
        std::fs::write(folder.join(name), bytes).expect("the corpus can be written to");
    };
    let inputs = [
        ("datagram", datagram()),
        ("control", control()),
        ("replica", replica()),
        ("peers", peers()),
        ("itp", itp()),
    ];
    for (target, inputs) in inputs {
        inputs.iter().for_each(|(name, input)| save(target, name, &input.0));
    }
    tickets().iter().for_each(|(name, bytes)| save("ticket", name, bytes));
}
