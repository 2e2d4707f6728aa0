//! The page around the charts and tables.

use std::fmt::Write as _;

use trocar::summary::Mode;

use super::scale::short;
use super::{Report, histogram, network, paths, series, stages, tables, teleoperation, timeline};
use crate::escape::{escape, escape_json};

const STYLE: &str = include_str!("style.css");
const KEY: &str = "<span class=\"key\"><i class=\"left\"></i>left <i class=\"right\"></i>right</span>";
const KEY_WITH_DROPS: &str = "<span class=\"key\"><i class=\"left\"></i>left <i class=\"right\"></i>right \
     <i class=\"cross\">×</i>error</span>";

/// The whole report as one HTML document without external resources.
pub fn html(report: &Report) -> String {
    let mut out = String::with_capacity(1 << 18);
    let title = escape(report.title);
    let _ = write!(
        out,
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\
         <title>{title} – Trocar report</title><style>{STYLE}</style></head><body><main>"
    );
    header(&mut out, report);
    tiles(&mut out, report);
    failures(&mut out, report);
    section(&mut out, "Timeline", KEY_WITH_DROPS, &timeline::timeline(report));
    if report.trace.hands.values().any(|hand| !hand.tip_in_world.is_empty()) {
        let body = format!(
            "<h3>from above</h3>{}<h3>from the front</h3>{}",
            paths::top(report),
            paths::front(report)
        );
        section(&mut out, "Paths of the instruments' tips", KEY_WITH_DROPS, &body);
    }
    if series::any(report, |hand| &hand.applied_force) {
        section(&mut out, "Force at the driver, after its limits", KEY, &series::forces(report));
    }
    if series::any(report, |hand| &hand.energy) {
        let body = series::energy(report)
            + "<p class=\"caption\">Energy observed at the device's port: touch is passive while it is not \
               negative.</p>";
        section(&mut out, "Energy", KEY, &body);
    }
    if series::any(report, |hand| &hand.jaw_angle) {
        section(&mut out, "Opening of the jaws", KEY, &series::jaws(report));
    }
    hands_and_errors(&mut out, report);
    rates(&mut out, report);
    if !report.trace.links.is_empty() {
        section(&mut out, "Network", "", &network::network(report));
    }
    if !report.trace.teleoperations.is_empty() {
        section(&mut out, "Tele-surgery", teleoperation::KEY, &teleoperation::teleoperation(report));
    }
    if !report.summary.tuned.is_empty() {
        section(&mut out, "Tuned: what was not as in the scenario at the end", "", &tables::tuned(report));
    }
    if !report.summary.faults.is_empty() {
        let body = stages::stages(report) + &tables::faults(report);
        section(&mut out, "Faults", stages::KEY, &body);
    }
    if !report.health.is_empty() {
        section(&mut out, "Supervisor", "", &tables::health(report));
    }
    footer(&mut out, report);
    out.push_str("</main></body></html>\n");
    out
}

fn section(out: &mut String, title: &str, key: &str, body: &str) {
    let _ = write!(out, "<section>{key}<h2>{}</h2>{body}</section>", escape(title));
}

fn header(out: &mut String, report: &Report) {
    let summary = report.summary;
    let (class, verdict) = match &summary.task {
        _ if summary.error.is_some() => ("poor", "failed"),
        task if task.completed => ("good", "completed"),
        task if task.cut_off => ("calm", "cut off"),
        _ => ("poor", "not completed"),
    };
    let how = match summary.mode {
        Mode::Live => "live, in real time",
        Mode::Lockstep => "lock-step, virtual time",
        Mode::Replay => "replay of a recording",
    };
    let score = summary.task.score.map_or("–".to_owned(), |score| format!("{score:.1}"));
    let disturbed = if summary.task.disturbed { "<br>disturbed: some actors were too slow" } else { "" };
    let _ = write!(
        out,
        "<header><div><h1>{}</h1><p class=\"sub\"><span class=\"verdict {class}\">{verdict}</span>{} · {how} · \
         seed {}</p></div><div class=\"score\"><b>{score}</b><span> / 100</span>\
         <p>{}{disturbed}</p></div></header>",
        escape(report.title),
        escape(&summary.scenario),
        summary.seed,
        escape(summary.task.score_kind.words()).replace(", ", ",<br>"),
    );
}

fn tiles(out: &mut String, report: &Report) {
    let summary = report.summary;
    let worst = summary
        .controllers
        .iter()
        .filter(|row| row.scheduled > 0)
        .min_by(|a, b| a.on_time.total_cmp(&b.on_time));
    let mut tiles = vec![
        (format!("{:.1} s", summary.task.seconds), "time of the exercise".to_owned()),
        (summary.task.errors.len().to_string(), "errors".to_owned()),
        (format!("{} N", short(summary.force_newtons_max)), "largest force at a driver".to_owned()),
        (format!("{} mm", short(summary.penetration_max * 1e3)), "deepest penetration".to_owned()),
        (format!("{:.1} / {:.1} s", summary.sim_secs, summary.wall_secs), "simulated / wall time".to_owned()),
    ];
    if !summary.faults.is_empty() {
        let held = format!("{} ms", short(summary.force_age_max_us * 1e-3));
        tiles.push((held, "longest force without a fresh command".to_owned()));
    }
    if let (Some(worst), Mode::Live) = (worst, summary.mode) {
        tiles.push((format!("{:.2} %", 100.0 * worst.on_time), format!("least on time: {}", worst.name)));
    }
    out.push_str("<div class=\"tiles\">");
    for (value, label) in tiles {
        let _ =
            write!(out, "<div class=\"tile\"><b>{}</b><span>{}</span></div>", escape(&value), escape(&label));
    }
    out.push_str("</div>");
}

/// A card with a list, unless it is empty.
fn notice(out: &mut String, title: &str, lines: impl Iterator<Item = String>) {
    let items: String = lines.map(|line| format!("<li>{}</li>", escape(&line))).collect();
    if !items.is_empty() {
        let _ = write!(out, "<section class=\"notice\"><h2>{title}</h2><ul>{items}</ul></section>");
    }
}

fn failures(out: &mut String, report: &Report) {
    let summary = report.summary;
    notice(out, "What went wrong", report.failures.iter().chain(&summary.error).cloned());
    if let Some(slow) = summary.too_slow() {
        let _ = write!(
            out,
            "<section class=\"notice\"><h2>Disturbed</h2><p>{}. What the trainee did was disturbed by it: the score and \
             the errors are not the trainee's alone.</p></section>",
            escape(&slow)
        );
    }
    let title = format!("Contacts that were not kept: {}", summary.contacts_not_kept);
    notice(out, &title, summary.unkept_contacts.iter().map(ToString::to_string));
    let title = format!("Frozen bodies: {}", summary.bodies_frozen);
    notice(out, &title, summary.frozen_bodies.iter().map(ToString::to_string));
    let cut_off = summary.cut_off_by.iter().map(|by| format!("{by} ended the run"));
    notice(out, "Ended before its time", cut_off);
    notice(out, "What was doubtful before the start", summary.warnings.iter().cloned());
    notice(out, "What it had to do without", summary.losses.iter().cloned());
}

fn hands_and_errors(out: &mut String, report: &Report) {
    let task = &report.summary.task;
    if task.metrics.is_empty() && task.errors.is_empty() {
        return;
    }
    out.push_str("<div class=\"two\">");
    if !task.metrics.is_empty() {
        section(out, "Motion of each hand", "", &tables::metrics(report));
    }
    let errors = if task.errors.is_empty() {
        "<p class=\"sub\">No errors.</p>".to_owned()
    } else {
        tables::errors(report)
    };
    section(out, "Errors", "", &errors);
    out.push_str("</div>");
}

fn rates(out: &mut String, report: &Report) {
    if report.summary.controllers.is_empty() {
        return;
    }
    section(out, "Controllers", "", &tables::controllers(report));
    // Lateness is zero by construction in lock-step, so it is not drawn.
    if report.summary.mode != Mode::Live {
        return;
    }
    let mut cells = String::new();
    for lateness in report.lateness {
        if let Some(svg) = histogram::histogram(lateness) {
            let _ = write!(cells, "<div><h3>{}</h3>{svg}</div>", escape(&lateness.name));
        }
    }
    if !cells.is_empty() {
        let body = format!(
            "<div class=\"grid3\">{cells}</div><p class=\"caption\">Both axes logarithmic; right of the \
             dashed line a tick counts as late (1 ms).</p>"
        );
        section(out, "How late ticks started", "", &body);
    }
}

fn footer(out: &mut String, report: &Report) {
    let summary = report.summary;
    let hash = summary.state_hash.as_deref().unwrap_or("–");
    let recording = match &summary.recording {
        Some(file) if summary.recording_complete => format!("recording {file}, complete"),
        Some(file) => format!("recording {file}, with gaps"),
        None => "not recorded".to_owned(),
    };
    let json = serde_json::to_string(summary).unwrap_or_default();
    let _ = write!(
        out,
        "<footer><p>Scores and metrics describe this run in simulation. They are not clinically \
         validated.</p><p>Trocar {} · {} · state hash <code>{}</code></p></footer>\
         <script type=\"application/json\" id=\"summary\">{}</script>",
        escape(&summary.version),
        escape(&recording),
        escape(hash),
        escape_json(&json),
    );
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use trocar::summary::{ControllerSummary, FrozenBody, FrozenPart, RunSummary, TaskErrorSummary};
    use trocar::trace::{Mark, RunTrace};

    #[test]
    fn a_report_is_self_contained_and_hostile_names_stay_names() {
        let hostile = "</script><img src=x onerror=alert(1)>";
        let mut summary = RunSummary::new(hostile, Mode::Live, 7);
        summary.controllers = vec![ControllerSummary { name: hostile.into(), ..Default::default() }];
        summary.task.errors = vec![TaskErrorSummary { kind: hostile.into(), at_secs: 1.0 }];
        summary.warnings = vec!["pad: it would sink in by about 9 mm".into()];
        summary.bodies_frozen = 1;
        summary.frozen_bodies = vec![FrozenBody {
            name: hostile.into(),
            part: FrozenPart::Body,
            at_secs: 0.5,
            at_in_world: [0.0; 3],
            reason: hostile.into(),
        }];
        let mut trace = RunTrace::new();
        trace.secs = 10.0;
        trace.phases.push(Mark { secs: 0.0, what: hostile.into(), subject: None, position_in_world: None });
        let html = html(&Report {
            title: hostile,
            summary: &summary,
            trace: &trace,
            lateness: &[],
            health: &[],
            incidents: &[],
            failures: &[hostile.to_owned()],
            force_limits: &BTreeMap::new(),
        });
        assert!(!html.contains("<img"), "a name became an element");
        assert_eq!(html.matches("<script").count(), 1);
        assert_eq!(html.matches("</script>").count(), 1);
        for outside in ["http://", "https://", "@import", "url("] {
            let found = html.replace("http://www.w3.org/2000/svg", "");
            assert!(!found.contains(outside), "{outside}");
        }
        assert!(html.contains("not clinically validated"));
        assert!(html.contains("<h2>What was doubtful before the start</h2><ul><li>pad: it would sink in"));
        assert!(html.contains("Frozen bodies: 1") && html.contains("stands still since 0.50 s"));
        assert!(!html.contains("not kept"));
    }

    #[test]
    fn an_empty_run_has_a_report() {
        let summary = RunSummary::new("wall", Mode::Lockstep, 0);
        let trace = RunTrace::new();
        let html = html(&Report {
            title: "Wall",
            summary: &summary,
            trace: &trace,
            lateness: &[],
            health: &[],
            incidents: &[],
            failures: &[],
            force_limits: &BTreeMap::new(),
        });
        assert!(html.contains("not completed") && !html.contains("NaN"), "{html}");
    }
}
