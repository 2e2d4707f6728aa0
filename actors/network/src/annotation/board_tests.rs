//! Notes of several stations on a piece of tissue that is cut, burned and taken away.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::annotation::PlaceReader;
use trocar_scene::{
    Access, Commands, Component, Entity, EntityAllocator, Hand, LABELS_MAX, MentorLabel, MentorPointer,
    MentorStroke, PictureFreeze, Pose, SECTION_PLACES_MAX, SECTIONS_MAX, Side, Signature, SimTime, Store,
    SurfaceMesh, SurfacePlace, SurfacePoint, TakeOverRequest, TakeOverStep, VertexPositions, WriterRules,
};

use super::{AnnotationBoard, Author};
use crate::control::{Note, NoteKind, NoteRefusal, PlainText, Refusal, STROKE_PLACES_MAX};
use crate::ticket::PlainName;

const HOST: u16 = 0;
const ANA: u16 = 5;
const BO: u16 = 6;

/// A host with a board: every batch is checked as the Model does it.
struct Session {
    store: Store,
    scenario: Commands,
    out: Commands,
    rules: WriterRules,
    board: AnnotationBoard,
    hand: Entity,
    tissue: Entity,
    now: SimTime,
}

impl Session {
    /// A strip of tissue of eight triangles, and a hand that Ana serves.
    fn new() -> Self {
        let registry = trocar_scene::Registry::standard();
        let mut scenario = Commands::new(registry.clone(), EntityAllocator::new(HOST, 0));
        let (tissue, hand) = (scenario.spawn(), scenario.spawn());
        let corners = (0..10).map(|at| Point3::new(f64::from(at / 2) * 0.01, f64::from(at % 2) * 0.01, 0.0));
        scenario.put(tissue, VertexPositions { positions: Arc::new(corners.collect()) });
        scenario.put(tissue, SurfaceMesh { triangles: Arc::new(strip()) });
        let (instrument, world_from_device) = (tissue, Pose::default());
        scenario.put(hand, Hand { side: Side::Right, instrument, world_from_device, scale: 1.0 });
        let out = Commands::new(registry.clone(), EntityAllocator::new(HOST, 9));
        let access = AnnotationBoard::access(Access::new());
        let rules = WriterRules::compile(&access, &registry, out.me()).expect("standard components");
        let board = AnnotationBoard::default();
        let store = Store::new(registry);
        let mut session = Self { store, scenario, out, rules, board, hand, tissue, now: SimTime::ZERO };
        session.write(|_, _| ());
        session
    }

    /// Somebody else writes.
    fn write(&mut self, write: impl FnOnce(&mut Commands, Entity)) {
        write(&mut self.scenario, self.tissue);
        self.scenario.seal();
        self.store.apply(&mut self.scenario, self.now);
        self.scenario.clear();
    }

    fn say(&mut self, station: u16, what: NoteKind) -> Result<(), Refusal> {
        let (host, ana, bo) = (name("host"), name("Ana"), name("Bo"));
        let named = match station {
            HOST => &host,
            ANA => &ana,
            _ => &bo,
        };
        self.now += SimTime::from_millis(1);
        what.check().expect("what comes over the wire is checked");
        let note = Note { station, at: self.now, what };
        let author = Author { name: named, is_host: station == HOST };
        self.board.apply(&note, author, &self.store.snapshot(), &mut self.out)
    }

    /// The end of a tick.
    fn tick(&mut self) {
        self.board.follow(&self.store.snapshot(), &mut self.out);
        self.out.seal();
        self.store.validate(&self.out, &self.rules).expect("what the board may do");
        self.store.apply(&mut self.out, self.now);
        self.out.clear();
    }

    fn all<T: Component>(&self) -> Vec<T> {
        self.store.view().iter::<T>().map(|(_, value)| value.clone()).collect()
    }

    /// Triangles of the strip, each with a place in its middle.
    fn places(&self, triangles: &[usize]) -> Vec<SurfacePlace> {
        let on = |triangle: &usize| SurfacePoint::Triangle {
            corners: strip()[*triangle],
            barycentric: [0.25, 0.25, 0.5],
        };
        triangles.iter().map(|triangle| SurfacePlace { entity: self.tissue, on: on(triangle) }).collect()
    }

    fn stroke(&self, stroke: u32, triangles: &[usize]) -> NoteKind {
        NoteKind::Stroke { stroke, colour: [255, 0, 0], width: 0.001, places: self.places(triangles) }
    }

    fn label(&self, label: u32, triangle: usize, text: &str) -> NoteKind {
        NoteKind::Label { label, place: self.places(&[triangle])[0], text: PlainText::new(text) }
    }

    /// Runs of a station's strokes, as lengths.
    fn runs(&self, station: u16) -> Vec<usize> {
        let all = self.all::<MentorStroke>();
        let own = all.iter().filter(|stroke| stroke.by.station == station);
        own.flat_map(|stroke| stroke.runs().map(<[_]>::len).collect::<Vec<_>>()).collect()
    }
}

fn strip() -> Vec<[u32; 3]> {
    (0..4)
        .flat_map(|cell| [[2 * cell, 2 * cell + 2, 2 * cell + 1], [2 * cell + 1, 2 * cell + 2, 2 * cell + 3]])
        .collect()
}

fn name(text: &str) -> PlainName {
    text.parse().expect("a name")
}

fn texts(session: &Session) -> Vec<String> {
    session.all::<MentorLabel>().into_iter().map(|label| label.text).collect()
}

#[test]
fn what_a_station_shows_is_in_the_scene_with_who_and_when() {
    let mut session = Session::new();
    session.say(ANA, session.stroke(1, &[0, 1, 2])).expect("shown");
    session.say(ANA, session.stroke(1, &[3])).expect("shown, in the same tick");
    session.say(BO, session.label(4, 6, " cut here ")).expect("shown");
    session.say(BO, NoteKind::Pointer(Some(session.places(&[7])[0]))).expect("shown");
    session.tick();
    let strokes = session.all::<MentorStroke>();
    assert_eq!((strokes.len(), strokes[0].places.len(), strokes[0].by.name.as_str()), (1, 4, "Ana"));
    assert_eq!((strokes[0].by.station, strokes[0].by.at), (ANA, SimTime::from_millis(2)));
    assert_eq!(texts(&session), ["cut here"]);
    // The places are where the tissue is.
    let scene = session.store.snapshot();
    let pointer = &session.all::<MentorPointer>()[0];
    let found = PlaceReader::new(&scene).find(&pointer.place).expect("on the tissue");
    assert!((found.point - Point3::new(0.0375, 0.0075, 0.0)).norm() < 0.003, "{found:?}");
    // It moves, and is the same entity; then it ends.
    session.say(BO, NoteKind::Pointer(Some(session.places(&[1])[0]))).expect("shown");
    session.tick();
    let pointers = session.all::<MentorPointer>();
    assert_eq!((pointers.len(), pointers[0].by.at), (1, SimTime::from_millis(5)));
    session.say(BO, NoteKind::Pointer(None)).expect("ends");
    session.tick();
    assert!(session.all::<MentorPointer>().is_empty());
    // A label changes under its number.
    session.say(BO, session.label(4, 2, "or here")).expect("shown");
    session.tick();
    assert_eq!(texts(&session), ["or here"]);
}

#[test]
fn what_comes_and_goes_within_a_tick_leaves_nothing() {
    let mut session = Session::new();
    session.say(ANA, NoteKind::Pointer(Some(session.places(&[0])[0]))).expect("shown");
    session.say(ANA, NoteKind::Pointer(None)).expect("ends");
    session.say(ANA, session.stroke(1, &[0])).expect("shown");
    session.say(ANA, NoteKind::Erase { stroke: 1 }).expect("erased");
    session.say(ANA, NoteKind::Freeze(true)).expect("frozen");
    session.say(ANA, NoteKind::Freeze(false)).expect("no longer");
    let entities = session.store.snapshot().entities().count();
    session.tick();
    session.tick();
    assert!(session.all::<MentorPointer>().is_empty() && session.all::<MentorStroke>().is_empty());
    assert!(session.all::<PictureFreeze>().is_empty());
    assert_eq!(session.store.snapshot().entities().count(), entities);
}

#[test]
fn a_station_erases_its_own_and_the_host_everything() {
    let mut session = Session::new();
    for station in [ANA, BO] {
        session.say(station, session.stroke(1, &[0, 1])).expect("shown");
        session.say(station, session.stroke(2, &[2, 3, 4])).expect("shown");
        session.say(station, session.label(1, 5, "here")).expect("shown");
    }
    session.tick();
    session.say(ANA, NoteKind::Erase { stroke: 1 }).expect("its own");
    session.say(ANA, NoteKind::Unlabel { label: 1 }).expect("its own");
    session.say(ANA, NoteKind::Erase { stroke: 77 }).expect("there is none: that is what was wanted");
    session.tick();
    assert_eq!((session.runs(ANA), session.runs(BO), texts(&session).len()), (vec![3], vec![2, 3], 1));
    for station in [Some(BO), None, Some(HOST)] {
        let refused = session.say(ANA, NoteKind::Clear { station }).expect_err("not its own");
        assert_eq!(refused, Refusal::Note(NoteRefusal::NotOwn));
    }
    session.say(HOST, NoteKind::Clear { station: Some(BO) }).expect("the host may");
    session.tick();
    assert_eq!((session.runs(ANA), session.runs(BO), texts(&session).len()), (vec![3], vec![], 0));
    session.say(BO, session.stroke(1, &[6])).expect("shown");
    session.say(ANA, NoteKind::Clear { station: Some(ANA) }).expect("its own");
    session.tick();
    assert_eq!((session.runs(ANA), session.runs(BO)), (vec![], vec![1]));
    session.say(HOST, NoteKind::Clear { station: None }).expect("the host may");
    session.tick();
    assert!(session.all::<MentorStroke>().is_empty());
}

#[test]
fn strokes_lose_what_is_cut_or_burned_away_and_labels_go_with_their_tissue() {
    let mut session = Session::new();
    session.say(ANA, session.stroke(1, &[0, 1, 2, 3, 4, 5, 6, 7])).expect("shown");
    session.say(ANA, session.label(1, 3, "kept")).expect("shown");
    session.say(ANA, session.label(2, 2, "lost")).expect("shown");
    session.say(BO, NoteKind::Pointer(Some(session.places(&[2])[0]))).expect("shown");
    session.tick();
    // A burn takes the third triangle: all after it have other numbers.
    session.write(|out, tissue| {
        let mut triangles = strip();
        triangles.remove(2);
        out.put(tissue, SurfaceMesh { triangles: Arc::new(triangles) });
    });
    session.tick();
    session.tick();
    assert_eq!((session.runs(ANA), texts(&session)), (vec![2, 5], vec!["kept".to_owned()]));
    assert!(session.all::<MentorPointer>().is_empty());
    // A blade splits the one with the label: it has another corner.
    session.write(|out, tissue| {
        let mut triangles = strip();
        triangles.remove(2);
        triangles[2][0] = 9;
        out.put(tissue, SurfaceMesh { triangles: Arc::new(triangles) });
    });
    // What is drawn in this very tick is judged by the new surface, and so is what was there before.
    session.say(BO, session.stroke(1, &[2, 3, 4])).expect("one of three is there");
    let gone = session.say(BO, session.label(1, 3, "gone")).expect_err("cut");
    assert_eq!(gone.to_string(), "there is no such surface any more: it was cut, or is gone");
    session.tick();
    session.tick();
    assert_eq!((session.runs(ANA), session.runs(BO), texts(&session).len()), (vec![2, 4], vec![1], 0));
    session.write(|out, tissue| out.despawn(tissue));
    session.tick();
    session.tick();
    assert!(session.all::<MentorStroke>().is_empty());
    assert!(session.say(BO, session.stroke(2, &[0])).is_err());
}

#[test]
fn there_is_an_end_to_strokes_and_labels_in_words() {
    let mut session = Session::new();
    let long: Vec<usize> = (0..STROKE_PLACES_MAX).map(|at| at % 8).collect();
    let note = session.stroke(1, &long);
    let refused = loop {
        match session.say(ANA, note.clone()) {
            Ok(()) => session.tick(),
            Err(refused) => break refused,
        }
        assert!(session.all::<MentorStroke>().len() <= SECTIONS_MAX);
    };
    let words = format!("the strokes of the scene have {SECTIONS_MAX} sections already; erase some");
    assert_eq!(refused.to_string(), words);
    let sections = session.all::<MentorStroke>();
    assert!(sections.len() > SECTIONS_MAX - STROKE_PLACES_MAX / (SECTION_PLACES_MAX - 1) - 1);
    assert!(sections.iter().all(|section| section.places.len() <= SECTION_PLACES_MAX));
    session.say(ANA, NoteKind::Erase { stroke: 1 }).expect("erased");
    session.tick();
    assert_eq!(session.say(ANA, note), Ok(()));
    for label in 0..LABELS_MAX as u32 {
        session.say(BO, session.label(label, 0, "x")).expect("shown");
    }
    let refused = session.say(ANA, session.label(1, 0, "x")).expect_err("full").to_string();
    assert_eq!(refused, format!("the scene has {LABELS_MAX} labels already; take one away"));
    assert_eq!(session.say(BO, session.label(3, 1, "changed")), Ok(()));
    assert_eq!(session.say(BO, session.label(3, 1, " ")), Err(NoteRefusal::NoText.into()));
    session.tick();
    assert_eq!(texts(&session).len(), LABELS_MAX);
}

#[test]
fn a_picture_is_frozen_by_one_and_freed_by_everybody() {
    let mut session = Session::new();
    session.say(ANA, NoteKind::Freeze(true)).expect("frozen");
    session.tick();
    assert_eq!(session.all::<PictureFreeze>()[0].by.name, "Ana");
    session.say(ANA, NoteKind::Freeze(true)).expect("it is");
    let refused = session.say(BO, NoteKind::Freeze(true)).expect_err("by another").to_string();
    assert_eq!(refused, "'Ana' has frozen the picture already");
    session.say(BO, NoteKind::Freeze(false)).expect("freed");
    session.tick();
    assert!(session.all::<PictureFreeze>().is_empty());
    session.say(BO, NoteKind::Freeze(false)).expect("it is");
    session.tick();
}

#[test]
fn the_pointer_of_who_leaves_goes_and_the_strokes_stay() {
    let mut session = Session::new();
    session.say(BO, session.stroke(1, &[0, 1])).expect("shown");
    session.say(BO, session.label(1, 0, "here")).expect("shown");
    session.say(BO, NoteKind::Pointer(Some(session.places(&[2])[0]))).expect("shown");
    session.say(ANA, NoteKind::Pointer(Some(session.places(&[3])[0]))).expect("shown");
    session.say(BO, NoteKind::Freeze(true)).expect("frozen");
    session.tick();
    session.board.leave(BO);
    session.tick();
    let pointers = session.all::<MentorPointer>();
    assert_eq!((pointers.len(), pointers[0].by.station), (1, ANA));
    assert!(session.all::<PictureFreeze>().is_empty());
    assert_eq!((session.runs(BO), texts(&session).len()), (vec![2], 1));
}

#[test]
fn requests_for_instruments_are_shown_at_their_hands_as_the_session_has_them() {
    let mut session = Session::new();
    let hand = session.hand;
    let by = Signature { station: BO, name: "Bo".to_owned(), at: session.now };
    let asked = TakeOverRequest { by: by.clone(), step: TakeOverStep::Asked, answer: None };
    let taken = TakeOverRequest { step: TakeOverStep::Accepted, answer: Some(by), ..asked.clone() };
    for (wished, put) in [(Some(&asked), 1), (Some(&asked), 0), (Some(&taken), 1), (None, 1), (None, 0)] {
        let scene = session.store.snapshot();
        let requests = wished.map(|request| (hand, request.clone()));
        session.board.show_requests(requests.into_iter(), &scene, &mut session.out);
        assert_eq!(!session.out.is_empty(), put == 1, "only what has changed is written");
        session.tick();
        assert_eq!(session.store.view().get::<TakeOverRequest>(hand), wished);
        // Of one that is built anew it is known what the scene has.
        session.board = AnnotationBoard::of(&session.store.snapshot());
    }
}

#[test]
fn a_board_that_is_built_anew_goes_on_with_what_the_scene_has() {
    let mut session = Session::new();
    session.say(ANA, session.stroke(1, &[0, 1, 2])).expect("shown");
    session.say(BO, NoteKind::Pointer(Some(session.places(&[5])[0]))).expect("shown");
    session.say(BO, NoteKind::Freeze(true)).expect("frozen");
    session.tick();
    // While there is no board, a blade cuts.
    session.write(|out, tissue| {
        out.put(tissue, SurfaceMesh { triangles: Arc::new(strip()[1..].to_vec()) });
    });
    session.board = AnnotationBoard::of(&session.store.snapshot());
    session.tick();
    assert_eq!(session.runs(ANA), [2]);
    session.say(ANA, session.stroke(1, &[3])).expect("shown");
    session.say(BO, NoteKind::Pointer(Some(session.places(&[6])[0]))).expect("shown");
    session.say(ANA, NoteKind::Freeze(false)).expect("freed");
    session.tick();
    assert_eq!((session.runs(ANA), session.all::<MentorPointer>().len()), (vec![3], 1));
    assert_eq!(session.all::<MentorStroke>().len(), 1);
    assert!(session.all::<PictureFreeze>().is_empty());
}

#[test]
fn what_somebody_else_removes_is_forgotten() {
    let mut session = Session::new();
    session.say(ANA, session.stroke(1, &[0, 1, 2])).expect("shown");
    session.say(ANA, NoteKind::Freeze(true)).expect("frozen");
    session.tick();
    session.tick();
    let scene = session.store.snapshot();
    let removed: Vec<Entity> = scene.entities().filter(|entity| entity.spawner() == 9).collect();
    session.write(|out, _| removed.iter().for_each(|entity| out.despawn(*entity)));
    session.tick();
    session.say(ANA, session.stroke(1, &[3])).expect("shown, as a new one");
    session.say(BO, NoteKind::Freeze(true)).expect("nobody has");
    session.tick();
    assert_eq!((session.runs(ANA), session.all::<PictureFreeze>().len()), (vec![1], 1));
}
