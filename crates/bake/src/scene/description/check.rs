//! Whether the numbers of a scene file are in their ranges.

use std::path::Path;

use relight_format as format;

use super::{
    BlendName, Camera, Color, Error, Ground, LayerFile, Light, MaterialOverride, Reflecting,
    Transform,
};

/// Range checks whose errors name the file.
pub(super) struct Checker<'a> {
    pub(super) path: &'a Path,
}

impl Checker<'_> {
    pub(super) fn require(
        &self,
        holds: bool,
        place: &str,
        expected: &str,
        found: impl std::fmt::Debug,
    ) -> Result<(), Error> {
        if holds {
            Ok(())
        } else {
            Err(Error::invalid(
                self.path,
                place,
                expected,
                format_args!("{found:?}"),
            ))
        }
    }

    pub(super) fn positive(&self, place: &str, value: f32) -> Result<(), Error> {
        self.require(
            value > 0.0 && value.is_finite(),
            place,
            "a number above 0",
            value,
        )
    }

    pub(super) fn finite(&self, place: &str, values: &[f32]) -> Result<(), Error> {
        self.require(
            values.iter().all(|x| x.is_finite()),
            place,
            "finite numbers",
            values,
        )
    }

    pub(super) fn nonzero(&self, place: &str, vector: [f32; 3]) -> Result<(), Error> {
        let normalizable = glam::Vec3::from(vector).try_normalize().is_some();
        self.require(normalizable, place, "a vector other than zero", vector)
    }

    pub(super) fn transform(&self, transform: &Transform) -> Result<(), Error> {
        self.positive("transform.scale", transform.scale)?;
        self.nonzero("transform.rotation_axis", transform.rotation_axis)?;
        self.finite("transform.rotation_degrees", &[transform.rotation_degrees])?;
        self.finite("transform.translation", &transform.translation)
    }

    pub(super) fn ground(&self, ground: &Ground) -> Result<(), Error> {
        for (place, value) in [
            ("ground.size", ground.size),
            ("ground.spacing", ground.spacing),
        ] {
            value.map_or(Ok(()), |value| self.positive(place, value))?;
        }
        self.finite("ground.height", ground.height.as_slice())?;
        self.finite(
            "ground.center",
            ground.center.as_ref().map_or(&[], |center| center),
        )?;
        ground.material.as_ref().map_or(Ok(()), |material| {
            self.material("ground.material", material)
        })
    }

    pub(super) fn camera(&self, camera: &Camera) -> Result<(), Error> {
        let angles = [camera.fov_x_degrees, camera.fov_y_degrees];
        self.require(
            angles.iter().flatten().count() == 1,
            "camera",
            "one of fov_x_degrees and fov_y_degrees",
            format_args!("{} of them", angles.iter().flatten().count()),
        )?;
        let in_range = angles
            .into_iter()
            .flatten()
            .all(|angle| angle > 0.0 && angle < 180.0);
        self.require(
            in_range,
            "camera",
            "a field of view above 0 and below 180",
            angles,
        )?;
        self.finite("camera.position", &camera.position)?;
        self.finite("camera.target", &camera.target)?;
        let [position, target, up] =
            [camera.position, camera.target, camera.up].map(glam::Vec3::from);
        self.nonzero(
            "camera.target minus camera.position",
            (target - position).into(),
        )?;
        self.nonzero("camera.up", up.into())?;
        self.nonzero(
            "camera.up across the viewing direction",
            (target - position).normalize().cross(up.normalize()).into(),
        )
    }

    fn layer(&self, place: &str, layer: &LayerFile) -> Result<(), Error> {
        use MaterialOverride as M;
        let plain = !matches!(
            *layer.material,
            M::Layers { .. } | M::MetallicRoughness { .. }
        );
        self.require(
            plain,
            &format!("{place}.material"),
            "a model other than layers and metallic-roughness",
            "one of them",
        )?;
        self.material(&format!("{place}.material"), &layer.material)?;
        self.require(
            layer.blend != BlendName::Coat || !matches!(*layer.material, M::Diffuse { .. }),
            &format!("{place}.blend"),
            "over, or a coat of a material that reflects",
            "a coat of a diffuse material",
        )?;
        self.require(
            (0.0..=1.0).contains(&layer.weight),
            &format!("{place}.weight"),
            "a number in [0, 1]",
            layer.weight,
        )?;
        self.require(
            layer.roughness_texture.is_none() || layer.glossiness_texture.is_none(),
            place,
            "one of roughness_texture and glossiness_texture",
            "both",
        )
    }

    pub(super) fn light(&self, place: &str, light: &Light) -> Result<(), Error> {
        self.finite(&format!("{place}.position"), &light.position)?;
        self.positive(&format!("{place}.radius"), light.radius)?;
        let radiance = light.radiance.rgb();
        self.require(
            radiance.iter().all(|x| *x >= 0.0 && x.is_finite()),
            &format!("{place}.radiance"),
            "numbers of at least 0",
            radiance,
        )?;
        match (light.direction, light.inner_degrees, light.outer_degrees) {
            (None, None, None) => Ok(()),
            (Some(direction), Some(inner), Some(outer)) => {
                self.nonzero(&format!("{place}.direction"), direction)?;
                self.require(
                    0.0 <= inner && inner < outer && outer <= 90.0,
                    &format!("{place}.outer_degrees"),
                    "0 <= inner_degrees < outer_degrees <= 90",
                    (inner, outer),
                )
            }
            parts => self.require(
                false,
                place,
                "all of direction, inner_degrees and outer_degrees, or none",
                parts,
            ),
        }
    }

    fn reflectance(&self, place: &str, rgb: [f32; 3]) -> Result<(), Error> {
        let valid = rgb.iter().all(|x| (0.0..=1.0).contains(x));
        self.require(valid, place, "reflectances in [0, 1]", rgb)
    }

    pub(super) fn material(&self, place: &str, material: &MaterialOverride) -> Result<(), Error> {
        use MaterialOverride as M;
        let at = |key: &str| format!("{place}.{key}");
        let unit = |key: &str, value: f32| {
            self.require(
                (0.0..=1.0).contains(&value),
                &at(key),
                "a number in [0, 1]",
                value,
            )
        };
        let color = |key: &str, value: Color| self.reflectance(&at(key), value.rgb());
        match *material {
            M::Diffuse { diffuse } => color("diffuse", diffuse),
            M::Reflecting(ref reflecting) => self.reflection(place, reflecting),
            M::MetallicRoughness {
                base_color,
                metallic,
                roughness: perceptual,
                anisotropy_strength,
                anisotropy_rotation_degrees,
            } => {
                color("base_color", base_color)?;
                unit("metallic", metallic)?;
                unit("roughness", perceptual)?;
                unit("anisotropy_strength", anisotropy_strength)?;
                let rotation = [anisotropy_rotation_degrees];
                self.finite(&at("anisotropy_rotation_degrees"), &rotation)
            }
            M::Layers {
                ref layers,
                normal_scale,
                ..
            } => {
                self.finite(&at("normal_scale"), &[normal_scale])?;
                let count = layers.len();
                let most = format::MAX_LAYERS;
                self.require(
                    (1..=most).contains(&count),
                    &at("layers"),
                    &format!("1 to {most} layers"),
                    count,
                )?;
                layers.iter().enumerate().try_for_each(|(index, layer)| {
                    self.layer(&format!("{place}.layers[{index}]"), layer)
                })
            }
            M::Measured { .. } => Ok(()),
        }
    }

    /// A base and what lies on it, by its model's entry of [`format::REFLECTION_MODELS`].
    fn reflection(&self, place: &str, reflecting: &Reflecting) -> Result<(), Error> {
        let Reflecting {
            model,
            diffuse,
            color,
            roughness,
        } = reflecting;
        self.reflectance(&format!("{place}.diffuse"), diffuse.rgb())?;
        self.reflectance(&format!("{place}.{}", model.color()), color.rgb())?;
        let name = model.roughness_name;
        let pair = roughness.pair();
        self.require(
            pair.is_some(),
            place,
            &format!("{name}, or {name}_x and {name}_y"),
            format_args!("{}", roughness.found(name)),
        )?;
        let place = format!("{place}.{name}");
        let expected = model.roughness.to_string();
        (pair.iter().flatten()).try_for_each(|&value| {
            self.require(model.roughness.contains(value), &place, &expected, value)
        })
    }
}
