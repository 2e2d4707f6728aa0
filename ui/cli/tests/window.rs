//! Windows on a real X server, with real keys and a real mouse.

use std::sync::Arc;

use crate::support::hosting::Host;
use crate::support::screen::{Running, Screen};
use serde_json::Value;
use trocar::app::App;
use trocar::run::Resumed;
use trocar_scene::{Entity, MentorLabel, MentorStroke, PictureFreeze, Snapshot};
use trocar_test_support::alone;

/// A session without files, in a small world that lasts as long as one looks.
const WALL: [&str; 6] = ["run", "wall", "--no-report", "--no-record", "--quality", "plain"];

fn differing(a: &image::RgbaImage, b: &image::RgbaImage) -> f64 {
    if a.dimensions() != b.dimensions() {
        return 1.0;
    }
    let far = |a: &image::Rgba<u8>, b: &image::Rgba<u8>| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 8);
    let count = a.pixels().zip(b.pixels()).filter(|(a, b)| far(a, b)).count();
    count as f64 / f64::from(a.width() * a.height())
}

#[test]
fn keys_and_mouse_do_what_the_list_of_keys_says() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let mut running = Running::start(&screen, folder.path(), &WALL);
    running.until("time passes", |running| running.seconds() > 0.2);

    // Space: time stands still. Right: a step of it passes.
    screen.act("key space");
    running.until("it pauses", |running| {
        let before = running.seconds();
        std::thread::sleep(std::time::Duration::from_millis(300));
        running.seconds() == before
    });
    let still = running.seconds();
    screen.act("key Right");
    running.until("a step is made", |running| running.seconds() > still);
    let stepped = running.seconds() - still;
    assert!((0.01..2.0).contains(&stepped), "{stepped}");
    let still = running.seconds();

    // A drag turns the camera, the wheel goes closer, [ goes back to the scenario's own camera.
    let from_camera = running.picture(&screen);
    assert_eq!(differing(&from_camera, &running.picture(&screen)), 0.0, "nothing has changed");
    screen.act("mousedown 1 mousemove_relative 120 40 mouseup 1");
    let turned = running.picture(&screen);
    assert!(differing(&from_camera, &turned) > 0.02, "{}", differing(&from_camera, &turned));
    screen.act("click --repeat 4 4");
    let closer = running.picture(&screen);
    assert!(differing(&turned, &closer) > 0.02, "{}", differing(&turned, &closer));
    screen.act("key bracketleft");
    assert_eq!(differing(&from_camera, &running.picture(&screen)), 0.0, "it is the camera again");

    // Without the panel at the left there is more room for the scene; two eyes share it.
    screen.act("key Tab");
    let wide = running.picture(&screen);
    assert!(wide.width() > from_camera.width() + 150, "{} {}", wide.width(), from_camera.width());
    screen.act("key F6");
    let pair = running.picture(&screen);
    let half = pair.width() / 2;
    let eye = |x| image::imageops::crop_imm(&pair, x, 0, half, pair.height()).to_image();
    let parallax = differing(&eye(0), &eye(half));
    assert!((0.0005..0.3).contains(&parallax), "two eyes see nearly the same: {parallax}");
    assert_eq!(running.seconds(), still, "looking lets no time pass");

    // Another window, and its end; then the end of everything.
    screen.act("key ctrl+n");
    running.until("there are two windows", |_| screen.windows().len() == 2);
    screen.act("key ctrl+q");
    let (code, printed) = running.end();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("wall"), "{printed}");
}

#[test]
fn closing_the_window_before_the_exercise_is_over_is_no_success() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let run =
        ["run", "peg-transfer", "--window", "--no-report", "--no-record", "--quality", "plain", "--json"];
    let mut running = Running::start(&screen, folder.path(), &run);
    running.until("time passes", |running| running.seconds() > 0.2);
    screen.act("key ctrl+q");
    let (code, printed) = running.end();
    assert_eq!(code, Some(1), "{printed}");
    let summary: Value = serde_json::from_str(&printed).expect("an object");
    assert_eq!(summary["cut_off_by"], "a person at the window");
    assert!(
        summary["error"].as_str().is_some_and(|error| error.contains("the exercise was over")),
        "{summary}"
    );
}

#[test]
fn a_value_found_in_the_panel_is_changed_by_dragging_it() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let mut running = Running::start(&screen, folder.path(), &WALL);
    running.until("time passes", |running| running.seconds() > 0.2);
    let friction = |running: &Running| {
        let fields = running.tune(&["list", "wall.rigid_body.friction"])["fields"].clone();
        fields[0]["value"].as_f64().unwrap_or_else(|| panic!("{fields}"))
    };
    let before = friction(&running);
    screen.act("key shift+Tab");
    let window = screen.windows().remove(0);
    let second = || std::thread::sleep(std::time::Duration::from_secs(1));
    // As a person does: where it did not answer yet, once more.
    running.until("the value is another one", |running| {
        second();
        // The line to type into is at the upper end of the panel at the right.
        screen.act(&format!("mousemove --window {window} 1050 32 click 1"));
        second();
        screen.act("key ctrl+a");
        screen.act("type --delay 60 wall.rigid_body.friction");
        second();
        // The first value that was found is below it; slowly, as a hand does.
        screen.act(&format!("mousemove --window {window} 905 58 sleep 0.3 mousedown 1"));
        for _ in 0..10 {
            screen.act("mousemove_relative 12 0 sleep 0.2");
        }
        screen.act("mouseup 1");
        second();
        friction(running) > before
    });
    screen.act("key Escape key ctrl+q");
    let (code, _) = running.end();
    assert_eq!(code, Some(0));
}

#[test]
fn a_person_moves_a_hand_with_the_mouse_and_gives_it_back() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let play = ["run", "wall", "--play", "--window", "--no-report", "--record", "play.mcap", "--json"];
    let mut running = Running::start(&screen, folder.path(), &play);
    running.until("time passes", |running| running.seconds() > 0.5);
    let tip = |running: &Running| -> Vec<f64> {
        let fields = running.tune(&["list", "probe.right.pose"])["fields"].clone();
        let numbers = fields.as_array().into_iter().flatten().filter_map(|field| field["value"].as_f64());
        numbers.collect()
    };
    let rested = tip(&running);
    assert!(rested.len() >= 7, "{rested:?}");
    let moved = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    running.until("the hand follows the mouse", |running| {
        screen.act("mousemove_relative 15 0");
        moved(&tip(running), &rested) > 0.004
    });
    // With the instruments in hand a space is not the window's: time goes on.
    screen.act("key space");
    let then = running.seconds();
    running.until("time goes on", |running| running.seconds() > then + 0.5);
    screen.act("key Escape");
    std::thread::sleep(std::time::Duration::from_secs(1));
    let given_back = tip(&running);
    screen.act("mousemove_relative 60 0 sleep 0.2 mousemove_relative 60 0 sleep 0.5");
    let drift = moved(&tip(&running), &given_back);
    assert!(drift < 0.002, "it follows nobody any more: {drift}");
    screen.act("key ctrl+q");
    let (_, printed) = running.end();
    let summary: Value = serde_json::from_str(&printed).expect("one object");
    assert_eq!(summary["recording_complete"], true, "{printed}");
}

#[test]
fn a_mentor_draws_writes_and_freezes_with_mouse_and_keys() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let host = Host::start(folder.path(), &["mentor=Ana"]);
    std::fs::write(folder.path().join("ticket"), &host.tickets[0]).expect("a file");
    let join = [
        "join",
        "--name",
        "Ana",
        "--ticket-file",
        "ticket",
        "--window",
        "--quality",
        "plain",
        "--record",
        "mentor.mcap",
    ];
    let mut running = Running::start(&screen, folder.path(), &join);
    running.until("time passes", |running| running.seconds() > 0.5);
    // What the host has made of it, and all stations see.
    let app = App::new();
    let shown = || -> Option<Arc<Snapshot>> {
        let recording = Resumed::read(app.registry(), &folder.path().join("mentor.mcap")).ok()?;
        Some(recording.scene().clone())
    };
    let is_of_host = |entity: Entity| entity.station() == 0;
    let window = screen.windows().remove(0);
    let second = || std::thread::sleep(std::time::Duration::from_secs(1));
    // As a person does: where it did not answer yet, once more.
    screen.act("key F4");
    running.until("a stroke is there", |_| {
        second();
        screen.act(&format!("mousemove --window {window} 560 470 sleep 0.3 mousedown 1"));
        for _ in 0..10 {
            screen.act("mousemove_relative 8 4 sleep 0.1");
        }
        screen.act("mouseup 1");
        second();
        let mut strokes = shown().into_iter().flat_map(|scene| {
            let strokes =
                scene.iter::<MentorStroke>().map(|(entity, stroke)| (entity, stroke.by.name.clone()));
            strokes.collect::<Vec<_>>()
        });
        strokes.any(|(entity, by)| is_of_host(entity) && by == "Ana")
    });
    running.until("a label is there", |_| {
        screen.act("key ctrl+l");
        second();
        screen.act("type --delay 60 here");
        screen.act("key Return");
        second();
        shown().is_some_and(|scene| scene.iter::<MentorLabel>().any(|(_, label)| label.text.contains("here")))
    });
    running.until("the pictures stand", |_| {
        screen.act("key ctrl+f");
        second();
        second();
        shown().is_some_and(|scene| scene.iter::<PictureFreeze>().next().is_some())
    });
    screen.act("key ctrl+q");
    running.end();
    host.end();
}

#[test]
fn a_display_that_disappears_takes_no_session_with_it() {
    let _alone = alone();
    let (mut screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let run = ["--window", "--json", "--seconds", "8"];
    let mut running = Running::start(&screen, folder.path(), &[&WALL[..], &run].concat());
    running.until("time passes", |running| running.seconds() > 0.5);
    // Nobody could let it go on afterwards.
    screen.act("key space");
    std::thread::sleep(std::time::Duration::from_secs(1));
    screen.vanish();
    running.until("it is said", |running| running.stderr().contains("the display is gone"));
    let said = running.stderr();
    let (code, printed) = running.end();
    let summary: Value =
        serde_json::from_str(&printed).unwrap_or_else(|error| panic!("{error}: {printed} {said}"));
    assert_eq!(code, Some(0), "{said}");
    assert!(summary["sim_secs"].as_f64().expect("a number") >= 8.0, "{printed}");
}

#[test]
fn without_a_graphics_adapter_the_window_is_given_up_and_the_session_goes_on() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let run = [&WALL[..], &["--window", "--json", "--seconds", "2"]].concat();
    let none = [("VK_DRIVER_FILES", "/dev/null"), ("VK_ICD_FILENAMES", "/dev/null")];
    let running = Running::begin(&screen, folder.path(), &run, &none);
    let (code, printed) = running.end();
    let said = std::fs::read_to_string(folder.path().join("stderr.txt")).expect("a file");
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("mesa-vulkan-drivers") && said.contains("the session goes on"), "{said}");
    let summary: Value = serde_json::from_str(&printed).expect("one object");
    assert!(summary["sim_secs"].as_f64().expect("a number") >= 2.0, "{printed}");
}

#[test]
fn the_window_stays_when_a_played_session_is_over_and_takes_the_keys_back_for_the_next_one() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let run = [&WALL[..], &["--play", "--window", "--seconds", "1.5"]].concat();
    let mut running = Running::start(&screen, folder.path(), &run);
    // A session that is over does not answer any more.
    let over = |running: &mut Running| running.until("it is over", |running| running.seconds() < 0.0);
    running.until("time passes", |running| running.seconds() > 0.1);
    over(&mut running);
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert_eq!(screen.windows().len(), 1, "the result can be read");
    // The instruments were in hand: their keys would be the session's. Now they are the window's again.
    running.until("the next one begins", |running| {
        screen.act("key BackSpace sleep 0.3");
        running.seconds() >= 0.0
    });
    over(&mut running);
    std::thread::sleep(std::time::Duration::from_secs(1));
    screen.act("key ctrl+q");
    let (code, printed) = running.end();
    assert_eq!(code, Some(0), "{printed}");
    assert_eq!(printed.matches("state hash").count(), 2, "{printed}");
}

#[test]
fn a_session_begins_anew_and_keeps_what_was_recorded_before() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let run = ["run", "wall", "--lockstep", "--window", "--no-report", "--record", "try.mcap"];
    let mut running = Running::start(&screen, folder.path(), &run);
    // In virtual time there is a pace; twice as fast is one.
    screen.act("key equal");
    screen.act("key BackSpace");
    let file = |name: &str| folder.path().join(name);
    running.until("it begins anew", |_| file("try-2.mcap").exists());
    std::thread::sleep(std::time::Duration::from_secs(1));
    screen.act("key ctrl+q");
    let (code, printed) = running.end();
    assert_eq!(code, Some(0), "{printed}");
    let told = printed.matches("state hash").count();
    assert_eq!(told, 2, "of both it is told what came of them: {printed}");
    for name in ["try.mcap", "try-2.mcap"] {
        let replayed = std::process::Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(["replay", name, "--headless"])
            .current_dir(folder.path())
            .output()
            .expect("the program starts");
        assert!(replayed.status.success(), "{name}: {}", String::from_utf8_lossy(&replayed.stderr));
    }
}

#[test]
fn a_window_of_no_size_and_a_large_one_again_show_the_same() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let mut running = Running::start(&screen, folder.path(), &WALL);
    running.until("time passes", |running| running.seconds() > 0.2);
    screen.act("key space key Tab");
    let before = running.picture(&screen);
    let window = screen.windows().remove(0);
    for size in ["1 1", "3000 2", "640 480", "1180 760"] {
        screen.act(&format!("windowsize --sync {window} {size}"));
        std::thread::sleep(std::time::Duration::from_millis(300));
    }
    screen.act(&format!("windowunmap --sync {window} windowmap --sync {window} windowfocus --sync {window}"));
    let mut after = running.picture(&screen);
    running.until("it is as large as before", |running| {
        after = running.picture(&screen);
        after.dimensions() == before.dimensions()
    });
    assert_eq!(differing(&before, &after), 0.0);
    screen.act("key ctrl+q");
    assert_eq!(running.end().0, Some(0));
}

#[test]
fn recordings_are_led_through_and_compared() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    for (seed, name) in [("1", "a.mcap"), ("2", "b.mcap")] {
        let status = std::process::Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(["run", "peg-transfer", "--lockstep", "--seconds", "2", "--no-report", "--json"])
            .args(["--seed", seed, "--record", name])
            .current_dir(folder.path())
            .stdout(std::process::Stdio::null())
            .status()
            .expect("the program starts");
        assert!(status.success());
    }
    let replay = ["replay", "a.mcap", "--beside", "b.mcap", "--window", "--quality", "plain"];
    let mut running = Running::start(&screen, folder.path(), &replay);
    let window = screen.windows().remove(0);
    screen.act("key space");
    // The timeline is at the lower end; its left quarter, then its right one, then back.
    let lead = |running: &mut Running, x: u32| {
        screen.act(&format!("mousemove --window {window} {x} 744 click 1"));
        let mut seen = running.picture(&screen);
        running.until("it is there", |running| {
            std::thread::sleep(std::time::Duration::from_millis(300));
            let before = std::mem::replace(&mut seen, running.picture(&screen));
            differing(&before, &seen) == 0.0
        });
        seen
    };
    let mut early = lead(&mut running, 400);
    // What stood still may have been what was there before: it is led there when once more changes nothing.
    running.until("it is led there", |running| {
        let before = std::mem::replace(&mut early, lead(running, 400));
        differing(&before, &early) == 0.0
    });
    running.until("another time, another scene", |running| differing(&early, &lead(running, 1100)) > 0.0005);
    running.until("the same time, the same scene", |running| differing(&early, &lead(running, 400)) == 0.0);
    running.send("-TERM");
    let (code, printed) = running.end();
    assert_eq!(code, Some(143), "{printed}");
    assert!(printed.contains("peg-transfer"), "{printed}");
}

#[test]
fn a_viewer_that_panics_or_loses_its_device_is_started_again_and_shows_the_same() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let plan = r#"schema = 1
        [[fault]]
        id = "the viewer dies"
        at_secs = 2.0
        target = "viewer"
        kind = "kill"
        [[fault]]
        id = "its device is lost"
        at_secs = 4.0
        for_secs = 8.0
        target = "viewer"
        kind = "unplug"
    "#;
    std::fs::write(folder.path().join("plan.toml"), plan).expect("a plan");
    let run = [&WALL[..], &["--window", "--json", "--faults", "plan.toml"]].concat();
    let mut running = Running::start(&screen, folder.path(), &run);
    screen.act("key Tab");
    let before = running.picture(&screen);
    for (said, number) in [("it panicked: a fault that was injected", 1), ("device", 2)] {
        running.until("it is started again", |running| {
            let told = running.stderr();
            told.matches("the viewer is started again").count() >= number && told.contains(said)
        });
    }
    // A panic takes no session with it, and the window is where it was. That it was noticed while the fault lasted is
    // certain only when that was longer than any frame.
    running.until("time goes on, and the fault is over", |running| running.seconds() > 12.5);
    let after = running.picture(&screen);
    assert_eq!(before.dimensions(), after.dimensions());
    // The wall stands still; the hand at it is small.
    assert!(differing(&before, &after) < 0.05, "{}", differing(&before, &after));
    screen.act("key ctrl+q");
    let (_, printed) = running.end();
    let summary: Value = serde_json::from_str(&printed).expect("one object");
    let faults = summary["faults"].as_array().expect("a list");
    assert_eq!(faults.len(), 2, "{printed}");
    for fault in faults {
        let at = |what: &str| fault[what].as_f64().unwrap_or_else(|| panic!("{what} of {fault}"));
        assert!(at("injected_secs") <= at("detected_secs"), "{fault}");
        assert!(at("detected_secs") <= at("resumed_secs"), "{fault}");
    }
}

#[test]
fn where_no_window_is_no_fault_can_be_aimed_at_it() {
    let _alone = alone();
    let folder = tempfile::tempdir().expect("a folder");
    let plan = "schema = 1\n[[fault]]\nid = 'a'\nat_secs = 1\ntarget = 'viewer'\nkind = 'kill'\n";
    std::fs::write(folder.path().join("plan.toml"), plan).expect("a plan");
    let run = std::process::Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(WALL)
        .args(["--headless", "--lockstep", "--seconds", "1", "--faults", "plan.toml"])
        .current_dir(folder.path())
        .output()
        .expect("the program starts");
    let said = String::from_utf8_lossy(&run.stderr);
    assert_eq!(run.status.code(), Some(4), "{said}");
    assert!(said.contains("unknown target 'viewer'; targets are: "), "{said}");
}

#[test]
fn several_cameras_stand_beside_each_other() {
    let _alone = alone();
    let (screen, folder) = (Screen::new(), tempfile::tempdir().expect("a folder"));
    let wall = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios/wall.toml");
    let second = "\n[[entity]]\nname = \"above\"\ncamera = { field_of_view = 0.9, near = 0.01, far = 1.0 }\n\
                  pose = { translation = [0.0, 0.0, 0.3], rotation = [1.0, 0.0, 0.0, 0.0] }\n";
    let scenario = std::fs::read_to_string(wall).expect("the scenario") + second;
    std::fs::write(folder.path().join("two.toml"), scenario).expect("a scenario");
    let run = ["run", "two.toml", "--no-report", "--no-record", "--quality", "plain", "--camera"];
    let mut running = Running::start(&screen, folder.path(), &[&run[..], &["camera,above"]].concat());
    running.until("time passes", |running| running.seconds() > 0.2);
    screen.act("key space");
    let pair = running.picture(&screen);
    let half = pair.width() / 2;
    let tile = |x| image::imageops::crop_imm(&pair, x, 0, half, pair.height()).to_image();
    let (left, right) = (tile(0), tile(half));
    assert!(differing(&left, &right) > 0.3, "{}", differing(&left, &right));
    // Both show something.
    for tile in [&left, &right] {
        let dark = image::RgbaImage::from_pixel(tile.width(), tile.height(), *tile.get_pixel(0, 0));
        assert!(differing(tile, &dark) > 0.2, "{}", differing(tile, &dark));
    }
    // ] goes on with one of them.
    screen.act("key bracketright");
    let one = running.picture(&screen);
    assert!(differing(&pair, &one) > 0.2, "{}", differing(&pair, &one));
    screen.act("key ctrl+q");
    assert_eq!(running.end().0, Some(0));
}
