//! What tissues look like: how lobules, vessels and spots of the [`texture`](super::texture) lie on a soft body, and how
//! they change its colour and its relief. They are bound to the body at rest, so they move and stretch with it.

use wide::f32x8;

use super::texture::{EDGE, LEVELS, Texture};
use crate::sim::random::Rng;

/// The looks of a material beside its colour and gloss.
#[derive(Debug, PartialEq)]
pub struct Tissue {
    /// Its row in `assets/materials.csv`.
    material: &'static str,
    /// Edge of a texel, m; a lobule is eight across.
    texel: f32,
    /// How much brighter and darker spots are, as a part of the colour.
    spots: f32,
    /// The colour between lobules, as a part of that on them.
    between: [f32; 3],
    /// The colour of vessels, as a part of that beside them.
    vessel: [f32; 3],
    /// How high lobules are, m.
    relief: f32,
}

/// Judged by the eye, beside photographs of laparoscopy: lobules of fat are 3 to 5 mm wide, those of liver 1 to 1.5 mm.
static TISSUES: [Tissue; 4] = [
    Tissue {
        material: "fat",
        texel: 0.5e-3,
        spots: 0.35,
        between: [0.93, 0.80, 0.66],
        vessel: [0.84, 0.38, 0.32],
        relief: 0.40e-3,
    },
    Tissue {
        material: "liver",
        texel: 0.18e-3,
        spots: 0.50,
        between: [0.78, 0.70, 0.70],
        vessel: [0.80, 0.60, 0.60],
        relief: 0.05e-3,
    },
    Tissue {
        material: "gallbladder",
        texel: 0.4e-3,
        spots: 0.35,
        between: [1.0, 1.0, 1.0],
        vessel: [1.10, 0.35, 0.45],
        relief: 0.06e-3,
    },
    Tissue {
        material: "phantom",
        texel: 0.6e-3,
        spots: 0.12,
        between: [0.97, 0.96, 0.96],
        vessel: [1.0, 1.0, 1.0],
        relief: 0.03e-3,
    },
];

impl Tissue {
    /// That of a material, where it has one.
    pub fn of(material: &str) -> Option<&'static Self> {
        TISSUES.iter().find(|tissue| tissue.material == material)
    }
}

/// A tissue on a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Paint {
    tissue: &'static Tissue,
    /// Where in the texture the body's frame is, texels.
    shift: [f32; 3],
}

/// What a painted surface is like at eight places.
pub(super) struct Painted {
    /// Factors on red, green, blue.
    pub(super) colour: [f32x8; 3],
    /// Factor on the roughness: fluid stands between lobules.
    pub(super) roughness: f32x8,
    /// What is to be added to the unit normal, in the axes of the body at rest.
    pub(super) tilt: [f32x8; 3],
}

impl Paint {
    /// A tissue on a body; `rng` draws where its vessels and lobules are.
    pub fn new(tissue: &'static Tissue, rng: &mut Rng) -> Self {
        let shift = [(); 3].map(|()| rng.uniform(0.0, EDGE as f64) as f32);
        Self { tissue, shift }
    }

    /// At eight places of the body at rest, m, of which a pixel shows `width` m.
    pub(super) fn at(&self, rest: [f32x8; 3], width: f32) -> Painted {
        let Tissue { texel, spots, between, vessel, relief, .. } = self.tissue;
        let number = f32x8::splat;
        let (one, half) = (number(1.0), number(0.5));
        let texels = Self::turned(rest);
        let texels: [f32x8; 3] = std::array::from_fn(|axis| {
            texels[axis] * number(1.0 / texel) + number(self.shift[axis])
        });
        let mut level = 0;
        let mut across = width / (1.4 * texel);
        while across > 1.0 && level + 1 < LEVELS {
            (level, across) = (level + 1, 0.5 * across);
        }
        let found = Texture::shared().at(texels, level);
        let spots = one + (found.mottle - half) * number(2.0 * spots);
        let colour = std::array::from_fn(|channel| {
            let lobule = number(between[channel]);
            let lobule = lobule + (one - lobule) * found.height;
            let vessel = one + number(vessel[channel] - 1.0) * found.vessel;
            spots * lobule * vessel
        });
        let steepness = number(-relief / texel);
        let tilt = Self::turned_back(found.slope.map(|slope| slope * steepness));
        Painted { colour, roughness: number(0.75) + number(0.4) * found.height, tilt }
    }

    /// Factors on red, green, blue at a place of the body at rest, m, seen from near by.
    pub fn colour_at(&self, rest: [f32; 3], width: f32) -> [f32; 3] {
        self.at(rest.map(f32x8::splat), width).colour.map(|eight| eight.as_array()[0])
    }

    /// The texture is turned like this in the body, so that no flat face shows it repeat itself: rows of a rotation.
    const ROTATION: [[f32; 3]; 3] = [
        [0.652_946, -0.652_274, -0.384_968],
        [0.470_555, 0.747_630, -0.468_645],
        [0.593_498, 0.124_851, 0.795_093],
    ];

    fn turned(place: [f32x8; 3]) -> [f32x8; 3] {
        Self::ROTATION.map(|[x, y, z]| {
            f32x8::splat(x) * place[0] + f32x8::splat(y) * place[1] + f32x8::splat(z) * place[2]
        })
    }

    fn turned_back(vector: [f32x8; 3]) -> [f32x8; 3] {
        let [x, y, z] = Self::ROTATION;
        std::array::from_fn(|axis| {
            f32x8::splat(x[axis]) * vector[0]
                + f32x8::splat(y[axis]) * vector[1]
                + f32x8::splat(z[axis]) * vector[2]
        })
    }
}
