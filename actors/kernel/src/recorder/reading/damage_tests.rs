//! What a damaged recording still gives: everything that is whole in it.

use proptest::prelude::*;

use crate::faults::FaultPlan;
use crate::recorder::tests::{Folder, RING, record, registry};
use crate::recorder::{Item, RecorderOptions, Recording, Replay};
use crate::testing::Count;

/// A recording of some chunks, with a short time between keyframes.
fn bytes(options: RecorderOptions) -> Vec<u8> {
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    record(&file, 6.0, options, FaultPlan::new(1));
    std::fs::read(&file).expect("written")
}

fn options() -> RecorderOptions {
    RecorderOptions { keyframe_period: crate::faults::secs(1.0), ..RecorderOptions::exact() }
}

/// The commits of a block by revision, with their payloads.
type Block = Vec<(u64, Vec<u8>)>;

/// The blocks of a file, and how many places are damaged.
fn blocks(recording: &Recording) -> (Vec<Block>, usize) {
    let (mut blocks, mut damage) = (Vec::new(), 0);
    for item in recording.items() {
        match item.expect("the file can be read") {
            Item::Commits(group) => {
                let commits = group.commits().map(|commit| (commit.revision.0, commit.payload.to_vec()));
                blocks.push(commits.collect());
            }
            Item::Damage(_) => damage += 1,
            _ => {}
        }
    }
    (blocks, damage)
}

/// Where the chunks with blocks lie: their content in the file, and the blocks of each.
fn whole_chunks(recording: &Recording) -> Vec<(std::ops::Range<usize>, usize)> {
    let mut counted = Vec::new();
    for chunk in recording.log_chunks() {
        let body = recording.chunk_body(*chunk).expect("readable");
        let items = crate::recorder::reading::chunk_items::parse_chunk(&body, false, chunk.offset);
        let blocks = items.iter().filter(|item| matches!(item, Item::Commits(_))).count();
        let begin = chunk.offset as usize;
        counted.push((begin..begin + 9 + chunk.length as usize, blocks));
    }
    counted
}

#[test]
fn damage_at_a_thousand_places_costs_no_more_than_the_chunk_that_it_hits() {
    let whole = bytes(options());
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    std::fs::write(&file, &whole).expect("written");
    let recording = Recording::open(&file).expect("opens");
    let chunks = whole_chunks(&recording);
    let (all, _) = blocks(&recording);
    assert!(chunks.len() >= 12 && all.len() >= 58, "{} chunks, {} blocks", chunks.len(), all.len());
    let mut random = trocar_scene::random::SplitMix64::new(7);
    for number in 0..1_000 {
        let at = random.below(whole.len() as u64 - 8) as usize + 8;
        let mut damaged = whole.clone();
        // A flipped bit, a byte of zero, or a run of zeros as a bad sector leaves.
        match number % 3 {
            0 => damaged[at] ^= 1 << (number % 8),
            1 => damaged[at] = damaged[at].wrapping_add(97),
            _ => {
                let end = (at + 64).min(damaged.len());
                damaged[at..end].fill(0);
            }
        }
        std::fs::write(&file, &damaged).expect("written");
        let recording = Recording::open(&file).unwrap_or_else(|error| panic!("byte {at}: {error}"));
        let hit = at..at + if number % 3 == 2 { 64 } else { 1 };
        let lost = chunks.iter().filter(|(range, _)| range.start < hit.end && hit.start < range.end);
        let lost: usize = lost.map(|(_, blocks)| blocks).sum();
        let (found, _) = blocks(&recording);
        assert!(found.len() >= all.len() - lost, "byte {at}: {} of {} blocks", found.len(), all.len());
        assert!(found.iter().all(|block| all.contains(block)), "byte {at}: a block that never was");
        let mut replay = Replay::new(&recording, &registry()).expect("a keyframe is whole");
        replay.run_to_end().unwrap_or_else(|error| {
            panic!("{number}, byte {at} of {}: {error}; {:?}; {chunks:?}", whole.len(), replay.damage())
        });
    }
}

#[test]
fn what_follows_damage_is_played_and_the_next_keyframe_makes_it_sound_again() {
    let mut damaged = bytes(options());
    let folder = Folder::new();
    let file = folder.file("a.mcap");
    std::fs::write(&file, &damaged).expect("written");
    let whole = Recording::open(&file).expect("opens");
    let (range, _) = whole_chunks(&whole)[4].clone();
    let end = whole.end().expect("closed").hash.clone();
    damaged[range.start + 200] ^= 4;
    std::fs::write(&file, &damaged).expect("written");
    let recording = Recording::open(&file).expect("opens");
    let mut replay = Replay::new(&recording, &registry()).expect("has a keyframe");
    let hash = replay.run_to_end().expect("the rest is whole");
    assert_eq!((replay.damage().len(), hash.to_string()), (1, end));
    assert_eq!(replay.view().get::<Count>(RING).map(|count| count.0), Some(6_000));
}

#[test]
fn a_recovered_file_is_closed_declares_what_is_lost_and_holds_the_rest() {
    let whole = bytes(options());
    let folder = Folder::new();
    let (file, other) = (folder.file("a.mcap"), folder.file("b.mcap"));
    std::fs::write(&file, &whole).expect("written");
    let recording = Recording::open(&file).expect("opens");
    let (all, _) = blocks(&recording);
    let chunks = whole_chunks(&recording);
    // Cut in its last third, and damaged in its third chunk.
    let mut damaged = whole[..whole.len() * 2 / 3].to_vec();
    damaged[chunks[2].0.start + 100] ^= 8;
    std::fs::write(&file, &damaged).expect("written");
    let recording = Recording::open(&file).expect("opens");
    let mut out = Vec::new();
    let recovered = recording.recover(&mut out).expect("much is whole");
    assert!(recovered.damaged_chunks >= 1 && recovered.damage.len() >= 2, "{recovered:?}");
    assert_eq!(recovered.bytes, out.len() as u64);
    std::fs::write(&other, &out).expect("written");
    let sound = Recording::open(&other).expect("opens");
    assert!(sound.truncation().is_none() && sound.damage().next().is_none());
    assert!(!sound.is_complete(), "it says that something is missing");
    assert_eq!(sound.metadata(), recording.metadata());
    let (found, damage) = blocks(&sound);
    assert_eq!(damage, 0);
    assert_eq!(found, blocks(&recording).0, "every block that was whole");
    assert!(found.len() > all.len() / 2 && found.len() < all.len());
    let mut replay = Replay::new(&sound, &registry()).expect("has a keyframe");
    replay.run_to_end().expect("sound");
    let [gap] = replay.gaps() else { panic!("one gap: {:?}", replay.gaps()) };
    assert!(gap.reason.contains("damaged"), "{gap:?}");
    assert!(mcap::Summary::read(&out).expect("sound").is_some(), "other programs read it, too");
}

#[test]
fn a_whole_file_is_recovered_as_it_was() {
    let whole = bytes(options());
    let folder = Folder::new();
    let (file, other) = (folder.file("a.mcap"), folder.file("b.mcap"));
    std::fs::write(&file, &whole).expect("written");
    let recording = Recording::open(&file).expect("opens");
    let mut out = Vec::new();
    let recovered = recording.recover(&mut out).expect("all is whole");
    assert_eq!((recovered.damaged_chunks, recovered.damage.len()), (0, 0));
    std::fs::write(&other, &out).expect("written");
    let again = Recording::open(&other).expect("opens");
    assert!(again.is_complete());
    assert_eq!((again.end(), blocks(&again)), (recording.end(), blocks(&recording)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn a_recovery_of_anything_ends_and_what_it_writes_opens(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        cut in any::<prop::sample::Index>(),
    ) {
        static BYTES: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
        let mut bytes = BYTES.get_or_init(|| bytes(options())).clone();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        bytes.truncate(bytes.len() / 2 + cut.index(bytes.len() / 2));
        let folder = Folder::new();
        let file = folder.file("a.mcap");
        std::fs::write(&file, &bytes).expect("written");
        let Ok(recording) = Recording::open(&file) else { return Ok(()) };
        let mut out = Vec::new();
        if recording.recover(&mut out).is_ok() {
            std::fs::write(&file, &out).expect("written");
            let sound = Recording::open(&file).expect("what was recovered opens");
            prop_assert!(sound.truncation().is_none() && sound.damage().next().is_none());
            prop_assert_eq!(blocks(&sound).1, 0);
        }
    }
}
