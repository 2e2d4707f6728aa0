//! Tests of what a host remembers.

use std::sync::LazyLock;

use proptest::prelude::*;
use ring::rand::SystemRandom;
use trocar_test_support::hostile::mutated;

use super::ticket_book::BookError;
use super::*;

pub(super) const NOW: u64 = 1_795_938_052;
pub(super) const HOUR: u64 = 3_600;

pub(super) fn name(text: &str) -> PlainName {
    text.parse().expect("a name")
}

pub(super) fn offer(role: Role, person: &str) -> Offer {
    let addresses = vec!["192.0.2.1:4070".parse().expect("an address")];
    Offer { role, person: name(person), expires: NOW + HOUR, session: name("liver"), addresses }
}

pub(super) fn resume_secret(byte: u8) -> ResumeSecret {
    ResumeSecret::from_bytes([byte; 32])
}

fn book() -> TicketBook {
    TicketBook::new(Identity::create(&name("Saal 3")).expect("an identity"))
}

fn issue(book: &mut TicketBook, role: Role, person: &str) -> (TicketId, Token) {
    let (id, ticket) = book.issue(offer(role, person), NOW, &SystemRandom::new()).expect("a ticket");
    (id, ticket.token().clone())
}

#[test]
fn a_ticket_carries_what_was_offered_and_the_hosts_fingerprint() {
    let mut book = book();
    let (id, ticket) = book.issue(offer(Role::Mentor, "Ana"), NOW, &SystemRandom::new()).expect("a ticket");
    let line: Ticket = ticket.to_string().parse().expect("its line");
    assert_eq!(line.fingerprint(), &book.identity().fingerprint());
    assert_eq!((line.role(), line.expires(), line.session().as_str()), (Role::Mentor, NOW + HOUR, "liver"));
    let admission = book.redeem(line.token(), 3, &resume_secret(1), NOW + 5).expect("it lets in");
    assert_eq!(admission, Admission { ticket: id, station: 3, role: Role::Mentor, person: name("Ana") });
}

#[test]
fn a_ticket_lets_in_once_and_its_station_comes_back_as_often_as_it_needs() {
    let mut book = book();
    let (_, token) = issue(&mut book, Role::Operate, "Ana");
    let first = book.redeem(&token, 1, &resume_secret(1), NOW).expect("it lets in");
    let again = book.redeem(&token, 2, &resume_secret(2), NOW + 1);
    assert_eq!(again, Err(Refused::Spent { at: NOW }));
    for secs in [0, 1, HOUR, RESUME_LIFE_SECS, RESUME_LIFE_SECS + CLOCK_TOLERANCE_SECS] {
        assert_eq!(book.resume(&resume_secret(1), NOW + secs).as_ref(), Ok(&first), "after {secs} s");
    }
    assert_eq!(book.resume(&resume_secret(2), NOW), Err(Refused::Unknown), "that of the second try");
    let late = NOW + RESUME_LIFE_SECS + CLOCK_TOLERANCE_SECS + 1;
    let expired = Refused::Expired { expired_at: NOW + RESUME_LIFE_SECS, now: late };
    assert_eq!(book.resume(&resume_secret(1), late), Err(expired));
}

#[test]
fn two_stations_never_share_a_resume_secret() {
    let mut book = book();
    let (_, ana) = issue(&mut book, Role::Mentor, "Ana");
    let (_, bo) = issue(&mut book, Role::Watch, "Bo");
    book.redeem(&ana, 1, &resume_secret(1), NOW).expect("it lets in");
    assert_eq!(book.redeem(&bo, 2, &resume_secret(1), NOW), Err(Refused::SecretInUse));
    book.redeem(&bo, 2, &resume_secret(2), NOW).expect("the ticket is still good");
    let roles = [1, 2].map(|byte| book.resume(&resume_secret(byte), NOW).map(|admission| admission.role));
    assert_eq!(roles, [Ok(Role::Mentor), Ok(Role::Watch)]);
}

#[test]
fn a_wrong_token_is_unknown_and_spends_nothing() {
    let mut book = book();
    let (_, token) = issue(&mut book, Role::Operate, "Ana");
    for byte in 0..16 {
        let mut wrong = *token.as_bytes();
        wrong[byte] ^= 1;
        let refused = book.redeem(&Token::from_bytes(wrong), 1, &resume_secret(1), NOW);
        assert_eq!(refused, Err(Refused::Unknown));
    }
    assert!(book.redeem(&token, 1, &resume_secret(1), NOW).is_ok());
}

#[test]
fn a_ticket_expires_by_the_hosts_clock_and_its_tolerance() {
    let mut book = book();
    let (_, early) = issue(&mut book, Role::Operate, "Ana");
    let (_, late) = issue(&mut book, Role::Operate, "Bo");
    let last = NOW + HOUR + CLOCK_TOLERANCE_SECS;
    let expired = Refused::Expired { expired_at: NOW + HOUR, now: last + 1 };
    assert_eq!(book.redeem(&late, 1, &resume_secret(1), last + 1), Err(expired));
    assert!(book.redeem(&early, 1, &resume_secret(1), last).is_ok());
}

#[test]
fn a_host_whose_clock_went_back_by_an_hour_says_so() {
    let mut book = book();
    let (_, token) = issue(&mut book, Role::Operate, "Ana");
    let back = Refused::ClockWentBack { issued_at: NOW, now: NOW - HOUR };
    assert_eq!(book.redeem(&token, 1, &resume_secret(1), NOW - HOUR), Err(back));
    assert!(
        book.redeem(&token, 1, &resume_secret(1), NOW - CLOCK_TOLERANCE_SECS).is_ok(),
        "a little is nothing"
    );
}

#[test]
fn a_station_comes_back_whichever_way_the_wall_clock_was_set_and_no_later_than_its_time() {
    let mut book = book();
    let (_, token) = issue(&mut book, Role::Operate, "Ana");
    // It comes in while the wall clock is an hour ahead; its time counts by the steady clock all the same.
    let ahead = HostTime { wall: NOW + 50 * 60, steady: NOW };
    let admission = book.redeem(&token, 1, &resume_secret(1), ahead).expect("it lets in");
    let last = NOW + RESUME_LIFE_SECS + CLOCK_TOLERANCE_SECS;
    for wall in [0, NOW - HOUR, NOW, NOW + HOUR, NOW + 10_000 * HOUR, u64::MAX] {
        for steady in [NOW, NOW + HOUR, last] {
            let back = book.resume(&resume_secret(1), HostTime { wall, steady });
            assert_eq!(back.as_ref(), Ok(&admission), "{wall} {steady}");
        }
        let late = book.resume(&resume_secret(1), HostTime { wall, steady: last + 1 });
        assert!(matches!(late, Err(Refused::Expired { .. })), "{wall}: {late:?}");
    }
    // The host was started again with a clock that is an hour wrong.
    assert_eq!(book.resume(&resume_secret(1), NOW - HOUR), Ok(admission));
}

#[test]
fn a_wall_clock_that_is_set_back_lets_no_expired_ticket_in() {
    let mut book = book();
    let (_, token) = issue(&mut book, Role::Operate, "Ana");
    let steady = NOW + HOUR + CLOCK_TOLERANCE_SECS + 1;
    let back = HostTime { wall: NOW + 60, steady };
    let refused = book.redeem(&token, 1, &resume_secret(1), back);
    assert_eq!(refused, Err(Refused::Expired { expired_at: NOW + HOUR, now: steady }));
    // A clock that was behind and is right now counts, too.
    let corrected = HostTime { wall: steady, steady: NOW };
    let refused = book.redeem(&token, 1, &resume_secret(1), corrected);
    assert_eq!(refused, Err(Refused::Expired { expired_at: NOW + HOUR, now: steady }));
}

#[test]
fn a_host_that_starts_with_a_clock_that_was_set_back_knows_the_time_of_later_tickets() {
    let mut book = book();
    let random = SystemRandom::new();
    let (_, old) = issue(&mut book, Role::Operate, "Ana");
    let day = NOW + 24 * HOUR;
    let next = Offer { expires: day + HOUR, ..offer(Role::Operate, "Bo") };
    let (_, bo) = book.issue(next, day, &random).expect("a ticket");
    let expired = |now| Some(Refused::Expired { expired_at: NOW + HOUR, now });
    assert_eq!(book.redeem(&old, 1, &resume_secret(1), NOW + 60).err(), expired(day));
    book.redeem(bo.token(), 2, &resume_secret(2), day + 30).expect("it lets in");
    assert_eq!(book.examine(&old, &resume_secret(1), NOW + 60).err(), expired(day + 30));
    // What was given out after the clock was right again is judged by itself.
    let (_, fresh) = issue(&mut book, Role::Operate, "Cy");
    assert!(book.redeem(&fresh, 3, &resume_secret(3), NOW + 60).is_ok());
    // A station that returns is late by what somebody's later ticket shows, and never early.
    assert!(book.resume(&resume_secret(2), NOW).is_ok());
}

#[test]
fn what_is_revoked_lets_nobody_in_or_back() {
    let mut book = book();
    let (open, open_token) = issue(&mut book, Role::Operate, "Ana");
    let (used, used_token) = issue(&mut book, Role::Watch, "Ana");
    let (other, other_token) = issue(&mut book, Role::Watch, "Bo");
    book.redeem(&used_token, 7, &resume_secret(1), NOW).expect("it lets in");
    let revoked = book.revoke(&Whom::Person(name("Ana")), NOW + 1).expect("she is known");
    assert_eq!(revoked, Revoked { tickets: vec![open, used], stations: vec![7] });
    let refused = Err(Refused::Revoked { at: NOW + 1 });
    assert_eq!(book.redeem(&open_token, 1, &resume_secret(2), NOW + 2), refused);
    assert_eq!(book.redeem(&used_token, 1, &resume_secret(2), NOW + 2), refused);
    assert_eq!(book.resume(&resume_secret(1), NOW + 2), refused);
    assert_eq!([open, used, other].map(|id| book.is_revoked(id)), [true, true, false]);
    let again = book.revoke(&Whom::Ticket(used), NOW + 9).expect("it is known");
    assert_eq!(again, Revoked::default(), "nothing new");
    assert_eq!(book.resume(&resume_secret(1), NOW + 9), refused, "the first withdrawal counts");
    assert!(book.redeem(&other_token, 8, &resume_secret(3), NOW).is_ok());
    let nobody = book.revoke(&Whom::Person(name("Cy")), NOW);
    assert_eq!(nobody, Err(RevokeError::NoPerson(name("Cy"))));
    let none: TicketId = "99".parse().expect("a number");
    assert_eq!(book.revoke(&Whom::Ticket(none), NOW), Err(RevokeError::NoTicket(none)));
}

#[test]
fn a_ticket_that_nobody_could_use_is_not_issued() {
    let mut book = book();
    let random = SystemRandom::new();
    let past = Offer { expires: NOW - 5, ..offer(Role::Watch, "Ana") };
    assert_eq!(book.issue(past, NOW, &random), Err(IssueError::Past(5)));
    let nowhere = Offer { addresses: Vec::new(), ..offer(Role::Watch, "Ana") };
    assert_eq!(book.issue(nowhere, NOW, &random), Err(IssueError::Ticket(TicketError::Addresses(0))));
    assert!(book.list(NOW).is_empty());
}

#[test]
fn the_book_is_bounded_and_forgets_only_what_is_over() {
    let mut book = book();
    let random = SystemRandom::new();
    let mut tokens = Vec::new();
    for number in 0..ENTRIES_MAX as u64 {
        let offer = Offer { expires: NOW + HOUR + number, ..offer(Role::Operate, "Ana") };
        tokens.push(book.issue(offer, NOW, &random).expect("there is room").1.token().clone());
    }
    book.redeem(&tokens[0], 1, &resume_secret(1), NOW).expect("it lets in");
    assert_eq!(book.issue(offer(Role::Operate, "Bo"), NOW, &random), Err(IssueError::Full));
    assert_eq!(book.list(NOW).len(), ENTRIES_MAX);

    // The second and third ticket are over; the first has a station that can come back.
    let later = NOW + HOUR + CLOCK_TOLERANCE_SECS + 3;
    let next = Offer { expires: later + HOUR, ..offer(Role::Operate, "Bo") };
    for _ in 0..2 {
        book.issue(next.clone(), later, &random).expect("there is room");
    }
    assert_eq!(book.issue(next.clone(), later, &random), Err(IssueError::Full));
    assert_eq!(book.list(later).len(), ENTRIES_MAX);
    assert!(book.resume(&resume_secret(1), later).is_ok());
    // Even if the clock goes back, what is forgotten lets nobody in.
    for token in &tokens[1..3] {
        assert_eq!(book.redeem(token, 2, &resume_secret(2), NOW), Err(Refused::Unknown));
    }
    // One that was withdrawn unused makes room at once.
    let last = book.list(later).last().expect("it is not empty").id;
    book.revoke(&Whom::Ticket(last), later).expect("it is known");
    let (id, _) = book.issue(next, later, &random).expect("there is room");
    assert!(id > last, "no number is given twice");
    let bytes = book.encode().expect("it encodes").len() as u64;
    assert!(bytes < STORE_BYTES_MAX / 2, "{bytes}");
}

#[test]
fn the_largest_book_fits_its_file() {
    // The longest entry times the most entries.
    let mut book = book();
    let random = SystemRandom::new();
    let empty = book.encode().expect("it encodes").len();
    let largest = Offer { expires: EXPIRY_MAX_SECS, ..offer(Role::Mentor, &"x".repeat(NAME_MAX)) };
    let (id, ticket) = book.issue(largest, EXPIRY_MAX_SECS - 1, &random).expect("a ticket");
    book.redeem(ticket.token(), u16::MAX, &resume_secret(9), EXPIRY_MAX_SECS).expect("it lets in");
    book.revoke(&Whom::Ticket(id), u64::MAX).expect("it is known");
    let entry = book.encode().expect("it encodes").len() - empty;
    // Its number has one byte instead of up to five.
    assert!(((entry + 4) * ENTRIES_MAX + empty) as u64 * 2 < 2 * STORE_BYTES_MAX, "{entry}");
}

#[test]
fn the_list_says_how_it_stands_with_every_ticket_and_has_no_secrets() {
    let mut book = book();
    let (_, redeemed) = issue(&mut book, Role::Operate, "Ana");
    issue(&mut book, Role::Watch, "Bo");
    let (revoked, _) = issue(&mut book, Role::Mentor, "Cy");
    book.redeem(&redeemed, 4, &resume_secret(1), NOW + 1).expect("it lets in");
    book.revoke(&Whom::Ticket(revoked), NOW + 2).expect("it is known");
    let states = |now| book.list(now).iter().map(|listed| listed.state).collect::<Vec<_>>();
    use TicketState::{Expired, Open, Redeemed, Revoked};
    assert_eq!(states(NOW + 3), [Redeemed, Open, Revoked]);
    assert_eq!(states(NOW + 2 * HOUR), [Redeemed, Expired, Revoked]);
    assert_eq!(states(NOW + 24 * HOUR), [Expired, Expired, Revoked]);
    let ana = &book.list(NOW + 3)[0];
    assert_eq!((ana.station, ana.redeemed_at), (Some(4), Some(NOW + 1)));
    assert_eq!(ana.resume_expires, Some(NOW + 1 + RESUME_LIFE_SECS));

    let shown = format!("{book:?} {:?}", book.list(NOW));
    assert!(shown.contains("Ana") && !shown.contains("PRIVATE KEY"), "{shown}");
    assert!(!shown.contains("1, 1, 1, 1"), "{shown}");
}

#[test]
fn a_book_comes_back_from_its_bytes_and_wrong_bytes_are_refused() {
    let mut book = book();
    let (_, token) = issue(&mut book, Role::Operate, "Ana");
    issue(&mut book, Role::Watch, "Bo");
    book.redeem(&token, 4, &resume_secret(1), NOW).expect("it lets in");
    let bytes = book.encode().expect("it encodes");
    let again = TicketBook::decode(&bytes).expect("it decodes");
    assert_eq!(again, book);
    assert_eq!(again.identity().key_pem(), book.identity().key_pem());
    for cut in 0..bytes.len() {
        assert!(TicketBook::decode(&bytes[..cut]).is_err(), "cut to {cut}");
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(matches!(TicketBook::decode(&longer), Err(BookError::Entries)));
}

/// A book with entries of every kind. The certificate is made once, since that takes long.
static KEPT: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut book = book();
    for (number, person) in ["Ana", "Bo", "Cy"].into_iter().enumerate() {
        let (id, token) = issue(&mut book, Role::ALL[number], person);
        if number > 0 {
            book.redeem(&token, number as u16, &resume_secret(number as u8), NOW).expect("it lets in");
        }
        if number > 1 {
            book.revoke(&Whom::Ticket(id), NOW).expect("it is known");
        }
    }
    book.encode().expect("it encodes")
});

proptest! {
    #[test]
    fn a_damaged_book_is_refused_or_a_book_in_order(
        damaged in mutated(vec![KEPT.clone()]),
        tail in prop::collection::vec(any::<u8>(), 0..120),
        cut in 60_usize..400,
    ) {
        // What follows certificate and key is where numbers, names and hashes are.
        let entries = [&KEPT[..KEPT.len() - cut.min(KEPT.len())], &tail].concat();
        for bytes in [damaged, entries] {
            let Ok(mut book) = TicketBook::decode(&bytes) else { continue };
            let listed = book.list(NOW);
            prop_assert!(listed.len() <= ENTRIES_MAX && listed.is_sorted_by_key(|ticket| ticket.id));
            let again = TicketBook::decode(&book.encode().expect("it encodes")).expect("its own bytes");
            prop_assert_eq!(&again, &book);
            for ticket in listed {
                book.revoke(&Whom::Ticket(ticket.id), NOW).expect("it is listed");
                prop_assert!(book.is_revoked(ticket.id));
            }
        }
    }
}
