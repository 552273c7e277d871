//! What may be used together.

use std::sync::Arc;

/// The same for everything that may be used together: scenes, views and renderers of one device,
/// for which `wgpu` has no name that differs between its instances.
#[derive(Clone, Debug, Default)]
pub(crate) struct Owner(Arc<()>);

impl PartialEq for Owner {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}
