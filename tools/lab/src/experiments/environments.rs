//! How well lobes fit environments, and how many of them it takes.

use rayon::prelude::*;
use relight_bake::environment::{self, FitOptions, hdr};

use super::Laboratory;
use super::report::{Section, Table};

/// Images in the folder of data.
const IMAGES: [(&str, &str); 12] = [
    ("grace", "debevec/grace_latlong.hdr"),
    ("stpeters", "debevec/stpeters_latlong.hdr"),
    ("park", "polyhaven/park.hdr"),
    ("studio", "polyhaven/studio.hdr"),
    ("lobby", "polyhaven/lobby.hdr"),
    ("night", "polyhaven/night.hdr"),
    ("apartment", "polyhaven/apartment.hdr"),
    ("ennis", "probulator/ennis_256.hdr"),
    ("pisa", "probulator/pisa_256.hdr"),
    ("uffizi", "probulator/uffizi_256.hdr"),
    ("wells", "probulator/wells_256.hdr"),
    ("envmap1", "physg/envmap1.exr"),
];
/// Lobes of the columns; a fit with more of them comes by each of these.
const LOBES: [usize; 5] = [8, 16, 32, 64, 128];
/// Lobes at which irradiance is shown.
const IRRADIANCE: [usize; 3] = [8, 32, 128];

pub fn run(laboratory: &mut Laboratory, section: &mut Section) -> anyhow::Result<()> {
    let most = LOBES[LOBES.len() - 1];
    section.text = vec![format!(
        "`bake environment --lobes {most}`, and what it comes by: `sources` is the number of suns, lamps \
         and windows that it takes out of the image first, all errors are of the rest. Columns of \
         numbers are the relative L2 error with so many lobes, weighted by solid angle; those of \
         irradiance the relative RMS error over 1,000 normals. The energy of the image is kept."
    )];
    let mut table = Table::new(
        "environments",
        "Errors against numbers of lobes",
        &[
            "image",
            "sources",
            "8 lobes",
            "16",
            "32",
            "64",
            "128",
            "irradiance, 8 lobes, %",
            "irradiance, 32, %",
            "irradiance, 128, %",
        ],
    );
    // Most of a fit is one thread's work.
    let fits = IMAGES.into_par_iter().map(|(name, path)| {
        let image = hdr::load(&laboratory.settings.data.join("env").join(path))?;
        let options = FitOptions::with_lobes(most);
        let fitted = environment::fit(&image, &options, laboratory.monitor)?;
        Ok((name, fitted))
    });
    for (name, fitted) in fits.collect::<anyhow::Result<Vec<_>>>()? {
        let rung = |lobes: usize| fitted.curve.iter().find(|rung| rung.allowed == lobes);
        let l2 = LOBES.map(|lobes| rung(lobes).map(|rung| f64::from(rung.relative_l2)));
        let irradiance = IRRADIANCE
            .map(|lobes| rung(lobes).map(|rung| 100.0 * f64::from(rung.irradiance_error)));
        let [l2_8, l2_16, l2_32, l2_64, l2_128] = l2.map(Into::into);
        let [few, some, many] = irradiance.map(Into::into);
        table.row([
            name.into(),
            fitted.environment.sources.len().into(),
            l2_8,
            l2_16,
            l2_32,
            l2_64,
            l2_128,
            few,
            some,
            many,
        ]);
    }
    section.tables.push(table);
    Ok(())
}
