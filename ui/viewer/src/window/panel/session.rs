//! The left panel: time, exercise, view.

use egui::{RichText, Ui};

use super::super::keys::{Action, hint};
use super::super::mentor::Pen;
use super::super::subject::{PlayState, Request};
use super::super::view_state::{Look, QUALITIES, StereoLayout, SubjectView};
use crate::overlay::Overlay;

use super::{
    POOR, SPEEDS, WindowState, Wishes, clock, hands, mentor, network, request_all, task, toggle_play,
};

/// Draws the panel.
pub(super) fn show(
    ui: &mut Ui,
    subject_views: &mut [SubjectView],
    pen: &mut Pen,
    state: &WindowState,
    player_help: &[(String, String)],
    wishes: &mut Wishes,
) {
    for subject_view in subject_views.iter_mut() {
        ui.heading(subject_view.subject.title());
        time(ui, subject_view);
    }
    controls(ui, subject_views, wishes);
    if state.hands.there
        && let Some(subject_view) = subject_views.first()
    {
        ui.separator();
        hands::charge(ui, &subject_view.scene, state.hands, wishes);
    }
    for subject_view in subject_views.iter() {
        task::show(ui, &subject_view.scene);
        network::show(ui, &subject_view.scene);
    }
    if let Some(subject_view) = subject_views.first() {
        mentor::show(ui, &subject_view.scene, pen, wishes);
    }
    if state.hands.there {
        ui.separator();
        hands::keys(ui, player_help);
    }
    ui.separator();
    view(ui, subject_views);
    over(ui, subject_views);
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
        let frames = RichText::new(format!("{:.0} frames/s", state.frames));
        ui.label(if state.lag.is_some() { frames.color(POOR) } else { frames.weak() });
        if ui.link("keys (F1)").clicked() {
            wishes.0.push(Action::Help);
        }
    });
}

fn time(ui: &mut Ui, subject_view: &mut SubjectView) {
    let state = subject_view.subject.state();
    let now = subject_view.subject.now().as_secs_f64();
    let state = match state.play_state {
        PlayState::Running if state.speed != 1.0 && state.speed > 0.0 => {
            format!("{:.3}×", state.speed).replace(".000", "")
        }
        PlayState::Running => String::new(),
        PlayState::Paused => "paused".to_owned(),
        PlayState::Over => "over".to_owned(),
    };
    ui.horizontal(|ui| {
        ui.label(RichText::new(clock(now)).monospace().size(18.0));
        ui.label(RichText::new(state).weak());
    });
}

fn controls(ui: &mut Ui, subject_views: &mut [SubjectView], wishes: &mut Wishes) {
    let Some(first) = subject_views.first_mut() else { return };
    let state = first.subject.state();
    let can = state.abilities;
    ui.horizontal(|ui| {
        let text = if state.play_state == PlayState::Running { "pause" } else { "go on" };
        let over = state.play_state == PlayState::Over && state.length.is_none();
        if ui.add_enabled(can.pause && !over, egui::Button::new(text)).on_hover_text("Space").clicked() {
            toggle_play(subject_views);
        }
        let still = state.play_state == PlayState::Paused;
        if ui.add_enabled(can.step && still, egui::Button::new("step")).on_hover_text("→").clicked() {
            wishes.0.push(Action::Step);
        }
        if ui.add_enabled(can.reset, egui::Button::new("reset")).on_hover_text("Backspace").clicked() {
            request_all(subject_views, &Request::Reset);
        }
    });
    let mut speed = state.speed;
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
    if speed != state.speed {
        request_all(subject_views, &Request::Speed(speed));
    }
}

fn view(ui: &mut Ui, subject_views: &mut [SubjectView]) {
    let Some((subject_view, others)) = subject_views.split_first_mut() else { return };
    ui.strong("view");
    camera(ui, subject_view);
    let named = |eyes: StereoLayout| {
        StereoLayout::ALL.iter().find(|(known, _)| *known == eyes).map_or("", |(_, name)| name)
    };
    egui::ComboBox::from_label("eyes").selected_text(named(subject_view.eyes)).show_ui(ui, |ui| {
        for (eyes, name) in StereoLayout::ALL {
            ui.selectable_value(&mut subject_view.eyes, eyes, name);
        }
    });
    if subject_view.eyes != StereoLayout::One {
        let millimetres = |ui: &mut Ui, metres: &mut f64, range, label: &str| {
            let mut shown = *metres * 1e3;
            let slider = egui::Slider::new(&mut shown, range).suffix(" mm").text(label);
            if ui.add(slider).changed() {
                *metres = shown * 1e-3;
            }
        };
        millimetres(ui, &mut subject_view.stereo.interocular, 0.0..=70.0, "eyes apart");
        millimetres(ui, &mut subject_view.stereo.convergence, 20.0..=1000.0, "converge at");
    }
    let quality =
        QUALITIES.iter().find(|(known, _)| *known == subject_view.quality).map_or("", |(_, name)| name);
    egui::ComboBox::from_label("quality").selected_text(quality).show_ui(ui, |ui| {
        for (quality, name) in QUALITIES {
            ui.selectable_value(&mut subject_view.quality, quality, name);
        }
    });
    if let Look::Free(orbit) = &mut subject_view.look {
        let mut degrees = orbit.field_of_view.to_degrees();
        if ui.add(egui::Slider::new(&mut degrees, 10.0..=110.0).suffix("°").text("field of view")).changed()
        {
            orbit.field_of_view = degrees.to_radians();
        }
    }
    // Compared recordings share one point of view.
    for other in others {
        (other.eyes, other.stereo, other.quality) =
            (subject_view.eyes, subject_view.stereo, subject_view.quality);
        other.look = subject_view.look.clone();
    }
}

/// The choice of cameras: one, all, or the mouse's own.
fn camera(ui: &mut Ui, subject_view: &mut SubjectView) {
    let cameras = subject_view.cameras();
    let now = match &subject_view.look {
        Look::Camera(name) => name.clone(),
        Look::Cameras(names) => format!("{} cameras", names.len()),
        Look::Free(_) => "free".to_owned(),
    };
    egui::ComboBox::from_label("camera").selected_text(&now).show_ui(ui, |ui| {
        for camera in &cameras {
            let look = Look::Camera(camera.clone());
            if ui.selectable_label(subject_view.look == look, camera).clicked() {
                subject_view.look = look;
            }
        }
        if cameras.len() > 1 {
            let all = matches!(subject_view.look, Look::Cameras(_));
            if ui.selectable_label(all, "all of them").clicked() {
                subject_view.look = Look::Cameras(cameras);
            }
        }
        if ui.selectable_label(matches!(subject_view.look, Look::Free(_)), "free (Esc)").clicked() {
            subject_view.free();
        }
    });
}

/// The switches of the overlays.
fn over(ui: &mut Ui, subject_views: &mut [SubjectView]) {
    let Some((subject_view, others)) = subject_views.split_first_mut() else { return };
    egui::CollapsingHeader::new("show").show(ui, |ui| {
        for overlay in Overlay::ALL {
            let mut shown = subject_view.overlays.shows(overlay);
            let text = format!("{} ({})", overlay.name(), hint(Action::Show(overlay)));
            if ui.checkbox(&mut shown, text).on_hover_text(overlay.description()).changed() {
                subject_view.overlays.set(overlay, shown);
            }
        }
    });
    for other in others {
        other.overlays.clone_from(&subject_view.overlays);
    }
}
