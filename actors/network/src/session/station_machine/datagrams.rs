//! The datagrams of a station: keys, which hands it serves, rows that come, and what the control channel carries.

use trocar_devices::Pedals;
use trocar_scene::{Activation, ActivationMode, Entity, Hand, SimTime, Snapshot};

use super::{NEWS_MAX, StationMachine, StationNews};
use crate::control::{ClientState, HandInfo};
use crate::datagram::{Keys, Kind, Side};
use crate::hands_link::{Connection, HandNumbers, HandsNews, HandsOrder, Parcel};
use crate::haptic::LinkQuality;

/// Time between two acknowledgements of rows.
const ACKNOWLEDGE_EVERY: SimTime = SimTime::from_millis(20);
/// Time between two tellings of what a person does with the pedals.
const PRESS_EVERY: SimTime = SimTime::from_millis(20);
/// Datagrams that the control channel is given to carry at a step.
const CARRIED_MAX: usize = 8;

impl<A: Copy + PartialEq + Send + 'static> StationMachine<A> {
    /// Gives the datagrams of a new connection their keys.
    pub(super) fn open(&mut self, id: u32, station: u16, now: SimTime) {
        self.rows.clear();
        if let Some(replica) = &mut self.replica {
            replica.reconnect();
        }
        let secret = self.secret ^ u64::from(id);
        let keys: Option<Keys> = self.stream.keys(id, 0);
        let made =
            keys.and_then(|keys| Connection::new(id, keys, Side::Client, &[], &self.sender, secret).ok());
        let Some(connection) = made.map(Box::new) else {
            self.control.broke("no keys for its datagrams", now);
            return;
        };
        self.quality = Some(LinkQuality::new(connection.meter().histograms().clone()));
        self.is_protected = connection.is_protected();
        self.connection = Some(id);
        self.hands.order(HandsOrder::Open { station, connection, peer: self.stream.peer() });
    }

    /// The hands of the session that this station serves.
    pub(super) fn served(&self) -> impl Iterator<Item = &HandInfo> + '_ {
        let welcome = self.control.welcome();
        let station = welcome.map(|welcome| welcome.station);
        let hands = welcome.map_or(&[][..], |welcome| &welcome.session.hands);
        hands.iter().filter(move |hand| hand.station == station)
    }

    /// Follows who serves which hand.
    pub(super) fn serve_hands(&mut self) {
        let serves: Vec<u8> = self.served().map(|hand| hand.number).collect();
        if let Some(connection) = self.connection {
            let hands = HandNumbers::new(serves.iter().copied());
            self.hands.order(HandsOrder::Serve { connection, hands });
        }
        self.serves = serves;
    }

    pub(super) fn rekey(&mut self, phase: u32, now: SimTime) {
        let Some(connection) = self.connection else { return };
        let both = (self.stream.keys(connection, phase), self.stream.keys(connection, phase));
        if let (Some(first), Some(second)) = both {
            let ((_, key), (own, _)) = (first.split(Side::Client), second.split(Side::Client));
            self.hands.order(HandsOrder::RekeyOpener { connection, key });
            self.hands.order(HandsOrder::RekeySealer { connection, key: own });
            // A connection that is over by now needs no answer.
            let _ = self.control.rekeyed(now);
        }
    }

    pub(super) fn take_hands_news(&mut self) {
        while let Some(news) = self.hands.next_news() {
            match news {
                HandsNews::Arrived { connection, parcel, sent_at: Some(sent_at) }
                    if Some(connection) == self.connection && parcel.kind() == Kind::Sketch =>
                {
                    if let Some(peer) = &mut self.peer {
                        peer.compare(sent_at, parcel.payload());
                    }
                }
                HandsNews::Arrived { connection, parcel, .. }
                    if Some(connection) == self.connection && parcel.kind() == Kind::Rows =>
                {
                    if self.rows.len() < NEWS_MAX {
                        self.rows.push_back(parcel);
                    }
                }
                HandsNews::Second { connection, point, .. } if Some(connection) == self.connection => {
                    if let Some(quality) = &mut self.quality {
                        quality.take(&point);
                    }
                }
                HandsNews::Carry { connection, datagram } if Some(connection) == self.connection => {
                    self.carrier.carry(datagram);
                }
                HandsNews::Hears { connection, hears } if Some(connection) == self.connection => {
                    self.carrier.hears(hears);
                }
                // The host counts what its own end has sealed, and asks for new keys.
                HandsNews::Arrived { .. }
                | HandsNews::Carry { .. }
                | HandsNews::Hears { .. }
                | HandsNews::Second { .. }
                | HandsNews::Worn { .. } => {}
                HandsNews::Closed(connection) => drop(connection),
                // A station echoes nobody's datagrams.
                HandsNews::Echoed { .. } | HandsNews::EchoEnded(_) => {}
            }
        }
    }

    /// Gives the hands link what the control channel carried.
    pub(super) fn take_carried(&mut self) {
        let Some(connection) = self.connection else { return };
        if let Some(is_heard) = self.carrier.take_heard() {
            self.hands.order(HandsOrder::Heard { connection, is_heard });
            self.tell(StationNews::Carried(!is_heard));
        }
        while let Some(datagram) = self.carrier.take_arrived() {
            // Without room it is lost, as on a path.
            self.hands.order(HandsOrder::Carried { connection, datagram });
        }
    }

    /// Puts what the control channel is to carry into it.
    pub(super) fn send_carried(&mut self, now: SimTime) {
        let Self { control, carrier, .. } = self;
        if control.state() != ClientState::Running {
            return;
        }
        for _ in 0..CARRIED_MAX {
            let (round_trip, waiting) = (control.round_trip(), control.outgoing().len());
            let Some(frame) = carrier.next(round_trip, control.has_urgent(), waiting, now) else { break };
            // One that cannot go is lost, or has ended the connection, which the next step sees.
            let _ = control.send_carried(frame.message(), frame.is_urgent, now);
        }
    }

    /// Tells the host which rows have come.
    pub(super) fn acknowledge(&mut self, now: SimTime) {
        let is_due = now.since(self.acknowledged_at) >= ACKNOWLEDGE_EVERY;
        let (Some(replica), Some(connection)) = (&self.replica, self.connection) else { return };
        if !is_due || self.control.state() != ClientState::Running {
            return;
        }
        self.acknowledged_at = now;
        self.payload.clear();
        replica.write_acknowledgement(&mut self.payload);
        if let Some(parcel) = Parcel::new(Kind::RowAcks, &self.payload) {
            self.hands.order(HandsOrder::Send { connection, parcel });
        }
    }

    /// Tells the hands link what the person at the station does with the pedals.
    pub(super) fn press(&mut self, now: SimTime, scene: &Snapshot) {
        if !self.moves {
            return;
        }
        let pressed: Vec<(u8, Pedals)> =
            self.served().map(|hand| (hand.number, pedals_of(scene, hand.entity))).collect();
        if pressed == self.pressed && now.since(self.pressed_at) < PRESS_EVERY {
            return;
        }
        for &(hand, pedals) in &pressed {
            self.hands.order(HandsOrder::Press { hand, pedals });
        }
        (self.pressed, self.pressed_at) = (pressed, now);
    }
}

/// What the person does with the pedals of a hand, by the instrument that it holds in the station's own scene.
fn pedals_of(scene: &Snapshot, hand: Entity) -> Pedals {
    let instrument = scene.get::<Hand>(hand).map(|hand| hand.instrument);
    match instrument.and_then(|instrument| scene.get::<Activation>(instrument)) {
        Some(Activation { level, mode, .. }) if *level > 0.0 => match mode {
            Some(ActivationMode::Coagulate) => Pedals::Coagulate,
            _ => Pedals::Energy,
        },
        _ => Pedals::Released,
    }
}
