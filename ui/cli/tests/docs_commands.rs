//! Every command line of README and docs names commands and options that there are.

use std::path::{Path, PathBuf};

use trocar_cli::command_line;

fn pages() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let docs = std::fs::read_dir(root.join("docs")).expect("a readable folder");
    let mut pages: Vec<PathBuf> = docs.map(|entry| entry.expect("an entry").path()).collect();
    pages.retain(|page| page.extension().is_some_and(|ending| ending == "md"));
    pages.push(root.join("README.md"));
    pages
}

/// The words of a line of a shell, without quotes and without a comment at its end.
fn words(line: &str) -> Vec<String> {
    let (mut words, mut word, mut quoted) = (Vec::new(), String::new(), false);
    for letter in line.chars() {
        match letter {
            '\'' => quoted = !quoted,
            '#' if !quoted && word.is_empty() => break,
            ' ' if !quoted => words.extend((!word.is_empty()).then(|| std::mem::take(&mut word))),
            letter => word.push(letter),
        }
    }
    words.extend((!word.is_empty()).then_some(word));
    words
}

/// Arguments of every call of the program in a line: `trocar …`, or the same through cargo.
fn calls(line: &str) -> Vec<Vec<String>> {
    let calls = line.split(" && ").flat_map(|part| part.split("; ")).map(|call| words(call.trim()));
    let arguments = calls.filter_map(|words| match words.first().map(String::as_str) {
        Some("trocar") => Some(words[1..].to_vec()),
        // Another program's options stand before `--`.
        Some("cargo") if !words.iter().any(|word| word == "--example") => {
            let at = words.iter().position(|word| word == "--")?;
            Some(words[at + 1..].to_vec())
        }
        _ => None,
    });
    arguments.collect()
}

/// Whether the program takes these arguments. `…` stands for more of them, and capitals for one of several words.
fn check(arguments: &[String]) -> Result<(), String> {
    use clap::error::ErrorKind;
    let known = || arguments.iter().filter(|word| *word != "…").map(String::as_str);
    let whole: Vec<&str> = ["trocar"].into_iter().chain(known()).collect();
    let Err(error) = command_line().try_get_matches_from(whole.iter().copied()) else { return Ok(()) };
    let text = error.to_string();
    let mut places = known().filter(|word| word.chars().all(|c| c.is_ascii_uppercase()));
    let is_fine = match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => true,
        // Prose may name a command without what it has to be told.
        ErrorKind::MissingRequiredArgument | ErrorKind::MissingSubcommand => {
            whole.len() <= 3 || whole.len() <= arguments.len()
        }
        ErrorKind::InvalidValue | ErrorKind::InvalidSubcommand => {
            places.any(|place| text.contains(&format!("'{place}'")))
        }
        _ => false,
    };
    if is_fine { Ok(()) } else { Err(text) }
}

/// Lines of shell blocks, and what stands between backticks elsewhere, which may go over the end of a line.
fn lines(page: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (index, part) in page.split("```").enumerate() {
        if index % 2 == 1 {
            found.extend(part.strip_prefix("sh\n").into_iter().flat_map(str::lines).map(str::to_owned));
        } else {
            found.extend(part.split('`').skip(1).step_by(2).map(|code| code.replace('\n', " ")));
        }
    }
    found
}

#[test]
fn every_command_line_of_the_docs_is_understood() {
    let (mut wrong, mut count) = (Vec::new(), 0);
    for page in pages() {
        let text = std::fs::read_to_string(&page).expect("a readable page");
        for line in lines(&text) {
            for arguments in calls(&line) {
                count += 1;
                if let Err(error) = check(&arguments) {
                    wrong.push(format!("{}: {line}\n{error}", page.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 60, "{count} command lines were found");
}

#[test]
fn every_option_of_the_docs_exists() {
    fn options(command: &clap::Command, known: &mut Vec<String>) {
        known.extend(command.get_arguments().filter_map(|option| option.get_long().map(str::to_owned)));
        command.get_subcommands().for_each(|command| options(command, known));
    }
    // Options of cargo, and of the figures that are written into the docs.
    let mut known = ["release", "example", "path", "open", "markdown"].map(str::to_owned).to_vec();
    options(&command_line(), &mut known);
    let mut wrong = Vec::new();
    for page in pages() {
        let text = std::fs::read_to_string(&page).expect("a readable page");
        for line in lines(&text) {
            let first = line.split_whitespace().next().unwrap_or_default();
            let option = first.strip_prefix("--").map(|option| option.split('=').next().unwrap_or_default());
            if let Some(option) = option.filter(|option| !option.is_empty())
                && !known.iter().any(|known| known == option)
            {
                wrong.push(format!("{}: --{option}", page.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "options that there are not:\n{}", wrong.join("\n"));
}

#[test]
fn a_wrong_command_line_is_seen() {
    let refused = |line: &str| calls(line).iter().all(|arguments| check(arguments).is_err());
    assert!(refused("trocar rnu peg-transfer") && refused("trocar run peg-transfer --lockstpe"));
    assert!(refused("cargo run --release -- run peg-transfer --show temprature"));
    assert!(refused("trocar completions bsah") && !refused("trocar completions SHELL"));
    assert_eq!(calls("cd x && trocar list plans; trocar tune use b # not this").len(), 2);
    assert_eq!(words("trocar tune set 'a.*.b c=1'")[3], "a.*.b c=1");
}
