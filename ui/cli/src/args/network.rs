//! The command line of sessions over a network: `trocar host`, `trocar join` and `trocar watch`.

use std::net::IpAddr;
use std::path::PathBuf;

use clap::{ArgMatches, Args, FromArgMatches, Subcommand, ValueHint};
use trocar::network::control::Architecture;
use trocar::network::live::sockets::PORT;
use trocar::network::ticket::{HostAddress, Role};

use super::RunArgs;
use super::picture::{PictureArgs, WindowArgs};
use super::values::{hand, positive};

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
    /// Who computes what, in place of what the scenario says: client-server (the host computes the scene), peer-to-peer (each
    /// station computes it, by all hands) or hybrid (the host computes it, and all hands go to all stations) [default: client-server]
    #[arg(long, value_name = "WORD", value_parser = architecture, help_heading = "Network")]
    pub architecture: Option<Architecture>,
    /// Datagrams without protection, for stations on this machine alone
    #[arg(long, help_heading = "Network")]
    pub insecure: bool,
    /// A relay, as ADDRESS:PORT, for a host that others cannot dial: the tickets carry its port there, too
    #[arg(
        long,
        value_name = "RELAY",
        requires = "relay_key",
        conflicts_with = "insecure",
        help_heading = "Network"
    )]
    pub relay: Option<String>,
    /// File of the relay's key, a copy of the one that the relay has made
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, requires = "relay", help_heading = "Network")]
    pub relay_key: Option<PathBuf>,
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
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
    /// Where the host listens.
    #[command(flatten)]
    pub listen: ListenArgs,
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

impl HostedRun {
    /// The session, if one is hosted.
    pub fn session(&self) -> Option<&RunArgs> {
        self.0.as_deref()
    }
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

fn architecture(text: &str) -> Result<Architecture, String> {
    let known = Architecture::ALL.into_iter().find(|architecture| architecture.word() == text);
    known.ok_or_else(|| format!("there are: {}", Architecture::ALL.map(Architecture::word).join(", ")))
}

fn ticket_wish(text: &str) -> Result<(Role, String), String> {
    let (role_text, person) = text.split_once('=').unwrap_or((text, "guest"));
    Ok((role(role_text)?, person.to_owned()))
}

/// `trocar join`.
#[derive(Debug, Args)]
pub struct JoinArgs {
    /// A hand that this station serves, with its device: NAME=SPEC, such as `left=virtual`; `trocar list devices` names
    /// every device. A mentor serves it once it was handed over
    #[arg(long = "hand", value_name = "NAME=SPEC", value_parser = hand, help_heading = "Session")]
    pub hands: Vec<(String, String)>,
    /// A person moves the hands with mouse, keyboard or gamepad; otherwise the session's virtual trainee moves virtual ones
    #[arg(long, help_heading = "Session")]
    pub play: bool,
    /// What is seen and kept.
    #[command(flatten)]
    pub view: ViewArgs,
    /// The ticket, and how it is shown.
    #[command(flatten)]
    pub ticket: TicketSource,
}

/// `trocar watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// What is seen and kept.
    #[command(flatten)]
    pub view: ViewArgs,
    /// The ticket, and how it is shown.
    #[command(flatten)]
    pub ticket: TicketSource,
}

/// Where the ticket comes from, and who shows it.
#[derive(Debug, Args)]
#[command(next_help_heading = "Network")]
pub struct TicketSource {
    /// The ticket; without it, or `--ticket-file`, it is asked for. Others on this machine can read it here
    #[arg(value_name = "TICKET", help_heading = None::<&str>)]
    pub ticket: Option<String>,
    /// File with the ticket; `-` is stdin
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, conflicts_with = "ticket")]
    pub ticket_file: Option<PathBuf>,
    /// Name of this station, which the others see
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Datagrams without protection, as the host was told; on one machine alone
    #[arg(long)]
    pub insecure: bool,
}

/// What is seen of a session, and what is kept of it.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// End after this much time, in seconds; otherwise when the session is over
    #[arg(long, value_parser = positive, help_heading = "Session")]
    pub seconds: Option<f64>,
    /// Windows.
    #[command(flatten)]
    pub window: WindowArgs,
    /// Pictures.
    #[command(flatten)]
    pub pictures: PictureArgs,
    /// Recording (MCAP); `-` is stdout; without it a station records nothing
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Output")]
    pub record: Option<PathBuf>,
    /// Report (HTML, one file); `-` is stdout; without it a station writes none
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Output")]
    pub report: Option<PathBuf>,
    /// Print exactly one JSON object on stdout (`trocar schema run` describes it)
    #[arg(long, help_heading = "Output")]
    pub json: bool,
    /// Tell beyond this machine that this station is there, by Zenoh: as `--zenoh` of the host, with the same `name=`
    #[arg(long, value_name = "ENDPOINT", num_args = 0..=1, default_missing_value = "", help_heading = "Network")]
    pub zenoh: Option<String>,
}
