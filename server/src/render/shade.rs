//! What colour eight pixels have: a lamp with its shadow, light from all around, and what shines back of
//! both.
//!
//! The surface is the usual mixture of a matt one and one of tiny mirrors: Walter et al., *Microfacet models
//! for refraction through rough surfaces*, 2007, with the distribution GGX. The Fresnel term is Schlick's. What
//! a uniform sky sends back is Karis' approximation, *Physically based shading on mobile*, 2014. What mirrors
//! show of the theatre is a sky that brightens about the lamp, above a darker floor.

use std::sync::LazyLock;

use wide::f32x8;

use super::camera::Camera;
use super::light::{self, WORKING_DISTANCE};
use super::material;
use super::project::Faces;
use super::raster::{self, LANES, Shown};
use super::scene::Scene;
use super::shadow::ShadowMap;
use super::tissue::Paint;

/// Numbers of eight pixels.
type Eight = f32x8;

/// Red, green, blue or x, y, z of eight pixels.
pub(super) type Triple = [f32x8; 3];

/// What shading needs of a scene and a camera.
pub(super) struct Shader<'a> {
    scene: &'a Scene,
    faces: &'a Faces,
    shadow: Option<&'a ShadowMap>,
    /// The direction of pixel (x, y) is the first plus x times the second plus y times the third.
    ray: [[f32; 3]; 3],
    eye: [f32; 3],
    lamp: Lamp,
    /// What a pixel shows of a surface at a depth of 1 m that faces it, m.
    width: f32,
}

/// From where the lamp shines.
enum Lamp {
    /// From everywhere in this direction.
    Far([f32; 3]),
    /// From this place along this axis, m.
    Near { place: [f32; 3], axis: [f32; 3] },
}

impl<'a> Shader<'a> {
    pub(super) fn new(
        scene: &'a Scene,
        camera: &Camera,
        faces: &'a Faces,
        shadow: Option<&'a ShadowMap>,
    ) -> Self {
        let turn = camera.world_from_camera.rotation;
        let vector = |vector: nalgebra::Vector3<f64>| [0, 1, 2].map(|axis| vector[axis] as f32);
        let start = camera.ray(0.0, 0.0);
        let (right, down) = (camera.ray(1.0, 0.0) - start, camera.ray(0.0, 1.0) - start);
        let lamp = match (scene.light.place, &scene.endoscope) {
            (light::Lamp::Far(direction), _) => Lamp::Far(vector(direction)),
            (light::Lamp::AtEndoscope, Some(endoscope)) => {
                let at = &endoscope.world_from_camera;
                let axis = vector(at.rotation * nalgebra::Vector3::z());
                Lamp::Near { place: vector(at.translation.vector), axis }
            }
            // Nothing is lit where there is no endoscope.
            (light::Lamp::AtEndoscope, None) => Lamp::Near { place: [0.0; 3], axis: [0.0; 3] },
        };
        Self {
            scene,
            faces,
            shadow,
            ray: [vector(turn * start), vector(turn * right), vector(turn * down)],
            eye: vector(camera.world_from_camera.translation.vector),
            lamp,
            width: (1.0 / camera.intrinsics.fy) as f32,
        }
    }

    /// The light that eight pixels get: linear, 0 to 1.
    pub(super) fn colours(&self, shown: &Shown) -> Triple {
        let background = self.scene.background.map(Eight::splat);
        if shown.is_nothing() {
            return background;
        }
        let surface = self.surface(shown);
        let ray: Triple = std::array::from_fn(|axis| {
            Eight::splat(self.ray[0][axis])
                + Eight::splat(self.ray[1][axis]) * shown.columns
                + Eight::splat(self.ray[2][axis] * shown.row)
        });
        let place =
            std::array::from_fn(|axis| Eight::splat(self.eye[axis]) + ray[axis] * shown.depth);
        let lit = self.lit(&surface, &ray, place);
        std::array::from_fn(|channel| shown.seen.bitselect(lit[channel], background[channel]))
    }

    /// The surfaces that eight pixels show.
    fn surface(&self, shown: &Shown) -> Surface {
        let mut surface = Surface::NONE;
        let mut painted = None;
        let mut left = shown.faces;
        // Few pixels side by side show more than two or three faces.
        while let Some(number) = left.into_iter().find(|number| *number > 0) {
            let pixels = raster::mask(shown.faces.map(|face| face == number));
            self.add_surface(&mut surface, &mut painted, shown, pixels, number - 1);
            left = left.map(|shown| if shown == number { 0 } else { shown });
        }
        self.add_paint(&mut surface, shown, painted.as_ref());
        surface.normal = unit(surface.normal);
        surface
    }

    /// Adds what a face is where `pixels` show it; its normal is not yet of length 1.
    fn add_surface(
        &self,
        surface: &mut Surface,
        painted: &mut Option<PaintedPixels<'a>>,
        shown: &Shown,
        pixels: Eight,
        face: u32,
    ) {
        let face = &self.faces.faces[face as usize];
        let scale = shown.depth * Eight::splat(face.over_area);
        let normals = face.vertices.map(|vertex| self.faces.normals[vertex as usize]);
        let weights: Triple = std::array::from_fn(|corner| {
            let ([a, b, c], key) = (face.edges[corner], normals[corner][3]);
            let edge = Eight::splat(a) * shown.columns + Eight::splat(b * shown.row + c);
            edge * (scale * Eight::splat(key))
        });
        let instance = &self.scene.instances()[face.instance as usize];
        let material = &instance.material;
        if let Some((paint, rest)) = instance.paint.as_ref().zip(self.faces.rest_of(face)) {
            if painted.as_ref().is_some_and(|before| before.instance != face.instance) {
                self.add_paint(surface, shown, painted.take().as_ref());
            }
            let new = || PaintedPixels::none(paint, face.instance);
            let painted = painted.get_or_insert_with(new);
            painted.pixels |= pixels;
            for (axis, sum) in painted.rest.iter_mut().enumerate() {
                let of = |corner: usize| Eight::splat(rest[corner][axis]) * weights[corner];
                *sum |= pixels & (of(0) + of(1) + of(2));
            }
        }
        for (axis, sum) in surface.normal.iter_mut().enumerate() {
            let of = |corner: usize| Eight::splat(normals[corner][axis]) * weights[corner];
            *sum |= pixels & (of(0) + of(1) + of(2));
        }
        for (sum, colour) in surface.colour.iter_mut().zip(material.colour) {
            *sum |= pixels & Eight::splat(colour);
        }
        surface.metallic |= pixels & Eight::splat(material.metallic);
        surface.roughness |= pixels & Eight::splat(material.roughness);
    }

    /// Adds what lies on the colour of tissue.
    fn add_paint(&self, surface: &mut Surface, shown: &Shown, painted: Option<&PaintedPixels<'_>>) {
        let Some(PaintedPixels { paint, pixels, rest, .. }) = painted else { return };
        let (pixels, rest) = (*pixels, *rest);
        let depths = pixels.bitselect(shown.depth, Eight::splat(f32::MAX)).to_array();
        let nearest = depths.into_iter().fold(f32::MAX, f32::min);
        let found = paint.at(rest, nearest * self.width);
        for (sum, factor) in surface.colour.iter_mut().zip(found.colour) {
            *sum = pixels.bitselect(*sum * factor, *sum);
        }
        for (sum, tilt) in surface.normal.iter_mut().zip(found.tilt) {
            *sum = pixels.bitselect(*sum + tilt, *sum);
        }
        let rough = surface.roughness;
        surface.roughness = pixels.bitselect(rough * found.roughness, rough);
    }

    fn lit(&self, surface: &Surface, ray: &Triple, place: Triple) -> Triple {
        let number = Eight::splat;
        let (zero, one) = (number(0.0), number(1.0));
        let normal = surface.normal;
        let view = unit(ray.map(|part| -part));
        let (lamp, strength) = self.towards_lamp(&place);
        let [towards_lamp, towards_view] = [dot(&normal, &lamp), dot(&normal, &view)];
        let facing_lamp = towards_lamp.max(zero);
        let facing_view = towards_view.max(number(1e-3));

        // The mirrors: how many face half-way, how many hide each other, how much each reflects. The sum of two
        // unit vectors is twice as long as either reaches along it.
        let reach = (number(0.5) + number(0.5) * dot(&view, &lamp)).max(number(1e-12)).sqrt();
        let facing_half = ((towards_lamp + towards_view) * number(0.5) / reach).max(zero);
        let alpha = surface.roughness * surface.roughness;
        let squared = alpha * alpha;
        let spread = facing_half * facing_half * (squared - one) + one;
        let k = alpha * number(0.5);
        let hidden = (facing_view * (one - k) + k) * (facing_lamp * (one - k) + k);
        // Their density times 1/π, which the lamp's brightness holds.
        let glint = squared * number(0.25) / (spread * spread * hidden);
        let grazing = one - reach;
        let grazing = grazing * grazing * grazing * grazing * grazing;

        let shadow = match self.shadow {
            Some(map) if facing_lamp.simd_gt(zero).any() => map.light(place, normal),
            _ => one,
        };
        let lamp_part = facing_lamp * shadow * strength;

        // What the theatre sends back, by Karis' fit.
        let (rough, facing_view) = (surface.roughness, facing_view);
        let r = [
            one - rough,
            number(0.0425) - number(0.0275) * rough,
            number(1.04) - number(0.572) * rough,
            number(0.022) * rough - number(0.04),
        ];
        let fade = fifth_power_of_two(facing_view * number(-9.28));
        let a = (r[0] * r[0]).min(fade) * r[0] + r[1];
        let (mirror_scale, mirror_shift) = (number(-1.04) * a + r[2], number(1.04) * a + r[3]);
        let reflected = {
            let twice = number(2.0) * towards_view;
            let direction: Triple = std::array::from_fn(|axis| normal[axis] * twice - view[axis]);
            self.theatre(&direction, &lamp, rough)
        };
        let up = number(0.5) + number(0.5) * normal[2];

        let light = &self.scene.light;
        std::array::from_fn(|channel| {
            let colour = surface.colour[channel];
            let base = number(0.04) + (colour - number(0.04)) * surface.metallic;
            let matt = colour * (one - surface.metallic);
            let fresnel = base + (one - base) * grazing;
            let ground = number(light.ground[channel]);
            let around = ground + (number(light.sky[channel]) - ground) * up;
            let lamp = number(light.lamp[channel]) * lamp_part;
            let mirrored = reflected[channel] * (base * mirror_scale + mirror_shift);
            let sum = matt * (lamp + around) + lamp * glint * fresnel + mirrored;
            shoulder(sum)
        })
    }

    /// The directions of the lamp from eight places, and how bright it is there.
    fn towards_lamp(&self, at: &Triple) -> (Triple, Eight) {
        /// So much brighter the nearest surfaces are at most: what is nearer hides the lamp.
        const BRIGHTEST: f32 = 8.0;
        let number = Eight::splat;
        match &self.lamp {
            Lamp::Far(direction) => (direction.map(number), number(1.0)),
            Lamp::Near { place, axis } => {
                let way: Triple = std::array::from_fn(|axis| number(place[axis]) - at[axis]);
                let squared = dot(&way, &way).max(number(1e-12));
                let direction = way.map(|part| part / squared.sqrt());
                let falloff = number((WORKING_DISTANCE * WORKING_DISTANCE) as f32) / squared;
                // The beam is brightest along its axis.
                let along = (-dot(&direction, &axis.map(number))).max(number(0.0));
                let beam = along * along;
                (direction, falloff.min(number(BRIGHTEST)) * beam * beam)
            }
        }
    }

    /// What comes from a direction of the theatre: floor, walls and ceiling, and a wide bright field about
    /// the lamp, whose edge is as soft as the surface is rough.
    fn theatre(&self, direction: &Triple, lamp: &Triple, rough: Eight) -> Triple {
        let number = Eight::splat;
        let light = &self.scene.light;
        let height = direction[2];
        // From the floor (−1) over the horizon to the ceiling.
        let rise = smooth((height + number(0.25)) * (one_over(number(0.3) + rough)));
        // A lamp at the endoscope is too small to be seen in mirrors but as a glint.
        let glow = match self.lamp {
            Lamp::Far(_) => number(0.95) - number(0.55) * rough,
            Lamp::Near { .. } => number(0.0),
        };
        let field = dot(direction, lamp) - number(0.55) + rough * number(0.2);
        let field = smooth(field * one_over(number(0.12) + number(0.6) * rough));
        std::array::from_fn(|channel| {
            let ground = number(light.ground[channel] * 0.9);
            let sky = number(light.sky[channel] * 1.5);
            ground + (sky - ground) * rise + field * glow * number(light.lamp[channel])
        })
    }
}

/// Those of eight pixels that show tissue.
struct PaintedPixels<'a> {
    paint: &'a Paint,
    instance: u32,
    pixels: Eight,
    /// Where that is in the body at rest, m.
    rest: Triple,
}

impl<'a> PaintedPixels<'a> {
    fn none(paint: &'a Paint, instance: u32) -> Self {
        let zero = Eight::new([0.0; LANES]);
        Self { paint, instance, pixels: zero, rest: [zero; 3] }
    }
}

/// A surface under eight pixels.
struct Surface {
    normal: Triple,
    colour: Triple,
    metallic: Eight,
    roughness: Eight,
}

impl Surface {
    /// All bits 0: those of pixels are added.
    const NONE: Self = {
        let zero = Eight::new([0.0; LANES]);
        Self { normal: [zero; 3], colour: [zero; 3], metallic: zero, roughness: zero }
    };
}

fn dot(a: &Triple, b: &Triple) -> Eight {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(vector: Triple) -> Triple {
    let scale = Eight::splat(1.0) / dot(&vector, &vector).max(Eight::splat(1e-12)).sqrt();
    vector.map(|part| part * scale)
}

fn one_over(number: Eight) -> Eight {
    Eight::splat(1.0) / number
}

/// 0 below 0, 1 above 1, and no edge in between.
fn smooth(number: Eight) -> Eight {
    let t = number.max(Eight::splat(0.0)).min(Eight::splat(1.0));
    t * t * (Eight::splat(3.0) - Eight::splat(2.0) * t)
}

/// Roughly 2 to the power of a number from −9.28 to 0: (1 + n·ln 2 / 16)^16.
fn fifth_power_of_two(number: Eight) -> Eight {
    let t = Eight::splat(1.0) + number * Eight::splat(std::f32::consts::LN_2 / 16.0);
    let t = t * t;
    let t = t * t;
    let t = t * t;
    t * t
}

/// Light as a picture can show it: the same up to 0.7, then ever less, below 1.
fn shoulder(light: Eight) -> Eight {
    let is_bright = light.simd_gt(Eight::splat(0.7));
    if is_bright.none() {
        return light;
    }
    let bright = Eight::splat(1.0) - Eight::splat(0.09) / (light - Eight::splat(0.4));
    is_bright.bitselect(bright, light)
}

/// Parts of the light, 0 to 1, for which there are bytes.
const LIGHTS: usize = 4096;

/// How pictures store them.
static BYTES: LazyLock<[u8; LIGHTS]> = LazyLock::new(|| {
    std::array::from_fn(|step| {
        let light = step as f32 / (LIGHTS - 1) as f32;
        (material::stored(light) * 255.0 + 0.5) as u8
    })
});

/// The byte for a part of the light, 0 to 1.
pub(super) fn byte(light: f32) -> u8 {
    let step = light * (LIGHTS - 1) as f32 + 0.5;
    BYTES[(step as usize).min(LIGHTS - 1)]
}

/// The bytes of eight pixels: red, green, blue of each.
pub(super) fn bytes(light: &Triple) -> [u8; 3 * LANES] {
    let (most, half) = (Eight::splat((LIGHTS - 1) as f32), Eight::splat(0.5));
    let table = &*BYTES;
    let steps = light.each_ref().map(|light| {
        let step = (*light * most + half).fast_max(half).fast_min(most);
        step.fast_trunc_int().to_array()
    });
    std::array::from_fn(|at| table[steps[at % 3][at / 3] as usize % LIGHTS])
}
