//! A frozen picture: while somebody has frozen it ([`PictureFreeze`]), a viewer shows the scene of that moment, and over it
//! what persons point at and draw now.

use trocar_scene::{
    Component, MentorLabel, MentorPointer, MentorStroke, PictureFreeze, Signature, Snapshot, TakeOverRequest,
};

/// First number of [`Snapshot::retouches`] of a still picture. Those of moving ones are lower, so that a viewer looks at the
/// whole scene anew when the picture goes on: it has not seen what happened in between.
const STILL: u64 = 1 << 62;

/// Holds the picture of one viewer while it is frozen.
#[derive(Default)]
pub struct StillPicture {
    held: Option<Held>,
}

struct Held {
    by: Signature,
    /// What is shown: all of the moment, and the annotations of now.
    scene: Snapshot,
}

impl StillPicture {
    /// Of a viewer that has shown nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// What to show for a scene: the scene itself, or the one that was shown when its picture was frozen. One that comes to a
    /// frozen scene later holds the first that it sees.
    pub fn show(&mut self, scene: &Snapshot) -> Snapshot {
        let Some((_, PictureFreeze { by })) = scene.iter::<PictureFreeze>().next() else {
            self.held = None;
            return scene.clone();
        };
        // A recording may be wound back to before the moment that is held.
        let is_same = |held: &Held| {
            held.by == *by && held.scene.revision() <= scene.revision() && held.scene.time() <= scene.time()
        };
        match self.held.as_mut().filter(|held| is_same(held)) {
            Some(held) => {
                if annotate(&mut held.scene, scene) {
                    held.scene.renumber(held.scene.retouches() + 1);
                }
                held.scene.clone()
            }
            None => {
                let mut still = scene.clone();
                still.renumber(STILL);
                self.held = Some(Held { by: by.clone(), scene: still.clone() });
                still
            }
        }
    }

    /// Whether the last scene shown was a held one.
    pub fn is_held(&self) -> bool {
        self.held.is_some()
    }
}

/// Takes over what persons show now; returns whether any of it has changed.
fn annotate(still: &mut Snapshot, now: &Snapshot) -> bool {
    fn column<T: Component>(still: &mut Snapshot, now: &Snapshot) -> bool {
        still.show_column::<T>(now)
    }
    let all = [
        column::<MentorPointer>,
        column::<MentorStroke>,
        column::<MentorLabel>,
        column::<PictureFreeze>,
        column::<TakeOverRequest>,
    ];
    all.into_iter().fold(false, |changed, column| column(still, now) | changed)
}

#[cfg(test)]
mod tests {
    use trocar_scene::{
        Commands, Entity, EntityAllocator, Pose, Registry, SimTime, Store, SurfacePlace, SurfacePoint,
    };

    use super::*;

    struct Scene {
        store: Store,
        out: Commands,
        body: Entity,
        millis: u64,
    }

    impl Scene {
        fn new() -> Self {
            let registry = Registry::standard();
            let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
            let body = out.spawn();
            let mut scene = Self { store: Store::new(registry), out, body, millis: 0 };
            scene.write(|out| out.put(body, Pose::default()));
            scene
        }
        fn write<T>(&mut self, write: impl FnOnce(&mut Commands) -> T) -> T {
            self.millis += 10;
            let value = write(&mut self.out);
            self.store.apply(&mut self.out, SimTime::from_millis(self.millis));
            self.out.clear();
            value
        }
        fn freeze(&mut self, station: u16) -> Entity {
            let by = by(station, self.millis);
            self.write(|out| {
                let entity = out.spawn();
                out.put(entity, PictureFreeze { by });
                entity
            })
        }
        fn move_to(&mut self, x: f64) {
            let body = self.body;
            self.write(|out| out.put(body, Pose::at(x, 0.0, 0.0)));
        }
        fn at(&self, shown: &Snapshot) -> f64 {
            shown.get::<Pose>(self.body).expect("it has one").translation.x
        }
    }

    fn by(station: u16, millis: u64) -> Signature {
        Signature { station, name: "Ana".to_owned(), at: SimTime::from_millis(millis) }
    }

    #[test]
    fn a_frozen_picture_stands_still_and_shows_what_is_drawn_now() {
        let (mut scene, mut still) = (Scene::new(), StillPicture::new());
        scene.move_to(0.1);
        assert_eq!(still.show(&scene.store.snapshot()).retouches(), 0);
        let freeze = scene.freeze(3);
        let first = still.show(&scene.store.snapshot());
        scene.move_to(0.2);
        let second = still.show(&scene.store.snapshot());
        assert_eq!((scene.at(&first), scene.at(&second), still.is_held()), (0.1, 0.1, true));
        // Nothing has changed, so that nothing is drawn again.
        let seen = |shown: &Snapshot| (shown.revision(), shown.retouches());
        assert_eq!(seen(&first), seen(&second));
        let body = scene.body;
        scene.write(|out| {
            let pointer = out.spawn();
            let on = SurfacePoint::Body { point: [0.0; 3], normal: [0.0, 0.0, 1.0] };
            out.put(pointer, MentorPointer { by: by(3, 5), place: SurfacePlace { entity: body, on } });
        });
        let third = still.show(&scene.store.snapshot());
        assert_eq!((scene.at(&third), third.iter::<MentorPointer>().count()), (0.1, 1));
        assert!(third.retouches() > second.retouches() && third.revision() == second.revision());
        scene.write(|out| out.despawn(freeze));
        let on = still.show(&scene.store.snapshot());
        assert_eq!((scene.at(&on), on.retouches(), still.is_held()), (0.2, 0, false));
    }

    #[test]
    fn another_freeze_holds_another_moment_and_so_does_a_recording_that_is_wound_back() {
        let (mut scene, mut still) = (Scene::new(), StillPicture::new());
        let freeze = scene.freeze(3);
        let begin = scene.store.snapshot();
        scene.move_to(0.1);
        // A viewer that comes late holds what it sees first.
        assert_eq!(scene.at(&still.show(&scene.store.snapshot())), 0.1);
        assert_eq!(scene.at(&still.show(&begin)), 0.0);
        scene.move_to(0.2);
        assert_eq!(scene.at(&still.show(&scene.store.snapshot())), 0.0);
        scene.write(|out| out.despawn(freeze));
        scene.freeze(4);
        assert_eq!(scene.at(&still.show(&scene.store.snapshot())), 0.2);
    }
}
