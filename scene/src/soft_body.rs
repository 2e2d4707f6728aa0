//! Abilities of soft bodies, independent of their method.
//!
//! Each soft-body method has its own component, which assigns a body to the method. That component declares
//! [`Component::SOFT_BODY`](crate::Component::SOFT_BODY): shared code queries a body's abilities, never its method.

/// Abilities of a body with simulated vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SoftAbilities {
    /// Its controller responds to detected contacts.
    pub responds_to_contacts: bool,
    /// Its controller answers contacts with rigid bodies that move, for both sides.
    pub bears: bool,
    /// It may be `coupled` with other bodies: those of its own method are solved as one system, those of other methods
    /// get impulses.
    pub couples: bool,
    /// It takes impulses from bodies of other controllers that are coupled with it.
    pub answers_couplings: bool,
    /// It may be `pinned` to a body driven into it.
    pub is_pinnable: bool,
    /// It removes burned elements, also from its surface, and continues.
    pub loses_elements: bool,
}

impl SoftAbilities {
    /// A body without any of these abilities.
    pub const NONE: Self = Self {
        responds_to_contacts: false,
        bears: false,
        couples: false,
        answers_couplings: false,
        is_pinnable: false,
        loses_elements: false,
    };
}

/// Names of components, formatted for a message: `'a', 'b' or 'c'`.
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
