//! Scenes of soft matter, in lock-step: each checked by its outcome, and with a control that fails.

use trocar::run::{RunOptions, RunOutcome, start};
use trocar_scene::scenario::Scenario;
use trocar_scene::{DeviceForce, HapticStatus, RestPositions, SimTime, TetMesh, VertexPositions};
use trocar_test_support::thorough;
use trocar_tests::{app, edited, finish, for_seeds, lockstep};

fn run(name: &str, replacements: &[(&str, &str)]) -> RunOutcome {
    let app = app();
    finish(&app, &edited(&app, name, replacements), &lockstep(1))
}

/// The final value of a measure.
fn outcome(run: &RunOutcome, measure: &str) -> f64 {
    let values = &run.summary.task.metrics["outcome"];
    *values.get(measure).unwrap_or_else(|| panic!("no '{measure}': {values:?}"))
}

fn holds(name: &str) -> RunOutcome {
    let run = run(name, &[]);
    assert!(run.summary.task.completed, "{:?} {:?}", run.summary.task, run.summary.error);
    assert!(run.summary.controllers.iter().all(|row| row.rejected == 0 && row.restarts == 0), "{name}");
    run
}

#[test]
fn two_hands_cut_a_circle_out_of_a_gauze() {
    let cut = holds("cloth-cut");
    // The result does not depend on the phase either: hands that begin in the middle of a step of the gauze, as live
    // ones do, give the same.
    let late = [(
        "step = [\n    { seconds = 1.0 },\n    { seconds = 1.5",
        "step = [\n    { seconds = 1.013 },\n    { seconds = 1.5",
    )];
    for cut in [cut, run("cloth-cut", &late)] {
        let area = outcome(&cut, "gauze.cut_area_m2");
        assert!((area / (std::f64::consts::PI * 0.02 * 0.02) - 1.0).abs() < 0.01, "{area} m²");
        assert_eq!(outcome(&cut, "gauze.pieces"), 2.0);
    }
    // Open blades cut nothing.
    let open =
        run("cloth-cut", &[("{ seconds = 1.5, to = [0.055", "{ seconds = 1.5, jaws = 0.6, to = [0.055")]);
    assert!(!open.summary.task.completed);
    assert_eq!((outcome(&open, "gauze.pieces"), outcome(&open, "gauze.cut_area_m2")), (1.0, 0.0));
}

#[test]
fn a_hook_cuts_a_membrane_through_and_burns_a_crater() {
    holds("cautery");
    if thorough() {
        // Without coagulation current nothing chars: the cutting current vaporises the tissue.
        let cut = run("cautery", &[(", mode = \"coagulate\"", "")]);
        assert!(!cut.summary.task.completed);
        assert_eq!(outcome(&cut, "liver.charred_cells"), 0.0);
    }
    // A hook without power burns nothing.
    let off = run("cautery", &[("power = 30.0", "power = 0.0")]);
    assert!(!off.summary.task.completed);
    assert_eq!(outcome(&off, "liver.removed_volume_m3"), 0.0);
    assert!((outcome(&off, "membrane.largest_piece_share") - 1.0).abs() < 1e-9);
}

#[test]
fn a_probe_presses_on_a_stomach_and_feels_it() {
    let pressed = holds("soft-stomach");
    assert!(pressed.summary.force_newtons_max > 0.1, "{} N", pressed.summary.force_newtons_max);
    // A stiffer stomach gives larger forces.
    let stiffer = run("soft-stomach", &[("young_modulus = 6000.0", "young_modulus = 18000.0")]);
    let force = |run: &RunOutcome| outcome(run, "stomach.contact_force_n.largest");
    assert!(force(&stiffer) > 1.5 * force(&pressed), "{} and {} N", force(&stiffer), force(&pressed));
    assert!(!stiffer.summary.task.completed, "it is not the stomach that was asked for");
}

#[test]
fn constraints_of_ours_or_of_the_engine_take_the_place_of_finite_elements_by_two_lines() {
    let force = |run: &RunOutcome| outcome(run, "stomach.contact_force_n.largest");
    // A coarser mesh than in the scenario, since the engine is slow.
    let coarse = ("edge = 0.012", "edge = 0.018");
    let wanted = force(&run("soft-stomach", &[coarse]));
    let volume = "{ young_modulus = 6000.0, poisson_ratio = 0.45, density = 1060.0 }";
    let ours = format!("xpbd = {{ matter = {{ volume = {volume} }} }}");
    let engine = "engine_soft = { young_modulus = 6000.0, parts = 1 }".to_string();
    for (component, kind) in [(ours, "xpbd"), (engine, "rapier-soft")] {
        let controller = format!("kind = \"{kind}\"\nrate_hz = 500");
        let other = run(
            "soft-stomach",
            &[
                coarse,
                ("dynamic_fem = { young_modulus = 6000.0 }", component.as_str()),
                ("kind = \"dynamic-fem\"\nrate_hz = 60", controller.as_str()),
            ],
        );
        assert!(other.summary.task.completed, "{kind}: {:?} {:?}", other.summary.task, other.summary.error);
        let found = force(&other);
        assert!((found / wanted - 1.0).abs() < 0.5, "{kind}: {found} N, of finite elements {wanted} N");
    }
}

#[test]
fn an_implicit_and_an_explicit_simulator_share_a_scene() {
    let both = holds("two-rates");
    let rate =
        |name: &str| both.summary.controllers.iter().find(|row| row.name == name).expect("it").achieved_hz;
    assert!((rate("organ") - 20.0).abs() < 0.2 && (rate("membrane") - 500.0).abs() < 1.0);
    // The results of the explicit body do not depend on the rate of the implicit one.
    let other = run("two-rates", &[("rate_hz = 20\n", "rate_hz = 10\n")]);
    let force = |run: &RunOutcome| outcome(run, "membrane.contact_force_n.largest");
    assert_eq!(force(&both), force(&other));
    // An organ of half the stiffness gives a different force.
    let softer = run("two-rates", &[("young_modulus = 6000.0", "young_modulus = 3000.0")]);
    let felt =
        |run: &RunOutcome, hand: &str| outcome(run, &format!("hand.{hand}.felt_stiffness_n_per_m.mean"));
    assert!(felt(&softer, "left") < 0.7 * felt(&both, "left") && !softer.summary.task.completed);
    assert_eq!(felt(&softer, "right"), felt(&both, "right"), "the other hand feels what it felt");
}

/// The left hand's contact with the organ in `two-rates`, with pieces of the scenario replaced: stiffness while it
/// presses \[N/m\], the force while it holds still \[N\], and its fluctuation \[N\].
fn felt(replacements: &[(&str, &str)]) -> [f64; 3] {
    let app = app();
    let mut session = start(&app, &edited(&app, "two-rates", replacements), &lockstep(1)).expect("it starts");
    let hand = session.snapshot().find("hand.left").expect("a hand");
    let (mut stiffness, mut forces) = (Vec::new(), Vec::new());
    for millis in (1_900..3_450).step_by(5) {
        session.run_until(SimTime::from_millis(millis));
        let scene = session.snapshot();
        let status = scene.get::<HapticStatus>(hand).expect("a status");
        let force = scene.get::<DeviceForce>(hand).expect("a force").force.norm();
        if millis < 2_400 && status.felt_stiffness > 0.0 {
            stiffness.push(status.felt_stiffness);
        }
        if millis > 2_900 {
            forces.push(force);
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let (low, high) =
        forces.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), f| (low.min(*f), high.max(*f)));
    [mean(&stiffness), mean(&forces), high - low]
}

#[test]
fn a_hand_feels_an_organ_alike_however_slowly_it_is_computed() {
    let organ = |hz: &str| ("rate_hz = 20\n".to_owned(), format!("rate_hz = {hz}\n"));
    let cases = [organ("10"), organ("20"), organ("100"), organ("200")];
    let felts: Vec<[f64; 3]> = for_seeds(&[0, 1, 2, 3], |case| {
        let (from, to) = &cases[case as usize];
        felt(&[(from, to)])
    });
    let [stiffness, force, _] = felts[3];
    for (felt, (_, hz)) in felts.iter().zip(&cases) {
        assert!((felt[0] / stiffness - 1.0).abs() < 0.15, "{hz}{} of {stiffness} N/m", felt[0]);
        // Humans can distinguish forces that differ by 7 %.
        assert!((felt[1] / force - 1.0).abs() < 0.03, "{hz}{} of {force} N", felt[1]);
        // The hand trembles; the simulation adds no vibration.
        assert!(felt[2] < 0.5 * felt[1], "{hz}{} of {} N up and down", felt[2], felt[1]);
    }
    // A zero-order hold of the force at 20 Hz feels like a softer organ.
    let held = felt(&[("renderer = { kind = \"proxy\" }", "renderer = { kind = \"held\" }")]);
    assert!(held[0] < 0.8 * stiffness, "{} of {stiffness} N/m", held[0]);
}

#[test]
fn a_bleeding_artery_is_clamped_and_sealed_and_the_patient_minds_when_nobody_does() {
    let sealed = holds("bleeding");
    let lost = outcome(&sealed, "artery.lost_m3");
    assert!(
        (outcome(&sealed, "piglet.blood_lost_m3") / lost - 1.0).abs() < 1e-9,
        "what is lost is the patient's"
    );
    // An open clamp lets the vessel bleed, and the flow prevents sealing.
    let open = run("bleeding", &[("{ seconds = 0.4, jaws = 0.0 }", "{ seconds = 0.4, jaws = 0.5 }")]);
    assert!(!open.summary.task.completed);
    assert!(
        outcome(&open, "artery.lost_m3") > 2.0 * lost,
        "{} of {lost} m³",
        outcome(&open, "artery.lost_m3")
    );
    assert!(outcome(&open, "artery.rate_m3_per_s") > 0.0);
    let pressure = |run: &RunOutcome| outcome(run, "piglet.arterial_pressure_pa.smallest");
    assert!(pressure(&open) < pressure(&sealed), "{} and {} Pa", pressure(&open), pressure(&sealed));
}

#[test]
fn a_needle_goes_through_a_pad_and_draws_its_thread_after_it() {
    let sewn = holds("needle-tissue");
    assert!(sewn.summary.force_newtons_max > 0.1, "{} N", sewn.summary.force_newtons_max);
    // A needle without a grip does not penetrate, nor does one on a skin that is too tough. A needle that lies about loose
    // is slow to simulate: after the time in which the other one comes through, only before a release.
    let driven_through = Some(6.0);
    let until = |edits: &[(&str, &str)], seconds: Option<f64>| {
        finish(&app(), &edited(&app(), "needle-tissue", edits), &RunOptions { seconds, ..lockstep(1) })
    };
    assert!(outcome(&until(&[], driven_through), "needle.exits") >= 1.0);
    let loose = if thorough() { None } else { driven_through };
    for (edit, seconds) in [
        (("jaws = 0.0\nstep", "jaws = 0.5\nstep"), loose),
        (("puncture_force = 0.3", "puncture_force = 1000.0"), None),
    ] {
        let control = until(&[edit], seconds);
        assert!(!control.summary.task.completed);
        assert_eq!((outcome(&control, "needle.entries"), outcome(&control, "needle.exits")), (0.0, 0.0));
    }
}

#[test]
fn three_throws_are_drawn_tight_and_hold_and_less_does_not() {
    let tied = holds("knot");
    assert!(outcome(&tied, "thread.slip_m") > 0.0, "what bears a load gives way");
    // Three throws in the same direction form another knot (a granny), and the task detects it.
    let granny = run("knot", &[("half_turns = [3, -3, 3]", "half_turns = [3, 3, 3]")]);
    assert!(!granny.summary.task.completed && outcome(&granny, "thread.knot_alternates") == 0.0);
    // Without friction the knot comes undone, and a single throw opens.
    let smooth = run("knot", &[("friction = { value = 0.3", "friction = { value = 0.0")]);
    assert_eq!(outcome(&smooth, "thread.knot"), 0.0);
    let single = run("knot", &[("half_turns = [3, -3, 3]", "half_turns = [3]")]);
    assert!(outcome(&single, "thread.slip_m") > 2e-3, "{} m", outcome(&single, "thread.slip_m"));
    for control in [&smooth, &single] {
        assert!(!control.summary.task.completed);
        assert!(outcome(control, "thread.tension_n") < 0.2, "{} N", outcome(control, "thread.tension_n"));
    }
}

#[test]
fn a_loop_is_carried_to_the_line_on_a_tube_and_drawn_close() {
    holds("tube-loop");
    // A loop drawn tight in the wrong place misses the line; a loop on the line that is not drawn tight holds nothing.
    let beside = run("tube-loop", &[("0.006000", "0.002000"), ("0.004000, 0.006975", "0.002000, 0.006975")]);
    assert!(outcome(&beside, "tube.line_off_m") > 2e-3, "{} m", outcome(&beside, "tube.line_off_m"));
    let loose = run("tube-loop", &[("0.020300", "0.011500")]);
    assert!(outcome(&loose, "tube.loop_tension_n") < 0.05, "{} N", outcome(&loose, "tube.loop_tension_n"));
    assert!(!beside.summary.task.completed && !loose.summary.task.completed);
    // A softer tube deforms more under the same hands, beyond the linear range.
    let soft = run("tube-loop", &[("young_modulus = 3e6", "young_modulus = 3e5")]);
    assert_eq!(outcome(&soft, "tube.beyond_linear"), 1.0);
}

#[test]
fn a_probe_presses_on_a_liver_with_a_precomputed_inverse() {
    let pressed = holds("fem-liver");
    assert!(pressed.summary.force_newtons_max > 0.05, "{} N", pressed.summary.force_newtons_max);
    // Linear elasticity: three times the stiffness gives three times the force at the same displacement. A mesh of
    // three times as many tetrahedra gives the same force, which single vertices do not.
    let finer = ("edge = 0.010", "edge = 0.007");
    let felt = |edits: &[(&str, &str)]| outcome(&run("fem-liver", edits), "liver.contact_force_n.largest");
    let change = felt(&[finer]) / outcome(&pressed, "liver.contact_force_n.largest") - 1.0;
    assert!(change.abs() <= 0.1, "the force changes by {change} on a finer mesh");
    let vertices = ("contact_radius = 0.012", "contact_radius = 0.0");
    let change = felt(&[vertices, finer]) / felt(&[vertices]) - 1.0;
    assert!(change.abs() > 0.12, "single vertices feel as hard on a finer mesh: {change}");
    let stiffer = run("fem-liver", &[("young_modulus = 6000.0", "young_modulus = 18000.0")]);
    let ratio = |measure: &str| outcome(&stiffer, measure) / outcome(&pressed, measure);
    let (force, moved) = (ratio("liver.contact_force_n.largest"), ratio("liver.displacement_max_m.largest"));
    assert!((force / moved / 3.0 - 1.0).abs() < 0.25 && force > 1.5, "{force} times, moved {moved} times");
    assert!(!stiffer.summary.task.completed, "it is not the liver that was asked for");
}

/// The expectations of `fem-liver`, from the first line to the last.
const EXPECTED: &str = r#"    { measure = "liver.displacement_max_m", which = "largest", min = 0.004, max = 0.006 },
    { measure = "liver.contact_force_n", which = "largest", min = 0.5, max = 0.8 },
    { measure = "liver.contact_force_n", max = 0.001 },
    { measure = "liver.displacement_max_m", max = 0.0001 },"#;

#[test]
fn closed_blades_slit_a_liver_with_a_precomputed_inverse() {
    let blades = |cut: &str| {
        run(
            "fem-liver",
            &[
                ("kind = \"probe\"", "kind = \"scissors\""),
                ("jaws = 0", "jaws = 2"),
                ("jaw_length = 0.010", "jaw_length = 0.030"),
                ("linear_fem = {", &format!("linear_fem = {{ {cut}")),
                (EXPECTED, "    { measure = \"liver.opened_faces\", min = 20.0 },"),
                // Down into it, 3 cm along, and out again.
                (
                    "{ seconds = 1.5, to = [-0.045, 0.000, 0.064] }",
                    "{ seconds = 1.5, to = [-0.045, 0.000, 0.045] }",
                ),
                ("{ seconds = 1.0 },", "{ seconds = 1.0, to = [-0.015, 0.000, 0.045] },"),
                (
                    "{ seconds = 1.5, to = [-0.045, 0.000, 0.090] }",
                    "{ seconds = 1.5, to = [-0.015, 0.000, 0.120] }",
                ),
            ],
        )
    };
    let cut = blades("cut = true,");
    assert!(cut.summary.task.completed, "{:?} {:?}", cut.summary.task, cut.summary.error);
    assert!(cut.summary.controllers.iter().all(|row| row.rejected == 0 && row.restarts == 0));
    // The cut has two lips, and where nothing touches it any longer the surface is back at rest.
    let nodes = |run: &RunOutcome| {
        let scene = &run.kernel.snapshot;
        let liver = scene.find("liver").expect("a liver");
        let rest = scene.get::<RestPositions>(liver).expect("its shape at rest").positions.clone();
        let now = scene.get::<VertexPositions>(liver).expect("its shape").positions.clone();
        let moved = rest.iter().zip(now.iter()).map(|(rest, now)| (now - rest).norm()).fold(0.0, f64::max);
        (rest.len(), moved)
    };
    let whole = blades("");
    assert!(!whole.summary.task.completed, "it is not cut");
    let (born, moved) = (nodes(&cut).0 - nodes(&whole).0, nodes(&cut).1);
    assert!(born >= 5 && moved < 1e-4, "{born} nodes have come apart, {moved} m from where they were");
}

#[test]
fn a_hand_feels_what_its_instrument_has_been_driven_into() {
    // Driven in to a point in the middle of the liver, retracted by 5 mm and returned, as exactly as a hand can.
    let drawn = |pinned: &str| {
        run(
            "fem-liver",
            &[
                ("contact_radius = 0.012 }", &format!("contact_radius = 0.012 }}\n{pinned}")),
                (
                    EXPECTED,
                    "    { measure = \"liver.pinned_force_n\", which = \"largest\", min = 0.1 },\n    \
                     { measure = \"liver.pinned_force_n\", max = 0.05 },",
                ),
                ("to = [-0.045, 0.000, 0.075]", "to = [-0.045, 0.000, 0.095]"),
                ("to = [-0.045, 0.000, 0.064]", "to = [-0.045, 0.000, 0.095]"),
            ],
        )
    };
    let pin = "pinned = { with = [{ entity = \"probe.right\", points = [[-0.045, 0.000, 0.045]] }] }";
    let held = drawn(pin);
    assert!(held.summary.task.completed, "{:?} {:?}", held.summary.task, held.summary.error);
    let (felt, took) = (held.summary.force_newtons_max, outcome(&held, "liver.pinned_force_n.largest"));
    assert!((felt / took - 1.0).abs() < 0.25, "the hand feels {felt} N of {took} N");
    let free = drawn("");
    let nothing = free.summary.force_newtons_max;
    assert!(!free.summary.task.completed && nothing < 0.05 * felt, "{nothing} N of nothing, {felt} N");
}

#[test]
fn a_mesh_of_ones_own_takes_the_place_of_an_organ_by_one_line() {
    let organ = run("fem-liver", &[]);
    let scene = &organ.kernel.snapshot;
    let liver = scene.find("liver").expect("a liver");
    let mesh = scene.get::<TetMesh>(liver).expect("a volume");
    let rest = scene.get::<RestPositions>(liver).expect("its shape at rest");
    // The same liver as an external Gmsh file.
    let mut file = format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n{}\n", rest.positions.len());
    for (node, at) in rest.positions.iter().enumerate() {
        file.push_str(&format!("{} {:e} {:e} {:e}\n", node + 1, at.x, at.y, at.z));
    }
    file.push_str(&format!("$EndNodes\n$Elements\n{}\n", mesh.tets.len()));
    for (element, tet) in mesh.tets.iter().enumerate() {
        let [a, b, c, d] = tet.map(|node| node + 1);
        file.push_str(&format!("{} 4 2 1 1 {a} {b} {c} {d}\n", element + 1));
    }
    file.push_str("$EndElements\n");
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("my-liver.msh"), file).expect("written");
    let (_, text) = trocar::app::SCENARIOS.iter().find(|(name, _)| *name == "fem-liver").expect("a scenario");
    let one_line = "mesh = { organ = \"liver\", edge = 0.010 }\ntissue";
    assert!(text.contains(one_line));
    let text = text.replace(one_line, "mesh = { file = \"my-liver.msh\" }\ntissue");
    let app = app();
    let scenario = Scenario::parse(&folder.path().join("own.toml"), &text, app.registry());
    let own = finish(&app, &scenario.expect("a valid scenario"), &lockstep(1));
    assert!(own.summary.task.completed, "{:?} {:?}", own.summary.task, own.summary.error);
    for measure in ["liver.contact_force_n.largest", "liver.displacement_max_m.largest"] {
        let (of_organ, of_file) = (outcome(&organ, measure), outcome(&own, measure));
        assert!((of_file / of_organ - 1.0).abs() < 1e-6, "{measure}: {of_file}, {of_organ}");
    }
}

#[test]
fn a_membrane_that_has_grown_onto_two_organs_draws_both_along() {
    holds("omentum");
    let pulled = |replacements: &[(&str, &str)], organ: &str| {
        outcome(&run("omentum", replacements), &format!("{organ}.displacement_max_m.largest"))
    };
    // Without gravity only the membrane deforms the organs.
    let weightless = ("gravity = [0.0, 0.0, -9.81]", "gravity = [0.0, 0.0, 0.0]");
    let down = ("to = [0.0, 0.0, -0.024]", "to = [0.0, 0.0, -0.014]");
    let joined = [pulled(&[weightless, down], "liver"), pulled(&[weightless, down], "stomach")];
    assert!(joined.iter().all(|organ| *organ > 5e-4), "{joined:?}");
    // A stiffer organ deforms less, and one without fixation not at all.
    let stiffer = pulled(&[weightless, down, ("young_modulus = 6000.0", "young_modulus = 24000.0")], "liver");
    assert!(stiffer < 0.7 * joined[0], "{stiffer} and {} m", joined[0]);
    let loose =
        pulled(&[weightless, down, ("stiffness = 100.0, damping", "stiffness = 0.001, damping")], "liver");
    assert!(loose < 0.05 * joined[0], "{loose} m");
}

#[test]
fn a_band_of_two_meshes_stays_about_an_organ() {
    holds("band");
    // A cushion without contact with the stomach falls through it, and the belt with it.
    let through = run("band", &[("stiffness = 200.0, friction = 0.3", "stiffness = 0.01, friction = 0.3")]);
    assert!(!through.summary.task.completed);
    assert!(outcome(&through, "belt.displacement_max_m") > 0.1);
    // A belt that is not attached to it stays where the jaws take it, and the cushion does not follow.
    let apart = run("band", &[("stiffness = 300.0, damping", "stiffness = 0.001, damping")]);
    assert!(!apart.summary.task.completed);
}

#[test]
fn nine_instruments_do_what_each_is_for_and_straight_rods_in_their_place_do_not() {
    let all = holds("instruments");
    assert!(all.summary.task.errors.is_empty());
    // With the engine's rigid bodies as with ours.
    let by_the_engine = run("instruments", &[("kind = \"rigid-bodies\"", "kind = \"rapier\"")]);
    assert!(by_the_engine.summary.task.completed, "{:?}", by_the_engine.summary.task.errors);
    // A plain rod cannot grasp, spread, cut, catch, hold up level or reach behind. A fork wider than the knot misses
    // it, and without a loop there is none to carry.
    let controls = [
        ("kind = \"grasper\"", "kind = \"probe\"", "ring."),
        ("kind = \"suture_grasper\"", "kind = \"probe\"", "rod."),
        ("kind = \"blunt_dissector\"", "kind = \"probe\"", "block."),
        ("kind = \"scissors\"", "kind = \"probe\"", "thread."),
        ("kind = \"hook_cautery\"", "kind = \"probe\"", "ring.hooked."),
        ("kind = \"retractor\"", "kind = \"probe\"", "lobe."),
        ("kind = \"band_passer\"", "kind = \"probe\"", "band."),
        ("jaw_width = 0.006", "jaw_width = 0.014", "knot."),
        ("translation = [-0.115, -0.03, 0.0345]", "translation = [-0.115, 0.0, 0.0345]", "loop."),
    ];
    for (with, without, of) in controls {
        let control = run("instruments", &[(with, without)]);
        let errors: Vec<String> =
            control.summary.task.errors.iter().map(|error| error.kind.clone()).collect();
        assert!(!errors.is_empty() && errors.iter().all(|error| error.starts_with(of)), "{with}: {errors:?}");
    }
}
