//! A reflection model over a Lambertian base, as scene files and as the format have it. What its keys
//! are called is in its entry of [`REFLECTION_MODELS`].

use relight_format::{ModelParameters, REFLECTION_MODELS, ReflectionModel, Specular};
use serde::de::{DeserializeOwned, Error as _};
use serde::ser::SerializeMap as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use toml::Value;

use super::{Color, MaterialOverride, black};

/// A roughness or an exponent as given: once, or along tangent and bitangent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct AlongAxes {
    both: Option<f32>,
    x: Option<f32>,
    y: Option<f32>,
}

impl AlongAxes {
    /// The two numbers that it stands for, if it is given in one of the two ways.
    pub(super) fn pair(&self) -> Option<[f32; 2]> {
        match (self.both, self.x, self.y) {
            (Some(both), None, None) => Some([both; 2]),
            (None, Some(x), Some(y)) => Some([x, y]),
            _ => None,
        }
    }

    /// Which keys are given, for messages.
    pub(super) fn found(&self, name: &str) -> String {
        let given: Vec<_> = [("", self.both), ("_x", self.x), ("_y", self.y)]
            .into_iter()
            .filter_map(|(axis, value)| value.map(|_| format!("{name}{axis}")))
            .collect();
        if given.is_empty() {
            "none of them".to_owned()
        } else {
            given.join(" and ")
        }
    }
}

/// A reflection model over a Lambertian base. Values are not checked.
#[derive(Clone, Copy, Debug)]
pub struct Reflecting {
    pub(super) model: &'static ReflectionModel,
    pub(super) diffuse: Color,
    pub(super) color: Color,
    pub(super) roughness: AlongAxes,
}

impl PartialEq for Reflecting {
    fn eq(&self, other: &Self) -> bool {
        let values = |one: &Self| (one.diffuse, one.color, one.roughness);
        self.model.key == other.model.key && values(self) == values(other)
    }
}

impl Reflecting {
    fn specular(&self) -> Specular {
        self.model.reflection(ModelParameters {
            color: self.color.rgb(),
            roughness: self.roughness.pair().unwrap_or([1.0; 2]),
        })
    }

    /// Reads the keys of a model; the error is as `serde` says it.
    fn read(model: &'static ReflectionModel, table: &toml::Table) -> Result<Self, String> {
        let name = model.roughness_name;
        let axes = [name.to_owned(), format!("{name}_x"), format!("{name}_y")];
        let axes = &axes[..if model.anisotropic { 3 } else { 1 }];
        let mut known = vec!["model", "diffuse", model.color()];
        known.extend(axes.iter().map(String::as_str));
        if let Some(key) = table.keys().find(|key| !known.contains(&key.as_str())) {
            return Err(unknown("field", key, &known));
        }
        let axis = |index: usize| match axes.get(index) {
            Some(key) => value(table, key),
            None => Ok(None),
        };
        let [both, x, y] = [axis(0)?, axis(1)?, axis(2)?];
        if both.is_none() && !model.anisotropic {
            return Err(missing(name));
        }
        Ok(Self {
            model,
            diffuse: value(table, "diffuse")?.unwrap_or_else(black),
            color: value(table, model.color())?.ok_or_else(|| missing(model.color()))?,
            roughness: AlongAxes { both, x, y },
        })
    }
}

fn missing(key: &str) -> String {
    format!("missing field `{key}`")
}

fn unknown(what: &str, found: &str, known: &[&str]) -> String {
    format!(
        "unknown {what} `{found}`, expected one of `{}`",
        known.join("`, `")
    )
}

fn value<T: DeserializeOwned>(table: &toml::Table, key: &str) -> Result<Option<T>, String> {
    let value = table.get(key).cloned();
    let read = value.map(Value::try_into::<T>).transpose();
    read.map_err(|error| format!("{key}: {}", error.message()))
}

/// What `model` says of materials that are no reflection over a base.
const OTHERS: [&str; 4] = ["diffuse", "metallic-roughness", "measured", "layers"];

impl<'de> Deserialize<'de> for MaterialOverride {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let table = toml::Table::deserialize(deserializer)?;
        let key = match table.get("model") {
            Some(Value::String(key)) => key.as_str(),
            Some(other) => {
                let found = other.type_str();
                let message = format!("model: a value of type {found}, expected a string");
                return Err(D::Error::custom(message));
            }
            None => return Err(D::Error::missing_field("model")),
        };
        if let Some(model) = REFLECTION_MODELS.iter().find(|model| model.key == key) {
            let read = Reflecting::read(model, &table).map_err(D::Error::custom)?;
            return Ok(Self::Reflecting(read));
        }
        if !OTHERS.contains(&key) {
            let models = REFLECTION_MODELS.iter().map(|model| model.key);
            let known: Vec<_> = OTHERS.into_iter().chain(models).collect();
            return Err(D::Error::custom(unknown("model", key, &known)));
        }
        // Those that `serde` derived.
        let read = Self::deserialize(Value::Table(table));
        read.map_err(|error| D::Error::custom(error.message()))
    }
}

impl Serialize for MaterialOverride {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self::Reflecting(reflecting) = self else {
            return Self::serialize(self, serializer);
        };
        let Reflecting {
            model,
            diffuse,
            color,
            roughness: AlongAxes { both, x, y },
        } = reflecting;
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("model", model.key)?;
        map.serialize_entry("diffuse", diffuse)?;
        map.serialize_entry(model.color(), color)?;
        for (axis, value) in [("", both), ("_x", x), ("_y", y)] {
            if let Some(value) = value {
                map.serialize_entry(&format!("{}{axis}", model.roughness_name), value)?;
            }
        }
        map.end()
    }
}

impl MaterialOverride {
    /// The base and the reflection, if the material is a model over a base. Values are not checked.
    pub(crate) fn reflection(&self) -> Option<(Color, Specular)> {
        match self {
            Self::Diffuse { diffuse } => Some((*diffuse, Specular::None)),
            Self::Reflecting(reflecting) => Some((reflecting.diffuse, reflecting.specular())),
            Self::MetallicRoughness { .. } | Self::Measured { .. } | Self::Layers { .. } => None,
        }
    }

    /// The material of a base and what lies on it.
    pub fn over_base(diffuse: [f32; 3], specular: &Specular) -> Self {
        let diffuse = Color::Rgb(diffuse);
        if let Specular::Lobes { path, .. } = specular {
            return Self::Measured {
                file: path.into(),
                original: None,
            };
        }
        let Some((model, ModelParameters { color, roughness })) = specular.model() else {
            return Self::Diffuse { diffuse };
        };
        let [x, y] = roughness.map(Some);
        let (both, [x, y]) = if model.anisotropic {
            (None, [x, y])
        } else {
            (x, [None; 2])
        };
        Self::Reflecting(Reflecting {
            model,
            diffuse,
            color: Color::Rgb(color),
            roughness: AlongAxes { both, x, y },
        })
    }
}
