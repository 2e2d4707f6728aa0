//! What a host and a station do alike with the datagrams of a connection: those that arrive, and those that are due.

use trocar_scene::SimTime;

use super::connection::{Arrived, Connection, ConnectionError, Reply};
use super::order::{HandsNews, LinkEnd, Parcel};
use crate::datagram::{DATAGRAM_MAX, Kind};
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

/// Takes a datagram: rows go to the controller, a reply goes back. Whether new samples of hands are in the connection.
///
/// # Errors
/// [`ConnectionError`]; nothing is answered.
pub(super) fn take<A: Copy + PartialEq>(
    connection: &mut Connection<A>,
    now: SimTime,
    from: A,
    datagram: &mut [u8],
    ways: Ways<'_, A>,
) -> Result<bool, ConnectionError> {
    let id = connection.id();
    let (arrived, reply) = connection.receive(now, from, datagram)?;
    let has_hands = arrived == Arrived::Hands;
    let payload = match arrived {
        Arrived::Rows(payload) => Some((Kind::Rows, payload)),
        Arrived::RowAcks(payload) => Some((Kind::RowAcks, payload)),
        Arrived::Hands | Arrived::Other => None,
    };
    if let Some(parcel) = payload.and_then(|(kind, payload)| Parcel::new(kind, payload)) {
        // What does not fit is lost, as on a path.
        ways.controller.tell(HandsNews::Arrived { connection: id, parcel });
    }
    if let Some(Reply { kind, payload }) = reply
        && let Some(length) = connection.seal(kind, &payload, now, ways.out)
    {
        (ways.send)(from, &ways.out[..length]);
    }
    Ok(has_hands)
}

/// Sends what is due to `to`, if it is known where that is: hands and a report; and tells the controller what it has to
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
    if let Some(to) = to {
        if let Some(length) = connection.tick(samples, now, out) {
            let is_sent = send(to, &out[..length]);
            connection.sent(samples, length, is_sent, now);
        }
        if let Some(length) = connection.report(now, out) {
            send(to, &out[..length]);
        }
    }
    if let Some(point) = connection.point(now) {
        controller.tell(HandsNews::Second { connection: id, point, rate: connection.rate() });
    }
    if connection.is_worn() && !*is_worn {
        *is_worn = controller.tell(HandsNews::Worn { connection: id });
    }
}
