//! Positions on a grid, and vertices in chunks of 64.
//!
//! The grid is the same everywhere, with a step that is a power of two: rounding twice is rounding once, and whole
//! numbers can be compared between stations. A chunk states the corner of the box around its points, and each point in
//! as many bits as the box needs along each axis: 17 bits for an organ of half a metre, 14 for neighbours in a box of
//! 6 cm. Only those vertices of a chunk are sent that have changed.

use nalgebra::{Point3, Vector3};
use trocar_scene::varint;

use super::ReplicationError;
use super::wire_reader::WireReader;

/// Step of a pose's position \[m\]: 0.95 µm, so that the error along an axis is below 0.48 µm.
pub const POSE_STEP: f64 = 1.0 / (1 << 20) as f64;
/// Step of vertices \[m\]: 3.8 µm. A vertex is off by at most 1.91 µm along an axis and 3.31 µm altogether.
pub const VERTEX_STEP: f64 = 1.0 / (1 << 18) as f64;
/// Vertices of a chunk.
pub const CHUNK_VERTICES: usize = 64;
/// Most vertices of a body that travels in chunks; bodies with more travel reliably.
pub const VERTICES_MAX: usize = 1 << 20;
/// Most bytes of an encoded chunk: head, mask, corner, and 64 points of 3 × 32 bits.
pub const CHUNK_BYTES_MAX: usize = 3 + 3 + 10 + 1 + 8 + 15 + 3 + CHUNK_VERTICES * 12;

/// A point in steps of [`VERTEX_STEP`].
pub type GridPoint = [i32; 3];

/// A position in whole steps; `None` beyond what a float can tell apart.
pub fn to_grid(position: &Vector3<f64>, step: f64) -> Option<[i64; 3]> {
    const FAR: f64 = (1_u64 << 52) as f64;
    let steps = position / step;
    let fits = steps.iter().all(|steps| steps.abs() < FAR);
    fits.then(|| [steps.x.round() as i64, steps.y.round() as i64, steps.z.round() as i64])
}

/// The position of whole steps.
pub fn from_grid(steps: [i64; 3], step: f64) -> Vector3<f64> {
    Vector3::from(steps.map(|steps| steps as f64 * step))
}

/// A vertex in whole steps; `None` when it is more than 8,191 m away.
pub fn vertex_to_grid(vertex: &Point3<f64>) -> Option<GridPoint> {
    let [x, y, z] = to_grid(&vertex.coords, VERTEX_STEP)?.map(|steps| i32::try_from(steps).ok());
    Some([x?, y?, z?])
}

/// The vertex of whole steps.
pub fn vertex_from_grid(point: GridPoint) -> Point3<f64> {
    Point3::from(from_grid(point.map(i64::from), VERTEX_STEP))
}

/// How many chunks so many vertices make.
pub fn chunk_count(vertices: usize) -> usize {
    vertices.div_ceil(CHUNK_VERTICES)
}

/// The vertices of a chunk.
pub fn chunk_range(chunk: usize, vertices: usize) -> std::ops::Range<usize> {
    let begin = (chunk * CHUNK_VERTICES).min(vertices);
    begin..(begin + CHUNK_VERTICES).min(vertices)
}

/// Appends those points of a chunk whose bit in the head's mask is set.
///
/// Layout: number of vertices of the body, number of the chunk, over how many revisions it goes; 0 for all points or 1
/// and a mask of eight bytes; the corner, three numbers with a sign; three bytes, how many bits a point takes along each
/// axis; the points above the corner, bit by bit.
pub fn write_chunk(head: &ChunkHead, points: &[GridPoint], out: &mut Vec<u8>) {
    varint::write(head.vertices as u64, out);
    varint::write(head.chunk as u64, out);
    varint::write(head.over, out);
    let all = full_mask(points.len());
    let mask = head.mask & all;
    out.push(u8::from(mask != all));
    if mask != all {
        out.extend_from_slice(&mask.to_le_bytes());
    }
    let chosen = || points.iter().enumerate().filter(|(k, _)| mask >> k & 1 == 1).map(|(_, point)| point);
    let (mut corner, mut far) = ([i32::MAX; 3], [i32::MIN; 3]);
    for point in chosen() {
        for axis in 0..3 {
            corner[axis] = corner[axis].min(point[axis]);
            far[axis] = far[axis].max(point[axis]);
        }
    }
    let bits: [u32; 3] = std::array::from_fn(|axis| match far[axis] >= corner[axis] {
        true => 32 - far[axis].wrapping_sub(corner[axis]).cast_unsigned().leading_zeros(),
        false => 0,
    });
    corner.iter().for_each(|steps| varint::write(varint::zigzag(i64::from(*steps)), out));
    out.extend(bits.map(|bits| bits as u8));
    let (mut waiting, mut held) = (0_u64, 0);
    for point in chosen() {
        for axis in 0..3 {
            let above = point[axis].wrapping_sub(corner[axis]).cast_unsigned();
            waiting |= u64::from(above) << held;
            held += bits[axis];
            while held >= 8 {
                out.push(waiting as u8);
                waiting >>= 8;
                held -= 8;
            }
        }
    }
    if held > 0 {
        out.push(waiting as u8);
    }
}

/// The head of a chunk, before its points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChunkHead {
    /// How many vertices the body has.
    pub vertices: usize,
    /// Which chunk of it.
    pub chunk: usize,
    /// The points are those that changed within so many revisions: whoever has the chunk as it was then has it as it is.
    pub over: u64,
    /// Which of its vertices follow.
    pub mask: u64,
}

impl ChunkHead {
    pub(super) fn read(reader: &mut WireReader<'_>) -> Result<Self, ReplicationError> {
        let count = reader.number()?;
        let vertices = usize::try_from(count).ok().filter(|count| *count <= VERTICES_MAX);
        let Some(vertices) = vertices else {
            return Err(reader.refuse(count, "a number of vertices up to 1,048,576"));
        };
        let number = reader.number()?;
        let chunk = usize::try_from(number).ok().filter(|chunk| *chunk < chunk_count(vertices));
        let Some(chunk) = chunk else {
            return Err(reader.refuse(number, "a chunk of the body"));
        };
        let over = reader.number()?;
        let all = full_mask(chunk_range(chunk, vertices).len());
        let mask = match reader.byte()? {
            0 => all,
            1 => reader.word()?,
            other => return Err(reader.refuse(u64::from(other), "0 for all vertices or 1 for a mask")),
        };
        if mask & !all != 0 {
            return Err(reader.refuse(mask, "a mask of the chunk's vertices"));
        }
        Ok(Self { vertices, chunk, over, mask })
    }

    /// The points, each with its number in the body; the chunk must end with them.
    pub(super) fn read_points(
        &self,
        reader: &mut WireReader<'_>,
        mut visit: impl FnMut(usize, GridPoint),
    ) -> Result<(), ReplicationError> {
        let mut corner = [0; 3];
        for corner in &mut corner {
            let steps = reader.signed()?;
            *corner = i32::try_from(steps)
                .map_err(|_| reader.refuse(steps.cast_unsigned(), "a place within 8,191 m"))?;
        }
        let mut bits = [0; 3];
        for bits in &mut bits {
            let count = reader.byte()?;
            if count > 32 {
                return Err(reader.refuse(u64::from(count), "up to 32 bits"));
            }
            *bits = u32::from(count);
        }
        let begin = self.chunk * CHUNK_VERTICES;
        let (mut waiting, mut held) = (0_u64, 0);
        for k in (0..CHUNK_VERTICES).filter(|k| self.mask >> k & 1 == 1) {
            let mut point = [0; 3];
            for axis in 0..3 {
                while held < bits[axis] {
                    waiting |= u64::from(reader.byte()?) << held;
                    held += 8;
                }
                let above = (waiting & ((1_u64 << bits[axis]) - 1)) as u32;
                waiting >>= bits[axis];
                held -= bits[axis];
                point[axis] = corner[axis].wrapping_add(above.cast_signed());
            }
            visit(begin + k, point);
        }
        if reader.is_empty() { Ok(()) } else { Err(reader.refuse(0, "the end of the chunk")) }
    }
}

/// A mask with one bit for each of so many vertices, 64 at most.
pub fn full_mask(vertices: usize) -> u64 {
    if vertices >= CHUNK_VERTICES { u64::MAX } else { (1 << vertices) - 1 }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use trocar_scene::random::SplitMix64;

    use super::*;

    fn read(bytes: &[u8]) -> Result<(ChunkHead, Vec<(usize, GridPoint)>), ReplicationError> {
        let mut reader = WireReader::new("chunk", bytes);
        let head = ChunkHead::read(&mut reader)?;
        let mut points = Vec::new();
        head.read_points(&mut reader, |vertex, point| points.push((vertex, point)))?;
        Ok((head, points))
    }

    #[test]
    fn vertices_of_an_organ_are_off_by_less_than_five_micrometres() {
        let mut random = SplitMix64::new(5);
        let mut worst = 0.0_f64;
        for _ in 0..100_000 {
            let vertex = Point3::from([(); 3].map(|()| 0.3 * random.unit() - 0.15));
            let point = vertex_to_grid(&vertex).expect("it is near");
            assert_eq!(
                vertex_to_grid(&vertex_from_grid(point)),
                Some(point),
                "rounding twice is rounding once"
            );
            worst = worst.max((vertex_from_grid(point) - vertex).norm());
        }
        assert!(worst < 3.31e-6 && worst > 2.5e-6, "{worst}");
        let far = Point3::new(9e3, 0.0, 0.0);
        assert_eq!(vertex_to_grid(&far), None);
        assert_eq!(
            to_grid(&far.coords, POSE_STEP).map(|steps| from_grid(steps, POSE_STEP)),
            Some(far.coords)
        );
        assert_eq!(to_grid(&Vector3::new(1e30, 0.0, 0.0), POSE_STEP), None);
    }

    #[test]
    fn a_chunk_of_neighbours_takes_a_fifth_of_its_floats() {
        let mut random = SplitMix64::new(6);
        let points: Vec<GridPoint> = (0..CHUNK_VERTICES)
            .map(|_| Point3::from([(); 3].map(|()| 0.1 + 0.06 * random.unit())))
            .map(|vertex| vertex_to_grid(&vertex).expect("it is near"))
            .collect();
        let mut out = Vec::new();
        let head = ChunkHead { vertices: 5_000, chunk: 7, over: 9, mask: u64::MAX };
        write_chunk(&head, &points, &mut out);
        assert!(out.len() <= 360 && out.len() * 4 < CHUNK_VERTICES * 24, "{}", out.len());
        out.clear();
        write_chunk(&ChunkHead { mask: 0b1001, ..head }, &points, &mut out);
        assert!(out.len() < 45, "{}", out.len());
        assert_eq!(read(&out).expect("it reads").1, [(448, points[0]), (451, points[3])]);
    }

    proptest! {
        #[test]
        fn chunks_come_back_to_the_last_bit(
            points in prop::collection::vec(prop::array::uniform3(any::<i32>()), 1..=64),
            mask in any::<u64>(),
            before in 0_usize..20,
            over in any::<u64>(),
        ) {
            let vertices = before * CHUNK_VERTICES + points.len();
            let mut out = Vec::new();
            write_chunk(&ChunkHead { vertices, chunk: before, over, mask }, &points, &mut out);
            prop_assert!(out.len() <= CHUNK_BYTES_MAX);
            let (head, found) = read(&out).expect("it reads");
            prop_assert_eq!((head.vertices, head.chunk, head.over), (vertices, before, over));
            let mask = mask & full_mask(points.len());
            let wanted: Vec<(usize, GridPoint)> = (0..points.len())
                .filter(|k| mask >> k & 1 == 1)
                .map(|k| (before * CHUNK_VERTICES + k, points[k]))
                .collect();
            prop_assert_eq!(found, wanted);
        }

        #[test]
        fn arbitrary_bytes_name_only_vertices_of_the_chunk(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            if let Ok((head, points)) = read(&bytes) {
                prop_assert!(points.iter().all(|(vertex, _)| *vertex < head.vertices));
            }
        }
    }
}
