//! Recorded hand motion: CSV, and the kinematics of JIGSAWS.
#![no_main]

use libfuzzer_sys::fuzz_target;
use trocar_devices::{
    JigsawsSelection, JigsawsSide, JigsawsSource, StartTime, Trajectory, read_hand_csv_from,
    read_jigsaws_from,
};
use trocar_fuzz::Bound;

/// Rows become 200 bytes of state each, in a vector that doubles; a CSV row has at least 18 bytes.
const ROWS: Bound = Bound { per_byte: 128, always: 256 << 10 };

fn check(read: Result<Trajectory, String>, file: &str) {
    match read {
        Ok(trajectory) => {
            for time_ns in [0, trajectory.start_ns(), trajectory.end_ns(), u64::MAX] {
                assert!(trajectory.at(time_ns).is_valid());
            }
        }
        Err(message) => assert!(message.starts_with(file), "{message}"),
    }
}

fuzz_target!(|bytes: &[u8]| {
    for start in [StartTime::File, StartTime::Zero] {
        let read = ROWS.holds(bytes.len(), || read_hand_csv_from(bytes, "hand.csv", start, None));
        check(read.map_err(|error| error.to_string()), "hand.csv");
    }
    for side in [JigsawsSide::Left, JigsawsSide::Right] {
        for source in [JigsawsSource::Slave, JigsawsSource::Master] {
            let selection = JigsawsSelection { side, source };
            let read = ROWS.holds(bytes.len(), || read_jigsaws_from(bytes, "hand.txt", selection));
            check(read.map_err(|error| error.to_string()), "hand.txt");
        }
    }
});
