//! The suture of a thread or needle, as a scenario names it: one of the first two by its name, any other by size and material,
//! or by values of its own.

use schemars::JsonSchema;
use serde::de::value::{MapAccessDeserializer, StrDeserializer};
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use trocar_scene::ComponentError;
use trocar_scene::components::Parameter;

use crate::suture_thread::ThreadMaterial;
use crate::suture_thread::suture_table::{SutureMaterial, SutureSize};

/// What a thread is.
///
/// In documents it is a name, `"silk2_0"` or `"silk2"`, or a table: `{ size = "3-0", material = "nylon" }`. Both kinds keep
/// their own encoding in binary.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Suture {
    /// Braided silk, USP size 2-0, nearly inextensible: see [`ThreadMaterial::silk_2_0`].
    #[default]
    Silk2_0,
    /// The same braid, USP size 2.
    Silk2,
    /// By its size and material, or with values of its own.
    Of(SutureOf),
}

/// A suture by its size and material. Values of its own replace those that follow; without a material all are needed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SutureOf {
    /// USP size: 6-0, 5-0, 4-0, 3-0, 2-0, 0, 1 or 2. Either this or the radius.
    pub size: Option<SutureSize>,
    /// Material: silk, polyglactin, polyester, polypropylene or nylon.
    pub material: Option<SutureMaterial>,
    /// Radius \[m\].
    pub radius: Option<f64>,
    /// Mass per length \[kg/m\].
    pub mass_per_length: Option<f64>,
    /// `EA`, force per unit strain \[N\].
    pub axial_stiffness: Option<f64>,
    /// `EI`, moment per unit curvature \[N·m²\].
    pub bending_stiffness: Option<f64>,
    /// `GJ`, moment per unit twist \[N·m²\].
    pub twisting_stiffness: Option<f64>,
    /// Coulomb friction coefficient on itself.
    pub friction: Option<f64>,
}

impl SutureOf {
    /// Name, value, range and its text, of each value of its own.
    fn own(&self) -> [(&'static str, Option<f64>, [f64; 2], &'static str); 6] {
        [
            ("suture.radius", self.radius, [1e-5, 5e-3], "1e-5 to 0.005 m"),
            ("suture.mass_per_length", self.mass_per_length, [1e-7, 0.1], "1e-7 to 0.1 kg/m"),
            ("suture.axial_stiffness", self.axial_stiffness, [1e-2, 1e6], "0.01 to 1e6 N"),
            ("suture.bending_stiffness", self.bending_stiffness, [1e-14, 1.0], "1e-14 to 1 N·m²"),
            ("suture.twisting_stiffness", self.twisting_stiffness, [1e-14, 1.0], "1e-14 to 1 N·m²"),
            ("suture.friction", self.friction, [0.0, 10.0], "0 to 10"),
        ]
    }

    fn check(&self) -> Result<(), ComponentError> {
        let refuse = |reason: String| Err(ComponentError::Malformed(format!("suture: {reason}")));
        match (self.size, self.radius) {
            (Some(_), Some(_)) => return refuse("'size' and 'radius' exclude each other".into()),
            (None, None) => {
                let sizes = SutureSize::ALL.map(SutureSize::name).join(", ");
                return refuse(format!("'size' ({sizes}) or 'radius' is missing"));
            }
            _ => {}
        }
        for (field, value, [low, high], valid) in self.own() {
            match value {
                Some(value) => ComponentError::range(field, value, low..=high, valid)?,
                None if self.material.is_none() && field != "suture.radius" => {
                    let key = field.trim_start_matches("suture.");
                    let materials = "silk, polyglactin, polyester, polypropylene, nylon";
                    return refuse(format!(
                        "'{key}' is missing, or a 'material' ({materials}) from which it follows"
                    ));
                }
                None => {}
            }
        }
        Ok(())
    }

    fn material(&self) -> ThreadMaterial {
        let radius = self.size.map(SutureSize::radius).or(self.radius);
        let radius = radius.unwrap_or(ThreadMaterial::silk_2_0().radius);
        // Without a material every value is replaced.
        let of_table = self.material.unwrap_or(SutureMaterial::Silk).strand(radius);
        ThreadMaterial {
            mass_per_length: self.mass_per_length.unwrap_or(of_table.mass_per_length),
            axial_stiffness: self.axial_stiffness.unwrap_or(of_table.axial_stiffness),
            bending_stiffness: self.bending_stiffness.unwrap_or(of_table.bending_stiffness),
            twisting_stiffness: self.twisting_stiffness.unwrap_or(of_table.twisting_stiffness),
            friction: self.friction.unwrap_or(of_table.friction),
            ..of_table
        }
    }
}

impl Suture {
    /// Refuses a table that names too much or too little.
    ///
    /// # Errors
    /// Names the key, and what is valid.
    pub fn check(&self) -> Result<(), ComponentError> {
        match self {
            Self::Of(of) => of.check(),
            Self::Silk2_0 | Self::Silk2 => Ok(()),
        }
    }

    /// Its properties, with their sources.
    #[must_use]
    pub fn parameters(&self) -> [(&'static str, Parameter); 6] {
        let own = match self {
            Self::Of(of) => of.own().map(|(_, value, ..)| value.is_some()),
            Self::Silk2_0 | Self::Silk2 => [false; 6],
        };
        let of_table = |at: usize, source: String| if own[at] { "given".to_owned() } else { source };
        let material = self.material();
        let sources = match self {
            Self::Of(SutureOf { size, material, .. }) => {
                let known = material.unwrap_or(SutureMaterial::Silk);
                let size = size.map(|size| {
                    let [low, high] = size.diameters().map(|diameter| diameter * 1e3);
                    format!("USP <861>: {} is {low:.3} to {high:.3} mm thick", size.name())
                });
                let modulus = known.young_modulus().1;
                let bends =
                    if known.is_braided() { "a hundredth of a solid rod: chosen" } else { "a solid rod" };
                [
                    size.unwrap_or_default(),
                    format!("{} kg/m³, all of it solid", known.density()),
                    modulus.to_owned(),
                    format!("{bends}, of the modulus in tension"),
                    "a solid rod of Poisson's ratio 0.4: chosen".to_owned(),
                    "chosen".to_owned(),
                ]
            }
            Self::Silk2_0 | Self::Silk2 => [
                if *self == Self::Silk2 {
                    "USP <861>: 2 is 0.500 to 0.599 mm thick"
                } else {
                    "USP <861>: 2-0 is 0.300 to 0.339 mm thick"
                },
                "silk 1.3 g/cm³, all of it solid",
                "strain 0.06 % of 2-0 at 2 N: chosen, below solid silk (Naleway 2015: 8.7 GPa)",
                "a hundredth of a solid silk rod: chosen, a braid bends far more easily",
                "near a solid silk rod: chosen",
                "in the middle of what is reported of sutures: chosen",
            ]
            .map(str::to_owned),
        };
        let values = [
            ("radius", material.radius),
            ("mass_per_length", material.mass_per_length),
            ("axial_stiffness", material.axial_stiffness),
            ("bending_stiffness", material.bending_stiffness),
            ("twisting_stiffness", material.twisting_stiffness),
            ("friction", material.friction),
        ];
        let mut sources = sources.into_iter().enumerate().map(|(at, source)| of_table(at, source));
        values.map(|(name, value)| (name, Parameter { value, source: sources.next().unwrap_or_default() }))
    }

    /// The material of the thread.
    #[must_use]
    pub fn material(&self) -> ThreadMaterial {
        let base = ThreadMaterial::silk_2_0();
        let radius = match self {
            Self::Of(of) => return of.material(),
            Self::Silk2_0 => 1.5e-4,
            Self::Silk2 => 2.5e-4,
        };
        // The same braid, thicker: forces scale with the area, bending moments with its square.
        let scale: f64 = radius / base.radius;
        ThreadMaterial {
            radius,
            mass_per_length: base.mass_per_length * scale.powi(2),
            axial_stiffness: base.axial_stiffness * scale.powi(2),
            bending_stiffness: base.bending_stiffness * scale.powi(4),
            twisting_stiffness: base.twisting_stiffness * scale.powi(4),
            ..base
        }
    }
}

/// The two sutures that have a name.
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Named {
    /// Braided silk, USP size 2-0, nearly inextensible.
    Silk2_0,
    /// The same braid, USP size 2.
    Silk2,
}

/// As a document holds it.
#[derive(Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum InDocument {
    /// By its name.
    Named(Named),
    /// By size and material, or by values of its own.
    Of(SutureOf),
}

/// In binary: formats without field names cannot tell a text from a table.
#[derive(Serialize, Deserialize)]
enum InBinary {
    Silk2_0,
    Silk2,
    Of(SutureOf),
}

impl Serialize for Suture {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            match self {
                Self::Silk2_0 => InDocument::Named(Named::Silk2_0),
                Self::Silk2 => InDocument::Named(Named::Silk2),
                Self::Of(of) => InDocument::Of(*of),
            }
            .serialize(serializer)
        } else {
            match self {
                Self::Silk2_0 => InBinary::Silk2_0,
                Self::Silk2 => InBinary::Silk2,
                Self::Of(of) => InBinary::Of(*of),
            }
            .serialize(serializer)
        }
    }
}

impl<'de> Deserialize<'de> for Suture {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if deserializer.is_human_readable() {
            return deserializer.deserialize_any(OfDocument);
        }
        Ok(match InBinary::deserialize(deserializer)? {
            InBinary::Silk2_0 => Self::Silk2_0,
            InBinary::Silk2 => Self::Silk2,
            InBinary::Of(of) => Self::Of(of),
        })
    }
}

struct OfDocument;

impl<'de> Visitor<'de> for OfDocument {
    type Value = Suture;

    fn expecting(&self, to: &mut std::fmt::Formatter) -> std::fmt::Result {
        to.write_str("\"silk2_0\", \"silk2\", or a table such as { size = \"3-0\", material = \"nylon\" }")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Suture, E> {
        match Named::deserialize(StrDeserializer::<E>::new(name)) {
            Ok(Named::Silk2_0) => Ok(Suture::Silk2_0),
            Ok(Named::Silk2) => Ok(Suture::Silk2),
            Err(_) => Err(E::invalid_value(serde::de::Unexpected::Str(name), &self)),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Suture, A::Error> {
        SutureOf::deserialize(MapAccessDeserializer::new(map)).map(Suture::Of)
    }
}
