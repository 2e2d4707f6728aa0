//! Off-axis views: an eye looks through a fixed pane and may move.
//!
//! The pane may be a real screen and the eye that of a tracked head: the scene then lies behind (or in front of) the
//! screen as if the screen were a window (Ware, Arthur, Booth, "Fish tank virtual reality", CHI 1993; the projection as
//! in Kooima, "Generalized perspective projection", 2009).

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use trocar_scene::{Camera, Entity, HeadTracked, Pose, Snapshot};

use crate::view::{Lens, View};

/// The two eyes of a head in front of a screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eyes {
    /// From the midpoint of the eyes to the right eye, in the frame of the view \[m\].
    pub to_right: Vector3<f64>,
    /// Depth of the screen from the midpoint of the eyes \[m\].
    pub screen: f64,
}

impl View {
    /// The view through a screen of this width and height \[m\], whose frame has its origin in the middle, x to the
    /// right, y down and z into it: the corners of the screen are those of the picture, wherever the eye is. An eye
    /// nearer to the screen than `near`, or behind it, is moved to that distance in front. `near` and `far` are depths
    /// from the eye, along the screen's z \[m\].
    pub fn through_screen(
        world_from_screen: &Isometry3<f64>,
        [width, height]: [f64; 2],
        eye_in_screen: &Point3<f64>,
        near: f64,
        far: f64,
    ) -> Self {
        let distance = (-eye_in_screen.z).max(near);
        let [x, y] = [eye_in_screen.x, eye_in_screen.y];
        let lens = Lens {
            field_of_view: 2.0 * (0.5 * height / distance).atan(),
            aspect: width / height,
            near,
            far,
            shift: [2.0 * x / width, -2.0 * y / height],
        };
        Self::new(world_from_screen * Translation3::new(x, y, -distance), lens)
    }

    /// The view from the midpoint of the eyes of a head in front of a screen, as [`Self::through_screen`];
    /// [`Self::stereo`] then gives these eyes, `interocular` \[m\] apart. In the head's frame x points to the right
    /// eye.
    pub fn of_head(
        world_from_screen: &Isometry3<f64>,
        size: [f64; 2],
        screen_from_head: &Isometry3<f64>,
        interocular: f64,
        [near, far]: [f64; 2],
    ) -> Self {
        let between = Point3::from(screen_from_head.translation.vector);
        let mut view = Self::through_screen(world_from_screen, size, &between, near, far);
        let to_right = screen_from_head.rotation * Vector3::new(0.5 * interocular, 0.0, 0.0);
        view.eyes = Some(Eyes { to_right, screen: (-between.z).max(near) });
        view
    }

    /// The view through a camera of the scene that is a screen; `aspect` changes the screen's width. Without a tracked
    /// head, the eye is in front of the middle of the screen, at the distance of the camera's field of view.
    pub(crate) fn of_tracked(
        scene: &Snapshot,
        screen: Entity,
        camera: &Camera,
        tracked: &HeadTracked,
        aspect: Option<f64>,
    ) -> Self {
        let world_from_screen = scene.world_pose(screen);
        let [width, height] = tracked.screen.map(|side| side * tracked.scale);
        let width = aspect.map_or(width, |aspect| height * aspect);
        let screen_from_head = if scene.get::<Pose>(tracked.head).is_some() {
            let mut head = world_from_screen.inverse() * scene.world_pose(tracked.head);
            head.translation.vector *= tracked.scale;
            head
        } else {
            let distance = 0.5 * height / (0.5 * camera.field_of_view).tan();
            Isometry3::translation(0.0, 0.0, -distance)
        };
        let interocular = tracked.interocular * tracked.scale;
        let depths = [camera.near, camera.far];
        Self::of_head(&world_from_screen, [width, height], &screen_from_head, interocular, depths)
    }

    /// The view of an eye displaced by an offset in this eye's frame; points at `depth` \[m\] keep their place in the
    /// picture.
    pub fn aside(&self, offset_in_eye: &Vector3<f64>, depth: f64) -> Self {
        // Never as close as the pane itself.
        let distance = (depth - offset_in_eye.z).max(self.lens.near.min(depth));
        let half_height = (0.5 * self.lens.field_of_view).tan() * depth;
        let half_width = half_height * self.lens.aspect;
        let mut eye = *self;
        eye.world_from_eye *= Translation3::new(offset_in_eye.x, offset_in_eye.y, depth - distance);
        eye.lens.field_of_view = 2.0 * (half_height / distance).atan();
        eye.lens.shift[0] += offset_in_eye.x / half_width;
        eye.lens.shift[1] -= offset_in_eye.y / half_height;
        eye.eyes = None;
        eye
    }

    /// Widens or narrows the picture about the line of sight: its height keeps its content.
    pub fn set_aspect(&mut self, aspect: f64) {
        self.lens.shift[0] *= self.lens.aspect / aspect;
        self.lens.aspect = aspect;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix4, UnitQuaternion, Vector4};

    use super::*;

    const SIZE: [f64; 2] = [0.5, 0.3];
    /// Positions of an eye: left, right, above, below, near and far.
    const EYES: [[f64; 3]; 6] = [
        [0.0, 0.0, -0.6],
        [0.2, 0.0, -0.6],
        [-0.4, 0.1, -0.3],
        [0.05, -0.35, -0.05],
        [0.9, 0.7, -0.2],
        [0.0, 0.02, -3.0],
    ];

    fn somewhere() -> Isometry3<f64> {
        let turn = UnitQuaternion::from_euler_angles(-1.1, 0.4, 0.2);
        Isometry3::from_parts(Translation3::new(0.3, -0.2, 0.5), turn)
    }

    fn corners() -> [([f64; 2], Point3<f64>); 4] {
        [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]].map(|[x, y]| {
            let [width, height] = SIZE;
            ([x, y], somewhere() * Point3::new((x - 0.5) * width, (y - 0.5) * height, 0.0))
        })
    }

    fn assert_near(a: [f64; 2], b: [f64; 2]) {
        assert!((a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-12, "{a:?} {b:?}");
    }

    fn through(eye: [f64; 3]) -> View {
        View::through_screen(&somewhere(), SIZE, &eye.into(), 0.01, 5.0)
    }

    #[test]
    fn the_corners_of_the_screen_are_those_of_the_picture_wherever_the_eye_is() {
        for eye in EYES {
            for (at, corner) in corners() {
                let (seen, depth) = through(eye).project(&corner).unwrap();
                assert_near(seen, at);
                assert!((depth + eye[2]).abs() < 1e-12, "the screen is as deep as the eye is before it");
            }
        }
    }

    #[test]
    fn what_is_behind_the_screen_goes_with_the_head_and_what_is_before_it_against_it() {
        for depth_in_screen in [-0.03, 0.0, 0.05, 0.4] {
            let point = Point3::new(0.02, -0.03, depth_in_screen);
            for eye in EYES.into_iter().filter(|eye| eye[2] < depth_in_screen - 0.01) {
                // Similar triangles: where the line from the eye to the point intersects the screen.
                let share = -eye[2] / (point.z - eye[2]);
                let on_screen = [0, 1].map(|axis| eye[axis] + (point[axis] - eye[axis]) * share);
                let expected = [0, 1].map(|axis| 0.5 + on_screen[axis] / SIZE[axis]);
                assert_near(through(eye).project(&(somewhere() * point)).unwrap().0, expected);
            }
        }
        let x = |eye: [f64; 3], depth: f64| {
            through(eye).project(&(somewhere() * Point3::new(0.0, 0.0, depth))).unwrap().0[0]
        };
        let (before, after) = ([0.0, 0.0, -0.6], [0.1, 0.0, -0.6]);
        assert!(x(after, 0.2) > x(before, 0.2) + 0.01 && x(after, -0.1) < x(before, -0.1) - 0.01);
    }

    /// The projection as Kooima writes it: y up and the eye looking along −z, clip depths from −1 to 1.
    fn kooima([a, b, c]: [Point3<f64>; 3], eye: Point3<f64>, near: f64, far: f64) -> Matrix4<f64> {
        let (right, up) = ((b - a).normalize(), (c - a).normalize());
        let normal = right.cross(&up).normalize();
        let (va, vb, vc) = (a - eye, b - eye, c - eye);
        let d = -va.dot(&normal);
        let scale = near / d;
        let (l, r) = (right.dot(&va) * scale, right.dot(&vb) * scale);
        let (bottom, top) = (up.dot(&va) * scale, up.dot(&vc) * scale);
        let mut frustum = Matrix4::zeros();
        frustum[(0, 0)] = 2.0 * near / (r - l);
        frustum[(0, 2)] = (r + l) / (r - l);
        frustum[(1, 1)] = 2.0 * near / (top - bottom);
        frustum[(1, 2)] = (top + bottom) / (top - bottom);
        frustum[(2, 2)] = -(far + near) / (far - near);
        frustum[(2, 3)] = -2.0 * far * near / (far - near);
        frustum[(3, 2)] = -1.0;
        let rows = [right, up, normal].map(|axis| axis.push(0.0).transpose());
        let turned = Matrix4::from_rows(&[rows[0], rows[1], rows[2], Vector4::w().transpose()]);
        frustum * turned * Matrix4::new_translation(&-eye.coords)
    }

    #[test]
    fn the_projection_is_that_of_the_paper() {
        let [_, _, (_, lower_left), (_, lower_right)] = corners();
        let [(_, upper_left), ..] = corners();
        for eye in EYES {
            let view = through(eye);
            let paper =
                kooima([lower_left, lower_right, upper_left], somewhere() * Point3::from(eye), 0.01, 5.0);
            for point in [[0.1, 0.05, 0.3], [-0.2, 0.1, 0.02], [0.0, -0.1, 1.0]] {
                let in_world = somewhere() * Point3::from(point);
                let clip = paper * in_world.to_homogeneous();
                let own = view.clip_from_world() * in_world.to_homogeneous();
                let (clip, own) = (clip / clip.w, own / own.w);
                assert_near([clip.x, clip.y], [own.x, own.y]);
                // Depths from 0 to 1 instead of −1 to 1.
                assert!((0.5 + 0.5 * clip.z - own.z).abs() < 1e-9, "{} {}", clip.z, own.z);
            }
        }
    }

    #[test]
    fn each_eye_of_a_head_sees_the_screen_and_the_parallax_of_its_place() {
        let head = Isometry3::from_parts(
            Translation3::new(0.1, -0.05, -0.5),
            UnitQuaternion::from_euler_angles(0.1, 0.7, -0.3),
        );
        let view = View::of_head(&somewhere(), SIZE, &head, 0.063, [0.01, 5.0]);
        // The arguments do not matter: the eyes are given.
        let eyes = view.stereo(1.0, 7.0);
        for (side, eye) in [-1.0, 1.0].into_iter().zip(eyes) {
            let eye_in_screen = head * Point3::new(side * 0.0315, 0.0, 0.0);
            let alone = View::through_screen(&somewhere(), SIZE, &eye_in_screen, 0.01, 5.0);
            for (at, corner) in corners() {
                assert_near(eye.project(&corner).unwrap().0, at);
            }
            for point in [[0.1, 0.05, 0.3], [-0.2, 0.1, -0.1]] {
                let in_world = somewhere() * Point3::from(point);
                assert_near(eye.project(&in_world).unwrap().0, alone.project(&in_world).unwrap().0);
            }
        }
    }

    #[test]
    fn an_eye_in_or_behind_the_screen_still_gives_numbers() {
        for z in [0.0, 0.3, -1e-9] {
            let view = through([0.1, 0.1, z]);
            assert!(view.clip_from_world().iter().all(|part| part.is_finite()));
            for (at, corner) in corners() {
                assert_near(view.project(&corner).unwrap().0, at);
            }
        }
        let face_on = Isometry3::translation(0.0, 0.0, -0.011);
        // For a head that looks along the screen one eye would be behind it.
        let along = face_on * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -1.57);
        for eye in View::of_head(&somewhere(), SIZE, &along, 0.063, [0.01, 5.0]).stereo(0.0, 0.1) {
            for (at, corner) in corners() {
                let (seen, depth) = eye.project(&corner).unwrap();
                assert!(depth >= 0.01 - 1e-12, "{depth}");
                assert!((seen[0] - at[0]).abs() < 1e-9 && (seen[1] - at[1]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_wider_picture_shows_more_on_both_sides_of_the_same() {
        let mut view = through(EYES[1]);
        let wide = {
            let [width, height] = SIZE;
            let size = [2.0 * width, height];
            View::through_screen(&somewhere(), size, &EYES[1].into(), 0.01, 5.0)
        };
        view.set_aspect(2.0 * view.lens.aspect);
        assert!((view.clip_from_world() - wide.clip_from_world()).amax() < 1e-12);
    }
}
