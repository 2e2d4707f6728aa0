//! Material parameters of tissues: measured values, ranges from the literature, and sources.
//!
//! A line `tissue = "liver"` at an entity fills in those of these parameters that its components omit, and a value
//! outside the range is reported. Where a source gives a shear modulus G, Young's modulus is 3 G, as for incompressible
//! material.

/// One property of a tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissueParameter {
    /// Key of the parameter in components.
    pub name: &'static str,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
    /// Default value.
    pub value: f64,
    /// Published range.
    pub range: [f64; 2],
    /// Source: method, sample and publication.
    pub source: &'static str,
}

/// A tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissueEntry {
    /// Name in scenarios.
    pub name: &'static str,
    /// Its parameters.
    pub parameters: &'static [TissueParameter],
}

const ARDA: &str = "shear-wave elastography of 127 healthy volunteers, mean and one deviation (Arda et al. 2011, Am. J. \
                    Roentgenol. 197)";
const MANCIA: &str = "collected by Mancia et al. 2019, Phys. Med. Biol. 64; the range holds that of the IT'IS Foundation tissue \
                      database";

const ITIS: &str = "IT'IS Foundation tissue database 4 (Hasgall et al. 2018)";
const SPREAD: &str = "IT'IS Foundation tissue database 4 (Hasgall et al. 2018); the range is what samples of one organ \
                      differ by, rounded (Duck 1990, Physical Properties of Tissue)";
const FLOW: &str = "at rest, from the flow by mass of the IT'IS Foundation tissue database 4 (Hasgall et al. 2018); half to \
                    twice that as the body needs";
const COTTON: &str =
    "its cotton fibre (Bledzki, Gassan 1999, Prog. Polym. Sci. 24); a sheet has a mass by area";
const DENATURED: &str = "as liver's (Kim et al. 1996), for want of a fit of its own; it belongs to its energy, so that change \
                         both or none";
const PYROLYSED: &str = "cellulose (Shafizadeh 1982, J. Anal. Appl. Pyrolysis 3): it browns and chars from 250 °C on, slowly from \
                         200, and goes up as tar and gas from 300 to 400";
const BROWNED: &str = "dry protein browns from 150 °C on and is carbon by 300 °C (Welch, van Gemert 2011, Optical-Thermal \
                       Response of Laser-Irradiated Tissue)";
const VAPORISED: &str = "proteins and fats go up in smoke from 300 to 500 °C (Welch, van Gemert 2011, Optical-Thermal Response of \
                         Laser-Irradiated Tissue)";
const WET: &str = "share of the mass, rounded (Duck 1990, Physical Properties of Tissue)";

const fn young(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "young_modulus", unit: "Pa", value, range, source }
}

const fn density(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "density", unit: "kg/m³", value, range, source }
}

/// Bioheat parameters: conductivity \[W/(m·K)\] and heat capacity \[J/(kg·K)\] with their ranges, blood perfusion
/// \[1/s\], mass fraction of water.
const fn conductivity(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "conductivity", unit: "W/(m·K)", value, range, source }
}

const fn heat_capacity(value: f64, range: [f64; 2]) -> TissueParameter {
    TissueParameter { name: "heat_capacity", unit: "J/(kg·K)", value, range, source: SPREAD }
}

const fn perfusion(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "perfusion", unit: "1/s", value, range, source }
}

const fn water(value: f64, range: [f64; 2]) -> TissueParameter {
    TissueParameter { name: "water", unit: "", value, range, source: WET }
}

/// Thermal damage kinetics (Arrhenius), and temperatures of charring and vaporisation of dry tissue.
const fn damage_frequency(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "damage_frequency", unit: "1/s", value, range, source }
}

const fn damage_energy(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "damage_energy", unit: "J/mol", value, range, source }
}

const fn charring(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "charring", unit: "°C", value, range, source }
}

const fn ablation(value: f64, range: [f64; 2], source: &'static str) -> TissueParameter {
    TissueParameter { name: "ablation", unit: "°C", value, range, source }
}

/// Tissue is mostly water, which is nearly incompressible.
const POISSON: TissueParameter = TissueParameter {
    name: "poisson_ratio",
    unit: "",
    value: 0.45,
    range: [0.4, 0.5],
    source: "nearly 0.5, as water keeps its volume; linear tetrahedra lock above 0.45 (Hughes 2000, ch. 4)",
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
            density(1050.0, [1040.0, 1102.0], MANCIA),
            conductivity(0.46, [0.4, 0.55], SPREAD),
            heat_capacity(3306.0, [3100.0, 3700.0]),
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
            conductivity(0.52, [0.42, 0.62], SPREAD),
            heat_capacity(3716.0, [3400.0, 3900.0]),
            perfusion(0.00054, [0.00027, 0.0011], FLOW),
        ],
    },
    TissueEntry {
        name: "gauze",
        parameters: &[
            young(
                8.0e9,
                [5.5e9, 1.26e10],
                "its cotton fibre, drawn (Bledzki, Gassan 1999, Prog. Polym. Sci. 24); a sheet of it is told by the stiffness of \
                 its weave, which gives way long before",
            ),
            density(1540.0, [1500.0, 1600.0], COTTON),
            conductivity(
                0.24,
                [0.07, 0.5],
                "chosen between a pad of its cotton fibre, 0.07 as air is between, and the 0.5 that is told of the fibre (Morton, Hearle \
                 2008, Physical Properties of Textile Fibres, §6.2), which is too high by Baxter 1946, Proc. Phys. Soc. 58",
            ),
            TissueParameter {
                name: "heat_capacity",
                unit: "J/(kg·K)",
                value: 1280.0,
                range: [1220.0, 1350.0],
                source: "its cotton fibre, dry (Morton, Hearle 2008, Physical Properties of Textile Fibres, table 6.1)",
            },
            perfusion(0.0, [0.0, 0.0], "no blood passes through it"),
            TissueParameter {
                name: "water",
                unit: "",
                value: 0.07,
                range: [0.0, 0.9],
                source: "dry in air of 65 % humidity: 7 to 8 % of its dry mass (Morton, Hearle 2008, Physical Properties of \
                         Textile Fibres); soaked it holds many times its own mass",
            },
            damage_frequency(0.0, [0.0, 0.0], "cellulose does not denature: it chars"),
            damage_energy(2.577e5, [0.0, 1e7], "of no account, as its frequency is none"),
            charring(250.0, [200.0, 300.0], PYROLYSED),
            ablation(350.0, [300.0, 400.0], PYROLYSED),
        ],
    },
    TissueEntry {
        name: "kidney",
        parameters: &[
            young(5.0e3, [2.1e3, 7.9e3], ARDA),
            POISSON,
            density(1066.0, [1025.0, 1100.0], ITIS),
            conductivity(0.53, [0.45, 0.6], SPREAD),
            heat_capacity(3763.0, [3500.0, 3950.0]),
            perfusion(0.067, [0.034, 0.13], FLOW),
            water(0.79, [0.76, 0.84]),
        ],
    },
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
            density(1079.0, [1050.0, 1160.0], ITIS),
            conductivity(
                0.52,
                [0.42, 0.62],
                "IT'IS tissue database; measurements of bovine liver differ by up to 40 % (Materials 2021, 14:3750)",
            ),
            heat_capacity(3540.0, [3300.0, 3800.0]),
            perfusion(
                0.0064,
                [0.0055, 0.018],
                "as models of ablation take it (Tungjitkusolmun et al. 2002, IEEE Trans. Biomed. Eng. 49); awake it is up to \
                 0.016 (IT'IS tissue database)",
            ),
            water(0.7, [0.68, 0.78]),
            damage_frequency(
                7.39e39,
                [1e37, 1e42],
                "Kim et al. 1996; fits differ by orders of magnitude and belong to their energy, so that change both or none",
            ),
            damage_energy(
                2.577e5,
                [2.4e5, 2.75e5],
                "Kim, Jacques, Rastegar, Thomsen, Motamedi 1996, IEEE J. Sel. Top. Quantum Electron. 2; the range is the one in which \
                 its frequency makes sense",
            ),
            charring(200.0, [150.0, 300.0], BROWNED),
            ablation(400.0, [300.0, 500.0], VAPORISED),
        ],
    },
    TissueEntry {
        name: "muscle",
        parameters: &[
            young(1.04e4, [6.7e3, 1.41e4], ARDA),
            POISSON,
            density(1090.0, [1040.0, 1180.0], ITIS),
            conductivity(0.49, [0.42, 0.56], SPREAD),
            heat_capacity(3421.0, [2600.0, 3800.0]),
            perfusion(
                0.00067,
                [0.0003, 0.01],
                "at rest as of the IT'IS tissue database; at work it is more than ten times that",
            ),
            water(0.75, [0.7, 0.79]),
        ],
    },
    TissueEntry {
        name: "pancreas",
        parameters: &[
            young(4.8e3, [1.8e3, 7.8e3], ARDA),
            POISSON,
            density(1087.0, [1040.0, 1130.0], ITIS),
            conductivity(0.51, [0.43, 0.59], SPREAD),
            heat_capacity(3164.0, [3000.0, 3600.0]),
            perfusion(0.0139, [0.007, 0.028], FLOW),
            water(0.73, [0.66, 0.78]),
        ],
    },
    TissueEntry {
        name: "peritoneum",
        parameters: &[
            young(
                1.9e5,
                [6.3e4, 6.9e6],
                "fold to the gut, of rabbits, little strained: shear modulus 21 to 186 kPa as it is drawn beforehand, their \
                 geometric mean (Fung, Zweifach, Intaglietta 1966, Circ. Res. 19); drawn towards breaking, of pigs, up to \
                 6.9 MPa (White et al. 2018, Proc. Inst. Mech. Eng. H)",
            ),
            POISSON,
            density(
                1100.0,
                [911.0, 1142.0],
                "from fat, which lies between its leaves, to tendon, whose collagen it is of (IT'IS Foundation tissue database 4, \
                 Hasgall et al. 2018)",
            ),
            conductivity(
                0.47,
                [0.21, 0.5],
                "as the collagen of a tendon; fat between its leaves lowers it (IT'IS Foundation tissue database 4, Hasgall et al. \
                 2018)",
            ),
            TissueParameter {
                name: "heat_capacity",
                unit: "J/(kg·K)",
                value: 3432.0,
                range: [2348.0, 3500.0],
                source: "as the collagen of a tendon; fat between its leaves lowers it (IT'IS Foundation tissue database 4, \
                         Hasgall et al. 2018)",
            },
            perfusion(
                0.00055,
                [0.00027, 0.002],
                "as a tendon at rest, to what skin gets (flows by mass of the IT'IS Foundation tissue database 4, Hasgall et al. \
                 2018)",
            ),
            TissueParameter {
                name: "water",
                unit: "",
                value: 0.65,
                range: [0.55, 0.75],
                source: "share of the mass in tendon and skin, rounded (Duck 1990, Physical Properties of Tissue)",
            },
            damage_frequency(7.39e39, [1e37, 1e42], DENATURED),
            damage_energy(2.577e5, [2.4e5, 2.75e5], DENATURED),
            charring(200.0, [150.0, 300.0], BROWNED),
            ablation(400.0, [300.0, 500.0], VAPORISED),
        ],
    },
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
            density(1089.0, [1050.0, 1175.0], ITIS),
            conductivity(0.53, [0.45, 0.6], SPREAD),
            heat_capacity(3596.0, [3400.0, 3800.0]),
            perfusion(0.0283, [0.014, 0.057], FLOW),
            water(0.78, [0.75, 0.81]),
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
            conductivity(0.53, [0.45, 0.6], SPREAD),
            heat_capacity(3690.0, [3400.0, 3900.0]),
            perfusion(0.0083, [0.0042, 0.017], FLOW),
        ],
    },
];

/// A tissue by its name.
#[must_use]
pub fn tissue(name: &str) -> Option<&'static TissueEntry> {
    TISSUES.iter().find(|tissue| tissue.name == name)
}

impl TissueEntry {
    /// A parameter by its key.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&'static TissueParameter> {
        self.parameters.iter().find(|parameter| parameter.name == name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_burns_has_what_heat_meets() {
        for organ in ["gauze", "kidney", "liver", "muscle", "pancreas", "peritoneum", "spleen"] {
            for name in ["density", "conductivity", "heat_capacity", "perfusion", "water"] {
                assert!(tissue(organ).is_some_and(|of| of.parameter(name).is_some()), "{organ} {name}");
            }
        }
    }

    #[test]
    fn every_value_is_within_its_range_and_says_where_it_is_from() {
        assert!(TISSUES.is_sorted_by_key(|tissue| tissue.name));
        for tissue in TISSUES {
            assert!(tissue.parameter("young_modulus").is_some(), "{}", tissue.name);
            for TissueParameter { name, value, range: [low, high], source, .. } in tissue.parameters {
                // Only an absent property has an empty range.
                assert!(low < high || [*low, *high] == [0.0; 2], "{} {name}", tissue.name);
                assert!((low..=high).contains(&value), "{} {name}", tissue.name);
                assert!(source.len() > 15, "{} {name}", tissue.name);
            }
        }
        assert_eq!(tissue("granite"), None);
        // A tissue with its own damage kinetics gives all parameters, so that none falls back to liver's.
        for name in ["damage_frequency", "damage_energy", "charring", "ablation"] {
            assert!(
                ["gauze", "liver", "peritoneum"]
                    .iter()
                    .all(|of| tissue(of).is_some_and(|of| of.parameter(name).is_some()))
            );
        }
    }
}
