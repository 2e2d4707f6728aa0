//! Threads that are stepped as one problem: each is an entity with its own line and anchors; in the solver their nodes
//! are concatenated.

use std::fmt::Display;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_dynamics::soft_body::Deformable;
use trocar_scene::{Commands, Entity, LineMesh, Snapshot, Tick};

use super::component::ThreadBody;
use super::grasp::GraspConstraints;
use super::saved_state::ThreadMemory;
use crate::suture_thread::bishop_frame::transport;
use crate::suture_thread::{CutNumbering, Hold, Thread, ThreadError, ThreadState, TwistHold};

/// An anchored node: the anchor holds its place, and keeps the thread from turning about its own axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnchoredNode {
    /// The node, in concatenated numbers.
    pub node: usize,
    /// Its place \[m\].
    pub place: Point3<f64>,
    /// Direction of the edge at it, and its director, when they were last known untwisted against the anchor.
    reference: Option<[Vector3<f64>; 2]>,
}

/// The threads; first the one that names the others.
pub struct ThreadGroup {
    list: Vec<Deformable>,
    anchored: Vec<AnchoredNode>,
    /// Whether the scene already has their lines.
    has_lines: bool,
}

impl ThreadGroup {
    /// Reads them; `first` is the body of the first thread, with the component `kind`.
    ///
    /// # Errors
    /// A mesh that is not a thread; a name of no thread (the message lists the existing ones); a thread with different
    /// properties.
    pub fn read(kind: &ThreadBody, first: Deformable, scene: &Snapshot) -> Result<Self, String> {
        let (radius, entity) = (kind.material().radius, first.entity);
        let has_lines = scene.get::<ThreadMemory>(entity).is_some();
        let mut list = vec![one(first, radius, has_lines, kind.closed)?];
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
            if of.closed {
                return Err(wrong("is closed, and such a thread is stepped by itself"));
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
            let line = Deformable::read(scene, other).map_err(|error| error.to_string())?;
            let mut line = one(line, radius, has_lines, false)?;
            if !has_lines && let Some(nodes) = of.nodes().map_err(|why| wrong(&why))? {
                line.replace_line(nodes);
            }
            list.push(line);
        }
        let mut lines = Self { list, anchored: Vec::new(), has_lines };
        if !has_lines && let Some(nodes) = kind.nodes()? {
            lines.list[0].replace_line(nodes);
        }
        if !has_lines && kind.closed {
            close(&mut lines.list[0]);
        }
        lines.anchor();
        if let Some(memory) = scene.get::<ThreadMemory>(entity) {
            let known = lines.anchored.iter_mut().zip(&memory.anchors);
            known.for_each(|(anchored, known)| anchored.reference = *known);
        }
        Ok(lines)
    }

    /// The thread that names the others.
    #[must_use]
    pub fn first(&self) -> &Deformable {
        &self.list[0]
    }

    /// All of them.
    pub fn entities(&self) -> impl Iterator<Item = Entity> + '_ {
        self.list.iter().map(|line| line.entity)
    }

    /// Anchored nodes.
    #[must_use]
    pub fn anchored(&self) -> &[AnchoredNode] {
        &self.anchored
    }

    /// Adds what the anchors hold to the constraints. A thread may swing about its anchor, but it does not roll there.
    pub fn hold(&mut self, state: &ThreadState, constraints: &mut GraspConstraints) {
        for anchored in &mut self.anchored {
            constraints.holds.push(Hold::fixed(anchored.node, anchored.place));
            let Some(edge) = edge_at(anchored.node, state) else { continue };
            let tangent = state.positions[state.after(edge)] - state.positions[edge];
            let Some(tangent) = tangent.try_normalize(0.0) else { continue };
            let [from, director] = *anchored.reference.get_or_insert([tangent, state.directors[edge]]);
            constraints.twist_holds.push(TwistHold { edge, director: transport(&from, &tangent, &director) });
        }
    }

    /// What a restart needs to know of the anchors.
    pub fn save_anchors(&self, memory: &mut ThreadMemory) {
        memory.anchors.clear();
        memory.anchors.extend(self.anchored.iter().map(|anchored| anchored.reference));
    }

    /// Builds the solver, and resumes its state from the scene.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn thread(&self, kind: &ThreadBody, known: Option<&ThreadMemory>) -> Result<Thread, ThreadError> {
        let Some(memory) = known else {
            if kind.closed {
                return Thread::closed(kind.material(), &self.list[0].positions);
            }
            let nodes: Vec<&[Point3<f64>]> = self.list.iter().map(|line| &line.positions[..]).collect();
            return Thread::several(kind.material(), &nodes);
        };
        let positions: Vec<Point3<f64>> =
            self.list.iter().flat_map(|line| line.positions.iter().copied()).collect();
        let velocities: Vec<Vector3<f64>> =
            self.list.iter().flat_map(|line| line.velocities.iter().copied()).collect();
        Thread::restore(kind.material(), memory.state(&positions, &velocities))
    }

    /// Rest positions of all nodes, concatenated \[m\].
    #[must_use]
    pub fn rest(&self) -> Vec<Point3<f64>> {
        self.list.iter().flat_map(|line| line.rest.iter().copied()).collect()
    }

    /// Replaces their nodes: new rest positions \[m\], and the new number of each former node, unless it was removed;
    /// the last node of each line is never removed, unless it is the only one.
    pub fn replace_line(&mut self, rest: &[Point3<f64>], now: &[Option<u32>], state: &ThreadState) {
        let (mut begin, mut from) = (0, 0);
        // The nodes of a closed thread that was cut are numbered from the cut.
        let is_alone = self.list.len() == 1;
        for line in &mut self.list {
            begin += line.rest.len();
            let last = now.get(begin - 1).copied().flatten();
            let end = if is_alone { rest.len() } else { last.map_or(from, |node| node as usize + 1) };
            line.replace_line(rest[from..end].to_vec());
            let joins = |[node, _]: &[u32; 2]| state.joins(from + *node as usize);
            Arc::make_mut(&mut line.segments).retain(joins);
            from = end;
        }
        self.has_lines = false;
        let former = std::mem::take(&mut self.anchored);
        self.anchor();
        for anchored in &mut self.anchored {
            let was = |former: &&AnchoredNode| now.get(former.node) == Some(&Some(anchored.node as u32));
            anchored.reference = former.iter().find(was).and_then(|former| former.reference);
        }
    }

    /// Cuts them.
    pub fn part(&mut self, parted: &CutNumbering, state: &ThreadState) {
        self.replace_line(&parted.places(&self.rest()), &parted.nodes, state);
    }

    /// Each thread with its first and last node, in concatenated numbers.
    fn spans(&self) -> impl Iterator<Item = (&Deformable, [usize; 2])> {
        self.list.iter().scan(0, |begin, line| {
            let first = *begin;
            *begin += line.rest.len();
            Some((line, [first, *begin - 1]))
        })
    }

    fn anchor(&mut self) {
        self.anchored.clear();
        let mut begin = 0;
        for line in &self.list {
            let held = line.pinned.iter().map(|node| *node as usize);
            self.anchored.extend(held.map(|node| AnchoredNode {
                node: begin + node,
                place: line.rest[node],
                reference: None,
            }));
            begin += line.rest.len();
        }
    }

    /// Writes their state to the scene.
    pub fn write(&mut self, state: &ThreadState, out: &mut Commands) {
        if !self.has_lines {
            self.has_lines = true;
            for line in &self.list {
                let segments: Arc<Vec<[u32; 2]>> = line.segments.clone();
                out.put(line.entity, LineMesh { segments, radius: line.radius });
            }
        }
        let mut first = 0;
        for line in &mut self.list {
            let end = first + line.rest.len();
            line.write(&state.positions[first..end], &state.velocities[first..end], out);
            first = end;
        }
    }

    /// Reports that they had to be frozen.
    pub fn freeze(&self, reason: &dyn Display, tick: &Tick<'_>, out: &mut Commands) {
        self.list.iter().for_each(|line| line.freeze(reason, tick, out));
    }

    /// Maximum tension of each thread, with its name \[N\].
    pub fn tensions<'a>(&'a self, state: &'a ThreadState) -> impl Iterator<Item = (&'a str, f64)> {
        self.spans().map(|(line, [first, last])| {
            let edges = if state.is_closed() { first..last + 1 } else { first..last };
            let most = state.tensions[edges].iter().copied().fold(0.0, f64::max);
            (line.name.as_str(), most)
        })
    }
}

/// The edge whose rotation an anchor of this node holds: the one after it, or the last one before it.
fn edge_at(node: usize, state: &ThreadState) -> Option<usize> {
    [Some(node), state.before(node)].into_iter().flatten().find(|edge| state.joins(*edge))
}

/// Adds the edge from the last vertex to the first.
fn close(line: &mut Deformable) {
    let last = line.rest.len().saturating_sub(1) as u32;
    let segments = Arc::make_mut(&mut line.segments);
    if segments.last() != Some(&[last, 0]) {
        segments.push([last, 0]);
    }
}

/// A line from its first vertex to its last; with `goes_on` it may have been cut. Of a closed thread the edge from the last
/// vertex to the first may be among its edges.
fn one(mut line: Deformable, radius: f64, goes_on: bool, is_closed: bool) -> Result<Deformable, String> {
    let last = line.rest.len().saturating_sub(1) as u32;
    let seam = is_closed && line.segments.last() == Some(&[last, 0]);
    let open = &line.segments[..line.segments.len() - usize::from(seam)];
    let is_edge = |ends: &[u32; 2]| ends[1] == ends[0] + 1;
    let follows = |pair: &[[u32; 2]]| pair[1][0] == pair[0][1] || (goes_on && pair[1][0] == pair[0][1] + 1);
    let is_thread = open.first().is_some_and(|ends| ends[0] == 0)
        && open.iter().all(is_edge)
        && open.windows(2).all(follows);
    if !is_thread {
        return Err(
            "its line is not one thread from its first vertex to its last: give it a mesh of a line".into()
        );
    }
    line.radius = radius;
    Ok(line)
}
