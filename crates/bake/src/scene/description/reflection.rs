//! A reflection model over a Lambertian base, as scene files and as the format have it.

use relight_format::Specular;

use super::{Color, MaterialOverride};

/// A roughness or an exponent as given: once, or along tangent and bitangent.
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

impl MaterialOverride {
    /// The base and the reflection, if the material is a model over a base. Values are not checked.
    pub(crate) fn reflection(&self) -> Option<(Color, Specular)> {
        use MaterialOverride as M;
        let layered = |diffuse, specular| Some((diffuse, specular));
        let pair = self.roughness_along_axes();
        let pair = pair.and_then(|given| given.pair()).unwrap_or([1.0; 2]);
        match *self {
            M::Diffuse { diffuse } => layered(diffuse, Specular::None),
            M::BlinnPhong {
                diffuse,
                specular,
                exponent,
            } => layered(
                diffuse,
                Specular::BlinnPhong {
                    specular: specular.rgb(),
                    exponent,
                },
            ),
            M::Ward {
                diffuse, specular, ..
            } => layered(
                diffuse,
                Specular::Ward {
                    specular: specular.rgb(),
                    alpha: pair,
                },
            ),
            M::CookTorrance {
                diffuse,
                f0,
                roughness,
            } => layered(
                diffuse,
                Specular::CookTorrance {
                    f0: f0.rgb(),
                    roughness,
                },
            ),
            M::Ggx { diffuse, f0, .. } => layered(
                diffuse,
                Specular::Ggx {
                    f0: f0.rgb(),
                    alpha: pair,
                },
            ),
            M::AshikhminShirley { diffuse, f0, .. } => layered(
                diffuse,
                Specular::AshikhminShirley {
                    f0: f0.rgb(),
                    exponents: pair,
                },
            ),
            M::MetallicRoughness { .. } | M::Measured { .. } | M::Layers { .. } => None,
        }
    }

    /// The roughness of a model where it may differ along tangent and bitangent.
    pub(super) fn roughness_along_axes(&self) -> Option<AlongAxes> {
        use MaterialOverride as M;
        match *self {
            M::Ward {
                alpha: both,
                alpha_x: x,
                alpha_y: y,
                ..
            }
            | M::Ggx {
                alpha: both,
                alpha_x: x,
                alpha_y: y,
                ..
            }
            | M::AshikhminShirley {
                exponent: both,
                exponent_x: x,
                exponent_y: y,
                ..
            } => Some(AlongAxes { both, x, y }),
            _ => None,
        }
    }

    /// The material of a base and what lies on it.
    pub fn over_base(diffuse: [f32; 3], specular: &Specular) -> Self {
        let diffuse = Color::Rgb(diffuse);
        match specular {
            Specular::None => Self::Diffuse { diffuse },
            Specular::BlinnPhong { specular, exponent } => Self::BlinnPhong {
                diffuse,
                specular: Color::Rgb(*specular),
                exponent: *exponent,
            },
            Specular::Ward {
                specular,
                alpha: [x, y],
            } => Self::Ward {
                diffuse,
                specular: Color::Rgb(*specular),
                alpha: None,
                alpha_x: Some(*x),
                alpha_y: Some(*y),
            },
            Specular::CookTorrance { f0, roughness } => Self::CookTorrance {
                diffuse,
                f0: Color::Rgb(*f0),
                roughness: *roughness,
            },
            Specular::Ggx { f0, alpha: [x, y] } => Self::Ggx {
                diffuse,
                f0: Color::Rgb(*f0),
                alpha: None,
                alpha_x: Some(*x),
                alpha_y: Some(*y),
            },
            Specular::AshikhminShirley {
                f0,
                exponents: [x, y],
            } => Self::AshikhminShirley {
                diffuse,
                f0: Color::Rgb(*f0),
                exponent: None,
                exponent_x: Some(*x),
                exponent_y: Some(*y),
            },
            Specular::Lobes { path, .. } => Self::Measured {
                file: path.into(),
                original: None,
            },
        }
    }
}
