//! Sutures by USP size and material.
//!
//! Diameters: United States Pharmacopeia, general chapter <861> and the monographs of synthetic absorbable and nonabsorbable
//! sutures, which have the same limits of the average diameter. A size is as thick as the middle of its limits.
//!
//! Moduli: silk and polyglactin 910 were measured on 3-0 sutures by Naleway et al. ("Mechanical properties of suture materials
//! in general and cutaneous surgery", J. Biomed. Mater. Res. B 103, 2015): 8.701 and, of the rapidly absorbed kind, 9.32 GPa.
//! Those of the others are chosen within what is reported of drawn filaments. Densities are those of the polymers; a
//! strand is taken as solid.
//!
//! A monofilament bends and twists as a round rod: `EI = E π r⁴ / 4`, `GJ = EI / (1 + ν)` with ν = 0.4. The filaments of
//! a braid slide on each other: `EI` is a hundredth of that of the rod (chosen; if nothing held the filaments together,
//! it would be their number, hundreds, that divides it), `GJ` near that of the rod, since a braid locks when it is twisted.

use std::f64::consts::PI;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ThreadMaterial;

/// Poisson's ratio of drawn polymers: assumed.
const POISSON: f64 = 0.4;
/// Bending stiffness of a braid relative to a round rod: chosen.
const BRAID: f64 = 0.01;

/// USP size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum SutureSize {
    /// 0.070 to 0.099 mm.
    #[serde(rename = "6-0", alias = "6/0")]
    S6_0,
    /// 0.100 to 0.149 mm.
    #[serde(rename = "5-0", alias = "5/0")]
    S5_0,
    /// 0.150 to 0.199 mm.
    #[serde(rename = "4-0", alias = "4/0")]
    S4_0,
    /// 0.200 to 0.249 mm.
    #[serde(rename = "3-0", alias = "3/0")]
    S3_0,
    /// 0.300 to 0.339 mm.
    #[serde(rename = "2-0", alias = "2/0")]
    S2_0,
    /// 0.350 to 0.399 mm.
    #[serde(rename = "0", alias = "1-0", alias = "1/0")]
    S0,
    /// 0.400 to 0.499 mm.
    #[serde(rename = "1")]
    S1,
    /// 0.500 to 0.599 mm.
    #[serde(rename = "2")]
    S2,
}

impl SutureSize {
    /// All of them, the thinnest first.
    pub const ALL: [Self; 8] =
        [Self::S6_0, Self::S5_0, Self::S4_0, Self::S3_0, Self::S2_0, Self::S0, Self::S1, Self::S2];

    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::S6_0 => "6-0",
            Self::S5_0 => "5-0",
            Self::S4_0 => "4-0",
            Self::S3_0 => "3-0",
            Self::S2_0 => "2-0",
            Self::S0 => "0",
            Self::S1 => "1",
            Self::S2 => "2",
        }
    }

    /// Limits of the average diameter \[m\].
    #[must_use]
    pub fn diameters(self) -> [f64; 2] {
        let micrometres = match self {
            Self::S6_0 => [70.0, 99.0],
            Self::S5_0 => [100.0, 149.0],
            Self::S4_0 => [150.0, 199.0],
            Self::S3_0 => [200.0, 249.0],
            Self::S2_0 => [300.0, 339.0],
            Self::S0 => [350.0, 399.0],
            Self::S1 => [400.0, 499.0],
            Self::S2 => [500.0, 599.0],
        };
        micrometres.map(|limit| limit * 1e-6)
    }

    /// Radius in the middle of the limits \[m\].
    #[must_use]
    pub fn radius(self) -> f64 {
        self.diameters().iter().sum::<f64>() / 4.0
    }
}

/// What a suture is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SutureMaterial {
    /// Braided silk.
    Silk,
    /// Braided polyglactin 910, which is absorbed.
    Polyglactin,
    /// Braided polyester.
    Polyester,
    /// Polypropylene, a monofilament.
    Polypropylene,
    /// Nylon (polyamide 6 or 6,6), a monofilament.
    Nylon,
}

impl SutureMaterial {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Silk, Self::Polyglactin, Self::Polyester, Self::Polypropylene, Self::Nylon];

    /// Whether it is braided of many filaments.
    #[must_use]
    pub fn is_braided(self) -> bool {
        matches!(self, Self::Silk | Self::Polyglactin | Self::Polyester)
    }

    /// Density \[kg/m³\].
    #[must_use]
    pub fn density(self) -> f64 {
        match self {
            Self::Silk => 1_300.0,
            Self::Polyglactin => 1_500.0,
            Self::Polyester => 1_380.0,
            Self::Polypropylene => 905.0,
            Self::Nylon => 1_140.0,
        }
    }

    /// Young's modulus of the strand in tension \[Pa\], and where it is from.
    #[must_use]
    pub fn young_modulus(self) -> (f64, &'static str) {
        match self {
            Self::Silk => (8.701e9, "3-0 silk, initial modulus (Naleway et al. 2015)"),
            Self::Polyglactin => (9.32e9, "3-0 rapid polyglactin 910, initial modulus (Naleway et al. 2015)"),
            Self::Polyester => (5.0e9, "chosen: drawn filaments have more, a braid of them gives"),
            Self::Polypropylene => {
                (2.5e9, "chosen, above the 1.1 to 1.6 GPa of polypropylene that is not drawn")
            }
            Self::Nylon => (2.0e9, "chosen, within 1 GPa wet and 3 GPa dry of polyamide 6,6"),
        }
    }

    /// Coulomb friction coefficient of the thread on itself. Chosen: it is no constant of the material, but falls with
    /// the tension; braids rub more than monofilaments, coated braids less ("Effect of suture material and construction on
    /// frictional properties of sutures", Surg. Gynecol. Obstet. 161, 1985; PMC2796445: 0.05 to 0.13 for coated ones).
    #[must_use]
    pub fn friction(self) -> f64 {
        match self {
            Self::Silk | Self::Polyester => 0.2,
            Self::Polyglactin => 0.13,
            Self::Polypropylene | Self::Nylon => 0.15,
        }
    }

    /// A strand of this radius \[m\].
    #[must_use]
    pub fn strand(self, radius: f64) -> ThreadMaterial {
        let (young, _) = self.young_modulus();
        let area = PI * radius * radius;
        let rod = young * area * radius * radius / 4.0;
        ThreadMaterial {
            radius,
            mass_per_length: self.density() * area,
            axial_stiffness: young * area,
            bending_stiffness: if self.is_braided() { BRAID * rod } else { rod },
            twisting_stiffness: rod / (1.0 + POISSON),
            friction: self.friction(),
            ..ThreadMaterial::silk_2_0()
        }
    }
}
