//! Resistance of tissue to needle and thread, besides its elasticity.

use serde::{Deserialize, Serialize};

use super::SutureError;

/// Forces of puncture, passage and exit. The force on a needle is decomposed as in Okamura, Simone, O'Leary (2004,
/// *Force modeling for needle insertion into soft tissue*): stiffness until the surface is punctured, then cutting at
/// the tip and friction along the shaft. Frick, Marucci, Cartmill, Martin, Walsh (2001, *Resistance forces acting on
/// suture needles*) measured two peaks, one at either surface, and no dependence on speed from 1 to 10 mm/s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Resistance {
    /// Puncture force of the surface from outside \[N\].
    pub puncture_force: f64,
    /// Puncture force of the surface from inside \[N\].
    pub exit_force: f64,
    /// Cutting force at the tip inside the tissue \[N\].
    pub cutting_force: f64,
    /// Friction along the needle without lateral load, per length \[N/m\].
    pub needle_grip: f64,
    /// The same along the thread \[N/m\].
    pub thread_grip: f64,
    /// Coulomb's friction coefficient of the needle, for lateral forces.
    pub needle_friction: f64,
    /// The same of the thread.
    pub thread_friction: f64,
    /// Spacing of channel points \[m\].
    pub spacing: f64,
}

impl Default for Resistance {
    /// Soft tissue, a taper-point needle of 0.6 mm and a braided thread. Measured values, and the reasons for the
    /// choices:
    ///
    /// | | Here | Measured |
    /// |---|---|---|
    /// | `puncture_force` | 0.6 N | 0.48 to 1.00 N for suture needles in human skin, growing with their diameter (Maloney, Potter, Chun, Montilla, Schanbacher, *Comparative analysis of taper point and reverse cutting needles on skin puncture force*); organs are softer |
    /// | `exit_force` | 0.4 N | chosen: that there is a second peak, at the surface from inside, is in Frick et al. |
    /// | `cutting_force` | 0.2 N | chosen, a third of the puncture: tearing is 0.6 of all that a needle meets on its way (Barnett, Lee, Moore 2015, *Fracture mechanics model of needle cutting tissue*) |
    /// | `needle_grip` | 15 N/m | chosen |
    /// | `thread_grip` | 20 N/m | 23 to 33 N/m for 6-0 polyglactin in human sclera (PMID 28989101) |
    /// | `needle_friction` | 0.1 | 0.007 to 0.054 of steel on the inside of small bowel (Lyle et al. 2013, *Tribology Letters* 51); chosen above, as tissue grips what pierces it |
    /// | `thread_friction` | 0.2 | 0.05 to 0.13 for coated and sheathed braids (PMC2796445); silk, which has more, is not among them |
    ///
    /// For skin, use about 1.0, 0.7, 0.5 N, 20 and 30 N/m. Sutures tear out of bowel at some 4.6 N (Gong et al. 2023).
    fn default() -> Self {
        Self {
            puncture_force: 0.6,
            exit_force: 0.4,
            cutting_force: 0.2,
            needle_grip: 15.0,
            thread_grip: 20.0,
            needle_friction: 0.1,
            thread_friction: 0.2,
            spacing: 1e-3,
        }
    }
}

impl Resistance {
    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// The first parameter out of range, and its range.
    pub fn check(&self) -> Result<(), SutureError> {
        let forces = [
            ("puncture_force", self.puncture_force),
            ("exit_force", self.exit_force),
            ("cutting_force", self.cutting_force),
        ];
        let grips = [("needle_grip", self.needle_grip), ("thread_grip", self.thread_grip)];
        let frictions =
            [("needle_friction", self.needle_friction), ("thread_friction", self.thread_friction)];
        let within = |what, value: f64, most: f64, valid| {
            if value >= 0.0 && value <= most {
                Ok(())
            } else {
                Err(SutureError::Number { what, value, valid })
            }
        };
        for (what, value) in forces {
            within(what, value, 1e6, "0 to 1e6 N")?;
        }
        for (what, value) in grips {
            within(what, value, 1e5, "0 to 1e5 N/m")?;
        }
        for (what, value) in frictions {
            within(what, value, 2.0, "0 to 2")?;
        }
        if self.cutting_force > self.puncture_force {
            let (what, value) = ("cutting_force", self.cutting_force);
            return Err(SutureError::Number { what, value, valid: "at most the puncture force" });
        }
        if !(1e-4..=1e-2).contains(&self.spacing) {
            let (what, value) = ("spacing", self.spacing);
            return Err(SutureError::Number { what, value, valid: "0.1 to 10 mm" });
        }
        Ok(())
    }
}
