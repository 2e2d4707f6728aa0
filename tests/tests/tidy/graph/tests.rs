//! Tests of the graph on small sources: cycles are found in any notation, and none where there is none.

use std::collections::BTreeMap;

use super::{Graph, circles};

fn graph(sources: &[(&str, &str)]) -> Graph {
    let sources: BTreeMap<String, String> =
        sources.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect();
    Graph::read("src/lib.rs", &|name| sources.get(name).cloned())
}

/// Imports as lines.
fn imports(sources: &[(&str, &str)]) -> Vec<String> {
    let line = |((from, to), names): (&(String, String), &std::collections::BTreeSet<String>)| {
        format!("{from} → {to}: {}", names.iter().cloned().collect::<Vec<_>>().join(", "))
    };
    graph(sources).imports().iter().map(line).collect()
}

fn circle(sources: &[(&str, &str)]) -> Vec<Vec<String>> {
    circles(&graph(sources).imports()).into_iter().map(|circle| circle.into_iter().collect()).collect()
}

const A_AND_B: [&str; 2] = ["src/a.rs", "src/b.rs"];

#[test]
fn a_circle_of_two_files_is_found() {
    let sources = [
        ("src/lib.rs", "mod a; mod b;"),
        ("src/a.rs", "use crate::b::B; pub struct A(B);"),
        ("src/b.rs", "pub struct B; fn f(_: crate::a::A) {}"),
    ];
    assert_eq!(imports(&sources), ["src/a.rs → src/b.rs: B", "src/b.rs → src/a.rs: A"]);
    assert_eq!(circle(&sources), [A_AND_B]);
}

#[test]
fn a_chain_is_no_circle() {
    let sources = [
        ("src/lib.rs", "mod a; mod b; mod c;"),
        ("src/a.rs", "use crate::b::B; use crate::c::C;"),
        ("src/b.rs", "use crate::c::C; pub struct B;"),
        ("src/c.rs", "pub struct C;"),
    ];
    assert_eq!(imports(&sources).len(), 3);
    assert_eq!(circle(&sources), Vec::<Vec<String>>::new());
}

#[test]
fn a_circle_through_re_exports_is_found_between_the_files_that_define() {
    let sources = [
        ("src/lib.rs", "mod a; mod deep; pub use deep::B as Known;"),
        ("src/a.rs", "use crate::Known; pub struct A(Known);"),
        ("src/deep/mod.rs", "mod b; pub use self::b::B;"),
        ("src/deep/b.rs", "use crate::a::A; pub struct B;"),
    ];
    assert_eq!(circle(&sources), [["src/a.rs", "src/deep/b.rs"]]);
    assert_eq!(graph(&sources).imports().len(), 2);
}

#[test]
fn a_circle_through_a_glob_is_found_and_only_for_names_that_are_used() {
    let used = [
        ("src/lib.rs", "mod a; mod b; mod c;"),
        ("src/a.rs", "use crate::b::*; pub struct A(B);"),
        ("src/b.rs", "pub use crate::c::*; pub struct B; type A = crate::a::A;"),
        ("src/c.rs", "pub struct C;"),
    ];
    assert_eq!(circle(&used), [A_AND_B]);
    assert!(!imports(&used).iter().any(|line| line.contains("c.rs")), "{:?}", imports(&used));
    let through = [used[0], ("src/a.rs", "use crate::b::*; pub struct A(C);"), used[2], used[3]];
    assert!(imports(&through).contains(&"src/a.rs → src/c.rs: C".to_owned()), "{:?}", imports(&through));
}

#[test]
fn a_circle_through_super_and_self_is_found() {
    let sources = [
        ("src/lib.rs", "mod room;"),
        ("src/room/mod.rs", "mod a; mod b;"),
        ("src/room/a.rs", "pub fn f() { super::b::g() }"),
        (
            "src/room/b.rs",
            "pub mod inner { use super::super::a; fn h() { a::f() } } pub fn g() { self::inner::h() }",
        ),
    ];
    assert_eq!(circle(&sources), [["src/room/a.rs", "src/room/b.rs"]]);
}

#[test]
fn parent_and_child_are_no_circle() {
    let sources = [
        ("src/lib.rs", "mod room; pub use room::a::A; pub const MOST: usize = 3;"),
        ("src/room/mod.rs", "pub mod a; mod b; pub use a::A; use b::B; pub struct Room(A, B);"),
        ("src/room/a.rs", "use super::Room; pub struct A; impl Room {}"),
        ("src/room/b.rs", "use super::*; pub struct B; fn f(_: Room) -> usize { crate::MOST }"),
    ];
    assert_eq!(circle(&sources), Vec::<Vec<String>>::new());
    assert_eq!(imports(&sources), ["src/room/b.rs → src/lib.rs: MOST"]);
}

#[test]
fn what_tests_import_does_not_count() {
    let sources = [
        ("src/lib.rs", "mod a; mod b;"),
        ("src/a.rs", "use crate::b::B; pub struct A(B);"),
        (
            "src/b.rs",
            "pub struct B; #[cfg(test)] use crate::a::A; #[cfg(test)] mod tests { use crate::a::A; }
             #[cfg(all(test, unix))] mod more; impl B { #[cfg(test)] fn f(_: crate::a::A) {} }",
        ),
    ];
    assert_eq!(imports(&sources), ["src/a.rs → src/b.rs: B"]);
}

#[test]
fn names_within_macros_and_names_that_macros_define_are_found() {
    let sources = [
        ("src/lib.rs", "#[macro_use] mod a; mod b;"),
        ("src/a.rs", "component! { pub struct A { x: f64 } } fn f() { print!(\"{}\", crate::b::B::new()) }"),
        ("src/b.rs", "pub struct B; fn f() { assert!(vec![crate::a::A { x: 1.0 }].is_empty()) }"),
    ];
    assert_eq!(circle(&sources), [A_AND_B]);
}

#[test]
fn a_name_used_through_an_imported_module_leads_to_who_defines_it() {
    let sources = [
        ("src/lib.rs", "mod a; mod room;"),
        ("src/a.rs", "use crate::room::{self, b}; fn f() { room::B::new(); b::g::<u8>(); }"),
        ("src/room.rs", "pub mod b; pub use b::B;"),
        ("src/room/b.rs", "pub struct B; pub fn g<T>() {}"),
    ];
    assert_eq!(imports(&sources), ["src/a.rs → src/room/b.rs: B, g"]);
}

#[test]
fn folders_are_joined_and_what_lies_within_one_another_is_left_out() {
    let sources = [
        ("src/lib.rs", "mod left; mod right; mod shared;"),
        ("src/left/mod.rs", "mod a; pub struct Left;"),
        ("src/left/a.rs", "use crate::right::b::B; use crate::shared::S;"),
        ("src/right.rs", "pub mod b; use crate::left::Left;"),
        ("src/right/b.rs", "pub struct B;"),
        ("src/shared.rs", "pub struct S; use crate::left::Left as L;"),
    ];
    let graph = graph(&sources);
    assert_eq!(circles(&graph.imports()), Vec::<std::collections::BTreeSet<String>>::new());
    let found = circles(&graph.imports_of_folders());
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].iter().collect::<Vec<_>>(), ["src/left", "src/right"]);
    let edges = graph.imports_of_folders();
    assert_eq!(edges.len(), 2, "{edges:?}");
}

#[test]
fn circles_that_touch_are_one_and_others_stand_apart() {
    let sources = [
        ("src/lib.rs", "mod a; mod b; mod c; mod d; mod e;"),
        ("src/a.rs", "pub struct A; use crate::b::B;"),
        ("src/b.rs", "pub struct B; use crate::c::C; use crate::a::A;"),
        ("src/c.rs", "pub struct C; use crate::b::B; use crate::d::D;"),
        ("src/d.rs", "pub struct D; use crate::e::E;"),
        ("src/e.rs", "pub struct E; use crate::d::D;"),
    ];
    assert_eq!(circle(&sources), [vec!["src/a.rs", "src/b.rs", "src/c.rs"], vec!["src/d.rs", "src/e.rs"]]);
}

#[test]
fn imports_from_other_crates_lead_nowhere_and_end() {
    let sources = [
        ("src/lib.rs", "mod a; use other::prelude::*; use serde; use x::x; pub use super_crate::*;"),
        ("src/a.rs", "use super::*; use crate::{x, serde::Serialize}; fn f(_: Pose) { x::x::y() }"),
    ];
    assert_eq!(imports(&sources), Vec::<String>::new());
}
