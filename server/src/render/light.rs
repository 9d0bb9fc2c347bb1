//! From where light comes: the lamps of a theatre, or the endoscope in a dark cavity.

use nalgebra::Vector3;

/// Where the lamp is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lamp {
    /// So far away that its rays are parallel: the unit vector towards it.
    Far(Vector3<f64>),
    /// At the endoscope, between its lenses. It shines along the endoscope's axis and throws no shadow that the
    /// endoscope could see.
    AtEndoscope,
}

/// A lamp, and the light that comes from everywhere else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Where the lamp is.
    pub place: Lamp,
    /// Red, green, blue of the lamp on a surface that faces it; of one at the endoscope, on its axis in
    /// [`WORKING_DISTANCE`].
    pub lamp: [f32; 3],
    /// Red, green, blue from above.
    pub sky: [f32; 3],
    /// Red, green, blue from below.
    pub ground: [f32; 3],
}

/// Distance for which the brightness of a lamp at the endoscope is set, m: that of the endoscope from the middle of the
/// workspace beside PSMs. Beyond, its light falls with the square of the distance.
pub const WORKING_DISTANCE: f64 = 0.16;

/// Red, green, blue of where nothing is, on the bench and in a cavity; linear.
const BACKGROUNDS: [[f32; 3]; 2] = [[0.72, 0.76, 0.80], [0.012, 0.004, 0.004]];

/// In what light a scene is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Look {
    /// Under the lamps of a theatre, as training phantoms are seen.
    #[default]
    Bench,
    /// As in a body: the only lamp is at the endoscope, and what is far from it is dark.
    Cavity,
}

impl Look {
    /// Their names, in the order of an option's words.
    pub const NAMES: [&str; 2] = ["bench", "cavity"];

    /// The light.
    pub fn light(self) -> Light {
        match self {
            // A theatre lamp over the right shoulder of a viewer that looks from +x.
            Self::Bench => Light {
                place: Lamp::Far(Vector3::new(0.38, 0.34, 0.86).normalize()),
                lamp: [0.92, 0.885, 0.83],
                sky: [0.33, 0.35, 0.38],
                ground: [0.15, 0.142, 0.138],
            },
            // Xenon's white; what walls of tissue send back is red and faint.
            Self::Cavity => Light {
                place: Lamp::AtEndoscope,
                lamp: [1.20, 1.14, 1.06],
                sky: [0.045, 0.018, 0.015],
                ground: [0.030, 0.012, 0.010],
            },
        }
    }

    /// Red, green, blue of where nothing is; linear.
    pub fn background(self) -> [f32; 3] {
        BACKGROUNDS[self as usize]
    }
}
