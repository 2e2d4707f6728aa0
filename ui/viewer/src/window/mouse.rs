//! Mouse gestures for the camera. They are followed event by event, not frame by frame, so that slow frames do not slow
//! the camera.

use std::time::{Duration, Instant};

use egui::{Pos2, Vec2};
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};

/// Largest time and distance between the clicks of a double click.
const DOUBLE: Duration = Duration::from_millis(400);
const DOUBLE_PIXELS: f32 = 6.0;
/// Scrolled pixels of a touch pad that count as one notch.
const PIXELS_PER_NOTCH: f64 = 50.0;

/// A gesture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Gesture {
    /// Turn the camera; pixels to the right and down.
    Turn(usize, Vec2),
    /// Move it parallel to the picture.
    Shift(usize, Vec2),
    /// Zoom in, by notches.
    Zoom(usize, f64),
    /// Select the entity at that place.
    Select(usize, Pos2),
}

/// State of the mouse: position and drag.
#[derive(Debug, Default)]
pub(super) struct Mouse {
    place: Pos2,
    /// The subject in which a button went down, and that button.
    drags: Option<(usize, MouseButton)>,
    clicked: Option<(Instant, Pos2)>,
}

impl Mouse {
    /// Where it is in the window \[pixels\].
    pub(super) fn place(&self) -> Pos2 {
        self.place
    }

    /// The gesture of an event; `over` returns the subject at a position, and `None` over a panel.
    pub(super) fn follow(
        &mut self,
        event: &WindowEvent,
        now: Instant,
        over: impl Fn(Pos2) -> Option<usize>,
    ) -> Option<Gesture> {
        match event {
            WindowEvent::CursorMoved { position, .. } => {
                let place = Pos2::new(position.x as f32, position.y as f32);
                let moved = place - std::mem::replace(&mut self.place, place);
                match self.drags? {
                    (subject_view, MouseButton::Left) => Some(Gesture::Turn(subject_view, moved)),
                    (subject_view, _) => Some(Gesture::Shift(subject_view, moved)),
                }
            }
            WindowEvent::MouseInput { state: ElementState::Released, button, .. } => {
                self.drags = self.drags.filter(|(_, dragging)| dragging != button);
                None
            }
            WindowEvent::MouseInput { button, .. } => {
                let subject_view = over(self.place)?;
                self.drags = Some((subject_view, *button));
                if *button != MouseButton::Left {
                    return None;
                }
                let twice = self.clicked.take().is_some_and(|(at, place)| {
                    now.duration_since(at) < DOUBLE && place.distance(self.place) < DOUBLE_PIXELS
                });
                self.clicked = (!twice).then_some((now, self.place));
                twice.then_some(Gesture::Select(subject_view, self.place))
            }
            WindowEvent::MouseWheel { delta, .. } => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, notches) => f64::from(*notches),
                    MouseScrollDelta::PixelDelta(pixels) => pixels.y / PIXELS_PER_NOTCH,
                };
                Some(Gesture::Zoom(over(self.place)?, notches))
            }
            WindowEvent::CursorLeft { .. } | WindowEvent::Focused(false) => {
                self.drags = None;
                None
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use winit::dpi::PhysicalPosition;
    use winit::event::{DeviceId, TouchPhase};

    fn moved(x: f64, y: f64) -> WindowEvent {
        WindowEvent::CursorMoved { device_id: DeviceId::dummy(), position: PhysicalPosition::new(x, y) }
    }

    fn button(button: MouseButton, state: ElementState) -> WindowEvent {
        WindowEvent::MouseInput { device_id: DeviceId::dummy(), state, button }
    }

    /// A panel at the left of x = 100, a subject at its right.
    fn over(place: Pos2) -> Option<usize> {
        (place.x >= 100.0).then_some(0)
    }

    #[test]
    fn a_drag_leads_however_far_it_goes_and_ends_with_its_own_button() {
        let (mut mouse, now) = (Mouse::default(), Instant::now());
        let mut follow = |event: WindowEvent| mouse.follow(&event, now, over);
        assert_eq!(follow(moved(150.0, 50.0)), None);
        follow(button(MouseButton::Left, ElementState::Pressed));
        assert_eq!(follow(moved(160.0, 45.0)), Some(Gesture::Turn(0, Vec2::new(10.0, -5.0))));
        // Over a panel the drag continues: it began in the scene.
        assert_eq!(follow(moved(60.0, 45.0)), Some(Gesture::Turn(0, Vec2::new(-100.0, 0.0))));
        follow(button(MouseButton::Right, ElementState::Released));
        assert!(follow(moved(61.0, 45.0)).is_some());
        follow(button(MouseButton::Left, ElementState::Released));
        assert_eq!(follow(moved(70.0, 45.0)), None);
        // A drag that begins on a panel moves no camera.
        follow(button(MouseButton::Right, ElementState::Pressed));
        assert_eq!(follow(moved(150.0, 45.0)), None);
    }

    #[test]
    fn two_clicks_select_and_a_third_one_does_not() {
        let (mut mouse, mut now) = (Mouse::default(), Instant::now());
        mouse.follow(&moved(150.0, 50.0), now, over);
        let mut click = |after: u64| {
            now += Duration::from_millis(after);
            let found = mouse.follow(&button(MouseButton::Left, ElementState::Pressed), now, over);
            mouse.follow(&button(MouseButton::Left, ElementState::Released), now, over);
            found
        };
        let select = Some(Gesture::Select(0, Pos2::new(150.0, 50.0)));
        assert_eq!([click(0), click(100), click(100)], [None, select, None]);
        assert_eq!([click(1_000), click(1_000), click(100)], [None, None, select]);
    }

    #[test]
    fn the_wheel_of_a_mouse_and_a_touch_pad_zoom_where_the_scene_is() {
        let (mut mouse, now) = (Mouse::default(), Instant::now());
        let wheel =
            |delta| WindowEvent::MouseWheel { device_id: DeviceId::dummy(), delta, phase: TouchPhase::Moved };
        let line = wheel(MouseScrollDelta::LineDelta(0.0, 2.0));
        assert_eq!(mouse.follow(&line, now, over), None);
        mouse.follow(&moved(150.0, 50.0), now, over);
        assert_eq!(mouse.follow(&line, now, over), Some(Gesture::Zoom(0, 2.0)));
        let pixels = wheel(MouseScrollDelta::PixelDelta(PhysicalPosition::new(0.0, -25.0)));
        assert_eq!(mouse.follow(&pixels, now, over), Some(Gesture::Zoom(0, -0.5)));
    }
}
