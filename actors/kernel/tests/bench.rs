//! The suite of measurements gives every figure that it names, of the size that the thing measured can have on any
//! machine, and judges it by what it says.

use trocar_kernel::bench::{Effort, Row, kernel};
use trocar_test_support::{alone, thorough};

/// A figure, its unit, between what it lies on any machine that can run a session at all, and whether it is held
/// against a floor and against a bar.
type Figure = (&'static str, &'static str, [f64; 2], bool, bool);

/// A share is at most 1. Reading costs less than a cache line from far away a few times over; a batch costs more than a
/// few instructions and less than a hand's period many times over; what is written is seen later than a core can tell
/// another one, and before anybody would call it a stall.
const FIGURES: [Figure; 13] = [
    ("hands_1khz_on_time", "share", [0.01, 1.0], true, true),
    ("hands_1khz_lateness_p99", "us", [1e-3, 5e5], true, true),
    ("hands_1khz_thread_cpu", "share", [1e-4, 1.0], false, true),
    ("hand_10khz_ticks_run", "share", [0.01, 1.0], true, true),
    ("hand_10khz_thread_cpu", "share", [1e-4, 1.0], false, false),
    ("snapshot_get_100_entities", "ns", [1.0, 2e3], false, true),
    ("snapshot_get_10000_entities", "ns", [1.0, 2e3], true, true),
    ("write_visible_100_entities_p50", "us", [0.5, 1e5], true, true),
    ("write_visible_10000_entities_p50", "us", [0.5, 1e5], true, true),
    ("write_visible_beside_plain_awaited_send_p50", "us", [0.5, 1e5], true, false),
    ("write_visible_beside_plain_send_p50", "us", [0.5, 1e5], true, false),
    ("model_cpu_per_batch_woken", "ns", [100.0, 1e7], false, false),
    ("model_cpu_per_batch_flood", "ns", [50.0, 1e6], false, false),
];

#[test]
fn every_figure_is_measured() {
    let _alone = alone();
    // At full length it measures as long as `trocar bench kernel` does.
    let effort = if thorough() { Effort::Full } else { Effort::Smoke };
    let rows = kernel(effort).expect("sessions start");
    let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(names, FIGURES.map(|(name, ..)| name));
    for (row, (_, unit, [least, most], has_floor, has_bar)) in rows.iter().zip(FIGURES) {
        println!("{row:?}");
        assert_eq!(
            (row.unit.as_str(), row.floor.is_some(), row.bar.is_some()),
            (unit, has_floor, has_bar),
            "{row:?}"
        );
        assert!((least..=most).contains(&row.value), "{row:?}");
        assert!(row.spread.is_finite() && row.spread >= 0.0, "{row:?}");
        // The floor is a thing of the same kind.
        assert!(row.floor.is_none_or(|floor| (least..=most).contains(&floor)), "{row:?}");
        let ratio = row.floor.map(|floor| row.value / floor);
        assert_eq!(row.ratio, ratio, "{row:?}");
        // Shares are held against the bar themselves: that of what is on time follows its floor.
        let judged = if row.unit == "share" { row.value } else { ratio.unwrap_or(row.value) };
        assert_eq!(row.holds, row.bar.is_none_or(|bar| row.better.holds(judged, bar)), "{row:?}");
    }
    let value = |name: &str| rows.iter().find(|row| row.name == name).map(|row: &Row| row.value);
    // All rows of one thing tell the same of it.
    assert_eq!(value("write_visible_100_entities_p50"), value("write_visible_beside_plain_awaited_send_p50"));
    assert_eq!(value("write_visible_100_entities_p50"), value("write_visible_beside_plain_send_p50"));
    // Whoever is awake already is not woken for each batch.
    assert!(value("model_cpu_per_batch_flood") < value("model_cpu_per_batch_woken"), "{rows:?}");
}
