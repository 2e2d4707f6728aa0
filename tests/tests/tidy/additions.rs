//! Cost of additions: the number of existing files that must name a new type.
//!
//! One example of each kind represents the next one. The count includes production sources that name its types, except
//! for its own files, benchmarks, and the tables of kinds.

use super::{ROOMS, production_sources, refuse};

/// The tables of the kinds of controllers and devices: the only files that may name everything.
const TABLES: [&str; 4] =
    ["ui/sdk/src/kinds", "ui/sdk/src/device_kinds.rs", "devices/src/spec.rs", "ui/cli/src/bench/"];

/// An example of an addition.
struct Addition {
    what: &'static str,
    /// Its types. `*` matches any ending.
    types: &'static [&'static str],
    /// Parts of the paths of its own files.
    own: &'static [&'static str],
    /// Limit on the files that name its types. These numbers only shrink; `wanted` is the goal.
    most: usize,
    wanted: usize,
}

const ADDITIONS: [Addition; 4] = [
    Addition {
        what: "a component: the tip of an electrode",
        types: &["ElectrodeTip"],
        own: &["/cauterised", "/electrosurgery"],
        most: 1,
        wanted: 1,
    },
    Addition {
        what: "a soft method: extended position-based dynamics",
        types: &["Xpbd*"],
        own: &["/xpbd"],
        most: 2,
        wanted: 2,
    },
    Addition {
        what: "a device: a hand that is replayed",
        types: &["ReplayHand*"],
        own: &["/replay_hand"],
        most: 1,
        wanted: 1,
    },
    Addition {
        what: "an exercise: peg transfer",
        types: &["PegTransfer*", "PegRules*"],
        own: &["/peg_"],
        most: 1,
        wanted: 1,
    },
];

#[test]
fn additions_touch_few_existing_files() {
    let sources: Vec<(String, String)> =
        ROOMS.iter().flat_map(|(_, folder)| production_sources(folder)).collect();
    let mut wrong = Vec::new();
    for addition in ADDITIONS {
        let Addition { what, most, wanted, .. } = addition;
        let is_own = |name: &str| addition.own.iter().any(|own| name.contains(own));
        assert!(
            sources.iter().any(|(name, code)| is_own(name) && names(code, addition.types)),
            "{what}: gone"
        );
        let touched: Vec<&str> = sources
            .iter()
            .filter(|(name, code)| {
                !is_own(name)
                    && !TABLES.iter().any(|table| name.starts_with(table))
                    && names(code, addition.types)
            })
            .map(|(name, _)| name.as_str())
            .collect();
        let count = touched.len();
        assert!(wanted <= most, "{what}: more is wanted than allowed");
        if count > most {
            wrong.push(format!("{what} touches {count} files, {most} at most: {touched:?}"));
        } else if count < most && most > wanted {
            wrong.push(format!("{what} touches {count} files now: write {}, not {most}", count.max(wanted)));
        } else if count > wanted {
            println!("warning: {what} touches {count} files, {wanted} are wanted: {touched:?}");
        }
    }
    refuse("what additions touch", wrong);
}

/// Whether code names one of these types.
fn names(code: &str, types: &[&str]) -> bool {
    code.split(|c: char| !c.is_alphanumeric() && c != '_').any(|word| {
        types.iter().any(|name| match name.strip_suffix('*') {
            Some(stem) => word.starts_with(stem),
            None => word == *name,
        })
    })
}

#[test]
fn types_are_found_as_whole_words() {
    assert!(names("let a: XpbdBody = b;", &["Xpbd*"]));
    assert!(names("fn f(_: &Vessel)", &["Vessel"]));
    assert!(!names("let vessel = Vessels::new();", &["Vessel", "Xpbd*"]));
}
