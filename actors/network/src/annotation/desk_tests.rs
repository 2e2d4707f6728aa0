//! What a person does at a station, as notes: each once, in order, at the rate that a link bears.

use std::sync::Arc;

use trocar_devices::Pedals;
use trocar_scene::{
    Commands, DeviceState, Entity, EntityAllocator, Hand, HandOverStep, MENTOR_DEEDS_MAX, MentorAnswer,
    MentorDeed, MentorInput, PersonInput, Pose, Registry, Side, Signature, SimTime, Store, SurfacePlace,
    SurfacePoint, TakeOverRequest, TakeOverStep,
};

use super::{DeskOwner, MentorDesk};
use crate::control::{HandInfo, NoteKind, TakeOver};
use crate::hands_link::HOST;
use crate::ticket::Role;

const STATION: u16 = 3;

struct Station {
    store: Store,
    out: Commands,
    desk: MentorDesk,
    window: Entity,
    hands: Vec<HandInfo>,
    /// The station's number, and its own devices' pedals, if it is the host.
    number: u16,
    pedals: Vec<(u8, Pedals)>,
    input: MentorInput,
    role: Option<Role>,
    is_heard: bool,
    now: SimTime,
}

impl Station {
    fn new() -> Self {
        let registry = Registry::standard();
        let mut out = Commands::new(registry.clone(), EntityAllocator::new(STATION, 4));
        let (window, hand) = (out.spawn(), out.spawn());
        out.put(
            hand,
            Hand { side: Side::Left, instrument: hand, world_from_device: Pose::default(), scale: 1.0 },
        );
        let name = "left".parse().expect("a name");
        let hands = vec![HandInfo { number: 1, name, entity: hand, station: Some(STATION) }];
        let store = Store::new(registry);
        let input = MentorInput { source: 1, first: 1, ..MentorInput::default() };
        let role = Some(Role::Mentor);
        let desk = MentorDesk::of(&store.snapshot(), out.me());
        let now = SimTime::from_millis(1_000);
        let (number, pedals, is_heard) = (STATION, Vec::new(), true);
        let mut station =
            Self { store, out, desk, window, hands, number, pedals, input, role, is_heard, now };
        station.write(|_, _| ());
        station
    }

    fn write(&mut self, write: impl FnOnce(&mut Commands, Entity)) {
        let hand = self.hands[0].entity;
        write(&mut self.out, hand);
        self.out.put(self.window, self.input.clone());
        self.out.seal();
        assert_eq!(self.out.error(), None);
        self.store.apply(&mut self.out, self.now);
        self.out.clear();
    }

    /// A tick of the network's actor; the window takes the answer in.
    fn tick(&mut self, millis: u64) -> Vec<NoteKind> {
        self.now += SimTime::from_millis(millis);
        let owner = DeskOwner {
            station: self.number,
            role: self.role,
            is_heard: self.is_heard,
            hands: &self.hands,
            pedals: &self.pedals,
        };
        let notes = self.desk.take(self.now, &self.store.snapshot(), &owner);
        self.desk.show(self.out.me(), &mut self.out);
        let me = self.out.me();
        self.write(|_, _| ());
        let answer = self.store.view().get::<MentorAnswer>(me).cloned().expect("it answers");
        self.input.forget_taken(&answer);
        self.write(|_, _| ());
        notes
    }

    fn answer(&self) -> &MentorAnswer {
        MentorAnswer::of(self.store.view()).expect("it answers")
    }

    fn does(&mut self, deed: MentorDeed) {
        assert!(self.input.add(deed));
        self.write(|_, _| ());
    }

    fn points(&mut self, weight: Option<f32>) {
        self.input.pointer = weight.map(place);
        self.write(|_, _| ());
    }
}

fn place(weight: f32) -> SurfacePlace {
    let barycentric = [weight, 1.0 - weight, 0.0];
    SurfacePlace {
        entity: Entity::new(0, 0, 7),
        on: SurfacePoint::Triangle { corners: [0, 1, 2], barycentric },
    }
}

fn erase(stroke: u32) -> MentorDeed {
    MentorDeed::Erase { stroke }
}

fn erased(notes: &[NoteKind]) -> Vec<u32> {
    let number = |note: &NoteKind| match note {
        NoteKind::Erase { stroke } => *stroke,
        note => panic!("{note:?}"),
    };
    notes.iter().map(number).collect()
}

#[test]
fn a_pointer_is_told_thirty_times_a_second_at_most_and_its_end_too() {
    let mut station = Station::new();
    assert!(station.tick(100).is_empty(), "who never points need not say so");
    let mut told = 0;
    for step in 0..1_000 {
        station.points(Some(step as f32 * 1e-3));
        told += station.tick(1).len();
    }
    assert!((28..=30).contains(&told), "{told}");
    station.points(None);
    assert_eq!(station.tick(40), [NoteKind::Pointer(None)]);
    assert!(station.tick(1_000).is_empty());
    // After a break the host may know it otherwise.
    station.points(Some(0.5));
    station.tick(100);
    station.is_heard = false;
    assert!(station.tick(100).is_empty());
    station.is_heard = true;
    assert_eq!(station.tick(100), [NoteKind::Pointer(Some(place(0.5)))]);
}

#[test]
fn every_deed_is_told_once_in_order_and_no_more_than_thirty_a_second() {
    let mut station = Station::new();
    let (mut told, mut next) = (Vec::new(), 0);
    for _ in 0..1_000 {
        while station.input.add(erase(next)) {
            next += 1;
        }
        station.write(|_, _| ());
        told.extend(erased(&station.tick(4)));
    }
    let expected = 32 + 4 * 30;
    assert!(told.len().abs_diff(expected) <= 1, "{} {expected}", told.len());
    assert!(told.iter().copied().eq(0..told.len() as u32));
    assert!(station.input.deeds.len() >= MENTOR_DEEDS_MAX - 1, "the others wait");
}

#[test]
fn a_desk_that_is_built_anew_repeats_nothing_and_a_new_window_begins_anew() {
    let mut station = Station::new();
    let before = station.input.clone();
    (0..3).for_each(|stroke| station.does(erase(stroke)));
    assert_eq!(erased(&station.tick(4)), [0, 1, 2]);
    // The window has not heard yet that they were taken, when the actor dies.
    let window = station.input.clone();
    station.input = MentorInput { deeds: Arc::new((0..4).map(erase).collect()), ..before };
    station.write(|_, _| ());
    station.desk = MentorDesk::of(&station.store.snapshot(), station.out.me());
    assert_eq!(erased(&station.tick(4)), [3]);
    assert_ne!(window.first, station.input.first);
    station.input = MentorInput { source: 2, first: 1, ..MentorInput::default() };
    station.does(erase(9));
    assert_eq!(erased(&station.tick(4)), [9]);
    assert_eq!((station.answer().source, station.answer().taken), (2, 1));
}

#[test]
fn what_a_role_may_not_is_refused_at_the_station_in_words() {
    let mut station = Station::new();
    station.role = Some(Role::Watch);
    station.does(MentorDeed::Freeze(true));
    assert!(station.tick(4).is_empty());
    let answer = station.answer().clone();
    assert_eq!(answer.refusal, "a station of the role watch may not freeze the picture");
    assert_eq!((answer.refusals, answer.may_annotate(), answer.may_ask()), (1, false, false));
    let hand = station.hands[0].entity;
    station.role = Some(Role::Operate);
    station.does(MentorDeed::HandOver { hand, step: HandOverStep::Ask });
    station.does(MentorDeed::Freeze(true));
    assert_eq!(station.tick(4), [NoteKind::Freeze(true)]);
    assert_eq!(station.answer().refusal, "a station of the role operate may not take over an instrument");
    station.does(MentorDeed::HandOver { hand: Entity::new(0, 0, 99), step: HandOverStep::Return });
    assert!(station.tick(4).is_empty());
    assert!(station.answer().refusal.contains("valid are left"), "{}", station.answer().refusal);
}

#[test]
fn what_is_done_while_nobody_hears_it_does_not_happen_later() {
    let mut station = Station::new();
    station.is_heard = false;
    station.does(erase(1));
    assert!(station.tick(4).is_empty());
    assert!(station.answer().refusal.contains("does not hear this station"));
    station.is_heard = true;
    station.does(erase(2));
    assert_eq!(erased(&station.tick(4)), [2]);
    station.role = None;
    station.does(MentorDeed::Clear { of_all: true });
    station.does(MentorDeed::Clear { of_all: false });
    let clear = |station| NoteKind::Clear { station };
    assert_eq!(station.tick(4), [clear(None), clear(Some(STATION))]);
}

#[test]
fn who_has_handed_an_instrument_over_takes_it_back_by_its_pedal() {
    let mut station = Station::new();
    let press = |station: &mut Station, activation| {
        let person = station.window;
        let mut input = PersonInput::default();
        input.left.activation = activation;
        station.write(|out, _| out.put(person, input));
    };
    let by = |station| Signature { station, name: "Ana".to_owned(), at: SimTime::ZERO };
    let lent = |station: &mut Station, answer| {
        let request = TakeOverRequest { by: by(9), step: TakeOverStep::Accepted, answer: Some(by(answer)) };
        station.write(|out, hand| out.put(hand, request));
    };
    press(&mut station, 1.0);
    assert!(station.tick(4).is_empty(), "nothing is handed over");
    lent(&mut station, STATION);
    assert!(station.tick(4).is_empty(), "the pedal was pressed before");
    press(&mut station, 0.0);
    assert!(station.tick(4).is_empty());
    press(&mut station, 1.0);
    assert_eq!(station.tick(4), [NoteKind::TakeOver { hand: 1, step: TakeOver::Return }]);
    assert!(station.tick(4).is_empty(), "once");
    // That of its device does the same.
    press(&mut station, 0.0);
    let pedal = |station: &mut Station, pedals: Pedals| {
        let state = DeviceState { buttons: pedals.buttons(), connected: true, ..DeviceState::default() };
        station.write(|out, hand| out.put(hand, state));
    };
    pedal(&mut station, Pedals::Released);
    assert!(station.tick(4).is_empty());
    pedal(&mut station, Pedals::Coagulate);
    assert_eq!(station.tick(4), [NoteKind::TakeOver { hand: 1, step: TakeOver::Return }]);
    pedal(&mut station, Pedals::Released);
    // Not that of somebody else.
    press(&mut station, 0.0);
    lent(&mut station, STATION + 1);
    station.tick(4);
    press(&mut station, 1.0);
    assert!(station.tick(4).is_empty());
}

#[test]
fn a_pedal_at_the_host_takes_back_and_that_of_whoever_has_the_hand_does_not() {
    let mut station = Station::new();
    (station.number, station.role) = (HOST, None);
    let by = |station| Signature { station, name: "Ana".to_owned(), at: SimTime::ZERO };
    let lent = TakeOverRequest { by: by(9), step: TakeOverStep::Accepted, answer: Some(by(HOST)) };
    station.pedals = vec![(0, Pedals::None), (1, Pedals::Energy)];
    station.write(|out, hand| out.put(hand, lent));
    assert!(station.tick(4).is_empty(), "the pedal was pressed before");
    station.pedals[1].1 = Pedals::Released;
    // The mentor's pedal, which the scene shows.
    let buttons = Pedals::Energy.buttons();
    let state = DeviceState { buttons, connected: true, ..DeviceState::default() };
    station.write(|out, hand| out.put(hand, state));
    assert!(station.tick(4).is_empty());
    station.pedals[0].1 = Pedals::Energy;
    assert!(station.tick(4).is_empty(), "that of the other hand");
    station.pedals[1].1 = Pedals::Energy;
    assert_eq!(station.tick(4), [NoteKind::TakeOver { hand: 1, step: TakeOver::Return }]);
    assert!(station.tick(4).is_empty(), "once");
}
