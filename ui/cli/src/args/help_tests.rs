//! Tests of the help texts of every command: plain words, and each option under its heading.

use clap::builder::Styles;
use clap::{Arg, Command};

/// Names with a capital inside that are not types.
const NAMES: [&str; 3] = ["MuJoCo", "PyElastica", "GitHub"];

/// Headings of the options of `run` and `replay`; all others are under `Options`.
const HEADINGS: [(&str, &[&str]); 5] = [
    (
        "Session",
        &[
            "seed",
            "hand",
            "skill",
            "left-handed",
            "set",
            "assets",
            "tuning",
            "use",
            "seconds",
            "lockstep",
            "play",
            "bindings",
            "faults",
            "resume",
            "reflector",
            "console",
        ],
    ),
    ("Window", &["window", "headless"]),
    (
        "Pictures",
        &[
            "picture",
            "film",
            "fps",
            "camera",
            "size",
            "eyes",
            "show",
            "interocular",
            "convergence",
            "quality",
        ],
    ),
    ("Output", &["record", "record-exact", "no-record", "report", "no-report", "force", "json"]),
    (
        "Network",
        &[
            "port",
            "bind",
            "address",
            "tickets",
            "ticket",
            "ticket-file",
            "name",
            "architecture",
            "insecure",
            "relay",
            "relay-key",
            "zenoh",
        ],
    ),
];
/// Commands whose options stand under headings.
const WITH_HEADINGS: [&str; 5] =
    ["trocar run", "trocar replay", "trocar host", "trocar join", "trocar watch"];

/// Every command with its full name, from the program down.
fn commands() -> Vec<(String, Command)> {
    fn walk(command: &Command, above: &str, found: &mut Vec<(String, Command)>) {
        let name = format!("{above} {}", command.get_name()).trim().to_owned();
        found.push((name.clone(), command.clone()));
        command.get_subcommands().for_each(|below| walk(below, &name, found));
    }
    let mut command = super::command().styles(Styles::plain());
    command.build();
    let mut found = Vec::new();
    walk(&command, "", &mut found);
    found.retain(|(name, _)| !name.contains(" help"));
    found
}

fn options(command: &Command) -> impl Iterator<Item = (&str, &Arg)> {
    command.get_arguments().filter_map(|arg| Some((arg.get_long()?, arg)))
}

/// Faults of a help text.
fn faults(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for wrong in ["::", "\\", "``", "[`"] {
        if text.contains(wrong) {
            found.push(format!("has {wrong}"));
        }
    }
    for word in text.split(|c: char| !c.is_alphanumeric()) {
        let letters: Vec<char> = word.chars().collect();
        let inner = letters
            .windows(3)
            .any(|three| three[0].is_lowercase() && three[1].is_uppercase() && three[2].is_lowercase());
        let is_name = NAMES.contains(&word);
        if inner && word.starts_with(char::is_uppercase) && !is_name {
            found.push(format!("names the type {word}"));
        }
    }
    found
}

#[test]
fn help_texts_have_no_types_and_no_marks_of_rustdoc() {
    let commands = commands();
    assert!(commands.len() > 15, "{} commands", commands.len());
    for (name, mut command) in commands {
        for text in [command.render_help().to_string(), command.render_long_help().to_string()] {
            let found = faults(&text);
            assert!(found.is_empty(), "{name} --help {found:?}:\n{text}");
        }
        assert!(command.get_about().is_some(), "{name} does not say what it does");
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        assert!(!about.starts_with('`') && !about.ends_with('.'), "{name}: {about}");
        for arg in command.get_arguments() {
            assert!(arg.get_help().is_some(), "{name}: {} has no help", arg.get_id());
        }
    }
}

#[test]
fn every_option_stands_under_the_heading_where_it_is_looked_for() {
    for (name, command) in commands() {
        let has_headings = WITH_HEADINGS.contains(&name.as_str());
        for (option, arg) in options(&command) {
            let heading = arg.get_help_heading().unwrap_or("Options");
            let listed = HEADINGS.iter().find(|(_, options)| options.contains(&option));
            let expected = match listed {
                Some((heading, _)) if has_headings => heading,
                // `trocar graph` takes the same session options as `run`.
                Some(("Session", _)) if name == "trocar graph" => "Session",
                // A ticket says where its host listens.
                Some(("Network", _)) if name == "trocar host ticket" => "Network",
                _ => "Options",
            };
            assert_eq!(heading, expected, "{name} --{option}");
        }
    }
    let commands: Vec<Command> = commands()
        .into_iter()
        .filter(|(name, _)| WITH_HEADINGS.contains(&name.as_str()))
        .map(|(_, it)| it)
        .collect();
    let known: Vec<&str> = commands.iter().flat_map(options).map(|(option, _)| option).collect();
    for (heading, listed) in HEADINGS {
        for option in listed {
            assert!(known.contains(option), "{heading}: --{option} is no option of {WITH_HEADINGS:?}");
        }
    }
}

/// Headings stand in the order in which a run is thought of, and an option that takes a length says its unit.
#[test]
fn headings_have_an_order_and_lengths_their_unit() {
    for (name, mut command) in commands() {
        let text = command.render_long_help().to_string();
        let places: Vec<usize> =
            HEADINGS.iter().filter_map(|(heading, _)| text.find(&format!("\n{heading}:\n"))).collect();
        assert!(places.is_sorted(), "{name}:\n{text}");
        for (option, arg) in options(&command) {
            let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
            let value = arg.get_value_names().and_then(|names| names.first()).map(ToString::to_string);
            if help.ends_with("in metres") {
                assert_eq!(value.as_deref(), Some("METRES"), "{name} --{option}");
            }
        }
    }
}

/// Every option and every place of every command, with a number below zero: nobody means another option by it.
#[test]
fn no_number_below_zero_is_taken_for_an_option() {
    let mut tried = 0;
    for (name, command) in commands() {
        let words: Vec<&str> = name.split(' ').collect();
        let with_value = options(&command).filter(|(_, arg)| arg.get_action().takes_values());
        let mut lines: Vec<Vec<String>> =
            with_value.map(|(option, _)| vec![format!("--{option}"), "-1".to_owned()]).collect();
        if command.get_positionals().next().is_some() {
            lines.push(vec!["-1".to_owned()]);
        }
        for line in lines {
            tried += 1;
            let all = words.iter().map(|word| (*word).to_owned()).chain(line.iter().cloned());
            let Err(error) = super::command().try_get_matches_from(all) else { continue };
            let text = error.to_string();
            assert!(
                !text.contains("-- -1") && !text.contains("unexpected argument"),
                "{name} {line:?}: {text}"
            );
        }
    }
    assert!(tried > 40, "{tried} lines");
}

#[test]
fn a_number_below_zero_is_refused_as_a_number() {
    let lines = [
        ("run wall --seconds", "number of seconds above 0"),
        ("run wall --fps", "frames per second"),
        ("run wall --interocular", "a length above 0"),
        ("run wall --convergence", "a length above 0"),
        ("run wall --seed", "invalid digit"),
        ("graph wall --after", "number of seconds above 0"),
        ("soak --plans", "invalid digit"),
        ("soak --seconds", "number of seconds above 0"),
        ("soak --from", "invalid digit"),
        ("gallery --at", "number of seconds above 0"),
        ("gallery --seed", "invalid digit"),
        ("tune status --session", "-1 is not in"),
    ];
    for (line, expected) in lines {
        let words = format!("trocar {line} -1");
        let error = super::command().try_get_matches_from(words.split(' ')).expect_err("it is refused");
        let text = error.to_string();
        assert!(text.contains(expected) && !text.contains("unexpected argument"), "{words}: {text}");
    }
}

#[test]
fn faults_of_help_texts_are_found() {
    assert_eq!(faults("Length in metres; `left=virtual`, MuJoCo, WIDTHxHEIGHT"), Vec::<String>::new());
    assert_eq!(faults("See RunOptions").len(), 1);
    assert_eq!(faults(r"After \[s\], see a::b").len(), 2);
}
