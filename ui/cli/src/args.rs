//! The command line.

#[cfg(test)]
mod help_tests;
mod network;
pub mod picture;
pub mod values;
pub mod zenoh;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum, ValueHint};
use serde_json::Value;
use trocar::tuning;

pub use network::{
    HostArgs, HostCommand, JoinArgs, RevokeArgs, TicketArgs, TicketSource, TicketsArgs, ViewArgs, WatchArgs,
};
pub use picture::{PictureArgs, PictureQuality, StereoLayout, WindowArgs};
use values::{hand, positive};

/// Surgical simulation by actors: one Model, many controllers, each at a rate of its own.
#[derive(Debug, Parser)]
#[command(name = "trocar", version, max_term_width = 100, arg_required_else_help = true)]
#[command(
    after_help = "Exit codes: 0 ok, 1 an expectation failed or the exercise was not completed, 2 usage, \
    3 a device or graphics adapter is missing, 4 a scenario or file cannot be used, a result could not be written or a \
    picture not be made, 69 a host cannot be reached or a port is in use, 70 internal error, 75 full, taken or too slow: \
    later perhaps, 76 the other program does not understand this one, 77 ticket or role do not allow it, 129, 130 and 143 \
    ended by SIGHUP, SIGINT and SIGTERM.\n\
    No score is clinically validated."
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// More messages on stderr; twice for even more
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
}

/// The whole command line. Whatever takes a value also takes a number below zero, and says itself what is wrong with it:
/// nobody means an option by `-1`.
pub fn command() -> clap::Command {
    fn with_numbers(command: clap::Command) -> clap::Command {
        let takes_value = |arg: &clap::Arg| arg.is_positional() || arg.get_action().takes_values();
        command
            .mut_args(|arg| if takes_value(&arg) { arg.allow_negative_numbers(true) } else { arg })
            .mut_subcommands(with_numbers)
    }
    with_numbers(<Cli as clap::CommandFactory>::command())
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a scenario: leaves a score, a recording and a report
    Run(RunArgs),
    /// Host a session of a scenario: others join it with the tickets that it prints
    Host(HostArgs),
    /// Join a session with a ticket: same scene, own hands, own window
    Join(JoinArgs),
    /// Look on at a session with a ticket, and point and draw if the ticket allows it
    Watch(WatchArgs),
    /// List what there is: scenarios, controllers, components, devices, fault plans, suites, tissues, templates
    List(ListArgs),
    /// Play a recording back, and compare it with its own hashes
    Replay(ReplayArgs),
    /// Recordings: count what they hold, recover damaged ones
    Recording {
        /// What to do
        #[command(subcommand)]
        command: crate::recording::RecordingCommand,
    },
    /// Draw who acts in a scenario, at which rates, and what flows between them
    Graph(GraphArgs),
    /// Measure figures beside the floors of this machine
    Bench(BenchArgs),
    /// Change values of a running session, hold sets of values against each other, save what was found good
    Tune(TuneArgs),
    /// Faults: show what a session survives by doing it
    Faults {
        /// What to do
        #[command(subcommand)]
        command: FaultsCommand,
    },
    /// Inspect a mesh file: size, unit, volume, defects, worst elements, regions; draw it, mend it
    Mesh(crate::mesh::MeshArgs),
    /// Draw a picture of every scenario, without a window
    Gallery(crate::gallery::GalleryArgs),
    /// Run random fault plans in virtual time, on all cores, and check what must hold whatever they do
    Soak(SoakArgs),
    /// Return datagrams, or forward stations to a host, as a bad network would: delay, loss, bursts, reordering
    Reflect(crate::reflect::ReflectArgs),
    /// Sessions beyond one machine, by Zenoh: list them, route between sites, make certificates
    Zenoh(zenoh::ZenohArgs),
    /// Forward sessions of hosts that cannot be dialled: sealed bytes, without any key of them
    Relay(crate::relay::RelayArgs),
    /// Start a project of your own from a template: a crate with a program, a scenario and tests
    New(NewArgs),
    /// Look at this machine, or at the path to a host: what limits it, and how to mend it
    Doctor(DoctorArgs),
    /// Print a JSON schema
    Schema(SchemaArgs),
    /// Print completions for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
}

impl Command {
    /// Folders from which meshes may be read.
    pub fn assets(&self) -> &[PathBuf] {
        match self {
            Command::Run(args) => &args.session.assets,
            Command::Host(args) => args.assets(),
            Command::Graph(args) => &args.session.assets,
            _ => &[],
        }
    }
}

/// What to simulate.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Session")]
pub struct SessionArgs {
    /// Name of a scenario (see `trocar list`), or a TOML file
    #[arg(value_hint = ValueHint::FilePath, help_heading = None::<&str>)]
    pub scenario: String,
    /// Seed of everything random
    #[arg(long, default_value_t = 1, allow_negative_numbers = true)]
    pub seed: u64,
    /// Another device for a hand: NAME=SPEC, such as `left=virtual:impedance=off` or `right=replay:hand.csv,start=file`;
    /// `trocar list devices` names every device and all its options
    #[arg(long = "hand", value_name = "NAME=SPEC", value_parser = hand)]
    pub hands: Vec<(String, String)>,
    /// Skill of the virtual trainee: novice, intermediate or expert
    #[arg(long)]
    pub skill: Option<String>,
    /// The trainee is left-handed
    #[arg(long)]
    pub left_handed: bool,
    /// Another value in the scenario: ENTITY.COMPONENT.FIELD=VALUE, where `*` in the entity stands for any letters,
    /// such as `ring.*.rigid_body.mass=0.02`; also `gravity.2=-1.62`, `controller.engine.rate_hz=250`, `task.…`,
    /// `hand.…`
    #[arg(long, value_name = "FIELD=VALUE", value_parser = tuning::parse_assignment)]
    pub set: Vec<(String, Value)>,
    /// A folder besides the scenario's own from which its meshes may be read; may be given several times
    #[arg(long, value_name = "DIR", value_hint = ValueHint::DirPath)]
    pub assets: Vec<PathBuf>,
    /// Sets of values to switch between while the session runs (see `trocar tune`)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub tuning: Option<PathBuf>,
    /// The set of `--tuning` to begin with
    #[arg(long = "use", value_name = "SET", requires = "tuning")]
    pub use_set: Option<String>,
}

/// `trocar run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// What to simulate.
    #[command(flatten)]
    pub session: SessionArgs,
    /// End after this much time of the session, in seconds; otherwise when the exercise is over
    #[arg(long, allow_negative_numbers = true, value_parser = positive, help_heading = "Session")]
    pub seconds: Option<f64>,
    /// Windows.
    #[command(flatten)]
    pub window: WindowArgs,
    /// Virtual time on one thread, as fast as it goes: the same seed gives the same bits
    #[arg(long, help_heading = "Session")]
    pub lockstep: bool,
    /// A person moves the hands with mouse, keyboard or gamepad, in the place of the virtual trainee
    #[arg(long, conflicts_with = "skill", help_heading = "Session")]
    pub play: bool,
    /// Which key, button or stick means what, for a person who plays (TOML)
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, requires = "play", help_heading = "Session")]
    pub bindings: Option<PathBuf>,
    /// Go on where this recording ends, such as that of a session whose machine died; with the seed that it had
    #[arg(
        long,
        value_name = "RECORDING",
        value_hint = ValueHint::FilePath,
        conflicts_with = "seed",
        help_heading = "Session"
    )]
    pub resume: Option<PathBuf>,
    /// Fault plan: what shall go wrong, and what must hold all the same; a name (see `trocar list plans`)
    /// or a TOML file
    #[arg(long, value_name = "PLAN", value_hint = ValueHint::FilePath, help_heading = "Session")]
    pub faults: Option<String>,
    /// A packet reflector that hands of the scenario go through, as ADDRESS:PORT (see `trocar reflect`), in place of one that
    /// the session starts: for scenarios such as `tele-liver`
    #[arg(long, value_name = "REFLECTOR", conflicts_with = "lockstep", help_heading = "Session")]
    pub reflector: Option<String>,
    /// A hand that leads a robot elsewhere, as at a surgeon's console: NAME=itp:HOST:PORT, with arm=left|right, pedal=BUTTON,
    /// dialect=raven|raven-sim, scale= and bind= after commas. The session is then that console alone, without the physics;
    /// the protocol (ITP) is unprotected
    #[arg(
        long = "console",
        value_name = "NAME=ROBOT",
        value_parser = hand,
        conflicts_with_all = ["lockstep", "reflector"],
        help_heading = "Session"
    )]
    pub consoles: Vec<(String, String)>,
    /// Pictures.
    #[command(flatten)]
    pub pictures: PictureArgs,
    /// Recording (MCAP); `-` is stdout [default: SCENARIO.mcap, or with the next free number SCENARIO-2.mcap]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Output")]
    pub record: Option<PathBuf>,
    /// Record every commit to the last bit; otherwise some components are sampled and rounded
    #[arg(long, conflicts_with = "no_record", help_heading = "Output")]
    pub record_exact: bool,
    /// Do not record
    #[arg(long, conflicts_with = "record", help_heading = "Output")]
    pub no_record: bool,
    /// Report (HTML, one file); `-` is stdout [default: report-SCENARIO.html, with the number of the recording]
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Output")]
    pub report: Option<PathBuf>,
    /// Write no report
    #[arg(long, conflicts_with = "report", help_heading = "Output")]
    pub no_report: bool,
    /// Print exactly one JSON object on stdout (`trocar schema run` describes it)
    #[arg(long, help_heading = "Output")]
    pub json: bool,
    /// Be reached beyond this machine by Zenoh: an endpoint to listen at, or `connect=`, `listen=`, `name=`, `config=`
    /// [default endpoint: tcp/127.0.0.1:7447]
    #[arg(
        long,
        value_name = "ENDPOINT",
        num_args = 0..=1,
        default_missing_value = "",
        conflicts_with = "lockstep",
        help_heading = "Network"
    )]
    pub zenoh: Option<String>,
}

/// `trocar list`.
#[derive(Debug, Args)]
pub struct ListArgs {
    /// What to list; everything without it
    pub what: Option<Listed>,
    /// As JSON
    #[arg(long)]
    pub json: bool,
}

/// What can be listed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Listed {
    /// Scenarios that are part of the program.
    Scenarios,
    /// Kinds of controllers that a scenario can ask for.
    Controllers,
    /// Components that an entity can have.
    Components,
    /// Devices that a hand can have, and their options.
    Devices,
    /// Ready fault plans.
    Plans,
    /// Suites of `trocar bench`.
    Suites,
    /// Tissues: what has been measured of them, and by whom.
    Tissues,
    /// Templates of `trocar new`.
    Templates,
}

/// `trocar replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The recording
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Another recording, shown beside this one
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = None::<&str>)]
    pub beside: Option<PathBuf>,
    /// The folder of the scenario, where it has textures in files
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath, help_heading = None::<&str>)]
    pub folder: Option<PathBuf>,
    /// Windows.
    #[command(flatten)]
    pub window: WindowArgs,
    /// Pictures.
    #[command(flatten)]
    pub pictures: PictureArgs,
    /// Report (HTML, one file); `-` is stdout
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, help_heading = "Output")]
    pub report: Option<PathBuf>,
    /// Print exactly one JSON object on stdout
    #[arg(long, help_heading = "Output")]
    pub json: bool,
}

/// `trocar graph`.
#[derive(Debug, Args)]
pub struct GraphArgs {
    /// What to draw.
    #[command(flatten)]
    pub session: SessionArgs,
    /// In which language
    #[arg(long, value_enum, default_value_t = GraphFormat::Mermaid, help_heading = None::<&str>)]
    pub format: GraphFormat,
    /// Run live for this many seconds first, and write the achieved rates into the graph
    #[arg(
        long,
        allow_negative_numbers = true,
        value_name = "SECONDS",
        value_parser = positive,
        help_heading = None::<&str>,
    )]
    pub after: Option<f64>,
}

/// Languages of graphs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GraphFormat {
    /// For Markdown pages.
    Mermaid,
    /// For Graphviz.
    Dot,
    /// For programs.
    Json,
}

/// `trocar bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// The suite; see `trocar list suites`
    #[arg(default_value = "kernel")]
    pub suite: String,
    /// A Python with the peers that are timed beside ours: coal and FCL for the suite `collision`
    /// (tests/peers/requirements.txt), MuJoCo, pypbd, PyElastica and Bullet for `simulator`
    /// (tests/peers/requirements-simulator.txt)
    #[arg(long, value_name = "PYTHON")]
    pub peers: Option<PathBuf>,
    /// Also draw how costs grow, as SVG (suites `collision` and `simulator`)
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Overwrite the file of `--plot` when there is one
    #[arg(long, requires = "plot")]
    pub force: bool,
    /// Print the figures as a Markdown table, without those of growth
    #[arg(long, conflicts_with = "json")]
    pub markdown: bool,
    /// Also write that table into a Markdown file with a place for it, such as docs/figures.md: this part of the file is
    /// replaced, without `--force`
    #[arg(long, value_name = "FILE")]
    pub into: Option<PathBuf>,
    /// Print exactly one JSON object on stdout (`trocar schema bench` describes it)
    #[arg(long)]
    pub json: bool,
}

/// `trocar tune`.
#[derive(Debug, Args)]
pub struct TuneArgs {
    /// What to do
    #[command(subcommand)]
    pub command: TuneCommand,
    /// Process number of the session, when it was started in another folder, or several run in this one
    #[arg(long, global = true, allow_negative_numbers = true, value_name = "PID")]
    pub session: Option<u32>,
    /// Print exactly one JSON object on stdout
    #[arg(long, global = true)]
    pub json: bool,
}

/// What to do to a running session.
#[derive(Debug, Subcommand)]
pub enum TuneCommand {
    /// List fields with their values
    List {
        /// An entity, a component of it, or a field; `*` stands for any letters
        #[arg(default_value = "*")]
        pattern: String,
    },
    /// Set fields, all of them or none
    Set {
        /// Such as `ring.*.rigid_body.mass=0.02`
        #[arg(required = true, value_name = "FIELD=VALUE", value_parser = tuning::parse_assignment)]
        values: Vec<(String, Value)>,
    },
    /// Go to a set of values; what is tuned and not in it goes back to the scenario's value
    Use {
        /// Name of the set; `base` is the scenario as it is written
        set: String,
    },
    /// Keep what is tuned now as a set
    Keep {
        /// Name of the set, such as `b`
        set: String,
    },
    /// What is tuned, and which sets there are
    Status,
    /// Write what is tuned into the scenario's file, which needs no `--force`; its comments and order stay
    Save {
        /// A new file instead; any other one that is there is refused
        #[arg(value_hint = ValueHint::FilePath)]
        file: Option<PathBuf>,
    },
    /// Write all sets to a file for `--tuning`
    Export {
        /// The file; stdout without it
        #[arg(value_hint = ValueHint::FilePath)]
        file: Option<PathBuf>,
        /// Overwrite the file when it is there
        #[arg(long, requires = "file")]
        force: bool,
    },
}

/// `trocar faults`.
#[derive(Debug, Subcommand)]
pub enum FaultsCommand {
    /// Kill, stall, unplug, corrupt and flood the peg transfer, and print what came of it beside its bars
    Verify(VerifyArgs),
}

/// `trocar faults verify`.
#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// Only in virtual time: exact, the same on every machine
    #[arg(long)]
    pub lockstep: bool,
    /// Only in real time: medians, and what becomes of the process itself
    #[arg(long)]
    pub live: bool,
    /// Only measurements whose name has this in it: `disk`, `link`, `kill_engine`
    #[arg(long, value_name = "TEXT")]
    pub only: Option<String>,
    /// Print exactly one JSON object on stdout (`trocar schema bench` describes it)
    #[arg(long)]
    pub json: bool,
}

/// `trocar soak`.
#[derive(Debug, Args)]
pub struct SoakArgs {
    /// Name of a scenario, or a TOML file
    #[arg(default_value = "peg-transfer", value_hint = ValueHint::FilePath)]
    pub scenario: String,
    /// How many plans
    #[arg(
        long,
        default_value_t = 1000,
        allow_negative_numbers = true,
        value_parser = clap::value_parser!(u64).range(1..=1_000_000),
    )]
    pub plans: u64,
    /// Seed of the first plan; the others follow
    #[arg(long, value_name = "SEED", default_value_t = 1, allow_negative_numbers = true)]
    pub from: u64,
    /// End each run after this much time of the session, in seconds; otherwise when the exercise is over
    #[arg(long, allow_negative_numbers = true, value_parser = positive)]
    pub seconds: Option<f64>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// `trocar new`.
#[derive(Debug, Args)]
pub struct NewArgs {
    /// The new crate's name
    pub name: String,
    /// What to start from (see `trocar list templates`)
    #[arg(long, short, default_value = "controller")]
    pub template: String,
    /// Folder of the project [default: ./NAME]
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub path: Option<PathBuf>,
    /// Where the project finds Trocar: a checkout, or the URL of a git repository [default: the checkout that
    /// this program was built from]
    #[arg(long, value_name = "PLACE", value_hint = ValueHint::DirPath)]
    pub trocar: Option<String>,
}

/// `trocar doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// Look at the path to the host of this ticket instead: name, connection, certificate, datagrams, their length, clocks;
    /// `-` is stdin. The ticket lets in afterwards as before
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub ticket_file: Option<PathBuf>,
    /// Datagrams without protection, as the host was told; on one machine alone
    #[arg(long, requires = "ticket_file")]
    pub insecure: bool,
    /// As JSON
    #[arg(long)]
    pub json: bool,
}

/// `trocar schema`.
#[derive(Debug, Args)]
pub struct SchemaArgs {
    /// Of what
    #[arg(value_enum, default_value_t = SchemaOf::Scenario)]
    pub of: SchemaOf,
}

/// What has a JSON schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SchemaOf {
    /// Scenario files.
    Scenario,
    /// Output of `run --json` and `replay --json`.
    Run,
    /// Output of `bench --json`.
    Bench,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use proptest::prelude::*;
    use proptest::sample::select;

    #[test]
    fn the_command_line_is_sound() {
        Cli::command().debug_assert();
    }

    /// Words of command lines, and others.
    fn word() -> impl Strategy<Value = String> {
        prop_oneof![
            2 => select(vec![
                "run", "list", "replay", "graph", "bench", "new", "doctor", "schema", "completions", "peg-transfer",
                "--seed", "--hand", "--seconds", "--after", "--skill", "--json", "--format", "--faults", "--", "-",
                "-v", "-vvvv", "left=virtual", "=", "mermaid", "kernel", "1", "-1", "nan", "1e400", "0.0",
                "18446744073709551616",
            ]).prop_map(str::to_owned),
            1 => "\\PC{0,20}",
            1 => "--?[a-z]{0,8}(=[-a-z0-9.]{0,6})?",
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

        #[test]
        fn any_command_line_is_understood_or_refused(words in prop::collection::vec(word(), 0..8)) {
            match Cli::try_parse_from(std::iter::once("trocar".to_owned()).chain(words)) {
                Ok(Cli { command: Command::Run(run), .. }) => {
                    prop_assert!(run.seconds.is_none_or(|secs| secs > 0.0 && secs <= 1e6));
                    prop_assert!(run.session.hands.iter().all(|(name, spec)| !name.is_empty() && !spec.is_empty()));
                }
                Ok(Cli { command: Command::Graph(graph), .. }) => {
                    prop_assert!(graph.after.is_none_or(|secs| secs > 0.0 && secs <= 1e6));
                }
                Ok(_) => {}
                Err(error) => prop_assert!(!error.to_string().is_empty()),
            }
        }
    }
}
