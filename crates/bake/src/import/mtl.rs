//! Material libraries of OBJ files.
//!
//! Our own parser; ARCHITECTURE.md says why it is not `tobj`.

use std::collections::BTreeMap;
use std::path::Path;

use super::Error;

/// One material, as far as it can be represented.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct MtlMaterial {
    /// `Kd`.
    pub diffuse: Option<[f32; 3]>,
    /// `Ks`.
    pub specular: Option<[f32; 3]>,
    /// `Ke`, radiance.
    pub emission: Option<[f32; 3]>,
    /// `Ns`.
    pub exponent: Option<f32>,
    /// `Pr`.
    pub roughness: Option<f32>,
    /// `Pm`.
    pub metallic: Option<f32>,
    /// `illum`.
    pub(crate) illumination: Option<u32>,
    /// `map_Kd`.
    pub(crate) diffuse_map: Option<Map>,
    /// `map_Ke`.
    pub(crate) emission_map: Option<Map>,
    /// `norm`.
    pub(crate) normal_map: Option<Map>,
    /// `map_bump` or `bump`: a height map, or often a normal map.
    pub(crate) bump_map: Option<Map>,
    /// `d`, or 1 less `Tr`.
    pub opacity: Option<f32>,
    /// `map_d`: opacity.
    pub(crate) opacity_map: Option<Map>,
    /// Keys of maps that are left out.
    pub(crate) ignored_maps: Vec<String>,
}

/// A texture reference.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Map {
    /// File name, as written.
    pub file: String,
    /// `-o`: offset of (u, v), v up.
    pub offset: [f32; 2],
    /// `-s`: scale of (u, v).
    pub scale: [f32; 2],
    /// `-clamp on`.
    pub clamp: bool,
}

/// Parses a material library.
pub(super) fn parse(file: &Path, text: &str) -> Result<BTreeMap<String, MtlMaterial>, Error> {
    let mut materials = BTreeMap::new();
    let mut current: Option<&mut MtlMaterial> = None;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        if key == "newmtl" {
            current = Some(materials.entry(rest.to_owned()).or_default());
            continue;
        }
        // Statements before the first material belong to none.
        let Some(material) = current.as_deref_mut() else {
            continue;
        };
        let wrong = |expected: &str| {
            Error::invalid(
                file,
                format_args!("line {}", number + 1),
                expected,
                format_args!("{line:?}"),
            )
        };
        let number = || {
            let value = rest
                .split_whitespace()
                .next()
                .and_then(|word| word.parse::<f32>().ok());
            value
                .filter(|value| value.is_finite())
                .ok_or_else(|| wrong("a finite number"))
        };
        let color = || {
            if rest.starts_with("spectral") || rest.starts_with("xyz") {
                return Ok(None);
            }
            let values: Result<Vec<f32>, _> = rest.split_whitespace().map(str::parse).collect();
            match values.as_deref() {
                Ok(&[grey]) if grey.is_finite() => Ok(Some([grey; 3])),
                Ok(&[r, g, b]) if (r + g + b).is_finite() => Ok(Some([r, g, b])),
                _ => Err(wrong("one or three finite numbers")),
            }
        };
        match key {
            "Kd" => material.diffuse = color()?,
            "Ks" => material.specular = color()?,
            "Ke" => material.emission = color()?,
            "Ns" => material.exponent = Some(number()?),
            "Pr" => material.roughness = Some(number()?),
            "Pm" => material.metallic = Some(number()?),
            "illum" => material.illumination = Some(number()? as u32),
            // A halo factor may stand between the key and the number.
            "d" => {
                let text = rest.strip_prefix("-halo").unwrap_or(rest).trim();
                let value = text.parse().ok().filter(|value: &f32| value.is_finite());
                material.opacity = Some(value.ok_or_else(|| wrong("a finite number"))?);
            }
            "Tr" => material.opacity = Some(1.0 - number()?),
            "map_d" => material.opacity_map = map(rest),
            "map_Kd" => material.diffuse_map = map(rest),
            "map_Ke" => material.emission_map = map(rest),
            "norm" => material.normal_map = map(rest),
            "map_bump" | "map_Bump" | "bump" => material.bump_map = map(rest),
            _ if key.starts_with("map_") || key == "disp" || key == "decal" || key == "refl" => {
                material.ignored_maps.push(key.to_owned());
            }
            // Colours of transmission and sheen, index of refraction.
            _ => {}
        }
    }
    Ok(materials)
}

/// Splits options from a file name, which may hold spaces.
fn map(text: &str) -> Option<Map> {
    let mut map = Map {
        file: String::new(),
        offset: [0.0; 2],
        scale: [1.0; 2],
        clamp: false,
    };
    let mut rest = text.trim();
    while rest.starts_with('-') {
        let (option, after) = rest.split_once(char::is_whitespace)?;
        rest = after.trim_start();
        // Numbers an option takes at most; those of one to three are optional after the first.
        let arity = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        for index in 0..arity {
            let (word, after) = rest.split_once(char::is_whitespace)?;
            let value = word.parse::<f32>();
            map.clamp |= option == "-clamp" && word == "on";
            if index > 0 && value.is_err() {
                break;
            }
            rest = after.trim_start();
            let target = match option {
                "-o" => map.offset.get_mut(index),
                "-s" => map.scale.get_mut(index),
                _ => None,
            };
            if let (Some(target), Ok(value)) = (target, value) {
                *target = value;
            }
        }
    }
    let finite = [map.offset, map.scale]
        .iter()
        .flatten()
        .all(|value| value.is_finite());
    if rest.is_empty() || !finite {
        return None;
    }
    map.file = rest.replace('\\', "/");
    Some(map)
}
