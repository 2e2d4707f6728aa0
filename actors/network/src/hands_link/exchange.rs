//! What a host and a station do alike with the datagrams of a connection: those that arrive, and those that are due.

use trocar_scene::SimTime;

use super::connection::{Arrived, Connection, ConnectionError, Reply};
use super::order::{HandsNews, LinkEnd, Parcel, Sealed};
use crate::datagram::{DATAGRAM_MAX, Header, Kind};
use crate::hand_sample::HandSample;

/// The ways out of a connection.
pub(super) struct Ways<'a, A> {
    /// Rows and acknowledgements, to the controller.
    pub controller: &'a mut LinkEnd<A>,
    /// Datagrams, to an address; whether the system took them.
    pub send: &'a mut dyn FnMut(A, &[u8]) -> bool,
    /// Room for a datagram.
    pub out: &'a mut [u8; DATAGRAM_MAX],
}

/// Takes a datagram, which came from an address or was carried: rows go to the controller, a reply goes back. Whether new samples of hands are in the connection.
///
/// # Errors
/// [`ConnectionError`]; nothing is answered.
pub(super) fn take<A: Copy + PartialEq>(
    connection: &mut Connection<A>,
    now: SimTime,
    from: Option<A>,
    datagram: &mut [u8],
    ways: Ways<'_, A>,
) -> Result<bool, ConnectionError> {
    let id = connection.id();
    let sent_at = Header::decode(datagram).map(|header| header.sent_at);
    let (arrived, reply) = match from {
        Some(from) => connection.receive(now, from, datagram)?,
        None => (connection.receive_carried(now, datagram)?, None),
    };
    let has_hands = arrived == Arrived::Hands;
    let payload = match arrived {
        Arrived::Rows(payload) => Some((Kind::Rows, payload)),
        Arrived::RowAcks(payload) => Some((Kind::RowAcks, payload)),
        Arrived::Sketch(payload) => Some((Kind::Sketch, payload)),
        Arrived::Hands | Arrived::Other => None,
    };
    if let Some(parcel) = payload.and_then(|(kind, payload)| Parcel::new(kind, payload)) {
        // What does not fit is lost, as on a path.
        let age = sent_at.ok().and_then(|sent_at| connection.age(sent_at, now));
        let sent_at = age.map(|age| SimTime(now.as_nanos().saturating_sub(age.as_nanos())));
        ways.controller.tell(HandsNews::Arrived { connection: id, parcel, sent_at });
    }
    if let (Some(Reply { kind, payload }), Some(from)) = (reply, from)
        && let Some(length) = connection.seal(kind, &payload, now, ways.out)
    {
        (ways.send)(from, &ways.out[..length]);
    }
    Ok(has_hands)
}

/// Sends a payload to `to`, or has it carried. Without a way it is lost.
pub(super) fn send_parcel<A: Copy + PartialEq>(
    connection: &mut Connection<A>,
    to: Option<A>,
    parcel: &Parcel,
    now: SimTime,
    ways: Ways<'_, A>,
) {
    let Ways { controller, send, out } = ways;
    if !connection.way().carries() && to.is_none() {
        return;
    }
    if let Some(length) = connection.seal(parcel.kind(), parcel.payload(), now, out) {
        dispatch(connection, to, &out[..length], controller, send);
    }
}

/// Sends a sealed datagram by itself, or has it carried.
fn dispatch<A: Copy + PartialEq>(
    connection: &Connection<A>,
    to: Option<A>,
    datagram: &[u8],
    controller: &mut LinkEnd<A>,
    send: &mut dyn FnMut(A, &[u8]) -> bool,
) {
    if !connection.way().carries() {
        to.map(|to| send(to, datagram));
    } else if let Some(datagram) = Sealed::new(datagram) {
        // What does not fit is lost, as on a path.
        controller.tell(HandsNews::Carry { connection: connection.id(), datagram });
    }
}

/// Sends what is due to `to`, if it is known where that is, or has it carried: hands and a report; and tells the controller what it has to
/// know of the connection.
pub(super) fn send_due<A: Copy + PartialEq>(
    connection: &mut Connection<A>,
    to: Option<A>,
    samples: &[HandSample],
    is_worn: &mut bool,
    now: SimTime,
    ways: Ways<'_, A>,
) {
    let Ways { controller, send, out } = ways;
    let id = connection.id();
    connection.way_mut().tick(now);
    if connection.way().carries() {
        if let Some(length) = connection.carry(samples, now, out) {
            dispatch(connection, to, &out[..length], controller, send);
        }
        if let Some(to) = to
            && let Some(length) = connection.try_again(samples, now, out)
        {
            send(to, &out[..length]);
        }
    } else if let Some(to) = to
        && let Some(length) = connection.tick(samples, now, out)
    {
        let is_sent = send(to, &out[..length]);
        connection.sent(samples, length, is_sent, now);
    }
    if (to.is_some() || connection.way().carries())
        && let Some(length) = connection.report(now, out)
    {
        dispatch(connection, to, &out[..length], controller, send);
    }
    if let Some(hears) = connection.way().news()
        && controller.tell(HandsNews::Hears { connection: id, hears })
    {
        connection.way_mut().told(hears);
    }
    if let Some(point) = connection.point(now) {
        controller.tell(HandsNews::Second { connection: id, point, rate: connection.rate() });
    }
    if connection.is_worn() && !*is_worn {
        *is_worn = controller.tell(HandsNews::Worn { connection: id });
    }
}
