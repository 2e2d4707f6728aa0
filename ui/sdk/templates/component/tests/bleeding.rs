//! The components in a scenario, in a session and in a recording.

use std::path::{Path, PathBuf};

use template_component::{Bleeding, BloodPool, app};
use trocar::kernel::recorder::{Recording, Replay};
use trocar::prelude::*;

const SCENARIO: &str = include_str!("../scenario.toml");

fn parse(text: &str) -> Result<Scenario, String> {
    app().scenario_from(Path::new("scenario.toml"), text).map_err(|error| error.to_string())
}

/// A file for this test in cargo's temporary folder.
fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

#[test]
fn it_stands_in_a_scenario_and_what_is_wrong_is_named_with_its_line() {
    assert!(parse(SCENARIO).is_ok());
    let refused = |from: &str, to: &str| parse(&SCENARIO.replace(from, to)).expect_err("refused");
    let error = refused("flow = 2e-7", "flow = -1.0");
    assert!(error.contains("scenario.toml:10") && error.contains("0 to 1e-4 m³/s"), "{error}");
    let error = refused("flow = 2e-7", "flow = nan");
    assert!(error.contains("scenario.toml:10") && error.contains("not finite"), "{error}");
    let error = refused("flow = 2e-7", "flwo = 2e-7");
    assert!(error.contains("flwo") && error.contains("`flow`"), "{error}");
}

#[test]
fn the_schema_says_what_every_field_means() {
    let schema = Bleeding::schema().expect("a schema");
    assert!(schema["description"].as_str().is_some_and(|text| text.contains("bleeds into the field")));
    let fields = schema["properties"].as_object().expect("fields");
    assert!(fields.values().all(|field| field["description"].is_string()), "{fields:?}");
}

#[test]
fn an_open_vessel_bleeds_a_sealed_one_does_not_and_the_recording_knows() {
    let (app, file) = (app(), scratch("bleeding.mcap"));
    let scenario = app.scenario_from(Path::new("scenario.toml"), SCENARIO).expect("a sound scenario");
    let record = Some(file.clone());
    let options = RunOptions { lockstep: true, seconds: Some(10.0), record, ..RunOptions::default() };
    let outcome = run(&app, &scenario, &options, &mut |_| {}).expect("it runs");
    let scene = &outcome.kernel.snapshot;
    let (open, sealed) =
        (scenario.entity("cystic-artery").unwrap(), scenario.entity("clipped-artery").unwrap());
    let lost = scene.get::<Bleeding>(open).expect("it bleeds").lost;
    assert!((lost / 2e-6 - 1.0).abs() < 0.01, "{lost} m³ in 10 s");
    assert_eq!(scene.get::<Bleeding>(sealed).expect("it is there").lost, 0.0);
    assert!(scene.get::<BloodPool>(open).expect("a pool").radius > 0.02);

    // Every change is in the recording, except those of derived components.
    let recording = Recording::open(&file).expect("a recording");
    let series = recording.series::<Bleeding>(app.registry(), open).expect("it was recorded");
    assert!(series.len() > 450, "{} changes in 500 ticks", series.len());
    assert!(series.windows(2).all(|pair| pair[0].1.lost <= pair[1].1.lost));
    let mut replay = Replay::new(&recording, app.registry()).expect("it can be replayed");
    replay.run_to_end().expect("to its end");
    assert_eq!(replay.view().get::<Bleeding>(open).map(|bleeding| bleeding.lost), Some(lost));
    assert!(replay.view().get::<BloodPool>(open).is_none());
}

#[test]
fn what_is_no_number_never_reaches_the_scene() {
    /// Writes an invalid value, once.
    #[derive(Default)]
    struct Careless;
    impl Controller for Careless {
        fn access(&self) -> Access {
            Access::new().writes::<Bleeding>(EntitySet::All)
        }
        fn tick(
            &mut self,
            _: &Tick<'_>,
            scene: &Snapshot,
            out: &mut Commands,
        ) -> Result<(), ControllerError> {
            for (vessel, bleeding) in scene.iter::<Bleeding>() {
                out.put(vessel, Bleeding { flow: f64::NAN, ..*bleeding });
            }
            Ok(())
        }
    }
    let app = App::new().component::<Bleeding>().component::<BloodPool>().controller::<Careless>("bleeder");
    let scenario = app.scenario_from(Path::new("scenario.toml"), SCENARIO).expect("a sound scenario");
    let options = RunOptions { lockstep: true, seconds: Some(1.0), ..RunOptions::default() };
    let outcome = run(&app, &scenario, &options, &mut |_| {}).expect("it runs");
    assert_eq!(outcome.reports[0].rejected, 50, "each of its batches was refused");
    assert!(outcome.kernel.snapshot.iter::<Bleeding>().all(|(_, bleeding)| bleeding.flow.is_finite()));
}
