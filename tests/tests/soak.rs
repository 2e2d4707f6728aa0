//! A sample of the random fault plans, a larger one in a thorough run of the tests; `trocar soak` runs any number.

use trocar::soak::soak;
use trocar_test_support::thorough;
use trocar_tests::{app, for_seeds};

#[test]
fn random_fault_plans_break_nothing() {
    let app = app();
    let scenario = app.scenario("peg-transfer").expect("a scenario");
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let seeds: Vec<u64> = (9_001..if thorough() { 9_101 } else { 9_003 }).collect();
    let rows = for_seeds(&seeds, |seed| {
        let file = folder.path().join(format!("{seed}.mcap"));
        soak(&app, &scenario, seed, Some(45.0), &file).expect("the session starts")
    });
    for row in rows {
        let again = format!("trocar soak --plans 1 --from {} --seconds 45", row.seed);
        assert!(row.violations.is_empty(), "{:?} after {:?}; again: {again}", row.violations, row.faults);
    }
}
