//! What was found of the path to a host, each step apart, and how to mend it.

use trocar::network::control::{Diagnosed, Refusal, TicketVerdict};
use trocar::network::diagnosis::{Echoed, Examined, LONG_BYTES, SHORT_BYTES};
use trocar::network::live::reach::{Reached, Step};
use trocar::network::ticket::{HostPlace, Refused, Ticket, clock_difference, utc};
use trocar_scene::SimTime;

use super::Check;
use crate::report::short;

/// Share of lost datagrams above which hands become slower, or forces fade.
const LOSS_MAX: f64 = 0.05;
/// Both clocks are read in whole seconds, one after the other.
const SECONDS_READ: u64 = 2;

/// What the host and its datagrams have brought.
pub struct Examination {
    /// The findings.
    pub found: Examined,
    /// Whether the host's machine said that nobody takes datagrams at the port.
    pub is_refused: bool,
    /// This machine's clock at the end \[s since 1970\].
    pub unix_secs: u64,
}

/// All checks, in the order of the path.
pub fn checks(ticket: &Ticket, reached: &[Reached], examination: Option<&Examination>) -> Vec<Check> {
    let mut checks = vec![name(reached), connection(reached), certificate(ticket, reached)];
    let Some(examination) = examination else {
        let why = "not looked at: the host was not reached";
        checks.extend(["ticket", "UDP", "path MTU", "clock"].map(|name| Check::skip(name, why)));
        return checks;
    };
    let Examination { found, is_refused, unix_secs } = examination;
    checks.push(of_ticket(ticket, found));
    match &found.answer {
        Some(Ok(_)) => {
            checks.push(udp(&found.short, *is_refused));
            checks.push(mtu(found));
        }
        _ => {
            let why = "not looked at: the host answers datagrams of those alone whose ticket it knows";
            checks.extend(["UDP", "path MTU"].map(|name| Check::skip(name, why)));
        }
    }
    checks.push(clock(found, *unix_secs));
    checks
}

/// Addresses that ended at a step: `192.0.2.1:7417 and 192.0.2.2:7417: refused, nobody listens there`.
fn ended_at(reached: &[Reached], is_step: impl Fn(Step) -> bool) -> Option<String> {
    let told = reached.iter().filter_map(|reached| {
        let (step, why) = reached.trouble.as_ref()?;
        is_step(*step).then(|| format!("{}: {why}", reached.address))
    });
    let told: Vec<String> = told.collect();
    (!told.is_empty()).then(|| told.join("; "))
}

/// A finding about addresses: it fails if no other address leads on.
fn finding(name: &'static str, good: Option<String>, bad: Option<String>, mend: &str) -> Check {
    match (good, bad) {
        (Some(good), None) => Check::ok(name, good),
        (Some(good), Some(bad)) => Check::warn(name, format!("{good}; but {bad}"), mend),
        (None, Some(bad)) => Check::fail(name, bad, mend),
        (None, None) => Check::skip(name, "not looked at: no address came so far"),
    }
}

fn name(reached: &[Reached]) -> Check {
    let is_name = |reached: &&Reached| !matches!(reached.address.place(), HostPlace::Ip(_));
    let found: Vec<String> = reached
        .iter()
        .filter(is_name)
        .filter(|reached| !reached.found.is_empty())
        .map(|reached| {
            let found: Vec<String> = reached.found.iter().map(ToString::to_string).collect();
            format!("{} is {}", reached.address, found.join(" and "))
        })
        .collect();
    let bad = ended_at(reached, |step| step == Step::Name);
    let good = match (found.is_empty(), reached.iter().any(|reached| !reached.found.is_empty())) {
        (false, _) => Some(found.join("; ")),
        (true, true) => Some("the ticket has addresses, which need no name service".to_owned()),
        (true, false) => None,
    };
    finding(
        "name",
        good,
        bad,
        "compare the name with the host's, look at this machine's name service (getent hosts NAME), or ask for a ticket \
         with an address (trocar host --address ADDRESS:PORT)",
    )
}

fn connection(reached: &[Reached]) -> Check {
    let good: Vec<String> = reached
        .iter()
        .filter_map(|reached| match (&reached.host, &reached.trouble) {
            (Some((socket, took)), _) => {
                Some(format!("{socket} takes connections ({} ms)", short(took.as_secs_f64() * 1e3)))
            }
            (None, Some((Step::Protocol | Step::Certificate, _))) => {
                Some(format!("{} takes connections", reached.address))
            }
            _ => None,
        })
        .collect();
    finding(
        "TCP",
        (!good.is_empty()).then(|| good.join("; ")),
        ended_at(reached, |step| step == Step::Connection),
        "refused: start the host, and compare its port with the ticket's; no answer: let TCP to that port through the \
         firewalls, and have the router in front of the host forward it; no route: join both machines to one network",
    )
}

fn certificate(ticket: &Ticket, reached: &[Reached]) -> Check {
    let fingerprint = ticket.fingerprint().to_string();
    let good = reached.iter().find_map(|reached| reached.host).map(|(socket, _)| {
        format!("{socket} has the certificate of the ticket, SHA-256 {}…", &fingerprint[..16])
    });
    let is_other = reached.iter().any(|reached| matches!(reached.trouble, Some((Step::Certificate, _))));
    let mend = if is_other {
        "ask the host for a new ticket (trocar host ticket), by a way that you trust: its certificate may be a new one; if \
         it is not, somebody stands in between: do not join over this network"
    } else {
        "another program has the port of the ticket: compare it with the host's, and look at what forwards it"
    };
    let bad = ended_at(reached, |step| matches!(step, Step::Certificate | Step::Protocol));
    finding("certificate", good, bad, mend)
}

fn of_ticket(ticket: &Ticket, found: &Examined) -> Check {
    const NEW: &str = "ask the host for a new ticket (trocar host ticket)";
    match (&found.answer, &found.error) {
        (Some(Ok(Diagnosed { ticket: TicketVerdict::LetsIn(role), .. })), _) => {
            Check::ok("ticket", format!("lets in once as {role}, until {}", utc(ticket.expires())))
        }
        (Some(Ok(Diagnosed { ticket: TicketVerdict::Spent { at }, .. })), _) => {
            let text = format!("was used already, at {}, and lets nobody in any more", utc(*at));
            Check::warn(
                "ticket",
                text,
                "whoever is in comes back without it; for another station, ask for a new one",
            )
        }
        (
            Some(Err(refusal @ Refusal::Ticket(Refused::Expired { .. } | Refused::ClockWentBack { .. }))),
            _,
        ) => Check::fail(
            "ticket",
            refusal.to_string(),
            "compare the clocks of both machines (below), or ask for a new ticket",
        ),
        (Some(Err(refusal @ Refusal::HostTrouble(_))), _) => Check::fail(
            "ticket",
            refusal.to_string(),
            "try again in half a minute, or look at what the host says",
        ),
        (Some(Err(refusal)), _) => Check::fail("ticket", refusal.to_string(), NEW),
        (None, why) => {
            let why = why.as_deref().unwrap_or("no answer");
            let text = format!("the host has not said what the ticket is worth: {why}");
            Check::fail("ticket", text, "let both ends have the same release of this program, then try again")
        }
    }
}

fn udp(echoed: &Echoed, is_refused: bool) -> Check {
    let Echoed { sent, there, back, shortest, longest } = *echoed;
    let ms = |time: Option<SimTime>| short(time.map_or(f64::NAN, |time| time.as_secs_f64() * 1e3));
    let came = format!("{back} of {sent} datagrams of {SHORT_BYTES} bytes came back");
    if back > 0 {
        let text = format!("{came}, round trip {} to {} ms", ms(shortest), ms(longest));
        return if f64::from(sent - back.min(sent)) <= LOSS_MAX * f64::from(sent) {
            Check::ok("UDP", text)
        } else {
            Check::warn(
                "UDP",
                text,
                "the path loses more than 5 %, and hands get slower at 20 %: use a cable in place of a wireless network, and \
                 stop what else fills the line",
            )
        };
    }
    if there > 0 {
        return Check::fail(
            "UDP",
            format!("{there} of {sent} datagrams reach the host, and none of its answers comes back"),
            "let answers through the firewall of this machine and of its network: UDP from the host's port",
        );
    }
    let why = if is_refused { ": nobody takes datagrams at that port" } else { "" };
    Check::fail(
        "UDP",
        format!("none of the datagrams reaches the host, while TCP does{why}"),
        "let UDP through to the same port as TCP, in all firewalls, and have it forwarded, too (a tunnel or forwarder for TCP \
         alone does not do)",
    )
}

fn mtu(found: &Examined) -> Check {
    let Echoed { sent, there, back, .. } = found.long;
    if found.short.back == 0 {
        return Check::skip("path MTU", "not looked at: no datagram passes at all");
    }
    if back > 0 {
        let lost = f64::from(sent - back.min(sent)) / f64::from(sent.max(1));
        let of_short = 1.0 - f64::from(found.short.back) / f64::from(found.short.sent.max(1));
        let text = format!("{back} of {sent} datagrams of {LONG_BYTES} bytes came back");
        return if lost <= of_short + 0.5 {
            Check::ok("path MTU", text)
        } else {
            Check::warn("path MTU", text, "long datagrams get lost more often: look at what fills the line")
        };
    }
    let way = if there > 0 { "come back from the host" } else { "reach the host" };
    Check::fail(
        "path MTU",
        format!("no datagrams of {LONG_BYTES} bytes {way}, while those of {SHORT_BYTES} bytes do"),
        "a tunnel on the path takes less: set its MTU to 1280 at least (ip link set dev TUNNEL mtu 1280), or go without it",
    )
}

fn clock(found: &Examined, here: u64) -> Check {
    let there = match &found.answer {
        Some(Ok(diagnosed)) => Some(diagnosed.host_unix_secs),
        Some(Err(Refusal::Ticket(Refused::Expired { now, .. } | Refused::ClockWentBack { now, .. }))) => {
            Some(*now)
        }
        _ => None,
    };
    let Some(there) = there else {
        return Check::skip("clock", "not looked at: the host has not told its time");
    };
    let differs = here.abs_diff(there);
    match clock_difference(there, here) {
        Some(text) => Check::fail(
            "clock",
            text,
            "let the network set the clock that is wrong: timedatectl set-ntp true",
        ),
        None if differs <= SECONDS_READ => {
            Check::ok("clock", "both clocks show the same, to the second".to_owned())
        }
        None => Check::ok("clock", format!("both clocks differ by {differs} s, which does no harm")),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Status;
    use super::*;
    use trocar::network::ticket::Role;

    const NOW: u64 = 1_795_938_052;

    fn ticket() -> Ticket {
        let fingerprint = trocar::network::ticket::Fingerprint::from_bytes([7; 32]);
        let token = trocar::network::ticket::Token::from_bytes([9; 16]);
        let address = "192.0.2.1:7417".parse().expect("an address");
        let session = "session".parse().expect("a name");
        Ticket::new(vec![address], fingerprint, token, Role::Operate, NOW + 60, session).expect("a ticket")
    }

    fn reached() -> Vec<Reached> {
        let socket = "192.0.2.1:7417".parse().expect("an address");
        vec![Reached {
            address: "192.0.2.1:7417".parse().expect("an address"),
            found: vec![socket],
            host: Some((socket, std::time::Duration::from_micros(300))),
            trouble: None,
        }]
    }

    fn ended(address: &str, found: bool, step: Step) -> Reached {
        let found = found.then(|| "192.0.2.9:7417".parse().expect("an address"));
        Reached {
            address: address.parse().expect("an address"),
            found: found.into_iter().collect(),
            host: None,
            trouble: Some((step, "why".to_owned())),
        }
    }

    fn examination(short: [u32; 3], long: [u32; 3], host_unix_secs: u64) -> Examination {
        let echoed = |[sent, there, back]: [u32; 3]| Echoed { sent, there, back, ..Echoed::default() };
        let answer =
            Diagnosed { connection: 3, ticket: TicketVerdict::LetsIn(Role::Operate), host_unix_secs };
        let found =
            Examined { answer: Some(Ok(answer)), short: echoed(short), long: echoed(long), error: None };
        Examination { found, is_refused: false, unix_secs: NOW }
    }

    /// The checks that are not good, and whether each names a remedy.
    fn faults(checks: &[Check]) -> Vec<(&'static str, Status)> {
        for check in checks {
            assert_eq!(
                check.mend.is_some(),
                matches!(check.status, Status::Warn | Status::Fail),
                "{check:?}"
            );
        }
        let faults = checks.iter().filter(|check| check.status != Status::Ok);
        faults.map(|check| (check.name, check.status)).collect()
    }

    #[test]
    fn each_fault_of_a_path_is_found_at_its_own_step() {
        let all = [24, 24, 24];
        let of = |examination: &Examination| faults(&checks(&ticket(), &reached(), Some(examination)));
        assert_eq!(of(&examination(all, all, NOW)), []);
        assert_eq!(of(&examination(all, all, NOW + 90)), []);
        assert_eq!(of(&examination(all, all, NOW + 3_600)), [("clock", Status::Fail)]);
        assert_eq!(of(&examination(all, [24, 0, 0], NOW)), [("path MTU", Status::Fail)]);
        assert_eq!(of(&examination(all, [24, 24, 0], NOW)), [("path MTU", Status::Fail)]);
        assert_eq!(of(&examination([24, 24, 18], all, NOW)), [("UDP", Status::Warn)]);
        for there in [0, 24] {
            let found = of(&examination([24, there, 0], [24, there, 0], NOW));
            assert_eq!(found, [("UDP", Status::Fail), ("path MTU", Status::Skip)]);
        }
    }

    #[test]
    fn a_host_that_is_not_reached_is_told_by_its_step_and_nothing_is_guessed_of_the_rest() {
        let rest = ["ticket", "UDP", "path MTU", "clock"].map(|name| (name, Status::Skip));
        let of = |reached: &[Reached]| {
            let found = faults(&checks(&ticket(), reached, None));
            let (steps, after) = found.split_at(found.len() - rest.len());
            assert_eq!(after, rest);
            steps.to_vec()
        };
        let skip = Status::Skip;
        let nameless = of(&[ended("or-3.example:7417", false, Step::Name)]);
        assert_eq!(nameless, [("name", Status::Fail), ("TCP", skip), ("certificate", skip)]);
        let closed = of(&[ended("192.0.2.9:7417", true, Step::Connection)]);
        assert_eq!(closed, [("TCP", Status::Fail), ("certificate", skip)]);
        for step in [Step::Protocol, Step::Certificate] {
            assert_eq!(of(&[ended("192.0.2.9:7417", true, step)]), [("certificate", Status::Fail)]);
        }
    }

    #[test]
    fn one_address_of_two_that_does_not_lead_on_is_a_warning() {
        let mut both = reached();
        both.push(ended("or-3.example:7417", false, Step::Name));
        both.push(ended("192.0.2.9:7417", true, Step::Connection));
        let all = [24, 24, 24];
        let found = faults(&checks(&ticket(), &both, Some(&examination(all, all, NOW))));
        assert_eq!(found, [("name", Status::Warn), ("TCP", Status::Warn)]);
    }

    #[test]
    fn a_ticket_that_expired_by_an_hour_shows_a_clock_that_is_wrong_by_as_much() {
        let mut examination = examination([0; 3], [0; 3], NOW);
        let refused = Refused::Expired { expired_at: NOW + 60, now: NOW + 3_600 };
        examination.found.answer = Some(Err(Refusal::Ticket(refused)));
        let found = checks(&ticket(), &reached(), Some(&examination));
        let failed = [
            ("ticket", Status::Fail),
            ("UDP", Status::Skip),
            ("path MTU", Status::Skip),
            ("clock", Status::Fail),
        ];
        assert_eq!(faults(&found), failed);
        assert!(found[6].found.contains("1 h 0 min behind the host's"), "{}", found[6].found);
    }

    #[test]
    fn a_ticket_that_was_used_is_a_warning_and_the_path_is_looked_at_all_the_same() {
        let mut examination = examination([24; 3], [24; 3], NOW);
        if let Some(Ok(answer)) = &mut examination.found.answer {
            answer.ticket = TicketVerdict::Spent { at: NOW - 60 };
        }
        let found = checks(&ticket(), &reached(), Some(&examination));
        assert_eq!(faults(&found), [("ticket", Status::Warn)]);
    }
}
