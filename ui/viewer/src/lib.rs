//! The viewer: renders surgical scenes, in windows and off-screen.
//!
//! A viewer only reads [`Snapshot`](trocar_scene::Snapshot)s: it never blocks the Model or a controller, and any number
//! of viewers can show one scene. Data flows one way:
//!
//! ```text
//! Snapshot ─▶ DrawList (drawables: geometry, pose, material; only what changed) ─▶ GPU copies ─▶ frames
//!    Camera, Optics, HeadTracked ─▶ View ─▶ Layout (mono, stereo, tiles) ───────────────────▶ panes of a frame
//! ```
//!
//! [`Renderer`] draws into textures; [`OffscreenRenderer`] is the headless viewer for programs.

pub mod bench;
pub mod colormap;
pub mod deform;
pub mod draw_list;
pub mod edit_map;
pub mod error;
pub mod film;
pub mod geometry;
pub mod gpu;
pub mod layout;
pub mod lights;
pub mod motion;
pub mod off_axis;
pub mod offscreen;
pub mod overlay;
pub mod pacing;
pub mod particles;
pub mod picture;
pub mod priority;
pub mod quality;
pub mod renderer;
pub mod still;
pub mod texture;
pub mod tube;
pub mod view;
pub mod window;

pub use error::ViewError;
pub use film::Film;
pub use layout::{Layout, Pane};
pub use motion::Motion;
pub use offscreen::OffscreenRenderer;
pub use overlay::{Legend, Overlay, Overlays};
pub use picture::Picture;
pub use quality::Quality;
pub use renderer::Renderer;
pub use still::StillPicture;
pub use view::{Lens, View};
