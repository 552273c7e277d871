//! Vector instructions, and results that do not depend on them.
//!
//! Every processor gives the same bytes: sums are formed in one order whatever the width,
//! and a product that is added is either always fused ([`pulp::Simd::mul_add_f32s`],
//! `f32::mul_add`) or never. Products of matrices that fill registers go through `product`,
//! as those of `nalgebra` round as the processor's widest instructions do.
//!
//! `RELIGHT_SIMD` chooses other instructions than the widest there are, for tests: `plain`,
//! `avx2` or `avx512`.

use std::sync::OnceLock;

use nalgebra::DMatrix;
use pulp::{Arch, Simd, WithSimd};

use crate::memory;

/// The environment variable.
pub const VARIABLE: &str = "RELIGHT_SIMD";

/// What this process uses.
pub(crate) fn arch() -> Arch {
    static ARCH: OnceLock<Arch> = OnceLock::new();
    *ARCH.get_or_init(|| chosen().unwrap_or_default())
}

/// Runs a block, compiled for the widest vectors, with the variables that it names.
///
/// Not a closure given to [`Arch::dispatch`]: that is compiled for any processor unless it is so small that the compiler
/// puts it where it is called.
macro_rules! vectorised {
    (<$of:lifetime> $($name:ident: $type:ty = $value:expr),+ => $output:ty $body:block) => {{
        struct Run<$of> {
            $($name: $type),+
        }
        impl<$of> pulp::WithSimd for Run<$of> {
            type Output = $output;

            #[inline(always)]
            fn with_simd<S: pulp::Simd>(self, _: S) -> $output {
                let Self { $($name),+ } = self;
                $body
            }
        }
        $crate::simd::arch().dispatch(Run { $($name: $value),+ })
    }};
}
pub(crate) use vectorised;

/// Adds values times a factor to sums, as many as there are of both.
pub(crate) fn add_scaled(sums: &mut [f32], values: &[f32], factor: f32) {
    vectorised!(
        <'a> sums: &'a mut [f32] = sums, values: &'a [f32] = values, factor: f32 = factor
        => () {
            for (sum, x) in sums.iter_mut().zip(values) {
                *sum += factor * x;
            }
        }
    );
}

/// What [`VARIABLE`] asks for, or the widest; what is there instead if this processor or
/// build has no such instructions.
pub fn chosen() -> Result<Arch, String> {
    let Some(name) = std::env::var_os(VARIABLE).filter(|name| !name.is_empty()) else {
        return Ok(Arch::new());
    };
    let name = name.to_string_lossy().into_owned();
    by_name(&name).ok_or(name)
}

/// Instructions by the name that [`VARIABLE`] has for them.
pub fn by_name(name: &str) -> Option<Arch> {
    match name {
        "plain" => Some(Arch::Scalar),
        #[cfg(target_arch = "x86_64")]
        "avx2" => pulp::x86::V3::try_new().map(Arch::V3),
        #[cfg(target_arch = "x86_64")]
        "avx512" => pulp::x86::V4::try_new().map(Arch::V4),
        _ => None,
    }
}

/// Numbers of `product`.
pub trait Number: nalgebra::Scalar + Copy + num::Number {}
impl Number for f32 {}
impl Number for f64 {}

/// The product of two matrices. Every element is a sum over blocks of `INNER` fused products, in
/// order.
///
/// # Panics
///
/// If the columns of the first are not as many as the rows of the second.
pub(crate) fn product<T: Number>(a: &DMatrix<T>, b: &DMatrix<T>) -> DMatrix<T> {
    product_by(arch(), &Of(a), b)
}

/// The same of a matrix as products read it.
///
/// # Panics
///
/// As [`product`].
pub(crate) fn product_of(a: &Panels, b: &DMatrix<f32>) -> DMatrix<f32> {
    product_by(arch(), a, b)
}

fn product_by<T: Number>(arch: Arch, a: &impl Rows<T>, b: &DMatrix<T>) -> DMatrix<T> {
    let mut product = vec![T::ZERO; a.shape().0 * b.ncols()];
    write_product_by(arch, a, b, &mut product);
    DMatrix::from_vec(a.shape().0, b.ncols(), product)
}

/// Writes the product of two matrices to `product`, column after column, whatever was there.
///
/// # Panics
///
/// If the columns of the first are not as many as the rows of the second, or `product` has not as many numbers as theirs.
pub(crate) fn write_product<T: Number>(a: &impl Rows<T>, b: &DMatrix<T>, product: &mut [T]) {
    write_product_by(arch(), a, b, product);
}

/// Products that are summed before they are added to those before.
const INNER: usize = 256;
/// Columns of the second matrix that are multiplied at a time.
const COLUMNS: usize = 6;
/// Vectors of rows that are multiplied at a time: with [`COLUMNS`], as many sums as registers hold.
const VECTORS: usize = 2;

/// The first factor of a product.
pub(crate) trait Rows<T: Number> {
    /// Rows and columns.
    fn shape(&self) -> (usize, usize);

    /// [`num::Number::PANEL`] rows from `first` on, or those that are left, side by side, column after column, in
    /// `room` unless they lie so already. What is beyond them in each column is not looked at.
    fn panel<'a>(&'a self, first: usize, room: &'a mut Vec<T>) -> &'a [T];
}

/// A matrix.
pub(crate) struct Of<'a, T>(pub &'a DMatrix<T>);

impl<T: Number> Rows<T> for Of<'_, T> {
    fn shape(&self) -> (usize, usize) {
        self.0.shape()
    }

    fn panel<'a>(&'a self, first: usize, room: &'a mut Vec<T>) -> &'a [T] {
        let (rows, columns) = self.0.shape();
        let count = T::PANEL.min(rows - first);
        room.resize(columns * T::PANEL, T::ZERO);
        let packed = room.chunks_exact_mut(T::PANEL);
        for (packed, column) in packed.zip(self.0.as_slice().chunks_exact(rows)) {
            packed[..count].copy_from_slice(&column[first..first + count]);
        }
        room
    }
}

/// A matrix as products read their first factor, panel after panel of rows.
pub(crate) struct Panels {
    shape: (usize, usize),
    values: Vec<f32>,
}

/// Rows of a panel.
const PANEL: usize = <f32 as num::Number>::PANEL;
/// Numbers of so many rows of a panel's columns.
const SQUARE: usize = PANEL * PANEL;

impl Panels {
    fn used((rows, columns): (usize, usize)) -> Self {
        Self {
            shape: (rows, columns),
            values: memory::used(rows.next_multiple_of(PANEL) * columns),
        }
    }

    pub(crate) fn rows(&self) -> usize {
        self.shape.0
    }
}

/// A matrix and its transpose. `fill` is asked for column after column.
pub(crate) fn both_ways(
    (rows, columns): (usize, usize),
    mut fill: impl FnMut(usize, &mut [f32]),
) -> [Panels; 2] {
    let mut panels = Panels::used((rows, columns));
    let mut transposed = Panels::used((columns, rows));
    // A panel's columns at a time: they stay in the cache.
    let padded = rows.next_multiple_of(PANEL);
    let mut other = [0.0; SQUARE];
    let mut beside = vec![0.0; padded * PANEL];
    for (first, panel) in (0..columns)
        .step_by(PANEL)
        .zip(transposed.values.chunks_exact_mut(PANEL * rows.max(1)))
    {
        let count = PANEL.min(columns - first);
        for (index, column) in beside.chunks_exact_mut(padded).take(count).enumerate() {
            fill(first + index, &mut column[..rows]);
        }
        let values = &mut panels.values[first * PANEL..];
        vectorised!(
            <'a>
            panel: &'a mut [f32] = panel,
            values: &'a mut [f32] = values,
            beside: &'a [f32] = &beside,
            sizes: [usize; 4] = [rows, columns, padded, count],
            other: &'a mut [f32; SQUARE] = &mut other
            => () {
                let [rows, columns, padded, count] = sizes;
                for (row, turned) in (0..rows).step_by(PANEL).zip(panel.chunks_mut(SQUARE)) {
                    let square = &mut values[row * columns..][..count * PANEL];
                    let pairs = square.as_chunks_mut::<PANEL>().0.iter_mut();
                    for (to, from) in pairs.zip(beside.chunks_exact(padded)) {
                        to.copy_from_slice(&from[row..row + PANEL]);
                    }
                    transpose(square, turned, other);
                }
            }
        );
    }
    [panels, transposed]
}

/// Transposes a square of numbers, or the first columns of one into what there is room for. `other` is memory for it.
#[inline(always)]
fn transpose(columns: &[f32], turned: &mut [f32], other: &mut [f32; SQUARE]) {
    if let (Ok(square), Ok(turned)) = (columns.try_into(), (&mut *turned).try_into()) {
        transpose_square(square, turned, other);
        return;
    }
    let (mut square, mut all) = ([0.0; SQUARE], [0.0; SQUARE]);
    square[..columns.len()].copy_from_slice(columns);
    transpose_square(&square, &mut all, other);
    turned.copy_from_slice(&all[..turned.len()]);
}

#[inline(always)]
fn transpose_square(square: &[f32; SQUARE], turned: &mut [f32; SQUARE], other: &mut [f32; SQUARE]) {
    // Halves that are put into each other number by number turn the digits of a number's place about.
    merge(square, turned);
    for _ in 0..PANEL.ilog2() / 2 {
        merge(turned, other);
        merge(other, turned);
    }
}

/// Puts halves into each other number by number.
#[inline(always)]
fn merge(halves: &[f32; SQUARE], merged: &mut [f32; SQUARE]) {
    let (low, high) = halves.split_at(SQUARE / 2);
    let pairs = merged.as_chunks_mut::<2>().0.iter_mut();
    for (pair, (low, high)) in pairs.zip(low.iter().zip(high)) {
        *pair = [*low, *high];
    }
}

impl Rows<f32> for Panels {
    fn shape(&self) -> (usize, usize) {
        self.shape
    }

    fn panel<'a>(&'a self, first: usize, _: &'a mut Vec<f32>) -> &'a [f32] {
        &self.values[first * self.shape.1..][..PANEL * self.shape.1]
    }
}

impl Drop for Panels {
    fn drop(&mut self) {
        memory::keep_values(std::mem::take(&mut self.values));
    }
}

fn write_product_by<T: Number>(arch: Arch, a: &impl Rows<T>, b: &DMatrix<T>, product: &mut [T]) {
    let (rows, inner) = a.shape();
    assert_eq!(inner, b.nrows(), "factors that do not fit");
    assert_eq!(product.len(), rows * b.ncols(), "a product of another size");
    if inner == 0 {
        product.fill(T::ZERO);
    }
    let mut room = Vec::new();
    let factors = side_by_side(b);
    for first in (0..rows).step_by(T::PANEL) {
        arch.dispatch(Panel {
            values: a.panel(first, &mut room),
            factors: &factors,
            columns: b.ncols(),
            inner,
            first,
            count: T::PANEL.min(rows - first),
            rows,
            product: &mut *product,
        });
    }
}

/// Rows of every [`COLUMNS`] columns of a matrix, as they are read: one row after another, then those of the
/// next columns. Beyond the last column the last is repeated.
fn side_by_side<T: Number>(matrix: &DMatrix<T>) -> Vec<[T; COLUMNS]> {
    let (rows, columns) = matrix.shape();
    let mut side_by_side = Vec::with_capacity(rows * columns.div_ceil(COLUMNS));
    for first in (0..columns).step_by(COLUMNS) {
        let column = |j: usize| &matrix.as_slice()[(first + j).min(columns - 1) * rows..][..rows];
        let columns: [&[T]; COLUMNS] = std::array::from_fn(column);
        side_by_side.extend((0..rows).map(|row| columns.map(|column| column[row])));
    }
    side_by_side
}

/// Some rows of a product.
struct Panel<'a, T> {
    values: &'a [T],
    /// As [`side_by_side`] has them.
    factors: &'a [[T; COLUMNS]],
    columns: usize,
    inner: usize,
    first: usize,
    count: usize,
    rows: usize,
    product: &'a mut [T],
}

impl<T: Number> WithSimd for Panel<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let columns = self.columns;
        let (vectors, _) = T::vectors::<S>(self.values).as_chunks::<VECTORS>();
        let per_panel = vectors.len() / self.inner.max(1);
        let mut sums = vec![T::ZERO; COLUMNS * T::PANEL];
        for block in (0..self.inner).step_by(INNER) {
            let length = INNER.min(self.inner - block);
            for column in (0..columns).step_by(COLUMNS) {
                let factors = &self.factors[column / COLUMNS * self.inner + block..][..length];
                for vector in 0..per_panel {
                    let mut held = [[T::splat(simd, T::ZERO); VECTORS]; COLUMNS];
                    // Not by an iterator's steps, which take as many instructions as the products.
                    let rows = vectors[block * per_panel..].chunks_exact(per_panel);
                    for (rows, factor) in rows.zip(factors) {
                        let rows = &rows[vector];
                        for j in 0..COLUMNS {
                            let factor = T::splat(simd, factor[j]);
                            for i in 0..VECTORS {
                                held[j][i] = T::multiply_add(simd, rows[i], factor, held[j][i]);
                            }
                        }
                    }
                    let (all, _) = T::vectors_mut::<S>(&mut sums).as_chunks_mut();
                    for (j, held) in held.into_iter().enumerate() {
                        all[j * per_panel + vector] = held;
                    }
                }
                for (j, sums) in sums.chunks_exact(T::PANEL).enumerate() {
                    if column + j < columns {
                        let start = (column + j) * self.rows + self.first;
                        let product = &mut self.product[start..start + self.count];
                        for (product, sum) in product.iter_mut().zip(sums) {
                            *product = if block > 0 { product.plus(*sum) } else { *sum };
                        }
                    }
                }
            }
        }
    }
}

mod num {
    use pulp::Simd;

    /// What a product needs of its numbers, of any width of vectors.
    pub trait Number: Copy {
        /// Rows of a panel: [`super::VECTORS`] of the widest vectors.
        const PANEL: usize;
        const ZERO: Self;
        type Vector<S: Simd>: Copy;

        fn plus(self, other: Self) -> Self;
        fn splat<S: Simd>(simd: S, value: Self) -> Self::Vector<S>;
        /// `a b + c`, rounded once.
        fn multiply_add<S: Simd>(
            simd: S,
            a: Self::Vector<S>,
            b: Self::Vector<S>,
            c: Self::Vector<S>,
        ) -> Self::Vector<S>;
        fn vectors<S: Simd>(values: &[Self]) -> &[Self::Vector<S>];
        fn vectors_mut<S: Simd>(values: &mut [Self]) -> &mut [Self::Vector<S>];
    }

    macro_rules! number {
        ($type:ty, $panel:expr, $vector:ident, $splat:ident, $multiply_add:ident,
         $vectors:ident, $vectors_mut:ident) => {
            impl Number for $type {
                const PANEL: usize = $panel;
                const ZERO: Self = 0.0;
                type Vector<S: Simd> = S::$vector;

                #[inline(always)]
                fn plus(self, other: Self) -> Self {
                    self + other
                }

                #[inline(always)]
                fn splat<S: Simd>(simd: S, value: Self) -> S::$vector {
                    simd.$splat(value)
                }

                #[inline(always)]
                fn multiply_add<S: Simd>(
                    simd: S,
                    a: S::$vector,
                    b: S::$vector,
                    c: S::$vector,
                ) -> S::$vector {
                    simd.$multiply_add(a, b, c)
                }

                #[inline(always)]
                fn vectors<S: Simd>(values: &[Self]) -> &[S::$vector] {
                    S::$vectors(values).0
                }

                #[inline(always)]
                fn vectors_mut<S: Simd>(values: &mut [Self]) -> &mut [S::$vector] {
                    S::$vectors_mut(values).0
                }
            }
        };
    }

    number!(
        f32,
        32,
        f32s,
        splat_f32s,
        mul_add_f32s,
        as_simd_f32s,
        as_mut_simd_f32s
    );
    number!(
        f64,
        16,
        f64s,
        splat_f64s,
        mul_add_f64s,
        as_simd_f64s,
        as_mut_simd_f64s
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random<T: From<f32> + nalgebra::Scalar>(
        rows: usize,
        columns: usize,
        mut seed: u32,
    ) -> DMatrix<T> {
        DMatrix::from_fn(rows, columns, |_, _| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            T::from((seed >> 8) as f32 / (1 << 23) as f32 - 1.0)
        })
    }

    fn archs() -> Vec<Arch> {
        let names = ["plain", "avx2", "avx512"];
        names.into_iter().filter_map(by_name).collect()
    }

    #[test]
    fn products_are_right_and_alike_on_all_instructions() {
        for (rows, inner, columns) in [
            (1, 1, 1),
            (3, 0, 2),
            (0, 4, 2),
            (4, 3, 0),
            (33, 300, 7),
            (64, 256, 6),
            (5, 1000, 13),
            (130, 17, 25),
        ] {
            let (a, b) = (
                random::<f64>(rows, inner, 1),
                random::<f64>(inner, columns, 2),
            );
            let (x, y) = (a.clone().cast::<f32>(), b.clone().cast::<f32>());
            let exact = &a * &b;
            let expected = (
                product_by(Arch::Scalar, &Of(&a), &b),
                product_by(Arch::Scalar, &Of(&x), &y),
            );
            // Sums of so many products of numbers up to 1.
            let tolerance = 1e-12 * (inner + 1) as f64;
            assert!((&expected.0 - &exact).iter().all(|d| d.abs() <= tolerance));
            let rounded = expected.1.clone().cast::<f64>() - &exact;
            assert!(rounded.iter().all(|d| d.abs() <= 1e-6 * (inner + 1) as f64));
            let [panels, _] = both_ways((rows, inner), |column, values| {
                values.copy_from_slice(x.column(column).as_slice());
            });
            let [_, transposed] = both_ways((inner, rows), |row, values| {
                values.copy_from_slice(x.row(row).transpose().as_slice());
            });
            for arch in archs() {
                assert!(product_by(arch, &Of(&a), &b) == expected.0, "{arch:?}");
                assert!(product_by(arch, &Of(&x), &y) == expected.1, "{arch:?}");
                for panels in [&panels, &transposed] {
                    assert!(product_by(arch, panels, &y) == expected.1, "{arch:?}");
                }
            }
        }
    }
}
