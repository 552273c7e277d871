//! A scene on a graphics device, with the materials of the last shot.

use std::sync::Arc;

use relight_format::{Material, Scene};
use relight_runtime::{Error, GpuScene};
use relight_shading::catcher;

use super::Shot;

pub(super) struct Uploaded {
    scene: Arc<Scene>,
    materials: Arc<Vec<Material>>,
    /// Whether materials may catch shadows.
    catches: bool,
    on_device: GpuScene,
}

impl Uploaded {
    /// Makes it the shot's: uploads another scene, which `uploads` counts, and sets the materials
    /// that are others.
    pub fn keep<'a>(
        kept: &'a mut Option<Self>,
        shot: &Shot,
        uploads: &mut u32,
        upload: impl FnOnce(&Scene) -> Result<GpuScene, Error>,
    ) -> Result<&'a GpuScene, Error> {
        let catches = catcher::catches(&shot.materials);
        let same =
            |kept: &Self| Arc::ptr_eq(&kept.scene, &shot.scene) && (kept.catches || !catches);
        // The old one goes first: two may not fit.
        let mut now = if let Some(known) = kept.take().filter(same) {
            known
        } else {
            *uploads += 1;
            let mut scene = shot.scene.clone();
            if catches {
                Arc::make_mut(&mut scene).materials = shot.materials.to_vec();
            }
            Self {
                materials: Arc::new(scene.materials.clone()),
                on_device: upload(&scene)?,
                scene: shot.scene.clone(),
                catches,
            }
        };
        if !Arc::ptr_eq(&now.materials, &shot.materials) {
            let changed = (now.materials.iter().zip(shot.materials.iter()).enumerate())
                .filter(|(_, (old, new))| old != new);
            for (index, (_, material)) in changed {
                now.on_device.set_material(index, material)?;
            }
            now.materials = shot.materials.clone();
        }
        Ok(&kept.insert(now).on_device)
    }
}
