//! `trocar relay`: forwards the sealed bytes of sessions whose hosts cannot be dialled.

use std::net::IpAddr;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use clap::{Args, ValueHint};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use trocar::network::live::relay::key_file;
use trocar::network::live::relay::server::{RELAY_PORT, RelayServer, RelayServerCounts};
use trocar::network::relay::SESSIONS_MAX;
use trocar::summary::{Exit, SCHEMA};

use crate::failure::Failure;
use crate::{output, signals};

/// Time between two looks at the counts.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Ports of sessions, if none are named.
const PORTS: &str = "7420-7435";

/// `trocar relay`.
#[derive(Debug, Args)]
pub struct RelayArgs {
    /// Port for TCP and UDP at which hosts register
    #[arg(long, default_value_t = RELAY_PORT)]
    pub port: u16,
    /// Ports for TCP and UDP of sessions, one each, as FIRST-LAST
    #[arg(long, value_name = "FIRST-LAST", value_parser = ports, default_value = PORTS)]
    pub ports: RangeInclusive<u16>,
    /// The address to listen at [default: every one of this machine]
    #[arg(long, value_name = "ADDRESS")]
    pub bind: Option<IpAddr>,
    /// File of the key that hosts of this relay have, too; it is made if there is none
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub key_file: PathBuf,
    /// End after this much time, in seconds; otherwise when a signal comes
    #[arg(long)]
    pub seconds: Option<f64>,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

fn ports(text: &str) -> Result<RangeInclusive<u16>, String> {
    let range = text.split_once('-').and_then(|(first, last)| Some(first.parse().ok()?..=last.parse().ok()?));
    let range: RangeInclusive<u16> = range.ok_or_else(|| format!("valid are two ports, such as {PORTS}"))?;
    let count = usize::from(*range.end()).saturating_sub(usize::from(*range.start())) + 1;
    if range.is_empty() || *range.start() == 0 || count > SESSIONS_MAX {
        return Err(format!("valid are 1 to {SESSIONS_MAX} ports from 1 on, such as {PORTS}"));
    }
    Ok(range)
}

/// Relays until the time is up or a signal comes, and tells what was forwarded.
pub fn relay(args: &RelayArgs) -> Result<Exit, Failure> {
    let limit = args.seconds.map(Duration::try_from_secs_f64).transpose();
    let limit = limit.map_err(|error| Failure::usage(format!("--seconds: {error}; valid are 0 and more")))?;
    let (key, is_new) = key_file::read_or_make(&args.key_file).map_err(Failure::invalid)?;
    let signals = signals::catch()?;
    let server =
        RelayServer::bind(args.bind, args.port, args.ports.clone(), key).map_err(Failure::invalid)?;
    if is_new {
        output::tell(&format!(
            "a new key is in {}; hosts of this relay need a copy",
            args.key_file.display()
        ));
    }
    let (port, file) = (server.port(), args.key_file.display());
    output::tell(&format!(
        "relaying sessions of hosts that call: trocar host SCENARIO --relay THIS_MACHINE:{port} --relay-key {file}; Ctrl-C \
         ends"
    ));
    let (counts, stop) = (server.counts().clone(), Arc::new(AtomicBool::new(false)));
    let running = stop.clone();
    let thread = std::thread::Builder::new()
        .name("relay".into())
        .spawn(move || server.run(&running))
        .map_err(Failure::internal)?;
    let bar = if args.json { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    bar.set_style(
        ProgressStyle::with_template("{msg}  {elapsed}").unwrap_or_else(|_| ProgressStyle::default_bar()),
    );
    let begun = Instant::now();
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
        .map_err(|_| Failure::internal("the relay's thread panicked"))?
        .map_err(|error| Failure::internal(format!("the relay cannot wait for its sockets: {error}")))?;
    let ended = signals.arrived();
    if args.json {
        output::print_json(&json!({
            "schema": SCHEMA, "port": port, "seconds": begun.elapsed().as_secs_f64(),
            "forwarded": counts.forwarded.load(Ordering::Relaxed),
            "dropped": counts.dropped.load(Ordering::Relaxed),
            "refused_hosts": counts.refused.load(Ordering::Relaxed),
            "error": ended.map(|(name, _)| format!("{name} ended the relay")),
        }))?;
    } else {
        output::print_text(&told(&counts))?;
    }
    Ok(ended.map_or(Exit::Ok, |(_, exit)| exit))
}

fn told(counts: &RelayServerCounts) -> String {
    let (sessions, streams) =
        (counts.sessions.load(Ordering::Relaxed), counts.streams.load(Ordering::Relaxed));
    let (forwarded, dropped) =
        (counts.forwarded.load(Ordering::Relaxed), counts.dropped.load(Ordering::Relaxed));
    format!("{sessions} sessions, {streams} streams; {forwarded} datagrams forwarded, {dropped} not")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_of_sessions_are_a_range_within_the_limit() {
        assert_eq!(ports("7420-7435"), Ok(7_420..=7_435));
        assert_eq!(ports("7420-7420"), Ok(7_420..=7_420));
        for wrong in ["7420", "7435-7420", "0-5", "1-9999", "a-b", ""] {
            assert!(ports(wrong).is_err_and(|told| told.contains("valid are")), "{wrong}");
        }
    }
}
