//! The grasp rule: an instrument holds a body when both jaws press on it from opposite sides.
//!
//! The rule depends on contacts only. The world that steps the body decides whether friction alone or an additional
//! grasp constraint keeps it.

use nalgebra::{Isometry3, Vector3};
use trocar_scene::entity::Entity;

/// Minimum normal force per jaw that counts as holding \[N\].
pub const HOLDING_FORCE_MIN: f64 = 0.02;
/// Minimum cosine between a pad's closing direction and its force.
const OPPOSING_COSINE_MIN: f64 = 0.5;
/// Time without opposing contacts after which a grasp ends \[s\]; it bridges flickering contacts.
pub const RELEASE_SECS: f64 = 0.02;

/// Contact of one jaw with one body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PadContact {
    /// The jaw: 0 is A (at +x), 1 is B.
    pub jaw: usize,
    /// The touched body.
    pub body: Entity,
    /// Normal force of the jaw on the body, in the instrument's frame \[N\].
    pub normal_force_in_instrument: Vector3<f64>,
}

/// A held body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// The body.
    pub held: Entity,
    /// `instrument_from_held` when the hold formed.
    pub anchor: Isometry3<f64>,
    /// Whether a grasp constraint assists friction.
    pub assisted: bool,
    /// Whether the grasp constraint broke in this hold; only the next hold gets a new one.
    pub torn: bool,
    /// Time without opposing contacts so far \[s\].
    pub slack_secs: f64,
}

/// The body that both jaws press on from opposite sides; of several, the one with the largest force, of equal ones the
/// lowest entity.
pub fn opposed_body(contacts: &[PadContact]) -> Option<Entity> {
    let mut best: Option<(f64, Entity)> = None;
    for contact in contacts.iter().filter(|contact| contact.jaw == 0) {
        let a = pressing_on(contacts, 0, contact.body);
        let b = pressing_on(contacts, 1, contact.body);
        let squeeze = a.min(b);
        let better =
            best.is_none_or(|(force, body)| squeeze > force || (squeeze == force && contact.body < body));
        if squeeze >= HOLDING_FORCE_MIN && better {
            best = Some((squeeze, contact.body));
        }
    }
    best.map(|(_, body)| body)
}

/// Force of a jaw on a body along the jaw's closing direction \[N\]; zero unless it points mainly that way.
fn pressing_on(contacts: &[PadContact], jaw: usize, body: Entity) -> f64 {
    let closing = if jaw == 0 { -Vector3::x() } else { Vector3::x() };
    let force: Vector3<f64> = contacts
        .iter()
        .filter(|contact| contact.jaw == jaw && contact.body == body)
        .map(|contact| contact.normal_force_in_instrument)
        .sum();
    let along = force.dot(&closing);
    if along >= OPPOSING_COSINE_MIN * force.norm() { along } else { 0.0 }
}

/// Advances a hold by one step of `step_secs`. `opposed` is the body between the jaws, `instrument_from_body` gives
/// poses relative to the instrument.
pub fn carry_on(
    hold: Option<Hold>,
    opposed: Option<Entity>,
    step_secs: f64,
    instrument_from_body: impl Fn(Entity) -> Option<Isometry3<f64>>,
) -> Option<Hold> {
    match (hold, opposed) {
        (Some(hold), Some(body)) if hold.held == body => Some(Hold { slack_secs: 0.0, ..hold }),
        (Some(hold), None) if hold.slack_secs + step_secs < RELEASE_SECS => {
            Some(Hold { slack_secs: hold.slack_secs + step_secs, ..hold })
        }
        (_, Some(body)) => instrument_from_body(body).map(|anchor| Hold {
            held: body,
            anchor,
            assisted: false,
            torn: false,
            slack_secs: 0.0,
        }),
        (_, None) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RING: Entity = Entity::new(0, 0, 7);
    const OTHER: Entity = Entity::new(0, 0, 8);

    fn pad(jaw: usize, body: Entity, x: f64, y: f64) -> PadContact {
        PadContact { jaw, body, normal_force_in_instrument: Vector3::new(x, y, 0.0) }
    }

    #[test]
    fn opposing_jaws_hold() {
        assert_eq!(opposed_body(&[pad(0, RING, -1.0, 0.0), pad(1, RING, 1.0, 0.1)]), Some(RING));
    }

    #[test]
    fn one_jaw_wrong_side_or_different_bodies_do_not() {
        assert_eq!(opposed_body(&[pad(0, RING, -1.0, 0.0)]), None);
        assert_eq!(opposed_body(&[pad(0, RING, 1.0, 0.0), pad(1, RING, 1.0, 0.0)]), None);
        assert_eq!(opposed_body(&[pad(0, RING, -1.0, 0.0), pad(1, OTHER, 1.0, 0.0)]), None);
        assert_eq!(opposed_body(&[pad(0, RING, -0.1, 1.0), pad(1, RING, 0.1, 1.0)]), None, "a push aside");
        assert_eq!(opposed_body(&[pad(0, RING, -1e-3, 0.0), pad(1, RING, 1e-3, 0.0)]), None, "a touch");
    }

    #[test]
    fn the_body_pressed_harder_counts() {
        let contacts = [
            pad(0, RING, -0.1, 0.0),
            pad(1, RING, 0.1, 0.0),
            pad(0, OTHER, -1.0, 0.0),
            pad(1, OTHER, 1.0, 0.0),
        ];
        assert_eq!(opposed_body(&contacts), Some(OTHER));
    }

    #[test]
    fn flickering_contacts_do_not_end_a_hold_but_a_release_does() {
        let place = |_| Some(Isometry3::identity());
        let mut hold = carry_on(None, Some(RING), 0.001, place);
        assert_eq!(hold.map(|hold| hold.held), Some(RING));
        for _ in 0..10 {
            hold = carry_on(hold, None, 0.001, place);
            assert!(hold.is_some());
        }
        hold = carry_on(hold, Some(RING), 0.001, place);
        for _ in 0..25 {
            hold = carry_on(hold, None, 0.001, place);
        }
        assert_eq!(hold, None);
    }
}
