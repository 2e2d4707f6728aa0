//! Layouts: stereo and tiled views in one picture.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{Entity, Snapshot};

use crate::draw_list::{DrawList, Part};
use crate::view::{Lens, View};

/// Field of view of nearly parallel projections \[rad\].
const NARROW: f64 = 0.1;

/// A part of a picture, in shares of its width and height from the left and the top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pane {
    /// Left edge.
    pub x: f64,
    /// Upper edge.
    pub y: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
}

impl Pane {
    /// The whole picture.
    pub const WHOLE: Self = Self { x: 0.0, y: 0.0, width: 1.0, height: 1.0 };

    /// The pane in shares of the picture, when it is given in shares of `outer`.
    pub fn within(&self, outer: &Self) -> Self {
        Self {
            x: outer.x + self.x * outer.width,
            y: outer.y + self.y * outer.height,
            width: self.width * outer.width,
            height: self.height * outer.height,
        }
    }

    /// Its pixels in a picture of this size: left, top, width, height; at least one pixel.
    pub fn pixels(&self, [width, height]: [u32; 2]) -> [u32; 4] {
        let edge = |share: f64, side: u32| (share.clamp(0.0, 1.0) * f64::from(side)).round() as u32;
        let (left, top) = (edge(self.x, width).min(width - 1), edge(self.y, height).min(height - 1));
        let (right, bottom) = (edge(self.x + self.width, width), edge(self.y + self.height, height));
        [left, top, right.max(left + 1).min(width) - left, bottom.max(top + 1).min(height) - top]
    }
}

/// How views share a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Layout {
    /// One view.
    #[default]
    Mono,
    /// Left and right eye beside each other.
    SideBySide(Stereo),
    /// Left eye above the right one.
    TopBottom(Stereo),
    /// Even rows (counted from the top, beginning with 0) for the left eye, odd ones for the right: polarised monitors.
    RowInterleaved(Stereo),
    /// Red from the left eye, green and blue from the right.
    Anaglyph(Stereo),
    /// Any number of views, each in a part of the picture; later ones lie over earlier ones.
    Tiles(Vec<Tile>),
}

/// The view of a tile.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum TileView {
    /// The view of the whole picture.
    #[default]
    Given,
    /// A camera of the scene, followed as it moves. A tile without its camera stays empty.
    Camera(Entity),
    /// A view of its own.
    Free(View),
}

/// One of several views. Its lens takes the aspect ratio of its pane.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Its part of the picture.
    pub pane: Pane,
    /// Its view.
    pub view: TileView,
    /// Pose of its eye in the frame of that view.
    pub view_from_eye: Isometry3<f64>,
    /// Layout within the tile: one eye, two, or tiles again.
    pub layout: Layout,
}

impl Tile {
    /// A tile of one eye.
    pub fn new(pane: Pane, view: TileView) -> Self {
        Self { pane, view, view_from_eye: Isometry3::identity(), layout: Layout::Mono }
    }
}

/// The stereo parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stereo {
    /// Distance of the eyes \[m\]; a few millimetres for a stereo laparoscope.
    pub interocular: f64,
    /// Depth of zero parallax \[m\].
    pub convergence: f64,
}

impl Default for Stereo {
    fn default() -> Self {
        Self { interocular: 0.0048, convergence: 0.2 }
    }
}

/// The combination of two pictures into one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weave {
    /// Each in its own pane.
    Panes,
    /// By rows.
    Rows,
    /// By colour.
    Colors,
}

/// The drawing of one pane.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Its part of the picture.
    pub pane: Pane,
    /// The view from the midpoint of the eyes.
    pub centre: View,
    /// One eye, or the left and the right one.
    pub eyes: Vec<View>,
    /// The combination of two pictures.
    pub weave: Weave,
}

impl Layout {
    /// Tiles of equal size, row by row from the upper left: as many columns as rows, or one more.
    pub fn grid(views: impl IntoIterator<Item = TileView>) -> Self {
        let views: Vec<TileView> = views.into_iter().collect();
        let columns = (1..=views.len()).find(|columns| columns * columns >= views.len()).unwrap_or(1);
        let rows = views.len().div_ceil(columns).max(1);
        let (width, height) = (1.0 / columns as f64, 1.0 / rows as f64);
        let tile = |(index, view): (usize, TileView)| {
            let (row, column) = (index / columns, index % columns);
            Tile::new(Pane { x: column as f64 * width, y: row as f64 * height, width, height }, view)
        };
        Self::Tiles(views.into_iter().enumerate().map(tile).collect())
    }

    /// The same tiles, each with that layout; other layouts are unchanged.
    #[must_use]
    pub fn each(mut self, layout: &Self) -> Self {
        if let Self::Tiles(tiles) = &mut self {
            tiles.iter_mut().for_each(|tile| tile.layout.clone_from(layout));
        }
        self
    }

    /// Four tiles, as in technical drawings: the given view, and the same scene from above, from the front (along +y)
    /// and from the right (along −x), nearly without perspective.
    pub fn quad(draw_list: &DrawList, view: &View) -> Self {
        let (centre, radius) = shown(draw_list, view);
        let distance = radius / (0.5 * NARROW).tan();
        let from = |direction: Vector3<f64>, up: Vector3<f64>| {
            let lens = Lens {
                field_of_view: NARROW,
                near: (distance - 3.0 * radius).max(0.2 * distance),
                far: distance + 20.0 * radius,
                ..Lens::default()
            };
            TileView::Free(View::looking_at(centre + direction * distance, centre, up, lens))
        };
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        Self::grid([TileView::Given, from(z, y), from(-y, z), from(x, z)])
    }

    /// The drawings of the panes, in order. `size` is that of the picture \[pixels\].
    pub fn shots(&self, scene: &Snapshot, view: &View, size: [u32; 2]) -> Vec<Shot> {
        let mut shots = Vec::new();
        self.collect(scene, view, Pane::WHOLE, size, &mut shots);
        shots
    }

    fn collect(&self, scene: &Snapshot, view: &View, pane: Pane, size: [u32; 2], shots: &mut Vec<Shot>) {
        let pair = |stereo: &Stereo| view.stereo(stereo.interocular, stereo.convergence);
        let mut add = |pane, eyes: &[View], weave| {
            shots.push(Shot { pane, centre: *view, eyes: eyes.to_vec(), weave });
        };
        let part = |x, y, width, height| Pane { x, y, width, height }.within(&pane);
        match self {
            Self::Mono => add(pane, &[*view], Weave::Panes),
            Self::SideBySide(stereo) => {
                let [left, right] = pair(stereo);
                add(part(0.0, 0.0, 0.5, 1.0), &[left], Weave::Panes);
                add(part(0.5, 0.0, 0.5, 1.0), &[right], Weave::Panes);
            }
            Self::TopBottom(stereo) => {
                let [left, right] = pair(stereo);
                add(part(0.0, 0.0, 1.0, 0.5), &[left], Weave::Panes);
                add(part(0.0, 0.5, 1.0, 0.5), &[right], Weave::Panes);
            }
            Self::RowInterleaved(stereo) => add(pane, &pair(stereo), Weave::Rows),
            Self::Anaglyph(stereo) => add(pane, &pair(stereo), Weave::Colors),
            Self::Tiles(tiles) => {
                for tile in tiles {
                    let pane = tile.pane.within(&pane);
                    let [.., width, height] = pane.pixels(size);
                    let aspect = f64::from(width) / f64::from(height);
                    let mut own = match tile.view {
                        TileView::Given => *view,
                        TileView::Free(free) => free,
                        TileView::Camera(camera) => match View::through(scene, camera, None) {
                            Ok(seen) => seen,
                            Err(_) => continue,
                        },
                    };
                    own.set_aspect(aspect);
                    own.world_from_eye *= tile.view_from_eye;
                    tile.layout.collect(scene, &own, pane, size, shots);
                }
            }
        }
    }
}

/// A bounding sphere of what a view shows: centre and radius \[m\]. Shafts are left out, since they extend far outside.
fn shown(draw_list: &DrawList, view: &View) -> (Point3<f64>, f64) {
    let things = || draw_list.items().iter().filter(|item| item.part != Part::Shaft);
    let ball = |item: &crate::draw_list::Item| {
        (Point3::from(item.world_from_item.translation.vector), f64::from(item.surface.geometry.radius))
    };
    let within = |(centre, _): &(Point3<f64>, f64)| {
        let seen = view.project(centre);
        seen.is_some_and(|(at, _)| at.iter().all(|share| (0.0..=1.0).contains(share)))
    };
    let mut balls: Vec<_> = things().map(ball).filter(within).collect();
    if balls.is_empty() {
        balls = things().map(ball).collect();
    }
    let mut ends: Option<(Point3<f64>, Point3<f64>)> = None;
    for (centre, radius) in balls {
        let (low, high) = (centre - Vector3::repeat(radius), centre + Vector3::repeat(radius));
        ends = Some(ends.map_or((low, high), |(min, max)| (min.inf(&low), max.sup(&high))));
    }
    let (min, max) = ends.unwrap_or((Point3::new(-0.1, -0.1, -0.1), Point3::new(0.1, 0.1, 0.1)));
    (nalgebra::center(&min, &max), (0.5 * (max - min)).amax().max(0.01))
}
