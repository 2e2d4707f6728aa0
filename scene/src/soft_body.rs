//! What a soft body can do, whichever method moves it.
//!
//! A method of soft bodies has a component of its own, by which a scene says that a body is moved by it. That component declares
//! [`Component::SOFT_BODY`](crate::Component::SOFT_BODY): shared code asks a body what it can do, and never which method moves it.

/// What a body can do whose vertices a method moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SoftAbilities {
    /// Its controller responds to contacts that detectors find.
    pub responds_to_contacts: bool,
    /// It may be `coupled` with others: with those of its own method it is stepped as one problem, to others it gives impulses.
    pub couples: bool,
    /// It takes impulses from bodies of other controllers that are coupled with it.
    pub answers_couplings: bool,
    /// It may be `pinned` to what has been driven into it.
    pub is_pinnable: bool,
    /// It goes on without elements that have burned, and takes them out of its surface.
    pub loses_elements: bool,
}

impl SoftAbilities {
    /// A body that can do nothing but move.
    pub const NONE: Self = Self {
        responds_to_contacts: false,
        couples: false,
        answers_couplings: false,
        is_pinnable: false,
        loses_elements: false,
    };
}

/// Names of components as a message tells them: `'a', 'b' or 'c'`.
#[must_use]
pub fn one_of(names: &[&str]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("'{name}'")).collect();
    match quoted.split_last() {
        None => "no method of this session".into(),
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_told_as_a_choice() {
        assert_eq!(one_of(&["a"]), "'a'");
        assert_eq!(one_of(&["a", "b", "c"]), "'a', 'b' or 'c'");
        assert_eq!(one_of(&[]), "no method of this session");
    }
}
