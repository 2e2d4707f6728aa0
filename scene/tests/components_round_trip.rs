//! Every standard component, with values that differ from the default, goes through every format unchanged.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Debug;
use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use trocar_scene::*;

fn pose() -> Pose {
    Pose::new(Vector3::new(0.1, -0.2, 0.3), UnitQuaternion::from_euler_angles(0.4, -0.5, 0.6))
}
fn velocity() -> Velocity {
    Velocity { linear: Vector3::new(0.1, 0.2, -0.3), angular: Vector3::new(-1.0, 2.0, 3.5) }
}
fn v(x: f64) -> Vector3<f64> {
    Vector3::new(x, -x, 0.1 * x)
}
fn e(counter: u32) -> Entity {
    Entity::new(1, 2, counter)
}

/// Puts the value of the key `value` of a document.
fn put_document(
    registry: &Registry,
    id: ComponentId,
    commands: &mut Commands,
    entity: Entity,
    text: &str,
) -> Result<(), ComponentError> {
    let document = toml::de::DeTable::parse(text).expect("a document");
    let value = DocumentValue::from(&document.get_ref()["value"]);
    registry.put_document(id, commands, entity, &value).map_err(|(_, error)| error)
}

struct Formats {
    registry: Arc<Registry>,
    seen: BTreeSet<&'static str>,
}

impl Formats {
    /// Through postcard, JSON and (unless `toml` is false) TOML, directly and through the registry.
    fn check<T: Component + PartialEq + Debug>(&mut self, value: T, toml: bool) {
        assert!(self.seen.insert(T::NAME), "{} is tested twice", T::NAME);
        value.check().unwrap_or_else(|error| panic!("{}: {error}", T::NAME));
        let id = self.registry.by_name(T::NAME).expect("registered");
        let entity = e(9);

        let mut bytes = postcard::to_stdvec(&value).expect("postcard");
        assert_eq!(postcard::from_bytes::<T>(&bytes).as_ref(), Ok(&value), "{}", T::NAME);
        bytes.extend([1, 2, 3]);
        let mut commands = self.commands();
        let rest = self.registry.put_postcard(id, &mut commands, entity, &bytes).expect("postcard");
        assert_eq!(rest, [1, 2, 3], "{} leaves what follows it", T::NAME);
        self.holds(commands, entity, &value);

        let json = serde_json::to_value(&value).expect("JSON");
        assert_eq!(serde_json::from_value::<T>(json.clone()).expect("JSON"), value, "{}", T::NAME);
        let text = serde_json::to_string(&value).expect("JSON");
        assert_eq!(serde_json::from_str::<T>(&text).expect("JSON"), value, "{}", T::NAME);

        if toml {
            let text = toml::to_string(&toml::Table::from_iter([(
                "value".to_owned(),
                toml::Value::try_from(&value).unwrap_or_else(|error| panic!("{}: {error}", T::NAME)),
            )]));
            let text = text.expect("TOML");
            let mut commands = self.commands();
            put_document(&self.registry, id, &mut commands, entity, &text).expect("TOML");
            self.holds(commands, entity, &value);

            let mut commands = self.commands();
            self.registry.put_json(id, &mut commands, entity, &json).expect("JSON");
            let snapshot = self.holds(commands, entity, &value);
            assert_eq!(snapshot.entity_json(entity)[T::NAME], json);
        }
    }

    fn commands(&self) -> Commands {
        Commands::new(self.registry.clone(), EntityAllocator::new(0, SCENARIO_SPAWNER))
    }

    fn holds<T: Component + PartialEq + Debug>(
        &self,
        mut commands: Commands,
        entity: Entity,
        value: &T,
    ) -> Snapshot {
        let mut store = Store::new(self.registry.clone());
        commands.seal();
        store.apply(&mut commands, SimTime::ZERO);
        assert_eq!(store.view().get::<T>(entity), Some(value), "{}", T::NAME);
        store.snapshot()
    }
}

#[test]
fn every_component_goes_through_every_format_unchanged() {
    let mut formats = Formats { registry: Registry::standard(), seen: BTreeSet::new() };
    graph_and_meshes(&mut formats);
    matter_and_looks(&mut formats);
    instruments(&mut formats);
    hands_and_tasks(&mut formats);
    annotations(&mut formats);
    stations(&mut formats);
    tele_surgery(&mut formats);
    let registered: BTreeSet<&str> = formats.registry.iter().map(|(_, entry)| entry.name).collect();
    let missing: Vec<_> = registered.difference(&formats.seen).collect();
    assert!(missing.is_empty(), "components without a test: {missing:?}");
}

fn graph_and_meshes(formats: &mut Formats) {
    formats.check(Name("ring \"1\"\n".into()), true);
    formats.check(Parent(e(4)), true);
    formats.check(pose(), true);
    formats.check(velocity(), true);
    formats.check(
        Shape::PegBoard {
            half_extents: [0.03, 0.02],
            thickness: 0.01,
            pegs: vec![[0.01, 0.0], [-0.01, 0.005]],
            peg_radius: 0.001,
            peg_height: 0.02,
        },
        true,
    );
    formats.check(SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [2, 1, 4_000_000_000]]) }, true);
    formats.check(TetMesh { tets: Arc::new(vec![[0, 1, 2, 3]]) }, true);
    let names = Arc::new(vec!["parenchyma".into(), "3".into()]);
    formats.check(TetRegions { names, of_tet: Arc::new(vec![0, 1, 0]) }, true);
    formats.check(LineMesh { segments: Arc::new(vec![[0, 1], [1, 2]]), radius: 0.0003 }, true);
    formats.check(VertexPositions { positions: Arc::new(vec![Point3::new(0.1, -2e-300, 3.0)]) }, true);
    formats.check(VertexVelocities { velocities: Arc::new(vec![Vector3::new(0.1, -2e-300, 3.0)]) }, true);
    formats.check(RestPositions { positions: Arc::new(vec![Point3::new(0.1, -2e-300, 3.0)]) }, true);
    let regions = vec![
        Region::Box { min: Point3::origin(), max: Point3::new(0.1, 0.2, 0.3) },
        Region::Ball { center: Point3::new(0.1, 0.0, 0.0), radius: 0.02 },
    ];
    formats.check(Anchors { regions }, true);
    formats.check(Frozen { reason: "a step of 0.002 s".into(), since: SimTime::from_millis(12) }, true);
    formats.check(OutOfValidity { reason: "strained by 12 %".into(), since: SimTime::from_millis(31) }, true);
    formats.check(HeatFrozen { reason: "a step of 2 s".into(), since: SimTime::from_millis(44) }, true);
    formats.check(MeshRemarks { remarks: vec!["it is 40 m across".into()] }, true);
    formats.check(MeshRepaired { what: "1 inverted element turned (4)".into() }, true);
    formats.check(TextureCoordinates { uv: Arc::new(vec![Vector2::new(0.25, 1.0)]) }, true);
    let node = BoundingVolumeNode {
        min: Point3::new(-1.0, -2.0, -3.0),
        max: Point3::new(1.0, 2.0, 3.0),
        first: 7,
        primitives: 3,
    };
    formats.check(BoundingVolumeTree { nodes: Arc::new(vec![node]) }, true);
}

fn matter_and_looks(formats: &mut Formats) {
    formats.check(
        VisualMaterial {
            base_color: [0.1, 0.2, 0.3, 0.4],
            roughness: 0.9,
            metalness: 1.0,
            wetness: 0.6,
            tiling: [2.0, 3.0],
            relief: 0.0005,
            shader: Some("looks/glow.wgsl".into()),
            color_map: Some(Texture::File("liver.png".into())),
            normal_map: Some(Texture::Procedural("bumps".into())),
            edit_map: None,
            free_map: Some(Texture::Procedural("noise".into())),
        },
        true,
    );
    formats.check(Light { color: [1.0, 0.5, 0.25], intensity: 3.0, cone_angle: 0.5, shadows: false }, true);
    formats.check(Camera { field_of_view: 0.7, near: 0.02, far: 2.0, aspect: 1.5 }, true);
    formats.check(Optics { tilt: 0.52, turn: -1.0, distortion: 0.1, vignette: 0.4 }, true);
    let tracked = HeadTracked { head: e(6), screen: [0.52, 0.29], interocular: 0.061, scale: 0.25 };
    formats.check(tracked.clone(), true);
    let refused = |change: fn(&mut HeadTracked)| {
        let mut changed = tracked.clone();
        change(&mut changed);
        changed.check().expect_err("refused").to_string()
    };
    assert!(refused(|tracked| tracked.screen[1] = 0.0).contains("0.001 to 100 m"));
    assert!(refused(|tracked| tracked.interocular = -0.06).contains("interocular"));
    assert!(refused(|tracked| tracked.scale = f64::NAN).contains("not finite"));
    formats.check(
        RigidBody {
            motion: Motion::Dynamic,
            mass: 0.005,
            friction: 0.3,
            restitution: 0.2,
            linear_damping: 0.1,
            angular_damping: 0.4,
        },
        true,
    );
    let ball = Joint { kind: JointKind::Ball, at: Point3::new(0.1, -0.2, 0.3), axis: None, to: Some(e(4)) };
    let hinge = Joint { kind: JointKind::Hinge, axis: Some(v(2.0)), to: None, ..ball };
    formats.check(Joints(vec![ball, hinge, Joint { kind: JointKind::Fixed, ..ball }]), true);
    let frame = |joint| JointFrame { joint, in_body: pose(), in_other: Pose::at(0.1, 0.2, 0.4) };
    formats.check(JointFrames { joints: vec![frame(ball), frame(hinge)] }, true);
    let load = JointLoad { force: v(1.0), torque: v(-2.0), position_error: 1e-7, angle_error: 2e-6 };
    formats.check(JointState { joints: vec![load, JointLoad::default()] }, true);
    formats.check(Tissue("liver".into()), true);
    let source = |from: &str, range| {
        let source = Source { from: from.into(), range };
        Sources([("xpbd".to_owned(), [("density".to_owned(), source)].into())].into())
    };
    let mut both = source("chosen", Some([900.0, 1100.0]));
    both.0.extend([("sewn".to_owned(), source("chosen", None).0.remove("xpbd").unwrap_or_default())]);
    formats.check(both, true);
    for (source, says) in
        [(source(" ", None), "says nothing"), (source("chosen", Some([2.0, 1.0])), "from 2 to 1")]
    {
        let refused = source.check().expect_err("refused").to_string();
        assert!(refused.contains(says), "{refused}");
    }
    let granite = Tissue("granite".into()).check().expect_err("no tissue").to_string();
    assert!(granite.contains("there are: artery, gallbladder"), "{granite}");
    formats.check(Temperature { celsius: Arc::new(vec![37.0, 60.5]) }, true);
    formats.check(Burn { omega: Arc::new(vec![0.0, 1.25]) }, true);
    let field = |name: &str, range| ScalarField {
        name: name.into(),
        unit: "Pa".into(),
        values: Arc::new(vec![0.0, -2.5e3]),
        range,
    };
    let fields = vec![field("stress", Some([0.0, 5e3])), field("pressure", None)];
    formats.check(ScalarFields { fields }, true);
    for (fields, says) in [
        (vec![field("stress", Some([1.0, 1.0]))], "range"),
        (vec![field("stress", None), field("stress", None)], "two fields are called 'stress'"),
        (vec![field("", None)], "name"),
        (vec![field("stress", Some([f64::NAN, 1.0]))], "not finite"),
    ] {
        let refused = ScalarFields { fields }.check().expect_err("refused").to_string();
        assert!(refused.contains(says), "{refused}");
    }
    let smoke = Particles {
        kind: ParticleKind::Smoke,
        positions: Arc::new(vec![Point3::new(0.01, -0.02, 0.03), Point3::origin()]),
        first: 1_000,
        radius: 0.004,
        color: [0.9, 0.8, 0.7],
        extinction: 55.0,
        densities: Arc::new(vec![0.25, 1.0]),
        ages: Arc::new(vec![0.0, 1.5]),
        spread: 2.0,
    };
    formats.check(smoke.clone(), true);
    assert_eq!(
        [999, 1_000, 1_001, 1_002].map(|number| smoke.index_of(number)),
        [None, Some(0), Some(1), None]
    );
    // Twice the radius, an eighth of the density: as much smoke as before.
    assert_eq!(smoke.particle(0), (0.004, 0.25 * 55.0));
    assert_eq!(smoke.particle(1), (0.008, 55.0 / 8.0));
    let without = |change: &dyn Fn(&mut Particles)| {
        let mut wrong = smoke.clone();
        change(&mut wrong);
        wrong.check().expect_err("refused").to_string()
    };
    let crowd = || Arc::new(vec![Point3::origin(); PARTICLES_MAX + 1]);
    for (refused, says) in [
        (without(&|wrong| wrong.kind = ParticleKind::Fluid), "only smoke grows old"),
        (without(&|wrong| wrong.densities = Arc::new(vec![1.0])), "densities: 1 values for 2 particles"),
        (without(&|wrong| wrong.densities = Arc::new(vec![1.0, 1.5])), "densities: 1.5"),
        (without(&|wrong| wrong.ages = Arc::new(vec![0.0, -1.0])), "ages: -1"),
        (without(&|wrong| wrong.ages = Arc::new(vec![0.0; 3])), "ages: 3 values for 2 particles"),
        (without(&|wrong| wrong.positions = crowd()), "at most 65536"),
        (without(&|wrong| wrong.positions = Arc::new(vec![Point3::new(0.0, 1e9, 0.0); 2])), "positions"),
        (without(&|wrong| wrong.positions = Arc::new(vec![Point3::new(0.0, f64::NAN, 0.0)])), "not finite"),
        (without(&|wrong| wrong.first = u64::MAX), "first"),
        (without(&|wrong| wrong.radius = 0.0), "radius"),
        (without(&|wrong| wrong.color[1] = 1.5), "color"),
        (without(&|wrong| wrong.extinction = -1.0), "extinction"),
        (without(&|wrong| wrong.spread = -1.0), "spread"),
    ] {
        assert!(refused.contains(says), "{refused}");
    }
}

fn instruments(formats: &mut Formats) {
    formats.check(
        Instrument {
            kind: InstrumentKind::NeedleDriver,
            shaft_length: 0.3,
            jaws: 1,
            jaw_friction: 0.0,
            grasp_assist: true,
            port: Some(e(3)),
            ..Instrument::default()
        },
        true,
    );
    formats.check(Port { axial_damping: 0.7, insertion_max: 0.25, ..Port::default() }, true);
    formats.check(
        InstrumentTarget {
            tip_in_world: pose(),
            velocity_in_world: velocity(),
            jaw_angle: 0.4,
            sampled_at: SimTime(1_234_567_890_123),
        },
        true,
    );
    let mode = Some(ActivationMode::Coagulate);
    formats.check(Activation { level: 0.6, since: SimTime::from_millis(12), mode }, true);
    formats.check(JawState { angle: 0.3, rate: -1.0, pad_force: [0.5, 0.6] }, true);
    formats.check(InstrumentForce { force: v(1.0), torque: v(0.1), at: SimTime(5) }, true);
    formats.check(Grasp { held: e(8), anchor: pose(), since: SimTime(77), assisted: true }, true);
    let plane = ContactPlane {
        point_in_world: Point3::new(0.1, 0.2, 0.3),
        normal_in_world: Vector3::z(),
        stiffness: 900.0,
        damping: 0.5,
        friction: 0.3,
    };
    // TOML has no null, so a list with gaps cannot stand in it; the engine writes this one, never a file.
    let model = LocalContactModel {
        proxy_in_world: pose(),
        proxy_velocity: velocity(),
        planes: [Some(plane), None, Some(plane), None],
        base_force: v(0.2),
        at: SimTime(9),
    };
    formats.check(model, false);
    formats.check(StationContactModel { model }, false);
}

fn annotations(formats: &mut Formats) {
    let by = |station| Signature { station, name: "Öztürk 2".to_owned(), at: SimTime(7) };
    let triangle = SurfacePoint::Triangle { corners: [5, 3, 70_000], barycentric: [0.2, 0.3, 0.5] };
    let places = [
        triangle,
        SurfacePoint::Segment { ends: [2, 1], along: 0.1 },
        SurfacePoint::Body { point: [0.1, -0.2, 0.3], normal: [0.6, 0.0, -0.8] },
    ];
    let places = places.map(|on| SurfacePlace { entity: e(4), on });
    formats.check(MentorPointer { by: by(3), place: places[0] }, true);
    formats.check(
        MentorStroke {
            by: by(3),
            stroke: 9,
            section: 2,
            colour: [255, 0, 128],
            width: 0.0015,
            places: Arc::new(places.to_vec()),
            gaps: vec![2],
        },
        true,
    );
    let text = "cut here \"first\"".to_owned();
    formats.check(MentorLabel { by: by(4), label: 1, place: places[2], text }, true);
    formats.check(PictureFreeze { by: by(5) }, true);
    let step = TakeOverStep::Accepted;
    formats.check(TakeOverRequest { by: by(5), step, answer: Some(by(6)) }, true);
    let deeds = vec![
        MentorDeed::Draw { stroke: 4, colour: [1, 2, 3], width: 0.002, places: places.to_vec() },
        MentorDeed::Erase { stroke: 3 },
        MentorDeed::Clear { of_all: true },
        MentorDeed::Label { label: 2, place: places[1], text: "here".to_owned() },
        MentorDeed::Freeze(true),
        MentorDeed::HandOver { hand: e(4), step: HandOverStep::Accept },
    ];
    let pointer = Some(places[2]);
    formats.check(MentorInput { source: 3, pointer, first: 7, deeds: Arc::new(deeds) }, true);
    formats.check(
        MentorAnswer {
            station: 2,
            role: Some(StationRole::Mentor),
            is_heard: true,
            source: 3,
            taken: 6,
            refusals: 1,
            refusal: "no".to_owned(),
            refused_at: SimTime(9),
        },
        true,
    );
}

fn tele_surgery(formats: &mut Formats) {
    let figures = TeleoperationFigures {
        sent: 6,
        received: 5,
        late: 1,
        refused: 2,
        round_trip_mean: Some(0.15),
        rms: Some(0.006),
        applied_error_max: Some(1e-9),
        x_range: 0.086,
        speed_max: 0.133,
        contact_share: 0.49,
        limited: 3,
        stops: 1,
        silences: 2,
        energised: 4.5,
        felt_share: Some(0.98),
        ..TeleoperationFigures::default()
    };
    let value = Teleoperation {
        end: TeleoperationEnd::Console,
        state: SlaveState::ReleasePedal,
        pedals: EnergyPedal::Coagulate,
        master_in_world: pose(),
        slave_in_world: pose(),
        at: SimTime(7),
        applied: SimTime(5),
        round_trip: 0.15,
        force_in_world: v(0.3),
        feedback: ForceFeedback::WaveVariables,
        felt_in_world: v(0.2),
        protected: true,
        figures,
    };
    // TOML has no absent numbers.
    formats.check(value, true);
    formats.check(SlaveOrder { stop: true }, true);
}

fn stations(formats: &mut Formats) {
    let link = LinkState {
        round_trip: 0.15,
        jitter: 0.001,
        loss: 0.02,
        age: 0.08,
        rate: 249.0,
        bytes_received: 3.1e5,
        bytes_sent: 4.2e4,
        over_tcp: true,
    };
    let hands = vec!["left".into(), "right".into()];
    formats.check(Repaired { times: 3 }, true);
    let role = StationRole::Mentor;
    formats.check(
        Station { number: 3, name: "Ada".into(), role, here: true, hands, protected: true, link },
        true,
    );
}

fn hands_and_tasks(formats: &mut Formats) {
    formats.check(Hand { side: Side::Right, instrument: e(2), world_from_device: pose(), scale: 1.25 }, true);
    formats.check(
        DeviceInfo {
            model: "Omni".into(),
            workspace: [0.16, 0.12, 0.07],
            max_force: 3.3,
            max_stiffness: 1000.0,
            input_dofs: 6,
            output_dofs: 3,
            ..DeviceInfo::default()
        },
        true,
    );
    formats.check(
        DeviceState {
            handle_in_device: pose(),
            velocity_in_device: velocity(),
            gripper: 0.3,
            buttons: 5,
            connected: true,
            applied_force: v(1.0),
            sampled_at: SimTime(8),
        },
        true,
    );
    formats.check(DeviceForce { force: v(2.0), torque: v(0.01), at: SimTime(7) }, true);
    formats.check(HandTarget { handle_in_device: pose(), gripper: 0.6 }, true);
    formats.check(PressTarget { buttons: 3, energy: true, coagulate: false }, true);
    formats.check(
        VirtualFixture {
            force: v(0.5),
            center_in_world: v(0.02).into(),
            stiffness: 50.0,
            damping: 1.0,
            at: SimTime(9),
        },
        true,
    );
    formats.check(
        HapticStatus {
            energy: 0.1,
            energy_min: -0.01,
            dissipated: 0.2,
            stale_samples: 3,
            ..HapticStatus::default()
        },
        true,
    );
    formats.check(
        PersonInput {
            source: 3,
            in_charge: Side::Right,
            left: PersonHand {
                moved: [0.1, -0.2, 0.3],
                rolled: 0.4,
                opening: Some(0.5),
                activation: 1.0,
                mode: Some(ActivationMode::Coagulate),
            },
            right: PersonHand { moved: [1.0, 2.0, -3.0], rolled: -0.7, ..PersonHand::default() },
            held: PersonActions { grip: 0.25, fine: 1.0, ..PersonActions::default() },
            view: Some(PersonView { world_from_view: pose(), field_of_view: 0.9 }),
            sampled_at: SimTime(9),
        },
        true,
    );
    let primitives = [
        Primitive::Shape(1),
        Primitive::Triangle(2),
        Primitive::Tetrahedron(3),
        Primitive::Segment(4),
        Primitive::Vertex(5),
        Primitive::Jaw(1),
        Primitive::Shaft,
    ];
    let collision = |(k, primitive): (usize, &Primitive)| Collision {
        a: e(1),
        primitive_a: *primitive,
        b: e(2),
        primitive_b: primitives[6 - k],
        points_in_world: [Point3::new(0.1, 0.2, 0.3), Point3::new(0.1, 0.20001, 0.3)],
        normal_in_world: Vector3::y(),
        depth: 1e-5,
        force_in_world: v(0.5),
        velocity_constraint: 0.1,
        method: Detection::DynamicPoint,
        detected_at: SimTime::from_millis(20),
    };
    let collisions = primitives.iter().enumerate().map(collision).collect();
    formats.check(CollisionList { collisions, penetration_max: 1e-4 }, true);
    let error = TaskError { kind: "drop_in_view".into(), at_secs: 12.5, entity: Some(e(5)) };
    let metrics = BTreeMap::from([("left".to_owned(), BTreeMap::from([("path_length".to_owned(), 1.25)]))]);
    formats.check(
        TaskState {
            task: "peg-transfer".into(),
            phase: "lift".into(),
            done: 3,
            steps: 12,
            seconds: 33.5,
            over: true,
            completed: true,
            cut_off: true,
            score: Some(87.5),
            errors: vec![error.clone(), TaskError { entity: None, ..error }],
            metrics,
        },
        true,
    );
    let values = [("cut_area_m2".to_owned(), 1.25e-3)].into();
    formats.check(Measured { values }, true);
    formats.check(
        VitalSigns {
            heart_rate: 71.0,
            arterial_pressure: 12_000.0,
            oxygen_saturation: 0.98,
            blood_loss: 1e-5,
        },
        true,
    );
}

#[test]
fn numbers_that_are_not_finite_are_refused_by_every_format() {
    let registry = Registry::standard();
    let id = registry.by_name("pose").expect("registered");
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, SCENARIO_SPAWNER));
    let mut bad = pose();
    bad.translation.y = f64::NAN;
    let bytes = postcard::to_stdvec(&bad).expect("postcard");
    let refused = registry.put_postcard(id, &mut commands, e(1), &bytes);
    assert!(matches!(refused, Err(ComponentError::NotFinite { index: 1 })), "{refused:?}");
    let text = "value = { translation = [0.1, nan, 0.3] }";
    let refused = put_document(&registry, id, &mut commands, e(1), text);
    assert!(matches!(refused, Err(ComponentError::NotFinite { index: 1 })), "{refused:?}");
    let refused =
        registry.put_json(id, &mut commands, e(1), &serde_json::json!({ "translation": [1, null, 2] }));
    assert!(matches!(refused, Err(ComponentError::Malformed(_))), "{refused:?}");
    let refused =
        registry.put_json(id, &mut commands, e(1), &serde_json::json!({ "rotation": [0, 0, 0, 2] }));
    assert!(refused.is_err(), "{refused:?}");
    assert!(commands.is_empty(), "nothing of a refused value is kept");
}

#[test]
fn truncated_bytes_are_refused() {
    let registry = Registry::standard();
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, SCENARIO_SPAWNER));
    let id = registry.by_name("collision_list").expect("registered");
    // A list that claims 2³² − 1 entries.
    let bytes = [0xff, 0xff, 0xff, 0xff, 0x0f, 1, 2, 3];
    assert!(matches!(
        registry.put_postcard(id, &mut commands, e(1), &bytes),
        Err(ComponentError::Malformed(_))
    ));
}

#[test]
fn a_name_is_registered_once() {
    #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, Component)]
    #[component(name = "pose")]
    struct Imposter;
    let mut builder = RegistryBuilder::new();
    builder.register::<Pose>().expect("free");
    builder.register::<Pose>().expect("the same type again is fine");
    let error = builder.register::<Imposter>().err().expect("taken");
    assert!(matches!(error, RegistryError::NameTaken { name: "pose", .. }));
    assert!(error.to_string().contains("Imposter") && error.to_string().contains("Pose"), "{error}");
    let registry = builder.build();
    let error = registry.by_name("poze").expect_err("unknown").to_string();
    assert!(error.contains("'poze'") && error.contains("pose"), "{error}");
    assert_eq!(registry.id::<Velocity>(), None);
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 1));
    commands.put(e(1), velocity());
    assert_eq!(commands.error(), Some(&CommandError::Unregistered("velocity")));
}

#[test]
fn ids_and_keys_do_not_depend_on_the_order_of_registration() {
    let mut one = RegistryBuilder::new();
    one.register::<Pose>()
        .expect("free")
        .register::<Velocity>()
        .expect("free")
        .register::<Name>()
        .expect("free");
    let mut other = RegistryBuilder::new();
    other
        .register::<Name>()
        .expect("free")
        .register::<Velocity>()
        .expect("free")
        .register::<Pose>()
        .expect("free");
    let list =
        |registry: Arc<Registry>| registry.iter().map(|(id, e)| (id, e.name, e.key)).collect::<Vec<_>>();
    let (one, other) = (list(one.build()), list(other.build()));
    assert_eq!(one, other);
    assert!(one.windows(2).all(|pair| pair[0].1 < pair[1].1));
}
