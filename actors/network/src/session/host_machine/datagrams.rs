//! The datagrams of a host: keys, echoes, what comes of its hands link, and what a control channel carries.

use trocar_scene::SimTime;

use super::telling::DATAGRAMS_MAX;
use super::{HostMachine, Link, told};
use crate::control::HostState;
use crate::datagram::{Kind, Side};
use crate::diagnosis::EchoEnd;
use crate::hands_link::{Connection, HandNumbers, HandsNews, HandsOrder};
use crate::haptic::LinkQuality;
use crate::session::host_members::{Member, Members, figures};
use crate::streams::StreamId;

impl<A: Copy + PartialEq + Send + 'static> HostMachine<A> {
    /// Gives a connection's datagrams their keys, and its hands.
    pub(super) fn open(&mut self, stream: StreamId, id: u32, station: u16, now: SimTime) {
        let hands = HandNumbers::new(self.members.served_by(station));
        let secret = self.secret ^ u64::from(id).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let connection = self
            .streams
            .keys(stream, id, 0)
            .and_then(|keys| {
                Connection::new(id, keys, Side::Server, hands.as_slice(), &self.sender, secret).ok()
            })
            .map(Box::new);
        let Some(connection) = connection else {
            if let Some(link) = self.links.get_mut(&stream) {
                link.control.broke("no keys for its datagrams", now);
            }
            return;
        };
        let quality = LinkQuality::new(connection.meter().histograms().clone());
        let name = self.members.name_of(station);
        self.streams.admitted(stream, id, station, name.as_str());
        let is_open = self.hands.order(HandsOrder::Open { station, connection, peer: None })
            && self.hands.order(HandsOrder::Serve { connection: id, hands });
        if let Some(member) = self.members.members.get_mut(&station) {
            member.quality = Some(quality);
        }
        if !is_open && let Some(link) = self.links.get_mut(&stream) {
            link.control.broke("the link of hands is overloaded", now);
        }
    }

    /// Begins the next phase of a connection's keys: the other side's first, so that this end can open what it seals.
    pub(super) fn rekey(&mut self, connection: u32, now: SimTime) {
        let found =
            self.links.iter_mut().find(|(_, link)| link.opened.is_some_and(|(id, _)| id == connection));
        let Some((stream, link)) = found else { return };
        let Ok(phase) = link.control.rekey(now) else { return };
        if let Some(keys) = self.streams.keys(*stream, connection, phase) {
            let (_, key) = keys.split(Side::Server);
            self.hands.order(HandsOrder::RekeyOpener { connection, key });
        }
    }

    /// Has the datagrams of a diagnosis echoed.
    pub(super) fn echo(&mut self, stream: StreamId, id: u32, now: SimTime) {
        let keys = self.streams.keys(stream, id, 0);
        let echo = keys.map(|keys| HandsOrder::Echo(Box::new(EchoEnd::new(id, keys))));
        let is_open = echo.is_some_and(|echo| self.hands.order(echo));
        if !is_open && let Some(link) = self.links.get_mut(&stream) {
            link.control.broke("no keys for its datagrams", now);
        }
    }

    pub(super) fn take_news(&mut self, now: SimTime) {
        while let Some(news) = self.hands.next_news() {
            match news {
                HandsNews::Arrived { connection, parcel, .. } if parcel.kind() == Kind::RowAcks => {
                    let member = self.member_of(connection);
                    // What a station acknowledges without having got it is counted by its feed and has no effect.
                    let _ = member.map(|member| member.feed.acknowledge(now, parcel.payload()));
                }
                HandsNews::Arrived { .. } => {}
                HandsNews::Second { connection, point, rate } => {
                    let station = self.station_of(connection);
                    if let Some(quality) =
                        self.member_of(connection).and_then(|member| member.quality.as_mut())
                    {
                        quality.take(&point);
                    }
                    if let Some(station) = station {
                        self.members.roster.set_link(station, figures(&point, rate));
                    }
                }
                HandsNews::Carry { connection, datagram } => {
                    if let Some(member) = self.member_of(connection) {
                        member.carrier.carry(datagram);
                    }
                }
                HandsNews::Hears { connection, hears } => {
                    if let Some(member) = self.member_of(connection) {
                        member.carrier.hears(hears);
                    }
                }
                HandsNews::Worn { connection } => self.rekey(connection, now),
                HandsNews::Closed(connection) => drop(connection),
                HandsNews::Echoed { connection, counts } => {
                    let of = |link: &&mut Link| link.control.diagnosed() == Some(connection);
                    if let Some(link) = self.links.values_mut().find(of) {
                        told(link.control.send_echoed(counts, now));
                    }
                }
                HandsNews::EchoEnded(echo) => drop(echo),
            }
        }
    }

    pub(super) fn station_of(&self, connection: u32) -> Option<u16> {
        let of = |(_, member): &(&u16, &Member)| member.connection == connection;
        self.members.members.iter().find(of).map(|(station, _)| *station)
    }

    pub(super) fn member_of(&mut self, connection: u32) -> Option<&mut Member> {
        self.members.members.values_mut().find(|member| member.connection == connection)
    }

    /// Gives the hands link what a station's control channel carried.
    pub(super) fn take_carried(&mut self, connection: u32, station: u16, now: SimTime) {
        let Some(member) = self.members.members.get_mut(&station) else { return };
        if member.connection != connection {
            return;
        }
        if let Some(is_heard) = member.carrier.take_heard() {
            self.hands.order(HandsOrder::Heard { connection, is_heard });
            let name = self.members.name_of(station);
            let what = if is_heard { "arrive by themselves again" } else { "are carried over TCP" };
            self.note_incident(now, format!("{name}: datagrams {what}"));
        }
        let Some(member) = self.members.members.get_mut(&station) else { return };
        while let Some(datagram) = member.carrier.take_arrived() {
            // Without room it is lost, as on a path.
            self.hands.order(HandsOrder::Carried { connection, datagram });
        }
    }
}

/// Puts what a station's control channel is to carry into it.
pub(super) fn send_carried(link: &mut Link, members: &mut Members, now: SimTime) {
    let Link { control, opened: Some((connection, station)), .. } = link else { return };
    let member = members.members.get_mut(station).filter(|member| member.connection == *connection);
    let Some(member) = member.filter(|_| control.state() == HostState::Running) else { return };
    for _ in 0..DATAGRAMS_MAX {
        let (round_trip, waiting) = (control.round_trip(), control.outgoing().len());
        let Some(frame) = member.carrier.next(round_trip, control.has_urgent(), waiting, now) else { break };
        told(control.send_carried(frame.message(), frame.is_urgent, now).map(|_| ()));
    }
}
