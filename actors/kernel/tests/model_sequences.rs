//! The Model's state machine against plain maps: 100,000 random sessions of several writers, compared after every
//! step in what became of it, every row, every revision, everything that changed since any revision, the counts,
//! the log; in the end every published snapshot is still what it was, and the log replayed gives the same scene.
//!
//! `TROCAR_SEQUENCES=1000000` plays more, as a thorough run of the tests does, `TROCAR_SEED=17` one only.

use crate::support::sequences;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use crate::support::sequences::reference::{Entry, Objection, Reference, Scene};
use crate::support::sequences::steps::{
    Author, PEG, RING, Random, Step, Write, first_claims, listing, minimal, universe,
};
use crate::support::sequences::values::{KINDS, Kind, Level, Row, Stranger, registry, with_fuse};
use trocar_kernel::runtime::guarded;
use trocar_kernel::{CommitBuffer, CommitKind, ModelCore, Outcome, Rejection};
use trocar_scene::{
    Batch, CommandError, Commands, Component, Entity, EntityAllocator, Provenance, Refusal, Registry,
    Revision, SimTime, Snapshot, Store, WriterId,
};
use trocar_test_support::thorough;

const SEQUENCES: u64 = 100_000;
const STEPS_MAX: usize = 30;
/// Between two steps \[ns\].
const STEP_NS: u64 = 40_000;

/// How often what happened.
type Tally = BTreeMap<&'static str, u64>;

fn start(registry: &Arc<Registry>) -> Store {
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
    assert_eq!((commands.spawn(), commands.spawn()), (RING, PEG));
    Kind::Count.put(&mut commands, RING, 1);
    commands.seal();
    store.apply(&mut commands, SimTime::ZERO);
    store
}

/// A Model, its reference, and what readers hold on to.
struct Bench {
    core: ModelCore,
    naive: Reference,
    universe: Vec<Entity>,
    now_ns: u64,
    tick: u64,
    held: Vec<(Arc<Snapshot>, Scene)>,
    /// The commits that were handed out, and their payloads.
    taken: Vec<(Entry, trocar_kernel::StateHash, Vec<u8>)>,
}

impl Bench {
    fn new(registry: &Arc<Registry>) -> Self {
        let mut core = ModelCore::new(start(registry), 0).expect("encodes");
        core.keep_commits(true);
        let mut naive = Reference::default();
        naive.scene.revision = 1;
        naive.scene.alive.extend([RING, PEG]);
        naive.scene.rows.insert((Kind::Count, RING), Row { value: 1, revision: 1 });
        naive.publish();
        let universe = universe();
        for (writer, claim) in first_claims() {
            core.declare(name(writer), WriterId(writer), &claim.access()).expect("fits");
            assert!(naive.declare(writer, &claim, &universe));
        }
        Self { core, naive, universe, now_ns: 0, tick: 0, held: Vec::new(), taken: Vec::new() }
    }

    fn step(&mut self, step: &Step, tally: &mut Tally) -> Result<(), String> {
        self.now_ns += STEP_NS;
        self.tick += 1;
        let mut count = |what: &'static str| *tally.entry(what).or_default() += 1;
        match step {
            Step::Batch { .. } => self.batch(step, &mut count)?,
            Step::Fence { writer, epoch } => {
                let ours = self.naive.fence(*writer, *epoch, self.now_ns);
                let theirs = self.core.fence(WriterId(*writer), *epoch, SimTime(self.now_ns));
                same("fence", &theirs, &ours)?;
                count(if ours { "fenced" } else { "fence too late" });
            }
            Step::Reborn { writer, epoch, claim } => {
                let ours = self.naive.fence(*writer, *epoch, self.now_ns);
                let theirs = self.core.fence(WriterId(*writer), *epoch, SimTime(self.now_ns));
                same("fence", &theirs, &ours)?;
                let ours = self.naive.declare(*writer, claim, &self.universe);
                let theirs = self.core.declare(name(*writer), WriterId(*writer), &claim.access());
                if theirs.is_ok() != ours {
                    return Err(format!("declared: {theirs:?}, expected {ours}"));
                }
                count(if ours { "declared anew" } else { "declaration overlaps" });
            }
            Step::Publish { take_commits } => {
                let snapshot = self.core.publish();
                self.naive.publish();
                if self.held.len() == 4 {
                    self.held.remove(self.tick as usize % 4);
                }
                self.held.push((snapshot, self.naive.scene.clone()));
                if *take_commits {
                    self.take_commits()?;
                }
                count("published");
            }
            Step::Recover => same("fell back", &self.core.recover(None), &false)?,
        }
        self.compare()
    }

    fn batch(&mut self, step: &Step, count: &mut dyn FnMut(&'static str)) -> Result<(), String> {
        let Step::Batch { writer, epoch, time_ns, writes, fuse } = step else { return Ok(()) };
        let (writer, tick) = (*writer, self.tick);
        let provenance = Provenance {
            writer: WriterId(writer),
            epoch: *epoch,
            tick,
            time: SimTime(*time_ns),
            based_on: Revision::ZERO,
        };
        let mut batch = Batch { provenance, commands: commands(self.core.view().registry(), writer, writes) };
        let before = (self.core.hash(), self.core.view().revision());
        let heard = guarded(|| with_fuse(*fuse, || self.core.apply(&mut batch, SimTime(self.now_ns))));
        // A bomb that is left in the buffers must not go off here.
        drop(batch);
        let objections = self.naive.objections(writer, *epoch, writes, *fuse);
        let bombs =
            writes.iter().any(|w| matches!(w, Write::Put(Kind::Bomb, ..) | Write::Contribute(Kind::Bomb, _)));
        use sequences::values::Fuse;
        match heard {
            Ok(Outcome::Applied { revision }) => {
                same("objections", &Vec::new(), &objections)?;
                self.naive.apply(writer, tick, *time_ns, writes, self.now_ns);
                same("revision", &revision.0, &self.naive.scene.revision)?;
                count("applied");
            }
            Ok(outcome) => {
                let told = translate(&outcome)?;
                if !objections.contains(&told) {
                    return Err(format!("told {told:?}, expected one of {objections:?}"));
                }
                same("state after a refusal", &(self.core.hash(), self.core.view().revision()), &before)?;
                if let Some(writer) = self.naive.writers.get_mut(&writer) {
                    if told.is_conflict() {
                        writer.counts.conflicts += 1
                    } else {
                        writer.counts.rejected += 1
                    }
                }
                count(label(&told));
            }
            Err(panic) => {
                let early = match fuse {
                    // Its check comes in the order of the components' names, before or after other objections.
                    Some(Fuse::Check) => {
                        bombs
                            && !objections.iter().any(|objection| {
                                matches!(
                                    objection,
                                    Objection::Stranger
                                        | Objection::Stale
                                        | Objection::Malformed(_)
                                        | Objection::Conflict(..)
                                )
                            })
                    }
                    Some(Fuse::Encode) => bombs && objections.is_empty(),
                    _ => false,
                };
                let half = *fuse == Some(Fuse::Replace)
                    && objections.is_empty()
                    && self.naive.disturbs_a_bomb(writer, writes);
                if !early && !half {
                    return Err(format!("panicked: {panic}"));
                }
                if early {
                    same(
                        "state after an early panic",
                        &(self.core.hash(), self.core.view().revision()),
                        &before,
                    )?;
                }
                same("fell back", &self.core.recover(Some(WriterId(writer))), &half)?;
                if let Some(writer) = self.naive.writers.get_mut(&writer) {
                    writer.counts.quarantined += 1;
                }
                if half {
                    self.naive.fall_back();
                }
                count(if half { "panicked half applied" } else { "panicked untouched" });
                return Ok(());
            }
        }
        // Whoever ought to have panicked did.
        let must = match fuse {
            Some(Fuse::Check | Fuse::Encode) => bombs && objections.is_empty(),
            _ => false,
        };
        if must { Err("a bomb did not go off".to_owned()) } else { Ok(()) }
    }

    fn take_commits(&mut self) -> Result<(), String> {
        let commits = self.core.swap_commits(CommitBuffer::new());
        for commit in commits.iter() {
            let Provenance { writer, epoch, tick, time, .. } = commit.provenance;
            let entry = Entry {
                is_fence: commit.kind == CommitKind::Fence,
                writer: writer.0,
                epoch,
                tick,
                time_ns: time.as_nanos(),
                revision: commit.revision.0,
            };
            same("name in the log", &commit.writer, &name(writer.0))?;
            self.taken.push((entry, commit.hash, commit.payload.to_vec()));
        }
        let log: Vec<&Entry> = self.taken.iter().map(|(entry, ..)| entry).collect();
        same("log", &log, &self.naive.log.iter().collect())?;
        match self.taken.last() {
            Some((_, hash, _)) => same("hash at the end of the log", hash, &self.core.hash()),
            None => Ok(()),
        }
    }

    fn compare(&self) -> Result<(), String> {
        let naive = &self.naive;
        compare_scene(self.core.view(), &naive.scene, &[0, naive.scene.revision.saturating_sub(2)])?;
        same("published", &self.core.published().revision().0, &naive.published().revision)?;
        for (id, writer) in &naive.writers {
            same("epoch", &self.core.epoch(WriterId(*id)), &Some(writer.epoch))?;
            let counts = self.core.counts(WriterId(*id)).unwrap_or_default();
            let counts =
                (counts.applied, counts.rejected, counts.conflicts, counts.quarantined, counts.undone);
            let ours = &writer.counts;
            let ours = (ours.applied, ours.rejected, ours.conflicts, ours.quarantined, ours.undone);
            same("counts (applied, rejected, conflicts, quarantined, undone)", &counts, &ours)?;
        }
        for drained in [false, true] {
            let due = self.core.is_publish_due(SimTime(self.now_ns), drained);
            same("publication due", &due, &naive.is_publish_due(self.now_ns, drained))?;
        }
        Ok(())
    }

    /// Everything that was ever published is what it was, and the log gives the same scene again.
    fn finish(&mut self, registry: &Arc<Registry>) -> Result<(), String> {
        let mut tally = Tally::new();
        self.step(&Step::Publish { take_commits: true }, &mut tally)?;
        for (snapshot, scene) in &self.held {
            let revisions: Vec<u64> = (0..=scene.revision).collect();
            compare_scene(snapshot, scene, &revisions)
                .map_err(|why| format!("a snapshot that is held: {why}"))?;
        }
        let mut again = ModelCore::new(start(registry), 0).map_err(|error| error.to_string())?;
        for (entry, hash, payload) in &self.taken {
            let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
            commands.decode(payload).map_err(|error| format!("a commit: {error}"))?;
            let kind = if entry.is_fence { CommitKind::Fence } else { CommitKind::Batch };
            let provenance = Provenance {
                writer: WriterId(entry.writer),
                epoch: entry.epoch,
                tick: entry.tick,
                time: SimTime(entry.time_ns),
                based_on: Revision::ZERO,
            };
            let revision = again
                .replay(kind, Revision::ZERO, name(entry.writer), provenance, &mut commands)
                .map_err(|error| format!("replay: {error}"))?;
            same("replayed", &(revision.0, again.hash()), &(entry.revision, *hash))?;
        }
        let mut kept = self.naive.scene.clone();
        kept.rows.retain(|(kind, _), _| !kind.is_derived());
        compare_scene(again.view(), &kept, &[0]).map_err(|why| format!("after replay: {why}"))
    }
}

fn name(writer: u16) -> &'static str {
    ["scenario", "engine", "pilot", "guest"].get(usize::from(writer)).copied().unwrap_or("stranger")
}

fn same<T: PartialEq + std::fmt::Debug>(what: &str, is: &T, expected: &T) -> Result<(), String> {
    if is == expected { Ok(()) } else { Err(format!("{what}: is {is:?}, expected {expected:?}")) }
}

fn compare_scene(scene: &Snapshot, naive: &Scene, since: &[u64]) -> Result<(), String> {
    same("revision", &scene.revision().0, &naive.revision)?;
    same("time", &scene.time().as_nanos(), &naive.time_ns)?;
    if !scene.entities().eq(naive.alive.iter().copied()) {
        return Err(format!(
            "entities: {:?}, expected {:?}",
            scene.entities().collect::<Vec<_>>(),
            naive.alive
        ));
    }
    let events: Vec<u8> = scene.events().since(0).map(|(_, event)| event.value as u8).collect();
    same("events", &events, &naive.events)?;
    for kind in KINDS {
        let id = scene.registry().by_name(kind.name()).map_err(|error| error.to_string())?;
        let rows = naive.rows.keys().filter(|(of, _)| *of == kind).count();
        same("rows of a column", &scene.erased_column(id).len(), &rows)?;
        for since in std::iter::once(None).chain(since.iter().copied().map(Some)) {
            let mut expected = naive
                .rows
                .range((kind, Entity::from_bits(0))..=(kind, Entity::from_bits(u64::MAX)))
                .filter(|(_, row)| since.is_none_or(|since| row.revision > since))
                .map(|((_, entity), row)| (*entity, *row));
            let mut wrong = None;
            kind.visit(scene, since, &mut |entity, row| {
                let ours = expected.next();
                if ours != Some((entity, row)) {
                    wrong.get_or_insert(format!("{entity} {row:?}, expected {ours:?}"));
                }
            });
            let wrong = wrong.or_else(|| expected.next().map(|row| format!("{row:?} is missing")));
            if let Some(wrong) = wrong {
                return Err(format!("{} since {since:?}: {wrong}", kind.name()));
            }
        }
    }
    Ok(())
}

fn commands(registry: &Arc<Registry>, writer: u16, writes: &[Write]) -> Commands {
    let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, writer));
    for write in writes {
        match write {
            Write::Put(kind, entity, value) => kind.put(&mut out, *entity, *value),
            Write::Remove(kind, entity) => kind.remove(&mut out, *entity),
            Write::Contribute(kind, value) => kind.put(&mut out, Entity::of_writer(0, writer), *value),
            Write::Transfer(kind, entity, to) => kind.transfer(&mut out, *entity, *to),
            Write::Spawn(entity) => spawn(&mut out, *entity),
            Write::Despawn(entity) => out.despawn(*entity),
            Write::Require(kind, entity, since) => kind.require(&mut out, *entity, *since),
            Write::Event { value, finite } => {
                let value = if *finite { f64::from(*value) } else { f64::NAN };
                out.event("something", RING, None, value);
            }
            Write::Unregistered => out.put(RING, Stranger(0)),
            Write::NotFinite(entity) => out.put(*entity, Level(f64::INFINITY)),
        }
    }
    out.seal();
    out
}

/// Spawns an entity of a given number, also one that exists already, as only bytes from outside can.
fn spawn(out: &mut Commands, entity: Entity) {
    let mut bytes = postcard::to_allocvec(&vec![entity]).expect("encodes");
    bytes.extend([0; 5]);
    assert!(out.decode(&bytes).expect("well-formed").is_empty());
}

fn kind_of(component: &str) -> Result<Kind, String> {
    KINDS
        .into_iter()
        .find(|kind| kind.name() == component)
        .ok_or_else(|| format!("a refusal names {component}"))
}

fn translate(outcome: &Outcome) -> Result<Objection, String> {
    Ok(match outcome {
        Outcome::Conflict(Refusal::Conflict { component, entity, .. }) => {
            Objection::Conflict(kind_of(component)?, *entity)
        }
        Outcome::Rejected(rejection) => match rejection {
            Rejection::UnknownWriter(_) => Objection::Stranger,
            Rejection::StaleEpoch { .. } => Objection::Stale,
            Rejection::UnknownHeir(heir) => Objection::UnknownHeir(*heir),
            Rejection::OwnEntity { component, entity } => Objection::OwnEntity(kind_of(component)?, *entity),
            Rejection::Unencodable(_) => Objection::Unencodable,
            Rejection::Refused(refusal) => match refusal {
                Refusal::Command(CommandError::Unregistered(name)) => {
                    same("unregistered", name, &Stranger::NAME)?;
                    Objection::Malformed("unregistered")
                }
                Refusal::Command(CommandError::Value { .. }) => Objection::Malformed("value"),
                Refusal::Command(CommandError::Event(_)) => Objection::Malformed("event"),
                Refusal::NotOwner(entity) => Objection::NotOwner(*entity),
                Refusal::UnknownEntity(entity) => Objection::UnknownEntity(*entity),
                Refusal::NotDeclared { component, entity } => {
                    Objection::NotDeclared(kind_of(component)?, *entity)
                }
                other => return Err(format!("refused: {other}")),
            },
            other => return Err(format!("rejected: {other}")),
        },
        other => return Err(format!("{other:?}")),
    })
}

fn label(objection: &Objection) -> &'static str {
    match objection {
        Objection::Stranger => "rejected: unknown writer",
        Objection::Stale => "rejected: stale epoch",
        Objection::Malformed(what) => match *what {
            "unregistered" => "rejected: unregistered component",
            "value" => "rejected: not finite",
            _ => "rejected: event not finite",
        },
        Objection::Conflict(..) => "conflict",
        Objection::NotOwner(_) => "rejected: not the owner",
        Objection::UnknownEntity(_) => "rejected: unknown entity",
        Objection::NotDeclared(..) => "rejected: undeclared",
        Objection::UnknownHeir(_) => "rejected: unknown heir",
        Objection::OwnEntity(..) => "rejected: own entity handed over",
        Objection::Unencodable => "rejected: cannot be encoded",
    }
}

/// Plays steps, or makes them up with `author`.
fn play(registry: &Arc<Registry>, steps: &[Step], tally: &mut Tally) -> Result<(), String> {
    let mut bench = Bench::new(registry);
    for (number, step) in steps.iter().enumerate() {
        bench.step(step, tally).map_err(|why| format!("step {number}: {why}"))?;
    }
    bench.finish(registry)
}

fn make_up_and_play(
    registry: &Arc<Registry>,
    seed: u64,
    tally: &mut Tally,
) -> Result<(), (Vec<Step>, String)> {
    let mut random = Random::new(seed);
    let length = 1 + random.below(STEPS_MAX);
    let mut bench = Bench::new(registry);
    let universe = bench.universe.clone();
    let mut steps = Vec::with_capacity(length);
    let outcome = guarded(|| {
        for number in 0..length {
            let step = Author { random: &mut random, universe: &universe }.step(&bench.naive);
            steps.push(step);
            bench.step(&steps[number], tally).map_err(|why| format!("step {number}: {why}"))?;
        }
        bench.finish(registry)
    });
    outcome.unwrap_or_else(Err).map_err(|why| (steps, why))
}

/// The message of a failing seed: what went wrong in the smallest session that goes wrong.
fn story(registry: &Arc<Registry>, seed: u64, steps: Vec<Step>, why: &str) -> String {
    let outcome = |steps: &[Step]| {
        guarded(|| play(registry, steps, &mut Tally::new()))
            .unwrap_or_else(|panic| Err(format!("panicked: {panic}")))
    };
    let steps = minimal(steps, &|steps| outcome(steps).is_err());
    let why = outcome(&steps).err().unwrap_or_else(|| why.to_owned());
    format!("seed {seed} (TROCAR_SEED={seed} plays it again): {why}\nsmallest session:\n{}", listing(&steps))
}

fn number_in(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable}={text} is not a number")))
}

#[test]
fn a_hundred_thousand_random_sessions_agree_with_plain_maps() {
    let seeds = match number_in("TROCAR_SEED") {
        Some(seed) => seed..seed + 1,
        None => {
            0..number_in("TROCAR_SEQUENCES").unwrap_or(if thorough() { 10 * SEQUENCES } else { SEQUENCES })
        }
    };
    let next = AtomicU64::new(seeds.start);
    let (total, failures) = (Mutex::new(Tally::new()), Mutex::new(Vec::new()));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let (registry, mut tally) = (registry(), Tally::new());
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= seeds.end || !failures.lock().expect("no panic").is_empty() {
                        break;
                    }
                    if let Err((steps, why)) = make_up_and_play(&registry, seed, &mut tally) {
                        failures.lock().expect("no panic").push(story(&registry, seed, steps, &why));
                    }
                }
                let mut total = total.lock().expect("no panic");
                for (what, times) in tally {
                    *total.entry(what).or_default() += times;
                }
            });
        }
    });
    let failures = failures.into_inner().expect("no panic");
    assert!(failures.is_empty(), "{}", failures.join("\n"));
    let total = total.into_inner().expect("no panic");
    // A generator that no longer reaches what it is there for would prove nothing.
    let played = seeds.end - seeds.start;
    if played >= SEQUENCES {
        for what in EVERYTHING {
            let times = total.get(what).copied().unwrap_or_default();
            assert!(times * 200 > played, "'{what}' happened {times} times in {played} sessions");
        }
    }
}

const EVERYTHING: [&str; 20] = [
    "applied",
    "conflict",
    "declaration overlaps",
    "declared anew",
    "fence too late",
    "fenced",
    "panicked half applied",
    "panicked untouched",
    "published",
    "rejected: cannot be encoded",
    "rejected: event not finite",
    "rejected: not finite",
    "rejected: not the owner",
    "rejected: own entity handed over",
    "rejected: stale epoch",
    "rejected: undeclared",
    "rejected: unknown entity",
    "rejected: unknown heir",
    "rejected: unknown writer",
    "rejected: unregistered component",
];
