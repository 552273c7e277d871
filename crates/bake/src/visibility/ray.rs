//! Rays against a triangle soup: watertight triangle test over a tree of boxes that `obvhs` builds.

use glam::{Vec3, Vec3A};
use obvhs::{Boundable, BvhBuildParams, aabb::Aabb, bvh2::Bvh2, bvh2::builder::build_bvh2};
use relight_shading::occluders::padding;

use super::wide::{Ray, Visitor, Wide};

/// Where a ray first meets the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle in the slice given to [`RayCaster::new`].
    pub triangle: usize,
    /// Weights of the triangle's vertices; they sum to 1.
    pub barycentrics: Vec3,
    /// Ray parameter, in lengths of the direction.
    pub distance: f32,
}

/// What a box costs in place of a triangle more in a leaf, as the binary tree is built. With .3 there are two and a half times the nodes, for
/// rays that take as long.
const BOX_COST: f32 = 2.0;
/// Rays start at least so many steps of the largest coordinate above their surface.
const ROUNDINGS: f32 = 4.0;

/// How far above their surface rays start in a scene whose box has these corners: so many of its diagonals, or as
/// far as the rounding of coordinates asks for.
pub fn ray_offset([low, high]: [Vec3; 2], diagonals: f32) -> f32 {
    let largest = low.abs().max(high.abs()).max_element();
    (diagonals * low.distance(high)).max(ROUNDINGS * largest * f32::EPSILON)
}

/// A set of triangles that rays can be cast against.
///
/// The triangle test is watertight: the sign of an edge's volume with the ray is computed
/// alike, up to sign, from both triangles that share the edge, and a ray through an edge
/// hits both, so no ray passes between triangles that share their vertices' coordinates.
pub struct RayCaster {
    tree: Wide,
    /// In the order in which the tree's leaves name them.
    triangles: Vec<[Vec3A; 3]>,
    /// Their numbers in the slice given to [`RayCaster::new`].
    numbers: Vec<u32>,
}

/// Where a ray passes through the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Crossing {
    /// Ray parameter, in lengths of the direction.
    pub distance: f32,
    /// Of the triangle: unit length, on the side from which its vertices run counter-clockwise.
    pub normal: Vec3,
    /// A vertex of the triangle.
    pub vertex: Vec3,
    /// Its number in the slice given to [`RayCaster::new`].
    pub triangle: usize,
}

/// A triangle's bounds with [`padding`].
struct Padded {
    vertices: [Vec3A; 3],
    padding: Vec3A,
}

impl Boundable for Padded {
    fn aabb(&self) -> Aabb {
        let bounds = Aabb::from_points(&self.vertices);
        Aabb::new(bounds.min - self.padding, bounds.max + self.padding)
    }
}

impl RayCaster {
    /// Builds the tree. Triangles may be degenerate; coordinates must be finite.
    pub fn new(triangles: &[[Vec3; 3]]) -> Self {
        let padding = Vec3A::from(padding(triangles));
        let padded: Vec<Padded> = triangles
            .iter()
            .map(|triangle| Padded {
                vertices: triangle.map(Vec3A::from),
                padding,
            })
            .collect();
        let mut params = BvhBuildParams::medium_build();
        params.pre_split = false;
        params.collapse_traversal_cost = BOX_COST;
        let bvh = if padded.is_empty() {
            Bvh2::default()
        } else {
            build_bvh2(&padded, params, &mut std::time::Duration::default())
        };
        let (tree, numbers) = Wide::new(&bvh);
        let triangles = (numbers.iter())
            .map(|&number| padded[number as usize].vertices)
            .collect();
        Self {
            tree,
            triangles,
            numbers,
        }
    }

    /// Whether anything lies on the ray at a parameter greater than zero.
    pub fn any_hit(&self, origin: Vec3, direction: Vec3) -> bool {
        self.met(origin, direction, f32::INFINITY).is_some()
    }

    /// [`Self::any_hit`] that looks first at what an earlier ray met, most often one in about the same direction from
    /// near by, and remembers what this one does. [`NOTHING`] for what none has met yet.
    pub(crate) fn any_hit_as_before(
        &self,
        origin: Vec3,
        direction: Vec3,
        occluder: &mut u32,
    ) -> bool {
        if let Some(triangle) = self.triangles.get(*occluder as usize)
            && intersect(triangle, origin.into(), direction.into()).is_some()
        {
            return true;
        }
        let met = self.met(origin, direction, f32::INFINITY);
        *occluder = met.unwrap_or(*occluder);
        met.is_some()
    }

    /// [`Self::any_hit`] of the triangles, by their numbers in the slice given to [`Self::new`],
    /// that `counted` names.
    pub(crate) fn any_hit_of(
        &self,
        origin: Vec3,
        direction: Vec3,
        counted: impl Fn(usize) -> bool,
    ) -> bool {
        let ray = Ray::new(origin, direction);
        let counts = |place: u32| counted(self.numbers[place as usize] as usize);
        self.first_of(&ray, f32::INFINITY, counts).is_some()
    }

    /// Whether anything lies between two points.
    pub(crate) fn blocked(&self, from: Vec3, to: Vec3) -> bool {
        self.met(from, to - from, 1.0).is_some()
    }

    /// A triangle that the ray meets before `length`, by its place.
    fn met(&self, origin: Vec3, direction: Vec3, length: f32) -> Option<u32> {
        self.first_of(&Ray::new(origin, direction), length, |_| true)
    }

    /// The first of those that count that is found on the ray before `length`.
    fn first_of(&self, ray: &Ray, length: f32, counts: impl Fn(u32) -> bool) -> Option<u32> {
        let (triangles, found) = (&self.triangles[..], None);
        let first = First {
            triangles,
            counts,
            found,
        };
        self.tree.walk(ray, length, first).found
    }

    /// Everything on the ray up to `length`, in no particular order.
    pub(crate) fn crossings(&self, origin: Vec3, direction: Vec3, length: f32) -> Vec<Crossing> {
        let all = All {
            caster: self,
            found: Vec::new(),
        };
        self.tree
            .walk(&Ray::new(origin, direction), length, all)
            .found
    }

    /// How far the nearest intersection is, in lengths of the direction, and whether it is of a triangle's front: the side
    /// from which its vertices run counter-clockwise. Of two sides of a sheet the front is met.
    pub(crate) fn closest_side(&self, origin: Vec3, direction: Vec3) -> Option<(f32, bool)> {
        let (place, distance, _) = self.nearest(origin, direction)?;
        let [a, b, c] = self.triangles[place as usize];
        let slope = (b - a).cross(c - a).dot(direction.into());
        Some((distance, slope < 0.0))
    }

    /// The nearest intersection at a parameter greater than zero.
    pub fn closest_hit(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let nearest = self.nearest(origin, direction);
        nearest.map(|(place, distance, barycentrics)| Hit {
            triangle: self.numbers[place as usize] as usize,
            barycentrics,
            distance,
        })
    }

    /// The place of what is met first, how far away it is, and barycentrics.
    fn nearest(&self, origin: Vec3, direction: Vec3) -> Option<(u32, f32, Vec3)> {
        let nearest = Nearest {
            triangles: &self.triangles,
            found: None,
        };
        let ray = Ray::new(origin, direction);
        self.tree.walk(&ray, f32::INFINITY, nearest).found
    }
}

/// Finds the first of those that count.
struct First<'a, C> {
    triangles: &'a [[Vec3A; 3]],
    counts: C,
    found: Option<u32>,
}

impl<C: Fn(u32) -> bool> Visitor for First<'_, C> {
    #[inline(always)]
    fn visit(&mut self, ray: &Ray, place: u32, length: f32) -> f32 {
        let hit = intersect(&self.triangles[place as usize], ray.origin, ray.direction);
        if hit.is_some_and(|(distance, _)| distance < length) && (self.counts)(place) {
            self.found = Some(place);
            return -1.0;
        }
        length
    }
}

/// Finds all.
struct All<'a> {
    caster: &'a RayCaster,
    found: Vec<Crossing>,
}

impl Visitor for All<'_> {
    #[inline(always)]
    fn visit(&mut self, ray: &Ray, place: u32, length: f32) -> f32 {
        let triangle = &self.caster.triangles[place as usize];
        let hit = intersect(triangle, ray.origin, ray.direction);
        if let Some((distance, _)) = hit.filter(|(distance, _)| *distance <= length) {
            let [a, b, c] = *triangle;
            self.found.push(Crossing {
                distance,
                normal: (b - a).cross(c - a).normalize_or_zero().into(),
                vertex: a.into(),
                triangle: self.caster.numbers[place as usize] as usize,
            });
        }
        length
    }
}

/// Finds the nearest: its place, how far away, and barycentrics.
struct Nearest<'a> {
    triangles: &'a [[Vec3A; 3]],
    found: Option<(u32, f32, Vec3)>,
}

impl Visitor for Nearest<'_> {
    #[inline(always)]
    fn visit(&mut self, ray: &Ray, place: u32, limit: f32) -> f32 {
        let triangle = &self.triangles[place as usize];
        let Some((distance, barycentrics)) = intersect(triangle, ray.origin, ray.direction) else {
            return limit;
        };
        // Of the two sides of a sheet, which lie on each other, the one that faces the ray.
        let [a, b, c] = *triangle;
        let behind = (b - a).cross(c - a).dot(ray.direction) > 0.0;
        let counted = if behind { distance * BEHIND } else { distance };
        if counted >= limit {
            return limit;
        }
        self.found = Some((place, distance, barycentrics));
        counted
    }
}

/// Whether a ray meets one triangle, as a [`RayCaster`] of it says.
#[inline(always)]
pub(crate) fn meets(triangle: [Vec3; 3], origin: Vec3, direction: Vec3) -> bool {
    let [a, b, c] = triangle;
    intersect(
        &[a.into(), b.into(), c.into()],
        origin.into(),
        direction.into(),
    )
    .is_some()
}

/// No triangle, where one is remembered.
pub(crate) const NOTHING: u32 = u32::MAX;

/// What is met from behind lies so much farther, a few steps of rounding.
const BEHIND: f32 = 1.0 + 8.0 * f32::EPSILON;

/// Ray parameter and barycentrics of the intersection, if any, with parameter > 0.
///
/// Signed volumes of the ray with the three edges (Plücker coordinates about the ray's
/// origin). `a × b` and `b × a` round to exact negatives, which makes shared edges
/// consistent; double precision near zero makes the edges about a vertex consistent.
#[inline(always)]
fn intersect(triangle: &[Vec3A; 3], origin: Vec3A, direction: Vec3A) -> Option<(f32, Vec3)> {
    let [a, b, c] = *triangle;
    let (a, b, c) = (a - origin, b - origin, c - origin);
    let mut volumes = Vec3::new(
        direction.dot(b.cross(c)),
        direction.dot(c.cross(a)),
        direction.dot(a.cross(b)),
    );
    // Bounds the rounding error of a volume: below it the sign is unknown.
    let scale = a.abs().max(b.abs()).max(c.abs()).max_element();
    let uncertain = 16.0 * f32::EPSILON * scale * scale * direction.abs().max_element();
    if volumes.abs().min_element() <= uncertain {
        volumes = precise_volumes(triangle, origin, direction);
    }
    if !(volumes.min_element() >= 0.0 || volumes.max_element() <= 0.0) {
        return None;
    }
    let volume = volumes.element_sum();
    if volume == 0.0 {
        return None;
    }
    let normal = (triangle[1] - triangle[0]).cross(triangle[2] - triangle[0]);
    let t = normal.dot(a) / normal.dot(direction);
    (t > 0.0 && t.is_finite()).then(|| (t, volumes / volume))
}

#[cold]
fn precise_volumes(triangle: &[Vec3A; 3], origin: Vec3A, direction: Vec3A) -> Vec3 {
    let (origin, direction) = (origin.as_dvec3(), direction.as_dvec3());
    let [a, b, c] = triangle.map(|vertex| vertex.as_dvec3() - origin);
    let volume = |p: glam::DVec3, q: glam::DVec3| direction.dot(p.cross(q)) as f32;
    Vec3::new(volume(b, c), volume(c, a), volume(a, b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use relight_format::math;

    fn quad_grid(n: u32) -> Vec<[Vec3; 3]> {
        let at = |x: u32, z: u32| {
            let (x, z) = (x as f32 / n as f32 - 0.5, z as f32 / n as f32 - 0.5);
            Vec3::new(x, 0.1 * math::sin(7.0 * x) * math::cos(5.0 * z), z)
        };
        (0..n * n)
            .flat_map(|i| {
                let (x, z) = (i % n, i / n);
                let [a, b, c, d] = [at(x, z), at(x + 1, z), at(x + 1, z + 1), at(x, z + 1)];
                [[a, c, b], [a, d, c]]
            })
            .collect()
    }

    #[test]
    fn rays_through_shared_vertices_and_edges_hit() {
        let triangles = quad_grid(40);
        let caster = RayCaster::new(&triangles);
        let origin = Vec3::new(0.013, 1.7, -0.021);
        for triangle in &triangles {
            for (i, &vertex) in triangle.iter().enumerate() {
                let middle = (vertex + triangle[(i + 1) % 3]) * 0.5;
                for target in [vertex, middle] {
                    if target.x.abs() < 0.49 && target.z.abs() < 0.49 {
                        assert!(
                            caster.any_hit(origin, target - origin),
                            "ray to {target} leaks"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn boxes_of_wide_ground_end_below_the_rays_that_start_on_it() {
        let [low, high] = [-5000.0, 5000.0].map(|side| Vec3::new(side, 1.0, side));
        let corner = Vec3::new(low.x, 1.0, high.z);
        let caster = RayCaster::new(&[[low, high, corner]]);
        let [least, largest] = caster.tree.bounds().map(|corner| corner.y);
        assert!(largest < 1.0 + ray_offset([low, high], 0.0), "{largest}");
        assert!(least <= 1.0 && largest >= 1.0, "{least} {largest}");
    }

    #[test]
    fn closest_hit_agrees_with_testing_every_triangle() {
        let triangles = quad_grid(12);
        let caster = RayCaster::new(&triangles);
        for i in 0..500u32 {
            let direction = relight_shading::octahedral::texel_direction(i % 25, i / 25, 25);
            let origin = Vec3::new(0.1, 0.02, -0.07);
            let brute = triangles
                .iter()
                .filter_map(|triangle| {
                    intersect(&triangle.map(Vec3A::from), origin.into(), direction.into())
                })
                .map(|(t, _)| t)
                .min_by(f32::total_cmp);
            let hit = caster.closest_hit(origin, direction);
            assert_eq!(hit.map(|hit| hit.distance), brute, "direction {direction}");
            assert_eq!(caster.any_hit(origin, direction), brute.is_some());
            if let Some(hit) = hit {
                let [a, b, c] = triangles[hit.triangle];
                let w = hit.barycentrics;
                let point = a * w.x + b * w.y + c * w.z;
                assert!(point.distance(origin + direction * hit.distance) < 1e-5);
            }
        }
    }

    #[test]
    fn what_was_met_before_changes_no_answer() {
        let triangles = quad_grid(12);
        let caster = RayCaster::new(&triangles);
        let (mut hits, mut again, mut occluder) = (0, 0, NOTHING);
        for i in 0..2000u32 {
            let direction = relight_shading::octahedral::texel_direction(i % 40, i / 40, 50);
            let origin = Vec3::new(0.1, 0.08 - 0.0001 * i as f32, -0.07);
            let expected = caster.any_hit(origin, direction);
            let before = occluder;
            let found = caster.any_hit_as_before(origin, direction, &mut occluder);
            assert_eq!(found, expected, "{direction}");
            hits += u32::from(found);
            again += u32::from(found && before == occluder);
        }
        assert!(
            hits > 300 && again > 30 && again < hits,
            "{again} of {hits}"
        );
    }

    #[test]
    fn of_two_sides_the_one_that_faces_the_ray_is_hit() {
        let front = quad_grid(6);
        let back = front.iter().map(|&[a, b, c]| [a, c, b]);
        let triangles: Vec<_> = front.iter().copied().chain(back).collect();
        let caster = RayCaster::new(&triangles);
        let mut hits = 0;
        for i in 0..625u32 {
            let direction = relight_shading::octahedral::texel_direction(i % 25, i / 25, 25);
            let origin = Vec3::new(0.1, 0.02, -0.07);
            if let Some(hit) = caster.closest_hit(origin, direction) {
                let [a, b, c] = triangles[hit.triangle];
                assert!((b - a).cross(c - a).dot(direction) <= 0.0, "{direction}");
                hits += 1;
            }
        }
        assert!(hits > 20, "{hits}");
    }

    #[test]
    fn nothing_is_hit_in_an_empty_scene() {
        assert!(!RayCaster::new(&[]).any_hit(Vec3::ZERO, Vec3::Y));
        assert_eq!(RayCaster::new(&[]).closest_hit(Vec3::ZERO, Vec3::Y), None);
    }
}
