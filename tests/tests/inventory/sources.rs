//! Lists the tests in the sources: files are found as the compiler finds them, from the root of each program along its
//! `mod` lines, so that a file outside every program has no tests.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A test function.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Test {
    /// `package::program`: the program is `lib`, `main`, `alone`, `tidy` …
    pub program: String,
    /// Its modules and its name, as its program lists it.
    pub name: String,
    /// Whether it begins by taking the lock of the tests that run alone.
    pub takes_the_lock: bool,
}

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Word(String),
    Text(String),
    Sign(char),
}

/// Words, strings and symbols of a source, without comments and character literals.
fn tokens(source: &str) -> Vec<Token> {
    let text: Vec<char> = source.chars().collect();
    let at = |i: usize| text.get(i).copied().unwrap_or('\0');
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut found = Vec::new();
    let mut i = 0;
    while i < text.len() {
        match at(i) {
            '/' if at(i + 1) == '/' => {
                while i < text.len() && at(i) != '\n' {
                    i += 1;
                }
            }
            '/' if at(i + 1) == '*' => {
                let mut depth = 0;
                while i < text.len() {
                    match (at(i), at(i + 1)) {
                        ('/', '*') => (depth, i) = (depth + 1, i + 2),
                        ('*', '/') => (depth, i) = (depth - 1, i + 2),
                        _ => i += 1,
                    }
                    if depth == 0 {
                        break;
                    }
                }
            }
            '"' => {
                let begin = i + 1;
                i = begin;
                while i < text.len() && at(i) != '"' {
                    i += if at(i) == '\\' { 2 } else { 1 };
                }
                found.push(Token::Text(text[begin..i.min(text.len())].iter().collect()));
                i += 1;
            }
            // A character literal ends within a few characters; a lifetime does not end in a quote.
            '\'' if at(i + 1) == '\\' => {
                i += 3;
                while i < text.len() && at(i) != '\'' {
                    i += 1;
                }
                i += 1;
            }
            '\'' if at(i + 2) == '\'' => i += 3,
            c if is_word(c) => {
                let begin = i;
                while is_word(at(i)) {
                    i += 1;
                }
                let word: String = text[begin..i].iter().collect();
                let hashes = (i..text.len()).take_while(|place| at(*place) == '#').count();
                if ["r", "br", "cr"].contains(&word.as_str()) && at(i + hashes) == '"' {
                    let begin = i + hashes + 1;
                    i = begin;
                    let ends = |i: usize| at(i) == '"' && (1..=hashes).all(|n| at(i + n) == '#');
                    while i < text.len() && !ends(i) {
                        i += 1;
                    }
                    found.push(Token::Text(text[begin..i.min(text.len())].iter().collect()));
                    i += hashes + 1;
                } else {
                    found.push(Token::Word(word));
                }
            }
            c if c.is_whitespace() => i += 1,
            c => {
                found.push(Token::Sign(c));
                i += 1;
            }
        }
    }
    found
}

/// The attributes before a function or a module.
#[derive(Default)]
struct Attributes {
    is_test: bool,
    path: Option<String>,
}

/// A source file reached from a program's root.
struct File {
    path: PathBuf,
    /// Its module path.
    modules: Vec<String>,
    /// The folder of its modules' files.
    folder: PathBuf,
}

struct Reader {
    program: String,
    found: Vec<Test>,
    open: Vec<File>,
}

/// Tests of the program with this root.
pub fn tests(program: &str, root: &Path) -> Vec<Test> {
    let folder = root.parent().expect("a source lies in a folder").to_owned();
    let open = vec![File { path: root.to_owned(), modules: Vec::new(), folder }];
    let mut reader = Reader { program: program.to_owned(), found: Vec::new(), open };
    while let Some(file) = reader.open.pop() {
        reader.read(&file);
    }
    reader.found
}

impl Reader {
    fn read(&mut self, file: &File) {
        let source = std::fs::read_to_string(&file.path)
            .unwrap_or_else(|error| panic!("{}: {error}", file.path.display()));
        let tokens = tokens(&source);
        // The module of each open brace, if it belongs to one.
        let mut braces: Vec<Option<String>> = Vec::new();
        let mut before = Attributes::default();
        let mut i = 0;
        while i < tokens.len() {
            match &tokens[i] {
                Token::Sign('#') if tokens.get(i + 1) == Some(&Token::Sign('[')) => {
                    i = attribute(&tokens, i + 2, &mut before);
                    continue;
                }
                Token::Word(word) if word == "fn" => {
                    if let (true, Some(Token::Word(name))) = (before.is_test, tokens.get(i + 1)) {
                        let modules = file.modules.iter().chain(braces.iter().flatten());
                        let name = modules.chain([name]).cloned().collect::<Vec<_>>().join("::");
                        let takes_the_lock = takes_the_lock(&tokens[i..]);
                        self.found.push(Test { program: self.program.clone(), name, takes_the_lock });
                    }
                    before = Attributes::default();
                }
                Token::Word(word) if word == "mod" => {
                    if let (Some(Token::Word(name)), Some(Token::Sign(next))) =
                        (tokens.get(i + 1), tokens.get(i + 2))
                    {
                        match next {
                            ';' => {
                                let inline: Vec<&String> = braces.iter().flatten().collect();
                                self.open.push(below(file, &inline, name, before.path.as_deref()));
                            }
                            '{' => {
                                braces.push(Some(name.clone()));
                                i += 2;
                            }
                            _ => {}
                        }
                    }
                    before = Attributes::default();
                }
                Token::Sign('{') => {
                    braces.push(None);
                    before = Attributes::default();
                }
                Token::Sign('}') => {
                    braces.pop();
                    before = Attributes::default();
                }
                Token::Sign(';') => before = Attributes::default(),
                _ => {}
            }
            i += 1;
        }
    }
}

/// Reads an attribute after its bracket; returns the position after it.
fn attribute(tokens: &[Token], from: usize, into: &mut Attributes) -> usize {
    let mut depth = 1;
    let mut i = from;
    while i < tokens.len() && depth > 0 {
        match &tokens[i] {
            Token::Sign('[') => depth += 1,
            Token::Sign(']') => depth -= 1,
            _ => {}
        }
        i += 1;
    }
    match &tokens[from..i] {
        [Token::Word(word), Token::Sign(']')] if word == "test" => into.is_test = true,
        [Token::Word(word), Token::Sign('='), Token::Text(path), ..] if word == "path" => {
            into.path = Some(path.clone());
        }
        _ => {}
    }
    i
}

/// The file of a module, as the compiler finds it.
fn below(file: &File, inline: &[&String], name: &str, path: Option<&str>) -> File {
    let modules =
        file.modules.iter().chain(inline.iter().copied()).cloned().chain([name.to_owned()]).collect();
    if let Some(path) = path {
        assert!(inline.is_empty(), "{}: a path within a module is not understood", file.path.display());
        let path = file.path.parent().expect("a source lies in a folder").join(path);
        let folder = path.parent().expect("a source lies in a folder").to_owned();
        return File { path, modules, folder };
    }
    let above = inline.iter().fold(file.folder.clone(), |folder, name| folder.join(name));
    let (flat, folder) = (above.join(format!("{name}.rs")), above.join(name));
    let path = if flat.exists() { flat } else { folder.join("mod.rs") };
    File { path, modules, folder }
}

/// Whether a function begins by taking the lock.
fn takes_the_lock(function: &[Token]) -> bool {
    const LOCK: &str = "let _alone = alone ( ) ;";
    let Some(begin) = function.iter().position(|token| *token == Token::Sign('{')) else {
        return false;
    };
    let first = function[begin + 1..].iter().map(|token| match token {
        Token::Word(text) | Token::Text(text) => text.clone(),
        Token::Sign(sign) => sign.to_string(),
    });
    first.take(LOCK.split(' ').count()).eq(LOCK.split(' ').map(str::to_owned))
}

/// Every program of the packages in these folders, with its root.
pub fn programs(root: &Path, folders: &[String]) -> Vec<(String, PathBuf)> {
    let mut found = Vec::new();
    for folder in folders {
        let folder = root.join(folder);
        let file = folder.join("Cargo.toml");
        let text =
            std::fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let manifest: toml::Table = toml::from_str(&text).expect("a manifest");
        let package = manifest["package"]["name"].as_str().expect("a name");
        for (name, path) in [("lib", "src/lib.rs"), ("bin", "src/main.rs")] {
            if folder.join(path).exists() {
                found.push((format!("{package}::{name}"), folder.join(path)));
            }
        }
        for test in manifest.get("test").and_then(|list| list.as_array()).into_iter().flatten() {
            let (name, path) = (test["name"].as_str().expect("text"), test["path"].as_str().expect("text"));
            found.push((format!("{package}::{name}"), folder.join(path)));
        }
        // Where cargo looks for programs itself, each file is one. Elsewhere a file that no program names would be lost
        // silently.
        let finds_itself =
            manifest["package"].get("autotests").is_none_or(|value| value.as_bool() != Some(false));
        let is_template = package.starts_with("template-");
        assert!(
            is_template || !(finds_itself && folder.join("tests").is_dir()),
            "{package}: 'autotests = false' is missing"
        );
        found.extend(files_left_out(package, &folder, &found));
    }
    found
}

/// Files beside the roots of a package's tests that none of its programs includes. They are returned as programs of
/// their own, so that the inventory lacks their tests and the comparison fails.
fn files_left_out(package: &str, folder: &Path, programs: &[(String, PathBuf)]) -> Vec<(String, PathBuf)> {
    let Ok(entries) = std::fs::read_dir(folder.join("tests")) else {
        return Vec::new();
    };
    let mut included = BTreeSet::new();
    for (_, root) in programs.iter().filter(|(program, _)| program.starts_with(&format!("{package}::"))) {
        let parent = root.parent().expect("a source lies in a folder").to_owned();
        let mut reader = Reader {
            program: String::new(),
            found: Vec::new(),
            open: vec![File { path: root.clone(), modules: Vec::new(), folder: parent }],
        };
        while let Some(file) = reader.open.pop() {
            reader.read(&file);
            included.insert(file.path);
        }
    }
    let mut left: Vec<(String, PathBuf)> = entries
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "rs") && !included.contains(path))
        .map(|path| (format!("{package}::{}", path.file_stem().unwrap_or_default().display()), path))
        .collect();
    left.sort();
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_are_found_in_modules_macros_and_files_but_not_in_comments_and_texts() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, text: &str| {
            let file = folder.path().join(name);
            std::fs::create_dir_all(file.parent().expect("a folder")).expect("a folder");
            std::fs::write(file, text).expect("a file");
        };
        write(
            "main.rs",
            r###"
            //! #[test] fn in_a_comment() {}
            mod a; // mod b;
            #[path = "elsewhere/c.rs"]
            mod c;
            /* mod d; /* nested */ #[test] fn neither() {} */
            const TEXT: &str = "#[test] fn in_a_text() {}";
            const RAW: &str = r#"#[test] fn "in_a_raw_text"() {}"#;
            const BRACES: [char; 3] = ['{', '\'', '"'];
            fn lifetime<'a>(text: &'a str) -> &'a str { text }
            mod inner {
                #[test]
                #[cfg(unix)]
                fn within() { let _alone = alone(); }
                fn helper() {}
            }
            proptest! {
                #![proptest_config(x)]
                #[test]
                fn generated(n in 0..3) { { } }
            }
            #[test]
            fn last() {}
            "###,
        );
        write("a.rs", "mod deeper; #[test] fn one() {}");
        write("a/deeper/mod.rs", "#[test] fn two() {}");
        write("elsewhere/c.rs", "mod beside;");
        write("elsewhere/beside.rs", "#[test] pub fn three() {}");
        let mut found = tests("x::main", &folder.path().join("main.rs"));
        found.sort();
        let names: Vec<&str> = found.iter().map(|test| test.name.as_str()).collect();
        assert_eq!(
            names,
            ["a::deeper::two", "a::one", "c::beside::three", "generated", "inner::within", "last"]
        );
        let locked: Vec<&str> =
            found.iter().filter(|test| test.takes_the_lock).map(|test| test.name.as_str()).collect();
        assert_eq!(locked, ["inner::within"]);
    }
}
