//! Batches of a controller elsewhere: what is read, what is refused, and silence.

use super::*;
use crate::json_testing::any_value;
use proptest::prelude::*;
use trocar_scene::{EntityAllocator, Name, Pose, Store};

const CODE: ClaimCode = ClaimCode(7);
const RING: Entity = Entity::new(0, 0, 1);

fn scene() -> Store {
    let mut store = Store::new(Registry::standard());
    let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 0));
    assert_eq!(out.spawn(), RING);
    out.put(RING, Name("ring.1".into()));
    out.put(RING, Pose::at(0.0, 0.0, 0.0));
    out.seal();
    store.apply(&mut out, SimTime::ZERO);
    store
}

fn right(rest: Value) -> ControllerRight {
    serde_json::from_value(json!({
        "name": "wind", "reads": ["pose"], "writes": ["velocity"], "entities": ["ring.1"], "rest": rest,
    }))
    .expect("a right")
}

fn batch(sequence: u64, more: &Value) -> Vec<u8> {
    let mut batch = json!({ "claim": CODE.to_string(), "sequence": sequence });
    batch.as_object_mut().expect("an object").extend(more.as_object().expect("an object").clone());
    batch.to_string().into_bytes()
}

fn commands(store: &Store) -> Commands {
    Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 9))
}

#[test]
fn a_batch_of_who_has_the_claim_becomes_commands() {
    let store = scene();
    let mut controller = RemoteController::new(right(json!([])));
    let access = controller.access(store.view()).expect("names that there are");
    assert_eq!(access.writes, [("velocity", EntitySet::Of(vec![RING]))]);
    controller.claim(SimTime::ZERO, CODE).expect("it is free");
    let put = json!({ "put": [{ "entity": "ring.1", "component": "velocity", "value": { "linear": [0.0, 0.0, 0.1] } }],
                      "events": [{ "name": "gust", "entity": "0:0:1" }] });
    let read = controller.admit(SimTime(1), SimTime::ZERO, &batch(1, &put)).expect("admitted");
    let mut out = commands(&store);
    read.write(store.view(), &mut out).expect("it fits");
    assert_eq!((out.len(), out.events().len(), out.error()), (2, 1, None));
    controller.judged(Err("'zenoh.wind' has not declared pose"));
    let status = controller.status();
    assert_eq!(
        (&status["refused"], &status["last_refusal"]),
        (&json!(1), &json!("'zenoh.wind' has not declared pose"))
    );
}

#[test]
fn what_cannot_be_read_is_late_or_has_no_claim_is_refused_and_named() {
    let store = scene();
    let mut controller = RemoteController::new(right(json!([])));
    controller.claim(SimTime::ZERO, CODE).expect("it is free");
    let mut refused = |payload: &[u8], says: &str| {
        let now = SimTime::from_millis(1);
        let told = controller.admit(now, SimTime::from_millis(5_000), payload).expect_err(says);
        assert!(told.contains(says), "{told}");
    };
    refused(b"{", "EOF");
    refused(&batch(1, &json!({ "putt": [] })), "putt");
    refused(json!({ "claim": ClaimCode(8).to_string() }).to_string().as_bytes(), "claim");
    refused(&batch(2, &json!({ "based_on_secs": 4.0 })), "1.000 s ago");
    let row = json!({ "entity": "ring.1", "component": "pose" });
    refused(&batch(3, &json!({ "remove": vec![row; COMMANDS_MAX + 1] })), "at most 256");
    refused(&vec![b' '; BATCH_MAX + 1], "bytes");
    assert_eq!(controller.status()["refused"], json!(6));
    for (more, says) in [
        (
            json!({ "put": [{ "entity": "rnig", "component": "velocity", "value": {} }] }),
            "no entity is called 'rnig'",
        ),
        (json!({ "put": [{ "entity": "ring.1", "component": "velocty", "value": {} }] }), "velocty"),
        (
            json!({ "put": [{ "entity": "ring.1", "component": "velocity", "value": { "linear": 3 } }] }),
            "velocity of 'ring.1'",
        ),
    ] {
        let mut controller = RemoteController::new(right(json!([])));
        controller.claim(SimTime::ZERO, CODE).expect("it is free");
        let read = controller.admit(SimTime(2), SimTime::ZERO, &batch(10, &more));
        let told = read.map(|batch| batch.write(store.view(), &mut commands(&store)));
        assert!(told.is_ok_and(|told| told.is_err_and(|told| told.contains(says))), "{says}");
    }
}

#[test]
fn silence_stops_its_commands_and_writes_what_it_rests_at() {
    let store = scene();
    let rest = json!([{ "entity": "ring.1", "component": "velocity", "value": {} }]);
    let mut controller = RemoteController::new(right(rest));
    controller.claim(SimTime::ZERO, CODE).expect("it is free");
    controller.admit(SimTime::from_millis(100), SimTime::ZERO, &batch(1, &json!({}))).expect("admitted");
    assert_eq!(controller.due(), Some(SimTime::from_millis(300)));
    assert!(!controller.watch(SimTime::from_millis(299)) && controller.watch(SimTime::from_millis(300)));
    let told = controller
        .admit(SimTime::from_millis(301), SimTime::ZERO, &batch(2, &json!({})))
        .expect_err("fenced");
    assert!(told.contains("silence"), "{told}");
    let mut out = commands(&store);
    controller.rest(store.view(), &mut out).expect("it fits");
    assert_eq!(out.len(), 1);
    assert_eq!(controller.status()["silences"], json!(1));
}

#[test]
fn names_that_there_are_not_are_said_before_anything_runs() {
    let store = scene();
    let mut wrong = right(json!([]));
    wrong.entities = vec!["rnig".into()];
    let told = RemoteController::new(wrong).access(store.view()).expect_err("refused");
    assert!(told.contains("'wind'") && told.contains("rnig"), "{told}");
    let rest = json!([{ "entity": "ring.1", "component": "velocity", "value": 7 }]);
    assert!(RemoteController::new(right(rest)).access(store.view()).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

    #[test]
    fn any_payload_is_read_or_refused(payload in prop::collection::vec(any::<u8>(), 0..300), text in "\\{\"(claim|put|sequence|value)\":[\\[\\]{}0-9\",a-z:]{0,40}") {
        let store = scene();
        let mut controller = RemoteController::new(right(json!([])));
        controller.claim(SimTime::ZERO, CODE).expect("it is free");
        for bytes in [&payload[..], text.as_bytes()] {
            if let Ok(batch) = controller.admit(SimTime(1), SimTime::ZERO, bytes) {
                let _ = batch.write(store.view(), &mut commands(&store));
            }
        }
    }

    #[test]
    fn a_batch_of_any_values_of_any_components_is_refused_or_becomes_commands_that_are_valid(
        rows in prop::collection::vec((any::<prop::sample::Index>(), any_value()), 0..6),
        removed in prop::collection::vec(any::<prop::sample::Index>(), 0..3),
        others in any_value(),
    ) {
        let store = scene();
        let names: Vec<&str> = store.view().registry().iter().map(|(_, entry)| entry.name).collect();
        let put: Vec<Value> = rows
            .iter()
            .map(|(at, value)| json!({ "entity": "ring.1", "component": at.get(&names), "value": value }))
            .collect();
        let remove: Vec<Value> =
            removed.iter().map(|at| json!({ "entity": "0:0:1", "component": at.get(&names) })).collect();
        let whole = json!({ "put": put, "remove": remove });
        for more in [whole, json!({ "events": [others.clone()] }), json!({ "put": others })] {
            let mut controller = RemoteController::new(right(json!([])));
            controller.claim(SimTime::ZERO, CODE).expect("it is free");
            let mut out = commands(&store);
            let read = controller.admit(SimTime(1), SimTime::ZERO, &batch(1, &more));
            if let Ok(batch) = &read
                && batch.write(store.view(), &mut out).is_ok()
            {
                prop_assert!(out.len() <= COMMANDS_MAX);
                out.seal();
                // What a component refuses is found when it is sealed, and the batch with it.
                let is_refused = out.error().is_some();
                prop_assert!(is_refused || out.puts().all(|(_, puts)| puts.check().is_ok()));
                prop_assert!(is_refused || out.events().iter().all(|event| event.value.is_finite()));
            }
            let refused = controller.status()["refused"].as_u64();
            prop_assert_eq!(refused, Some(u64::from(read.is_err())));
        }
    }
}
