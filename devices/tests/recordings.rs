//! Recorded hands: golden files, every kind of bad file, exact replay through the driver.

use std::path::PathBuf;

use crate::support::{Bench, MS, force};
use nalgebra::Vector3;
use trocar_devices::{
    DeviceSample, DeviceSpec, HandIntent, HapticDevice, JigsawsSelection, JigsawsSide, JigsawsSource,
    ReplayHand, StartTime, TrajectoryPoint, VirtualHand, VirtualHandConfig, read_hand_csv,
    read_hand_csv_from, read_jigsaws_from,
};

const HEADER: &str = "t,x,y,z,qw,qx,qy,qz,gripper\n";

fn golden(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn csv_error(text: &str) -> String {
    read_hand_csv_from(text.as_bytes(), "hand.csv", StartTime::File).unwrap_err().to_string()
}

fn row_error(row: &str) -> String {
    csv_error(&format!("{HEADER}0,0,0,0,1,0,0,0,0\n{row}\n"))
}

#[test]
fn a_golden_csv_plays_with_differentiated_velocities() {
    let trajectory = read_hand_csv(&golden("hand.csv"), StartTime::File).unwrap();
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
    let file = read_hand_csv_from(text.as_bytes(), "f", StartTime::File).unwrap();
    assert_eq!(file.start_ns(), 1_700_000_000_500_000_000);
    let zero = read_hand_csv_from(text.as_bytes(), "f", StartTime::Zero).unwrap();
    assert_eq!((zero.start_ns(), zero.end_ns()), (0, 1_000_000_000));
    let first = zero.points()[0].state;
    assert_eq!((first.gripper, first.pose_in_device.translation.z), (0.5, 3.0));
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
    let trajectory = read_hand_csv_from(text.as_bytes(), "f", StartTime::File).unwrap();
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
                command.intent = Some(HandIntent { pose_in_device, gripper: 0.3 });
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
