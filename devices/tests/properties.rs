//! No input from outside makes the readers or the specs panic, and what they accept is valid.

use proptest::prelude::*;
use trocar_devices::{
    DeviceSpec, JigsawsSelection, JigsawsSide, JigsawsSource, StartTime, Trajectory, read_hand_csv_from,
    read_jigsaws_from,
};

fn cell() -> impl Strategy<Value = String> {
    prop_oneof![
        6 => (-1.0..1.0_f64).prop_map(|x| x.to_string()),
        2 => prop_oneof![Just("0"), Just("1"), Just("-1")].prop_map(str::to_owned),
        1 => any::<f64>().prop_map(|x| format!("{x:e}")),
        1 => "\\PC{0,6}",
    ]
}

fn rows(columns: usize, separator: &'static str) -> impl Strategy<Value = String> {
    let row = prop::collection::vec(cell(), columns).prop_map(move |cells| cells.join(separator));
    prop::collection::vec(row, 0..6).prop_map(|rows| rows.join("\n"))
}

fn good_rows() -> impl Strategy<Value = String> {
    let row = (
        1e-6..1.0_f64,
        prop::array::uniform3(-1.0..1.0_f64),
        prop::array::uniform4(0.1..1.0_f64),
        0.0..1.0_f64,
    );
    prop::collection::vec(row, 1..20).prop_map(|rows| {
        let mut t = 0.0;
        let mut text = String::from("t,x,y,z,qw,qx,qy,qz,gripper\n");
        for (step, [x, y, z], q, gripper) in rows {
            t += step;
            let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
            let [qw, qx, qy, qz] = q.map(|x| x / norm);
            text += &format!("{t},{x},{y},{z},{qw},{qx},{qy},{qz},{gripper}\n");
        }
        text
    })
}

fn assert_valid(trajectory: &Trajectory, times: &[u64]) {
    for time_ns in times.iter().copied().chain([0, trajectory.start_ns(), trajectory.end_ns(), u64::MAX]) {
        assert!(trajectory.at(time_ns).is_valid());
    }
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused_as_csv(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(read_hand_csv_from(&bytes[..], "f", StartTime::File, None).is_err());
        let mut with_header = b"t,x,y,z,qw,qx,qy,qz,gripper\n".to_vec();
        with_header.extend(bytes);
        if let Ok(trajectory) = read_hand_csv_from(&with_header[..], "f", StartTime::Zero, None) {
            assert_valid(&trajectory, &[]);
        }
    }

    #[test]
    fn any_table_is_read_or_refused_as_csv(text in rows(9, ","), times in prop::collection::vec(any::<u64>(), 4)) {
        let text = format!("t,x,y,z,qw,qx,qy,qz,gripper\n{text}");
        if let Ok(trajectory) = read_hand_csv_from(text.as_bytes(), "f", StartTime::File, None) {
            assert_valid(&trajectory, &times);
        }
    }

    #[test]
    fn any_good_table_is_read(text in good_rows(), times in prop::collection::vec(0..20_000_000_000_u64, 8)) {
        let trajectory = read_hand_csv_from(text.as_bytes(), "f", StartTime::File, None).unwrap();
        assert_valid(&trajectory, &times);
    }

    #[test]
    fn any_table_is_read_or_refused_as_jigsaws(
        space in rows(76, " "), comma in rows(76, ","), bytes in prop::collection::vec(any::<u8>(), 0..400)
    ) {
        for text in [space.as_bytes(), comma.as_bytes(), &bytes[..]] {
            for side in [JigsawsSide::Left, JigsawsSide::Right] {
                let selection = JigsawsSelection { side, source: JigsawsSource::Slave };
                if let Ok(trajectory) = read_jigsaws_from(text, "f", selection) {
                    assert_valid(&trajectory, &[]);
                }
            }
        }
    }

    #[test]
    fn any_text_is_parsed_or_refused_as_a_spec(
        text in prop_oneof![
            "\\PC{0,60}",
            "(virtual|replay|jigsaws):[a-z_]{0,10}(,[a-z_]{1,12}=[-a-z0-9.]{0,6}){0,4}",
            "virtual:(mass|friction|x|workspace|impedance)=[-0-9.ex]{0,8}",
        ]
    ) {
        if let Ok(DeviceSpec::Virtual(config)) = text.parse::<DeviceSpec>() {
            prop_assert!(config.check().is_ok());
        }
    }
}
