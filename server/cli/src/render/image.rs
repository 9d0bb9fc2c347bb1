//! Colour images: put together, and written to files.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::Context;
use trocar_server::render::Picture;

use super::look::Layer;

/// Red, green, blue between pictures of a sheet.
const BACKGROUND: u8 = 255;

/// Red, green, blue, row by row from above.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Image {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) rgb: Vec<u8>,
}

impl Image {
    fn blank(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![BACKGROUND; 3 * width * height] }
    }

    /// What a layer of a picture looks like.
    pub(crate) fn of(picture: &Picture, layer: Layer) -> Self {
        let rgb = match layer {
            Layer::Rgb => picture.rgb.clone(),
            Layer::Depth => {
                let seen =
                    || picture.depth.iter().zip(&picture.mask).filter(|(_, body)| **body > 0);
                let near = seen().map(|(depth, _)| *depth).fold(f32::INFINITY, f32::min);
                let grey = |(depth, body): (&f32, &i32)| {
                    let light = if *body > 0 { (near / depth * 255.0) as u8 } else { 0 };
                    [light; 3]
                };
                picture.depth.iter().zip(&picture.mask).flat_map(grey).collect()
            }
            Layer::Mask => picture.mask.iter().flat_map(|body| colour_of(*body)).collect(),
        };
        Self { width: picture.width, height: picture.height, rgb }
    }

    /// Images side by side, `gap` pixels apart.
    pub(crate) fn beside(parts: &[Self], gap: usize) -> Self {
        let width = parts.iter().map(|part| part.width + gap).sum::<usize>().saturating_sub(gap);
        let height = parts.iter().map(|part| part.height).max().unwrap_or(0);
        let mut whole = Self::blank(width, height);
        let mut left = 0;
        for part in parts {
            whole.put(part, left, 0);
            left += part.width + gap;
        }
        whole
    }

    /// Images below each other, `gap` pixels apart.
    pub(crate) fn below(parts: &[Self], gap: usize) -> Self {
        let height = parts.iter().map(|part| part.height + gap).sum::<usize>().saturating_sub(gap);
        let width = parts.iter().map(|part| part.width).max().unwrap_or(0);
        let mut whole = Self::blank(width, height);
        let mut top = 0;
        for part in parts {
            whole.put(part, 0, top);
            top += part.height + gap;
        }
        whole
    }

    fn put(&mut self, part: &Self, left: usize, top: usize) {
        for (row, line) in part.rgb.chunks_exact(3 * part.width).enumerate() {
            let first = 3 * ((top + row) * self.width + left);
            self.rgb[first..][..line.len()].copy_from_slice(line);
        }
    }

    /// Writes it as a PNG.
    pub(crate) fn write_png(&self, path: &Path) -> anyhow::Result<()> {
        let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
        let (width, height) = (u32::try_from(self.width)?, u32::try_from(self.height)?);
        let mut encoder = png::Encoder::new(BufWriter::new(file), width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::High);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish().with_context(|| format!("writing {}", path.display()))
    }
}

/// A colour for each body that its neighbours do not have.
fn colour_of(body: i32) -> [u8; 3] {
    let mix = (body as u32).wrapping_mul(0x9e37_79b1);
    match body {
        0 => [0; 3],
        _ => [24, 16, 8].map(|shift| 64 + ((mix >> shift) as u8 / 4) * 3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(width: usize, height: usize, light: u8) -> Image {
        Image { width, height, rgb: vec![light; 3 * width * height] }
    }

    #[test]
    fn images_are_put_together() {
        let beside = Image::beside(&[plain(2, 1, 1), plain(1, 2, 2)], 1);
        let light = |image: &Image| image.rgb.iter().step_by(3).copied().collect::<Vec<_>>();
        assert_eq!((beside.width, beside.height), (4, 2));
        assert_eq!(light(&beside), [1, 1, 255, 2, 255, 255, 255, 2]);
        let below = Image::below(&[plain(1, 1, 1), plain(2, 1, 2)], 0);
        assert_eq!(light(&below), [1, 255, 2, 2]);
    }

    #[test]
    fn bodies_have_colours_of_their_own() {
        let mut colours: Vec<_> = (0..60).map(colour_of).collect();
        colours.sort_unstable();
        colours.dedup();
        assert_eq!(colours.len(), 60);
    }
}
