//! The result of a session that is over: it stays over the last scene until it is closed.

use egui::{Context, RichText};

use super::super::keys::Action;
use super::super::subject::{PlayState, SubjectState};
use super::super::view_state::SubjectView;
use super::{BAD, GOOD, Wishes};

/// Shows the result of the first subject that has one; `closed` is the number of sessions whose result was closed.
pub(super) fn show(
    ctx: &Context,
    subject_views: &mut [SubjectView],
    closed: &mut Option<u64>,
    wishes: &mut Wishes,
) {
    for subject_view in subject_views {
        let state = subject_view.subject.state();
        let Some((number, _)) = shown(&state, *closed) else { continue };
        let mut open = true;
        card(ctx, &subject_view.subject.title(), &state, &mut open, wishes);
        if !open {
            *closed = Some(number);
        }
        return;
    }
}

/// The result that is to be shown, with its number.
fn shown(state: &SubjectState, closed: Option<u64>) -> Option<(u64, &super::super::subject::Verdict)> {
    let (number, verdict) = state.verdict.as_ref()?;
    let is_shown = state.play_state == PlayState::Over && closed != Some(*number);
    is_shown.then_some((*number, verdict))
}

fn card(ctx: &Context, title: &str, state: &SubjectState, open: &mut bool, wishes: &mut Wishes) {
    let Some((_, verdict)) = &state.verdict else { return };
    egui::Window::new(title)
        .id(egui::Id::unique("result"))
        .open(open)
        .collapsible(false)
        .resizable(false)
        .default_width(360.0)
        .anchor(egui::Align2::CENTER_TOP, [0.0, 48.0])
        .show(ctx, |ui| {
            let color = if verdict.bad { BAD } else { GOOD };
            ui.label(RichText::new(&verdict.title).color(color).size(20.0));
            egui::ScrollArea::vertical().max_height(300.0).show(ui, |ui| {
                for line in &verdict.lines {
                    ui.label(line);
                }
            });
            ui.separator();
            ui.horizontal(|ui| {
                let again = egui::Button::new("once more (Backspace)");
                if ui.add_enabled(state.abilities.reset, again).clicked() {
                    wishes.0.push(Action::Reset);
                }
                if ui.button("end (Ctrl+Q)").clicked() {
                    wishes.0.push(Action::Quit);
                }
            });
        });
}

#[cfg(test)]
mod tests {
    use super::super::super::subject::Verdict;
    use super::*;

    #[test]
    fn a_result_is_shown_from_the_end_of_a_session_until_it_is_closed_or_the_next_one_begins() {
        let verdict =
            Verdict { title: "completed".into(), lines: vec!["score 91.2 / 100".into()], bad: false };
        let mut state = SubjectState { verdict: Some((1, verdict.clone())), ..SubjectState::default() };
        assert_eq!(shown(&state, None), None, "the session goes on");
        state.play_state = PlayState::Over;
        assert_eq!(shown(&state, None), Some((1, &verdict)));
        assert_eq!(shown(&state, Some(1)), None, "closed");
        state.verdict = Some((2, verdict.clone()));
        assert_eq!(shown(&state, Some(1)), Some((2, &verdict)), "that of the next session");
    }

    #[test]
    fn the_card_has_the_score_and_every_line() {
        let lines = ["score 18.2 / 100", "gauze.pieces is 1, at least 2 is expected"].map(str::to_owned);
        let verdict = Verdict { title: "not completed".into(), lines: lines.to_vec(), bad: true };
        let state = SubjectState {
            verdict: Some((1, verdict)),
            play_state: PlayState::Over,
            ..SubjectState::default()
        };
        let ctx = Context::default();
        let mut texts = String::new();
        for _ in 0..3 {
            let output = ctx.run_ui(egui::RawInput::default(), |ui| {
                card(ui.ctx(), "Cautery", &state, &mut true, &mut Wishes::default());
            });
            texts = super::super::tests::texts(&output.shapes);
        }
        for text in
            ["Cautery", "not completed", "score 18.2 / 100", "at least 2 is expected", "Backspace", "Ctrl+Q"]
        {
            assert!(texts.contains(text), "'{text}' is not in: {texts}");
        }
    }
}
