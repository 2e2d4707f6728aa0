//! Checks of README and docs: the index, the snippets, the tables of figures, the map of the code. Links, names of
//! tests, and that the programs shown are the examples, are checked in `tidy/`; command lines are parsed in
//! `ui/cli/tests/docs_commands.rs`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use trocar::play::Bindings;
use trocar_kernel::faults::FaultPlan;
use trocar_scene::scenario::Scenario;
use trocar_tests::app;

/// Programs that tests build, and that pages may show.
const EXAMPLES: [&str; 4] = [
    "ui/cli/examples/haste.rs",
    "ui/sdk/examples/slippery.rs",
    "ui/sdk/examples/guide.rs",
    "ui/cli/examples/offscreen.rs",
];
/// Suites of `trocar bench` whose tables are in docs/figures.md.
const SUITES: [&str; 8] =
    ["kernel", "session", "viewer", "collision", "simulator", "network", "recording", "build"];
/// Entities that snippets of scenarios refer to.
const NEIGHBOURS: &str = r#"
schema = 1
name = "snippet"
[[entity]]
name = "stomach"
[[entity]]
name = "hook"
[[entity]]
name = "probe.right"
instrument = { kind = "probe", shaft_length = 0.15, shaft_radius = 0.006, jaw_length = 0.010, jaws = 0, mass = 0.03 }
[[entity]]
name = "hand.right"
hand = { side = "right", instrument = "probe.right" }
"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests lie in the workspace").to_owned()
}

fn read(name: &str) -> String {
    std::fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// Pages of README and manual: path from the root and text.
fn pages() -> Vec<(String, String)> {
    let mut names: Vec<String> = files("docs").into_iter().filter(|name| name.ends_with(".md")).collect();
    names.push("README.md".to_owned());
    names.into_iter().map(|name| (name.clone(), read(&name))).collect()
}

/// Files of a folder, with their paths from the root.
fn files(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(root().join(folder)).expect("a readable folder");
    let names = entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.map(|name| format!("{folder}/{name}")).collect();
    names.sort();
    names
}

/// Blocks of code of a page: language, text, and line of the first fence.
fn blocks(page: &str) -> Vec<(&str, String, usize)> {
    let mut found = Vec::new();
    let mut open: Option<(&str, String, usize)> = None;
    for (index, line) in page.lines().enumerate() {
        if let Some(language) = line.strip_prefix("```") {
            match open.take() {
                Some(block) => found.push(block),
                None => open = Some((language, String::new(), index + 1)),
            }
        } else if let Some((_, text, _)) = &mut open {
            text.push_str(line);
            text.push('\n');
        }
    }
    assert!(open.is_none(), "a block of code does not end");
    found
}

fn refuse(what: &str, found: Vec<String>) {
    assert!(found.is_empty(), "{what}:\n  {}", found.join("\n  "));
}

#[test]
fn every_page_is_in_the_index() {
    let index = read("docs/README.md");
    let pages = files("docs").into_iter().filter_map(|file| Some(file.strip_prefix("docs/")?.to_owned()));
    let pages = pages.filter(|name| name.ends_with(".md") && name != "README.md");
    let missing = pages.filter(|name| !index.contains(&format!("]({name})")));
    refuse("pages that docs/README.md does not list", missing.collect());
}

#[test]
fn every_program_of_the_docs_is_compiled() {
    let doctests = read("ui/sdk/src/lib.rs");
    let examples = EXAMPLES.map(|name| (name, read(name)));
    let mut wrong = Vec::new();
    for (name, text) in pages() {
        let is_doctest = doctests.contains(&format!("include_str!(\"../../../{name}\")"));
        for (language, block, line) in blocks(&text) {
            match language {
                "rust" if is_doctest || examples.iter().any(|(_, example)| example.ends_with(&block)) => {}
                // `tests/run` runs it.
                "python" if read("tests/read_recording.py").ends_with(&block) => {}
                "rust" => wrong.push(format!("{name}:{line}: neither an example nor a doctest")),
                "" | "sh" | "toml" | "mermaid" => {}
                other => wrong.push(format!("{name}:{line}: '{other}' is a language that no test checks")),
            }
        }
    }
    refuse("programs that nothing compiles", wrong);
}

/// A manifest of the docs asks for what the template `controller` asks for, by which it is built and tested.
fn read_manifest(snippet: &str) -> Result<(), String> {
    let table = |text: &str| text.parse::<toml::Table>().map_err(|error| error.to_string());
    let (ours, theirs) = (table(&read("ui/sdk/templates/controller/Cargo.toml"))?, table(snippet)?);
    let known = ours["dependencies"].as_table().ok_or("no dependencies")?;
    let asked = theirs["dependencies"].as_table().ok_or("no dependencies")?;
    for (name, wanted) in known {
        let found = asked.get(name).ok_or(format!("'{name}' is missing"))?;
        let path = |value: &toml::Value| value.get("path").and_then(|path| path.as_str().map(str::to_owned));
        match (path(wanted), path(found)) {
            (None, None) if wanted == found => {}
            (Some(_), Some(path))
                if ["trocar/ui/sdk", "trocar/ui/cli"].iter().any(|end| path.ends_with(end)) => {}
            _ => return Err(format!("'{name}' is {found}, and {wanted} in the template")),
        }
    }
    match ours["package"].get("edition") == theirs["package"].get("edition") {
        true => Ok(()),
        false => Err("another edition".to_owned()),
    }
}

/// Parses a snippet by its kind: a fault plan, bindings, a scenario, or a part of one.
fn read_toml(snippet: &str) -> Result<(), String> {
    if snippet.contains("[[fault]]") {
        return FaultPlan::parse(snippet, "snippet").map(drop).map_err(|error| error.to_string());
    }
    if snippet.contains("[controls]") {
        return Bindings::parse(snippet).map(drop).map_err(|error| error.to_string());
    }
    if snippet.contains("[dependencies]") {
        return read_manifest(snippet);
    }
    let app = app();
    let starts = |table: &str| snippet.starts_with(table);
    let text = if starts("schema =") {
        snippet.to_owned()
    } else if ["[[entity]]", "[[controller]]", "[[hand]]", "[task]"].into_iter().any(starts) {
        format!("{NEIGHBOURS}\n{snippet}")
    } else {
        format!("{NEIGHBOURS}\n[[entity]]\nname = \"example\"\n{snippet}")
    };
    let scenario = Scenario::parse(Path::new("snippet.toml"), &text, app.registry());
    let scenario = scenario.map_err(|error| error.to_string())?;
    scenario.spawn(app.registry()).map_err(|error| error.to_string())?;
    match scenario.controllers.iter().find(|entry| app.kind_of(&entry.kind).is_none()) {
        Some(unknown) => Err(format!("no controller is of the kind '{}'", unknown.kind)),
        None => Ok(()),
    }
}

#[test]
fn every_toml_of_the_docs_is_read() {
    let mut wrong = Vec::new();
    let mut snippets = 0;
    for (name, text) in pages() {
        for (_, block, line) in blocks(&text).into_iter().filter(|(language, ..)| *language == "toml") {
            snippets += 1;
            wrong.extend(read_toml(&block).err().map(|error| format!("{name}:{line}: {error}")));
        }
    }
    refuse("snippets of TOML", wrong);
    assert!(snippets >= 12, "{snippets} snippets were found");
    assert!(read_toml("linear_fem = { yuong_modulus = 6000.0 }").is_err(), "a wrong key is refused");
    assert!(read_toml("[package]\nedition = \"2024\"\n[dependencies]\ntrocar = \"1\"").is_err());
    assert!(read_toml("[[controller]]\nname = \"x\"\nkind = \"rapeir\"\nrate_hz = 10").is_err());
}

/// The cells of the tables of figures, by the figure's name.
fn figures(page: &str) -> BTreeMap<&str, Vec<&str>> {
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `")?.split_once("` | "));
    rows.map(|(name, cells)| (name, cells.trim_end_matches(" |").split(" | ").collect())).collect()
}

#[test]
fn the_figures_of_every_suite_have_one_place() {
    let page = read("docs/figures.md");
    for suite in SUITES {
        let mark = format!("<!-- figures: bench {suite} -->\n`trocar bench {suite}` on ");
        assert_eq!(page.matches(&mark).count(), 1, "{suite}");
        let (_, rest) = page.split_once(&mark).expect("it is there");
        let (table, _) = rest.split_once("<!-- end -->").expect("a table ends");
        let rows = figures(table);
        assert!(rows.len() > 3 && rows.values().all(|cells| cells.len() == 7), "{suite}: {rows:?}");
    }
    assert_eq!(page.matches("<!-- figures:").count(), SUITES.len());
    assert_eq!(page.matches("<!-- end -->").count(), SUITES.len());
}

#[test]
fn the_figures_of_the_readme_are_those_of_the_page_of_figures() {
    let (readme, page) = (read("README.md"), read("docs/figures.md"));
    let measured = figures(&page);
    let mut shown = 0;
    for line in readme.lines().filter(|line| line.starts_with("| ") && line.contains("<!-- ")) {
        let (_, rest) = line.split_once("<!-- ").expect("it names its figure");
        let (name, cells) = rest.split_once(" --> | ").expect("and then shows it");
        let [value, unit, _, _, _, bar, _] = measured[name][..] else { panic!("{name}") };
        let wanted = match bar {
            "–" => format!("{value} {unit} | – |"),
            bar => format!("{value} {unit} | {bar}"),
        };
        assert!(cells.starts_with(&wanted), "{name}: README says {cells}, docs/figures.md {wanted}");
        shown += 1;
    }
    assert!(shown >= 8, "{shown} figures are in the README");
}

#[test]
fn the_map_of_the_code_names_every_folder_and_none_that_does_not_exist() {
    let page = read("docs/architecture.md");
    let named: BTreeSet<&str> = page
        .lines()
        .filter_map(|line| line.strip_prefix("- `")?.split_once("` – "))
        .map(|(path, _)| path)
        .collect();
    let mut wrong: Vec<String> = named
        .iter()
        .filter(|path| !root().join(path).exists())
        .map(|path| format!("{path} does not exist"))
        .collect();
    let mut waiting: Vec<PathBuf> =
        ["scene", "scene/derive", "devices"].map(|room| root().join(room).join("src")).into();
    for floor in ["actors", "ui"] {
        waiting.extend(files(floor).into_iter().map(|room| root().join(room).join("src")));
    }
    while let Some(folder) = waiting.pop() {
        let path = format!("{}/", folder.strip_prefix(root()).expect("below the root").display());
        if !named.contains(path.as_str()) {
            wrong.push(format!("{path} is not on the map"));
        }
        let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{path}: {error}"));
        waiting.extend(entries.map(|entry| entry.expect("an entry").path()).filter(|path| path.is_dir()));
    }
    refuse("the map in docs/architecture.md", wrong);
}
