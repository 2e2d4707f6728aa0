//! `trocar recording stats`: what the bytes of a recording are spent on.

use serde_json::{Value, json};
use trocar::summary::{Exit, SCHEMA};
use trocar_kernel::recorder::{Bytes, ComponentBytes, Recording, RecordingStatistics};

use super::StatsArgs;
use crate::escape::printable;
use crate::failure::Failure;
use crate::output;

/// Rows that are shown of each table.
const ROWS_MAX: usize = 40;

/// Prints the statistics of a recording.
pub fn stats(args: &StatsArgs) -> Result<Exit, Failure> {
    let recording = Recording::open(&args.file).map_err(Failure::invalid)?;
    let found = recording.statistics().map_err(Failure::invalid)?;
    if args.json {
        output::print_json(&object(args, &found))?;
    } else {
        output::print_text(&text(args, &found).join("\n"))?;
    }
    Ok(Exit::Ok)
}

/// Seconds of the recording, at least a little.
fn secs(found: &RecordingStatistics) -> f64 {
    found.span.as_secs_f64().max(1e-3)
}

fn object(args: &StatsArgs, found: &RecordingStatistics) -> Value {
    let bytes = |bytes: &Bytes| json!({ "count": bytes.count, "bytes": bytes.bytes });
    let component = |component: &ComponentBytes| {
        json!({
            "name": component.name,
            "policy": component.policy,
            "committed": component.committed.as_ref().map(bytes),
            "blocks": bytes(&component.blocks),
            "keyframes": bytes(&component.keyframes),
        })
    };
    let by_name = |map: &std::collections::BTreeMap<String, Bytes>| {
        let pairs = map.iter().map(|(name, count)| (name.clone(), bytes(count)));
        Value::Object(pairs.collect())
    };
    json!({
        "schema": SCHEMA,
        "file": args.file.display().to_string(),
        "bytes": found.file,
        "seconds": found.span.as_secs_f64(),
        "bytes_per_minute": found.file as f64 / secs(found) * 60.0,
        "committed_bytes": found.committed,
        "topics": by_name(&found.topics),
        "framing_bytes": found.framing,
        "commit_heads": bytes(&found.heads),
        "components": found.components.iter().map(component).collect::<Vec<_>>(),
        "writers": by_name(&found.writers),
    })
}

fn text(args: &StatsArgs, found: &RecordingStatistics) -> Vec<String> {
    let per_minute = |bytes: u64| format!("{:.3}", bytes as f64 / secs(found) * 60.0 / 1e6);
    let per_second = |count: u64| format!("{:.1}", count as f64 / secs(found));
    let share = |bytes: u64| format!("{:.1} %", 100.0 * bytes as f64 / found.file.max(1) as f64);
    let name = printable(&args.file.display().to_string());
    let mut lines = vec![format!(
        "{name}: {:.2} MB, {:.1} s, {} MB a minute",
        found.file as f64 / 1e6,
        found.span.as_secs_f64(),
        per_minute(found.file)
    )];
    if let Some(committed) = found.committed {
        let less = committed as f64 / found.file.max(1) as f64;
        let committed = committed as f64 / 1e6;
        lines.push(format!("the session committed {committed:.2} MB: {less:.1} times as much"));
    }
    lines.push(String::new());
    let topics = found.topics.iter().map(|(topic, bytes)| {
        let (count, bytes) = (bytes.count, bytes.bytes);
        vec![printable(topic), per_second(count), per_minute(bytes), share(bytes)]
    });
    let framing = vec!["framing".to_owned(), String::new(), per_minute(found.framing), share(found.framing)];
    let rows: Vec<_> = topics.chain([framing]).collect();
    lines.extend(output::columns(&["topic", "messages/s", "MB/min", "share"], &rows));
    lines.push(String::new());
    let heads = vec![
        "(heads of commits)".to_owned(),
        "exact".to_owned(),
        String::new(),
        String::new(),
        per_second(found.heads.count),
        per_minute(found.heads.bytes),
        String::new(),
    ];
    let components = found.components.iter().take(ROWS_MAX).map(|component| {
        let before = component.committed.unwrap_or_default();
        vec![
            printable(&component.name),
            component.policy.clone(),
            per_second(before.count),
            per_minute(before.bytes),
            per_second(component.blocks.count),
            per_minute(component.blocks.bytes),
            per_minute(component.keyframes.bytes),
        ]
    });
    let rows: Vec<_> = std::iter::once(heads).chain(components).collect();
    let head =
        ["component", "kept", "puts/s before", "MB/min before", "rows/s", "MB/min", "keyframes MB/min"];
    lines.extend(output::columns(&head, &rows));
    if !found.writers.is_empty() {
        lines.push(String::new());
        let writers = found.writers.iter();
        let rows: Vec<_> = writers
            .map(|(name, bytes)| vec![printable(name), per_second(bytes.count), per_minute(bytes.bytes)])
            .collect();
        lines.extend(output::columns(&["writer", "commits/s", "MB/min before"], &rows));
    }
    lines
}
