//! `trocar reflect`: the packet reflector, which returns datagrams, or forwards stations to a host, over a bad path.

use std::net::{SocketAddr, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::{Args, ValueHint};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use trocar::network::impairments::{DELAY_MAX, DelayTrace, Impairments};
use trocar::network::live::reflector::{ReflectorCounts, ReflectorServer};
use trocar::network::live::sockets::PORT;
use trocar::summary::{Exit, SCHEMA};
use trocar_scene::SimTime;

use crate::args::values::positive;
use crate::failure::Failure;
use crate::{output, signals};

/// Time between two looks at the counts.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Largest trace \[bytes\].
const TRACE_BYTES_MAX: u64 = 64 << 20;

/// `trocar reflect`.
#[derive(Debug, Args)]
pub struct ReflectArgs {
    /// Port for TCP and UDP; 0 is any
    #[arg(long, default_value_t = PORT + 1)]
    pub port: u16,
    /// A host, as ADDRESS:PORT: stations that come here are forwarded to it and its answers back; without it datagrams
    /// return to their senders
    #[arg(long, value_name = "HOST")]
    pub to: Option<String>,
    /// Delay, in seconds, or a file with delays along time: one a line, each for 10 ms, or time,delay
    #[arg(long, value_name = "SECONDS|FILE", value_hint = ValueHint::FilePath, default_value = "0")]
    pub delay: String,
    /// Largest deviation from the delay, in seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds, default_value_t = 0.0)]
    pub jitter: f64,
    /// Each datagram has its own delay, so that later ones overtake
    #[arg(long)]
    pub independent: bool,
    /// Share of datagrams that are lost, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = 0.0)]
    pub loss: f64,
    /// Mean length of a burst of losses, in datagrams; without it each is lost for itself
    #[arg(long, value_name = "DATAGRAMS", value_parser = burst)]
    pub burst: Option<f64>,
    /// Share that arrives twice, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = 0.0)]
    pub duplicate: f64,
    /// Share that is overtaken by the next one, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = 0.0)]
    pub reorder: f64,
    /// Share of which bits flip, 0 to 1
    #[arg(long, value_name = "SHARE", value_parser = share, default_value_t = 0.0)]
    pub corrupt: f64,
    /// Bytes per second that pass
    #[arg(long, value_name = "BYTES", value_parser = rate)]
    pub rate: Option<f64>,
    /// How long a datagram waits for `--rate` before it is lost, in seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds, default_value_t = 0.2)]
    pub queue: f64,
    /// Seed of everything random
    #[arg(long, default_value_t = 1, allow_negative_numbers = true)]
    pub seed: u64,
    /// End after this much time, in seconds; otherwise when a signal comes
    #[arg(long, value_parser = positive)]
    pub seconds: Option<f64>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// Reflects until the time is up or a signal comes, and tells what became of the datagrams.
pub fn reflect(args: &ReflectArgs) -> Result<Exit, Failure> {
    let path = path(args)?;
    let host = args.to.as_deref().map(|to| address("--to", to)).transpose()?;
    let signals = signals::catch()?;
    let server = ReflectorServer::bind(args.port, host, path, args.seed).map_err(Failure::invalid)?;
    let port = server.port();
    let ends = host.map_or("back to their senders".to_owned(), |host| format!("to {host} and back"));
    output::tell(&format!("reflecting datagrams that come to port {port} {ends}; Ctrl-C ends"));
    let (counts, stop) = (server.counts().clone(), Arc::new(AtomicBool::new(false)));
    let running = stop.clone();
    let thread = std::thread::Builder::new()
        .name("reflector".into())
        .spawn(move || server.run(&running))
        .map_err(Failure::internal)?;
    let bar = ProgressBar::new_spinner();
    bar.set_style(
        ProgressStyle::with_template("{msg}  {elapsed}").unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    let begun = Instant::now();
    let limit = args.seconds.map(Duration::from_secs_f64);
    while signals.arrived().is_none()
        && limit.is_none_or(|limit| begun.elapsed() < limit)
        && !thread.is_finished()
    {
        std::thread::sleep(LOOK_EVERY);
        bar.set_message(told(&counts));
    }
    stop.store(true, Ordering::Relaxed);
    bar.finish_and_clear();
    thread
        .join()
        .map_err(|_| Failure::internal("the reflector's thread panicked"))?
        .map_err(|error| Failure::internal(format!("the reflector cannot wait for its sockets: {error}")))?;
    let ended = signals.arrived();
    if args.json {
        let of = |count: &std::sync::atomic::AtomicU64| count.load(Ordering::Relaxed);
        output::print_json(&json!({
            "schema": SCHEMA, "port": port, "seconds": begun.elapsed().as_secs_f64(),
            "received": of(&counts.received), "sent": of(&counts.sent), "lost": of(&counts.lost),
            "error": ended.map(|(name, _)| format!("{name} ended the reflector")),
        }))?;
    } else {
        output::print_text(&told(&counts))?;
    }
    Ok(ended.map_or(Exit::Ok, |(_, exit)| exit))
}

fn told(counts: &ReflectorCounts) -> String {
    let of = |count: &std::sync::atomic::AtomicU64| count.load(Ordering::Relaxed);
    let (received, sent, lost) = (of(&counts.received), of(&counts.sent), of(&counts.lost));
    let under_way = received.saturating_sub(sent + lost);
    format!("{received} datagrams came, {sent} went on, {lost} were lost, {under_way} are under way")
}

/// The path that the options describe.
fn path(args: &ReflectArgs) -> Result<Impairments, Failure> {
    let (delay, trace) = match args.delay.parse::<f64>() {
        Ok(secs) if (0.0..=DELAY_MAX.as_secs_f64()).contains(&secs) => (secs, DelayTrace::default()),
        Ok(secs) => {
            return Err(Failure::usage(format!("--delay {secs}: 0 to 60 seconds are valid, or a file")));
        }
        Err(_) => (0.0, trace(&args.delay)?),
    };
    Ok(Impairments {
        delay: SimTime::from_secs_f64(delay),
        jitter: SimTime::from_secs_f64(args.jitter),
        independent: args.independent,
        trace,
        loss: args.loss,
        burst: args.burst.unwrap_or(0.0),
        duplicate: args.duplicate,
        reorder: args.reorder,
        corrupt: args.corrupt,
        bytes_per_sec: args.rate,
        queue: SimTime::from_secs_f64(args.queue),
    })
}

fn trace(file: &str) -> Result<DelayTrace, Failure> {
    let wrong = |error: &dyn std::fmt::Display| Failure::invalid(format!("--delay {file}: {error}"));
    let length = std::fs::metadata(file).map_err(|error| wrong(&error))?.len();
    if length > TRACE_BYTES_MAX {
        return Err(wrong(&format!("more than {TRACE_BYTES_MAX} bytes")));
    }
    let text = std::fs::read_to_string(file).map_err(|error| wrong(&error))?;
    DelayTrace::parse(&text).map_err(|error| wrong(&error))
}

/// The first address of a name or number with a port.
pub fn address(option: &str, text: &str) -> Result<SocketAddr, Failure> {
    let found = text.to_socket_addrs().map_err(|error| {
        Failure::usage(format!(
            "{option} {text}: {error}; ADDRESS:PORT is expected, such as 192.0.2.7:{PORT} or [2001:db8::7]:{PORT}"
        ))
    });
    found?.next().ok_or_else(|| Failure::usage(format!("{option} {text}: the name has no address")))
}

fn share(text: &str) -> Result<f64, String> {
    within(text, 0.0, 1.0, "a share from 0 to 1")
}

fn seconds(text: &str) -> Result<f64, String> {
    within(text, 0.0, DELAY_MAX.as_secs_f64(), "0 to 60 seconds")
}

fn burst(text: &str) -> Result<f64, String> {
    within(text, 1.0, 1e6, "a mean length of 1 to 1e6 datagrams")
}

fn rate(text: &str) -> Result<f64, String> {
    within(text, 1.0, 1e12, "1 to 1e12 bytes per second")
}

fn within(text: &str, least: f64, most: f64, expected: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (least..=most).contains(&value) => Ok(value),
        _ => Err(format!("{expected} is expected")),
    }
}
