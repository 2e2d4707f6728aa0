use trocar_scene::SimTime;

use super::{Invitation, OPENING_MAX, PairMachine, TOKEN_BYTES};
use crate::control::{LinkFigures, StationInfo};
use crate::hands_link::{HandsOrder, LinkEnd, hands_channel};
use crate::haptic::SenderConfig;
use crate::impairments::Impairments;
use crate::lockstep::{PairDoors, PairWires};
use crate::ticket::Role;

struct Station {
    machine: PairMachine<usize>,
    link: LinkEnd<usize>,
    number: u16,
}

/// What the hands link of a station is told.
#[derive(Debug, PartialEq, Eq)]
enum Told {
    Open(u16, u32),
    Serve(u16, Vec<u8>),
    Close(u16),
}

impl Station {
    fn new(doors: &PairDoors, number: u16) -> Self {
        let (controller, link) = hands_channel();
        let door = Box::new(doors.open(PairWires::default()));
        let machine = PairMachine::new(door, controller, SenderConfig::default(), 5);
        Self { machine, link, number }
    }

    fn step(&mut self, now: SimTime, stations: &[StationInfo]) -> Vec<(u16, Vec<u8>)> {
        self.machine.step(now, self.number, stations)
    }

    fn told(&mut self) -> Vec<Told> {
        let orders = std::iter::from_fn(|| self.link.orders.pop().ok());
        orders
            .map(|order| match order {
                HandsOrder::OpenPair { station, connection, .. } => Told::Open(station, connection.id()),
                HandsOrder::ServePair { station, hands } => Told::Serve(station, hands.as_slice().to_vec()),
                HandsOrder::ClosePair { station } => Told::Close(station),
                _ => panic!("another order"),
            })
            .collect()
    }
}

fn info(number: u16, hands: &[u8]) -> StationInfo {
    StationInfo {
        number,
        name: format!("station {number}").parse().expect("a name"),
        role: Role::Operate,
        is_here: true,
        hands: hands.to_vec(),
        link: LinkFigures::default(),
    }
}

fn ms(millis: u64) -> SimTime {
    SimTime::from_millis(millis)
}

fn doors() -> PairDoors {
    PairDoors::new(&Impairments::delay(ms(5)), 1)
}

#[test]
fn two_stations_meet_by_an_invitation_and_take_the_hands_that_the_host_names() {
    let doors = doors();
    let (mut first, mut second) = (Station::new(&doors, 1), Station::new(&doors, 2));
    let stations = [info(1, &[0]), info(2, &[3, 4])];
    let invitations = first.step(ms(0), &stations);
    assert!(second.step(ms(0), &stations).is_empty(), "the higher number waits");
    let [(2, invitation)] = &invitations[..] else { panic!("{invitations:?}") };
    second.machine.invited(1, invitation, ms(0));
    for at in 1..60 {
        first.step(ms(at), &stations);
        second.step(ms(at), &stations);
        // It comes again when it was late, and changes nothing.
        second.machine.invited(1, invitation, ms(at));
    }
    let id = Invitation::read(invitation).expect("it reads").connection();
    assert_eq!(first.told(), [Told::Open(2, id), Told::Serve(2, vec![3, 4])]);
    assert_eq!(second.told(), [Told::Open(1, id), Told::Serve(1, vec![0])]);
    assert_eq!(first.machine.stations().collect::<Vec<_>>(), [2]);
    // A hand changes its station, and then the second one leaves.
    let moved = [info(1, &[0, 4]), info(2, &[3])];
    first.step(ms(60), &moved);
    assert_eq!(first.told(), [Told::Serve(2, vec![3])]);
    first.step(ms(61), &moved[..1]);
    second.step(ms(61), &moved[1..]);
    assert_eq!((first.told(), second.told()), (vec![Told::Close(2)], vec![Told::Close(1)]));
}

#[test]
fn who_has_not_the_token_of_his_number_gets_no_pair() {
    let doors = doors();
    let mut first = Station::new(&doors, 1);
    let mut others = [2, 3].map(|number| Station::new(&doors, number));
    let stations = [info(1, &[0]), info(2, &[1]), info(3, &[2])];
    let invitations = first.step(ms(0), &stations);
    assert_eq!(invitations.iter().map(|(to, _)| *to).collect::<Vec<_>>(), [2, 3]);
    let of_second = Invitation::read(&invitations[0].1).expect("it reads");
    // One guesses, the other one has the token of somebody else.
    let guessed = Invitation { token: [0; TOKEN_BYTES], ..of_second.clone() };
    others[0].machine.invited(1, &guessed.to_bytes(), ms(0));
    others[1].machine.invited(1, &of_second.to_bytes(), ms(0));
    for at in 1..200 {
        first.step(ms(at), &stations);
        for other in &mut others {
            other.machine.step(ms(at), other.number, &stations);
        }
    }
    assert_eq!(first.told(), []);
    assert!(others.iter_mut().all(|other| other.told().is_empty()));
    assert_eq!(first.machine.stations().count(), 0);
}

#[test]
fn who_comes_and_says_nothing_is_sent_away() {
    let doors = doors();
    let mut first = Station::new(&doors, 1);
    let stations = [info(1, &[0]), info(2, &[1])];
    first.step(ms(0), &stations);
    let mut silent = doors.open(PairWires::default());
    let place = 0_u64.to_le_bytes();
    let mut stream = super::PairDoor::dial(&mut silent, &place).expect("a door");
    stream.connect(ms(0));
    let mut over = None;
    for at in (1..OPENING_MAX.as_nanos() / 1_000_000 + 100).step_by(10) {
        first.step(ms(at), &stations);
        let mut bytes = Vec::new();
        if over.is_none() && stream.receive(ms(at), 64, &mut bytes).is_err() {
            over = Some(at);
        }
        assert!(bytes.is_empty(), "nothing is said before the token was right");
    }
    let over = over.expect("it is sent away");
    assert!((5_000..5_100).contains(&over), "{over}");
    assert!(super::PairDoor::dial(&mut silent, b"elsewhere").is_err());
    assert_eq!(first.told(), []);
}
