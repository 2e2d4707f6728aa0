//! `trocar host`: a session that others join, and the tickets with which they do.

use std::io::IsTerminal;
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;

use clap::{ArgMatches, Args, FromArgMatches, Subcommand, ValueHint};
use serde_json::json;
use trocar::app::App;
use trocar::network::live::sockets::PORT;
use trocar::network::live::store_admissions::{unix_secs, wait_for_the_book};
use trocar::network::ticket::private_file;
use trocar::network::ticket::{HostAddress, PlainName, Role, TicketId, TicketStore, Whom, utc};
use trocar::network::{
    HostOptions, Network, NetworkError, NetworkHost, TICKET_LIFE_SECS, addresses, default_book, issue,
};
use trocar::summary::{Exit, SCHEMA};

use crate::args::{RunArgs, positive};
use crate::failure::Failure;
use crate::{output, run};

/// `trocar host`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct HostArgs {
    /// What to run. Before the sub-command, which is gone from the matches once it is taken.
    #[command(flatten)]
    pub run: HostedRun,
    /// What to do besides.
    #[command(subcommand)]
    pub command: Option<HostCommand>,
    /// Where to listen.
    #[command(flatten)]
    pub listen: ListenArgs,
    /// Ticket to give out at the start: ROLE or ROLE=PERSON, with the roles operate, mentor and watch; may be given several
    /// times [default: operate]
    #[arg(long = "ticket", value_name = "ROLE[=PERSON]", value_parser = ticket_wish, help_heading = "Network")]
    pub tickets: Vec<(Role, String)>,
    /// File for the tickets too, one a line, which only its owner can read
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Network")]
    pub ticket_file: Option<PathBuf>,
    /// Datagrams without protection, for stations on this machine alone
    #[arg(long, help_heading = "Network")]
    pub insecure: bool,
}

/// The arguments of a run, where there is no sub-command.
#[derive(Debug)]
pub struct HostedRun(Option<Box<RunArgs>>);

impl Args for HostedRun {
    fn augment_args(command: clap::Command) -> clap::Command {
        RunArgs::augment_args(command)
    }
    fn augment_args_for_update(command: clap::Command) -> clap::Command {
        RunArgs::augment_args_for_update(command)
    }
}

impl FromArgMatches for HostedRun {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        if matches.subcommand_name().is_some() {
            return Ok(Self(None));
        }
        RunArgs::from_arg_matches(matches).map(|run| Self(Some(Box::new(run))))
    }
    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// Where a host listens, and where its tickets are.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Network")]
pub struct ListenArgs {
    /// Port for TCP and UDP; 0 is any
    #[arg(long, default_value_t = PORT)]
    pub port: u16,
    /// The address to listen at [default: every one of this machine]
    #[arg(long, value_name = "ADDRESS")]
    pub bind: Option<IpAddr>,
    /// An address that tickets carry, with its port, in place of those that this machine knows of itself; may be given
    /// several times
    #[arg(long = "address", value_name = "ADDRESS:PORT", value_parser = host_address)]
    pub addresses: Vec<HostAddress>,
    /// File of the host's certificate and tickets [default: in the user's folder of state]
    #[arg(long = "tickets", value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub book: Option<PathBuf>,
}

/// What a host does besides hosting.
#[derive(Debug, Subcommand)]
pub enum HostCommand {
    /// Give out a ticket, for a host that runs or will run with the same file of tickets
    Ticket(TicketArgs),
    /// List the tickets that were given out
    Tickets(TicketsArgs),
    /// Withdraw a ticket, or all of a person; their stations are cut off
    Revoke(RevokeArgs),
}

/// `trocar host ticket`.
#[derive(Debug, Args)]
pub struct TicketArgs {
    /// What its holder may do: operate, mentor or watch
    #[arg(long, default_value = "operate", value_parser = role)]
    pub role: Role,
    /// For whom it is
    #[arg(long, default_value = "guest")]
    pub person: String,
    /// Hours after which it lets nobody in any more
    #[arg(long, value_name = "HOURS", default_value_t = 24.0, value_parser = positive)]
    pub hours: f64,
    /// Where the host listens.
    #[command(flatten)]
    pub listen: ListenArgs,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// `trocar host tickets`.
#[derive(Debug, Args)]
pub struct TicketsArgs {
    /// File of the host's tickets [default: in the user's folder of state]
    #[arg(long = "tickets", value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub book: Option<PathBuf>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// `trocar host revoke`.
#[derive(Debug, Args)]
pub struct RevokeArgs {
    /// Number of a ticket (see `trocar host tickets`), or the person whose tickets are withdrawn
    pub whom: String,
    /// File of the host's tickets [default: in the user's folder of state]
    #[arg(long = "tickets", value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub book: Option<PathBuf>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

impl HostArgs {
    /// Folders from which meshes may be read.
    pub fn assets(&self) -> &[PathBuf] {
        self.run.0.as_ref().map_or(&[], |run| &run.session.assets)
    }
}

fn role(text: &str) -> Result<Role, String> {
    text.parse().map_err(|_| "valid are operate, mentor and watch".to_owned())
}

fn host_address(text: &str) -> Result<HostAddress, String> {
    text.parse().map_err(|error| format!("{error}"))
}

fn ticket_wish(text: &str) -> Result<(Role, String), String> {
    let (role_text, person) = text.split_once('=').unwrap_or((text, "guest"));
    Ok((role(role_text)?, person.to_owned()))
}

/// Hosts a session, or does what belongs to one.
pub fn host(app: &App, args: &HostArgs) -> Result<Exit, Failure> {
    match (&args.command, &args.run.0) {
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
    };
    let host = Arc::new(NetworkHost::open(&options)?);
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
