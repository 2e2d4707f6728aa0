//! Controller of finger proxies: the proxy of each instrument, and its local contact model for haptics.
//!
//! Haptics renders these models without the physics engine, which need not know the surface. If there is an engine too,
//! its setting `contact_models_by_others` leaves these instruments' models to this controller.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::components::{
    Detection, Instrument, InstrumentTarget, LocalContactModel, Pose, Primitive, Velocity,
};
use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Entity, EntitySet, SimTime, Snapshot, Tick,
};

use super::bodies;
use super::combined_surface::CombinedSurface;
use super::report::{self, FoundContact, Report};
use crate::finger_proxy::{FingerProxy, PlaneProperties, ProxyConfig};

/// Configuration: instruments, surfaces and contact properties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FingerProxyConfig {
    /// Names of instruments.
    pub instruments: Vec<String>,
    /// Names of bodies. If they move relative to each other, their whole combined surface is refitted.
    pub surfaces: Vec<String>,
    /// Radius of the proxy \[m\].
    #[serde(default = "radius")]
    pub radius: f64,
    /// Coulomb friction.
    #[serde(default)]
    pub friction: f64,
    /// Stiffness against penetration \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
    /// Damping along the normal \[N·s/m\].
    #[serde(default)]
    pub damping: f64,
    /// Distance within which surfaces are included before contact \[m\]; larger for a fast hand.
    #[serde(default = "foresight")]
    pub foresight: f64,
}

fn radius() -> f64 {
    ProxyConfig::default().radius
}

fn foresight() -> f64 {
    2e-3
}

/// Ticks of look-ahead for a hand: the current one, and one until haptics gets the model.
const TICKS_AHEAD: f64 = 2.0;

/// A proxy, and its last position in world.
struct InstrumentProxy {
    instrument: Entity,
    proxy: FingerProxy,
    before: Option<(SimTime, Point3<f64>)>,
}

/// Updates the proxies of instruments on surfaces, and writes local contact models for haptics.
pub struct FingerProxyController {
    hands: Vec<InstrumentProxy>,
    felt: CombinedSurface,
    feel: PlaneProperties,
    foresight: f64,
    report: Report,
}

impl FingerProxyController {
    /// Finds instruments and bodies. Proxies of an earlier life continue from the positions in its models.
    ///
    /// # Errors
    /// One does not exist or is invalid; or a parameter is out of range.
    pub fn new(config: &FingerProxyConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let within = |what: &str, value: f64, least: f64, most: f64| {
            // NaN fails every range check.
            if (least..=most).contains(&value) {
                return Ok(());
            }
            Err(ControllerError::Scene(format!("{what} = {value}: {least} to {most} is valid")))
        };
        within("stiffness", config.stiffness, 1.0, 1e6)?;
        within("damping", config.damping, 0.0, 1e4)?;
        within("foresight", config.foresight, 0.0, 0.1)?;
        let friction = config.friction;
        let proxy = ProxyConfig {
            radius: config.radius,
            static_friction: friction,
            dynamic_friction: friction,
            ..ProxyConfig::default()
        };
        let felt = CombinedSurface::named(context, &config.surfaces)?;
        let hand = |instrument: Entity| {
            let proxy = match context.scene.get::<LocalContactModel>(instrument) {
                Some(model) => {
                    let place = Point3::from(model.proxy_in_world.translation);
                    FingerProxy::resumed(proxy, &felt.pose().inverse_transform_point(&place))
                }
                None => FingerProxy::new(proxy),
            };
            let proxy = proxy.map_err(|error| ControllerError::Scene(error.to_string()))?;
            Ok(InstrumentProxy { instrument, proxy, before: None })
        };
        let hands = bodies::instruments(context, &config.instruments)?.into_iter().map(hand);
        Ok(Self {
            hands: hands.collect::<Result<_, ControllerError>>()?,
            felt,
            feel: PlaneProperties { stiffness: config.stiffness, damping: config.damping },
            foresight: config.foresight,
            report: Report::new(Detection::Proxy, config.stiffness),
        })
    }
}

impl InstrumentProxy {
    /// Follows the hand, and returns its local contact model.
    fn follow(
        &mut self,
        tick: &Tick<'_>,
        target: &InstrumentTarget,
        felt: &CombinedSurface,
        feel: &PlaneProperties,
        foresight: f64,
    ) -> Result<LocalContactModel, ControllerError> {
        let world_from_tip = target.tip_in_world.isometry();
        let (period_secs, pose) = (tick.period.as_secs_f64(), felt.pose());
        let device = pose.inverse_transform_point(&world_from_tip.translation.vector.into());
        let place = self.proxy.step(felt.moving(), &device, period_secs);
        let place = pose * place.map_err(|error| ControllerError::Failed(error.to_string()))?;
        let ahead = TICKS_AHEAD * period_secs * target.velocity_in_world.linear.norm();
        let mut model =
            self.proxy.local_contact_model(felt.moving(), pose, feel, foresight + ahead, tick.time);
        // The surface may move as a whole, with the proxy.
        let linear = self.before.map_or(Vector3::zeros(), |(at, before)| {
            let secs = tick.time.since(at).as_secs_f64();
            if secs > 0.0 { (place - before) / secs } else { Vector3::zeros() }
        });
        self.before = Some((tick.time, place));
        model.proxy_velocity = Velocity { linear, angular: target.velocity_in_world.angular };
        model.proxy_in_world = Pose::new(place.coords, world_from_tip.rotation);
        Ok(model)
    }
}

impl Controller for FingerProxyController {
    fn access(&self) -> Access {
        let instruments = self.hands.iter().map(|hand| hand.instrument).collect();
        bodies::access()
            .reads::<Instrument>()
            .reads::<InstrumentTarget>()
            .reads::<LocalContactModel>()
            .writes::<LocalContactModel>(EntitySet::Of(instruments))
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.report.begin();
        self.felt.follow(scene, out, tick.period.as_secs_f64())?;
        for hand in &mut self.hands {
            let is_there = scene.get::<Instrument>(hand.instrument).is_some();
            // Without a target of the hand there is no proxy.
            let Some(target) = scene.get::<InstrumentTarget>(hand.instrument).filter(|_| is_there) else {
                continue;
            };
            let model = hand.follow(tick, target, &self.felt, &self.feel, self.foresight)?;
            out.put(hand.instrument, model);
            let pose = self.felt.pose();
            for contact in hand.proxy.contacts() {
                let (surface, triangle) = self.felt.owner(contact.triangle);
                self.report.add(FoundContact {
                    parts: [(hand.instrument, Primitive::Shape(0)), (surface, Primitive::Triangle(triangle))],
                    on_second_in_world: pose * contact.on_surface,
                    normal_in_world: pose * -contact.normal,
                    depth: contact.push,
                });
                // Each plane has its own share of the path.
                self.report.end_pair();
            }
        }
        self.report.send(scene.time(), out);
        Ok(())
    }
}
