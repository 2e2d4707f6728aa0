//! Telling one thing from every other, so that what is remembered of it is never taken for what is known of another.

use std::sync::Arc;

/// What one thing is, and no other: a copy of the thing is another thing.
#[derive(Debug, Default)]
pub(crate) struct Identity(Arc<()>);

impl Clone for Identity {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// The identity of a thing that may be gone by now; no later thing has it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Known(Option<Arc<()>>);

impl Known {
    pub(crate) fn of(identity: &Identity) -> Self {
        Self(Some(identity.0.clone()))
    }

    pub(crate) fn is(&self, identity: &Identity) -> bool {
        self.0.as_ref().is_some_and(|known| Arc::ptr_eq(known, &identity.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thing_is_itself_and_its_copy_is_another() {
        let thing = Identity::default();
        let known = Known::of(&thing);
        assert!(known.is(&thing) && known.clone().is(&thing));
        assert!(!known.is(&thing.clone()) && !known.is(&Identity::default()) && !Known::default().is(&thing));
    }
}
