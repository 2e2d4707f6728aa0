//! Plays a recording back into a Model: the same batches in the same order, checked against the recorded
//! state hashes.

use std::iter::Peekable;
use std::sync::Arc;

use trocar_scene::{Commands, ComponentError, EntityAllocator, Registry, SimTime, Snapshot};

use super::error::RecordingError;
use super::recording::Recording;
use crate::model_core::ModelCore;
use crate::recorder::format::{Gap, Group};
use crate::recorder::reading::chunk_items::{Item, Keyframe};
use crate::state_hash::StateHash;

type Items<'a> = Box<dyn Iterator<Item = Result<Item, RecordingError>> + 'a>;

/// A recording being played back.
pub struct Replay<'a> {
    recording: &'a Recording,
    registry: Arc<Registry>,
    items: Peekable<Items<'a>>,
    core: ModelCore,
    /// The Model's hash at the end of the last block or keyframe.
    state_hash: StateHash,
    commands: Commands,
    time: SimTime,
    gaps: Vec<Gap>,
    damage: Vec<String>,
    /// The block being played, and the next of its commits.
    block: Option<(Group, usize)>,
    /// Whether the next keyframe replaces the scene instead of checking it; hashes are not checked until then.
    fresh: bool,
}

impl<'a> Replay<'a> {
    /// A replay from the beginning.
    ///
    /// # Errors
    /// [`RecordingError`]; a recording without a keyframe has nothing to play.
    pub fn new(recording: &'a Recording, registry: &Arc<Registry>) -> Result<Self, RecordingError> {
        Self::from_items(recording, registry, Box::new(recording.items()))
    }

    /// A replay from the last keyframe at or before `time`; [`Self::advance_to`] plays the rest.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn seek(
        recording: &'a Recording,
        registry: &Arc<Registry>,
        time: SimTime,
    ) -> Result<Self, RecordingError> {
        // Items before the first keyframe of that chunk belong to an earlier keyframe.
        let items = recording.seek(time)?.skip_while(|item| !matches!(item, Ok(Item::Keyframe(_)) | Err(_)));
        Self::from_items(recording, registry, Box::new(items))
    }

    fn from_items(
        recording: &'a Recording,
        registry: &Arc<Registry>,
        mut items: Items<'a>,
    ) -> Result<Self, RecordingError> {
        recording.check_components(registry)?;
        let mut damage: Vec<String> = recording.damage().collect();
        let first = loop {
            match items.next().transpose()? {
                Some(Item::Keyframe(keyframe)) => break keyframe,
                Some(Item::Damage(what)) => damage.push(what),
                Some(_) => {}
                None => {
                    return Err(RecordingError::NotARecording {
                        file: recording.path().to_owned(),
                        what: "it has no keyframe".to_owned(),
                    });
                }
            }
        };
        Ok(Self {
            core: load(recording, registry, &first)?,
            state_hash: first.state_hash,
            commands: Commands::new(registry.clone(), EntityAllocator::new(0, 0)),
            registry: registry.clone(),
            recording,
            items: items.peekable(),
            time: first.time,
            gaps: Vec::new(),
            damage,
            block: None,
            fresh: false,
        })
    }

    /// Plays the commits of the next instant and returns its time; `None` at the end.
    ///
    /// # Errors
    /// [`RecordingError::Diverged`] when the scene differs from the recorded one, and others for a file that cannot be
    /// read.
    pub fn step(&mut self) -> Result<Option<SimTime>, RecordingError> {
        loop {
            if let Some((group, next)) = self.block.take() {
                let next = self.apply(&group, next)?;
                if next < group.len() {
                    self.block = Some((group, next));
                    return Ok(Some(self.time));
                }
                self.state_hash = group.state_hash();
                if self.fresh {
                    self.core.continue_chain(group.hash());
                } else {
                    self.check(group.hash())?;
                }
                return Ok(Some(self.time));
            }
            match self.items.next().transpose()? {
                None => return Ok(None),
                Some(Item::Gap(gap)) => {
                    self.gaps.push(gap);
                    self.fresh = true;
                }
                Some(Item::Damage(what)) => {
                    if !self.damage.contains(&what) {
                        self.damage.push(what);
                    }
                    self.fresh = true;
                }
                Some(Item::Keyframe(keyframe)) if self.fresh => {
                    self.core = load(self.recording, &self.registry, &keyframe)?;
                    self.state_hash = keyframe.state_hash;
                    self.time = keyframe.time;
                    self.fresh = false;
                }
                Some(Item::Keyframe(keyframe)) => self.check(keyframe.hash)?,
                Some(Item::Commits(group)) if group.is_empty() => {}
                Some(Item::Commits(group)) => self.block = Some((group, 0)),
            }
        }
    }

    /// Plays everything up to `time`.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn advance_to(&mut self, time: SimTime) -> Result<(), RecordingError> {
        loop {
            let next = match (&self.block, self.items.peek()) {
                (Some((group, next)), _) => group.get(*next).map(|commit| commit.provenance.time),
                (None, None) => return Ok(()),
                (None, Some(Ok(Item::Commits(group)))) => group.get(0).map(|commit| commit.provenance.time),
                (None, Some(Ok(Item::Keyframe(keyframe)))) => Some(keyframe.time),
                (None, Some(Ok(Item::Gap(gap)))) => Some(gap.time),
                (None, Some(_)) => None,
            };
            if next.is_some_and(|next| next > time) || self.step()?.is_none() {
                return Ok(());
            }
        }
    }

    /// Plays the rest, and returns the final state hash.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn run_to_end(&mut self) -> Result<StateHash, RecordingError> {
        while self.step()?.is_some() {}
        Ok(self.core.hash())
    }

    /// The current scene.
    pub fn view(&self) -> &Snapshot {
        self.core.view()
    }
    /// A snapshot of the current scene.
    pub fn snapshot(&mut self) -> Arc<Snapshot> {
        self.core.publish()
    }
    /// The Model's hash as it was recorded, at the end of the last block.
    pub fn state_hash(&self) -> StateHash {
        self.state_hash
    }
    /// The hash of what is stored so far.
    pub fn hash(&self) -> StateHash {
        self.core.hash()
    }
    /// Time of the last batch.
    pub fn time(&self) -> SimTime {
        self.time
    }
    /// Damaged parts so far, and those outside the chunks.
    pub fn damage(&self) -> &[String] {
        &self.damage
    }
    /// Gaps so far.
    pub fn gaps(&self) -> &[Gap] {
        &self.gaps
    }

    /// Applies the commits of one time from number `next` on, and returns the number of the first one after them.
    fn apply(&mut self, group: &Group, mut next: usize) -> Result<usize, RecordingError> {
        let time = group.get(next).map(|commit| commit.provenance.time);
        while let Some(commit) = group.get(next).filter(|commit| Some(commit.provenance.time) == time) {
            let wrong = |error: &ComponentError| self.recording.undecodable(commit.revision.0, error);
            self.commands.clear();
            let rest = self.commands.decode(commit.payload).map_err(|error| wrong(&error))?;
            if !rest.is_empty() {
                return Err(wrong(&ComponentError::Malformed(format!("{} bytes too many", rest.len()))));
            }
            self.commands.seal();
            self.core
                .replay(commit.kind, commit.revision, commit.writer, commit.provenance, &mut self.commands)
                .map_err(|error| wrong(&error))?;
            self.time = self.time.max(commit.provenance.time);
            next += 1;
        }
        Ok(next)
    }

    fn check(&self, recorded: StateHash) -> Result<(), RecordingError> {
        let found = self.core.hash();
        if found == recorded {
            return Ok(());
        }
        Err(RecordingError::Diverged {
            file: self.recording.path().to_owned(),
            revision: self.core.view().revision().0,
            found,
            recorded,
        })
    }
}

fn load(
    recording: &Recording,
    registry: &Arc<Registry>,
    keyframe: &Keyframe,
) -> Result<ModelCore, RecordingError> {
    let wrong = |error: ComponentError| recording.damaged(keyframe.offset(), format!("keyframe: {error}"));
    let store = keyframe.load(registry).map_err(wrong)?;
    let core = ModelCore::new(store, recording.metadata().station).map_err(wrong)?;
    Ok(core.with_chain(keyframe.hash))
}
