//! What a page's workers run: fits, which take seconds.

use std::sync::atomic::AtomicBool;

use js_sys::{Function, Uint8Array, Uint32Array};
use relight_bake::environment;
use relight_bake::environment::hdr::{self, Reading};
use relight_bake::measured::{Table, fit};
use relight_bake::monitor::{Monitor, Progress};
use relight_format::{self as format, MaterialAsset, MaterialReport, TextureSlot};
use send_wrapper::SendWrapper;
use wasm_bindgen::prelude::wasm_bindgen;
use wasm_bindgen::{JsError, JsValue};

use crate::jobs::{fit_options, fit_stages_to, panorama_of};

static NEVER: AtomicBool = AtomicBool::new(false);

fn failed(error: impl std::fmt::Display) -> JsError {
    JsError::new(&error.to_string())
}

/// Fits an image with few lobes, then with all of them. Calls `report(stage, fraction)` often, and
/// `deliver(asset, texels)` after each of the two, the second time with those of its [`Panorama`].
#[wasm_bindgen]
pub fn fit_light(
    bytes: &[u8],
    name: &str,
    lobes: usize,
    report: Function,
    deliver: &Function,
) -> Result<(), JsError> {
    let image = hdr::parse(bytes, &Reading::default()).map_err(failed)?;
    // Workers have one thread.
    let report = SendWrapper::new(report);
    let tell = |Progress { stage, fraction }: Progress| {
        // Nobody may listen any more.
        let _ = report.call2(&JsValue::NULL, &stage.into(), &fraction.into());
    };
    let monitor = Monitor {
        report: &tell,
        stop: &NEVER,
    };
    let stages = fit_stages_to(lobes);
    for (index, lobes) in stages.iter().copied().enumerate() {
        let options = fit_options(lobes);
        let fitted = environment::fit(&image, &options, monitor).map_err(failed)?;
        let mut fitted = fitted.environment;
        name.clone_into(&mut fitted.report.source);
        let asset = format::write_environment(&fitted).map_err(failed)?;
        let panorama = panorama_of(&image, index, &stages);
        let texels = panorama
            .as_ref()
            .map_or(&[][..], |image| image.levels().texels());
        let _ = deliver.call2(
            &JsValue::NULL,
            &Uint8Array::from(&asset[..]),
            &Uint32Array::from(texels),
        );
    }
    Ok(())
}

/// Fits a measured BRDF and returns a material asset.
#[wasm_bindgen]
pub fn fit_material(bytes: &[u8], name: &str) -> Result<Vec<u8>, JsError> {
    let table = Table::parse(bytes).map_err(failed)?;
    let fitted = fit::corrected(&table, fit::Stop::default());
    let slot = TextureSlot::whole(0);
    let surface = fitted.fit.surface(name.to_owned(), Some(slot));
    let asset = MaterialAsset {
        report: MaterialReport {
            source: name.to_owned(),
            relative_l2: fitted.fit.relative_l2 as f32,
            shaded_relative_l2: fitted.fit.shaded_relative_l2 as f32,
            albedo_error: fitted.fit.albedo_error as f32,
            corrected_relative_l2: fitted.relative_l2 as f32,
        },
        material: format::plain_material(name, surface),
        textures: vec![fitted.ratio],
    };
    format::write_material(&asset).map_err(failed)
}
