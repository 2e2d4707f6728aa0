//! What a session tells of itself, and how often.

use super::*;
use trocar_scene::{Commands, EntityAllocator, Name, StationRole, Store};

const RING: Entity = Entity::new(0, 0, 1);
const HOST: Entity = Entity::new(0, 1, 1);
const AWAY: Entity = Entity::new(0, 1, 2);

struct Told {
    store: Store,
    telemetry: Telemetry,
    now: SimTime,
}

impl Told {
    fn new(reads: &[&str]) -> Self {
        let registry = Registry::standard();
        let telemetry =
            Telemetry::new(SessionKeys::new("s"), &registry, reads.iter().copied()).expect("components");
        let mut told = Self { store: Store::new(registry), telemetry, now: SimTime::ZERO };
        told.write(|out| {
            out.adopt(RING);
            out.put(RING, Name("ring.1".into()));
            out.put(RING, Pose::at(0.1, 0.0, 0.0));
        });
        told
    }

    fn write(&mut self, write: impl FnOnce(&mut Commands)) {
        let allocator = EntityAllocator::new(0, 1);
        let mut commands = Commands::new(self.store.view().registry().clone(), allocator);
        write(&mut commands);
        assert_eq!(commands.error(), None);
        commands.seal();
        self.store.apply(&mut commands, self.now);
    }

    fn after(&mut self, millis: u64) -> Vec<(String, Value)> {
        self.now += SimTime::from_millis(millis);
        let mut messages = Vec::new();
        let health = [("engine".to_owned(), "healthy".to_owned())];
        self.telemetry.tell(self.store.view(), self.now, &health, &mut |key, value| {
            messages.push((key.to_owned(), value.clone()));
        });
        messages
    }

    fn keys(&mut self, millis: u64) -> Vec<String> {
        self.after(millis).into_iter().map(|(key, _)| key).collect()
    }
}

#[test]
fn a_pose_is_told_when_it_has_moved_and_everything_again_each_second() {
    let mut told = Told::new(&[]);
    let first = told.after(1);
    let keys: Vec<&str> = first.iter().map(|(key, _)| key.as_str()).collect();
    assert_eq!(keys, ["trocar/s/pose/ring.1", "trocar/s/health", "trocar/s/roster"]);
    assert_eq!(first[0].1["child_frame_id"], "ring.1");
    assert_eq!(first[0].1["translation"], json!({ "x": 0.1, "y": 0.0, "z": 0.0 }));
    assert_eq!(first[1].1, json!({ "engine": "healthy" }));
    assert_eq!(told.keys(40), [""; 0], "nothing has moved");
    told.write(|out| out.put(RING, Pose::at(0.2, 0.0, 0.0)));
    assert_eq!(told.keys(40), ["trocar/s/pose/ring.1"]);
    assert_eq!(told.keys(1_000).len(), 3, "who comes late sees all");
}

#[test]
fn rates_are_bounded_however_often_a_row_changes_and_a_delay_makes_no_burst() {
    let mut told = Told::new(&["velocity"]);
    told.after(1);
    let (mut poses, mut rows) = (0, 0);
    for step in 0..1_000 {
        told.write(|out| {
            out.put(RING, Pose::at(f64::from(step) * 1e-3, 0.0, 0.0));
            out.put(RING, trocar_scene::Velocity::default());
        });
        for key in told.keys(1) {
            poses += usize::from(key.contains("/pose/"));
            rows += usize::from(key == "trocar/s/row/velocity/ring.1");
        }
    }
    assert!((28..=32).contains(&poses) && (55..=64).contains(&rows), "{poses} poses, {rows} rows");
    told.after(60_000);
    assert_eq!(told.keys(1), [""; 0]);
}

#[test]
fn the_roster_is_the_hosts_and_says_who_is_away() {
    let mut told = Told::new(&[]);
    let station = |number, here| Station {
        number,
        name: format!("station {number}"),
        role: StationRole::Operate,
        here,
        hands: vec!["left".into()],
        protected: true,
        link: Default::default(),
    };
    told.write(|out| {
        out.adopt(HOST);
        out.put(HOST, station(2, true));
        out.adopt(AWAY);
        out.put(AWAY, station(1, false));
    });
    let roster = roster(told.store.view());
    assert_eq!((&roster[0]["number"], &roster[0]["here"]), (&json!(1), &json!(false)));
    assert_eq!(roster[1]["hands"], json!(["left"]));
}

#[test]
fn a_component_that_there_is_not_is_said() {
    let wrong = Telemetry::new(SessionKeys::new("s"), &Registry::standard(), ["velocty"]);
    assert!(wrong.err().expect("refused").contains("velocty"));
}
