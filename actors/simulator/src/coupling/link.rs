//! The link: springs and dampers between points of two bodies.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Points that one link joins at most.
pub const POINTS_MAX: usize = 64;

/// Of what a link is made.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LinkConfig {
    /// Force per stretch of each pair of points \[N/m\].
    pub stiffness: f64,
    /// Force per velocity of stretching \[N·s/m\].
    pub damping: f64,
}

/// Why a link was not made or not stepped; it is as it was before.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum LinkError {
    /// A constant out of range.
    #[error("{what} of a link is {value}: 0 or more and finite is valid")]
    Config {
        /// Which.
        what: &'static str,
        /// What came.
        value: f64,
    },
    /// Too few or too many points.
    #[error("a link of {0} points: 1 to {POINTS_MAX} are valid")]
    Points(usize),
    /// Lists or matrices of another size.
    #[error("{what} for {found} points: the link has {expected}")]
    Size {
        /// What it is.
        what: &'static str,
        /// For how many it came.
        found: usize,
        /// Points there are.
        expected: usize,
    },
    /// A number that is none, or a mobility that is negative.
    #[error("{0} is not a finite number, or a mobility is not that of a mass")]
    Number(&'static str),
    /// A step of no time.
    #[error("a step of {0} s: above 0 and up to 1 s is valid")]
    Step(f64),
}

/// Everything that changes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkState {
    /// Where the faster body's points are from the slower one's without force \[m\].
    pub offsets: Vec<Vector3<f64>>,
    /// How far the springs are stretched beyond \[m\].
    pub stretches: Vec<Vector3<f64>>,
    /// Points of the slower body as the faster one sees them \[m\].
    pub proxies: Vec<Point3<f64>>,
    /// Their velocities \[m/s\].
    pub proxy_velocities: Vec<Vector3<f64>>,
    /// What the slower body has not been given yet \[N·s\].
    pub owed: Vec<Vector3<f64>>,
    /// Energy that may be spent on stretching the springs anew \[J\].
    pub tank: f64,
    /// Sum of the magnitudes of all impulses so far \[N·s\].
    pub exchanged: f64,
}

/// Springs and dampers between points of a faster and of a slower body.
#[derive(Clone, Debug)]
pub struct Link {
    config: LinkConfig,
    state: LinkState,
    /// Velocities per impulse \[1/kg\], three rows to a point: of the faster, of the slower body.
    mobilities: [DMatrix<f64>; 2],
    /// 1 + β W for the step that it is for \[s\].
    factor: Option<(f64, Cholesky<f64, Dyn>)>,
    right: DVector<f64>,
    moved: DVector<f64>,
    after: Vec<Vector3<f64>>,
    impulses: Vec<Vector3<f64>>,
}

fn mobility(matrix: &DMatrix<f64>, points: usize) -> Result<(), LinkError> {
    if matrix.nrows() != 3 * points || matrix.ncols() != 3 * points {
        return Err(LinkError::Size { what: "a mobility", found: matrix.nrows() / 3, expected: points });
    }
    let fits = matrix.iter().all(|x| x.is_finite()) && matrix.diagonal().iter().all(|x| *x >= 0.0);
    if fits { Ok(()) } else { Err(LinkError::Number("a mobility")) }
}

fn finite<'a>(what: &'static str, values: impl Iterator<Item = &'a f64>) -> Result<(), LinkError> {
    values.into_iter().all(|x| x.is_finite()).then_some(()).ok_or(LinkError::Number(what))
}

fn of(values: &DVector<f64>, point: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&values.as_slice()[3 * point..][..3])
}

impl Link {
    /// Joins points where they are now, without force: of the faster body, then of the slower one \[m\]. Mobilities are
    /// the velocities of a body's points per impulse on them \[1/kg\], three rows and columns to a point.
    ///
    /// # Errors
    /// Constants out of range, lists of different lengths, numbers that are none.
    pub fn new(
        config: LinkConfig,
        points: [&[Point3<f64>]; 2],
        slow_velocities: &[Vector3<f64>],
        mobilities: [DMatrix<f64>; 2],
    ) -> Result<Self, LinkError> {
        for (what, value) in [("stiffness", config.stiffness), ("damping", config.damping)] {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(LinkError::Config { what, value });
            }
        }
        let [fast, slow] = points;
        let count = fast.len();
        if !(1..=POINTS_MAX).contains(&count) {
            return Err(LinkError::Points(count));
        }
        let size = |what, found| {
            if found == count { Ok(()) } else { Err(LinkError::Size { what, found, expected: count }) }
        };
        size("places of the slower body", slow.len())?;
        size("velocities of the slower body", slow_velocities.len())?;
        finite("a place", fast.iter().chain(slow).flat_map(|at| at.iter()))?;
        finite("a velocity", slow_velocities.iter().flatten())?;
        mobilities.iter().try_for_each(|matrix| mobility(matrix, count))?;
        let none = vec![Vector3::zeros(); count];
        Ok(Self {
            config,
            state: LinkState {
                offsets: fast.iter().zip(slow).map(|(fast, slow)| fast - slow).collect(),
                stretches: none.clone(),
                proxies: slow.to_vec(),
                proxy_velocities: slow_velocities.to_vec(),
                owed: none.clone(),
                tank: 0.0,
                exchanged: 0.0,
            },
            mobilities,
            factor: None,
            right: DVector::zeros(3 * count),
            moved: DVector::zeros(3 * count),
            after: none.clone(),
            impulses: none,
        })
    }

    /// Everything that changes, to continue from.
    #[must_use]
    pub fn state(&self) -> &LinkState {
        &self.state
    }

    /// Continues from a state, bit for bit.
    ///
    /// # Errors
    /// A state of another link, or with numbers that are none; then everything is as it was.
    pub fn restore(&mut self, state: LinkState) -> Result<(), LinkError> {
        let count = self.impulses.len();
        let LinkState { offsets, stretches, proxies, proxy_velocities, owed, tank, exchanged } = &state;
        for found in [offsets.len(), stretches.len(), proxies.len(), proxy_velocities.len(), owed.len()] {
            if found != count {
                return Err(LinkError::Size { what: "a state", found, expected: count });
            }
        }
        let vectors = offsets.iter().chain(stretches).chain(proxy_velocities).chain(owed).flatten();
        finite("a state", vectors.chain(proxies.iter().flat_map(|at| at.iter())).chain([tank, exchanged]))?;
        if *tank < 0.0 {
            return Err(LinkError::Number("a tank below 0 J"));
        }
        self.state = state;
        Ok(())
    }

    /// Energy of the springs \[J\].
    #[must_use]
    pub fn energy(&self) -> f64 {
        let squares: f64 = self.state.stretches.iter().map(|stretch| stretch.norm_squared()).sum();
        0.5 * self.config.stiffness * squares
    }

    /// The mobilities are others now: a needle has turned.
    ///
    /// # Errors
    /// Of another size, or numbers that are none.
    pub fn set_mobilities(&mut self, fast: &DMatrix<f64>, slow: &DMatrix<f64>) -> Result<(), LinkError> {
        for (own, new) in self.mobilities.iter_mut().zip([fast, slow]) {
            mobility(new, self.impulses.len())?;
            if own != new {
                own.copy_from(new);
                self.factor = None;
            }
        }
        Ok(())
    }

    /// A step of the faster body is due: the impulses on its points \[N·s\], to be taken as a jump of its velocity before
    /// it moves. Its points where they are \[m\], and how they move \[m/s\].
    ///
    /// # Errors
    /// A step of no time, lists of another length, numbers that are none.
    pub fn fast(
        &mut self,
        dt: f64,
        places: &[Point3<f64>],
        velocities: &[Vector3<f64>],
    ) -> Result<&[Vector3<f64>], LinkError> {
        let count = self.impulses.len();
        if !(dt > 0.0 && dt <= 1.0) {
            return Err(LinkError::Step(dt));
        }
        for (what, found) in [("places", places.len()), ("velocities", velocities.len())] {
            if found != count {
                return Err(LinkError::Size { what, found, expected: count });
            }
        }
        finite("a place", places.iter().flat_map(|at| at.iter()))?;
        finite("a velocity", velocities.iter().flatten())?;
        let LinkConfig { stiffness, damping } = self.config;
        let beta = dt * (stiffness * dt + damping);
        if self.factor.as_ref().is_none_or(|(step, _)| *step != dt) {
            let identity = DMatrix::identity(3 * count, 3 * count);
            let matrix = identity + (&self.mobilities[0] + &self.mobilities[1]) * beta;
            self.factor = Some((dt, Cholesky::new(matrix).ok_or(LinkError::Number("a mobility"))?));
        }
        self.stretch_anew(places);
        for (point, velocity) in velocities.iter().enumerate() {
            let closing = velocity - self.state.proxy_velocities[point];
            let force = self.state.stretches[point] * (-dt * stiffness) - closing * beta;
            self.right.as_mut_slice()[3 * point..][..3].copy_from_slice(force.as_slice());
        }
        if let Some((_, factor)) = &self.factor {
            factor.solve_mut(&mut self.right);
        }
        let mut lost = 0.0;
        self.moved.gemv(1.0, &self.mobilities[0], &self.right, 0.0);
        for (point, velocity) in velocities.iter().enumerate() {
            let (impulse, kick) = (of(&self.right, point), of(&self.moved, point));
            self.impulses[point] = impulse;
            self.after[point] = velocity + kick;
            self.state.owed[point] -= impulse;
            self.state.exchanged += impulse.norm();
            lost += 0.5 * impulse.dot(&kick);
        }
        self.moved.gemv(1.0, &self.mobilities[1], &self.right, 0.0);
        for (point, after) in self.after.iter().enumerate() {
            let kick = of(&self.moved, point);
            lost += 0.5 * self.impulses[point].dot(&kick);
            self.state.proxy_velocities[point] -= kick;
            let proxy = self.state.proxy_velocities[point];
            let opening = after - proxy;
            lost += (dt * damping + 0.5 * dt * dt * stiffness) * opening.norm_squared();
            self.state.stretches[point] += opening * dt;
            self.state.proxies[point] += proxy * dt;
        }
        self.state.tank += lost;
        Ok(&self.impulses)
    }

    /// Stretches the springs to where the points are, as far as the tank can pay for it.
    fn stretch_anew(&mut self, places: &[Point3<f64>]) {
        let (mut along, mut square) = (0.0, 0.0);
        for (point, place) in places.iter().enumerate() {
            let apart = self.apart(point, place);
            along += self.state.stretches[point].dot(&apart);
            square += apart.norm_squared();
        }
        let stiffness = self.config.stiffness;
        let cost = |share: f64| stiffness * share * (along + 0.5 * share * square);
        let mut share = 1.0;
        if cost(1.0) > self.state.tank {
            // The cost is a parabola through the origin: its larger root.
            let root = (along * along + 2.0 * self.state.tank * square / stiffness).sqrt();
            share = ((root - along) / square).clamp(0.0, 1.0);
        }
        for (point, place) in places.iter().enumerate() {
            let apart = self.apart(point, place);
            self.state.stretches[point] += apart * share;
        }
        self.state.tank = (self.state.tank - cost(share)).max(0.0);
    }

    /// How much further apart two points are than their spring is stretched \[m\].
    fn apart(&self, point: usize, place: &Point3<f64>) -> Vector3<f64> {
        place - self.state.proxies[point] - self.state.offsets[point] - self.state.stretches[point]
    }

    /// A step of the slower body is due: the impulses on its points \[N·s\], all that the faster one was given since the
    /// last time with the opposite sign, to be taken as a jump of its velocity before it moves.
    pub fn slow(&mut self, impulses: &mut Vec<Vector3<f64>>) {
        impulses.clone_from(&self.state.owed);
        self.state.owed.fill(Vector3::zeros());
    }

    /// The slower body has moved: its points where they are \[m\], and how they move \[m/s\].
    ///
    /// # Errors
    /// Lists of another length, numbers that are none.
    pub fn moved(&mut self, places: &[Point3<f64>], velocities: &[Vector3<f64>]) -> Result<(), LinkError> {
        let expected = self.impulses.len();
        for (what, found) in [("places", places.len()), ("velocities", velocities.len())] {
            if found != expected {
                return Err(LinkError::Size { what, found, expected });
            }
        }
        finite("a place", places.iter().flat_map(|at| at.iter()))?;
        finite("a velocity", velocities.iter().flatten())?;
        self.state.proxies.copy_from_slice(places);
        self.state.proxy_velocities.copy_from_slice(velocities);
        Ok(())
    }
}
