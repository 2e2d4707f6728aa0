//! The result of a run for people: as text on the terminal, and as a card in the window.

use trocar::summary::{BY_THE_HOST, Mode, RunSummary, TaskSummary, TeleoperationFigures};
use trocar_viewer::window::subject::Verdict;

use crate::escape::printable;
use crate::output::{self, in_words};
use crate::report::short;

/// Errors in the summary at most.
const ERRORS_MAX: usize = 16;
/// Times in the line of one kind of error at most.
const TIMES_MAX: usize = 6;

/// Contacts that were not kept that the text names one by one; the others are in report and JSON.
const UNKEPT_SHOWN: usize = 4;
/// Frozen bodies that the text and the window name; the others are in report and JSON.
const FROZEN_SHOWN: usize = 4;

/// The result as the window shows it.
pub fn verdict(summary: &RunSummary, bad: bool) -> Verdict {
    let task = &summary.task;
    if !task.is_exercise() {
        let title = if summary.error.is_some() { "failed" } else { "the session has ended" };
        let frozen = frozen_bodies(summary).into_iter().chain(ended_by_host(summary));
        let lines = frozen.chain(summary.error.iter().map(|error| printable(error))).collect();
        return Verdict { title: title.to_owned(), lines, bad };
    }
    let how = match () {
        () if task.completed => "completed",
        () if task.cut_off => "cut off",
        () => "not completed",
    };
    let mut lines = vec![format!("{:.1} s", task.seconds)];
    if let Some(score) = task.score {
        lines.push(format!("score {score:.1} / 100"));
        lines.push(task.score_kind.words().to_owned());
    }
    lines.extend(summary.too_slow().map(|slow| format!("disturbed: {slow}")));
    lines.extend(errors_of(task).iter().map(|error| printable(error)));
    lines.extend(frozen_bodies(summary));
    lines.extend(ended_by_host(summary));
    lines.extend(summary.error.iter().map(|error| printable(error)));
    Verdict { title: how.to_owned(), lines, bad }
}

/// At a station, that its host has ended the session.
fn ended_by_host(summary: &RunSummary) -> Option<String> {
    let is_by_host = summary.cut_off_by.as_deref() == Some(BY_THE_HOST);
    is_by_host.then(|| "the host ended the session".to_owned())
}

/// The bodies that stand still: their names in one line, and each with its reason.
fn frozen_bodies(summary: &RunSummary) -> Vec<String> {
    let Some(names) = summary.frozen_names(FROZEN_SHOWN) else { return Vec::new() };
    let mut lines = vec![format!("frozen: {}", printable(&names))];
    let each = summary.frozen_bodies.iter().take(FROZEN_SHOWN);
    lines.extend(each.map(|body| format!("  {}", printable(&body.to_string()))));
    lines
}

/// Errors in words, one line each: every expectation that was not met, with its value and its bound; of other errors
/// how often and when.
fn errors_of(task: &TaskSummary) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    let mut often: Vec<(&str, Vec<f64>)> = Vec::new();
    for error in &task.errors {
        match often.iter_mut().find(|(kind, _)| *kind == error.kind) {
            Some((_, times)) => times.push(error.at_secs),
            None => often.push((&error.kind, vec![error.at_secs])),
        }
    }
    for (kind, times) in &often {
        if kind.contains(' ') {
            // A sentence, which an exercise of expectations makes at its end.
            lines.push((*kind).to_owned());
            continue;
        }
        let shown: Vec<String> = times.iter().take(TIMES_MAX).map(|at| format!("{at:.1} s")).collect();
        let more = if times.len() > TIMES_MAX { ", …" } else { "" };
        lines.push(format!("{} × {} at {}{more}", times.len(), in_words(kind), shown.join(", ")));
    }
    if lines.len() > ERRORS_MAX {
        let more = lines.len() - ERRORS_MAX;
        lines.truncate(ERRORS_MAX);
        lines.push(format!("… and {more} more, in the report and with --json"));
    }
    lines
}

/// The summary as text for people.
pub fn text(summary: &RunSummary) -> String {
    let bold = |text: String| console::style(text).bold().to_string();
    let task = &summary.task;
    let verdict = match () {
        () if task.completed => console::style("completed").green().to_string(),
        () if task.cut_off => console::style("cut off").yellow().to_string(),
        () => console::style("not completed").red().to_string(),
    };
    let scenario = bold(summary.scenario.clone());
    let mut lines = if task.is_exercise() {
        let score = task.score.map_or("–".to_owned(), |score| format!("{score:.1}"));
        let errors = match task.errors.len() {
            1 => "1 error".to_owned(),
            count => format!("{count} errors"),
        };
        let mut lines = vec![format!("{scenario} {verdict} in {:.1} s, {errors}", task.seconds)];
        lines.extend(errors_of(task).iter().map(|error| format!("  {}", printable(error))));
        lines.push(format!("{} / 100  {}", bold(format!("score {score}")), task.score_kind.words()));
        lines.extend(
            task.disturbed.then(|| "the score is disturbed: it says little about the trainee".to_owned()),
        );
        lines
    } else {
        vec![format!("{scenario}: {:.1} s; there is no exercise in it", summary.sim_secs)]
    };
    let cut_off_by = summary.cut_off_by.as_ref().filter(|by| by.as_str() != BY_THE_HOST);
    lines.extend(cut_off_by.map(|by| format!("{by} ended the run before its time")));
    lines.extend(ended_by_host(summary));
    lines.extend(summary.too_slow().map(|slow| console::style(slow).yellow().to_string()));
    lines.push(String::new());
    lines.extend(rates(summary));
    lines.push(String::new());
    lines.push(format!(
        "largest force at a driver {} N, deepest penetration {} mm",
        short(summary.force_newtons_max),
        short(summary.penetration_max * 1e3)
    ));
    if summary.contacts_not_kept > 0 {
        lines.push(format!("contacts that were not kept: {}", summary.contacts_not_kept));
        lines.extend(summary.unkept_contacts.iter().take(UNKEPT_SHOWN).map(|contact| format!("  {contact}")));
    }
    lines.extend(frozen_bodies(summary));
    lines.extend(summary.teleoperation.iter().map(|(hand, figures)| teleoperation(hand, figures)));
    if !summary.faults.is_empty() {
        lines.push(format!(
            "no force was held for longer than {} ms after its last fresh command; {} commands of zombies were refused",
            short(summary.force_age_max_us * 1e-3),
            summary.commands_refused
        ));
    }
    for row in summary.controllers.iter().filter(|row| row.lost + row.delayed + row.duplicated > 0) {
        lines.push(format!(
            "{}: of {} batches {} were lost, {} came late, {} came twice",
            row.name, row.sent, row.lost, row.delayed, row.duplicated
        ));
    }
    for fault in &summary.faults {
        let state = match (fault.injected_secs, fault.recovery_secs()) {
            (Some(_), Some(took)) => format!("overcome in {:.1} ms", took * 1e3),
            (Some(_), None) if fault.is_under_way() => "lasted to the end".to_owned(),
            (Some(_), None) => "not overcome".to_owned(),
            (None, _) => "did not strike".to_owned(),
        };
        lines.push(format!("fault '{}' ({} {}): {state}", fault.id, fault.kind, fault.target));
    }
    lines.push(format!(
        "{:.1} s simulated in {:.1} s; state hash {}",
        summary.sim_secs,
        summary.wall_secs,
        summary.state_hash.as_deref().unwrap_or("–")
    ));
    if let Some(file) = &summary.recording {
        let gaps = if summary.recording_complete { "" } else { " (with gaps)" };
        let size = summary.recording_bytes.map(|bytes| format!(", {:.2} MB", bytes as f64 * 1e-6));
        lines.push(format!("recording {file}{}{gaps}", size.unwrap_or_default()));
    }
    if let Some(file) = &summary.report {
        lines.push(format!("report {file}"));
    }
    if let Some(error) = &summary.error {
        lines.push(console::style(crate::escape::printable(error)).red().to_string());
    }
    lines.join("\n")
}

/// How well a slave followed its master, in a line. Of an end whose other one is elsewhere less is known.
fn teleoperation(hand: &str, figures: &TeleoperationFigures) -> String {
    let told =
        |value: Option<f64>, unit: &str| value.map_or("–".to_owned(), |value| short(value * 1e3) + unit);
    let mut parts = Vec::new();
    if figures.round_trip_mean.is_some() {
        let (mean, p99) = (told(figures.round_trip_mean, " ms"), told(figures.round_trip_p99, " ms"));
        parts.push(format!("{mean} behind its master in the mean ({p99} of 99 %)"));
    }
    parts.push(format!("{} packets of {}", figures.received, figures.sent));
    if figures.applied_error_max.is_some() {
        parts.push(format!(
            "{} at most from the pose whose time stamp it applies",
            told(figures.applied_error_max, " mm")
        ));
    }
    if figures.rms.is_some() {
        let (lag, left) = (told(figures.constant_lag, " ms"), told(figures.constant_lag_rms, " mm"));
        parts.push(format!("RMS {}, with a constant lag of {lag} {left}", told(figures.rms, " mm")));
    }
    if figures.energised > 0.0 {
        parts.push(format!("current on for {} s", short(figures.energised)));
    }
    if figures.stops + figures.silences > 0 {
        parts.push(format!("{} emergency stops, {} silences", figures.stops, figures.silences));
    }
    format!("slave of {}: {}", printable(hand), parts.join("; "))
}

/// The table of rates.
fn rates(summary: &RunSummary) -> Vec<String> {
    let live = summary.mode == Mode::Live;
    let head: &[&str] = if live {
        &[
            "controller",
            "target Hz",
            "achieved Hz",
            "on time",
            "late p50 µs",
            "p99",
            "step p50 µs",
            "p99",
            "missed",
            "restarts",
            "hits mean",
            "max",
            "in ticks",
        ]
    } else {
        &[
            "controller",
            "target Hz",
            "ticks",
            "step p50 µs",
            "p99",
            "rejected",
            "restarts",
            "hits mean",
            "max",
            "in ticks",
        ]
    };
    let rows: Vec<Vec<String>> = summary
        .controllers
        .iter()
        .map(|row| {
            let steps = [short(row.step_us.p50), short(row.step_us.p99)];
            let mut cells = vec![row.name.clone(), short(row.target_hz)];
            if live {
                cells.push(format!("{:.1}", row.achieved_hz));
                cells.push(format!("{:.2} %", row.on_time * 100.0));
                cells.extend([short(row.lateness_us.p50), short(row.lateness_us.p99)]);
                cells.extend(steps);
                cells.push(row.missed.to_string());
            } else {
                cells.push(row.scheduled.to_string());
                cells.extend(steps);
                cells.push(row.rejected.to_string());
            }
            cells.push(row.restarts.to_string());
            cells.extend(match &row.hits {
                Some(hits) => [format!("{:.1}", hits.mean), hits.max.to_string(), hits.ticks.to_string()],
                None => ["–", "–", "–"].map(str::to_owned),
            });
            cells
        })
        .collect();
    output::columns(head, &rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar::summary::{FrozenBody, FrozenPart, TaskErrorSummary};

    fn task(errors: &[(&str, f64)]) -> TaskSummary {
        let error =
            |(kind, at_secs): &(&str, f64)| TaskErrorSummary { kind: (*kind).into(), at_secs: *at_secs };
        TaskSummary {
            errors: errors.iter().map(error).collect(),
            score: Some(40.0),
            ..TaskSummary::default()
        }
    }

    #[test]
    fn errors_of_one_kind_share_a_line_and_expectations_have_one_each() {
        let drops: Vec<(&str, f64)> = (1..=8).map(|at| ("drop_in_view", f64::from(at))).collect();
        let lines = errors_of(&task(&[&drops[..], &[("wrong_order", 2.26)]].concat()));
        assert_eq!(lines[0], "8 × drop in view at 1.0 s, 2.0 s, 3.0 s, 4.0 s, 5.0 s, 6.0 s, …");
        assert_eq!(lines[1], "1 × wrong order at 2.3 s");
        let failed = ["a.b_m is 1, at most 0 is expected", "c.d_n is 2, at least 3 is expected"];
        assert_eq!(errors_of(&task(&failed.map(|line| (line, 9.0)))), failed);
        assert_eq!(errors_of(&task(&[])), [] as [String; 0]);
    }

    #[test]
    fn of_very_many_errors_the_first_are_named_and_the_rest_counted() {
        let many: Vec<String> =
            (0..ERRORS_MAX + 9).map(|n| format!("x.{n} is 1, at most 0 is expected")).collect();
        let many: Vec<(&str, f64)> = many.iter().map(|line| (line.as_str(), 1.0)).collect();
        let lines = errors_of(&task(&many));
        assert_eq!(lines.len(), ERRORS_MAX + 1);
        assert_eq!(lines[ERRORS_MAX], "… and 9 more, in the report and with --json");
    }

    #[test]
    fn frozen_bodies_have_lines_of_their_own_on_the_terminal_and_in_the_window() {
        let mut summary = RunSummary::new("x", Mode::Live, 1);
        let body = |n: usize| FrozenBody {
            name: format!("pad-{n}"),
            part: if n == 1 { FrozenPart::Heat } else { FrozenPart::Body },
            at_secs: 0.5,
            at_in_world: [0.0; 3],
            reason: format!("reason {n}\u{1b}[2J"),
        };
        assert!(!text(&summary).contains("frozen"));
        (summary.frozen_bodies, summary.bodies_frozen) = ((0..6).map(body).collect(), 6);
        let shown = text(&summary);
        for line in [
            "frozen: pad-0, the heat of pad-1, pad-2, pad-3, …\n",
            "\n  pad-0 stands still since 0.50 s: reason 0",
            "\n  the heat of pad-1 stands still since 0.50 s: reason 1",
        ] {
            assert!(shown.contains(line), "'{line}' is not in: {shown}");
        }
        assert!(!shown.contains("not kept") && !shown.contains("reason 4"), "{shown}");
        assert!(!shown.contains("\u{1b}[2J"), "{shown}");
        for task in [TaskSummary::default(), TaskSummary { completed: true, ..TaskSummary::default() }] {
            summary.task = task;
            let lines = verdict(&summary, true).lines;
            assert!(lines.iter().any(|line| line.starts_with("frozen: pad-0,")), "{lines:?}");
        }
    }

    #[test]
    fn the_window_shows_score_and_errors_without_control_characters() {
        let mut summary = RunSummary::new("x", Mode::Live, 1);
        summary.task = task(&[("a is 1, at most 0 is expected\u{1b}[2J", 1.0)]);
        let shown = verdict(&summary, true);
        assert_eq!((shown.title.as_str(), shown.bad), ("not completed", true));
        assert!(shown.lines.contains(&"score 40.0 / 100".to_owned()), "{:?}", shown.lines);
        assert!(shown.lines.iter().all(|line| !line.contains('\u{1b}')), "{:?}", shown.lines);
        summary.task = TaskSummary { completed: true, ..TaskSummary::default() };
        assert_eq!(verdict(&summary, false).title, "the session has ended");
    }
}
