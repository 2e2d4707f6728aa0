//! The left panel: time, exercise, view.

use egui::{RichText, Ui};

use super::super::keys::{Action, KEYS, name};
use super::super::subject::{Ask, Course};
use super::super::view_state::{Eyes, Look, QUALITIES, Sight};
use crate::overlay::Overlay;

use super::{Hands, SPEEDS, Wishes, ask_all, clock, task, toggle_course};

/// Draws the panel.
pub(super) fn show(ui: &mut Ui, sights: &mut [Sight], frames: f64, hands: Hands, wishes: &mut Wishes) {
    for sight in sights.iter_mut() {
        ui.heading(sight.subject.title());
        time(ui, sight);
    }
    controls(ui, sights, wishes);
    if hands.there {
        let text = if hands.taken { "instruments in hand (Esc)" } else { "take the instruments (F8)" };
        if ui.add_enabled(!hands.taken, egui::Button::new(text)).clicked() {
            wishes.0.push(Action::Hands);
        }
    }
    for sight in sights.iter() {
        task::show(ui, &sight.scene);
    }
    ui.separator();
    view(ui, sights);
    over(ui, sights);
    ui.horizontal(|ui| {
        if ui.button("picture").on_hover_text(hint(Action::Screenshot)).clicked() {
            wishes.0.push(Action::Screenshot);
        }
        if ui.button("new window").on_hover_text(hint(Action::NewWindow)).clicked() {
            wishes.0.push(Action::NewWindow);
        }
    });
    ui.separator();
    ui.horizontal(|ui| {
        ui.label(RichText::new(format!("{frames:.0} frames/s")).weak());
        if ui.link("keys (F1)").clicked() {
            wishes.0.push(Action::Help);
        }
    });
}

/// The key of an action, as a hint.
fn hint(action: Action) -> String {
    KEYS.iter().find(|(_, known, _)| *known == action).map(|(chord, ..)| name(chord)).unwrap_or_default()
}

fn time(ui: &mut Ui, sight: &mut Sight) {
    let standing = sight.subject.standing();
    let now = sight.subject.now().as_secs_f64();
    let state = match standing.course {
        Course::Running if standing.speed != 1.0 && standing.speed > 0.0 => {
            format!("{:.3}×", standing.speed).replace(".000", "")
        }
        Course::Running => String::new(),
        Course::Paused => "paused".to_owned(),
        Course::Over => "over".to_owned(),
    };
    ui.horizontal(|ui| {
        ui.label(RichText::new(clock(now)).monospace().size(18.0));
        ui.label(RichText::new(state).weak());
    });
}

fn controls(ui: &mut Ui, sights: &mut [Sight], wishes: &mut Wishes) {
    let Some(first) = sights.first_mut() else { return };
    let standing = first.subject.standing();
    let can = standing.abilities;
    ui.horizontal(|ui| {
        let text = if standing.course == Course::Running { "pause" } else { "go on" };
        let over = standing.course == Course::Over && standing.length.is_none();
        if ui.add_enabled(can.pause && !over, egui::Button::new(text)).on_hover_text("Space").clicked() {
            toggle_course(sights);
        }
        let still = standing.course == Course::Paused;
        if ui.add_enabled(can.step && still, egui::Button::new("step")).on_hover_text("→").clicked() {
            wishes.0.push(Action::Step);
        }
        if ui.add_enabled(can.reset, egui::Button::new("reset")).on_hover_text("Backspace").clicked() {
            ask_all(sights, &Ask::Reset);
        }
    });
    let mut speed = standing.speed;
    let why = "in real time there is one speed only; --lockstep and recordings have others";
    ui.add_enabled_ui(can.speed, |ui| {
        let shown =
            |speed: f64| if speed < 1.0 { format!("1/{:.0}×", 1.0 / speed) } else { format!("{speed}×") };
        egui::ComboBox::from_label("speed").selected_text(shown(speed)).show_ui(ui, |ui| {
            for choice in SPEEDS {
                ui.selectable_value(&mut speed, choice, shown(choice));
            }
        });
    })
    .response
    .on_disabled_hover_text(why);
    if speed != standing.speed {
        ask_all(sights, &Ask::Speed(speed));
    }
}

fn view(ui: &mut Ui, sights: &mut [Sight]) {
    let Some((sight, others)) = sights.split_first_mut() else { return };
    ui.strong("view");
    camera(ui, sight);
    let named = |eyes: Eyes| Eyes::ALL.iter().find(|(known, _)| *known == eyes).map_or("", |(_, name)| name);
    egui::ComboBox::from_label("eyes").selected_text(named(sight.eyes)).show_ui(ui, |ui| {
        for (eyes, name) in Eyes::ALL {
            ui.selectable_value(&mut sight.eyes, eyes, name);
        }
    });
    if sight.eyes != Eyes::One {
        let millimetres = |ui: &mut Ui, metres: &mut f64, range, label: &str| {
            let mut shown = *metres * 1e3;
            let slider = egui::Slider::new(&mut shown, range).suffix(" mm").text(label);
            if ui.add(slider).changed() {
                *metres = shown * 1e-3;
            }
        };
        millimetres(ui, &mut sight.stereo.interocular, 0.0..=70.0, "eyes apart");
        millimetres(ui, &mut sight.stereo.convergence, 20.0..=1000.0, "converge at");
    }
    let quality = QUALITIES.iter().find(|(known, _)| *known == sight.quality).map_or("", |(_, name)| name);
    egui::ComboBox::from_label("quality").selected_text(quality).show_ui(ui, |ui| {
        for (quality, name) in QUALITIES {
            ui.selectable_value(&mut sight.quality, quality, name);
        }
    });
    if let Look::Free(orbit) = &mut sight.look {
        let mut degrees = orbit.field_of_view.to_degrees();
        if ui.add(egui::Slider::new(&mut degrees, 10.0..=110.0).suffix("°").text("field of view")).changed()
        {
            orbit.field_of_view = degrees.to_radians();
        }
    }
    // Compared recordings share one point of view.
    for other in others {
        (other.eyes, other.stereo, other.quality) = (sight.eyes, sight.stereo, sight.quality);
        other.look = sight.look.clone();
    }
}

/// The choice of cameras: one, all, or the mouse's own.
fn camera(ui: &mut Ui, sight: &mut Sight) {
    let cameras = sight.cameras();
    let now = match &sight.look {
        Look::Camera(name) => name.clone(),
        Look::Cameras(names) => format!("{} cameras", names.len()),
        Look::Free(_) => "free".to_owned(),
    };
    egui::ComboBox::from_label("camera").selected_text(&now).show_ui(ui, |ui| {
        for camera in &cameras {
            let look = Look::Camera(camera.clone());
            if ui.selectable_label(sight.look == look, camera).clicked() {
                sight.look = look;
            }
        }
        if cameras.len() > 1 {
            let all = matches!(sight.look, Look::Cameras(_));
            if ui.selectable_label(all, "all of them").clicked() {
                sight.look = Look::Cameras(cameras);
            }
        }
        if ui.selectable_label(matches!(sight.look, Look::Free(_)), "free (Esc)").clicked() {
            sight.free();
        }
    });
}

/// The switches of the overlays.
fn over(ui: &mut Ui, sights: &mut [Sight]) {
    let Some((sight, others)) = sights.split_first_mut() else { return };
    egui::CollapsingHeader::new("show").show(ui, |ui| {
        for overlay in Overlay::ALL {
            let mut shown = sight.overlays.shows(overlay);
            let text = format!("{} ({})", overlay.name(), hint(Action::Show(overlay)));
            if ui.checkbox(&mut shown, text).on_hover_text(overlay.description()).changed() {
                sight.overlays.set(overlay, shown);
            }
        }
    });
    for other in others {
        other.overlays.clone_from(&sight.overlays);
    }
}
