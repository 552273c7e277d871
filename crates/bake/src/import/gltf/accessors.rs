//! Accessors, sparse ones included, and buffer views -> numbers, every index checked.

use gltf::json::accessor::{ComponentType, IndexComponentType, Type};
use gltf::json::buffer::View;
use gltf::json::validation::{Checked, USize64};
use gltf::json::{Accessor, Index};
use serde::Deserialize as _;

use super::super::Error;
use super::Document;

impl Document<'_> {
    /// POSITION's min and max are not used, but a file that gives them wrong is broken.
    pub(super) fn check_bounds(&self, index: Index<Accessor>, place: &str) -> Result<(), Error> {
        let accessor = self.get(index, place)?;
        for (name, bound) in [("min", &accessor.min), ("max", &accessor.max)] {
            if let Some(value) = bound
                && <[f32; 3]>::deserialize(value).is_err()
            {
                let place = format!("accessors[{}].{name}", index.value());
                return Err(self.invalid(place, "three numbers", value));
            }
        }
        Ok(())
    }

    pub(super) fn indices(
        &self,
        index: Index<Accessor>,
        place: &str,
        vertices: usize,
    ) -> Result<Vec<u32>, Error> {
        let indices = self.elements(index, place, Type::Scalar, |component, _, bytes| {
            Some(match component {
                ComponentType::U8 => u32::from(bytes[0]),
                ComponentType::U16 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
                ComponentType::U32 => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
                _ => return None,
            })
        })?;
        match indices.iter().position(|&index| index as usize >= vertices) {
            None => Ok(indices),
            Some(at) => Err(self.invalid(
                place,
                format_args!("indices below {vertices}"),
                format_args!("{} at element {at}", indices[at]),
            )),
        }
    }

    /// Reads finite vectors of any component type, normalised or not.
    pub(super) fn floats<const N: usize>(
        &self,
        index: Index<Accessor>,
        place: &str,
    ) -> Result<Vec<[f32; N]>, Error> {
        let values = self.any_floats(index, place)?;
        match values
            .iter()
            .position(|value: &[f32; N]| !value.iter().all(|x| x.is_finite()))
        {
            None => Ok(values),
            Some(at) => Err(self.invalid(
                place,
                "finite numbers",
                format_args!("{:?} at element {at}", values[at]),
            )),
        }
    }

    /// Reads vectors of any component type, normalised or not, whose numbers may be infinite or none.
    pub(super) fn any_floats<const N: usize>(
        &self,
        index: Index<Accessor>,
        place: &str,
    ) -> Result<Vec<[f32; N]>, Error> {
        let kind = [Type::Scalar, Type::Vec2, Type::Vec3, Type::Vec4][N - 1];
        self.elements(index, place, kind, |component, normalized, bytes| {
            let size = component.size();
            Some(std::array::from_fn(|i| {
                component_value(component, normalized, &bytes[i * size..(i + 1) * size])
            }))
        })
    }

    /// Reads colours of three or four numbers, without their alpha.
    pub(super) fn colors(
        &self,
        index: Index<Accessor>,
        place: &str,
    ) -> Result<Vec<[f32; 3]>, Error> {
        if self.get(index, place)?.type_ == Checked::Valid(Type::Vec3) {
            return self.floats::<3>(index, place);
        }
        let colors = self.floats::<4>(index, place)?;
        Ok(colors.into_iter().map(|[r, g, b, _]| [r, g, b]).collect())
    }

    /// Decodes the elements of an accessor, sparse ones included. `decode` gets as many bytes
    /// as one element has, and returns `None` for a component type that is not allowed.
    fn elements<T: Copy>(
        &self,
        index: Index<Accessor>,
        place: &str,
        kind: Type,
        decode: impl Fn(ComponentType, bool, &[u8]) -> Option<T>,
    ) -> Result<Vec<T>, Error> {
        let accessor = self.get(index, place)?;
        let place = format!("{place} (accessors[{}])", index.value());
        let wrong_type = || {
            self.invalid(
                &place,
                format_args!("type {kind:?} of an allowed component type"),
                format_args!("{:?} of {:?}", accessor.type_, accessor.component_type),
            )
        };
        let Checked::Valid(component) = accessor.component_type else {
            return Err(wrong_type());
        };
        let component = component.0;
        if accessor.type_ != Checked::Valid(kind) {
            return Err(wrong_type());
        }
        let size = component.size() * kind.multiplicity();
        let count = usize::try_from(accessor.count.0).unwrap_or(usize::MAX);
        // Three corners of each of the most triangles.
        let most = self.files.max_vertices() * 3;
        if !(1..=most).contains(&count) {
            let expected = format!("1 to {most} elements (--limit-vertices)");
            return Err(self.invalid(&place, expected, count));
        }
        let decode_all = |bytes: &[u8], stride: usize, count: usize| -> Result<Vec<T>, Error> {
            let element =
                |i: usize| decode(component, accessor.normalized, &bytes[i * stride..][..size]);
            (0..count)
                .map(|i| element(i).ok_or_else(wrong_type))
                .collect()
        };
        let mut values = match accessor.buffer_view {
            Some(view) => {
                let (bytes, stride) = self.span(view, accessor.byte_offset, count, size, &place)?;
                decode_all(bytes, stride, count)?
            }
            None => vec![decode(component, false, &[0; 16][..size]).ok_or_else(wrong_type)?; count],
        };
        let Some(sparse) = &accessor.sparse else {
            return Ok(values);
        };
        let place = format!("{place}.sparse");
        let changed = usize::try_from(sparse.count.0).unwrap_or(usize::MAX);
        if !(1..=count).contains(&changed) {
            return Err(self.invalid(&place, format_args!("1 to {count} elements"), changed));
        }
        let Checked::Valid(IndexComponentType(index_type)) = sparse.indices.component_type else {
            return Err(self.invalid(&place, "an unsigned index type", "another"));
        };
        let index_size = index_type.size();
        let offset = Some(sparse.indices.byte_offset);
        let (index_bytes, index_stride) = self.span(
            sparse.indices.buffer_view,
            offset,
            changed,
            index_size,
            &place,
        )?;
        let offset = Some(sparse.values.byte_offset);
        let (value_bytes, value_stride) =
            self.span(sparse.values.buffer_view, offset, changed, size, &place)?;
        for (i, value) in decode_all(value_bytes, value_stride, changed)?
            .into_iter()
            .enumerate()
        {
            let mut word = [0; 4];
            word[..index_size].copy_from_slice(&index_bytes[i * index_stride..][..index_size]);
            let target = u32::from_le_bytes(word) as usize;
            *values.get_mut(target).ok_or_else(|| {
                self.invalid(&place, format_args!("indices below {count}"), target)
            })? = value;
        }
        Ok(values)
    }

    /// The bytes of `count` elements of `size` bytes in a buffer view, and their stride.
    fn span(
        &self,
        view: Index<View>,
        offset: Option<USize64>,
        count: usize,
        size: usize,
        place: &str,
    ) -> Result<(&[u8], usize), Error> {
        let bytes = self.view(view, place)?;
        let stride = self
            .get(view, place)?
            .byte_stride
            .map_or(size, |stride| stride.0);
        if stride < size {
            let expected = format!("a stride of at least {size} bytes");
            return Err(self.invalid(format_args!("bufferViews[{view}]"), expected, stride));
        }
        let length = stride.saturating_mul(count - 1).saturating_add(size);
        let start = usize::try_from(offset.unwrap_or_default().0).unwrap_or(usize::MAX);
        let span = bytes
            .get(start..start.saturating_add(length))
            .ok_or_else(|| {
                self.invalid(
                    place,
                    format_args!("{length} bytes from byte {start} of bufferViews[{view}]"),
                    format_args!("{} bytes in all", bytes.len()),
                )
            })?;
        Ok((span, stride))
    }

    pub(super) fn view(&self, index: Index<View>, place: &str) -> Result<&[u8], Error> {
        let view = self.get(index, place)?;
        let place = format!("bufferViews[{index}]");
        self.get(view.buffer, &place)?;
        let buffer = &self.buffers[view.buffer.value()];
        let offset = view.byte_offset.unwrap_or_default().0;
        let range = usize::try_from(offset)
            .ok()
            .zip(usize::try_from(offset.saturating_add(view.byte_length.0)).ok());
        range
            .and_then(|(start, end)| buffer.get(start..end))
            .ok_or_else(|| {
                self.invalid(
                    place,
                    format_args!("a range inside the buffer's {} bytes", buffer.len()),
                    format_args!("{} bytes from byte {offset}", view.byte_length.0),
                )
            })
    }
}

fn component_value(component: ComponentType, normalized: bool, bytes: &[u8]) -> f32 {
    let scaled = |value: f32, largest: f32| {
        if normalized {
            (value / largest).max(-1.0)
        } else {
            value
        }
    };
    let pair = || [bytes[0], bytes[1]];
    let word = || [bytes[0], bytes[1], bytes[2], bytes[3]];
    match component {
        ComponentType::I8 => scaled(f32::from(bytes[0] as i8), 127.0),
        ComponentType::U8 => scaled(f32::from(bytes[0]), 255.0),
        ComponentType::I16 => scaled(f32::from(i16::from_le_bytes(pair())), 32767.0),
        ComponentType::U16 => scaled(f32::from(u16::from_le_bytes(pair())), 65535.0),
        ComponentType::U32 => scaled(u32::from_le_bytes(word()) as f32, u32::MAX as f32),
        ComponentType::F32 => f32::from_le_bytes(word()),
    }
}
