//! The connections of a host: who comes, what each stream brings and takes, and how it ends.

use std::collections::VecDeque;

use trocar_scene::SimTime;

use super::datagrams::send_carried;
use super::{HostMachine, Link};
use crate::control::{ControlError, Goodbye, HostControl, HostState};
use crate::datagram::Side;
use crate::hands_link::HandsOrder;
use crate::streams::StreamId;

/// Bytes taken from one stream at a tick.
const TAKEN_MAX: usize = 64 << 10;

impl<A: Copy + PartialEq + Send + 'static> HostMachine<A> {
    pub(super) fn accept(&mut self, now: SimTime) {
        self.streams.work(now, &mut self.opened);
        for stream in self.opened.drain(..) {
            let control = HostControl::new(self.facts.clone(), now);
            let link = Link {
                control,
                opened: None,
                is_echoed: false,
                pieces: VecDeque::new(),
                is_told: false,
                is_paused: false,
            };
            self.links.insert(stream, link);
        }
    }

    /// Takes what one stream has brought.
    pub(super) fn serve(&mut self, stream: StreamId, now: SimTime) {
        let Some(link) = self.links.get_mut(&stream) else { return };
        self.received.clear();
        let received = self.streams.receive(stream, now, TAKEN_MAX, &mut self.received);
        link.control.receive(&self.received, now, &mut self.members);
        if let Err(closed) = received {
            link.control.broke(&closed.0, now);
        }
        let admitted = link.control.admitted().copied();
        let admitted = admitted.filter(|_| link.opened.is_none() && link.control.state() != HostState::Ended);
        if let Some(admitted) = admitted {
            link.opened = Some((admitted.connection, admitted.station));
        }
        let diagnosed = link.control.diagnosed().filter(|_| !link.is_echoed);
        link.is_echoed |= diagnosed.is_some();
        let opened = link.opened;
        if let Some(id) = diagnosed {
            self.echo(stream, id, now);
        }
        if let Some(admitted) = admitted {
            self.open(stream, admitted.connection, admitted.station, now);
        }
        if let Some((id, station)) = opened
            && let Some(phase) = self.members.take_rekeyed(station)
            && let Some(keys) = self.streams.keys(stream, id, phase)
        {
            let (key, _) = keys.split(Side::Server);
            self.hands.order(HandsOrder::RekeySealer { connection: id, key });
        }
        if let Some((connection, station)) = opened {
            self.take_carried(connection, station, now);
        }
        let superseded = std::mem::take(&mut self.members.superseded);
        for connection in superseded {
            let of_connection = |link: &&mut Link| link.opened.is_some_and(|(id, _)| id == connection);
            self.links
                .values_mut()
                .filter(of_connection)
                .for_each(|link| link.control.dismiss(Goodbye::Superseded, now));
        }
    }

    /// Moves what waits into the stream, and lets go of a connection that is over.
    pub(super) fn flush(&mut self, stream: StreamId, now: SimTime) {
        let Some(link) = self.links.get_mut(&stream) else { return };
        send_carried(link, &mut self.members, now);
        let mut poll = link.control.poll(now);
        while !link.control.outgoing().is_empty() {
            match self.streams.send(stream, now, link.control.outgoing()) {
                Ok(0) => break,
                Ok(count) => {
                    link.control.advance(count, now);
                    poll = link.control.poll(now);
                }
                Err(closed) => {
                    link.control.broke(&closed.0, now);
                    poll = link.control.poll(now);
                }
            }
        }
        let ended = link.control.state() == HostState::Ended;
        if ended && !link.is_told {
            link.is_told = true;
            self.ended(stream, now);
        }
        if poll.is_over {
            self.streams.close(stream);
            self.links.remove(&stream);
        }
    }

    fn ended(&mut self, stream: StreamId, now: SimTime) {
        let Some(link) = self.links.get(&stream) else { return };
        let error = link.control.error().cloned();
        let text = error.as_ref().map_or_else(String::new, ToString::to_string);
        if let Some(connection) = link.control.diagnosed() {
            self.hands.order(HandsOrder::Close { connection });
            self.note_incident(now, "somebody with a ticket has looked at the path".to_owned());
            return;
        }
        let Some((connection, station)) = link.opened else {
            self.strangers += 1;
            if matches!(error, Some(ControlError::Refused { .. })) {
                self.note_incident(now, format!("a station was not let in: {text}"));
            }
            return;
        };
        self.hands.order(HandsOrder::Close { connection });
        let is_over = error.as_ref().is_some_and(|error| !error.is_of_the_link());
        let name = self.stations().into_iter().find(|info| info.number == station).map(|info| info.name);
        let is_superseded = matches!(error, Some(ControlError::Ended(Goodbye::Superseded)));
        self.members.disconnected(station, connection, is_over && !is_superseded, now);
        if let Some(name) = name.filter(|_| !is_superseded) {
            let what = if is_over { "has left" } else { "is away" };
            self.note_incident(now, format!("{name} {what}: {text}"));
        }
    }
}
