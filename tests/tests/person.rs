//! A person with only mouse and keyboard transfers a ring of the peg transfer.
//!
//! The person is a script with a person's means: it sees positions in the picture, and moves the pointer, turns the
//! wheel, and presses buttons and keys, sixty times per second.

use std::time::Duration;

use nalgebra::{Point3, Vector3};
use trocar::play::{Bindings, Control, Controls, person};
use trocar::run::{RunOptions, start};
use trocar::session::Session;
use trocar_kernel::faults::FaultPlan;
use trocar_scene::{
    Camera, DeviceState, Entity, Grasp, HandTarget, PersonInput, PersonView, Side, SimTime, Snapshot,
    TaskState, Velocity,
};
use trocar_tests::{Names, app, names};

/// Interval between two pictures.
const FRAME: SimTime = SimTime::from_micros(16_667);
/// Share of the remaining distance in the picture that the mouse moves per picture.
const HASTE: f64 = 0.08;
/// Largest motion of the pointer between two pictures \[heights of the picture\].
const STROKE_MAX: f64 = 0.012;

struct Person {
    session: Session,
    controls: Controls,
    me: Entity,
    names: Names,
    view: PersonView,
}

impl Person {
    fn sits_down(mut session: Session) -> Self {
        let scene = session.snapshot();
        let (camera, lens) = scene.iter::<Camera>().next().expect("the scenario has a camera");
        let view = PersonView {
            world_from_view: scene.world_pose(camera).into(),
            field_of_view: lens.field_of_view,
        };
        let controls = Controls::new(Bindings::default(), &scene);
        let me = person(&scene).expect("somebody plays");
        Self { controls, me, names: names(&scene), view, session }
    }

    fn scene(&mut self) -> std::sync::Arc<Snapshot> {
        self.session.snapshot()
    }

    fn press(&mut self, name: &str, down: bool) {
        let control = Control::named(name).expect("a control");
        assert!(self.controls.press(control, f64::from(u8::from(down))), "{name} means something");
    }

    /// One picture: writes the input, and lets time pass.
    fn frame(&mut self) {
        self.controls.advance(FRAME.as_secs_f64());
        let input = self.controls.input(Some(self.view), self.session.now());
        let me = self.me;
        self.session.apply(|out| out.put(me, input)).expect("written");
        self.session.step(FRAME);
    }

    fn wait(&mut self, frames: usize) {
        (0..frames).for_each(|_| self.frame());
    }

    /// Position in the picture: right and down in heights of the picture, and the logarithm of the depth.
    fn seen(&self, point_in_world: &Vector3<f64>) -> Vector3<f64> {
        let eye = self.view.world_from_view.isometry();
        let point = eye.inverse_transform_point(&Point3::from(*point_in_world));
        let height = 2.0 * (0.5 * self.view.field_of_view).tan();
        Vector3::new(point.x / point.z / height, point.y / point.z / height, point.z.ln())
    }

    fn tip(&mut self, side: Side) -> nalgebra::Isometry3<f64> {
        let instrument = self.names.instruments[side as usize];
        self.scene().world_pose(instrument)
    }

    /// Moves the tip of the active hand to a place with mouse and wheel; true once it is there.
    fn lead(&mut self, to: impl Fn(&Snapshot) -> Vector3<f64>, tolerance: f64, frames: usize) -> bool {
        for _ in 0..frames {
            let side = self.controls.in_charge();
            let tip = self.tip(side).translation.vector;
            let goal = to(&self.scene());
            if (goal - tip).norm() < tolerance {
                return true;
            }
            let way = (self.seen(&goal) - self.seen(&tip)) * HASTE;
            let stroke = |x: f64| x.clamp(-STROKE_MAX, STROKE_MAX);
            self.controls.pointer_moved(stroke(way.x), stroke(way.y));
            let notch = self.controls.bindings().depth_per_notch;
            self.controls.scrolled(stroke(way.z) / notch);
            self.frame();
        }
        false
    }

    fn holds(&mut self, side: Side) -> Option<Entity> {
        let instrument = self.names.instruments[side as usize];
        self.scene().get::<Grasp>(instrument).map(|grasp| grasp.held)
    }

    fn ring(&mut self, name: &str) -> Entity {
        self.scene().find(name).expect("the scenario has this ring")
    }
}

/// A point on a ring's centre line: its intersection with the closing direction of the jaws, on the side of `towards`.
fn grasp_point(scene: &Snapshot, ring: Entity, tip: Entity, towards: &Vector3<f64>) -> Vector3<f64> {
    let pose = scene.world_pose(ring);
    let normal = pose.rotation * Vector3::z();
    let closing = scene.world_pose(tip).rotation * Vector3::x();
    let across = (closing - normal * closing.dot(&normal)).normalize();
    let side = if across.dot(towards) < 0.0 { -1.0 } else { 1.0 };
    pose.translation.vector + across * (side * 0.008)
}

fn open(seed: u64) -> Person {
    let session = Session::builder().seed(seed).play().open("peg-transfer").expect("the session opens");
    Person::sits_down(session)
}

/// Grasps a ring with the left hand, lifts it, and carries it away; returns the person and the state hash.
fn carry_a_ring(seed: u64) -> (Person, Entity) {
    let mut person = open(seed);
    let ring = person.ring("ring.3");
    let instrument = person.names.instruments[Side::Left as usize];
    let outwards = Vector3::new(-1.0, 0.0, 0.0);
    let up = Vector3::z();
    person.wait(30);
    let above = |scene: &Snapshot| grasp_point(scene, ring, instrument, &outwards) + up * 0.02;
    assert!(person.lead(above, 0.001, 600), "above the ring: {:?}", person.tip(Side::Left));
    let at = |scene: &Snapshot| grasp_point(scene, ring, instrument, &outwards) - up * 0.0002;
    assert!(person.lead(at, 0.0006, 600), "at the ring: {:?}", person.tip(Side::Left));
    person.press("MouseLeft", true);
    person.wait(30);
    assert_eq!(person.holds(Side::Left), Some(ring), "the ring is held: {:?}", person.tip(Side::Left));
    let lifted = person.tip(Side::Left).translation.vector + up * 0.04;
    assert!(person.lead(|_| lifted, 0.002, 600), "lifted: {:?}", person.tip(Side::Left));
    assert_eq!(person.holds(Side::Left), Some(ring), "still held after the lift");
    let height = person.scene().world_pose(ring).translation.z;
    assert!(height > 0.025, "the ring is {height} m high");
    (person, ring)
}

/// Moves a held ring's centre to a place, by the tip that holds it.
fn lead_ring(person: &mut Person, ring: Entity, to: &Vector3<f64>, tolerance: f64) -> bool {
    let tip = person.names.instruments[person.controls.in_charge() as usize];
    let goal = |scene: &Snapshot| {
        scene.world_pose(tip).translation.vector + to - scene.world_pose(ring).translation.vector
    };
    person.lead(goal, tolerance, 600)
}

#[test]
fn a_person_with_a_mouse_takes_a_ring_carries_it_and_puts_it_back() {
    let (mut person, ring) = carry_a_ring(3);
    let held = person.scene().world_pose(ring).translation.vector;
    let away = Vector3::new(-0.020, 0.012, held.z);
    assert!(
        lead_ring(&mut person, ring, &away, 0.002),
        "carried away: {:?}",
        person.scene().world_pose(ring)
    );
    // Around the peg that its own ring has left free.
    let peg = Vector3::new(-0.012, -0.015, 0.0);
    let over = peg + Vector3::z() * held.z;
    assert!(
        lead_ring(&mut person, ring, &over, 0.0015),
        "over the peg: {:?}",
        person.scene().world_pose(ring)
    );
    assert_eq!(person.holds(Side::Left), Some(ring));
    let low = peg + Vector3::z() * 0.004;
    assert!(lead_ring(&mut person, ring, &low, 0.002), "lowered: {:?}", person.scene().world_pose(ring));
    person.press("MouseLeft", false);
    person.wait(60);
    assert_eq!(person.holds(Side::Left), None, "let go");
    let clear = person.tip(Side::Left).translation.vector + Vector3::z() * 0.03;
    assert!(person.lead(|_| clear, 0.002, 600), "withdrawn");
    let scene = person.scene();
    let lies = scene.world_pose(ring).translation.vector;
    let speed = scene.get::<Velocity>(ring).expect("it moves").linear.norm();
    assert!(lies.z.abs() < 0.003 && speed < 0.01, "it lies on the board: {lies:?}, {speed} m/s");
    assert!((lies - peg).xy().norm() < 0.0065, "around its peg: {lies:?}");
    assert_eq!(person.session.task().errors, [], "the referee has seen nothing wrong");
    // The other hand has not moved.
    let target = scene.get::<HandTarget>(person.names.hands[1]).expect("a target");
    assert!(target.handle_in_device.translation.norm() < 1e-9, "{target:?}");
}

#[test]
fn a_person_with_a_mouse_hands_a_ring_over_and_puts_it_on_the_other_board() {
    let (mut person, ring) = carry_a_ring(4);
    let held = person.scene().world_pose(ring).translation.vector;
    let meeting = Vector3::new(0.0, 0.0, held.z);
    assert!(lead_ring(&mut person, ring, &meeting, 0.002), "brought: {:?}", person.scene().world_pose(ring));
    // The left hand keeps its grip, whatever happens to the button.
    person.press("Tab", true);
    person.press("Tab", false);
    person.press("MouseLeft", false);
    let instrument = person.names.instruments[Side::Right as usize];
    let outwards = Vector3::new(1.0, 0.0, 0.0);
    let before = |scene: &Snapshot| {
        let back = scene.world_pose(instrument).rotation * Vector3::z() * -0.02;
        grasp_point(scene, ring, instrument, &outwards) + back
    };
    assert!(person.lead(before, 0.001, 900), "before the ring: {:?}", person.tip(Side::Right));
    let at = |scene: &Snapshot| {
        let deeper = scene.world_pose(instrument).rotation * Vector3::z() * 0.001;
        grasp_point(scene, ring, instrument, &outwards) + deeper
    };
    assert!(person.lead(at, 0.0006, 900), "at the ring: {:?}", person.tip(Side::Right));
    person.press("MouseLeft", true);
    person.wait(30);
    assert_eq!([Side::Left, Side::Right].map(|side| person.holds(side)), [Some(ring); 2], "both hold it");
    // Back to the left hand, which opens and retracts.
    person.press("Tab", true);
    person.press("Tab", false);
    person.press("MouseLeft", false);
    person.wait(10);
    assert_eq!(
        [Side::Left, Side::Right].map(|side| person.holds(side)),
        [Some(ring); 2],
        "both hold it still"
    );
    person.press("MouseLeft", true);
    person.press("MouseLeft", false);
    person.wait(30);
    assert_eq!([Side::Left, Side::Right].map(|side| person.holds(side)), [None, Some(ring)], "handed over");
    let tip = person.tip(Side::Left);
    let clear = tip.translation.vector + tip.rotation * Vector3::z() * -0.03;
    assert!(person.lead(|_| clear, 0.003, 600), "withdrawn");
    person.press("Tab", true);
    person.press("Tab", false);
    let peg = Vector3::new(0.040, -0.015, 0.0);
    let over = peg + Vector3::z() * 0.036;
    assert!(
        lead_ring(&mut person, ring, &over, 0.0015),
        "over the peg: {:?}",
        person.scene().world_pose(ring)
    );
    let low = peg + Vector3::z() * 0.006;
    assert!(lead_ring(&mut person, ring, &low, 0.002), "lowered: {:?}", person.scene().world_pose(ring));
    person.press("MouseLeft", true);
    person.press("MouseLeft", false);
    person.wait(60);
    let tip = person.tip(Side::Right);
    let clear = tip.translation.vector + tip.rotation * Vector3::z() * -0.03;
    assert!(person.lead(|_| clear, 0.003, 600), "withdrawn");
    person.wait(60);
    assert_eq!(person.session.task().errors, [], "the referee has seen nothing wrong");
    let scene = person.scene();
    let (_, task) = scene.iter::<TaskState>().next().expect("an exercise");
    assert_eq!(task.done, 1, "one ring is done: {:?}", scene.world_pose(ring));
}

#[test]
fn the_same_person_does_the_same_to_the_bit() {
    let hash = || {
        let (person, _) = carry_a_ring(5);
        person.session.hash().expect("lock-step has a hash")
    };
    assert_eq!(hash(), hash());
}

/// Target and motion of the left hand, millisecond by millisecond, while a person drags, presses and drags on.
struct Drag {
    targets: Vec<HandTarget>,
    handles: Vec<Vector3<f64>>,
}

impl Drag {
    fn of(faults: Option<FaultPlan>) -> Self {
        let mut builder = Session::builder().seed(2).play();
        if let Some(plan) = faults {
            builder = builder.faults(plan);
        }
        let mut person = Person::sits_down(builder.open("peg-transfer").expect("the session opens"));
        let mut drag = Drag { targets: Vec::new(), handles: Vec::new() };
        for frame in 0..90 {
            person.controls.pointer_moved(0.003, if frame < 45 { 0.002 } else { -0.002 });
            person.controls.scrolled(0.05);
            if frame == 30 {
                person.press("MouseLeft", true);
            }
            let input = person.controls.input(Some(person.view), person.session.now());
            let me = person.me;
            person.session.apply(|out| out.put(me, input)).expect("written");
            for _ in 0..16 {
                person.session.step(SimTime::from_millis(1));
                let (scene, hand) = (person.scene(), person.names.hands[0]);
                drag.targets.extend(scene.get::<HandTarget>(hand).copied());
                let state = scene.get::<DeviceState>(hand).copied().unwrap_or_default();
                drag.handles.push(state.handle_in_device.translation);
            }
        }
        drag
    }

    /// Largest speed of the target between two changes \[m/s\].
    fn target_speed(&self) -> f64 {
        let place = |index: usize| self.targets[index].handle_in_device.translation;
        let (mut changed, mut speed) = (None, 0.0_f64);
        for index in 1..self.targets.len() {
            let way = (place(index) - place(index - 1)).norm();
            if way > 0.0 {
                let millis = changed.map_or(10, |before| index - before);
                speed = speed.max(way / (millis as f64 * 1e-3));
                changed = Some(index);
            }
        }
        speed
    }

    /// Largest motion of the handle in a millisecond \[m\].
    fn handle_step(&self) -> f64 {
        self.handles.windows(2).map(|pair| (pair[1] - pair[0]).norm()).fold(0.0, f64::max)
    }
}

#[test]
fn a_controller_that_dies_in_the_middle_of_a_drag_goes_on_without_a_jump() {
    let undisturbed = Drag::of(None);
    // During a drag, and while the jaws close.
    let plan = FaultPlan::new(2)
        .at(SimTime::from_millis(300))
        .kill("manual")
        .at(SimTime::from_millis(505))
        .kill("manual")
        .at(SimTime::from_millis(1_001))
        .kill("manual");
    let killed = Drag::of(Some(plan));
    assert_eq!(undisturbed.targets.len(), killed.targets.len());
    let (first, last) = (undisturbed.targets[0], undisturbed.targets[undisturbed.targets.len() - 1]);
    let moved = (last.handle_in_device.translation - first.handle_in_device.translation).norm();
    assert!(moved > 0.01, "the drag goes somewhere: {moved} m");
    // The missed time is made up for, without overshoot; the hand itself hardly changes.
    let speeds = [undisturbed.target_speed(), killed.target_speed()];
    assert!(speeds[1] <= 1.1 * speeds[0], "{speeds:?} m/s");
    let steps = [undisturbed.handle_step(), killed.handle_step()];
    println!("targets at most {speeds:?} m/s, the handle at most {steps:?} m in a millisecond");
    assert!(steps[1] <= 0.25e-3, "{steps:?} m");
    let same = killed.targets[killed.targets.len() - 1];
    let apart = (last.handle_in_device.translation - same.handle_in_device.translation).norm();
    assert!(apart < 1e-6 && (last.gripper - same.gripper).abs() < 1e-6, "{last:?} {same:?}");
}

#[test]
fn a_window_that_is_opened_anew_moves_nothing_and_its_motion_counts_from_the_first_write() {
    let mut person = open(1);
    for _ in 0..30 {
        person.controls.pointer_moved(0.003, 0.0);
        person.frame();
    }
    person.wait(30);
    let hand = person.names.hands[0];
    let target = |person: &mut Person| {
        person.scene().get::<HandTarget>(hand).expect("a target").handle_in_device.translation
    };
    let before = target(&mut person);
    person.controls = Controls::new(Bindings::default(), &person.session.snapshot());
    person.wait(30);
    assert!((target(&mut person) - before).norm() < 1e-7, "nothing jumps back");
    person.controls.pointer_moved(0.02, 0.0);
    person.wait(30);
    assert!((target(&mut person) - before).norm() > 0.001);
    let scene = person.scene();
    assert_eq!(scene.get::<PersonInput>(person.me).expect("a person").source, 2);
}

#[test]
fn in_real_time_a_window_writes_from_a_thread_of_its_own() {
    let app = app();
    let scenario = app.scenario("peg-transfer").expect("a scenario");
    let options = RunOptions { play: true, ..RunOptions::default() };
    let mut session = start(&app, &scenario, &options).expect("it starts");
    let scene = session.snapshot();
    let (me, hand) = (person(&scene).expect("somebody plays"), names(&scene).hands[0]);
    let mut controls = Controls::new(Bindings::default(), &scene);
    let mut operator = session.operator().expect("room for one").expect("real time");
    let window = std::thread::spawn(move || {
        for _ in 0..60 {
            controls.pointer_moved(0.003, 0.0);
            let input = controls.input(None, SimTime::ZERO);
            operator.apply(Duration::from_secs(30), |out| out.put(me, input)).expect("written");
            std::thread::sleep(Duration::from_millis(2));
        }
    });
    window.join().expect("the window does not panic");
    let moved = |scene: &Snapshot| {
        let target = scene.get::<HandTarget>(hand);
        target.map_or(0.0, |target| target.handle_in_device.translation.norm())
    };
    // For a machine of any speed.
    while moved(&session.snapshot()) < 0.01 && session.now() < SimTime::from_millis(60_000) {
        session.step(SimTime::from_millis(10));
    }
    assert!(moved(&session.snapshot()) >= 0.01);
    assert_eq!(session.finish().outcome.code, 0);
}

#[test]
fn the_manual_shows_the_default_bindings() {
    let page = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/playing.md");
    let page = std::fs::read_to_string(page).expect("a readable page");
    let table = Bindings::default().table();
    assert!(page.contains(&table), "docs/playing.md shows other bindings than these:\n{table}");
}
