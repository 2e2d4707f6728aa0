//! A mentor's side of a session, in virtual time: what it draws, what it asks for, and what it is refused.

use trocar::network::impairments::Impairments;
use trocar::network::ticket::Role;
use trocar::play::person;
use trocar::session::Session;
use trocar_scene::annotation::{nearest_place, place_in_world};
use trocar_scene::{
    Commands, DeviceState, Entity, HandOverStep, HandTarget, MentorAnswer, MentorDeed, MentorInput,
    MentorPointer, MentorStroke, PersonInput, Pose, PressTarget, SimTime, Snapshot, Station, SurfacePlace,
    SurfacePoint, TakeOverRequest, TakeOverStep,
};

use crate::support::party::{Guest, Party};

const BO: usize = 0;
const ANA: usize = 1;

/// The window of a person: its input, and the entity that has it.
struct Window {
    entity: Entity,
    input: MentorInput,
}

impl Window {
    fn open(session: &mut Session) -> Self {
        let mut entity = None;
        let input = MentorInput { source: 1, first: 1, ..MentorInput::default() };
        let first = input.clone();
        let write = |out: &mut trocar_scene::Commands| {
            let window = *entity.insert(out.spawn());
            out.put(window, first);
        };
        session.apply(write).expect("an input");
        Self { entity: entity.expect("it was spawned"), input }
    }

    fn shows(&mut self, session: &mut Session, pointer: Option<SurfacePlace>, deed: MentorDeed) {
        if let Some(answer) = MentorAnswer::of(&session.snapshot()) {
            self.input.forget_taken(answer);
        }
        self.input.pointer = pointer;
        assert!(self.input.add(deed));
        let (entity, input) = (self.entity, self.input.clone());
        session.apply(|out| out.put(entity, input)).expect("an input");
    }

    fn does(&mut self, session: &mut Session, deed: MentorDeed) {
        self.shows(session, self.input.pointer, deed);
    }
}

fn path() -> Impairments {
    Impairments { loss: 0.02, ..Impairments::delay(SimTime::from_millis(20)) }
}

fn refusal(session: &mut Session) -> String {
    MentorAnswer::of(&session.snapshot()).expect("its network answers").refusal.clone()
}

#[test]
fn a_mentors_stroke_is_in_the_hosts_scene_and_follows_the_tissue() {
    let guests = [Guest { name: "Ana", role: Role::Mentor, hands: &[] }];
    let mut party = Party::new("fem-liver", &path(), &guests);
    party.run(200);
    let scene = party.stations[0].snapshot();
    // A line over the place where the probe will press.
    let places: Vec<SurfacePlace> = (-10..=10)
        .filter_map(|step| {
            let above = nalgebra::Point3::new(-0.045 + f64::from(step) * 1e-3, 0.012, 0.3);
            Some(nearest_place(&scene, &above, &-nalgebra::Vector3::z())?.place)
        })
        .filter(|place| scene.name(place.entity) == "liver")
        .collect();
    assert!(places.len() > 15, "{} places", places.len());
    let mut window = Window::open(&mut party.stations[0]);
    for (number, part) in places.chunks(8).enumerate() {
        let (colour, width) = ([200, 30, 20], 0.0015);
        let deed = MentorDeed::Draw { stroke: 1, colour, width, places: part.to_vec() };
        window.shows(&mut party.stations[0], Some(places[number]), deed);
        party.run(40);
    }
    party.run(100);
    let drawn = |session: &mut Session| -> Vec<MentorStroke> {
        session.snapshot().iter::<MentorStroke>().map(|(_, stroke)| stroke.clone()).collect()
    };
    let at_host = drawn(&mut party.host);
    assert_eq!(at_host.len(), 1, "parts of one stroke are one section");
    assert_eq!((at_host[0].by.name.as_str(), &at_host[0].places[..]), ("Ana", &places[..]));
    let came_back = (0..100).any(|_| {
        party.run(10);
        drawn(&mut party.stations[0]) == at_host
    });
    assert!(came_back, "who drew it sees it as the host has it");
    assert_eq!(party.host.snapshot().iter::<MentorPointer>().count(), 1);

    let at = |scene: &Snapshot| -> Vec<nalgebra::Point3<f64>> {
        places.iter().map(|place| place_in_world(scene, place).expect("it is there").0).collect()
    };
    let farthest = |a: &[nalgebra::Point3<f64>], b: &[nalgebra::Point3<f64>]| {
        a.iter().zip(b).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max)
    };
    let before = at(&party.host.snapshot());
    let mut moved = 0.0_f64;
    while party.now < SimTime::from_millis(3_800) {
        party.run(100);
        moved = moved.max(farthest(&before, &at(&party.host.snapshot())));
    }
    assert!(moved > 0.5e-3, "the tissue was pressed, and the stroke with it: {moved}");
    let apart = farthest(&at(&party.host.snapshot()), &at(&party.stations[0].snapshot()));
    assert!(apart < 0.2e-3, "both show it at the same place: {apart}");
    window.does(&mut party.stations[0], MentorDeed::Erase { stroke: 1 });
    party.run(200);
    assert!(drawn(&mut party.host).is_empty() && drawn(&mut party.stations[0]).is_empty());
}

/// What the person at a station does with pointer and pedal.
fn plays(session: &mut Session, change: impl FnOnce(&mut PersonInput)) {
    let scene = session.snapshot();
    let me = person(&scene).expect("somebody plays");
    let mut input = *scene.get::<PersonInput>(me).expect("a person");
    change(&mut input);
    session.apply(|out| out.put(me, input)).expect("a person's input");
}

fn probe(session: &mut Session) -> Pose {
    let scene = session.snapshot();
    *scene.get::<Pose>(scene.find("probe.right").expect("a probe")).expect("a pose")
}

/// How far the probe moves at the host during some time \[m\].
fn motion(party: &mut Party, millis: u64) -> f64 {
    let before = probe(&mut party.host);
    let mut most = 0.0_f64;
    for _ in 0..millis {
        party.step();
        most = most.max((probe(&mut party.host).translation - before.translation).norm());
    }
    most
}

#[test]
fn an_instrument_that_is_handed_over_does_not_move_and_its_pedal_takes_it_back() {
    let guests = [
        Guest { name: "Bo", role: Role::Operate, hands: &["right"] },
        Guest { name: "Ana", role: Role::Mentor, hands: &["right"] },
    ];
    let mut party = Party::new("wall", &path(), &guests);
    party.run(1_500);
    let hand = party.host.snapshot().find("hand.right").expect("a hand");
    let serving = |party: &mut Party| Station::serving(&party.host.snapshot(), hand);
    assert_eq!(serving(&mut party), 1, "a mentor's device waits");
    plays(&mut party.stations[BO], |input| input.right.moved[0] += 0.1);
    assert!(motion(&mut party, 1_000) > 3e-3, "Bo moves it away from where both began");

    let mut windows: Vec<Window> = party.stations.iter_mut().map(Window::open).collect();
    let step = |step| MentorDeed::HandOver { hand, step };
    windows[ANA].does(&mut party.stations[ANA], step(HandOverStep::Ask));
    party.run(300);
    let asked = party.stations[BO].snapshot().get::<TakeOverRequest>(hand).cloned().expect("Bo sees it");
    assert_eq!((asked.by.name.as_str(), asked.step), ("Ana", TakeOverStep::Asked));
    windows[BO].does(&mut party.stations[BO], step(HandOverStep::Accept));
    let moved = motion(&mut party, 1_500);
    assert!(moved <= 1e-4, "{:.3} mm when it was handed over", moved * 1e3);
    assert_eq!(serving(&mut party), 2);

    plays(&mut party.stations[ANA], |input| input.right.moved[0] -= 0.08);
    assert!(motion(&mut party, 1_000) > 3e-3, "Ana moves it");
    plays(&mut party.stations[BO], |input| input.right.activation = 1.0);
    let moved = motion(&mut party, 1_500);
    assert!(moved <= 1e-4, "{:.3} mm when it was taken back", moved * 1e3);
    assert_eq!(serving(&mut party), 1, "{}", refusal(&mut party.stations[BO]));
    assert!(party.host.snapshot().get::<TakeOverRequest>(hand).is_none());
    plays(&mut party.stations[BO], |input| input.right.moved[0] += 0.05);
    assert!(motion(&mut party, 1_000) > 2e-3, "it is Bo's again");
}

#[test]
fn what_is_refused_is_told_to_the_person_at_the_station() {
    let guests = [
        Guest { name: "Bo", role: Role::Watch, hands: &[] },
        Guest { name: "Ana", role: Role::Mentor, hands: &[] },
    ];
    let mut party = Party::new("wall", &path(), &guests);
    party.run(200);
    let mut windows: Vec<Window> = party.stations.iter_mut().map(Window::open).collect();
    windows[BO].does(&mut party.stations[BO], MentorDeed::Freeze(true));
    let on = SurfacePoint::Triangle { corners: [0, 1, 2], barycentric: [1.0, 0.0, 0.0] };
    let places = vec![SurfacePlace { entity: Entity::new(0, 7, 99), on }];
    let nowhere = MentorDeed::Draw { stroke: 1, colour: [0; 3], width: 0.001, places };
    windows[ANA].does(&mut party.stations[ANA], nowhere);
    party.run(200);
    assert_eq!(refusal(&mut party.stations[BO]), "a station of the role watch may not freeze the picture");
    let told = refusal(&mut party.stations[ANA]);
    assert!(told.contains("no such surface"), "{told}");
    let hand = party.host.snapshot().find("hand.right").expect("a hand");
    windows[ANA].does(&mut party.stations[ANA], MentorDeed::HandOver { hand, step: HandOverStep::Ask });
    party.run(200);
    let told = refusal(&mut party.stations[ANA]);
    assert!(told.contains("no device for the hand 'right'; join with --hand right=virtual"), "{told}");
    assert!(party.host.snapshot().get::<TakeOverRequest>(hand).is_none());
}

#[test]
fn the_hosts_own_person_draws_asks_and_clears_and_a_mentor_that_is_cut_off_loses_the_instrument() {
    let guests = [
        Guest { name: "Bo", role: Role::Operate, hands: &["right"] },
        Guest { name: "Ana", role: Role::Mentor, hands: &["right"] },
    ];
    let mut party = Party::new("wall", &path(), &guests);
    party.run(500);
    let hand = party.host.snapshot().find("hand.right").expect("a hand");
    let mut host = Window::open(&mut party.host);
    let mut ana = Window::open(&mut party.stations[ANA]);
    let on = SurfacePoint::Body { point: [0.0; 3], normal: [0.0, 0.0, 1.0] };
    let entity = party.host.snapshot().find("wall").expect("a wall");
    let places = vec![SurfacePlace { entity, on }];
    let stroke = MentorDeed::Draw { stroke: 1, colour: [9; 3], width: 0.001, places };
    host.does(&mut party.host, stroke.clone());
    ana.does(&mut party.stations[ANA], stroke);
    ana.does(&mut party.stations[ANA], MentorDeed::HandOver { hand, step: HandOverStep::Ask });
    party.run(200);
    let names = |session: &mut Session| -> Vec<String> {
        let scene = session.snapshot();
        let mut names: Vec<_> = scene.iter::<MentorStroke>().map(|(_, row)| row.by.name.clone()).collect();
        names.sort();
        names
    };
    assert_eq!(names(&mut party.stations[BO]), ["Ana", "host"]);
    // The host may answer for everybody.
    host.does(&mut party.host, MentorDeed::HandOver { hand, step: HandOverStep::Accept });
    host.does(&mut party.host, MentorDeed::Clear { of_all: true });
    party.run(300);
    assert!(names(&mut party.stations[BO]).is_empty());
    assert_eq!(Station::serving(&party.host.snapshot(), hand), 2);
    // Once more from a second one, while it is with Ana.
    host.does(&mut party.host, MentorDeed::HandOver { hand, step: HandOverStep::Ask });
    party.run(100);
    assert!(refusal(&mut party.host).contains("is with 'Ana'"), "{}", refusal(&mut party.host));
    party.wires[ANA].disconnect();
    party.run(300);
    assert_eq!(Station::serving(&party.host.snapshot(), hand), 1, "it is Bo's again");
    assert!(party.host.snapshot().get::<TakeOverRequest>(hand).is_none());
}

#[test]
fn a_pedal_of_the_hosts_own_device_takes_an_instrument_back_once_it_was_released() {
    let guests = [Guest { name: "Ana", role: Role::Mentor, hands: &["right"] }];
    let mut party = Party::new("wall", &path(), &guests);
    party.run(300);
    let hand = party.host.snapshot().find("hand.right").expect("a hand");
    let serving = |party: &mut Party| Station::serving(&party.host.snapshot(), hand);
    // What a device with pedals says; a virtual one takes it from whoever moves it.
    let foot = |party: &mut Party, is_down: bool| {
        let at = party.host.snapshot().get::<DeviceState>(hand).expect("a device").handle_in_device;
        let target = HandTarget { handle_in_device: at, gripper: 0.0 };
        let press = PressTarget { buttons: 0, energy: is_down, coagulate: false };
        let apply = |out: &mut Commands| {
            out.put(hand, target);
            out.put(hand, press);
        };
        party.host.apply(apply).expect("a foot on the pedal");
        party.run(300);
    };
    foot(&mut party, true);
    let mut ana = Window::open(&mut party.stations[0]);
    ana.does(&mut party.stations[0], MentorDeed::HandOver { hand, step: HandOverStep::Ask });
    party.run(500);
    assert_eq!(serving(&mut party), 1, "nobody is at the host's window, so the host has agreed");
    foot(&mut party, true);
    assert_eq!(serving(&mut party), 1, "the pedal was down before");
    foot(&mut party, false);
    assert_eq!(serving(&mut party), 1);
    foot(&mut party, true);
    assert_eq!(serving(&mut party), 0, "{}", refusal(&mut party.host));
    assert!(party.host.snapshot().get::<TakeOverRequest>(hand).is_none());
}
