//! Scenes that little light of an environment gets into.

use glam::Vec3;
use rayon::prelude::*;
use relight_format::math;

use crate::mesh::Mesh;
use crate::visibility::ray::RayCaster;

/// Triangles that are looked at, about.
const PROBES: usize = 2048;
/// Directions looked in from each.
const RAYS: usize = 32;
/// One of so many of them tells of a dim place what is about it.
const FEW: usize = 4;
/// Mean part of light from everywhere below which errors of what is left of it show.
const DIM: f64 = 0.25;
/// Places where less than that arrives are in a room, not in a crevice, if their rays go farther than this part of the
/// scene's diagonal, on average. People look at rooms from within: the whole is dim to them if so much of the surface is.
const ROOM: f32 = 0.1;
const ROOMS: f64 = 0.2;
/// Nobody looks into what gets less than this part: insides of shells that have two sides.
const CLOSED: f64 = 0.002;

/// What a place sees.
struct Place {
    area: f32,
    /// Of light from everywhere, the part that arrives, at most.
    part: f32,
    /// Whether it lies in a room: it sees fronts, most of them far away, and little else.
    indoors: bool,
}

/// What places all over a scene see.
struct Places(Vec<Place>);

impl Places {
    /// `origin` tells where rays from a triangle begin, `diagonal` how large the scene is without its ground.
    fn of(
        mesh: &Mesh,
        origin: &(impl Fn(usize) -> Vec3 + Sync),
        caster: &RayCaster,
        diagonal: f32,
    ) -> Self {
        let step = (mesh.triangles.len() / PROBES).max(1);
        let looked_at: Vec<usize> = (0..mesh.triangles.len()).step_by(step).collect();
        let look = |&triangle: &usize| {
            let [a, b, c] = mesh.corners(&mesh.triangles[triangle]);
            place(caster, origin(triangle), (b - a).cross(c - a), diagonal)
        };
        Self(looked_at.par_iter().map(look).collect())
    }

    /// The area of those that count, and the part of light from everywhere that arrives there on average.
    fn mean(&self, counts: impl Fn(&Place) -> bool) -> (f64, f64) {
        let counted = self.0.iter().filter(|place| counts(place));
        let (light, area) = counted.fold((0.0, 0.0), |(light, all), place| {
            let area = f64::from(place.area);
            (light + area * f64::from(place.part), all + area)
        });
        (area, light / area)
    }

    /// The part of the surface that lies in rooms which light gets into, and the part of it that does, if much does.
    fn rooms(&self) -> Option<(f64, f64)> {
        let (all, _) = self.mean(|_| true);
        let (area, part) = self.mean(|place| place.indoors);
        (area > ROOMS * all && part > CLOSED).then(|| (area / all, part))
    }
}

/// Whether much of a scene lies in rooms; `ray_offset` is how far from triangles rays begin, `diagonal` as in [`warning`].
pub(super) fn has_rooms(mesh: &Mesh, ray_offset: f32, caster: &RayCaster, diagonal: f32) -> bool {
    let above_middle = |triangle: usize| {
        let corners = mesh.corners(&mesh.triangles[triangle]);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        corners.iter().sum::<Vec3>() / 3.0 + ray_offset * normal.normalize_or_zero()
    };
    let places = Places::of(mesh, &above_middle, caster, diagonal);
    places.rooms().is_some()
}

/// A warning if the distance is seen from nearly nowhere, or little of it; `origin` tells where rays from a triangle begin,
/// `diagonal` how large the scene is without its ground.
pub(super) fn warning(
    mesh: &Mesh,
    origin: &(impl Fn(usize) -> Vec3 + Sync),
    caster: &RayCaster,
    diagonal: f32,
) -> Option<String> {
    let places = Places::of(mesh, origin, caster, diagonal);
    let count = places.0.len();
    let lit = places.0.iter().filter(|place| place.part > 0.0).count();
    if lit * 50 < count {
        return Some(format!(
            "the distance is seen from {lit} of {count} points on fronts of triangles: an environment \
             hardly lights this scene; a closed room needs lights or openings, and a mesh whose \
             triangles face inwards must be turned about in the program that made it"
        ));
    }
    let (_, part) = places.mean(|_| true);
    if part < DIM {
        return Some(format!(
            "of light from everywhere {:.0} % arrives at the surface, on average: errors show {:.0} times as \
             much as out in the open; compare with `lab truth`, and draw with high quality",
            100.0 * part,
            1.0 / part
        ));
    }
    places.rooms().map(|(surface, part)| {
        format!(
            "{:.0} % of the surface lies in rooms, where of light from everywhere {:.1} % arrives, on average: errors \
             show more there than out in the open; compare with `lab truth`, draw with high quality, and bake with \
             --refine-error 0.02 or less",
            100.0 * surface,
            100.0 * part
        )
    })
}

/// What is seen from `origin` on the side of a triangle that `normal`, twice as long as its area, points to.
fn place(caster: &RayCaster, origin: Vec3, normal: Vec3, diagonal: f32) -> Place {
    let face = normal.normalize_or_zero();
    // Spread over the sphere by the golden angle, and turned to the side that the triangle faces.
    let directions = (0..RAYS).map(|ray| {
        let y = (2.0 * ray as f32 + 1.0) / RAYS as f32 - 1.0;
        let (sin, cos) = math::sin_cos(2.399_963_f32 * ray as f32);
        let around = (1.0 - y * y).max(0.0).sqrt();
        let direction = Vec3::new(around * cos, y, around * sin);
        direction * face.dot(direction).signum()
    });
    let [mut open, mut all] = [0.0; 2];
    for direction in directions.clone() {
        let cosine = face.dot(direction);
        all += cosine;
        if !caster.any_hit(origin, direction) {
            open += cosine;
        }
    }
    let part = open / all.max(f32::MIN_POSITIVE);
    let mut place = Place {
        area: normal.length(),
        part,
        indoors: false,
    };
    if f64::from(part) >= DIM {
        return place;
    }
    let [mut fronts, mut backs, mut reach] = [0.0; 3];
    for direction in directions.step_by(FEW) {
        match caster.closest_side(origin, direction) {
            Some((distance, true)) => {
                fronts += 1.0;
                reach += distance;
            }
            Some(_) => backs += 1.0,
            None => {}
        }
    }
    place.indoors = fronts > backs && reach > ROOM * diagonal * fronts;
    place
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::mesh::{Triangle, Vertex};

    /// So many faces of a box of 2 m that look inwards, its last face the lid, each divided into triangles, beside an open
    /// floor that has so many metres on each side.
    fn scene(faces: usize, floor: f32) -> Mesh {
        const PARTS: u32 = 8;
        let mut mesh = Mesh::default();
        let sides = [
            Vec3::NEG_Y,
            Vec3::X,
            Vec3::NEG_X,
            Vec3::Z,
            Vec3::NEG_Z,
            Vec3::Y,
        ];
        let box_faces = sides.into_iter().take(faces).map(|side| (side, side, 2.0));
        let floor =
            (floor > 0.0).then(|| (Vec3::NEG_Y, Vec3::new(2.0 + 0.5 * floor, -1.0, 0.0), floor));
        for (outwards, middle, width) in box_faces.chain(floor) {
            let (u, v) = (-outwards).any_orthonormal_pair();
            for (row, column) in (0..PARTS).flat_map(|row| (0..PARTS).map(move |i| (row, i))) {
                let first = mesh.vertices.len() as u32;
                for [x, y] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
                    let at = |part: u32| width * (part as f32 / PARTS as f32 - 0.5);
                    mesh.vertices.push(Vertex {
                        position: middle + at(column + x) * u + at(row + y) * v,
                        normal: -outwards,
                        tangent: u,
                        bitangent_sign: 1.0,
                        uv: Vec2::ZERO,
                        second_uv: Vec2::ZERO,
                    });
                }
                for corners in [[0, 1, 2], [0, 2, 3]] {
                    mesh.triangles.push(Triangle {
                        vertices: corners.map(|corner| first + corner),
                        material: 0,
                    });
                }
            }
        }
        mesh
    }

    /// The warning of such a scene.
    fn told(faces: usize, floor: f32) -> Option<String> {
        let mesh = scene(faces, floor);
        let middle = |triangle: usize| {
            let corners = mesh.corners(&mesh.triangles[triangle]);
            let face = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            assert!(face.dot(corners[0]) < 0.0, "faces look inwards");
            corners.iter().sum::<Vec3>() / 3.0 + 1e-4 * face.normalize()
        };
        warning(
            &mesh,
            &middle,
            &RayCaster::new(&mesh.soup()),
            mesh.diagonal(),
        )
    }

    #[test]
    fn a_floor_is_light_a_box_without_its_lid_dim_and_a_closed_one_dark() {
        assert_eq!(told(1, 0.0), None);
        // A fifth of what leaves the lid arrives at each of the others.
        let dim = told(5, 0.0).unwrap();
        let part: f32 = (dim.split_whitespace().nth(4).unwrap().parse()).unwrap();
        assert!((part - 20.0).abs() <= 2.0, "{dim}");
        assert!(told(6, 0.0).unwrap().contains("is seen from 0 of"));
    }

    #[test]
    fn a_dim_room_is_told_of_beside_what_lies_open() {
        // The box has 20 of 36 square metres.
        // But for what lies below the rim, where more than a quarter arrives.
        let told_of = told(5, 4.0).unwrap();
        let (part, text) = told_of.split_once(' ').unwrap();
        assert!(
            (20..=56).contains(&part.parse::<i32>().unwrap()),
            "{told_of}"
        );
        assert!(
            text.starts_with("% of the surface lies in rooms"),
            "{told_of}"
        );
        // Of 164 it has an eighth: this is a view of something else.
        assert_eq!(told(5, 12.0), None);
        // Nobody looks into a closed one.
        assert_eq!(told(6, 4.0), None);
    }

    #[test]
    fn rooms_are_what_light_gets_into() {
        let rooms = |faces: usize, floor: f32| {
            let mesh = scene(faces, floor);
            let caster = RayCaster::new(&mesh.soup());
            has_rooms(&mesh, 1e-4, &caster, mesh.diagonal())
        };
        assert!(rooms(5, 0.0) && rooms(5, 4.0));
        assert!(!rooms(1, 0.0) && !rooms(5, 12.0) && !rooms(6, 0.0) && !rooms(6, 4.0));
    }
}
