//! Pictures: colour, depth and bodies of every pixel, row by row from above.

use super::camera::Camera;
use super::scene::BodyNumber;

/// What was seen through a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green, blue of each pixel as files store them; height × width × 3.
    pub rgb: Vec<u8>,
    /// Depth of each pixel along the optical axis, m; the camera's `far` where nothing is. height × width.
    pub depth: Vec<f32>,
    /// The body that each pixel shows, 0 where nothing is; height × width.
    pub mask: Vec<BodyNumber>,
}

impl Picture {
    /// A black picture.
    pub fn new(width: usize, height: usize) -> Self {
        let pixels = width * height;
        let (rgb, depth, mask) = (vec![0; 3 * pixels], vec![0.0; pixels], vec![0; pixels]);
        Self { width, height, rgb, depth, mask }
    }

    /// All of it, to be drawn.
    pub fn canvas(&mut self) -> Canvas<'_> {
        Canvas {
            rgb: Some(&mut self.rgb),
            depth: Some(&mut self.depth),
            mask: Some(&mut self.mask),
        }
    }

    /// Where each pixel's surface is in the world, m.
    pub fn points(&self, camera: &Camera) -> impl Iterator<Item = nalgebra::Point3<f64>> {
        self.depth.iter().enumerate().map(|(index, depth)| {
            let (column, row) = (index % self.width, index / self.width);
            camera.back_project(column as f64, row as f64, f64::from(*depth))
        })
    }
}

/// Where a picture is drawn; what is not wanted is not drawn. Shapes and units are those of [`Picture`].
#[derive(Debug, Default)]
pub struct Canvas<'a> {
    /// Colours.
    pub rgb: Option<&'a mut [u8]>,
    /// Depth.
    pub depth: Option<&'a mut [f32]>,
    /// Bodies.
    pub mask: Option<&'a mut [BodyNumber]>,
}

impl Canvas<'_> {
    /// The same canvas, for a while.
    pub fn again(&mut self) -> Canvas<'_> {
        Canvas {
            rgb: self.rgb.as_deref_mut(),
            depth: self.depth.as_deref_mut(),
            mask: self.mask.as_deref_mut(),
        }
    }

    /// Checks that everything has so many pixels.
    ///
    /// # Panics
    /// Where something has more or fewer.
    pub(super) fn check(&self, pixels: usize) {
        let fits =
            |length: Option<usize>, each: usize| length.is_none_or(|has| has == each * pixels);
        let rgb = self.rgb.as_ref().map(|rgb| rgb.len());
        let depth = self.depth.as_ref().map(|depth| depth.len());
        let mask = self.mask.as_ref().map(|mask| mask.len());
        assert!(fits(rgb, 3) && fits(depth, 1) && fits(mask, 1), "a canvas has the camera's size");
    }
}
