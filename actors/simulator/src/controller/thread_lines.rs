//! The threads of a scene that are stepped as one problem: each an entity of its own, with its own line and anchors; for the
//! solver their nodes follow one after the other.

use std::fmt::Display;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_scene::{Commands, Entity, LineMesh, Snapshot, Tick};

use super::deformable::Deformable;
use super::thread_body::ThreadBody;
use super::thread_memory::ThreadMemory;
use crate::thread::{Thread, ThreadError, ThreadState};

/// The threads, the one that names the others first.
pub struct Lines {
    list: Vec<Deformable>,
    /// Where nodes are held, among those of all.
    anchored: Vec<(usize, Point3<f64>)>,
    /// Whether the scene has their lines already.
    has_lines: bool,
}

impl Lines {
    /// Reads them; `first` is what the scene has of the first one, which `kind` describes.
    ///
    /// # Errors
    /// A mesh that is no thread; a name that is that of none, and which there are; one that is not alike.
    pub fn read(kind: &ThreadBody, first: Deformable, scene: &Snapshot) -> Result<Self, String> {
        let (radius, entity) = (kind.material().radius, first.entity);
        let mut list = vec![one(first, radius)?];
        let carriers = Deformable::carriers::<ThreadBody>(scene);
        for name in &kind.together_with {
            let wrong = |why: &str| format!("together_with: '{name}' {why}");
            let found = carriers.iter().find(|other| scene.name(**other) == *name && **other != entity);
            let Some((other, of)) = found.and_then(|other| Some((*other, scene.get::<ThreadBody>(*other)?)))
            else {
                let others = carriers.iter().filter(|other| **other != entity);
                let names: Vec<String> = others.map(|other| scene.name(*other)).collect();
                return Err(wrong(&format!("is no other thread; valid: {}", names.join(", "))));
            };
            if list.iter().any(|line| line.entity == other) {
                return Err(wrong("is named twice"));
            }
            if of.material() != kind.material() {
                return Err(wrong("is of another material: give both the same suture and parameters"));
            }
            if !of.together_with.is_empty() || of.tied_around.is_some() {
                return Err(wrong(
                    "names others or a body itself: let the first one alone say what goes together",
                ));
            }
            if scene.world_pose(other) != scene.world_pose(entity) {
                return Err(wrong("is at another pose: give both the same, and lay it where it is"));
            }
            let mut line = one(Deformable::read(scene, other).map_err(|error| error.to_string())?, radius)?;
            if scene.get::<ThreadMemory>(entity).is_none()
                && let Some(nodes) = of.nodes().map_err(|why| wrong(&why))?
            {
                line.lie(nodes);
            }
            list.push(line);
        }
        let has_lines = scene.get::<ThreadMemory>(entity).is_some();
        let mut lines = Self { list, anchored: Vec::new(), has_lines };
        if !has_lines && let Some(nodes) = kind.nodes()? {
            lines.list[0].lie(nodes);
        }
        lines.anchor();
        Ok(lines)
    }

    /// The one that names the others.
    #[must_use]
    pub fn first(&self) -> &Deformable {
        &self.list[0]
    }

    /// All of them.
    pub fn entities(&self) -> impl Iterator<Item = Entity> + '_ {
        self.list.iter().map(|line| line.entity)
    }

    /// Nodes that are held, and where \[m\].
    #[must_use]
    pub fn anchored(&self) -> &[(usize, Point3<f64>)] {
        &self.anchored
    }

    /// The solver of what the scene has, from where an earlier life left it.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn thread(&self, kind: &ThreadBody, known: Option<&ThreadMemory>) -> Result<Thread, ThreadError> {
        let Some(memory) = known else {
            let nodes: Vec<&[Point3<f64>]> = self.list.iter().map(|line| &line.positions[..]).collect();
            return Thread::several(kind.material(), &nodes);
        };
        let positions: Vec<Point3<f64>> =
            self.list.iter().flat_map(|line| line.positions.iter().copied()).collect();
        let velocities: Vec<Vector3<f64>> =
            self.list.iter().flat_map(|line| line.velocities.iter().copied()).collect();
        Thread::restore(kind.material(), memory.state(&positions, &velocities))
    }

    /// Nodes at rest of all of them, one after the other \[m\].
    #[must_use]
    pub fn rest(&self) -> Vec<Point3<f64>> {
        self.list.iter().flat_map(|line| line.rest.iter().copied()).collect()
    }

    /// They have other nodes from now on: where these are at rest \[m\].
    pub fn lie(&mut self, rest: &[Point3<f64>], state: &ThreadState) {
        for (line, [first, last]) in self.list.iter_mut().zip(state.threads()) {
            line.lie(rest[first..=last].to_vec());
        }
        self.has_lines = false;
        self.anchor();
    }

    fn anchor(&mut self) {
        self.anchored.clear();
        let mut begin = 0;
        for line in &self.list {
            let held = line.pinned.iter().map(|node| *node as usize);
            self.anchored.extend(held.map(|node| (begin + node, line.rest[node])));
            begin += line.rest.len();
        }
    }

    /// Tells the scene where they are.
    pub fn write(&mut self, state: &ThreadState, out: &mut Commands) {
        if !self.has_lines {
            self.has_lines = true;
            for line in &self.list {
                let segments: Arc<Vec<[u32; 2]>> = line.segments.clone();
                out.put(line.entity, LineMesh { segments, radius: line.radius });
            }
        }
        for (line, [first, last]) in self.list.iter_mut().zip(state.threads()) {
            line.write(&state.positions[first..=last], &state.velocities[first..=last], out);
        }
    }

    /// Tells everybody that they had to be stopped where they are.
    pub fn freeze(&self, reason: &dyn Display, tick: &Tick<'_>, out: &mut Commands) {
        self.list.iter().for_each(|line| line.freeze(reason, tick, out));
    }

    /// The largest tension of each, with its name \[N\].
    pub fn tensions<'a>(&'a self, state: &'a ThreadState) -> impl Iterator<Item = (&'a str, f64)> {
        self.list.iter().zip(state.threads()).map(|(line, [first, last])| {
            let most = state.tensions[first..last].iter().copied().fold(0.0, f64::max);
            (line.name.as_str(), most)
        })
    }
}

/// A line from its first vertex to its last.
fn one(mut line: Deformable, radius: f64) -> Result<Deformable, String> {
    let chain = |(edge, ends): (usize, &[u32; 2])| *ends == [edge as u32, edge as u32 + 1];
    if line.segments.is_empty() || !line.segments.iter().enumerate().all(chain) {
        return Err(
            "its line is not one thread from its first vertex to its last: give it a mesh of a line".into()
        );
    }
    line.radius = radius;
    Ok(line)
}
