//! Forbidden constructs: clocks and threads in algorithms, iteration over hash maps, unsafe code, unbounded queues.

use super::{production, production_sources, refuse, root, sources};

/// Pure crates: no clock, no thread, no socket of their own.
const PURE: [&str; 7] = [
    "scene",
    "actors/dynamics",
    "actors/engine",
    "actors/collision",
    "actors/simulator",
    "actors/haptics",
    "actors/tasks",
];
/// Modules with a hash map that is used for look-ups only, never iterated.
const LOOKUPS: [&str; 7] = [
    "actors/kernel/src/recorder/columns/history.rs",
    "actors/kernel/src/recorder/sampler.rs",
    "scene/src/registry.rs",
    "scene/src/mesh/gmsh/mod.rs",
    "scene/src/mesh/gmsh/v4.rs",
    "scene/src/mesh/surface_repair.rs",
    "ui/viewer/src/gpu/passes.rs",
];
/// Modules in which unsafe code is allowed: scheduling, timers, the kernel's event devices, counting allocations, a
/// foreign engine's ABI, the loss of an X display.
const UNSAFE: [&str; 6] = [
    "devices/src/gamepad/evdev.rs",
    "devices/src/sched.rs",
    "actors/kernel/src/runtime/sched.rs",
    "ui/cli/src/bench/counting.rs",
    "ui/sdk/templates/engine/src/ffi.rs",
    "ui/viewer/src/window/display.rs",
];

#[test]
fn algorithms_have_no_clock_no_thread_and_no_socket() {
    const ABSENT: [&str; 9] = [
        "Instant::now",
        "SystemTime",
        "std::time::Instant",
        "std::thread",
        "thread::spawn",
        "std::net",
        "UdpSocket",
        "TcpStream",
        "std::process",
    ];
    let mut found = Vec::new();
    for folder in PURE.iter().chain(&["actors/input"]) {
        for (name, code) in production_sources(folder) {
            found.extend(
                ABSENT.iter().filter(|word| code.contains(**word)).map(|word| format!("{name}: {word}")),
            );
        }
    }
    refuse("what an algorithm may not have", found);
}

#[test]
fn sockets_and_clocks_of_the_network_lie_in_its_live_driver_alone() {
    const ABSENT: [&str; 9] = [
        "Instant",
        "SystemTime",
        "std::thread",
        "thread::spawn",
        "UdpSocket",
        "TcpStream",
        "TcpListener",
        "socket2",
        "tokio",
    ];
    let mut found = Vec::new();
    for folder in ["actors/network", "actors/zenoh"] {
        let driver = format!("{folder}/src/live/");
        let sources = production_sources(folder).into_iter().filter(|(name, _)| !name.starts_with(&driver));
        for (name, code) in sources {
            let words = ABSENT.iter().filter(|word| code.contains(**word));
            found.extend(words.map(|word| format!("{name}: {word}")));
        }
    }
    refuse("what a protocol may not have", found);
}

#[test]
fn nothing_random_is_unseeded_and_no_order_comes_from_a_hash_map() {
    let mut found = Vec::new();
    for folder in
        PURE.iter().chain(&["actors/input", "actors/kernel", "actors/network", "actors/zenoh", "devices"])
    {
        for (name, code) in production_sources(folder) {
            let hashed = ["HashMap", "HashSet"].into_iter().filter(|_| !LOOKUPS.contains(&name.as_str()));
            for word in ["thread_rng", "rand::rng()", "from_entropy", "from_os_rng"].into_iter().chain(hashed)
            {
                if code.contains(word) {
                    found.push(format!("{name}: {word}"));
                }
            }
        }
    }
    refuse("what makes two runs differ", found);
}

#[test]
fn unsafe_code_stands_in_named_modules_only_and_says_why_it_is_sound() {
    let mut found = Vec::new();
    for folder in ["scene", "devices", "actors", "ui"] {
        for (name, text) in sources(folder) {
            let production = production(&text);
            let code = production.replace("unsafe_code", "").replace("unsafe_op_in_unsafe_fn", "");
            // The word in a list of words.
            let code = code.replace("\"unsafe\"", "");
            let blocks = code
                .split(|c: char| !c.is_alphanumeric() && c != '_')
                .filter(|word| *word == "unsafe")
                .count();
            if blocks == 0 {
                continue;
            }
            let is_test = name.contains("/tests/");
            if !UNSAFE.contains(&name.as_str()) && !is_test {
                found.push(format!("{name}: unsafe code"));
            }
            if text.matches("// SAFETY:").count() == 0 {
                found.push(format!("{name}: no SAFETY comment"));
            }
        }
    }
    refuse("unsafe code where none is allowed", found);
    let pure = std::fs::read_to_string(root().join("scene/src/lib.rs")).expect("a readable source");
    assert!(pure.contains("#![forbid(unsafe_code)]"), "scene forbids unsafe code");
}

#[test]
fn every_queue_is_bounded() {
    const UNBOUNDED: [&str; 4] = ["unbounded_channel", "mpsc::channel(", "channel::unbounded", ".do_send("];
    let mut found = Vec::new();
    for folder in ["scene", "devices", "actors", "ui"] {
        for (name, text) in sources(folder) {
            let code = production(&text);
            found.extend(
                UNBOUNDED.iter().filter(|word| code.contains(**word)).map(|word| format!("{name}: {word}")),
            );
        }
    }
    refuse("queues without a bound", found);
}

#[test]
fn nothing_is_left_unfinished() {
    // Split, so that this file does not match itself.
    let marks = [
        ["to", "do!("].concat(),
        ["unimple", "mented!("].concat(),
        ["FIX", "ME"].concat(),
        ["#[ig", "nore"].concat(),
    ];
    let mut found = Vec::new();
    for folder in ["scene", "devices", "actors", "ui", "tests"] {
        for (name, text) in sources(folder) {
            found.extend(
                marks
                    .iter()
                    .filter(|mark| text.contains(mark.as_str()))
                    .map(|mark| format!("{name}: {mark}")),
            );
        }
    }
    refuse("unfinished work", found);
}
