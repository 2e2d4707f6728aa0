//! The standard components: those of surgical scenes.

pub mod contact;
pub mod deformation;
pub mod device;
pub mod field;
pub mod graph;
pub mod instrument;
pub mod joint;
pub mod matter;
pub mod mentor_input;
pub mod mesh;
pub mod particles;
pub mod person;
pub mod shape;
pub mod station;
pub mod surface_place;
pub mod task;
pub mod telementoring;
pub mod teleoperation;
pub mod virtual_fixture;
pub mod visual;

pub use contact::{Collision, CollisionList, Detection, Primitive};
pub use deformation::{
    Anchors, Frozen, HeatFrozen, MeshRemarks, MeshRepaired, OutOfValidity, Region, RestPositions,
    VertexVelocities,
};
pub use device::{DeviceForce, DeviceInfo, DeviceState, Hand, HandTarget, HapticStatus, PressTarget, Side};
pub use field::{ScalarField, ScalarFields};
pub use graph::{Name, Parent, Pose, Velocity};
pub use instrument::{
    Activation, ActivationMode, ContactPlane, Grasp, Instrument, InstrumentForce, InstrumentKind,
    InstrumentTarget, JawState, LocalContactModel, Port, StationContactModel,
};
pub use joint::{JOINTS_MAX, Joint, JointFrame, JointFrames, JointKind, JointLoad, JointState, Joints};
pub use matter::{Burn, Motion, Parameter, RigidBody, Source, Sources, Temperature, Tissue};
pub use mentor_input::{
    DRAWN_PLACES_MAX, HandOverStep, MENTOR_DEEDS_MAX, MentorAnswer, MentorDeed, MentorInput,
};
pub use mesh::{
    BoundingVolumeNode, BoundingVolumeTree, LineMesh, SurfaceMesh, TetMesh, TetRegions, TextureCoordinates,
    VertexPositions,
};
pub use particles::{PARTICLES_MAX, ParticleKind, Particles};
pub use person::{PERSON_TOTAL_MAX, PersonAction, PersonActions, PersonHand, PersonInput, PersonView};
pub use shape::Shape;
pub use station::{LinkState, Repaired, Station, StationRole};
pub use surface_place::{PLACE_REACH_MAX, SurfacePlace, SurfacePoint};
pub use task::{Measured, OUTCOME, PEG_TRANSFER, ScoreKind, TaskError, TaskState, VitalSigns};
pub use telementoring::{
    LABEL_TEXT_MAX, LABELS_MAX, MentorLabel, MentorPointer, MentorStroke, PictureFreeze, SECTION_PLACES_MAX,
    SECTIONS_MAX, SIGNATURE_NAME_MAX, STROKE_WIDTH_MAX, Signature, TakeOverRequest, TakeOverStep,
};
pub use teleoperation::{
    EnergyPedal, ForceFeedback, SlaveOrder, SlaveState, Teleoperation, TeleoperationEnd, TeleoperationFigures,
};
pub use virtual_fixture::VirtualFixture;
pub use visual::{Camera, HeadTracked, Light, Optics, Texture, VisualMaterial};

use crate::registry::{RegistryBuilder, RegistryError};

/// Registers every standard component.
///
/// # Errors
/// When a name is already taken by another type.
pub fn register(builder: &mut RegistryBuilder) -> Result<(), RegistryError> {
    crate::register_all!(builder;
        Name, Parent, Pose, Velocity,
        Shape, SurfaceMesh, TetMesh, TetRegions, LineMesh, TextureCoordinates, BoundingVolumeTree,
        VertexPositions, VertexVelocities, RestPositions, Anchors,
        Frozen, OutOfValidity, HeatFrozen, MeshRepaired, MeshRemarks,
        VisualMaterial, Light, Camera, Optics, HeadTracked,
        RigidBody, Joints, JointFrames, JointState, Tissue, Sources, Temperature, Burn, ScalarFields, Particles,
        Instrument, Port, InstrumentTarget, JawState, Activation, InstrumentForce, Grasp, LocalContactModel,
        Hand, DeviceInfo, DeviceState, DeviceForce, HandTarget, PressTarget, HapticStatus, PersonInput, VirtualFixture,
        CollisionList, TaskState, Measured, VitalSigns, Station, Repaired,
        MentorPointer, MentorStroke, MentorLabel, PictureFreeze, TakeOverRequest, StationContactModel,
        Teleoperation, SlaveOrder,
        MentorInput, MentorAnswer,
    )?;
    Ok(())
}
