use proptest::prelude::*;
use trocar_scene::Leaves;

use super::{History, RowDecoder, RowEncoder};

/// A value with everything in it that a component may have.
type Value = (f64, Vec<[f64; 3]>, Option<String>, u32, bool, Vec<(i16, f32)>);

fn values() -> impl Strategy<Value = Value> {
    let number =
        prop_oneof![any::<f64>(), -1.0..1.0, (-900..900_i32).prop_map(|n| f64::from(n) / 128.0), Just(-0.0)];
    let points = prop::collection::vec([number.clone(), number.clone(), number.clone()], 0..6);
    let text = prop::option::of("[a-zé]{0,4}");
    let list = prop::collection::vec((any::<i16>(), any::<f32>()), 0..4);
    (number, points, text, any::<u32>(), any::<bool>(), list)
}

/// Codes blocks of rows (entity, value), and returns the blocks.
fn coded(blocks: &[Vec<(u64, Value)>]) -> Vec<Vec<u8>> {
    let (mut history, mut leaves) = (History::default(), Leaves::default());
    let blocks = blocks.iter().map(|rows| {
        let (mut out, mut encoder) = (Vec::new(), RowEncoder::new(7));
        for (commit, (entity, value)) in rows.iter().enumerate() {
            leaves.of(value).expect("it can be recorded");
            encoder.push(commit as u32 / 2, *entity, &leaves);
        }
        if !encoder.is_empty() {
            encoder.finish(&mut history, &mut out);
        }
        out
    });
    blocks.collect()
}

fn decode(history: &mut History, block: &[u8]) -> Result<Vec<(u32, u64, Vec<u8>)>, String> {
    let mut decoder = RowDecoder::new(history, block);
    let mut all = Vec::new();
    while let Some((_, rows)) = decoder.next()? {
        all.extend(rows.into_iter().map(|row| (row.commit, row.entity, row.value)));
    }
    Ok(all)
}

proptest! {
    #[test]
    fn rows_come_back_to_the_last_bit(
        blocks in prop::collection::vec(prop::collection::vec((0..3_u64, values()), 0..8), 1..5),
    ) {
        let mut history = History::default();
        for (rows, block) in blocks.iter().zip(coded(&blocks)) {
            let decoded = decode(&mut history, &block).expect("what was coded is sound");
            prop_assert_eq!(decoded.len(), rows.len());
            for (index, ((entity, value), (commit, found, bytes))) in rows.iter().zip(decoded).enumerate() {
                prop_assert_eq!((index as u32 / 2, *entity), (commit, found));
                prop_assert_eq!(postcard::to_stdvec(value).expect("it encodes"), bytes);
            }
        }
    }

    #[test]
    fn damaged_rows_are_refused_or_read_and_nothing_panics(
        rows in prop::collection::vec((0..3_u64, values()), 1..8),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut block = coded(&[rows]).remove(0);
        for (at, byte) in damage {
            let at = at.index(block.len());
            block[at] = byte;
        }
        let _ = decode(&mut History::default(), &block);
    }
}

#[test]
fn a_smooth_motion_on_a_grid_takes_less_than_two_bytes_a_number() {
    let step = 2_f64.powi(-30);
    let rows: Vec<Vec<(u64, Value)>> = (0..5)
        .map(|block| {
            let row = |tick: i32| {
                let angle = f64::from(tick) * 0.005;
                let at = |phase: f64| (0.1 * (angle + phase).sin() / step).round() * step;
                (1, (at(0.0), vec![[at(1.0), at(2.0), at(3.0)]], None, 1, true, Vec::new()))
            };
            (block * 100..block * 100 + 100).map(row).collect()
        })
        .collect();
    let blocks = coded(&rows);
    let numbers = 100 * 4;
    let deflated = miniz_oxide::deflate::compress_to_vec(&blocks[4], 6).len();
    assert!(deflated < numbers * 2, "{deflated} bytes for {numbers} numbers; 8 bytes each before");
}

#[test]
fn few_bytes_never_claim_much_memory() {
    // A million rows, a shape of four billion numbers, a text of any length.
    let claims: [&[u8]; 4] = [
        &[7, 0xff, 0xff, 0x3f, 0, 0],
        &[7, 1, 1, 1, 6, 0xff, 0xff, 0xff, 0xff, 0x0f, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 1, 0, 1],
        &[
            7, 1, 1, 1, 7, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 1, 0, 1, 0, 0, 8, 255, 255, 255, 255, 0, 0, 0,
            0,
        ],
        &[7, 1, 1, 0xff, 0xff, 0xff, 0xff, 0x0f],
    ];
    for claim in claims {
        assert!(decode(&mut History::default(), claim).is_err(), "{claim:?}");
    }
}
