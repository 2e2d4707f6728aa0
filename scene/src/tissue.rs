//! What has been measured of tissues: values, the range in which others found them, and where that is written.
//!
//! A line `tissue = "liver"` at an entity fills in what its components leave open of these parameters, and a value outside
//! the range is told. Where a source gives a shear modulus G, Young's modulus is 3 G, as of what keeps its volume.

/// One property of a tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissueParameter {
    /// The key by which components have it.
    pub name: &'static str,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
    /// What is taken where a scenario says nothing else.
    pub value: f64,
    /// Between which values it has been found.
    pub range: [f64; 2],
    /// How, of whom, and by whom.
    pub source: &'static str,
}

/// A tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissueEntry {
    /// By which scenarios call it.
    pub name: &'static str,
    /// What is known of it.
    pub parameters: &'static [TissueParameter],
}

const ARDA: &str = "shear-wave elastography of 127 healthy volunteers, mean and one deviation (Arda et al. 2011, Am. J. \
                    Roentgenol. 197)";
const MANCIA: &str = "collected by Mancia et al. 2019, Phys. Med. Biol. 64";

const fn young(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "young_modulus", unit: "Pa", value, range, source }
}

const fn density(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "density", unit: "kg/m³", value, range, source }
}

/// Tissue is mostly water, which keeps its volume.
const POISSON: TissueParameter = TissueParameter {
    name: "poisson_ratio",
    unit: "",
    value: 0.45,
    range: [0.4, 0.5],
    source: "nearly 0.5, as water keeps its volume; linear tetrahedra lock above 0.45 (Hughes 2000, §4.4)",
};

/// All tissues, by name.
pub const TISSUES: &[TissueEntry] = &[
    TissueEntry {
        name: "artery",
        parameters: &[
            young(
                6.3e5,
                [4.9e5, 7.7e5],
                "hepatic artery, shear modulus 210 ± 47 kPa (Holzapfel et al. 2005; collected by Mancia et al. 2019, Phys. Med. \
                 Biol. 64)",
            ),
            POISSON,
            density(1050.0, [1050.0, 1075.0], MANCIA),
        ],
    },
    TissueEntry {
        name: "gallbladder",
        parameters: &[
            young(
                2.55e5,
                [2.3e5, 2.8e5],
                "wall, shear modulus 85 ± 8.2 kPa (Karimi et al. 2017; collected by Mancia et al. 2019, Phys. Med. Biol. 64)",
            ),
            POISSON,
            density(1060.0, [1050.0, 1080.0], MANCIA),
        ],
    },
    TissueEntry { name: "kidney", parameters: &[young(5.0e3, [2.1e3, 7.9e3], ARDA), POISSON] },
    TissueEntry {
        name: "liver",
        parameters: &[
            young(
                4.74e3,
                [2.7e3, 7.8e3],
                "shear-wave elastography of 115 healthy people, mean and extremes (Dhar, Gupta, Gupta 2020, Int. J. Med. \
                 Res. Rev.)",
            ),
            POISSON,
            density(1060.0, [1050.0, 1080.0], MANCIA),
            TissueParameter {
                name: "conductivity",
                unit: "W/(m·K)",
                value: 0.52,
                range: [0.42, 0.62],
                source: "IT'IS tissue database; measurements of bovine liver differ by up to 40 % (Materials 2021, 14:3750)",
            },
            TissueParameter {
                name: "heat_capacity",
                unit: "J/(kg·K)",
                value: 3540.0,
                range: [3300.0, 3800.0],
                source: "IT'IS tissue database",
            },
        ],
    },
    TissueEntry { name: "muscle", parameters: &[young(1.04e4, [6.7e3, 1.41e4], ARDA), POISSON] },
    TissueEntry { name: "pancreas", parameters: &[young(4.8e3, [1.8e3, 7.8e3], ARDA), POISSON] },
    TissueEntry {
        name: "spleen",
        parameters: &[
            young(
                2.9e3,
                [1.1e3, 2.3e4],
                "2.9 ± 1.8 kPa (Arda et al. 2011, Am. J. Roentgenol. 197) to 23 kPa by another device (Viceconti et al. 2025, World \
                 J. Radiol. 17)",
            ),
            POISSON,
        ],
    },
    TissueEntry {
        name: "stomach",
        parameters: &[
            young(
                1.9e3,
                [1.9e3, 4e5],
                "pressed a little: shear modulus 637 Pa (Lim et al. 2009; collected by Mancia et al. 2019, Phys. Med. Biol. 64); \
                 its wall drawn by a fifth to two thirds bears 16 to 200 kPa (Bauer et al. 2020, Acta Biomater. 102)",
            ),
            POISSON,
            density(1058.0, [1040.0, 1090.0], MANCIA),
        ],
    },
];

/// A tissue by its name.
#[must_use]
pub fn tissue(name: &str) -> Option<&'static TissueEntry> {
    TISSUES.iter().find(|tissue| tissue.name == name)
}

impl TissueEntry {
    /// What is known of a property.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&'static TissueParameter> {
        self.parameters.iter().find(|parameter| parameter.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_is_within_its_range_and_says_where_it_is_from() {
        assert!(TISSUES.is_sorted_by_key(|tissue| tissue.name));
        for tissue in TISSUES {
            assert!(tissue.parameter("young_modulus").is_some(), "{}", tissue.name);
            for TissueParameter { name, value, range: [low, high], source, .. } in tissue.parameters {
                assert!(low < high && (low..=high).contains(&value), "{} {name}", tissue.name);
                assert!(source.len() > 15, "{} {name}", tissue.name);
            }
        }
        assert_eq!(tissue("granite"), None);
    }
}
