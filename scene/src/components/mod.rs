//! The components of the field.

pub mod contact;
pub mod deformation;
pub mod device;
pub mod field;
pub mod graph;
pub mod instrument;
pub mod matter;
pub mod mesh;
pub mod particles;
pub mod person;
pub mod shape;
pub mod task;
pub mod visual;

pub use contact::{Collision, CollisionList, Detection, Primitive};
pub use deformation::{
    Anchors, Frozen, HeatFrozen, MeshRepaired, OutOfValidity, Region, RestPositions, VertexVelocities,
};
pub use device::{DeviceForce, DeviceInfo, DeviceState, Hand, HandTarget, HapticStatus, Side};
pub use field::{ScalarField, ScalarFields};
pub use graph::{Name, Parent, Pose, Velocity};
pub use instrument::{
    Activation, ActivationMode, ContactPlane, Grasp, Instrument, InstrumentForce, InstrumentKind,
    InstrumentTarget, JawState, LocalContactModel, Port,
};
pub use matter::{Burn, Motion, Parameter, RigidBody, Source, Sources, Temperature, Tissue};
pub use mesh::{
    BoundingVolumeNode, BoundingVolumeTree, LineMesh, SurfaceMesh, TetMesh, TextureCoordinates,
    VertexPositions,
};
pub use particles::{PARTICLES_MAX, ParticleKind, Particles};
pub use person::{PERSON_TOTAL_MAX, PersonAction, PersonActions, PersonHand, PersonInput, PersonView};
pub use shape::Shape;
pub use task::{Measured, TaskError, TaskState, VitalSigns};
pub use visual::{Camera, HeadTracked, Light, Optics, Texture, VisualMaterial};

use crate::registry::{RegistryBuilder, RegistryError};

/// Registers every component of the field.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    builder.register::<Name>()?;
    builder.register::<Parent>()?;
    builder.register::<Pose>()?;
    builder.register::<Velocity>()?;
    builder.register::<Shape>()?;
    builder.register::<SurfaceMesh>()?;
    builder.register::<TetMesh>()?;
    builder.register::<LineMesh>()?;
    builder.register::<VertexPositions>()?;
    builder.register::<VertexVelocities>()?;
    builder.register::<RestPositions>()?;
    builder.register::<Anchors>()?;
    builder.register::<Frozen>()?;
    builder.register::<OutOfValidity>()?;
    builder.register::<HeatFrozen>()?;
    builder.register::<MeshRepaired>()?;
    builder.register::<TextureCoordinates>()?;
    builder.register::<BoundingVolumeTree>()?;
    builder.register::<VisualMaterial>()?;
    builder.register::<Light>()?;
    builder.register::<Camera>()?;
    builder.register::<Optics>()?;
    builder.register::<HeadTracked>()?;
    builder.register::<RigidBody>()?;
    builder.register::<Tissue>()?;
    builder.register::<Sources>()?;
    builder.register::<Temperature>()?;
    builder.register::<Burn>()?;
    builder.register::<ScalarFields>()?;
    builder.register::<Particles>()?;
    builder.register::<Instrument>()?;
    builder.register::<Port>()?;
    builder.register::<InstrumentTarget>()?;
    builder.register::<JawState>()?;
    builder.register::<Activation>()?;
    builder.register::<InstrumentForce>()?;
    builder.register::<Grasp>()?;
    builder.register::<LocalContactModel>()?;
    builder.register::<Hand>()?;
    builder.register::<DeviceInfo>()?;
    builder.register::<DeviceState>()?;
    builder.register::<DeviceForce>()?;
    builder.register::<HandTarget>()?;
    builder.register::<HapticStatus>()?;
    builder.register::<PersonInput>()?;
    builder.register::<CollisionList>()?;
    builder.register::<TaskState>()?;
    builder.register::<Measured>()?;
    builder.register::<VitalSigns>()?;
    Ok(())
}
