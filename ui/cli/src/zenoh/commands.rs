//! `trocar zenoh list`, `router` and `certificate`.

use std::time::{Duration, Instant};

use serde_json::{Value, json};
use trocar::summary::{Exit, SCHEMA};
use trocar_zenoh::certificates;
use trocar_zenoh::certificates::CertificateError;
use trocar_zenoh::keys::of_token;
use trocar_zenoh::live::{Router, SeenSession, Watch, list};
use trocar_zenoh::presence::Change;

use super::present::{failure, settings};
use crate::args::zenoh::{ZenohArgs, ZenohCertificateArgs, ZenohCommand, ZenohListArgs, ZenohRouterArgs};
use crate::escape::printable;
use crate::failure::Failure;
use crate::{output, signals};

/// Time between two looks at signals.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Most changes that are printed as JSON.
const CHANGES_MAX: usize = 4_096;

/// `trocar zenoh`.
pub fn command(args: &ZenohArgs) -> Result<Exit, Failure> {
    let (json, done) = match &args.command {
        ZenohCommand::List(args) => (args.json, sessions(args)),
        ZenohCommand::Router(args) => (args.json, router(args)),
        ZenohCommand::Certificate(args) => (args.json, certificate(args)),
    };
    if json && let Err(failure) = &done {
        output::print_json(&json!({ "schema": SCHEMA, "error": failure.message }))?;
    }
    done
}

fn sessions(args: &ZenohListArgs) -> Result<Exit, Failure> {
    let (settings, rights) = settings("", &args.endpoint)?;
    let signals = signals::catch()?;
    let found = list(&settings, &rights).map_err(|error| failure(&error))?;
    let mut changes = Vec::new();
    if !args.json {
        output::print_text(&table(&found))?;
    }
    if let Some(seconds) = args.seconds {
        let watch = Watch::open(&settings, &rights).map_err(|error| failure(&error))?;
        let begun = Instant::now();
        while signals.arrived().is_none() && begun.elapsed().as_secs_f64() < seconds {
            let Some(change) = watch.next(LOOK_EVERY) else { continue };
            if args.json && changes.len() < CHANGES_MAX {
                changes.push(as_json(&change, begun.elapsed().as_secs_f64()));
            } else if !args.json {
                output::print_text(&format!(
                    "{:6.1} s  {}\n",
                    begun.elapsed().as_secs_f64(),
                    in_words(&change)
                ))?;
            }
        }
    }
    if args.json {
        output::print_json(&json!({ "schema": SCHEMA, "sessions": found, "changes": changes }))?;
    }
    Ok(signals.arrived().map_or(Exit::Ok, |(_, exit)| exit))
}

fn split(change: &Change) -> (&str, bool) {
    match change {
        Change::Came(token) => (token, true),
        Change::Went(token) => (token, false),
    }
}

fn as_json(change: &Change, at_secs: f64) -> Value {
    let (token, came) = split(change);
    let (session, station) = of_token(token).unwrap_or((token, None));
    json!({ "at_secs": at_secs, "session": session, "station": station, "came": came })
}

fn in_words(change: &Change) -> String {
    let (token, came) = split(change);
    let (session, station) = of_token(token).unwrap_or((token, None));
    let who = station.map_or_else(String::new, |station| format!("station {station} of "));
    format!("{who}{} {}", printable(session), if came { "is there" } else { "is gone" })
}

/// Sessions as lines.
fn table(found: &[SeenSession]) -> String {
    if found.is_empty() {
        return "no session is there\n".to_owned();
    }
    let mut text = String::new();
    for session in found {
        let info = |key: &str| session.info[key].as_str().unwrap_or("?").to_owned();
        let list = |value: &Value| -> String {
            let names = value.as_array().into_iter().flatten().filter_map(Value::as_str);
            names.collect::<Vec<_>>().join(", ")
        };
        let alive = if session.alive { "alive" } else { "gone" };
        let protected = if session.info["protected"] == json!(true) { "" } else { ", unprotected" };
        text += &printable(&format!("{}: {}, {alive}{protected}", session.name, info("scenario")));
        for (what, key) in [("hands", "hands"), ("controllers", "controllers")] {
            let names = list(&session.info[key]);
            if !names.is_empty() {
                text += &printable(&format!("; {what} to command: {names}"));
            }
        }
        text.push('\n');
        for station in session.roster.as_array().into_iter().flatten() {
            let number = station["number"].as_u64().unwrap_or_default();
            let here = session.stations_alive.iter().any(|alive| u64::from(*alive) == number);
            let line = format!(
                "  station {number}, {} ({}): {}{}{}",
                station["name"].as_str().unwrap_or("?"),
                station["role"].as_str().unwrap_or("?"),
                if station["here"] == json!(true) { "here" } else { "away" },
                if here { ", alive" } else { "" },
                match list(&station["hands"]) {
                    hands if hands.is_empty() => String::new(),
                    hands => format!(", serves {hands}"),
                }
            );
            text += &printable(&line);
            text.push('\n');
        }
    }
    text
}

fn router(args: &ZenohRouterArgs) -> Result<Exit, Failure> {
    let (settings, rights) = settings("", &args.endpoint)?;
    let signals = signals::catch()?;
    let router = Router::open(&settings, &rights).map_err(|error| failure(&error))?;
    let places: Vec<String> = settings.listen.iter().map(ToString::to_string).collect();
    let who = if settings.is_protected() { "for those named in its file" } else { "unprotected" };
    output::tell(&format!("routing at {} ({who}); Ctrl-C ends", places.join(", ")));
    let begun = Instant::now();
    while signals.arrived().is_none()
        && args.seconds.is_none_or(|seconds| begun.elapsed().as_secs_f64() < seconds)
    {
        std::thread::sleep(LOOK_EVERY);
    }
    drop(router);
    let ended = signals.arrived();
    if args.json {
        output::print_json(&json!({
            "schema": SCHEMA,
            "seconds": begun.elapsed().as_secs_f64(),
            "error": ended.map(|(name, _)| format!("{name} ended the router")),
        }))?;
    }
    Ok(ended.map_or(Exit::Ok, |(_, exit)| exit))
}

fn certificate(args: &ZenohCertificateArgs) -> Result<Exit, Failure> {
    let files =
        certificates::make(&args.folder, &args.name, &args.addresses).map_err(|error| match error {
            CertificateError::Usage(_) => Failure::usage(error),
            CertificateError::File { .. } => Failure::invalid(error),
            CertificateError::Make(_) => Failure::internal(error),
        })?;
    if args.json {
        output::print_json(&json!({
            "schema": SCHEMA, "authority": files.authority, "certificate": files.certificate, "key": files.key,
        }))?;
    } else {
        output::print_text(&format!(
            "{}\n{}\n{}\n",
            files.authority.display(),
            files.certificate.display(),
            files.key.display()
        ))?;
    }
    Ok(Exit::Ok)
}
