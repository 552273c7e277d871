//! A reflection model over a Lambertian base, as scene files and as the format have it.

use relight_format::Specular;

use super::{Color, MaterialOverride, alpha_pair};

impl MaterialOverride {
    /// The base and the reflection, if the material is a model over a base. Values are not checked.
    pub fn reflection(&self) -> Option<(Color, Specular)> {
        use MaterialOverride as M;
        let layered = |diffuse, specular| Some((diffuse, specular));
        let pair = |alpha, x, y| alpha_pair(alpha, x, y).unwrap_or([1.0; 2]);
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
                diffuse,
                specular,
                alpha,
                alpha_x,
                alpha_y,
            } => {
                let alpha = pair(alpha, alpha_x, alpha_y);
                layered(
                    diffuse,
                    Specular::Ward {
                        specular: specular.rgb(),
                        alpha,
                    },
                )
            }
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
            M::Ggx {
                diffuse,
                f0,
                alpha,
                alpha_x,
                alpha_y,
            } => {
                let alpha = pair(alpha, alpha_x, alpha_y);
                layered(
                    diffuse,
                    Specular::Ggx {
                        f0: f0.rgb(),
                        alpha,
                    },
                )
            }
            M::AshikhminShirley {
                diffuse,
                f0,
                exponent,
                exponent_x,
                exponent_y,
            } => {
                let exponents = pair(exponent, exponent_x, exponent_y);
                layered(
                    diffuse,
                    Specular::AshikhminShirley {
                        f0: f0.rgb(),
                        exponents,
                    },
                )
            }
            M::MetallicRoughness { .. } | M::Measured { .. } | M::Layers { .. } => None,
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
