//! `trocar join` and `trocar watch`: a station of a session that somebody hosts.

use std::io::{BufRead, IsTerminal, Read};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use indicatif::{ProgressBar, ProgressStyle};
use trocar::app::App;
use trocar::network::control::ClientState;
use trocar::network::ticket::{LINE_MAX, Role, Ticket};
use trocar::network::{JoinOptions, JoinProgress, Network, Station};
use trocar::summary::Exit;

use crate::args::{JoinArgs, RunArgs, SessionArgs, TicketSource, ViewArgs, WatchArgs};
use crate::failure::Failure;
use crate::{output, run, signals};

/// Joins a session, and serves its hands.
pub fn join(app: &App, args: &JoinArgs) -> Result<Exit, Failure> {
    let options = JoinOptions {
        name: args.ticket.name.clone(),
        hands: args.hands.clone(),
        play: args.play,
        insecure: args.ticket.insecure,
        ..JoinOptions::default()
    };
    take_part(app, &args.ticket, &options, &args.view)
}

/// Looks on at a session.
pub fn watch(app: &App, args: &WatchArgs) -> Result<Exit, Failure> {
    let options = JoinOptions {
        name: args.ticket.name.clone(),
        insecure: args.ticket.insecure,
        ..JoinOptions::default()
    };
    take_part(app, &args.ticket, &options, &args.view)
}

fn take_part(
    app: &App,
    source: &TicketSource,
    options: &JoinOptions,
    view: &ViewArgs,
) -> Result<Exit, Failure> {
    let ticket = ticket(source)?;
    let stop = signals::catch()?.stop().clone();
    let station = Arc::new(joined(app, &ticket, options, &stop, view.json)?);
    if !view.json {
        let role = station.role;
        output::tell(&format!("in the session '{}' as {} ({role})", station.scenario.name, station.name));
    }
    let args = RunArgs {
        session: SessionArgs {
            scenario: station.scenario.name.clone(),
            seed: station.seed,
            hands: options.hands.clone(),
            ..SessionArgs::default()
        },
        seconds: view.seconds,
        window: view.window,
        lockstep: false,
        play: options.play,
        bindings: None,
        faults: None,
        resume: None,
        reflector: None,
        consoles: Vec::new(),
        pictures: view.pictures.clone(),
        record: view.record.clone(),
        record_exact: false,
        no_record: view.record.is_none(),
        report: view.report.clone(),
        no_report: view.report.is_none(),
        json: view.json,
        zenoh: view.zenoh.clone(),
    };
    run::run_in(app, &args, &Network::Station(station))
}

/// The ticket of the command line, of a file, or of a person who is asked for it.
fn ticket(source: &TicketSource) -> Result<Ticket, Failure> {
    let text = match (&source.ticket, &source.ticket_file) {
        (Some(text), _) => {
            tracing::warn!(
                "others on this machine can read the ticket on the command line; it works once: \
                 --ticket-file FILE, or - for stdin, keeps the next one to yourself"
            );
            text.clone()
        }
        (None, Some(file)) => return ticket_in(file),
        (None, None) if std::io::stdin().is_terminal() => {
            eprint!("ticket: ");
            let typed = console::Term::stderr().read_secure_line();
            typed.map_err(|error| Failure::usage(format!("no ticket: {error}")))?
        }
        (None, None) => {
            return Err(Failure::usage("no ticket: name one, or a file with --ticket-file, - for stdin"));
        }
    };
    parse(&text)
}

/// The ticket in a file; `-` is stdin.
pub fn ticket_in(file: &Path) -> Result<Ticket, Failure> {
    parse(&read(file)?)
}

fn parse(text: &str) -> Result<Ticket, Failure> {
    text.lines().next().unwrap_or_default().trim().parse().map_err(Failure::usage)
}

fn read(file: &Path) -> Result<String, Failure> {
    let wrong = |error: std::io::Error| Failure::invalid(format!("{}: {error}", file.display()));
    let mut text = String::new();
    // A ticket is one line; of anything else no more is read than shows that it is none.
    let most = LINE_MAX as u64 + 64;
    if file == Path::new("-") {
        std::io::stdin().lock().take(most).read_line(&mut text).map_err(wrong)?;
    } else {
        std::fs::File::open(file).map_err(wrong)?.take(most).read_to_string(&mut text).map_err(wrong)?;
    }
    Ok(text)
}

fn joined(
    app: &App,
    ticket: &Ticket,
    options: &JoinOptions,
    stop: &AtomicBool,
    is_silent: bool,
) -> Result<Station, Failure> {
    let bar = if is_silent { ProgressBar::hidden() } else { ProgressBar::new(0) };
    let style = ProgressStyle::with_template("{spinner} {msg} {wide_bar} {bytes}/{total_bytes}");
    if let Ok(style) = style {
        bar.set_style(style);
    }
    let mut show = |progress: &JoinProgress, trouble: Option<&str>| {
        let told = match progress.state {
            ClientState::Away | ClientState::Connecting => trouble.unwrap_or("connecting to the host"),
            ClientState::Opening => "asking to be let in",
            ClientState::Loading => "getting the scene",
            ClientState::Building => "building the scene",
            ClientState::Running | ClientState::Ended => "in the session",
        };
        bar.set_message(told.to_owned());
        if let Some((arrived, bytes)) = progress.scene {
            bar.set_length(u64::from(bytes));
            bar.set_position(u64::from(arrived));
        }
        bar.tick();
    };
    let joined = trocar::network::join(app.registry(), ticket, options, stop, &mut show);
    bar.finish_and_clear();
    if let Err(error) = &joined
        && let Some(signal) = signals::catch()?.arrived()
    {
        return Err(Failure { exit: signal.1, message: format!("{}: {error}", signal.0) });
    }
    let station = joined?;
    if station.role == Role::Watch && !options.hands.is_empty() {
        return Err(Failure::usage("a ticket to watch serves no hands"));
    }
    Ok(station)
}
