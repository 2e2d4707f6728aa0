//! Sketch: few numbers of each body, by which two peers see how far their bodies are apart.
//!
//! Of a chunk of 64 vertices the sketch has four sums of all coordinates with random signs. The mean square of the differences
//! of such sums is, in expectation, the square of the distance between both chunks (Alon, Matias, Szegedy, "The space
//! complexity of approximating the frequency moments", 1996). The signs are others in each sketch, so that no difference hides
//! for ever. What has no distance (what jaws hold, how a mesh hangs together) goes as a hash.
//!
//! Payload, numbers of variable length but for floats (four bytes, little-endian):
//!
//! ```text
//! number of the sketch
//! for each body, or part of it: entity (difference to the one before), hash of what has no distance (4 bytes),
//!     1 + whether it has a pose, which follows (7 floats); number of vertices; if that is not 0: first chunk, chunks, 4 floats each
//! ```

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};
use trocar_scene::{
    Entity, Grasp, LineMesh, Motion, Pose, RigidBody, Snapshot, SurfaceMesh, TetMesh, VertexPositions, varint,
};

use crate::replication::wire_reader::{WireReader, write_entity};
use crate::replication::{ROWS_PAYLOAD_MAX, ReplicationError};

/// Vertices of a chunk.
pub const CHUNK: usize = 64;
/// Sums of a chunk.
pub const SUMS: usize = 4;
/// Most chunks of a part of a body.
const CHUNKS_MAX: usize = 60;
/// Most bytes of one part beside its chunks.
const PART_HEAD_MAX: usize = 10 + 4 + 1 + 28 + 10 + 10 + 10;
const _: () = assert!(10 + PART_HEAD_MAX + CHUNKS_MAX * SUMS * 4 <= ROWS_PAYLOAD_MAX);

/// A body, or some chunks of it.
#[derive(Clone, Debug, PartialEq)]
pub struct BodySketch {
    /// The body.
    pub entity: Entity,
    /// Hash of what it holds, and of how its meshes hang together.
    pub discrete: u32,
    /// Its pose, if it is rigid and moves; single precision.
    pub pose: Option<Isometry3<f64>>,
    /// How many vertices it has.
    pub vertices: u32,
    /// The first chunk of this part.
    pub first: u32,
    /// The sums of its chunks.
    pub chunks: Vec<[f32; SUMS]>,
}

/// How far two sketches of a body, or of the same part of it, are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Apart {
    /// They hold other things, or their meshes hang together otherwise.
    Otherwise,
    /// By so much at most: of a pose \[m\] and \[rad\], of the vertices of a chunk the root of the mean square \[m\].
    By {
        /// Of the pose, or of the worst chunk \[m\].
        distance: f64,
        /// Of the pose \[rad\].
        angle: f64,
    },
}

/// The bodies that are compared, in order: rigid ones that move, those with vertices, and instruments that hold something.
pub fn bodies(scene: &Snapshot) -> Vec<Entity> {
    let rigid = scene.iter::<RigidBody>().filter(|(_, body)| body.motion == Motion::Dynamic);
    let mut bodies: Vec<Entity> = rigid.map(|(entity, _)| entity).collect();
    bodies.extend(scene.iter::<VertexPositions>().map(|(entity, _)| entity));
    bodies.extend(scene.iter::<trocar_scene::Instrument>().map(|(entity, _)| entity));
    bodies.sort_unstable();
    bodies.dedup();
    bodies
}

/// The sketch of this number of a body: its parts, each of which fits into a payload.
pub fn of(scene: &Snapshot, entity: Entity, number: u64) -> Vec<BodySketch> {
    let is_rigid = scene.get::<RigidBody>(entity).is_some_and(|body| body.motion == Motion::Dynamic);
    let pose = is_rigid.then(|| scene.get::<Pose>(entity)).flatten().map(single);
    let discrete = discrete(scene, entity);
    let vertices = scene.get::<VertexPositions>(entity).map_or(&[][..], |vertices| &vertices.positions);
    let whole = BodySketch {
        entity,
        discrete,
        pose,
        vertices: u32::try_from(vertices.len()).unwrap_or(u32::MAX),
        first: 0,
        chunks: Vec::new(),
    };
    let sums: Vec<[f32; SUMS]> =
        vertices.chunks(CHUNK).enumerate().map(|(at, chunk)| sums(chunk, number, at as u64)).collect();
    if sums.is_empty() {
        return vec![whole];
    }
    let part = |(at, chunks): (usize, &[[f32; SUMS]])| BodySketch {
        first: (at * CHUNKS_MAX) as u32,
        chunks: chunks.to_vec(),
        ..whole.clone()
    };
    sums.chunks(CHUNKS_MAX).enumerate().map(part).collect()
}

impl BodySketch {
    /// How far this is from the same part of another body's sketch of the same number.
    pub fn apart(&self, other: &Self) -> Apart {
        let is_same = self.discrete == other.discrete
            && self.vertices == other.vertices
            && self.first == other.first
            && self.chunks.len() == other.chunks.len()
            && self.pose.is_some() == other.pose.is_some();
        if !is_same {
            return Apart::Otherwise;
        }
        let (mut distance, mut angle) = (0.0, 0.0);
        if let (Some(a), Some(b)) = (&self.pose, &other.pose) {
            distance = (a.translation.vector - b.translation.vector).norm();
            angle = a.rotation.angle_to(&b.rotation);
        }
        for (a, b) in self.chunks.iter().zip(&other.chunks) {
            let squares = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
            distance = f64::max(distance, (squares / (SUMS * CHUNK) as f64).sqrt());
        }
        Apart::By { distance, angle }
    }

    fn write(&self, before: &mut u64, out: &mut Vec<u8>) {
        write_entity(self.entity, before, out);
        out.extend_from_slice(&self.discrete.to_le_bytes());
        out.push(1 + u8::from(self.pose.is_some()));
        if let Some(pose) = &self.pose {
            let (place, turn) = (pose.translation.vector, pose.rotation.coords);
            place.iter().chain(turn.iter()).for_each(|x| out.extend_from_slice(&(*x as f32).to_le_bytes()));
        }
        varint::write(u64::from(self.vertices), out);
        if self.vertices > 0 {
            varint::write(u64::from(self.first), out);
            varint::write(self.chunks.len() as u64, out);
            self.chunks.iter().flatten().for_each(|sum| out.extend_from_slice(&sum.to_le_bytes()));
        }
    }

    fn read(reader: &mut WireReader<'_>, before: &mut u64) -> Result<Self, ReplicationError> {
        let entity = reader.entity(before)?;
        let discrete = u32::from_le_bytes(reader.array()?);
        let pose = match reader.byte()? {
            1 => None,
            2 => Some(read_pose(reader)?),
            other => return Err(reader.refuse(u64::from(other), "1 or 2")),
        };
        let vertices = reader.number()?;
        let vertices =
            u32::try_from(vertices).map_err(|_| reader.refuse(vertices, "a number of vertices"))?;
        let mut body = Self { entity, discrete, pose, vertices, first: 0, chunks: Vec::new() };
        if vertices > 0 {
            let (first, count) = (reader.number()?, reader.number()?);
            let all = u64::from(vertices).div_ceil(CHUNK as u64);
            if first.checked_add(count).is_none_or(|end| end > all) || count > CHUNKS_MAX as u64 {
                return Err(reader.refuse(count, "chunks that the body has"));
            }
            body.first = first as u32;
            for _ in 0..count {
                let mut sums = [0.0; SUMS];
                for sum in &mut sums {
                    *sum = f32::from_le_bytes(reader.array()?);
                    if !sum.is_finite() {
                        return Err(reader.refuse(u64::from(sum.to_bits()), "a sum of coordinates"));
                    }
                }
                body.chunks.push(sums);
            }
        }
        Ok(body)
    }
}

/// Payloads with these sketches, of one number.
pub fn write(number: u64, sketches: &[BodySketch]) -> Vec<Vec<u8>> {
    let mut payloads: Vec<Vec<u8>> = Vec::new();
    let mut before = 0;
    for sketch in sketches {
        let room = PART_HEAD_MAX + sketch.chunks.len() * SUMS * 4;
        match payloads.last_mut() {
            Some(payload) if payload.len() + room <= ROWS_PAYLOAD_MAX => sketch.write(&mut before, payload),
            _ => {
                let mut payload = Vec::with_capacity(ROWS_PAYLOAD_MAX);
                varint::write(number, &mut payload);
                before = 0;
                sketch.write(&mut before, &mut payload);
                payloads.push(payload);
            }
        }
    }
    payloads
}

/// The number and the sketches of a payload.
///
/// # Errors
/// When it is malformed.
pub fn read(payload: &[u8]) -> Result<(u64, Vec<BodySketch>), ReplicationError> {
    let mut reader = WireReader::new("a sketch", payload);
    let number = reader.number()?;
    let (mut sketches, mut before) = (Vec::new(), 0);
    while !reader.is_empty() {
        sketches.push(BodySketch::read(&mut reader, &mut before)?);
    }
    Ok((number, sketches))
}

fn read_pose(reader: &mut WireReader<'_>) -> Result<Isometry3<f64>, ReplicationError> {
    let mut numbers = [0.0; 7];
    for number in &mut numbers {
        *number = f64::from(f32::from_le_bytes(reader.array()?));
    }
    let [x, y, z, i, j, k, w] = numbers;
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-3);
    match rotation.filter(|_| numbers.iter().all(|number| number.is_finite())) {
        Some(rotation) => Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation)),
        None => Err(reader.refuse(0, "a pose")),
    }
}

/// A pose as a payload carries it.
fn single(pose: &Pose) -> Isometry3<f64> {
    let pose = pose.isometry();
    let place = pose.translation.vector.map(|x| f64::from(x as f32));
    let turn = pose.rotation.coords.map(|x| f64::from(x as f32));
    Isometry3::from_parts(place.into(), UnitQuaternion::new_normalize(Quaternion::from(turn)))
}

/// The sums of a chunk with the signs of a sketch.
fn sums(chunk: &[Point3<f64>], number: u64, at: u64) -> [f32; SUMS] {
    let mut sums = [0.0; SUMS];
    let mut state = number.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ at.wrapping_mul(0xD1B5_4A32_D192_ED03);
    for vertex in chunk {
        let bits = next(&mut state);
        for (axis, x) in vertex.iter().enumerate() {
            for (of, sum) in sums.iter_mut().enumerate() {
                *sum += if bits >> (axis * SUMS + of) & 1 == 0 { *x } else { -x };
            }
        }
    }
    sums.map(|sum| sum as f32)
}

/// Splitmix64 (Steele, Lea, Flood 2014).
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// What the entity holds, and how its meshes hang together, as a hash.
fn discrete(scene: &Snapshot, entity: Entity) -> u32 {
    let mut hasher = blake3::Hasher::new();
    let mut add = |what: u8, number: u64| {
        hasher.update(&[what]);
        hasher.update(&number.to_le_bytes());
    };
    if let Some(grasp) = scene.get::<Grasp>(entity) {
        add(1, grasp.held.to_bits());
    }
    if let Some(mesh) = scene.get::<SurfaceMesh>(entity) {
        add(2, mesh.triangles.len() as u64);
    }
    if let Some(mesh) = scene.get::<TetMesh>(entity) {
        add(3, mesh.tets.len() as u64);
    }
    if let Some(mesh) = scene.get::<LineMesh>(entity) {
        add(4, mesh.segments.len() as u64);
    }
    let hash = hasher.finalize();
    let [a, b, c, d, ..] = *hash.as_bytes();
    u32::from_le_bytes([a, b, c, d])
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::Vector3;
    use proptest::prelude::*;
    use trocar_scene::{Commands, EntityAllocator, Registry, SimTime, Store};

    use super::*;

    /// A scene with a soft body whose vertices are moved by this, a ring at a place, and an instrument that holds it or nothing.
    fn scene(shift: impl Fn(usize) -> Vector3<f64>, x: f64, holds: bool) -> (Snapshot, [Entity; 3]) {
        let registry = Registry::standard();
        let mut store = Store::new(registry.clone());
        let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
        commands.begin(SimTime::ZERO);
        let [organ, ring, tool] = [commands.spawn(), commands.spawn(), commands.spawn()];
        let vertex = |at: usize| Point3::new(at as f64 * 1e-3, (at % 17) as f64 * 1e-3, 0.02) + shift(at);
        let positions = Arc::new((0..5_000).map(vertex).collect::<Vec<_>>());
        commands.put(organ, VertexPositions { positions });
        commands.put(ring, RigidBody { motion: Motion::Dynamic, ..RigidBody::default() });
        commands.put(ring, Pose::at(x, 0.0, 0.1));
        commands.put(tool, trocar_scene::Instrument::default());
        if holds {
            let (anchor, since) = (Pose::default(), SimTime::ZERO);
            commands.put(tool, Grasp { held: ring, anchor, since, assisted: false });
        }
        commands.seal();
        store.apply(&mut commands, SimTime::ZERO);
        (store.snapshot(), [organ, ring, tool])
    }

    fn all(scene: &Snapshot, number: u64) -> Vec<BodySketch> {
        bodies(scene).into_iter().flat_map(|body| of(scene, body, number)).collect()
    }

    /// The largest distance that sketches of this number find.
    fn distance(a: &Snapshot, b: &Snapshot, number: u64) -> f64 {
        let pairs = all(a, number).into_iter().zip(all(b, number));
        let by = |(a, b): (BodySketch, BodySketch)| match a.apart(&b) {
            Apart::By { distance, .. } => distance,
            Apart::Otherwise => f64::INFINITY,
        };
        pairs.map(by).fold(0.0, f64::max)
    }

    #[test]
    fn sketches_come_back_in_payloads_that_fit_into_datagrams() {
        let (scene, _) = scene(|_| Vector3::zeros(), 0.3, true);
        let sketches = all(&scene, 7);
        assert_eq!(sketches.len(), 4, "the organ's 79 chunks are two parts");
        let payloads = write(7, &sketches);
        assert!(payloads.len() > 1 && payloads.iter().all(|payload| payload.len() <= ROWS_PAYLOAD_MAX));
        let bytes: usize = payloads.iter().map(Vec::len).sum();
        assert!(bytes < 1_500, "{bytes} bytes for 5,000 vertices, a ring and an instrument");
        let mut read_again = Vec::new();
        for payload in &payloads {
            let (number, read) = read(payload).expect("it reads");
            assert_eq!(number, 7);
            read_again.extend(read);
        }
        assert_eq!(read_again.len(), sketches.len());
        for (read, written) in read_again.iter().zip(&sketches) {
            assert!(
                matches!(read.apart(written), Apart::By { distance, angle } if distance < 1e-7 && angle < 1e-3)
            );
        }
    }

    #[test]
    fn a_sketch_tells_how_far_two_livers_are_apart_and_not_whether_they_are_the_same_bits() {
        let (one, _) = scene(|_| Vector3::zeros(), 0.3, true);
        // 10 µm everywhere, as two peers are; 3 mm along z in one chunk.
        let (near, _) = scene(|at| Vector3::new(1e-5 * (at as f64).sin(), 1e-5, 0.0), 0.3 + 1e-5, true);
        let (far, _) = scene(|at| Vector3::z() * if at / 64 == 20 { 3e-3 } else { 0.0 }, 0.3, true);
        let numbers = 0..64;
        let found: Vec<f64> = numbers.clone().map(|number| distance(&one, &near, number)).collect();
        assert!(found.iter().all(|distance| (1e-6..1e-4).contains(distance)), "{found:?}");
        let found: Vec<f64> = numbers.map(|number| distance(&one, &far, number)).collect();
        let seen = found.iter().filter(|distance| **distance > 1e-3).count();
        assert!(seen >= 56, "{seen} of 64 sketches find it");
        let mean_square = found.iter().map(|distance| distance * distance).sum::<f64>() / 64.0;
        assert!((mean_square.sqrt() / 3e-3 - 1.0).abs() < 0.25, "{}", mean_square.sqrt());
    }

    #[test]
    fn what_has_no_distance_differs_otherwise() {
        let (one, [_, ring, tool]) = scene(|_| Vector3::zeros(), 0.3, true);
        let (other, _) = scene(|_| Vector3::zeros(), 0.35, false);
        let apart = |body: Entity| of(&one, body, 1)[0].apart(&of(&other, body, 1)[0]);
        assert_eq!(apart(tool), Apart::Otherwise);
        assert!(matches!(apart(ring), Apart::By { distance, .. } if (distance - 0.05).abs() < 1e-6));
    }

    proptest! {
        #[test]
        fn any_bytes_are_sketches_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            let _ = read(&bytes);
        }

        #[test]
        fn a_flipped_bit_never_panics(at in any::<prop::sample::Index>(), bit in 0..8_u8) {
            let (scene, _) = scene(|_| Vector3::zeros(), 0.3, true);
            let mut payload = write(7, &all(&scene, 7)).remove(0);
            let at = at.index(payload.len());
            payload[at] ^= 1 << bit;
            let _ = read(&payload);
        }
    }
}
