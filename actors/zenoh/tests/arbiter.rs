//! Called from an actor: the library panics where it blocks on a runtime with one thread.

use trocar_kernel::actix::System;
use trocar_zenoh::hand::HandBoard;
use trocar_zenoh::live::{Bridge, Router, SessionFacts, Watch, list};
use trocar_zenoh::rights::Rights;

use crate::support::{free_port, settings};

#[test]
fn everything_can_be_called_on_a_runtime_with_one_thread() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let other = format!("tcp/127.0.0.1:{}", free_port());
    System::new().block_on(async {
        let facts =
            SessionFacts { name: "s".into(), scenario: "wall".into(), is_hosted: false, station: None };
        let rights = Rights::default();
        let bridge = Bridge::open(&settings(&endpoint), &rights, &facts, &HandBoard::default());
        let bridge = bridge.expect("a bridge");
        assert_eq!(list(&settings(&endpoint), &rights).expect("a list"), [], "it does not run yet");
        let watch = Watch::open(&settings(&endpoint), &rights).expect("a watch");
        let router = Router::open(&settings(&other), &rights).expect("a router");
        drop((router, watch, bridge));
        let nobody = list(&settings(&endpoint), &rights).expect_err("nobody is there");
        assert!(nobody.to_string().contains(&endpoint), "{nobody}");
    });
}

#[test]
fn a_port_that_is_taken_is_said_with_what_to_do_and_so_is_a_name() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let running = crate::support::Running::start(&endpoint, &Rights::default(), None);
    let open = |text: &str, name: &str| {
        let facts =
            SessionFacts { name: name.into(), scenario: "wall".into(), is_hosted: false, station: None };
        Bridge::open(&settings(text), &Rights::default(), &facts, &HandBoard::default()).map(drop)
    };
    let taken = open(&endpoint, "b").expect_err("the port is taken").to_string();
    assert!(taken.contains(&format!("connect={endpoint}")), "{taken}");
    let join = format!("connect={endpoint}");
    crate::support::wait_for("the name is taken", || {
        let told = open(&join, "wall").err()?.to_string();
        assert!(told.contains("'wall' is there already") && told.contains("name="), "{told}");
        Some(())
    });
    open(&join, "other").expect("another name is free");
    drop(running);
}
