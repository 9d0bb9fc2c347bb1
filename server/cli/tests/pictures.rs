//! The pictures of every task are those of `assets/pictures`, as nearly as floating point goes.
//!
//! `make pictures` writes them anew. Where one differs, the test leaves a sheet with what was expected, what
//! was found, and their difference.

use std::path::{Path, PathBuf};
use std::process::Command;

use trocar_server::Registry;

/// How far a channel of a pixel may be off, of 255: elementary functions and shading may round otherwise on
/// another machine, and an edge may fall on the other side of a sample.
const CHANNEL: u8 = 12;

/// How many pixels in a thousand may be further off.
const OFTEN: usize = 5;

struct Image {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

fn read(path: &Path) -> Image {
    let file = std::fs::File::open(path)
        .unwrap_or_else(|error| panic!("{}: {error}; `make pictures` writes it", path.display()));
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
    let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut rgb).unwrap();
    assert_eq!(info.color_type, png::ColorType::Rgb);
    Image { width: info.width as usize, height: info.height as usize, rgb }
}

fn write(path: &Path, image: &Image) {
    let file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    let mut encoder = png::Encoder::new(file, image.width as u32, image.height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&image.rgb).unwrap();
}

/// Pixels in a thousand that are off.
fn difference(one: &Image, other: &Image) -> usize {
    let is_off = |(a, b): (&[u8], &[u8])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > CHANNEL);
    let pixels = one.rgb.chunks_exact(3).zip(other.rgb.chunks_exact(3));
    pixels.filter(|pair| is_off(*pair)).count() * 1000 / (one.width * one.height)
}

/// Expected, found, and eight times their difference, side by side.
fn sheet(expected: &Image, found: &Image) -> Image {
    let mut rgb = Vec::with_capacity(3 * expected.rgb.len());
    let lines = expected.rgb.chunks_exact(3 * expected.width);
    for (one, other) in lines.zip(found.rgb.chunks_exact(3 * expected.width)) {
        rgb.extend_from_slice(one);
        rgb.extend_from_slice(other);
        rgb.extend(one.iter().zip(other).map(|(a, b)| a.abs_diff(*b).saturating_mul(8)));
    }
    Image { width: 3 * expected.width, height: expected.height, rgb }
}

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets/pictures")
}

#[test]
fn every_task_looks_as_it_did() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("pictures");
    let output = Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(["render", "--each"])
        .arg(&folder)
        .env("TROCAR_LOG", "warn")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut changed = vec![];
    for task in Registry::builtin().ids() {
        let expected = read(&golden().join(format!("{task}.png")));
        let found = read(&folder.join(format!("{task}.png")));
        assert_eq!((expected.width, expected.height), (found.width, found.height), "{task}");
        let off = difference(&expected, &found);
        if off > OFTEN {
            let path = folder.join(format!("{task}-difference.png"));
            write(&path, &sheet(&expected, &found));
            changed.push(format!("{task}: {off} of 1000 pixels, see {}", path.display()));
        }
    }
    assert!(changed.is_empty(), "`make pictures` makes these the expected ones: {changed:#?}");
}

#[test]
fn a_cavity_is_darker_and_other_looks_are_refused() {
    let sheet = |look: &str| {
        let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{look}.png"));
        let output = Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(["render", "--task", "NeedleReach-v0", "--size", "64x48", "--look", look])
            .args(["--camera", "endoscope", "--moments", "1", "--out"])
            .arg(&path)
            .output()
            .unwrap();
        (path, output)
    };
    let light = |look: &str| {
        let (path, output) = sheet(look);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        read(&path).rgb.iter().map(|byte| u64::from(*byte)).sum::<u64>()
    };
    let (bench, cavity) = (light("bench"), light("cavity"));
    assert!(0 < cavity && cavity < bench, "{cavity} of {bench}");
    let (_, refused) = sheet("night");
    let told = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && told.contains("cavity"), "{told}");
}

#[test]
fn a_change_that_can_be_seen_is_found() {
    let expected = read(&golden().join("NeedlePick-v0.png"));
    let shifted = Image { rgb: [&expected.rgb[12..], &expected.rgb[..12]].concat(), ..expected };
    let expected = read(&golden().join("NeedlePick-v0.png"));
    assert_eq!(difference(&expected, &expected), 0);
    assert!(difference(&expected, &shifted) > OFTEN);
    let sheet = sheet(&expected, &shifted);
    assert_eq!(sheet.rgb.len(), 3 * sheet.width * sheet.height);
}
