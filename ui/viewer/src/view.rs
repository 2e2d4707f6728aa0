//! Views of a scene: camera poses, lenses and stereo.

use nalgebra::{Isometry3, Matrix4, Point3, Translation3, UnitQuaternion, Vector3};
use trocar_scene::{Camera, Entity, HeadTracked, Optics, Snapshot};

use crate::error::ViewError;
use crate::off_axis::Eyes;

/// A pinhole camera. In its frame z is along the line of sight, x to the right and y *down* in the picture, as for
/// [`Camera`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Vertical field of view \[rad\].
    pub field_of_view: f64,
    /// Width divided by height.
    pub aspect: f64,
    /// Nearest visible depth \[m\].
    pub near: f64,
    /// Farthest visible depth \[m\].
    pub far: f64,
    /// Shift of the picture's centre against the axis, as a share of its half width and half height: off-axis views.
    pub shift: [f64; 2],
}

impl Default for Lens {
    fn default() -> Self {
        let camera = Camera::default();
        Self {
            field_of_view: camera.field_of_view,
            aspect: camera.aspect,
            near: camera.near,
            far: camera.far,
            shift: [0.0; 2],
        }
    }
}

impl Lens {
    /// `clip_from_eye`: depth 0 at `near`, 1 at `far`, x right and y up in clip space.
    pub fn clip_from_eye(&self) -> Matrix4<f64> {
        let scale_y = 1.0 / (0.5 * self.field_of_view).tan();
        let scale_x = scale_y / self.aspect;
        let depth = self.far / (self.far - self.near);
        // The eye looks along +z with y down.
        Matrix4::new(
            scale_x,
            0.0,
            self.shift[0],
            0.0,
            0.0,
            -scale_y,
            self.shift[1],
            0.0,
            0.0,
            0.0,
            depth,
            -self.near * depth,
            0.0,
            0.0,
            1.0,
            0.0,
        )
    }
}

/// A point of view with a lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Pose of the eye in world.
    pub world_from_eye: Isometry3<f64>,
    /// Its lens.
    pub lens: Lens,
    /// Radial displacement at the corner as a share of the half diagonal, see [`Optics`].
    pub distortion: f64,
    /// Loss of light at the corner in \[0, 1\].
    pub vignette: f64,
    /// The two eyes of a tracked head, if the view is that of one.
    pub eyes: Option<Eyes>,
}

impl View {
    /// An undistorted view.
    pub fn new(world_from_eye: Isometry3<f64>, lens: Lens) -> Self {
        Self { world_from_eye, lens, distortion: 0.0, vignette: 0.0, eyes: None }
    }

    /// From `eye`, looking at `target`, the picture's upper edge towards `up` (all in world).
    pub fn looking_at(eye: Point3<f64>, target: Point3<f64>, up: Vector3<f64>, lens: Lens) -> Self {
        let forward = (target - eye).try_normalize(1e-12).unwrap_or_else(Vector3::z);
        let mut right = forward.cross(&up);
        if right.norm() < 1e-9 {
            // Parallel to `up`: any horizontal direction will do.
            right = forward.cross(&Vector3::y()) + forward.cross(&Vector3::x()) * 1e-3;
        }
        let right = right.normalize();
        let down = forward.cross(&right);
        let axes = nalgebra::Matrix3::from_columns(&[right, down, forward]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(axes));
        Self::new(Isometry3::from_parts(Translation3::from(eye.coords), rotation), lens)
    }

    /// The view of a camera of the scene, including its optics, or of the head that is tracked in front of it
    /// ([`HeadTracked`]); `aspect` replaces the camera's own.
    ///
    /// # Errors
    /// When the entity has no [`Camera`].
    pub fn through(scene: &Snapshot, camera: Entity, aspect: Option<f64>) -> Result<Self, ViewError> {
        let no_camera = || ViewError::NoCamera { name: scene.name(camera), known: cameras(scene) };
        let seen = scene.get::<Camera>(camera).ok_or_else(no_camera)?;
        if let Some(tracked) = scene.get::<HeadTracked>(camera) {
            return Ok(Self::of_tracked(scene, camera, seen, tracked, aspect));
        }
        let lens = Lens {
            field_of_view: seen.field_of_view,
            aspect: aspect.unwrap_or(seen.aspect),
            near: seen.near,
            far: seen.far,
            shift: [0.0; 2],
        };
        let mut view = Self::new(scene.world_pose(camera), lens);
        if let Some(optics) = scene.get::<Optics>(camera) {
            // Rotating the scope turns the tilted line of sight; the camera head, and so the picture's orientation,
            // stays.
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), optics.turn);
            let tilt = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), optics.tilt);
            view.world_from_eye *= turn * tilt * turn.inverse();
            view.distortion = optics.distortion;
            view.vignette = optics.vignette;
        }
        Ok(view)
    }

    /// The view of the first camera of the scene, or a view of the whole scene when it has none.
    pub fn default_of(scene: &Snapshot, aspect: Option<f64>) -> Self {
        let first = scene.iter::<Camera>().next().map(|(entity, _)| entity);
        first.and_then(|camera| Self::through(scene, camera, aspect).ok()).unwrap_or_else(|| {
            let lens = Lens { aspect: aspect.unwrap_or(4.0 / 3.0), ..Lens::default() };
            Self::looking_at(Point3::new(0.0, -0.25, 0.25), Point3::origin(), Vector3::z(), lens)
        })
    }

    /// The camera of that name; the error lists the others.
    ///
    /// # Errors
    /// [`ViewError::NoCamera`].
    pub fn named(scene: &Snapshot, name: &str, aspect: Option<f64>) -> Result<Self, ViewError> {
        let found =
            scene.iter::<Camera>().map(|(entity, _)| entity).find(|entity| scene.name(*entity) == name);
        let camera =
            found.ok_or_else(|| ViewError::NoCamera { name: name.to_owned(), known: cameras(scene) })?;
        Self::through(scene, camera, aspect)
    }

    /// Left and right eye: parallel, `interocular` \[m\] apart, their pictures shifted so that points at the depth
    /// `convergence` \[m\] have no parallax (off-axis stereo; Bourke, "Calculating stereo pairs", 1999). For a tracked
    /// head ([`Self::eyes`]) the arguments are ignored: its own eyes are used, and the screen has no parallax.
    pub fn stereo(&self, interocular: f64, convergence: f64) -> [Self; 2] {
        let given = Eyes { to_right: Vector3::new(0.5 * interocular, 0.0, 0.0), screen: convergence };
        let Eyes { to_right, screen } = self.eyes.unwrap_or(given);
        [-to_right, to_right].map(|offset| self.aside(&offset, screen))
    }

    /// `clip_from_world`.
    pub fn clip_from_world(&self) -> Matrix4<f64> {
        self.lens.clip_from_eye() * self.world_from_eye.inverse().to_homogeneous()
    }

    /// The position of a world point in the picture, each coordinate from 0 (left, top) to 1, and its depth \[m\];
    /// `None` behind the eye. Lens distortion is left out.
    pub fn project(&self, point_in_world: &Point3<f64>) -> Option<([f64; 2], f64)> {
        let in_eye = self.world_from_eye.inverse() * point_in_world;
        if in_eye.z <= 0.0 {
            return None;
        }
        let clip = self.lens.clip_from_eye() * in_eye.to_homogeneous();
        Some(([0.5 + 0.5 * clip.x / clip.w, 0.5 - 0.5 * clip.y / clip.w], in_eye.z))
    }

    /// Maps a point of the distorted picture (each coordinate from 0 to 1) to the undistorted one, as `composite.wgsl`
    /// does.
    pub fn through_lens(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let aspect = self.lens.aspect;
        let offset = [(2.0 * x - 1.0) * aspect, 2.0 * y - 1.0];
        let r2 = (offset[0] * offset[0] + offset[1] * offset[1]) / (aspect * aspect + 1.0);
        let bent = (1.0 + self.distortion * r2) / (1.0 + self.distortion);
        [0.5 + 0.5 * offset[0] * bent / aspect, 0.5 + 0.5 * offset[1] * bent]
    }

    /// The inverse: maps a point of the undistorted picture to the distorted one.
    pub fn onto_lens(&self, at: [f64; 2]) -> [f64; 2] {
        let mut seen = at;
        // Fixed-point iteration; distortions are so small that each step gains more than a digit.
        for _ in 0..12 {
            let through = self.through_lens(seen);
            seen = [seen[0] + at[0] - through[0], seen[1] + at[1] - through[1]];
        }
        seen
    }

    /// The view of the single pixel that contains `at` (as for [`Self::ray`]), in a picture of this size.
    pub fn pixel(&self, at: [f64; 2], size: [u32; 2]) -> Self {
        let [width, height] = size.map(|side| f64::from(side.max(1)));
        let centre =
            |share: f64, side: f64| ((share.clamp(0.0, 1.0) * side).floor().min(side - 1.0) + 0.5) / side;
        // In the picture's coordinates: from −1 to 1, up.
        let (x, y) = (2.0 * centre(at[0], width) - 1.0, 1.0 - 2.0 * centre(at[1], height));
        let mut pixel = *self;
        pixel.lens.field_of_view = 2.0 * ((0.5 * self.lens.field_of_view).tan() / height).atan();
        pixel.lens.aspect = self.lens.aspect * height / width;
        pixel.lens.shift = [width * (self.lens.shift[0] - x), height * (self.lens.shift[1] - y)];
        pixel
    }

    /// The ray through a point of the picture (0 to 1 from left and top): its origin and unit direction in world.
    pub fn ray(&self, [x, y]: [f64; 2]) -> (Point3<f64>, Vector3<f64>) {
        let tan = (0.5 * self.lens.field_of_view).tan();
        let right = (2.0 * x - 1.0 - self.lens.shift[0]) * tan * self.lens.aspect;
        let down = (2.0 * y - 1.0 + self.lens.shift[1]) * tan;
        let direction = self.world_from_eye * Vector3::new(right, down, 1.0).normalize();
        (Point3::from(self.world_from_eye.translation.vector), direction)
    }
}

fn cameras(scene: &Snapshot) -> String {
    let names: Vec<String> = scene.iter::<Camera>().map(|(entity, _)| scene.name(entity)).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ray_through_a_projected_point_passes_the_point() {
        let lens = Lens { shift: [0.1, -0.2], ..Lens::default() };
        let eye = Point3::new(0.1, -0.3, 0.2);
        let view = View::looking_at(eye, Point3::new(0.0, 0.02, 0.0), Vector3::z(), lens);
        let point = Point3::new(0.02, 0.03, -0.01);
        let (place, depth) = view.project(&point).unwrap();
        let (origin, direction) = view.ray(place);
        let along = (point - origin).dot(&direction);
        assert!((origin + direction * along - point).norm() < 1e-12);
        assert!(depth > 0.0 && depth <= along);
    }

    #[test]
    fn the_view_of_a_pixel_sees_what_the_pixel_shows() {
        let lens = Lens { shift: [0.1, -0.2], ..Lens::default() };
        let eye = Point3::new(0.1, -0.3, 0.2);
        let view = View::looking_at(eye, Point3::new(0.0, 0.02, 0.0), Vector3::z(), lens);
        let point = Point3::new(0.02, 0.03, -0.01);
        let (at, depth) = view.project(&point).unwrap();
        let size = [640, 480];
        let (seen, alone) = view.pixel(at, size).project(&point).unwrap();
        // Anywhere in the picture of that one pixel, displaced from its middle by the point's offset.
        for (axis, side) in [(0, 640.0), (1, 480.0)] {
            let within = (at[axis] * side).fract();
            assert!((seen[axis] - within).abs() < 1e-6, "{seen:?} {within}");
        }
        assert_eq!(depth, alone);
    }

    #[test]
    fn a_lens_leaves_the_middle_and_the_corners_where_they_are() {
        let mut view =
            View::looking_at(Point3::new(0.0, -0.3, 0.0), Point3::origin(), Vector3::z(), Lens::default());
        view.distortion = -0.2;
        for at in [[0.5, 0.5], [0.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
            let through = view.through_lens(at);
            assert!((through[0] - at[0]).abs() < 1e-12 && (through[1] - at[1]).abs() < 1e-12);
        }
        for at in [[0.3, 0.8], [0.05, 0.5], [0.9, 0.1]] {
            let back = view.through_lens(view.onto_lens(at));
            assert!((back[0] - at[0]).abs() < 1e-6 && (back[1] - at[1]).abs() < 1e-6, "{at:?} {back:?}");
        }
        // Barrel distortion shows more at the sides than the undistorted picture.
        assert!(view.through_lens([0.75, 0.5])[0] > 0.75);
    }

    #[test]
    fn up_is_up_and_right_is_right_in_the_picture() {
        let view =
            View::looking_at(Point3::new(0.0, -0.3, 0.0), Point3::origin(), Vector3::z(), Lens::default());
        let ([x, _], _) = view.project(&Point3::new(0.01, 0.0, 0.0)).unwrap();
        let ([_, y], _) = view.project(&Point3::new(0.0, 0.0, 0.01)).unwrap();
        assert!(x > 0.5 && y < 0.5, "{x} {y}");
    }

    #[test]
    fn parallax_vanishes_at_the_convergence_and_follows_the_formula_elsewhere() {
        let mono =
            View::looking_at(Point3::new(0.0, -0.3, 0.0), Point3::origin(), Vector3::z(), Lens::default());
        let (interocular, convergence) = (0.006, 0.2);
        let [left, right] = mono.stereo(interocular, convergence);
        let half_width = (0.5 * mono.lens.field_of_view).tan() * mono.lens.aspect;
        for depth in [0.05, 0.1, 0.2, 0.4] {
            let point = mono.world_from_eye * Point3::new(0.01, 0.02, depth);
            let x = |eye: &View| eye.project(&point).unwrap().0[0];
            // Width of the picture at distance 1 is 2 × half_width; similar triangles.
            let expected = interocular * (1.0 / convergence - 1.0 / depth) / (2.0 * half_width);
            assert!((x(&right) - x(&left) - expected).abs() < 1e-12, "{depth}");
        }
    }
}
