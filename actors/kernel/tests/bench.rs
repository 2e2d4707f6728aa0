//! The suite of measurements runs and gives every figure that it names.

use trocar_kernel::bench::{Effort, kernel};

#[test]
fn every_figure_is_measured() {
    // `FULL_BENCH=1` measures as long as `trocar bench kernel` does.
    let effort = if std::env::var_os("FULL_BENCH").is_some() { Effort::Full } else { Effort::Smoke };
    let rows = kernel(effort).expect("sessions start");
    for row in &rows {
        println!("{row:?}");
        assert!(row.value.is_finite() && row.value > 0.0, "{row:?}");
        assert!(row.spread.is_finite() && row.spread >= 0.0, "{row:?}");
        assert!(row.ratio.is_none_or(|ratio| ratio.is_finite() && ratio > 0.0), "{row:?}");
    }
    let names: Vec<&str> = rows.iter().map(|row| row.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "hands_1khz_on_time",
            "hands_1khz_lateness_p99",
            "hands_1khz_thread_cpu",
            "hand_10khz_ticks_run",
            "hand_10khz_thread_cpu",
            "snapshot_get_100_entities",
            "snapshot_get_10000_entities",
            "write_visible_100_entities_p50",
            "write_visible_10000_entities_p50",
            "write_visible_beside_plain_awaited_send_p50",
            "write_visible_beside_plain_send_p50",
            "model_cpu_per_batch_woken",
            "model_cpu_per_batch_flood",
        ]
    );
}
