//! A diagnosis: what somebody with a ticket asks in place of the session, to learn what the path to the host carries.
//!
//! The opening shows the ticket's token, which the host looks up and does not spend. Then the host says whether the ticket
//! would let in and what its clock shows, and echoes datagrams under keys of this TLS session, each to where it came from
//! and as long as it came: nobody gets an answer before the host knows the token, and nobody more bytes than he sent.

use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

use super::credential::Credential;
use super::plain_text::PlainText;
use crate::ticket::Role;

/// Most diagnoses at once. Who comes later is asked to try again.
pub const DIAGNOSES_MAX: usize = 4;
/// Longest time of one.
pub const DIAGNOSIS_TIME_MAX: SimTime = SimTime::from_millis(15_000);

/// First message of somebody who wants to know what the path carries.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnose {
    /// Version of the program, for people.
    pub program: PlainText,
    /// What would let a station in.
    pub credential: Credential,
}

/// What a ticket is worth, of those that the host has given out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TicketVerdict {
    /// It would let in.
    LetsIn(Role),
    /// It has let somebody in before. Whoever has it may still look at the path, since a station that is in has it, too.
    Spent {
        /// When \[s since 1970\].
        at: u64,
    },
}

/// The host's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnosed {
    /// Number of the connection in datagrams.
    pub connection: u32,
    /// What the ticket is worth.
    pub ticket: TicketVerdict,
    /// The host's clock \[s since 1970\].
    pub host_unix_secs: u64,
}

/// Datagrams of a diagnosis that have come to the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EchoCounts {
    /// Short ones.
    pub short: u32,
    /// Those as long as a datagram can be.
    pub long: u32,
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::control::error::{ControlError, Goodbye, Refusal};
    use crate::control::frame::{FrameDecoder, OPENING_MAX, after_preamble};
    use crate::control::host::{HostControl, HostState, SendError};
    use crate::control::message::{ClientMessage, HostMessage};
    use crate::control::outbox::Outbox;
    use crate::control::session_testing::{Pair, ms, ticket};
    use crate::ticket::{Refused, Role};

    /// The bytes of an opening that shows the ticket of this number.
    fn opening(number: u8) -> Vec<u8> {
        let mut outbox = Outbox::default();
        let diagnose = Diagnose { program: PlainText::new("0.1.0"), credential: ticket(number) };
        outbox.push(&ClientMessage::Diagnose(Box::new(diagnose)), true, ms(0)).expect("it is short");
        outbox.waiting().to_vec()
    }

    /// Takes the host's answer out of what it sends.
    fn answer(host: &mut HostControl) -> Result<Diagnosed, Refusal> {
        host.poll(ms(1));
        let bytes = host.outgoing().to_vec();
        host.advance(bytes.len(), ms(1));
        let (mut decoder, mut rest) = (FrameDecoder::new(OPENING_MAX), bytes.as_slice());
        let frame = decoder.next_frame(&mut rest).expect("a frame").expect("a whole one");
        match HostMessage::decode(after_preamble(frame).expect("an opening")).expect("a message") {
            HostMessage::Diagnosed(diagnosed) => Ok(diagnosed),
            HostMessage::Refused(refusal) => Err(refusal),
            other => panic!("{}", other.name()),
        }
    }

    /// A host that has heard an opening.
    fn asked(pair: &mut Pair, number: u8) -> (HostControl, Result<Diagnosed, Refusal>) {
        let mut host = HostControl::new(Arc::clone(&pair.facts), ms(0));
        host.receive(&opening(number), ms(1), &mut pair.session);
        let answer = answer(&mut host);
        (host, answer)
    }

    #[test]
    fn whoever_has_a_ticket_gets_a_connection_and_the_ticket_still_lets_in() {
        let mut pair = Pair::operating();
        let (host, first) = asked(&mut pair, 1);
        let first = first.expect("the ticket is good");
        assert_eq!(first.ticket, TicketVerdict::LetsIn(Role::Operate));
        assert_eq!((host.state(), host.diagnosed()), (HostState::Diagnosing, Some(first.connection)));
        assert!(host.admitted().is_none() && pair.session.redeemed == 0, "nothing is spent");
        pair.join();
        let (_, second) = asked(&mut pair, 1);
        let second = second.expect("a ticket that was used is known");
        assert_eq!(second.ticket, TicketVerdict::Spent { at: 7 });
        assert_ne!(second.connection, first.connection);
    }

    #[test]
    fn a_ticket_that_the_host_never_gave_out_gets_a_refusal_and_no_connection() {
        let mut pair = Pair::operating();
        let (host, refused) = asked(&mut pair, 99);
        assert_eq!(refused, Err(Refusal::Ticket(Refused::Unknown)));
        assert_eq!((host.state(), host.diagnosed()), (HostState::Ended, None));
    }

    #[test]
    fn a_diagnosis_brings_counts_and_nothing_of_the_session_and_ends_by_itself() {
        let mut pair = Pair::operating();
        let (mut host, _) = asked(&mut pair, 1);
        assert_eq!(host.send_echoed(EchoCounts { short: 1, long: 0 }, ms(2)), Ok(()));
        assert_eq!(host.send_delta(b"scene", ms(2)), Err(SendError::NotNow));
        assert_eq!(host.send_roster(Vec::new(), ms(2)), Err(SendError::NotNow));
        assert_eq!(host.send_hand_served(0, None, ms(2)), Err(SendError::NotNow));
        assert_eq!(host.rekey(ms(2)), Err(SendError::NotNow));
        host.poll(DIAGNOSIS_TIME_MAX);
        assert_eq!(host.state(), HostState::Diagnosing, "no ping is missed");
        host.poll(ms(1) + DIAGNOSIS_TIME_MAX);
        assert!(matches!(host.error(), Some(ControlError::Ended(Goodbye::TooSlow(_)))), "{:?}", host.error());
    }

    #[test]
    fn who_diagnoses_can_say_goodbye_and_nothing_else() {
        let mut pair = Pair::operating();
        for (message, is_goodbye) in
            [(ClientMessage::Goodbye(Goodbye::Leaves), true), (ClientMessage::Rekeyed { phase: 1 }, false)]
        {
            let (mut host, _) = asked(&mut pair, 1);
            let mut outbox = Outbox::default();
            outbox.push(&message, false, ms(2)).expect("it is short");
            host.receive(outbox.waiting(), ms(2), &mut pair.session);
            assert_eq!(host.state(), HostState::Ended);
            assert_eq!(matches!(host.error(), Some(ControlError::Goodbye(Goodbye::Leaves))), is_goodbye);
            assert_eq!(matches!(host.error(), Some(ControlError::Unexpected { .. })), !is_goodbye);
        }
    }
}
