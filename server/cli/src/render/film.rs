//! Moving pictures: GIF files with one palette, in which only what changes is written.

use std::borrow::Cow;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, ensure};
use color_quant::NeuQuant;

use super::image::Image;

/// Colours of a palette; the number after the last stands for what stays as it was.
const COLOURS: usize = 255;

const UNCHANGED: u8 = COLOURS as u8;

/// Pictures of a film that its palette is made for.
pub(super) const SAMPLED: usize = 12;

/// Bits of a channel by which colours are told apart.
const BITS: u32 = 6;

/// Writes `count` pictures that `draw` draws, `fps` a second, as a GIF that begins anew at its end.
pub(super) fn write(
    path: &Path,
    fps: u32,
    count: usize,
    draw: impl Fn(usize) -> anyhow::Result<Image>,
) -> anyhow::Result<()> {
    ensure!(count > 0, "nothing to show");
    let sampled = SAMPLED.min(count);
    let samples: Result<Vec<_>, _> =
        (0..sampled).map(|sample| draw(sample * (count - 1) / (sampled - 1).max(1))).collect();
    let samples = samples?;
    let size = [samples[0].width, samples[0].height];
    let mut palette = Palette::of(&samples);
    let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
    let [width, height] = [u16::try_from(size[0])?, u16::try_from(size[1])?];
    let mut encoder =
        gif::Encoder::new(BufWriter::new(file), width, height, &palette.quantiser.color_map_rgb())?;
    encoder.set_repeat(gif::Repeat::Infinite)?;

    let mut shown = palette.numbers(&draw(0)?);
    let mut frame = Frame { left: 0, top: 0, width: size[0], numbers: shown.clone() };
    let mut begin = 0;
    for index in 1..=count {
        let next = if index < count {
            let image = draw(index)?;
            ensure!([image.width, image.height] == size, "pictures of several sizes");
            let numbers = palette.numbers(&image);
            // A picture like the last lengthens that one's time.
            let Some(changed) = Frame::of_changes(&shown, &numbers, size[0]) else { continue };
            shown = numbers;
            Some(changed)
        } else {
            None
        };
        let delay = hundredths(index, fps) - hundredths(begin, fps);
        encoder.write_frame(&frame.with_delay(delay)?)?;
        begin = index;
        match next {
            Some(next) => frame = next,
            None => break,
        }
    }
    Ok(())
}

/// Hundredths of a second before the picture of this index: rounded from the film's beginning, so that the film as
/// a whole is as long as it should be.
fn hundredths(index: usize, fps: u32) -> u64 {
    (index as u64 * 200 + u64::from(fps)) / (2 * u64::from(fps))
}

/// Colours for all of a film: from picture to picture, the same colour looks the same.
struct Palette {
    quantiser: NeuQuant,
    /// Numbers of colours that were looked up, by their first [`BITS`] of each channel.
    known: Vec<Option<u8>>,
}

impl Palette {
    /// Colours for images like these.
    fn of(images: &[Image]) -> Self {
        /// From 1, slow and best, to 30.
        const SPEED: i32 = 10;
        let pixels = images.iter().flat_map(|image| image.rgb.chunks_exact(3));
        let pixels: Vec<u8> =
            pixels.flat_map(|pixel| [pixel[0], pixel[1], pixel[2], u8::MAX]).collect();
        let quantiser = NeuQuant::new(SPEED, COLOURS, &pixels);
        Self { quantiser, known: vec![None; 1 << (3 * BITS)] }
    }

    /// The number of the nearest colour of each pixel.
    fn numbers(&mut self, image: &Image) -> Vec<u8> {
        let number = |pixel: &[u8]| {
            let key =
                pixel.iter().fold(0, |key, light| key << BITS | usize::from(light >> (8 - BITS)));
            let quantiser = &self.quantiser;
            *self.known[key].get_or_insert_with(|| {
                // The middle of the colours that share the key, whichever of them comes first.
                let middle = |light: u8| (light >> (8 - BITS) << (8 - BITS)) | 1 << (7 - BITS);
                let [red, green, blue] = [0, 1, 2].map(|channel| middle(pixel[channel]));
                quantiser.index_of(&[red, green, blue, u8::MAX]) as u8
            })
        };
        image.rgb.chunks_exact(3).map(number).collect()
    }
}

/// A rectangle of a picture.
struct Frame {
    left: usize,
    top: usize,
    width: usize,
    numbers: Vec<u8>,
}

impl Frame {
    /// What is `new` in pictures of this width; none where all is as it was.
    fn of_changes(old: &[u8], new: &[u8], width: usize) -> Option<Self> {
        let lines = || old.chunks_exact(width).zip(new.chunks_exact(width)).enumerate();
        let changed = || lines().filter(|(_, (old, new))| old != new);
        let (top, bottom) = (changed().next()?.0, changed().next_back()?.0);
        let differs = |(old, new): (&u8, &u8)| old != new;
        let first = |(_, (old, new)): (_, (&[u8], &[u8]))| old.iter().zip(new).position(differs);
        let last = |(_, (old, new)): (_, (&[u8], &[u8]))| old.iter().zip(new).rposition(differs);
        let (left, right) = (changed().filter_map(first).min()?, changed().filter_map(last).max()?);
        let inside = lines().skip(top).take(bottom - top + 1);
        let numbers = inside.flat_map(|(_, (old, new))| {
            let pixels = old[left..=right].iter().zip(&new[left..=right]);
            pixels.map(|(old, new)| if old == new { UNCHANGED } else { *new })
        });
        Some(Self { left, top, width: right - left + 1, numbers: numbers.collect() })
    }

    /// Shown for so many hundredths of a second.
    fn with_delay(&self, delay: u64) -> anyhow::Result<gif::Frame<'_>> {
        Ok(gif::Frame {
            left: u16::try_from(self.left)?,
            top: u16::try_from(self.top)?,
            width: u16::try_from(self.width)?,
            height: u16::try_from(self.numbers.len() / self.width)?,
            delay: u16::try_from(delay).context("a picture that does not change for minutes")?,
            transparent: Some(UNCHANGED),
            buffer: Cow::Borrowed(&self.numbers),
            ..gif::Frame::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 40;
    const HEIGHT: usize = 30;

    /// A red square of 8 × 8 pixels, so far to the right of the edge of a grey slope.
    fn square(left: usize) -> Image {
        let pixel = |index: usize| {
            let (x, y) = (index % WIDTH, index / WIDTH);
            let is_red = (left..left + 8).contains(&x) && (10..18).contains(&y);
            if is_red { [220, 30, 20] } else { [60 + 4 * y as u8; 3] }
        };
        Image { width: WIDTH, height: HEIGHT, rgb: (0..WIDTH * HEIGHT).flat_map(pixel).collect() }
    }

    /// A picture as a player shows it, and for how long, in 1/100 s.
    struct Shown {
        rgb: Vec<u8>,
        delay: u16,
        /// Width and height of what was written.
        size: [u16; 2],
    }

    fn play(path: &Path) -> Vec<Shown> {
        let mut decoder = gif::DecodeOptions::new().read_info(File::open(path).unwrap()).unwrap();
        let palette = decoder.global_palette().unwrap().to_vec();
        let (mut canvas, mut shown) = (vec![0; 3 * WIDTH * HEIGHT], vec![]);
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            assert!(frame.palette.is_none(), "one palette for all");
            let [left, top, width] = [frame.left, frame.top, frame.width].map(usize::from);
            for (index, number) in frame.buffer.iter().enumerate() {
                if frame.transparent != Some(*number) {
                    let place = (top + index / width) * WIDTH + left + index % width;
                    let colour = &palette[3 * usize::from(*number)..][..3];
                    canvas[3 * place..][..3].copy_from_slice(colour);
                }
            }
            let size = [frame.width, frame.height];
            shown.push(Shown { rgb: canvas.clone(), delay: frame.delay, size });
        }
        shown
    }

    /// Plays a film of squares at these places.
    fn film(name: &str, fps: u32, places: &[usize]) -> Vec<Shown> {
        let path = std::env::temp_dir().join(format!("trocar-film-{}-{name}", std::process::id()));
        write(&path, fps, places.len(), |index| Ok(square(places[index]))).unwrap();
        let shown = play(&path);
        std::fs::remove_file(path).unwrap();
        shown
    }

    #[test]
    fn films_show_what_was_drawn() {
        let places: Vec<_> = (0..30).collect();
        let shown = film("drawn", 25, &places);
        assert_eq!(shown.len(), 30);
        for (place, shown) in places.iter().zip(&shown) {
            let drawn = square(*place);
            let off = shown.rgb.iter().zip(&drawn.rgb).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(off < Some(12), "{place}: {off:?}");
            assert_eq!(shown.delay, 4);
        }
        // The square and the column that it left.
        assert!(shown[1..].iter().all(|shown| shown.size == [9, 8]));
    }

    #[test]
    fn what_does_not_change_does_not_flicker() {
        let shown = film("still", 25, &[0, 5, 9, 14, 20]);
        let above = |shown: &Shown| shown.rgb[..3 * WIDTH * 10].to_vec();
        assert!(shown.iter().all(|one| above(one) == above(&shown[0])));
    }

    #[test]
    fn films_are_as_long_as_they_should_be() {
        for (fps, centiseconds) in [(25, 80), (30, 67), (7, 286), (50, 40), (1, 2000)] {
            let places: Vec<_> = (0..20).collect();
            let shown = film(&format!("long-{fps}"), fps, &places);
            let delays = shown.iter().map(|shown| u32::from(shown.delay));
            assert_eq!(delays.clone().sum::<u32>(), centiseconds, "{fps} a second");
            assert!(delays.clone().max() <= delays.min().map(|least| least + 1));
        }
        // Pictures that are the same are one.
        let shown = film("same", 25, &[1, 1, 1, 2, 2]);
        assert_eq!(shown.iter().map(|shown| shown.delay).collect::<Vec<_>>(), [12, 8]);
    }

    #[test]
    fn pictures_of_several_sizes_are_no_film() {
        let path = std::env::temp_dir().join(format!("trocar-film-{}-sizes", std::process::id()));
        let draw = |index: usize| {
            let rgb = vec![index as u8; 3 * (index + 1)];
            Ok(Image { width: index + 1, height: 1, rgb })
        };
        assert!(write(&path, 25, 3, draw).unwrap_err().to_string().contains("several sizes"));
        assert!(write(&path, 25, 0, draw).is_err());
        std::fs::remove_file(path).ok();
    }
}
