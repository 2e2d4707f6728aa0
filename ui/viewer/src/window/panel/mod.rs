//! The panels around the scene. They show the subjects' state and send requests; they never change a scene themselves.

mod actors;
mod hands;
mod help;
mod icons;
mod inspect;
mod mentor;
mod network;
mod result;
mod session;
mod task;
mod timeline;
mod tune;
mod value;

use std::time::{Duration, Instant};

use egui::{Color32, RichText, Ui};

use super::keys::Action;
use super::mentor::Pen;
use super::subject::{Note, PlayState, Request};
use super::view_state::SubjectView;

pub(super) use inspect::Inspector;
pub(super) use tune::TuningPanel;

/// How long a note is shown.
const NOTE: Duration = Duration::from_secs(6);
/// The available speeds.
pub(super) const SPEEDS: [f64; 9] = [0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

/// Colours of good and bad states.
pub(super) const GOOD: Color32 = Color32::from_rgb(120, 200, 140);
pub(super) const POOR: Color32 = Color32::from_rgb(235, 190, 90);
pub(super) const BAD: Color32 = Color32::from_rgb(240, 110, 100);

/// Visibility and state of the panels.
pub(super) struct Panels {
    pub(super) left: bool,
    pub(super) right: bool,
    pub(super) actors: bool,
    pub(super) help: bool,
    pub(super) inspector: Inspector,
    pub(super) tuning: TuningPanel,
    /// The help of the player's controls.
    pub(super) player_help: Vec<(String, String)>,
    notes: Vec<(Instant, Note)>,
    heard: Vec<u64>,
    /// The session whose result was closed.
    closed: Option<u64>,
}

/// The fonts of a window: where the fonts of one family lack a symbol, those of the other give it.
pub(super) fn fonts() -> egui::FontDefinitions {
    let mut fonts = egui::FontDefinitions::default();
    let all: Vec<String> = fonts.families.values().flatten().cloned().collect();
    for family in fonts.families.values_mut() {
        for name in &all {
            if !family.contains(name) {
                family.push(name.clone());
            }
        }
    }
    fonts
}

/// What a window knows of itself.
#[derive(Clone, Debug, Default)]
pub(super) struct WindowState {
    /// Frames a second.
    pub(super) frames: f64,
    /// How far the pictures lag, and why.
    pub(super) lag: Option<[String; 2]>,
    /// The player.
    pub(super) hands: Hands,
}

/// Requests of the panels to the window.
#[derive(Default)]
pub(super) struct Wishes(pub(super) Vec<Action>);

impl Panels {
    pub(super) fn new(player_help: Vec<(String, String)>) -> Self {
        Self {
            left: true,
            right: false,
            actors: false,
            help: false,
            inspector: Inspector::default(),
            tuning: TuningPanel::default(),
            player_help,
            notes: Vec::new(),
            heard: Vec::new(),
            closed: None,
        }
    }

    /// Shows a note of the window itself.
    pub(super) fn note(&mut self, text: String, bad: bool) {
        if self.notes.len() >= 8 {
            self.notes.remove(0);
        }
        self.notes.push((Instant::now(), Note { text, bad }));
    }

    /// Collects new notes of the subjects.
    fn listen(&mut self, subject_views: &mut [SubjectView]) {
        self.heard.resize(subject_views.len(), 0);
        for (index, subject_view) in subject_views.iter_mut().enumerate() {
            let state = subject_view.subject.state();
            for (number, note) in &state.notes {
                if *number > self.heard[index] {
                    self.heard[index] = *number;
                    self.note(note.text.clone(), note.bad);
                }
            }
        }
        self.notes.retain(|(since, _)| since.elapsed() < NOTE);
    }

    /// Draws all panels; the scene gets the rest of `ui`.
    pub(super) fn show(
        &mut self,
        ui: &mut Ui,
        subject_views: &mut [SubjectView],
        pen: &mut Pen,
        state: &WindowState,
    ) -> Wishes {
        let mut wishes = Wishes::default();
        self.listen(subject_views);
        if subject_views.iter_mut().any(|subject_view| subject_view.subject.state().length.is_some()) {
            egui::Panel::bottom("timeline").show(ui, |ui| timeline::show(ui, subject_views, &mut wishes));
        }
        if self.actors {
            egui::Panel::bottom("actors")
                .resizable(true)
                .default_size(180.0)
                .show(ui, |ui| actors::show(ui, subject_views));
        }
        if self.left {
            // Fixed width, whatever its content, so that the scene keeps its size.
            egui::Panel::left("session").exact_size(240.0).show(ui, |ui| {
                ui.spacing_mut().slider_width = 70.0;
                egui::ScrollArea::vertical().show(ui, |ui| {
                    session::show(ui, subject_views, pen, state, &self.player_help, &mut wishes);
                });
            });
        }
        if self.right {
            egui::Panel::right("inspect").exact_size(300.0).show(ui, |ui| {
                let Some(subject_view) = subject_views.first_mut() else { return };
                self.tuning.show(ui, subject_view);
                ui.separator();
                self.inspector.show(ui, subject_view);
            });
        }
        result::show(ui.ctx(), subject_views, &mut self.closed, &mut wishes);
        if let Some(subject_view) = subject_views.first() {
            mentor::over_the_scene(ui.ctx(), &subject_view.scene, pen);
        }
        if let Some([lag, why]) = &state.lag {
            lagging(ui, lag, why);
        }
        if self.help {
            help::show(ui.ctx(), &mut self.help, &self.player_help);
        }
        wishes
    }

    /// Draws the notes over the scene.
    pub(super) fn show_notes(&self, ui: &Ui) {
        if self.notes.is_empty() {
            return;
        }
        // Redraws, so that they disappear in time.
        ui.ctx().request_repaint_after(Duration::from_millis(500));
        egui::Area::new(egui::Id::unique("notes"))
            .anchor(egui::Align2::CENTER_TOP, [0.0, 12.0])
            .interactable(false)
            .show(ui.ctx(), |ui| {
                for (_, note) in &self.notes {
                    let color = if note.bad { BAD } else { Color32::WHITE };
                    egui::Frame::popup(ui.style()).show(ui, |ui| {
                        ui.label(RichText::new(&note.text).color(color));
                    });
                }
            });
    }
}

/// Says over the scene that pictures lag, whatever panels are open.
fn lagging(ui: &Ui, lag: &str, why: &str) {
    egui::Area::new(egui::Id::unique("lag"))
        .anchor(egui::Align2::RIGHT_BOTTOM, [-12.0, -12.0])
        .interactable(false)
        .show(ui.ctx(), |ui| {
            egui::Frame::popup(ui.style()).show(ui, |ui| {
                ui.set_max_width(420.0);
                ui.label(RichText::new(lag).color(POOR).strong());
                ui.label(RichText::new(why).color(POOR));
            });
        });
}

/// Whether the player can take control of the instruments, and has done so.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Hands {
    pub(super) there: bool,
    pub(super) taken: bool,
}

/// Sends the same request to every subject of the window.
pub(super) fn request_all(subject_views: &mut [SubjectView], request: &Request) {
    subject_views.iter_mut().for_each(|subject_view| subject_view.subject.request(request.clone()));
}

/// The next speed, up or down.
pub(super) fn next_speed(now: f64, by: isize) -> f64 {
    let nearest = |(_, a): &(usize, &f64), (_, b): &(usize, &f64)| {
        (*a / now).ln().abs().total_cmp(&(*b / now).ln().abs())
    };
    let at = SPEEDS.iter().enumerate().min_by(nearest).map_or(4, |(at, _)| at);
    SPEEDS[(at as isize + by).clamp(0, SPEEDS.len() as isize - 1) as usize]
}

/// Pauses or resumes.
pub(super) fn toggle_play(subject_views: &mut [SubjectView]) {
    let runs = subject_views
        .iter_mut()
        .any(|subject_view| subject_view.subject.state().play_state == PlayState::Running);
    request_all(subject_views, if runs { &Request::Pause } else { &Request::Resume });
}

/// A time as text for people.
pub(super) fn clock(seconds: f64) -> String {
    let minutes = (seconds / 60.0).floor();
    format!("{minutes:.0}:{:04.1}", seconds - 60.0 * minutes)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The texts among shapes.
    pub(super) fn texts(shapes: &[egui::epaint::ClippedShape]) -> String {
        fn add(shape: &egui::Shape, out: &mut String) {
            match shape {
                egui::Shape::Text(text) => {
                    out.push_str(text.galley.text());
                    out.push('\n');
                }
                egui::Shape::Vec(shapes) => shapes.iter().for_each(|shape| add(shape, out)),
                _ => {}
            }
        }
        let mut out = String::new();
        shapes.iter().for_each(|clipped| add(&clipped.shape, &mut out));
        out
    }

    #[test]
    fn that_pictures_lag_is_said_over_the_scene() {
        let ctx = egui::Context::default();
        let mut told = String::new();
        for _ in 0..2 {
            let output = ctx.run_ui(egui::RawInput::default(), |ui| {
                lagging(ui, "pictures lag: 1 a second", "the machine is busy");
            });
            told = texts(&output.shapes);
        }
        assert!(told.contains("pictures lag: 1 a second") && told.contains("the machine is busy"), "{told}");
    }

    /// Whatever is not ASCII in the sources of what a window shows has a glyph in the fonts that it has, of both kinds.
    #[test]
    fn every_symbol_that_a_window_shows_is_in_its_fonts() {
        fn sources(folder: &std::path::Path, found: &mut Vec<std::path::PathBuf>) {
            for entry in std::fs::read_dir(folder).expect("a folder") {
                let path = entry.expect("an entry").path();
                if path.is_dir() {
                    sources(&path, found);
                } else if path.extension().is_some_and(|ending| ending == "rs") {
                    found.push(path);
                }
            }
        }
        let ui = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the folder of all rooms");
        let mut files = vec![
            ui.join("cli/src/run.rs"),
            ui.join("cli/src/run_text.rs"),
            ui.join("../scene/src/readable.rs"),
            ui.join("../scene/src/components/person.rs"),
            ui.join("../scene/src/components/task.rs"),
        ];
        sources(&ui.join("viewer/src/window"), &mut files);
        sources(&ui.join("viewer/src/overlay"), &mut files);
        sources(&ui.join("cli/src/window"), &mut files);
        let mut symbols = std::collections::BTreeMap::new();
        for file in &files {
            let text =
                std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
            for line in text.lines().filter(|line| !line.trim_start().starts_with("//")) {
                let code = line.split(" // ").next().unwrap_or(line);
                for symbol in code.chars().filter(|symbol| !symbol.is_ascii()) {
                    symbols.entry(symbol).or_insert_with(|| file.display().to_string());
                }
            }
        }
        assert!(symbols.contains_key(&'→') && symbols.contains_key(&'µ'), "{symbols:?}");
        let ctx = egui::Context::default();
        ctx.set_fonts(fonts());
        let _ = ctx.run_ui(egui::RawInput::default(), |_| {});
        let missing: Vec<String> = symbols
            .iter()
            .flat_map(|(symbol, file)| {
                let fonts = [egui::FontId::proportional(13.0), egui::FontId::monospace(13.0)];
                let lacks = |font: &egui::FontId| !ctx.fonts_mut(|fonts| fonts.has_glyph(font, *symbol));
                let told = move |font: egui::FontId| format!("{symbol:?} of {file} in {:?}", font.family);
                fonts.into_iter().filter(lacks).map(told).collect::<Vec<_>>()
            })
            .collect();
        assert_eq!(missing, [] as [String; 0]);
    }

    #[test]
    fn speeds_are_doubled_and_halved_and_end() {
        assert_eq!(next_speed(1.0, 1), 2.0);
        assert_eq!(next_speed(1.0, -1), 0.5);
        assert_eq!(next_speed(0.9, 1), 2.0);
        assert_eq!(next_speed(16.0, 1), 16.0);
        assert_eq!(next_speed(0.0625, -1), 0.0625);
    }

    #[test]
    fn a_clock_counts_minutes() {
        assert_eq!(clock(0.04), "0:00.0");
        assert_eq!(clock(75.25), "1:15.2");
    }
}
