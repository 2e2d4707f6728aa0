//! Rendering of virtual fixtures: a constant force, a spring and a damper at the tip, at the hand's own rate.

use nalgebra::Vector3;
use trocar_scene::VirtualFixture;

use crate::renderer::{RenderInput, freshness};
use crate::spatial::Wrench;

/// Age of a fixture above which it fades; it is gone at twice that age \[s\]. A behaviour at 20 Hz renews it in time.
pub const FADE_SECS: f64 = 0.1;

/// The fixture's wrench on the hand, at the tip, in world. Stiffness and damping are at most what is stable at the
/// device. Finite input gives finite output.
pub fn render(fixture: &VirtualFixture, input: &RenderInput<'_>) -> Wrench {
    let fresh = freshness(input.now.since(fixture.at).as_secs_f64(), FADE_SECS);
    let tip = input.tip_in_world.translation.vector;
    let spring = (fixture.center_in_world.coords - tip) * fixture.stiffness.min(input.stiffness_max);
    let damper = input.tip_twist.linear * -fixture.damping.min(input.damping_max);
    let force = input.waited(fixture.force, fixture.at);
    Wrench { force: (force + spring + damper) * fresh, torque: Vector3::zeros() }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use trocar_scene::SimTime;

    use super::*;
    use crate::renderer::tests::input_at;
    use crate::spatial::Twist;

    #[test]
    fn a_fixture_is_a_force_a_spring_and_a_damper() {
        let fixture = VirtualFixture {
            force: Vector3::new(0.0, 0.0, 0.5),
            center_in_world: Point3::new(0.010, 0.0, 0.0),
            stiffness: 100.0,
            damping: 2.0,
            at: SimTime::ZERO,
        };
        let mut input = input_at(Vector3::new(0.004, 0.0, 0.0));
        input.tip_twist = Twist { linear: Vector3::new(0.0, 0.1, 0.0), ..Twist::ZERO };
        let felt = render(&fixture, &input).force;
        assert!((felt - Vector3::new(0.6, -0.2, 0.5)).norm() < 1e-12, "{felt}");
    }

    #[test]
    fn it_is_no_stiffer_than_the_device_renders_stably() {
        let fixture = VirtualFixture {
            center_in_world: Point3::new(0.001, 0.0, 0.0),
            stiffness: 1e5,
            ..VirtualFixture::default()
        };
        let input = input_at(Vector3::zeros());
        let felt = render(&fixture, &input).force.x;
        assert!((felt - input.stiffness_max * 0.001).abs() < 1e-12, "{felt}");
    }

    #[test]
    fn it_fades_when_nobody_renews_it() {
        let fixture = VirtualFixture { force: Vector3::x(), ..VirtualFixture::default() };
        let mut input = input_at(Vector3::zeros());
        for (millis, share) in [(0, 1.0), (100, 1.0), (150, 0.5), (200, 0.0), (5_000, 0.0)] {
            input.now = SimTime::from_millis(millis);
            assert!((render(&fixture, &input).force.x - share).abs() < 1e-9, "{millis} ms");
        }
    }
}
