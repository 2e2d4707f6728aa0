//! Overlays: visualisation of contacts, forces, fields and names over a scene.
//!
//! [`Overlays`] selects what is shown and is plain data. The algorithms beside it turn a snapshot into coloured lines,
//! triangles and spots ([`Sketch`]), into one value per vertex ([`fields`]) and into [`Legend`]s. Overlays that are off
//! cost nothing: their data is neither computed nor sent. What persons show one another ([`annotations`]) is always drawn
//! where it is in the scene, unless it is switched off.

pub mod annotations;
pub mod boxes;
pub mod contacts;
pub mod fields;
pub mod forces;
pub mod legend;
pub mod sketch;
pub mod trails;

pub use fields::Field;
pub use legend::Legend;
pub use sketch::Sketch;
pub use trails::Trails;

use nalgebra::Point3;
use thiserror::Error;
use trocar_scene::{Name, Pose, Snapshot};

use crate::draw_list::DrawList;

/// A kind of overlay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Overlay {
    /// Contact areas.
    Contacts,
    /// Contact normals.
    Normals,
    /// Contact forces.
    Forces,
    /// Forces that the haptic devices render.
    HandForces,
    /// Triangle edges.
    Wireframe,
    /// Bounding boxes.
    Boxes,
    /// Trails of the instruments' tips.
    Trails,
    /// Frames of reference.
    Axes,
    /// Names of entities.
    Names,
    /// Temperature.
    Temperature,
    /// Burns.
    Burn,
    /// A simulator's field over its vertices.
    Field,
}

impl Overlay {
    /// All overlays, in the order of lists.
    pub const ALL: [Self; 12] = [
        Self::Contacts,
        Self::Normals,
        Self::Forces,
        Self::HandForces,
        Self::Wireframe,
        Self::Boxes,
        Self::Trails,
        Self::Axes,
        Self::Names,
        Self::Temperature,
        Self::Burn,
        Self::Field,
    ];

    /// Its name on command lines and in settings; permanent.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Contacts => "contacts",
            Self::Normals => "normals",
            Self::Forces => "forces",
            Self::HandForces => "hand-forces",
            Self::Wireframe => "wireframe",
            Self::Boxes => "boxes",
            Self::Trails => "trails",
            Self::Axes => "axes",
            Self::Names => "names",
            Self::Temperature => "temperature",
            Self::Burn => "burn",
            Self::Field => "field",
        }
    }

    /// A one-line description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Contacts => "what touches, in red: triangles of meshes, the spot on other surfaces",
            Self::Normals => "direction of each contact",
            Self::Forces => "force of each contact",
            Self::HandForces => "force that each hand feels, at the tip of its instrument",
            Self::Wireframe => "edges of the triangles that are drawn",
            Self::Boxes => "trees of bounding volumes, or the box around each thing",
            Self::Trails => "where the tips of the instruments have just been",
            Self::Axes => "frame of each thing: x red, y green, z blue",
            Self::Names => "what things are called",
            Self::Temperature => "temperature of tissue, with its scale",
            Self::Burn => "share of the tissue's protein that is denatured, with its scale",
            Self::Field => "a quantity per vertex that a simulator gives (stress, strain), with its scale",
        }
    }
}

/// A name that no overlay has.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("'{name}' cannot be shown{suggestion}; there are: {known}")]
pub struct UnknownOverlay {
    /// The name that was asked for.
    pub name: String,
    /// `; did you mean 'forces'?`, or nothing.
    pub suggestion: String,
    /// The valid names.
    pub known: String,
}

/// A switch for each of [`Overlay::ALL`], all off by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Switches(u32);

/// Selection and sizes of overlays. All but the annotations of persons are off by default.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlays {
    /// The switches of [`Overlay::ALL`].
    pub shown: Switches,
    /// Name of the field to show; by default the first one of each entity.
    pub field: Option<String>,
    /// Length of arrows of force \[m/N\].
    pub metres_per_newton: f64,
    /// Length of normals and axes \[m\].
    pub axis_length: f64,
    /// Radius of the contact spot on a surface that is no mesh \[m\].
    pub spot_radius: f64,
    /// Duration of trails \[s\].
    pub trail_secs: f64,
    /// Ends of the scale of temperatures \[°C\].
    pub celsius: [f64; 2],
    /// Width of lines \[pixels\].
    pub line_width: f32,
    /// Whether the picture includes legends; a window may show them elsewhere.
    pub legends: bool,
    /// Whether pointers, strokes and labels of persons are drawn, and what they ask for is told.
    pub annotations: bool,
}

impl Default for Overlays {
    fn default() -> Self {
        Self {
            shown: Switches::default(),
            field: None,
            metres_per_newton: 0.01,
            axis_length: 0.01,
            spot_radius: 0.002,
            trail_secs: 2.0,
            celsius: [20.0, 100.0],
            line_width: 2.0,
            legends: true,
            annotations: true,
        }
    }
}

impl Overlays {
    /// Only these overlays.
    pub fn of(shown: &[Overlay]) -> Self {
        let mut overlays = Self::default();
        shown.iter().for_each(|overlay| overlays.set(*overlay, true));
        overlays
    }

    /// Parses a list such as `contacts,forces`; `field=stress` selects one of several fields.
    ///
    /// # Errors
    /// [`UnknownOverlay`] for the first unknown name.
    pub fn parse(list: &str) -> Result<Self, UnknownOverlay> {
        let mut overlays = Self::default();
        for word in list.split(',').map(str::trim).filter(|word| !word.is_empty()) {
            let (name, which) =
                word.split_once('=').map_or((word, None), |(name, which)| (name, Some(which)));
            let found = Overlay::ALL.into_iter().find(|overlay| overlay.name() == name);
            match (found, which) {
                (Some(Overlay::Field), Some(which)) => overlays.field = Some(which.to_owned()),
                (Some(_), None) => {}
                _ => return Err(unknown(word)),
            }
            found.into_iter().for_each(|overlay| overlays.set(overlay, true));
        }
        Ok(overlays)
    }

    /// Whether it is shown.
    pub fn shows(&self, overlay: Overlay) -> bool {
        self.shown.0 & bit(overlay) != 0
    }

    /// Shows or hides it.
    pub fn set(&mut self, overlay: Overlay, shown: bool) {
        let others = self.shown.0 & !bit(overlay);
        self.shown = Switches(if shown { others | bit(overlay) } else { others });
    }

    /// Toggles it.
    pub fn toggle(&mut self, overlay: Overlay) {
        self.shown.0 ^= bit(overlay);
    }

    /// Whether there is nothing of them in a scene.
    pub fn show_nothing_of(&self, scene: &Snapshot) -> bool {
        self.is_empty() && !(self.annotations && annotations::are_there(scene))
    }

    /// Whether all of [`Overlay::ALL`] are off.
    pub fn is_empty(&self) -> bool {
        self.shown.0 == 0
    }

    /// The overlays that are on, in the order of lists.
    pub fn iter(&self) -> impl Iterator<Item = Overlay> + '_ {
        Overlay::ALL.into_iter().filter(|overlay| self.shows(*overlay))
    }
}

fn bit(overlay: Overlay) -> u32 {
    1 << overlay as u32
}

fn unknown(name: &str) -> UnknownOverlay {
    let known = Overlay::ALL.map(Overlay::name);
    let alike = known.into_iter().map(|known| (strsim::jaro_winkler(name, known), known));
    let closest = alike.filter(|(score, _)| *score > 0.75).max_by(|a, b| a.0.total_cmp(&b.0));
    UnknownOverlay {
        name: name.to_owned(),
        suggestion: closest.map_or_else(String::new, |(_, best)| format!("; did you mean '{best}'?")),
        known: known.join(", "),
    }
}

/// The computed overlays of a scene.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// Lines, triangles and spots.
    pub sketch: Sketch,
    /// Fields over surfaces.
    pub fields: Vec<Field>,
    /// Their legends.
    pub legends: Vec<Legend>,
    /// Names with their positions in world: their middle stands there.
    pub labels: Vec<(Point3<f64>, String)>,
    /// Texts that stand above a position in world.
    pub captions: Vec<(Point3<f64>, String)>,
    /// Lines at the top of the picture.
    pub banner: Vec<String>,
    /// Whether the picture has a frame, because it stands still.
    pub frozen: bool,
}

impl Seen {
    /// Whether nothing but legends is written into the picture.
    pub fn has_no_text(&self) -> bool {
        self.labels.is_empty() && self.captions.is_empty() && self.banner.is_empty() && !self.frozen
    }
}

/// Most names drawn.
const LABELS_MAX: usize = 256;
/// Most frames drawn.
const AXES_MAX: usize = 1024;

/// Computes the overlays of a scene. `trails` has recorded the snapshots before.
pub fn look(overlays: &Overlays, scene: &Snapshot, draw_list: &DrawList, trails: &Trails) -> Seen {
    let mut seen = Seen::default();
    for overlay in overlays.iter() {
        match overlay {
            Overlay::Contacts => contacts::touching(overlays, scene, draw_list, &mut seen),
            Overlay::Normals => contacts::normals(overlays, scene, &mut seen),
            Overlay::Forces => contacts::forces(overlays, scene, &mut seen),
            Overlay::HandForces => forces::hands(overlays, scene, &mut seen),
            // Drawn from the surfaces that are on the device.
            Overlay::Wireframe => {}
            Overlay::Boxes => boxes::boxes(overlays, scene, draw_list, &mut seen.sketch),
            Overlay::Trails => trails.draw(overlays, &mut seen.sketch),
            Overlay::Axes => {
                for (entity, _) in scene.iter::<Pose>().take(AXES_MAX) {
                    let world_from_entity = scene.world_pose(entity);
                    seen.sketch.axes(&world_from_entity, overlays.axis_length, overlays.line_width);
                }
            }
            Overlay::Names => label(scene, draw_list, &mut seen.labels),
            Overlay::Temperature | Overlay::Burn | Overlay::Field => {
                fields::field(overlay, overlays, scene, draw_list, &mut seen);
            }
        }
    }
    if overlays.annotations {
        annotations::draw(scene, overlays.line_width, &mut seen);
    }
    seen
}

fn label(scene: &Snapshot, draw_list: &DrawList, labels: &mut Vec<(Point3<f64>, String)>) {
    let mut last = None;
    for item in draw_list.items() {
        if last == Some(item.entity) || labels.len() >= LABELS_MAX {
            continue;
        }
        last = Some(item.entity);
        if let Some(Name(name)) = scene.get::<Name>(item.entity) {
            let place = Point3::from(item.world_from_item.translation.vector);
            labels.push((place, name.chars().filter(|letter| !letter.is_control()).take(48).collect()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_reads_back_and_says_what_it_shows() {
        for overlay in Overlay::ALL {
            assert_eq!(Overlays::parse(overlay.name()).unwrap(), Overlays::of(&[overlay]));
            assert!(overlay.description().len() > 10);
            let mut toggled = Overlays::default();
            toggled.toggle(overlay);
            assert_eq!(toggled.iter().collect::<Vec<_>>(), [overlay]);
            toggled.toggle(overlay);
            assert!(toggled.is_empty());
        }
        let several = Overlays::parse(" forces, contacts,field=strain").unwrap();
        let shown: Vec<_> = several.iter().collect();
        assert_eq!(shown, [Overlay::Contacts, Overlay::Forces, Overlay::Field]);
        assert_eq!(several.field.as_deref(), Some("strain"));
    }

    #[test]
    fn an_unknown_name_is_refused_with_what_was_meant() {
        let refused = Overlays::parse("contacts,force").unwrap_err();
        assert!(refused.to_string().contains("did you mean 'forces'?"), "{refused}");
        assert!(refused.known.contains("temperature"));
        assert_eq!(Overlays::parse("zzz").unwrap_err().suggestion, "");
        assert!(Overlays::parse("axes=3").is_err());
    }
}
