//! Object identities, so that cached data of one object is never used for another.

use std::sync::Arc;

/// Identity of an object; a copy of the object gets a new identity.
#[derive(Debug, Default)]
pub(crate) struct Identity(Arc<()>);

impl Clone for Identity {
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Remembered identity of an object that may no longer exist; it is never reused.
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
