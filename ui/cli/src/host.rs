//! `trocar host`: a session that others join, and the tickets with which they do.

use std::io::IsTerminal;
use std::net::ToSocketAddrs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::json;
use trocar::app::App;
use trocar::network::live::relay::agent::RelayAgent;
use trocar::network::live::relay::key_file;
use trocar::network::live::relay::server::RELAY_PORT;
use trocar::network::live::store_admissions::{unix_secs, wait_for_the_book};
use trocar::network::ticket::private_file;
use trocar::network::ticket::{HostAddress, PlainName, Role, TicketId, TicketStore, Whom, utc};
use trocar::network::{
    HostOptions, Network, NetworkError, NetworkHost, TICKET_LIFE_SECS, addresses, default_book, issue,
};
use trocar::summary::{Exit, SCHEMA};

use crate::args::{HostArgs, HostCommand, RevokeArgs, RunArgs, TicketArgs, TicketsArgs};
use crate::failure::Failure;
use crate::{output, run};

/// Hosts a session, or does what belongs to one.
pub fn host(app: &App, args: &HostArgs) -> Result<Exit, Failure> {
    match (&args.command, args.run.session()) {
        (Some(HostCommand::Ticket(args)), _) => ticket(args),
        (Some(HostCommand::Tickets(args)), _) => tickets(args),
        (Some(HostCommand::Revoke(args)), _) => revoke(args),
        (None, Some(run)) => host_session(app, args, run),
        (None, None) => Err(Failure::usage("name a scenario to host, such as 'trocar host peg-transfer'")),
    }
}

fn host_session(app: &App, args: &HostArgs, session: &RunArgs) -> Result<Exit, Failure> {
    if session.lockstep {
        return Err(Failure::usage("--lockstep: a session that others join runs in real time"));
    }
    // Errors in the scenario are told before a port is taken.
    let scenario = app.scenario(&session.session.scenario)?;
    let options = HostOptions {
        name: "host".to_owned(),
        bind: args.listen.bind,
        port: args.listen.port,
        addresses: args.listen.addresses.clone(),
        book: args.listen.book.clone().unwrap_or_else(default_book),
        insecure: args.insecure,
        is_attended: session.play,
        architecture: args.architecture,
    };
    let mut host = NetworkHost::open(&options)?;
    // It ends after the session.
    let _agent = match (&args.relay, &args.relay_key) {
        (Some(relay), Some(key)) => Some(call_relay(&mut host, relay, key)?),
        _ => None,
    };
    let host = Arc::new(host);
    let wishes = if args.tickets.is_empty() {
        vec![(Role::Operate, "guest".to_owned())]
    } else {
        args.tickets.clone()
    };
    let mut lines = String::new();
    for (role, person) in wishes {
        let ticket = host.ticket(&person, role, TICKET_LIFE_SECS, &scenario.name)?.to_string();
        announce(&ticket, role, &person, session.json)?;
        lines.push_str(&ticket);
        lines.push('\n');
    }
    if let Some(file) = &args.ticket_file {
        private_file::write(file, lines.as_bytes()).map_err(Failure::invalid)?;
    }
    if !session.json {
        output::tell(&format!(
            "hosting '{}' on port {} for TCP and UDP; further tickets: trocar host ticket --role watch",
            scenario.name,
            host.port()
        ));
    }
    run::run_in(app, session, &Network::Host(host))
}

/// Gets a port at a relay, and has the tickets carry it.
fn call_relay(host: &mut NetworkHost, relay: &str, key: &Path) -> Result<RelayAgent, Failure> {
    let wrong = |why: &dyn std::fmt::Display| {
        Failure::usage(format!(
            "--relay {relay}: {why}; ADDRESS:PORT is expected, such as relay.example:{RELAY_PORT}"
        ))
    };
    let place: HostAddress = relay.parse().map_err(|error| wrong(&error))?;
    let key = key_file::read(key).map_err(Failure::invalid)?;
    let found = relay.to_socket_addrs().map_err(|error| wrong(&error))?.next();
    let found = found.ok_or_else(|| wrong(&"the name has no address"))?;
    let agent = RelayAgent::register(found, key, host.local())
        .map_err(|error| Failure { exit: Exit::Unavailable, message: error.to_string() })?;
    let there = HostAddress::new(place.place().clone(), agent.port()).map_err(Failure::internal)?;
    output::tell(&format!("others reach this host by the relay, at {there}"));
    host.also_at(there);
    Ok(agent)
}

/// A ticket is the result that somebody needs at once: stdout, also when the result of the run follows there.
fn announce(ticket: &str, role: Role, person: &str, json: bool) -> Result<(), Failure> {
    if json {
        // The one object on stdout is that of the run.
        output::tell(ticket);
        return Ok(());
    }
    if std::io::stdout().is_terminal() {
        let command = if role == Role::Watch { "watch" } else { "join" };
        output::tell(&format!("ticket for {person} ({role}); on the other machine: trocar {command}"));
    }
    output::print_text(&format!("{ticket}\n"))
}

fn open(book: Option<&PathBuf>) -> Result<TicketStore, Failure> {
    let file = book.cloned().unwrap_or_else(default_book);
    let name: PlainName = "host".parse().map_err(Failure::internal)?;
    Ok(TicketStore::open(&file, &name, wait_for_the_book).map_err(NetworkError::from)?)
}

fn ticket(args: &TicketArgs) -> Result<Exit, Failure> {
    let mut store = open(args.listen.book.as_ref())?;
    let options = HostOptions {
        bind: args.listen.bind,
        addresses: args.listen.addresses.clone(),
        ..HostOptions::default()
    };
    let life_secs = (args.hours * 3_600.0).round().min(1e9) as u64;
    let addresses = addresses(&options, args.listen.port);
    let ticket = issue(&mut store, &args.person, args.role, life_secs, "session", addresses)?;
    if args.json {
        let addresses: Vec<String> = ticket.addresses().iter().map(ToString::to_string).collect();
        output::print_json(&json!({
            "schema": SCHEMA,
            "ticket": ticket.to_string(),
            "role": args.role.to_string(),
            "person": args.person,
            "expires": ticket.expires(),
            "addresses": addresses,
        }))?;
    } else {
        output::print_text(&format!("{ticket}\n"))?;
    }
    Ok(Exit::Ok)
}

fn tickets(args: &TicketsArgs) -> Result<Exit, Failure> {
    let store = open(args.book.as_ref())?;
    let listed = store.book().list(unix_secs());
    if args.json {
        output::print_json(&json!({ "schema": SCHEMA, "tickets": listed }))?;
        return Ok(Exit::Ok);
    }
    let mut text = String::from("number  state     role     expires               person\n");
    for row in &listed {
        let state = serde_json::to_value(row.state).unwrap_or_default();
        let state = state.as_str().unwrap_or_default().to_owned();
        let (id, role, until) = (row.id.to_string(), row.role.to_string(), utc(row.expires));
        text.push_str(&format!("{id:<7} {state:<9} {role:<8} {until:<21} {}\n", row.person));
    }
    output::print_text(&text)?;
    Ok(Exit::Ok)
}

fn revoke(args: &RevokeArgs) -> Result<Exit, Failure> {
    let mut store = open(args.book.as_ref())?;
    let whom = match args.whom.parse::<TicketId>() {
        Ok(id) => Whom::Ticket(id),
        Err(_) => Whom::Person(args.whom.parse().map_err(Failure::usage)?),
    };
    let revoked = store.revoke(&whom, unix_secs()).map_err(NetworkError::from)?.map_err(Failure::usage)?;
    if args.json {
        output::print_json(&json!({ "schema": SCHEMA, "revoked": revoked }))?;
    } else {
        let (tickets, stations) = (revoked.tickets.len(), revoked.stations.len());
        output::print_text(&format!("{tickets} tickets withdrawn, {stations} stations cut off\n"))?;
    }
    Ok(Exit::Ok)
}
