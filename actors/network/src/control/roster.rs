//! Who is in a session, over which connection, and who serves which hand.
//!
//! A station whose connection broke keeps its place and its hands for [`AWAY_TIME_MAX`]. When it comes back earlier, over
//! whatever address, its new connection replaces the old one, which may not have noticed yet that it is dead.

use std::collections::BTreeMap;

use trocar_scene::SimTime;

use super::error::Refusal;
use super::message::{HandInfo, LinkFigures, STATION_HANDS_MAX, STATIONS_MAX, StationInfo};
use super::plain_text::PlainText;
use crate::ticket::{PlainName, Role};

/// How long a station keeps its place and its hands after a break.
pub const AWAY_TIME_MAX: SimTime = SimTime::from_millis(60_000);

/// Stations and hands of a session.
#[derive(Clone, Debug)]
pub struct Roster {
    stations: BTreeMap<u16, Station>,
    hands: Vec<HandInfo>,
    last_connection: u32,
}

#[derive(Clone, Debug)]
struct Station {
    name: PlainName,
    role: Role,
    connection: u32,
    away_since: Option<SimTime>,
    link: LinkFigures,
}

/// A station that has come in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Number of its connection, never used before in this session.
    pub connection: u32,
    /// The connection that this one replaces, if the station was there: to be dismissed as superseded.
    pub superseded: Option<u32>,
}

impl Roster {
    /// Of a session with these hands. The host itself is in it like any other station, if it has hands.
    pub fn new(hands: Vec<HandInfo>) -> Self {
        Self { stations: BTreeMap::new(), hands, last_connection: 0 }
    }

    /// Whether a station could come in: the room, its name, and the hands that it wishes. `station` is the number of one
    /// that comes back.
    ///
    /// # Errors
    /// [`Refusal::SessionFull`], [`Refusal::NameTaken`], [`Refusal::HandUnknown`], [`Refusal::HandTaken`].
    pub fn check(&self, station: Option<u16>, name: &PlainName, hands: &[PlainName]) -> Result<(), Refusal> {
        let is_known = station.is_some_and(|number| self.stations.contains_key(&number));
        if !is_known && self.stations.len() >= STATIONS_MAX {
            return Err(Refusal::SessionFull { most: STATIONS_MAX as u16 });
        }
        let is_taken =
            self.stations.iter().any(|(number, other)| Some(*number) != station && other.name == *name);
        if is_taken {
            return Err(Refusal::NameTaken { name: name.clone() });
        }
        hands.iter().try_for_each(|hand| self.free_hand(station, hand).map(|_| ()))
    }

    /// A station comes in or back. [`Self::check`] has found nothing against it.
    pub fn arrive(&mut self, number: u16, name: PlainName, role: Role) -> Arrival {
        let connection = self.next_connection();
        let station = Station { name, role, connection, away_since: None, link: LinkFigures::default() };
        let before = self.stations.insert(number, station);
        let superseded =
            before.filter(|station| station.away_since.is_none()).map(|station| station.connection);
        Arrival { connection, superseded }
    }

    /// A number for a connection, which none has had.
    pub fn next_connection(&mut self) -> u32 {
        self.last_connection = self.last_connection.wrapping_add(1);
        self.last_connection
    }

    /// A station takes a hand; returns its number.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn take_hand(&mut self, station: u16, hand: &PlainName) -> Result<u8, Refusal> {
        let at = self.free_hand(Some(station), hand)?;
        let served = self.hands.iter().filter(|hand| hand.station == Some(station)).count();
        if served >= STATION_HANDS_MAX && self.hands[at].station != Some(station) {
            let text = format!("a station serves at most {STATION_HANDS_MAX} hands");
            return Err(Refusal::HostTrouble(PlainText::new(text)));
        }
        self.hands[at].station = Some(station);
        Ok(self.hands[at].number)
    }

    /// A station gives a hand back; returns its number.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn give_hand(&mut self, station: u16, hand: &PlainName) -> Result<u8, Refusal> {
        let at = self.find_hand(hand)?;
        if self.hands[at].station != Some(station) {
            return Err(Refusal::HandNotServed { hand: PlainText::new(hand.as_str()) });
        }
        self.hands[at].station = None;
        Ok(self.hands[at].number)
    }

    /// A connection ended without a goodbye. Returns whether the station is away now: not if it has a newer connection.
    pub fn break_off(&mut self, number: u16, connection: u32, now: SimTime) -> bool {
        match self.stations.get_mut(&number) {
            Some(station) if station.connection == connection => {
                station.away_since.get_or_insert(now);
                true
            }
            _ => false,
        }
    }

    /// A station leaves; returns the numbers of the hands that it gave free. Nothing happens if it has a newer connection.
    pub fn leave(&mut self, number: u16, connection: u32) -> Vec<u8> {
        if self.stations.get(&number).is_none_or(|station| station.connection != connection) {
            return Vec::new();
        }
        self.stations.remove(&number);
        let served = self.hands.iter_mut().filter(|hand| hand.station == Some(number));
        served
            .map(|hand| {
                hand.station = None;
                hand.number
            })
            .collect()
    }

    /// The next station that was away for too long; it has left, and the numbers of its hands come with it.
    pub fn expire(&mut self, now: SimTime) -> Option<(u16, Vec<u8>)> {
        let is_over =
            |station: &Station| station.away_since.is_some_and(|since| now >= since + AWAY_TIME_MAX);
        let (number, station) = self.stations.iter().find(|(_, station)| is_over(station))?;
        let (number, connection) = (*number, station.connection);
        Some((number, self.leave(number, connection)))
    }

    /// When [`Self::expire`] has something to do.
    pub fn deadline(&self) -> Option<SimTime> {
        self.stations
            .values()
            .filter_map(|station| station.away_since)
            .min()
            .map(|since| since + AWAY_TIME_MAX)
    }

    /// How the link of a station does.
    pub fn set_link(&mut self, number: u16, link: LinkFigures) {
        if let Some(station) = self.stations.get_mut(&number) {
            station.link = link;
        }
    }

    /// The hands.
    pub fn hands(&self) -> &[HandInfo] {
        &self.hands
    }

    /// The stations, for a message.
    pub fn stations(&self) -> Vec<StationInfo> {
        let info = |(number, station): (&u16, &Station)| StationInfo {
            number: *number,
            name: station.name.clone(),
            role: station.role,
            is_here: station.away_since.is_none(),
            hands: self
                .hands
                .iter()
                .filter(|hand| hand.station == Some(*number))
                .map(|hand| hand.number)
                .collect(),
            link: station.link,
        };
        self.stations.iter().map(info).collect()
    }

    fn find_hand(&self, name: &PlainName) -> Result<usize, Refusal> {
        self.hands.iter().position(|hand| hand.name == *name).ok_or_else(|| Refusal::HandUnknown {
            hand: PlainText::new(name.as_str()),
            valid: self.hands.iter().map(|hand| hand.name.clone()).collect(),
        })
    }

    fn free_hand(&self, station: Option<u16>, name: &PlainName) -> Result<usize, Refusal> {
        let at = self.find_hand(name)?;
        match self.hands[at].station {
            Some(other) if Some(other) != station => {
                let by = self.stations.get(&other).map(|station| station.name.clone());
                let by = by.unwrap_or_else(|| self.hands[at].name.clone());
                Err(Refusal::HandTaken { hand: PlainText::new(name.as_str()), by })
            }
            _ => Ok(at),
        }
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::Entity;

    use super::*;

    fn name(text: &str) -> PlainName {
        text.parse().expect("a name")
    }

    fn roster() -> Roster {
        let hand = |number: u8, text: &str| HandInfo {
            number,
            name: name(text),
            entity: Entity::new(0, 0, u32::from(number) + 1),
            station: None,
        };
        Roster::new(vec![hand(0, "left"), hand(1, "right")])
    }

    #[test]
    fn a_station_that_is_away_keeps_its_hands_for_a_minute_and_then_gives_them_free() {
        let mut roster = roster();
        let arrival = roster.arrive(3, name("Ana"), Role::Operate);
        assert_eq!(roster.take_hand(3, &name("right")), Ok(1));
        let broke_at = SimTime::from_millis(500);
        assert!(roster.break_off(3, arrival.connection, broke_at));
        assert!(!roster.stations()[0].is_here);
        let taken = roster.check(None, &name("Bo"), &[name("right")]).expect_err("it is kept");
        assert_eq!(taken, Refusal::HandTaken { hand: PlainText::new("right"), by: name("Ana") });
        assert!(matches!(roster.check(None, &name("Ana"), &[]), Err(Refusal::NameTaken { .. })));
        let over_at = broke_at + AWAY_TIME_MAX;
        assert_eq!(roster.deadline(), Some(over_at));
        assert_eq!(roster.expire(over_at - SimTime(1)), None);
        assert_eq!(roster.expire(over_at), Some((3, vec![1])));
        assert_eq!((roster.expire(over_at), roster.deadline()), (None, None));
        assert_eq!(roster.check(None, &name("Ana"), &[name("right")]), Ok(()));
    }

    #[test]
    fn the_end_of_a_replaced_connection_takes_nothing_from_the_station_that_is_back() {
        let mut roster = roster();
        let first = roster.arrive(3, name("Ana"), Role::Operate);
        roster.take_hand(3, &name("left")).expect("free");
        let second = roster.arrive(3, name("Ana"), Role::Operate);
        assert_eq!(second.superseded, Some(first.connection));
        assert!(!roster.break_off(3, first.connection, SimTime::ZERO));
        assert_eq!(roster.leave(3, first.connection), Vec::<u8>::new());
        let stations = roster.stations();
        assert!(stations[0].is_here && stations[0].hands == [0]);
        assert_eq!(roster.leave(3, second.connection), vec![0]);
    }

    #[test]
    fn a_full_session_takes_nobody_but_those_who_come_back() {
        let mut roster = roster();
        for number in 0..STATIONS_MAX as u16 {
            let station = name(&format!("station {number}"));
            assert_eq!(roster.check(None, &station, &[]), Ok(()));
            roster.arrive(number, station, Role::Watch);
        }
        assert_eq!(roster.check(None, &name("late"), &[]), Err(Refusal::SessionFull { most: 64 }));
        assert_eq!(roster.check(Some(5), &name("station 5"), &[]), Ok(()));
    }

    #[test]
    fn a_hand_is_given_back_by_its_station_only_and_an_unknown_one_is_answered_with_the_valid_ones() {
        let mut roster = roster();
        roster.arrive(1, name("Ana"), Role::Operate);
        roster.arrive(2, name("Bo"), Role::Operate);
        roster.take_hand(1, &name("left")).expect("free");
        assert!(matches!(roster.give_hand(2, &name("left")), Err(Refusal::HandNotServed { .. })));
        assert_eq!(roster.take_hand(1, &name("left")), Ok(0), "it has it already");
        assert_eq!(roster.give_hand(1, &name("left")), Ok(0));
        let unknown = roster.take_hand(2, &name("third")).expect_err("unknown").to_string();
        assert_eq!(unknown, "the session has no hand 'third'; valid are left, right");
    }
}
