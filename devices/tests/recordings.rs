//! Recorded hands: golden files, every kind of bad file, exact replay through the driver.

use std::path::PathBuf;

use crate::support::{Bench, MS, force};
use nalgebra::Vector3;
use trocar_devices::{
    DeviceSample, DeviceSpec, HandIntent, HapticDevice, JigsawsSelection, JigsawsSide, JigsawsSource,
    ReplayHand, StartTime, TimeUnit, TrajectoryPoint, VirtualHand, VirtualHandConfig, read_hand_csv,
    read_hand_csv_from, read_jigsaws_from,
};

const HEADER: &str = "t,x,y,z,qw,qx,qy,qz,gripper\n";

fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn csv_error(text: &str) -> String {
    read_hand_csv_from(text.as_bytes(), "hand.csv", StartTime::File, None).unwrap_err().to_string()
}

fn row_error(row: &str) -> String {
    csv_error(&format!("{HEADER}0,0,0,0,1,0,0,0,0\n{row}\n"))
}

#[test]
fn a_golden_csv_plays_with_differentiated_velocities() {
    let trajectory = read_hand_csv(&golden("hand.csv"), StartTime::File, None).unwrap();
    assert_eq!((trajectory.points().len(), trajectory.end_ns()), (4, 40_000_000));
    let state = trajectory.at(10_000_000);
    // From rows 0 and 2: 5 mm and -2 mm in 30 ms; 0.03 rad about z in 30 ms.
    assert!((state.linear_velocity - Vector3::new(0.005, -0.002, 0.0) / 0.03).norm() < 1e-12);
    assert!((state.angular_velocity - Vector3::new(0.0, 0.0, 1.0)).norm() < 1e-5);
    let between = trajectory.at(20_000_000);
    assert!((between.pose_in_device.translation.vector - Vector3::new(0.003, -0.001, 0.0)).norm() < 1e-15);
    assert!((between.pose_in_device.rotation.scaled_axis() - Vector3::new(0.0, 0.0, 0.02)).norm() < 1e-7);
    assert!((between.gripper - 0.2).abs() < 1e-15);
    assert!(between.connected && between.is_valid());
}

#[test]
fn columns_may_come_in_any_order_and_times_may_start_anywhere() {
    let text = "\u{feff}gripper, t ,x,y,z,qx,qy,qz,qw\r\n0.5,1700000000.5,1,2,3,0,0,0,1\r\n0.6,1700000001.5,1,2,3,0,0,0,1\r\n";
    let read = |start| read_hand_csv_from(text.as_bytes(), "f", start, None);
    let zero = read(StartTime::default()).unwrap();
    assert_eq!((zero.start_ns(), zero.end_ns()), (0, 1_000_000_000));
    let first = zero.points()[0].state;
    assert_eq!((first.gripper, first.pose_in_device.translation.z), (0.5, 3.0));
    // A hand that would begin to move in 54 years.
    let error = read(StartTime::File).unwrap_err().to_string();
    assert!(
        error.starts_with("f: line 2, column t: with start=file the hand would begin to move 1700000000.5 s"),
        "{error}"
    );
    let today = text.replace("1700000000.5", "7.5").replace("1700000001.5", "8.5");
    let file = read_hand_csv_from(today.as_bytes(), "f", StartTime::File, None).unwrap();
    assert_eq!((file.start_ns(), file.end_ns()), (7_500_000_000, 8_500_000_000));
}

/// Rows 10 ms apart, whose times are given.
fn rows_at(header: &str, times: &[&str]) -> String {
    let rows = times.iter().enumerate().map(|(at, time)| format!("{time},0,0,0.00{at},1,0,0,0,0\n"));
    HEADER.replacen('t', header, 1) + &rows.collect::<String>()
}

#[test]
fn a_file_of_any_clock_begins_with_its_first_row() {
    for (header, times) in [
        ("t", ["0", "0.01", "0.02"]),
        ("t", ["12.345", "12.355", "12.365"]),
        ("t", ["-0.5", "-0.49", "-0.48"]),
        ("t", ["1700000000.000000", "1700000000.010000", "1700000000.020000"]),
        ("t", ["1700000000000", "1700000000010", "1700000000020"]),
        ("t", ["1700000000000000", "1700000000010000", "1700000000020000"]),
        ("t", ["1700000000000000000", "1700000000010000000", "1700000000020000000"]),
        ("t", ["2023-11-14T22:13:19.995Z", "2023-11-14T22:13:20.005Z", "2023-11-14T22:13:20.015Z"]),
        ("t", ["2023-11-14 23:59:59.99", "2023-11-15 00:00:00", "2023-11-15 00:00:00.01"]),
        ("t", ["14:05:59.995", "14:06:00.005", "14:06:00.015"]),
        ("t_s", ["0", "0.01", "0.02"]),
        ("t_ms", ["5", "15", "25"]),
        ("t_us", ["0", "10000", "20000"]),
        ("t_ns", ["86000000000000", "86000010000000", "86000020000000"]),
    ] {
        let text = rows_at(header, &times);
        let trajectory = read_hand_csv_from(text.as_bytes(), "f", StartTime::default(), None).unwrap();
        let at: Vec<u64> = trajectory.points().iter().map(|point| point.time_ns).collect();
        assert_eq!(at, [0, 10_000_000, 20_000_000], "{times:?}");
        // 1 mm in 10 ms.
        let speed = trajectory.points()[1].state.linear_velocity.z;
        assert!((speed - 0.1).abs() < 1e-9, "{times:?}: {speed} m/s");
    }
    let text = rows_at("t", &["0", "10", "20"]);
    let unit = Some(TimeUnit::Milliseconds);
    let trajectory = read_hand_csv_from(text.as_bytes(), "f", StartTime::Zero, unit).unwrap();
    assert_eq!(trajectory.end_ns(), 20_000_000);
}

#[test]
fn two_hands_of_one_clock_stay_together_when_the_session_starts_at_a_time_of_it() {
    let start = StartTime::At(1_700_000_000_000_000_000);
    for (times, expected) in [
        (["1700000000.5", "1700000000.51", "1700000000.52"], vec![500_000_000, 510_000_000, 520_000_000]),
        (["1699999999.99", "1700000000", "1700000000.01"], vec![0, 10_000_000]),
    ] {
        let text = rows_at("t", &times);
        let trajectory = read_hand_csv_from(text.as_bytes(), "f", start, None).unwrap();
        let at: Vec<u64> = trajectory.points().iter().map(|point| point.time_ns).collect();
        assert_eq!(at, expected);
    }
    let text = rows_at("t", &["1600000000.5", "1600000000.51", "1600000000.52"]);
    let error = read_hand_csv_from(text.as_bytes(), "f", start, None).unwrap_err().to_string();
    let expected = "f: line 4, column t: the session starts at 1700000000 s of this clock, but the last row is at 1600000000.52 s";
    assert_eq!(error, expected);
}

#[test]
fn a_clock_that_cannot_be_of_a_hand_is_refused_with_the_remedy() {
    let rows: String = (0..100).map(|at| format!("{},0,0,0,1,0,0,0,0\n", 10 * at)).collect();
    let text = format!("{HEADER}{rows}");
    let read = |unit| read_hand_csv_from(text.as_bytes(), "f", StartTime::Zero, unit);
    let error = read(None).unwrap_err().to_string();
    assert!(error.contains("100 rows are 10 s apart") && error.contains("time=ms"), "{error}");
    for (unit, end) in [(TimeUnit::Milliseconds, 990_000_000), (TimeUnit::Seconds, 990_000_000_000)] {
        assert_eq!(read(Some(unit)).unwrap().end_ns(), end);
    }
    let lines = HEADER.replace('\n', "\r\n") + "0,0,0,0,1,0,0,0,0\r\n1,0,0,0,1,0,0,0,x\r\n";
    assert!(csv_error(&lines).contains("line 3, column gripper"), "{}", csv_error(&lines));
    assert!(
        row_error("soon,0,0,0,1,0,0,0,0")
            .contains("line 3, column t: \"soon\" is no time; valid are numbers")
    );
}

#[test]
fn a_bad_csv_is_refused_by_file_line_and_column() {
    for (row, message) in [
        ("1,0,NaN,0,1,0,0,0,0", "hand.csv: line 3, column y: the number is not finite"),
        ("1,0,0,inf,1,0,0,0,0", "hand.csv: line 3, column z: the number is not finite"),
        ("1,0,0,0,1,0,0,zero,0", "hand.csv: line 3, column qz: \"zero\" is not a number"),
        ("1,0,0,0,1,0,0,0,", "hand.csv: line 3, column gripper: \"\" is not a number"),
        ("1,0,0,0,1,0,0,0", "hand.csv: line 3: 8 columns instead of 9"),
        ("1,0,0,0,1,0,0,0,0,0", "hand.csv: line 3: 10 columns instead of 9"),
        ("0,0,0,0,1,0,0,0,0", "hand.csv: line 3, column t: time 0 s is not after 0 s of the row before"),
        ("-1,0,0,0,1,0,0,0,0", "hand.csv: line 3, column t: -1 is out of range (0 to 3200000000 s)"),
        ("1,120,0,0,1,0,0,0,0", "hand.csv: line 3, column x: 120 is out of range (-10 to 10 m)"),
        (
            "1,0,0,0,0.99,0,0,0,0",
            "hand.csv: line 3, column qw..qz: the quaternion is not normalised (length 0.99, valid is 1 ± 0.001)",
        ),
    ] {
        assert_eq!(row_error(row), message);
    }
    assert!(row_error("1,0,0,0,1e200,1e200,0,0,0").contains("not normalised"));
    let backwards = "2,0,0,0,1,0,0,0,0\n1.5,0,0,0,1,0,0,0,0";
    assert_eq!(
        row_error(backwards),
        "hand.csv: line 4, column t: time 1.5 s is not after 2 s of the row before"
    );
}

#[test]
fn a_quaternion_that_was_rounded_is_normalised() {
    let text = format!("{HEADER}0,0,0,0,0.9995,0,0,0,0\n");
    let trajectory = read_hand_csv_from(text.as_bytes(), "f", StartTime::File, None).unwrap();
    assert_eq!(trajectory.points()[0].state.pose_in_device.rotation.w, 1.0);
}

#[test]
fn a_csv_without_rows_or_with_a_wrong_header_is_refused() {
    assert_eq!(csv_error(""), "hand.csv: holds no rows of data");
    assert_eq!(csv_error(HEADER), "hand.csv: holds no rows of data");
    let valid = "; valid columns are t,x,y,z,qw,qx,qy,qz,gripper";
    for (header, problem) in [
        ("t,x,y,z,qw,qx,qy,qz\n", "lacks the column gripper"),
        ("t,x,y,z,qw,qx,qy,qz,jaw\n", "has an unknown column \"jaw\""),
        ("t,x,x,z,qw,qx,qy,qz,gripper\n", "has the column x twice"),
        ("0,0,0,0,1,0,0,0,0\n", "has an unknown column \"0\""),
    ] {
        assert_eq!(csv_error(header), format!("hand.csv: line 1: the header {problem}{valid}"));
    }
}

#[test]
fn a_golden_jigsaws_file_gives_each_of_the_four_manipulators() {
    let bytes = std::fs::read(golden("jigsaws.txt")).unwrap();
    let all = [
        (JigsawsSource::Master, JigsawsSide::Left),
        (JigsawsSource::Master, JigsawsSide::Right),
        (JigsawsSource::Slave, JigsawsSide::Left),
        (JigsawsSource::Slave, JigsawsSide::Right),
    ];
    for (block, (source, side)) in all.into_iter().enumerate() {
        let number = block as f64 + 1.0;
        let trajectory = read_jigsaws_from(&bytes[..], "f", JigsawsSelection { side, source }).unwrap();
        assert_eq!((trajectory.points().len(), trajectory.end_ns()), (3, 66_666_666));
        let state = trajectory.at(33_333_333);
        assert!((state.pose_in_device.translation.x - 0.01 * number).abs() < 1e-9);
        // Printed with six digits: velocities by differentiation are good to 1e-6 m / 66 ms.
        assert!((state.linear_velocity.y - 0.02 * number).abs() < 2e-5, "{}", state.linear_velocity.y);
        assert!((state.angular_velocity.z - 0.3 * number).abs() < 1e-3);
        assert!((state.gripper - (0.25 * block as f64 - 0.1).max(0.0)).abs() < 1e-9);
        assert!(state.is_valid());
    }
}

#[test]
fn jigsaws_with_commas_and_a_header_reads_the_same() {
    let text = std::fs::read_to_string(golden("jigsaws.txt")).unwrap();
    let rows = text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(","));
    let header = (0..76).map(|n| format!("column{n}")).collect::<Vec<_>>().join(",");
    let csv = std::iter::once(header).chain(rows).collect::<Vec<_>>().join("\r\n");
    let selection = JigsawsSelection::default();
    assert_eq!(
        read_jigsaws_from(csv.as_bytes(), "f", selection).unwrap(),
        read_jigsaws_from(text.as_bytes(), "f", selection).unwrap()
    );
}

#[test]
fn bad_jigsaws_files_are_refused_by_file_line_and_column() {
    let text = std::fs::read_to_string(golden("jigsaws.txt")).unwrap();
    let rows: Vec<Vec<String>> =
        text.lines().map(|line| line.split_whitespace().map(str::to_owned).collect()).collect();
    let error = |column: usize, value: &str| {
        let mut rows = rows.clone();
        rows[1][column] = value.to_owned();
        let text = rows.iter().map(|row| row.join(" ")).collect::<Vec<_>>().join("\n");
        let selection = JigsawsSelection { side: JigsawsSide::Left, source: JigsawsSource::Slave };
        read_jigsaws_from(text.as_bytes(), "suture.txt", selection).unwrap_err().to_string()
    };
    assert_eq!(
        error(38, "nan"),
        "suture.txt: line 2, column 39 (slave left, position x): the number is not finite"
    );
    assert_eq!(
        error(56, "wide"),
        "suture.txt: line 2, column 57 (slave left, gripper): \"wide\" is not a number"
    );
    assert!(
        error(41, "-1").contains("line 2, column 42 (slave left, rotation 11): the matrix is no rotation")
    );
    assert_eq!(error(0, ""), "suture.txt: line 2: 75 columns instead of 76");
    let empty = read_jigsaws_from(&b"\n \n"[..], "e.txt", JigsawsSelection::default()).unwrap_err();
    assert_eq!(empty.to_string(), "e.txt: holds no rows of data");
    let long = vec![b'1'; 100_000];
    let long = read_jigsaws_from(&long[..], "l.txt", JigsawsSelection::default()).unwrap_err();
    assert_eq!(long.to_string(), "l.txt: line 1: the line is longer than 8192 bytes");
}

#[test]
fn a_jigsaws_spec_registers_by_centre_scale_and_pose() {
    let file = golden("jigsaws.txt");
    let text = format!("jigsaws:{},side=right,source=slave,scale=2,at_z=0.01", file.display());
    let mut device = text.parse::<DeviceSpec>().unwrap().build().unwrap();
    device.open(0).unwrap();
    let middle = device.read(33_333_333).unwrap().pose_in_device.translation.vector;
    assert!((middle - Vector3::new(0.0, 0.0, 0.01)).norm() < 1e-6, "{middle}");
    let start = device.read(0).unwrap().pose_in_device.translation.vector;
    assert!((start.y + 2.0 * 0.02 * 4.0 / 30.0).abs() < 1e-5);
}

/// Plays through a driver against a spring; what the driver published.
fn play(device: Box<dyn HapticDevice>, intents: bool) -> Vec<DeviceSample> {
    let mut bench = Bench::new(device);
    let mut link = bench.slot.take(1).unwrap();
    (1..=600_u64)
        .map(|ms| {
            if ms == 200 {
                bench.faults.unplug_until(bench.now_ns + 50 * MS);
            }
            let x = link.sample().state.pose_in_device.translation.x;
            let mut command = force(1, bench.now_ns + MS, -100.0 * x);
            if intents {
                let pose_in_device =
                    nalgebra::Isometry3::translation(0.02 * (ms as f64 * 0.01).sin(), 0.0, 0.0);
                command.intent = Some(HandIntent::at(pose_in_device, 0.3));
            }
            link.command(command);
            bench.step()
        })
        .collect()
}

#[test]
fn our_own_recording_replays_bit_for_bit_through_the_driver() {
    let live = play(Box::new(VirtualHand::new(VirtualHandConfig::default()).unwrap()), true);
    assert!(live.iter().any(|sample| !sample.state.connected) && live[599].applied.force.norm() > 0.1);
    let replay = ReplayHand::from_recording(live.iter().map(TrajectoryPoint::from).collect()).unwrap();
    let again = play(Box::new(replay), false);
    for (live, again) in live.iter().zip(&again) {
        assert_eq!(live.state, again.state, "at {} ns", live.published_at_ns);
        assert_eq!(live.applied, again.applied, "at {} ns", live.published_at_ns);
    }
}

#[test]
fn force_moves_a_replayed_hand_only_if_asked() {
    let file = golden("hand.csv");
    let mut positions = Vec::new();
    for force in ["off", "on,friction=0"] {
        let text = format!("replay:{},force={force}", file.display());
        let mut device = text.parse::<DeviceSpec>().unwrap().build().unwrap();
        device.open(0).unwrap();
        for ms in 1..=2_000_u64 {
            device.read(ms * MS).unwrap();
            device.write(ms * MS, &trocar_devices::Wrench::from_force(Vector3::new(1.0, 0.0, 0.0))).unwrap();
        }
        let state = device.read(2_001 * MS).unwrap();
        assert!((state.gripper - 0.4).abs() < 1e-3);
        positions.push(state.pose_in_device.translation.x);
    }
    assert_eq!(positions[0], 0.006);
    // 1 N against the arm's 500 N/m.
    assert!((positions[1] - 0.008).abs() < 1e-9, "{}", positions[1]);
}
