//! A body with a tree of oriented boxes that is kept up to date.

use trocar_scene::{BuildContext, Commands, ControllerError, Snapshot};

use super::bodies::{Body, Change, RequiredGeometry};
use crate::obb_tree::ObbTree;

/// A body and its tree, which is updated only when the body has changed.
pub struct TreeBody {
    pub body: Body,
    pub tree: ObbTree,
}

impl TreeBody {
    /// The body of that name.
    ///
    /// # Errors
    /// As [`Body::named`].
    pub fn named(context: &BuildContext<'_>, name: &str) -> Result<Self, ControllerError> {
        let body = Body::named(context, name, RequiredGeometry::Surface)?;
        let tree = ObbTree::build(&body.surface());
        Ok(Self { body, tree })
    }

    /// Reads it again: if only vertices have moved the boxes are refitted, else rebuilt.
    pub fn follow(&mut self, scene: &Snapshot, out: &mut Commands) -> Change {
        let change = self.body.follow(scene, out);
        let surface = self.body.surface();
        let is_fitted = match change {
            Change::None => true,
            Change::Deformed => self.tree.refit(surface.vertices()).is_ok(),
            Change::Absent => self.tree.is_empty(),
            Change::Remeshed => false,
        };
        if !is_fitted {
            self.tree = ObbTree::build(&surface);
        }
        change
    }
}
