//! Bodies of the scene as input of methods: checked when they change, and awaited while absent.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use trocar_scene::components::{
    CollisionList, Instrument, LineMesh, Parent, Pose, SurfaceMesh, VertexPositions,
};
use trocar_scene::{Access, BuildContext, Commands, ControllerError, Entity, SimTime, Snapshot};

use crate::{Line, Surface};

/// Largest coordinate of a vertex in its body's frame \[m\]: larger ones would reduce the accuracy of a whole tree.
const COORDINATE_MAX: f64 = 1e6;

/// Access of every detector.
pub fn access() -> Access {
    Access::new()
        .reads::<SurfaceMesh>()
        .reads::<VertexPositions>()
        .reads::<Pose>()
        .reads::<Parent>()
        .contributes::<CollisionList>()
}

/// Change of a body since it was last read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// No change.
    None,
    /// The same triangles or segments, with moved vertices.
    Deformed,
    /// Other triangles or segments.
    Remeshed,
    /// Absent or invalid: it is empty until it is back, and then counts as remeshed.
    Absent,
}

/// Required geometry of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RequiredGeometry {
    /// Triangles.
    Surface,
    /// Triangles, or segments with a radius: a needle, a thread, a band.
    SurfaceOrLine,
}

impl RequiredGeometry {
    fn is(self, scene: &Snapshot, entity: Entity) -> bool {
        let is_line = || scene.get::<LineMesh>(entity).is_some();
        scene.get::<SurfaceMesh>(entity).is_some() || self == Self::SurfaceOrLine && is_line()
    }

    fn words(self) -> &'static str {
        match self {
            Self::Surface => "surface",
            Self::SurfaceOrLine => "surface or line",
        }
    }
}

#[derive(Clone, Debug)]
enum Parts {
    Triangles(Arc<Vec<[u32; 3]>>),
    Segments(Arc<Vec<[u32; 2]>>, f64),
}

impl Parts {
    fn of(scene: &Snapshot, entity: Entity, wanted: RequiredGeometry) -> Option<Self> {
        let line = scene.get::<LineMesh>(entity).filter(|_| wanted == RequiredGeometry::SurfaceOrLine);
        match line {
            Some(line) => Some(Self::Segments(line.segments.clone(), line.radius)),
            None => scene.get::<SurfaceMesh>(entity).map(|mesh| Self::Triangles(mesh.triangles.clone())),
        }
    }

    fn is_same(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Triangles(own), Self::Triangles(other)) => Arc::ptr_eq(own, other),
            (Self::Segments(own, radius), Self::Segments(other, others)) => {
                Arc::ptr_eq(own, other) && radius == others
            }
            _ => false,
        }
    }

    fn check(&self, vertices: &[Point3<f64>]) -> Result<(), String> {
        let too_far = vertices.iter().position(|vertex| vertex.coords.amax() > COORDINATE_MAX);
        if let Some(vertex) = too_far {
            return Err(format!("vertex {vertex} is further away than {COORDINATE_MAX:e} m"));
        }
        match self {
            Self::Triangles(triangles) => {
                Surface::new(vertices, triangles).map(drop).map_err(|error| error.to_string())
            }
            Self::Segments(segments, radius) => {
                Line::new(vertices, segments, *radius).map(drop).map_err(|error| error.to_string())
            }
        }
    }
}

/// A body with a surface, or a line. Data is shared with the scene, never copied.
#[derive(Clone, Debug)]
pub struct Body {
    /// Its entity.
    pub entity: Entity,
    /// `world_from_body`.
    pub pose: Isometry3<f64>,
    name: String,
    wanted: RequiredGeometry,
    vertices: Arc<Vec<Point3<f64>>>,
    parts: Parts,
    /// Whether the last read data is valid.
    is_present: bool,
    /// Whether its presence was reported to the scene.
    told: bool,
}

impl Body {
    /// The body of that name. In a later life of the controller an absent one is awaited.
    ///
    /// # Errors
    /// There is none of that name, or its geometry is missing or invalid.
    pub fn named(
        context: &BuildContext<'_>,
        name: &str,
        wanted: RequiredGeometry,
    ) -> Result<Self, ControllerError> {
        let scene = context.scene;
        let found = find(scene, name, &|entity| wanted.is(scene, entity), wanted.words());
        let mut body = Self {
            entity: if is_first_life(context) { found? } else { found.unwrap_or(context.me) },
            pose: Isometry3::identity(),
            name: name.to_owned(),
            wanted,
            vertices: Arc::default(),
            parts: Parts::Triangles(Arc::default()),
            is_present: false,
            told: true,
        };
        match body.read(scene) {
            Err(reason) if is_first_life(context) => {
                Err(ControllerError::Scene(format!("'{name}': {reason}")))
            }
            _ => Ok(body),
        }
    }

    /// Reads it again, and emits an event when it becomes invalid, and when it is valid again.
    pub fn follow(&mut self, scene: &Snapshot, out: &mut Commands) -> Change {
        let change = self.read(scene).unwrap_or(Change::Absent);
        if self.told != self.is_present {
            self.told = self.is_present;
            let name = if self.is_present { "surface_usable" } else { "surface_unusable" };
            out.event(name, out.me(), Some(self.entity), 0.0);
        }
        change
    }

    fn read(&mut self, scene: &Snapshot) -> Result<Change, String> {
        if !self.wanted.is(scene, self.entity) {
            // Another one of the same name takes its place.
            match scene.find(&self.name).filter(|entity| self.wanted.is(scene, *entity)) {
                Some(entity) => self.entity = entity,
                None => return self.lose(format!("has no {} any more", self.wanted.words())),
            }
        }
        let parts = Parts::of(scene, self.entity, self.wanted);
        let (Some(parts), Some(vertices)) = (parts, scene.get::<VertexPositions>(self.entity)) else {
            return self.lose("has no vertices".to_owned());
        };
        self.pose = scene.world_pose(self.entity);
        let is_same = parts.is_same(&self.parts);
        if is_same && Arc::ptr_eq(&vertices.positions, &self.vertices) {
            return Ok(if self.is_present { Change::None } else { Change::Absent });
        }
        let deforms = self.is_present && is_same && vertices.positions.len() == self.vertices.len();
        self.parts = parts;
        self.vertices.clone_from(&vertices.positions);
        let checked = self.parts.check(&self.vertices);
        self.is_present = checked.is_ok();
        checked.map(|()| if deforms { Change::Deformed } else { Change::Remeshed })
    }

    fn lose(&mut self, reason: String) -> Result<Change, String> {
        self.is_present = false;
        self.vertices = Arc::default();
        self.parts = Parts::Triangles(Arc::default());
        Err(reason)
    }

    /// Its surface; empty while absent.
    pub fn surface(&self) -> Surface<'_> {
        match &self.parts {
            Parts::Triangles(triangles) if self.is_present => Surface::trusted(&self.vertices, triangles),
            _ => Surface::trusted(&[], &[]),
        }
    }

    /// Its segments and their radius \[m\], if it is a line.
    pub fn segments(&self) -> Option<(&[[u32; 2]], f64)> {
        match &self.parts {
            Parts::Segments(segments, radius) if self.is_present => Some((segments, *radius)),
            _ => None,
        }
    }

    /// Its vertices; none while it is absent \[m\].
    pub fn vertices(&self) -> &[Point3<f64>] {
        if self.is_present { &self.vertices } else { &[] }
    }
}

/// Whether this is the controller's first life, in which all bodies must exist; later they may be absent.
fn is_first_life(context: &BuildContext<'_>) -> bool {
    context.epoch <= 1 && context.time == SimTime::ZERO
}

/// Instruments by their names. In a later life absent ones are skipped.
///
/// # Errors
/// There is none of that name.
pub fn instruments(context: &BuildContext<'_>, names: &[String]) -> Result<Vec<Entity>, ControllerError> {
    let is_instrument = |entity| context.scene.get::<Instrument>(entity).is_some();
    let one = |name: &String| match find(context.scene, name, &is_instrument, "instrument") {
        Err(error) if is_first_life(context) => Err(error),
        found => Ok(found.unwrap_or(context.me)),
    };
    names.iter().map(one).collect()
}

/// Creates each body in pairs of names once, and returns the pairs by index.
///
/// # Errors
/// For the first body that cannot be created.
pub fn pairs<T>(
    names: &[[String; 2]],
    mut make: impl FnMut(&str) -> Result<T, ControllerError>,
) -> Result<(Vec<T>, Vec<[usize; 2]>), ControllerError> {
    let (mut made, mut known): (Vec<T>, Vec<&str>) = (Vec::new(), Vec::new());
    let mut number = |name| {
        if let Some(number) = known.iter().position(|known| *known == name) {
            return Ok(number);
        }
        made.push(make(name)?);
        known.push(name);
        Ok(known.len() - 1)
    };
    let mut numbers = Vec::with_capacity(names.len());
    for [first, second] in names {
        numbers.push([number(first.as_str())?, number(second.as_str())?]);
    }
    Ok((made, numbers))
}

/// Refuses pairs of a body with itself.
///
/// # Errors
/// Names the body.
pub fn refuse_twins(names: &[[String; 2]], what: &str) -> Result<(), ControllerError> {
    match names.iter().find(|[first, second]| first == second) {
        Some([name, _]) => {
            let reason = format!("{what} of '{name}' and '{name}': two bodies are needed");
            Err(ControllerError::Scene(reason))
        }
        None => Ok(()),
    }
}

/// The entity of that name, if it has the required data.
fn find(
    scene: &Snapshot,
    name: &str,
    is_wanted: &dyn Fn(Entity) -> bool,
    what: &str,
) -> Result<Entity, ControllerError> {
    match scene.find(name) {
        Some(entity) if is_wanted(entity) => Ok(entity),
        found => {
            let named = scene.iter::<trocar_scene::components::Name>();
            let wanted = named.filter(|(entity, _)| is_wanted(*entity)).map(|(_, name)| name.0.as_str());
            let mut known: Vec<&str> = wanted.collect();
            known.sort_unstable();
            let known = if known.is_empty() { "there is none".to_owned() } else { known.join(", ") };
            let why = if found.is_some() { format!("has no {what}") } else { "does not exist".to_owned() };
            Err(ControllerError::Scene(format!("'{name}' {why}; with a {what}: {known}")))
        }
    }
}
