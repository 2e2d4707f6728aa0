//! Constraints of a linear organ: pinned points, vertices held by jaws, and patches pressed by rods.
//!
//! A load on a single vertex feels stiffer the coarser the mesh is, so each point that a rod touches stands for a patch
//! around it. Its position and push direction are found on the rest shape, with the rod transformed by the displacement
//! of the patch. On the deformed surface, which is coarse, the point nearest to a rod would jump while the rod is
//! pressed in, and so would the force.

use nalgebra::{Point3, Unit, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use trocar_collision::primitive::{closest_on_segment, closest_on_triangle};
use trocar_dynamics::picking::Jaws;
use trocar_dynamics::soft_body::bearing::rigid_response::PlaneContact;
use trocar_dynamics::soft_body::grasp::Holder;
use trocar_dynamics::soft_body::instrument_rods::Rod;
use trocar_dynamics::soft_body::method::StepContext;
use trocar_dynamics::soft_body::rod_contact::{ContactSurface, RodContact, touches};
use trocar_scene::{Commands, Component, Entity, RecordPolicy};

use super::Body;
use crate::linear_fem::{Attachment, Hold, LinearFemError, patch};

/// Distance from a rod within which the surface is already checked, so that a resting contact is not lost by rounding
/// \[m\].
const MARGIN: f64 = 1e-3;
/// Maximum number of contact points at once; the deepest are kept.
const CONTACTS_MAX: usize = 96;
/// Tolerated penetration depth \[m\].
const PENETRATION_MAX: f64 = 1e-5;
/// Minimum distance between patches of one rod, relative to their radius.
const PATCHES_APART: f64 = 1.0;
/// A surface point that an instrument pressed on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PressedPoint {
    /// The instrument.
    pub instrument: u64,
    /// Corners of the triangle; one vertex three times for a vertex.
    pub nodes: [u32; 3],
    /// Barycentric weights of the point: each in \[0, 1\], their sum 1.
    pub weights: [f64; 3],
}

/// Points that rods pressed on in the last tick; a restart continues with them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "linear_fem_contacts", record = RecordPolicy::sampled(10.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct Contacts {
    /// In the order of detection.
    pub places: Vec<PressedPoint>,
}

impl Contacts {
    /// Saves the centres of loaded patches.
    pub(crate) fn keep(&mut self, answers: &[ConstraintReaction], rods: &[Rod], contact_radius: f64) {
        self.places.clear();
        let borne = answers.iter().filter(|answer| contact_radius > 0.0 && answer.force != Vector3::zeros());
        self.places.extend(borne.filter_map(|answer| {
            let ConstraintSource::RodContact(touch) = &answer.by else { return None };
            let instrument = rods[touch.rod].instrument.to_bits();
            Some(PressedPoint { instrument, nodes: touch.nodes, weights: touch.weights })
        }));
    }
}

/// One constraint on the surface, and its force.
pub(crate) struct ConstraintReaction {
    pub attachment: Attachment,
    /// Prescribed mean displacement, from rest \[m\].
    pub target: Vector3<f64>,
    /// Of a patch: how far its mean displacement lags behind that of its centre, the contact point \[m\].
    pub lag: f64,
    pub by: ConstraintSource,
    /// On the body \[N\].
    pub force: Vector3<f64>,
}

pub(crate) enum ConstraintSource {
    /// A rod contact.
    RodContact(RodContact),
    /// A vertex held by an instrument's jaws.
    Jaws(Entity, u32),
    /// A pinned point, by its number.
    Pin(usize),
    /// A rigid body that moves, by the number of its contact in the step.
    Body(usize),
}

impl Body {
    /// The current constraints, persistent ones first: pinned points, held vertices, rod contacts.
    pub(crate) fn collect_constraints(
        &mut self,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Vec<ConstraintReaction>, String> {
        let rods = site.rods;
        let triangles = self.body.triangles.clone();
        let mut touched = Vec::new();
        let skin = ContactSurface {
            positions: &self.positions,
            triangles: &triangles,
            segments: &[],
            thickness: MARGIN,
            closed: true,
        };
        touches(rods, &skin, 0.0, &mut touched);
        let holders = Holder::all(site, &touched, &triangles);
        let jaws: Vec<Jaws<'_>> = holders.iter().map(Holder::jaws).collect();
        self.hold(&jaws, site, out)?;
        let mut answers = Vec::new();
        self.pins.record_points(site.scene, site.world_from_body);
        let altered = self.divisible.as_ref().map(|(_, altered)| altered);
        let is_gone = |tet| altered.is_some_and(|altered| altered.is_gone(tet));
        let driven = self.pins.driven(site.scene, site.world_from_body, &self.mesh, is_gone);
        answers.extend(driven.map(|(number, attachment, target)| ConstraintReaction {
            attachment,
            target,
            lag: 0.0,
            by: ConstraintSource::Pin(number),
            force: Vector3::zeros(),
        }));
        for pick in &self.grips.picks.picks {
            let Some(jaw) = jaws.iter().find(|jaw| jaw.instrument == pick.instrument) else { continue };
            for held in pick.vertices.iter().filter(|held| !self.is_pinned[held.vertex as usize]) {
                let target =
                    jaw.body_from_instrument * held.in_instrument - self.body.rest[held.vertex as usize];
                answers.push(ConstraintReaction {
                    attachment: Attachment::node(held.vertex, Hold::Point),
                    target,
                    lag: 0.0,
                    by: ConstraintSource::Jaws(Entity::from_bits(pick.instrument), held.vertex),
                    force: Vector3::zeros(),
                });
            }
        }
        touched.retain(|touch| self.can_be_pushed(touch, rods));
        touched.sort_by(|a, b| b.depth.total_cmp(&a.depth));
        touched.truncate(CONTACTS_MAX);
        self.continue_contacts(rods, &mut answers);
        self.add_rod_constraints(&touched, rods, &mut answers);
        let room = CONTACTS_MAX.saturating_sub(answers.len());
        let borne = site.rigid.contacts.iter().take(room).enumerate();
        answers.extend(borne.map(|(number, press)| self.body_constraint(number, press, site)));
        Ok(answers)
    }

    /// A constraint that keeps a surface point outside a rigid body, which gives way.
    pub(super) fn body_constraint(
        &self,
        number: usize,
        press: &PlaneContact,
        site: &StepContext<'_>,
    ) -> ConstraintReaction {
        let ([a, b, c], [u, v, w]) = (press.nodes, press.weights);
        let weights = if a == b { vec![(a, 1.0)] } else { vec![(a, u), (b, v), (c, w)] };
        let rest = weights.iter().map(|&(node, weight)| self.body.rest[node as usize].coords * weight);
        let now = press.place(&self.positions) - rest.sum::<Vector3<f64>>();
        let step = site.period_secs();
        // `M⁻¹/² h` times its motion: the product of two of these is what a force on one moves the other.
        let factor = site.rigid.inertia(press.body as usize, step).cholesky();
        let motion = factor.and_then(|factor| factor.l().solve_lower_triangular(&press.motion()));
        let (along, compliance) = (Unit::new_unchecked(press.normal), press.stiffness.recip());
        let motion = motion.unwrap_or_else(Vector6::zeros).into();
        ConstraintReaction {
            target: now + press.normal * site.rigid.free_depth(press, step),
            lag: 0.0,
            attachment: Attachment {
                weights,
                hold: Hold::AtLeastOnBody { along, compliance, body: press.body, motion },
            },
            by: ConstraintSource::Body(number),
            force: Vector3::zeros(),
        }
    }

    /// Adds contacts of rods elsewhere on the surface.
    pub(crate) fn collect_more_contacts(&self, rods: &[Rod], answers: &mut Vec<ConstraintReaction>) {
        let mut touched = Vec::new();
        let triangles = &self.body.triangles;
        touches(
            rods,
            &ContactSurface {
                positions: &self.positions,
                triangles,
                segments: &[],
                thickness: 0.0,
                closed: true,
            },
            0.0,
            &mut touched,
        );
        touched.retain(|touch| touch.depth > PENETRATION_MAX && self.can_be_pushed(touch, rods));
        touched.truncate(CONTACTS_MAX.saturating_sub(answers.len()));
        self.add_rod_constraints(&touched, rods, answers);
    }

    /// Jaws that hold do not push as well, and a held vertex cannot be pushed.
    fn can_be_pushed(&self, touch: &RodContact, rods: &[Rod]) -> bool {
        let holds = self.grips.picks.of(rods[touch.rod].instrument.to_bits()).is_some();
        !holds && touch.nodes.iter().any(|&node| !self.is_pinned[node as usize])
    }

    /// Rest and current position of a surface point \[m\].
    fn place(&self, nodes: &[u32; 3], weights: &[f64; 3]) -> [Point3<f64>; 2] {
        [&self.body.rest[..], &self.positions].map(|points| {
            let corners =
                nodes.iter().zip(weights).map(|(&node, weight)| points[node as usize].coords * *weight);
            Point3::from(corners.sum::<Vector3<f64>>())
        })
    }

    /// Continues the contacts of the last tick, at their new positions.
    fn continue_contacts(&self, rods: &[Rod], answers: &mut Vec<ConstraintReaction>) {
        for known in &self.contacts.places {
            let now = self.place(&known.nodes, &known.weights)[1];
            let own = rods.iter().enumerate().filter(|(_, rod)| rod.instrument.to_bits() == known.instrument);
            let away = |rod: &Rod| {
                let along = closest_on_segment(&now, &rod.ends);
                (rod.ends[0].lerp(&rod.ends[1], along) - now).norm() - rod.radius
            };
            let Some((rod, _)) = own.min_by(|a, b| away(a.1).total_cmp(&away(b.1))) else { continue };
            let Some(touch) = self.pressed(rod, rods, &known.nodes, &known.weights) else { continue };
            if touch.depth > -MARGIN && self.can_be_pushed(&touch, rods) && !self.is_covered(&touch, answers)
            {
                answers.push(self.rod_constraint(touch, rods));
            }
        }
    }

    /// The contact point and push direction of a rod last seen pressing on or near another point, found on the rest
    /// shape.
    fn pressed(
        &self,
        index: usize,
        rods: &[Rod],
        nodes: &[u32; 3],
        weights: &[f64; 3],
    ) -> Option<RodContact> {
        let rod = &rods[index];
        let [rest, now] = self.place(nodes, weights);
        let along = closest_on_segment(&now, &rod.ends);
        let on_axis = rod.ends[0].lerp(&rod.ends[1], along);
        let from_rest = on_axis - (now - rest);
        let nearest = self.body.triangles.iter().enumerate().map(|(element, nodes)| {
            let nearest = closest_on_triangle(&from_rest, &nodes.map(|node| self.body.rest[node as usize]));
            (element, nearest.weights, from_rest - nearest.point)
        });
        let nearest = nearest.min_by(|a, b| a.2.norm_squared().total_cmp(&b.2.norm_squared()));
        let (element, weights, away) = nearest?;
        let nodes = self.body.triangles[element];
        let [a, b, c] = nodes.map(|node| self.body.rest[node as usize]);
        let outward = (b - a).cross(&(c - a)).try_normalize(0.0)?;
        let distance = away.norm() * if away.dot(&outward) < 0.0 { -1.0 } else { 1.0 };
        let outward = if distance.abs() > 1e-6 { away / distance } else { outward };
        let velocity = rod.velocities[0].lerp(&rod.velocities[1], along);
        let (normal, depth, element) = (-outward, rod.radius - distance, Some(element as u32));
        Some(RodContact { rod: index, nodes, weights, normal, depth, velocity, on_axis, element })
    }

    /// Whether another patch of the same rod covers this point.
    fn is_covered(&self, touch: &RodContact, answers: &[ConstraintReaction]) -> bool {
        let [place, _] = self.place(&touch.nodes, &touch.weights);
        answers.iter().any(|answer| match &answer.by {
            ConstraintSource::RodContact(other) => {
                let apart = (self.place(&other.nodes, &other.weights)[0] - place).norm();
                other.rod == touch.rod && apart < PATCHES_APART * self.kind.contact_radius
            }
            ConstraintSource::Jaws(..) | ConstraintSource::Pin(_) | ConstraintSource::Body(_) => false,
        })
    }

    /// Adds constraints that keep surface points outside rods: all of `touched`, or those that other patches do not
    /// cover.
    fn add_rod_constraints(
        &self,
        touched: &[RodContact],
        rods: &[Rod],
        answers: &mut Vec<ConstraintReaction>,
    ) {
        for touch in touched {
            // Most are covered already: only the others are examined.
            if self.is_covered(touch, answers) {
                continue;
            }
            let seen = || self.pressed(touch.rod, rods, &touch.nodes, &touch.weights);
            let touch = if self.kind.contact_radius > 0.0 { seen().unwrap_or(*touch) } else { *touch };
            if !self.is_covered(&touch, answers) {
                answers.push(self.rod_constraint(touch, rods));
            }
        }
    }

    /// A constraint that keeps a surface point outside a rod, with the patch around it.
    fn rod_constraint(&self, touch: RodContact, rods: &[Rod]) -> ConstraintReaction {
        let [place, _] = self.place(&touch.nodes, &touch.weights);
        let ([a, b, c], [u, v, w]) = (touch.nodes, touch.weights);
        let patch = patch(&self.body.rest, &self.body.triangles, &place, self.kind.contact_radius);
        // Without a patch, as inside or at a radius of 0, the point alone.
        let weights =
            patch.unwrap_or_else(|_| if a == b { vec![(a, 1.0)] } else { vec![(a, u), (b, v), (c, w)] });
        let on_rod = touch.on_axis.coords + touch.normal * rods[touch.rod].radius;
        ConstraintReaction {
            target: on_rod - place.coords,
            lag: 0.0,
            attachment: Attachment { weights, hold: Hold::AtLeast(Unit::new_unchecked(touch.normal)) },
            by: ConstraintSource::RodContact(touch),
            force: Vector3::zeros(),
        }
    }

    /// A patch constrains its mean displacement, and its centre is displaced further: the mean's target lags until the
    /// centre lies on the rod. Returns whether a target has changed.
    pub(crate) fn advance_to_rod(
        &mut self,
        answers: &mut [ConstraintReaction],
    ) -> Result<bool, LinearFemError> {
        let Some(solver) = &mut self.solver else { return Ok(false) };
        let mut moves = false;
        for (index, answer) in answers.iter_mut().enumerate().filter(|(index, _)| self.holding.holds(*index))
        {
            let ConstraintSource::RodContact(touch) = &answer.by else { continue };
            if answer.attachment.weights.len() <= 3 || answer.force.dot(&touch.normal) <= 0.0 {
                continue;
            }
            let moved = touch.nodes.iter().zip(touch.weights).map(|(&node, weight)| {
                (self.positions[node as usize] - self.body.rest[node as usize]) * weight
            });
            let beyond = (moved.sum::<Vector3<f64>>() - answer.target).dot(&touch.normal);
            if beyond.abs() > PENETRATION_MAX {
                answer.lag += beyond;
                let target = answer.target - touch.normal * answer.lag;
                self.holding.set_target(solver, index, target)?;
                if let Some(blend) = &mut self.blend {
                    blend.set_target(index, target)?;
                }
                moves = true;
            }
        }
        Ok(moves)
    }
}
