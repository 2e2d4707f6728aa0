//! Figures as a Markdown table, and the page that holds the tables of all suites.

use std::fs;
use std::path::{Path, PathBuf};

use trocar::summary::BenchSummary;
use trocar_scene::output_file::{self, Replace};

use super::{HEAD, cells};
use crate::failure::Failure;

/// Ends every table.
const END: &str = "<!-- end -->";
/// Part of the names of figures that are drawn rather than listed (`--plot`).
const GROWTH: &str = "_growth_";

/// Begins the table of a suite.
fn begin(suite: &str) -> String {
    format!("<!-- figures: bench {suite} -->")
}

/// The table of a suite, between the comments that mark its place in a page.
pub fn table(suite: &str, summary: &BenchSummary) -> String {
    let machine = &summary.machine;
    let mut lines = vec![
        begin(suite),
        format!(
            "`trocar bench {suite}` on {} × {}, real-time priority {}:",
            machine.cores,
            machine.cpu,
            if machine.fifo { "granted" } else { "refused" }
        ),
        String::new(),
        format!("| {} |", HEAD.join(" | ")),
        format!("|{}", "---|".repeat(HEAD.len())),
    ];
    for row in summary.results.iter().filter(|row| !row.name.contains(GROWTH)) {
        let [name, rest @ ..] = cells(row);
        let holds = match row.bar {
            None => "–",
            Some(_) if row.holds => "yes",
            Some(_) => "**no**",
        };
        lines.push(format!("| `{name}` | {} | {holds} |", rest.join(" | ")));
    }
    lines.push(END.to_owned());
    lines.join("\n")
}

/// A Markdown file with one place for the table of a suite.
pub struct Page {
    file: PathBuf,
    before: String,
    after: String,
}

impl Page {
    /// Reads the file and finds the place.
    ///
    /// # Errors
    /// When the file cannot be read, or does not have the place exactly once.
    pub fn read(file: &Path, suite: &str) -> Result<Self, Failure> {
        // A part of it is to be written anew.
        output_file::check(file, Replace::Writable)?;
        let text = fs::read_to_string(file)
            .map_err(|error| Failure::invalid(format!("--into {}: {error}", file.display())))?;
        let (begin, refuse) =
            (begin(suite), |what: &str| Failure::invalid(format!("--into {}: {what}", file.display())));
        let (before, rest) =
            text.split_once(&begin).ok_or_else(|| refuse(&format!("there is no '{begin}'")))?;
        if rest.contains(&begin) {
            return Err(refuse(&format!("'{begin}' stands there twice")));
        }
        let (_, after) =
            rest.split_once(END).ok_or_else(|| refuse(&format!("'{begin}' has no '{END}' after it")))?;
        Ok(Self { file: file.to_owned(), before: before.to_owned(), after: after.to_owned() })
    }

    /// Writes the file with this table in the place.
    ///
    /// # Errors
    /// When the file cannot be written; it is as it was then.
    pub fn write(self, table: &str) -> Result<(), Failure> {
        let Self { file, before, after } = self;
        Ok(output_file::write(&file, format!("{before}{table}{after}").as_bytes(), Replace::Writable)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::machine;
    use trocar::summary::{BenchResult, Better};

    fn summary() -> BenchSummary {
        let mut summary = BenchSummary::new(machine());
        let row = |name: &str, bar| BenchResult::on_value(name, "ms", (1.5, 0.1), bar, Better::Lower);
        summary.results = vec![row("a_step", Some(1.0)), row("a_growth_10", None), row("a_share", None)];
        summary
    }

    #[test]
    fn a_table_lists_figures_without_growth_and_says_what_is_missed() {
        let table = table("session", &summary());
        assert!(table.contains("| `a_step` | 1.5 | ms | 10 % | – | – | ≤ 1 | **no** |"), "{table}");
        assert!(table.contains("| `a_share` | 1.5 | ms | 10 % | – | – | – | – |"), "{table}");
        assert!(!table.contains("growth"), "{table}");
    }

    #[test]
    fn the_table_takes_its_place_in_a_page_and_leaves_the_rest() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("figures.md");
        let old = "# Figures\n\n<!-- figures: bench session -->\n| old |\n<!-- end -->\n\n\
                   <!-- figures: bench kernel -->\n| kept |\n<!-- end -->\nThe end\n";
        fs::write(&file, old).expect("it is written");
        let table = table("session", &summary());
        Page::read(&file, "session").and_then(|page| page.write(&table)).expect("it has the place");
        let new = fs::read_to_string(&file).expect("it is there");
        assert_eq!(new, old.replace("<!-- figures: bench session -->\n| old |\n<!-- end -->", &table));
        assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1, "nothing else is left");
    }

    #[test]
    fn a_page_without_the_place_is_refused_before_anything_is_measured() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("figures.md");
        let refused = |text: &str| {
            fs::write(&file, text).expect("it is written");
            Page::read(&file, "session").err().expect("it is refused").message
        };
        let begin = begin("session");
        assert!(refused("# Figures").contains("there is no '<!-- figures: bench session -->'"));
        assert!(refused(&begin).contains("has no '<!-- end -->' after it"));
        assert!(refused(&format!("{begin}{END}{begin}{END}")).contains("twice"));
        let mut protected = fs::metadata(&file).expect("a file").permissions();
        protected.set_readonly(true);
        fs::set_permissions(&file, protected).expect("its mode");
        let read_only = Page::read(&file, "session").err().expect("it is refused");
        assert!(read_only.message.contains("figures.md: is read-only"), "{}", read_only.message);
        let missing = Page::read(&folder.path().join("none.md"), "session").err().expect("it is refused");
        assert!(missing.message.contains("none.md"), "{}", missing.message);
    }
}
