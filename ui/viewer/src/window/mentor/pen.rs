//! The pen: pointer, strokes and labels of the person at a window.

use std::collections::{BTreeSet, VecDeque};
use std::time::{Duration, Instant};

use nalgebra::Point3;
use trocar_scene::annotation::SurfaceHit;
use trocar_scene::{
    DRAWN_PLACES_MAX, Entity, MentorDeed, MentorLabel, MentorStroke, PictureFreeze, Snapshot, SurfacePlace,
};

/// Colours of the pen.
pub(in crate::window) const COLOURS: [[u8; 3]; 5] =
    [[235, 60, 50], [250, 205, 40], [70, 210, 100], [60, 150, 255], [250, 250, 250]];
/// Width of a stroke \[m\].
const WIDTH: f32 = 0.0015;
/// Places of a stroke that are nearer to one another are one \[m\].
const STEP: f64 = 3e-4;
/// A stroke does not bridge more than this \[m\]: the mouse has passed an edge.
const LEAP: f64 = 0.02;
/// Time between two parts of a stroke: the others see it grow.
const PART_EVERY: Duration = Duration::from_millis(60);
/// Most deeds that wait for the subject to take them.
const DEEDS_MAX: usize = 64;
/// Most strokes that were erased and may still be seen, and most drags that are remembered.
const ERASED_MAX: usize = 512;
const DRAGS_MAX: usize = 512;

/// What the person at a window shows.
#[derive(Default)]
pub(in crate::window) struct Pen {
    is_on: bool,
    /// Index of the colour.
    pub(in crate::window) colour: usize,
    /// Whether the button is down.
    is_down: bool,
    /// The next stroke is the first one of its drag.
    begins: bool,
    stroke: Option<OpenStroke>,
    /// Number of the last stroke and of the last label of this window.
    last_stroke: u32,
    last_label: u32,
    erased: BTreeSet<u32>,
    /// Numbers of the first strokes of the mouse's drags: one drag over several bodies makes several strokes.
    drags: VecDeque<u32>,
    pointer: Option<SurfacePlace>,
    /// The pointer has changed since it was passed on.
    has_moved: bool,
    /// A label that is being written.
    pub(in crate::window) label: Option<LabelEntry>,
    deeds: Vec<MentorDeed>,
    /// There are others to show something to.
    pub(in crate::window) is_shared: bool,
    /// Something was dropped, since nobody takes the deeds.
    pub(in crate::window) is_full: bool,
}

/// A stroke that is being drawn.
struct OpenStroke {
    number: u32,
    colour: [u8; 3],
    /// Places that are not passed on yet.
    places: Vec<SurfacePlace>,
    since: Instant,
    body: Entity,
    last: Point3<f64>,
}

/// A label that is being written.
pub(in crate::window) struct LabelEntry {
    place: SurfacePlace,
    /// Its text.
    pub(in crate::window) text: String,
    /// Whether the line has got the keys.
    pub(in crate::window) has_focus: bool,
}

impl Pen {
    /// Whether the mouse draws.
    pub(in crate::window) fn is_on(&self) -> bool {
        self.is_on
    }

    /// Takes the pen up, or lays it down.
    pub(in crate::window) fn set_on(&mut self, is_on: bool) {
        self.is_on = is_on;
        if !is_on {
            self.release();
            self.point(None);
        }
    }

    /// The mouse is there.
    pub(in crate::window) fn hover(
        &mut self,
        scene: &Snapshot,
        station: u16,
        hit: Option<&SurfaceHit>,
        now: Instant,
    ) {
        if !self.is_on {
            return;
        }
        self.point(hit.map(|hit| hit.place));
        if self.is_down {
            self.draw(scene, station, hit, now);
        }
    }

    /// The button goes down.
    pub(in crate::window) fn press(
        &mut self,
        scene: &Snapshot,
        station: u16,
        hit: Option<&SurfaceHit>,
        now: Instant,
    ) {
        self.is_down = self.is_on;
        self.begins = true;
        self.hover(scene, station, hit, now);
    }

    /// The mouse is nowhere.
    pub(in crate::window) fn leave(&mut self) {
        self.point(None);
    }

    /// The button goes up.
    pub(in crate::window) fn release(&mut self) {
        self.is_down = false;
        self.end_stroke();
    }

    fn point(&mut self, place: Option<SurfacePlace>) {
        self.has_moved |= self.pointer != place;
        self.pointer = place;
    }

    fn draw(&mut self, scene: &Snapshot, station: u16, hit: Option<&SurfaceHit>, now: Instant) {
        let Some(hit) = hit else { return self.end_stroke() };
        let far = |stroke: &OpenStroke| (hit.point - stroke.last).norm();
        if self.stroke.as_ref().is_some_and(|open| open.body != hit.place.entity || far(open) > LEAP) {
            self.end_stroke();
        }
        match &mut self.stroke {
            Some(open) if far(open) < STEP => {}
            Some(open) => {
                open.places.push(hit.place);
                open.last = hit.point;
                if open.places.len() >= DRAWN_PLACES_MAX {
                    self.pass_on(now);
                }
            }
            None => {
                let own = scene.iter::<MentorStroke>().filter(|(_, stroke)| stroke.by.station == station);
                let greatest = own.map(|(_, stroke)| stroke.stroke).max().unwrap_or(0);
                self.last_stroke = self.last_stroke.max(greatest).saturating_add(1);
                if std::mem::take(&mut self.begins) {
                    if self.drags.len() == DRAGS_MAX {
                        self.drags.pop_front();
                    }
                    self.drags.push_back(self.last_stroke);
                }
                self.stroke = Some(OpenStroke {
                    number: self.last_stroke,
                    colour: COLOURS[self.colour % COLOURS.len()],
                    places: vec![hit.place],
                    since: now,
                    body: hit.place.entity,
                    last: hit.point,
                });
            }
        }
    }

    /// Passes on what was drawn of the open stroke.
    fn pass_on(&mut self, now: Instant) {
        let Some(open) = &mut self.stroke else { return };
        open.since = now;
        let places = std::mem::take(&mut open.places);
        if !places.is_empty() {
            let (stroke, colour) = (open.number, open.colour);
            self.does(MentorDeed::Draw { stroke, colour, width: WIDTH, places });
        }
    }

    fn end_stroke(&mut self) {
        if let Some(open) = &self.stroke {
            let since = open.since;
            self.pass_on(since);
        }
        self.stroke = None;
    }

    /// Erases what the person has drawn last, and is not erased yet: all strokes of one drag.
    pub(in crate::window) fn erase_last(&mut self, scene: &Snapshot, station: u16) {
        self.release();
        let own = scene.iter::<MentorStroke>().filter(|(_, stroke)| stroke.by.station == station);
        let mut drawn: BTreeSet<u32> = own.map(|(_, stroke)| stroke.stroke).collect();
        // The last ones may be on their way still.
        let first = self.drags.back().copied();
        drawn.extend(first.into_iter().flat_map(|first| first..=self.last_stroke));
        self.erased.retain(|number| drawn.contains(number));
        let left: Vec<u32> = drawn.difference(&self.erased).copied().collect();
        let Some(last) = left.last() else { return };
        // Strokes of a window before are erased one by one.
        let first = self.drags.iter().rfind(|first| *first <= last).copied().unwrap_or(*last);
        for stroke in left.iter().copied().filter(|stroke| *stroke >= first) {
            if self.erased.len() < ERASED_MAX {
                self.erased.insert(stroke);
            }
            self.does(MentorDeed::Erase { stroke });
        }
    }

    /// Takes away everything of the person's own, or of everybody.
    pub(in crate::window) fn clear(&mut self, of_all: bool) {
        self.release();
        self.does(MentorDeed::Clear { of_all });
    }

    /// Freezes the pictures, or lets them go on.
    pub(in crate::window) fn freeze(&mut self, scene: &Snapshot) {
        let is_frozen = scene.iter::<PictureFreeze>().next().is_some();
        self.does(MentorDeed::Freeze(!is_frozen));
    }

    /// Begins a label.
    pub(in crate::window) fn begin_label(&mut self, place: SurfacePlace) {
        self.release();
        self.label = Some(LabelEntry { place, text: String::new(), has_focus: false });
    }

    /// Puts the label that was written.
    pub(in crate::window) fn put_label(&mut self, scene: &Snapshot, station: u16) {
        let Some(LabelEntry { place, text, .. }) = self.label.take() else { return };
        let text = text.trim().to_owned();
        if text.is_empty() {
            return;
        }
        let own = scene.iter::<MentorLabel>().filter(|(_, label)| label.by.station == station);
        let greatest = own.map(|(_, label)| label.label).max().unwrap_or(0);
        self.last_label = self.last_label.max(greatest).saturating_add(1);
        self.does(MentorDeed::Label { label: self.last_label, place, text });
    }

    /// Something that is to be passed on.
    pub(in crate::window) fn does(&mut self, deed: MentorDeed) {
        if self.deeds.len() < DEEDS_MAX {
            self.deeds.push(deed);
        } else {
            self.is_full = true;
        }
    }

    /// Passes on what has grown for long enough.
    pub(in crate::window) fn pass(&mut self, now: Instant) {
        if self.stroke.as_ref().is_some_and(|open| now.duration_since(open.since) >= PART_EVERY) {
            self.pass_on(now);
        }
    }

    /// The pointer, if it has changed since the last call.
    pub(in crate::window) fn take_pointer(&mut self) -> Option<Option<SurfacePlace>> {
        std::mem::take(&mut self.has_moved).then_some(self.pointer)
    }

    /// Deeds that wait.
    pub(in crate::window) fn deeds(&mut self) -> &mut Vec<MentorDeed> {
        &mut self.deeds
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use trocar_scene::{Commands, EntityAllocator, Registry, Signature, SimTime, Store, SurfacePoint};

    use super::*;

    fn hit(body: u32, x: f64) -> SurfaceHit {
        let on = SurfacePoint::Body { point: [x as f32, 0.0, 0.0], normal: [0.0, 0.0, 1.0] };
        let place = SurfacePlace { entity: Entity::new(0, 0, body), on };
        SurfaceHit { place, point: Point3::new(x, 0.0, 0.0), distance: 0.1 }
    }

    struct Window {
        pen: Pen,
        store: Store,
        out: Commands,
        now: Instant,
    }

    impl Window {
        fn new() -> Self {
            let registry = Registry::standard();
            let out = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
            let mut pen = Pen::default();
            pen.set_on(true);
            Self { pen, store: Store::new(registry), out, now: Instant::now() }
        }
        /// A stroke of this number of station 3 is in the scene.
        fn shown(&mut self, stroke: u32) {
            let entity = self.out.spawn();
            let by = Signature { station: 3, name: "Ana".to_owned(), at: SimTime::ZERO };
            let places = Arc::new(vec![hit(1, 0.0).place]);
            let (section, colour, width, gaps) = (0, [1, 2, 3], 0.001, Vec::new());
            self.out.put(entity, MentorStroke { by, stroke, section, colour, width, places, gaps });
            self.out.seal();
            self.store.apply(&mut self.out, SimTime::ZERO);
            self.out.clear();
        }
        fn hover(&mut self, hit: Option<SurfaceHit>) {
            self.pen.hover(self.store.view(), 3, hit.as_ref(), self.now);
        }
        fn press(&mut self, hit: Option<SurfaceHit>) {
            self.pen.press(self.store.view(), 3, hit.as_ref(), self.now);
        }
        /// Numbers of strokes and of their places, as they were passed on.
        fn drawn(&mut self) -> Vec<(u32, usize)> {
            let of = |deed: &MentorDeed| match deed {
                MentorDeed::Draw { stroke, places, .. } => (*stroke, places.len()),
                MentorDeed::Erase { stroke } => (*stroke, 0),
                deed => panic!("{deed:?}"),
            };
            self.pen.deeds().drain(..).map(|deed| of(&deed)).collect()
        }
    }

    #[test]
    fn a_stroke_grows_in_parts_and_leaves_out_places_that_are_one() {
        let mut window = Window::new();
        window.hover(Some(hit(1, 0.0)));
        assert!(window.drawn().is_empty(), "it only points");
        assert_eq!(window.pen.take_pointer(), Some(Some(hit(1, 0.0).place)));
        assert_eq!(window.pen.take_pointer(), None);
        window.press(Some(hit(1, 0.0)));
        (0..=100).for_each(|step| window.hover(Some(hit(1, f64::from(step) * 1e-4))));
        window.pen.pass(window.now);
        assert!(window.drawn().is_empty());
        window.now += PART_EVERY;
        window.pen.pass(window.now);
        let places: usize = window.drawn().iter().map(|(_, count)| count).sum();
        assert!((25..=34).contains(&places), "{places} places of 10 mm");
        (0..100).for_each(|step| window.hover(Some(hit(1, 0.01 + f64::from(step) * 1e-3))));
        window.pen.release();
        let parts = window.drawn();
        assert!(parts.iter().all(|(stroke, count)| *stroke == 1 && *count <= DRAWN_PLACES_MAX), "{parts:?}");
        assert_eq!(parts.len(), 2);
        window.hover(Some(hit(1, 0.3)));
        assert!(window.drawn().is_empty(), "the button is up");
    }

    #[test]
    fn a_stroke_does_not_bridge_an_edge_or_go_on_at_another_body() {
        let mut window = Window::new();
        window.press(Some(hit(1, 0.0)));
        for at in [Some(hit(1, 0.001)), None, Some(hit(1, 0.003)), Some(hit(2, 0.004)), Some(hit(2, 0.1))] {
            window.hover(at);
        }
        window.pen.release();
        assert_eq!(window.drawn(), [(1, 2), (2, 1), (3, 1), (4, 1)]);
        window.press(Some(hit(1, 0.0)));
        window.pen.release();
        assert_eq!(window.drawn(), [(5, 1)]);
        // What was drawn in one drag is erased together.
        (1..=4).for_each(|stroke| window.shown(stroke));
        window.pen.erase_last(window.store.view(), 3);
        assert_eq!(window.drawn(), [(5, 0)]);
        window.pen.erase_last(window.store.view(), 3);
        assert_eq!(window.drawn(), [(1, 0), (2, 0), (3, 0), (4, 0)]);
        window.pen.erase_last(window.store.view(), 3);
        assert!(window.drawn().is_empty());
    }

    #[test]
    fn strokes_of_a_window_before_keep_their_numbers_and_are_erased_one_after_the_other() {
        let mut window = Window::new();
        (5..=7).for_each(|stroke| window.shown(stroke));
        window.press(Some(hit(1, 0.0)));
        window.pen.release();
        assert_eq!(window.drawn(), [(8, 1)]);
        // Nothing of it has come back from the host yet.
        (0..6).for_each(|_| window.pen.erase_last(window.store.view(), 3));
        assert_eq!(window.drawn(), [(8, 0), (7, 0), (6, 0), (5, 0)]);
        window.press(Some(hit(1, 0.0)));
        window.pen.release();
        assert_eq!(window.drawn(), [(9, 1)], "no number twice");
        window.pen.erase_last(window.store.view(), 4);
        assert_eq!(window.drawn(), [(9, 0)], "its own last one; those in the scene are of another station");
    }

    #[test]
    fn who_lays_the_pen_down_points_no_longer_and_too_many_deeds_are_told() {
        let mut window = Window::new();
        window.press(Some(hit(1, 0.0)));
        window.pen.set_on(false);
        assert_eq!((window.drawn(), window.pen.take_pointer()), (vec![(1, 1)], Some(None)));
        window.hover(Some(hit(1, 0.0)));
        assert_eq!(window.pen.take_pointer(), None);
        (0..DEEDS_MAX).for_each(|_| window.pen.clear(false));
        assert!(!window.pen.is_full);
        window.pen.clear(false);
        assert!(window.pen.is_full);
        assert_eq!(window.pen.deeds().len(), DEEDS_MAX);
    }

    #[test]
    fn a_label_has_a_number_of_its_own_and_none_without_a_text() {
        let mut window = Window::new();
        window.pen.begin_label(hit(1, 0.0).place);
        window.pen.put_label(window.store.view(), 3);
        assert!(window.pen.deeds().is_empty() && window.pen.label.is_none());
        for number in 1..3 {
            window.pen.begin_label(hit(1, 0.0).place);
            window.pen.label.as_mut().expect("it is written").text = " cut here ".to_owned();
            window.pen.put_label(window.store.view(), 3);
            let text = "cut here".to_owned();
            let label = MentorDeed::Label { label: number, place: hit(1, 0.0).place, text };
            assert_eq!(window.pen.deeds().pop(), Some(label));
        }
    }
}
