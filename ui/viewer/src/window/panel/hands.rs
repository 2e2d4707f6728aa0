//! The instruments in a person's hands: which hand is in charge, and the keys that move it.

use egui::{RichText, Ui};
use trocar_scene::{Hand, PersonInput, Snapshot};

use super::super::keys::Action;
use super::{GOOD, Hands, POOR, Wishes};

/// The switch that takes the instruments, and the hand in charge.
pub(super) fn charge(ui: &mut Ui, scene: &Snapshot, hands: Hands, wishes: &mut Wishes) {
    if hands.taken {
        ui.label(RichText::new(in_charge(scene)).color(GOOD).strong());
        ui.label(RichText::new("Esc gives the instruments back").weak());
    } else if ui.button("take the instruments (F8)").clicked() {
        wishes.0.push(Action::Hands);
    } else {
        ui.label(RichText::new(format!("{}, at rest", in_charge(scene))).color(POOR));
    }
}

/// The hand in charge with its instrument: `right hand: hook.right`.
fn in_charge(scene: &Snapshot) -> String {
    let Some((_, input)) = PersonInput::of(scene) else {
        return "no hand is in charge yet".to_owned();
    };
    let side = input.in_charge.as_str();
    let hand = scene.iter::<Hand>().find(|(_, hand)| hand.side == input.in_charge);
    match hand.map(|(_, hand)| scene.name(hand.instrument)) {
        Some(name) => format!("{side} hand: {name}"),
        None => format!("{side} hand"),
    }
}

/// The keys that move the hand in charge.
pub(super) fn keys(ui: &mut Ui, player: &[(String, String)]) {
    egui::CollapsingHeader::new("keys of the hands").default_open(true).show(ui, |ui| {
        for (controls, about) in player {
            ui.horizontal_wrapped(|ui| {
                ui.label(RichText::new(short(controls)).monospace().strong());
                ui.label(RichText::new(about).weak());
            });
        }
    });
}

/// The first control of several: all of them stand in the list of keys (F1).
fn short(controls: &str) -> &str {
    let first = controls.split(", ").next().unwrap_or(controls);
    first.strip_prefix("Key").unwrap_or(first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{Commands, EntityAllocator, Name, RegistryBuilder, Side, SimTime, Store};

    #[test]
    fn the_hand_in_charge_is_told_with_its_instrument() {
        let mut builder = RegistryBuilder::new();
        trocar_scene::components::register(&mut builder).expect("names are free");
        let mut store = Store::new(builder.build());
        assert_eq!(in_charge(&store.snapshot()), "no hand is in charge yet");
        let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 0));
        let [person, left, right] = [out.spawn(), out.spawn(), out.spawn()];
        let hand = |side| Hand { side, instrument: right, world_from_device: Default::default(), scale: 1.0 };
        out.put(right, Name("hook.right".into()));
        out.put(left, hand(Side::Right));
        for (number, (side, told)) in
            [(Side::Right, "right hand: hook.right"), (Side::Left, "left hand")].into_iter().enumerate()
        {
            out.put(person, PersonInput { in_charge: side, ..PersonInput::default() });
            out.seal();
            store.apply(&mut out, SimTime::from_millis(number as u64));
            out.clear();
            assert_eq!(in_charge(&store.snapshot()), told);
        }
    }

    #[test]
    fn a_key_is_named_by_its_first_control() {
        for (controls, told) in [("KeyA, ArrowLeft", "A"), ("MouseLeft", "MouseLeft"), ("pointer", "pointer")]
        {
            assert_eq!(short(controls), told);
        }
    }
}
