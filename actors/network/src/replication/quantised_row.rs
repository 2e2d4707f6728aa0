//! A row as it travels in a datagram: rounded, and in few bytes.
//!
//! The first byte tells the form: 0 the value to its last bit as postcard writes it, 1 a pose on its grid, 2 any value
//! whose numbers with a fraction are multiples of a step. Rounding twice is rounding once, so the form is a value's
//! identity too: [`super::StateDigest`] compares it between stations. A value that rounding would make invalid, for
//! instance a small radius that must not be zero, travels to its last bit.

use trocar_scene::{
    Commands, ComponentError, ComponentId, Entity, EntityAllocator, LeafKind, LeafRun, Leaves, Pose,
    Registry, Snapshot, VertexPositions, varint,
};

use super::ReplicationError;
use super::choice::{ReplicatedColumns, RowCodec};
use super::positions::{POSE_STEP, from_grid, to_grid, vertex_to_grid};
use super::rotation::{SmallestThree, quantise};
use super::wire_reader::WireReader;

const EXACT: u8 = 0;
const POSE: u8 = 1;
const GRID: u8 = 2;

/// Largest magnitude of a number in steps: whole numbers that a float holds exactly.
const STEPS_MAX: f64 = (1_u64 << 52) as f64;

/// Quantises rows and reads them back; its buffers are reused.
pub struct RowQuantiser {
    leaves: Leaves,
    postcard: Vec<u8>,
    /// Takes rounded values on trial.
    trial: Commands,
}

impl RowQuantiser {
    /// Empty buffers for rows of these components.
    pub fn new(registry: &std::sync::Arc<Registry>) -> Self {
        let trial = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        Self { leaves: Leaves::default(), postcard: Vec::new(), trial }
    }

    /// Appends the quantised form of a row; `Ok(false)` when there is no such row. Vertices are written in whole here;
    /// datagrams take them in chunks.
    ///
    /// # Errors
    /// When the value cannot be encoded.
    pub fn write(
        &mut self,
        scene: &Snapshot,
        columns: &ReplicatedColumns,
        id: ComponentId,
        entity: Entity,
        out: &mut Vec<u8>,
    ) -> Result<bool, ComponentError> {
        let begin = out.len();
        if columns.is_unreliable(id) {
            let quantised = match columns.codec(id) {
                RowCodec::Pose => write_pose(scene, entity, out),
                RowCodec::Vertices => write_vertices(scene, entity, out),
                RowCodec::Grid { step } => self.write_grid(scene, id, entity, step, out)?,
                RowCodec::Exact => false,
            };
            if quantised {
                return Ok(true);
            }
        }
        out.truncate(begin);
        out.push(EXACT);
        let found = scene.erased_column(id).encode_row(entity, out)?;
        if !found {
            out.truncate(begin);
        }
        Ok(found)
    }

    fn write_grid(
        &mut self,
        scene: &Snapshot,
        id: ComponentId,
        entity: Entity,
        step: f64,
        out: &mut Vec<u8>,
    ) -> Result<bool, ComponentError> {
        if !scene.erased_column(id).leaves(entity, &mut self.leaves)? {
            return Ok(false);
        }
        self.leaves.round(step);
        self.postcard.clear();
        self.leaves.encode(&mut self.postcard);
        let trial = scene.registry().put_postcard(id, &mut self.trial, entity, &self.postcard);
        let is_valid = matches!(trial, Ok([]));
        self.trial.clear();
        Ok(is_valid && write_leaves(&self.leaves, step, out))
    }

    /// Puts a row of a datagram, but for vertices, into `commands`.
    ///
    /// # Errors
    /// When the bytes are malformed, or the value is refused by its component's check.
    pub fn read(
        &mut self,
        bytes: &[u8],
        columns: &ReplicatedColumns,
        id: ComponentId,
        entity: Entity,
        commands: &mut Commands,
    ) -> Result<(), ReplicationError> {
        let registry = columns.registry();
        let component = registry.entry(id).name;
        let mut reader = WireReader::new("a row", bytes);
        let form = reader.byte()?;
        match (form, columns.codec(id)) {
            (EXACT, _) => {
                self.postcard.clear();
                self.postcard.extend_from_slice(reader.rest());
            }
            (POSE, RowCodec::Pose) => {
                let pose = read_pose(&mut reader)?;
                trocar_scene::Component::check(&pose)
                    .map_err(|error| ReplicationError::Value { component, error })?;
                commands.put(entity, pose);
                return Ok(());
            }
            (GRID, RowCodec::Grid { step }) => {
                read_leaves(&mut reader, step, &mut self.leaves)?;
                self.postcard.clear();
                self.leaves.encode(&mut self.postcard);
            }
            _ => return Err(reader.refuse(u64::from(form), "a form of this component")),
        }
        // Bytes behind the value are ignored: it has been put by then, and is valid.
        match registry.put_postcard(id, commands, entity, &self.postcard) {
            Ok(_) => Ok(()),
            Err(error) => Err(ReplicationError::Value { component, error }),
        }
    }
}

fn write_pose(scene: &Snapshot, entity: Entity, out: &mut Vec<u8>) -> bool {
    let Some(pose) = scene.get::<Pose>(entity) else { return false };
    let Some(steps) = to_grid(&pose.translation, POSE_STEP) else { return false };
    out.push(POSE);
    steps.iter().for_each(|steps| varint::write(varint::zigzag(*steps), out));
    quantise(&pose.rotation).write(out);
    true
}

fn read_pose(reader: &mut WireReader<'_>) -> Result<Pose, ReplicationError> {
    let steps = [reader.signed()?, reader.signed()?, reader.signed()?];
    let rotation = SmallestThree::read(reader)?.rotation();
    if !reader.is_empty() {
        return Err(reader.refuse(0, "the end of the pose"));
    }
    Ok(Pose::new(from_grid(steps, POSE_STEP), rotation))
}

/// Vertices on their grid, for digests.
fn write_vertices(scene: &Snapshot, entity: Entity, out: &mut Vec<u8>) -> bool {
    let Some(vertices) = scene.get::<VertexPositions>(entity) else { return false };
    out.push(GRID);
    varint::write(vertices.positions.len() as u64, out);
    for vertex in vertices.positions.iter() {
        let Some(point) = vertex_to_grid(vertex) else { return false };
        point.iter().for_each(|steps| out.extend_from_slice(&steps.to_le_bytes()));
    }
    true
}

/// What the value looks like, then its leaves; false when a number is no multiple of the step.
fn write_leaves(leaves: &Leaves, step: f64, out: &mut Vec<u8>) -> bool {
    out.push(GRID);
    varint::write(leaves.shape.len() as u64, out);
    for run in &leaves.shape {
        out.push(run.kind as u8);
        varint::write(u64::from(run.count), out);
    }
    let (mut bits, mut text) = (leaves.bits.iter().copied(), &leaves.text[..]);
    for run in leaves.shape.iter().filter(|run| run.kind.is_leaf()) {
        for leaf in bits.by_ref().take(run.count as usize) {
            match run.kind {
                LeafKind::Bool | LeafKind::U8 | LeafKind::I8 => out.push(leaf as u8),
                LeafKind::Signed => varint::write(varint::zigzag(leaf as i64), out),
                LeafKind::F32 | LeafKind::F64 => {
                    let steps = f64::from_bits(leaf) / step;
                    if steps.abs() > STEPS_MAX || (steps as i64) as f64 * step != f64::from_bits(leaf) {
                        return false;
                    }
                    varint::write(varint::zigzag(steps as i64), out);
                }
                LeafKind::Text => {
                    varint::write(leaf, out);
                    let length = usize::try_from(leaf).unwrap_or(usize::MAX).min(text.len());
                    let (this, rest) = text.split_at(length);
                    out.extend_from_slice(this);
                    text = rest;
                }
                _ => varint::write(leaf, out),
            }
        }
    }
    true
}

fn read_leaves(reader: &mut WireReader<'_>, step: f64, leaves: &mut Leaves) -> Result<(), ReplicationError> {
    leaves.clear();
    for _ in 0..reader.count()? {
        let number = reader.byte()?;
        let count = reader.number()?;
        let kind = LeafKind::from_number(number)
            .ok_or_else(|| reader.refuse(u64::from(number), "a kind of number or text"))?;
        // A leaf takes a byte, so no more of them can follow than bytes.
        let most = if kind.is_leaf() { reader.rest().len() as u64 } else { u64::from(u32::MAX) };
        let count = u32::try_from(count).ok().filter(|count| u64::from(*count) <= most);
        let count = count.ok_or_else(|| reader.refuse(most, "the most leaves that can follow"))?;
        leaves.shape.push(LeafRun { kind, count });
    }
    for at in 0..leaves.shape.len() {
        let LeafRun { kind, count } = leaves.shape[at];
        if !kind.is_leaf() {
            continue;
        }
        for _ in 0..count {
            let leaf = match kind {
                LeafKind::Bool | LeafKind::U8 | LeafKind::I8 => u64::from(reader.byte()?),
                LeafKind::Signed => reader.signed()?.cast_unsigned(),
                LeafKind::F32 | LeafKind::F64 => (reader.signed()? as f64 * step).to_bits(),
                LeafKind::Text => {
                    let length = reader.count()?;
                    leaves.text.extend_from_slice(reader.take(length)?);
                    length as u64
                }
                _ => reader.number()?,
            };
            leaves.bits.push(leaf);
        }
    }
    if reader.is_empty() { Ok(()) } else { Err(reader.refuse(0, "the end of the row")) }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::{Point3, UnitQuaternion, Vector3};
    use proptest::prelude::*;
    use trocar_scene::{
        Component, InstrumentTarget, LocalContactModel, Particles, SimTime, Store, Velocity, VitalSigns,
    };

    use super::super::choice::ColumnRates;
    use super::*;

    const ENTITY: Entity = Entity::new(0, 0, 7);

    fn columns() -> ReplicatedColumns {
        ReplicatedColumns::new(&Registry::standard(), &ColumnRates::default()).expect("the defaults hold")
    }

    /// Sends a value through its form; returns what comes out, the form's bytes, and those of what comes out.
    fn through<T: Component>(value: T) -> (T, Vec<u8>, Vec<u8>) {
        let columns = columns();
        let registry = columns.registry().clone();
        let id = registry.id::<T>().expect("it is standard");
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let mut quantiser = RowQuantiser::new(&registry);
        let mut store = Store::new(registry);
        commands.put(ENTITY, value);
        store.apply(&mut commands, SimTime::ZERO);
        let (mut once, mut twice) = (Vec::new(), Vec::new());
        assert_eq!(quantiser.write(store.view(), &columns, id, ENTITY, &mut once), Ok(true));
        commands.clear();
        quantiser.read(&once, &columns, id, ENTITY, &mut commands).expect("it reads its own");
        store.apply(&mut commands, SimTime::ZERO);
        assert_eq!(quantiser.write(store.view(), &columns, id, ENTITY, &mut twice), Ok(true));
        (store.view().get::<T>(ENTITY).expect("it was put").clone(), once, twice)
    }

    #[test]
    fn rows_come_back_within_their_tolerance_and_in_a_fraction_of_the_bytes() {
        let rotation = UnitQuaternion::from_euler_angles(0.3, -1.2, 2.0);
        let pose = Pose::new(Vector3::new(0.123_456_789, -0.05, 0.3), rotation);
        let (back, form, again) = through(pose);
        assert!((back.translation - pose.translation).amax() <= POSE_STEP / 2.0);
        assert!(back.rotation.angle_to(&rotation) < 2e-5);
        assert!(form.len() <= 17 && form == again, "{}", form.len());
        let velocity = Velocity { linear: Vector3::new(0.1, -0.02, 1e-9), angular: Vector3::zeros() };
        let (back, form, again) = through(velocity);
        assert!((back.linear - velocity.linear).amax() <= 1e-4 && back.linear.z == 0.0);
        assert!(form.len() <= 12 && form == again, "{}", form.len());
        let target = InstrumentTarget { tip_in_world: pose, jaw_angle: 0.5, ..InstrumentTarget::default() };
        let (back, form, again) = through(target);
        assert!((back.jaw_angle - 0.5).abs() <= 2.5e-7 && form.len() < 60 && form == again, "{}", form.len());
        let (_, form, again) = through(LocalContactModel { proxy_in_world: pose, ..Default::default() });
        assert!(form == again && form[0] == GRID);
    }

    #[test]
    fn a_value_that_rounding_would_make_invalid_travels_to_its_last_bit() {
        // Rounded to a ten thousandth, the radius would be zero, which is refused.
        let particles = Particles { radius: 2e-5, ..Particles::default() };
        let (back, form, again) = through(particles.clone());
        assert_eq!(back, particles);
        assert!(form[0] == EXACT && form == again);
        let far = Pose::at(1e30, 0.0, 0.0);
        let (back, form, _) = through(far);
        assert!(back == far && form[0] == EXACT);
    }

    #[test]
    fn texts_options_and_lists_come_back() {
        let particles = Particles {
            positions: Arc::new(vec![Point3::new(0.125, 0.25, -0.5); 9]),
            densities: Arc::new(vec![0.5; 9]),
            first: 12_345_678_901,
            radius: 0.0078125,
            ..Particles::default()
        };
        let (back, form, again) = through(particles.clone());
        assert!(form[0] == GRID && form == again);
        assert_eq!(
            (back.first, &back.positions, back.kind),
            (particles.first, &particles.positions, particles.kind)
        );
        let (_, form, again) = through(VitalSigns::default());
        assert_eq!(form, again);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_put_nothing_invalid(bytes in prop::collection::vec(any::<u8>(), 0..120), form in 0_u8..4) {
            let columns = columns();
            let mut commands = Commands::new(columns.registry().clone(), EntityAllocator::new(0, 0));
            let mut quantiser = RowQuantiser::new(columns.registry());
            let row: Vec<u8> = std::iter::once(form).chain(bytes).collect();
            for id in columns.unreliable() {
                let _ = quantiser.read(&row, &columns, id, ENTITY, &mut commands);
            }
            prop_assert!(commands.error().is_none());
            prop_assert!(commands.puts().all(|(_, puts)| puts.check().is_ok()));
        }
    }
}
