//! Cameras as words of the command line.

use clap::ValueEnum;
use trocar_server::render::{Lens, Viewpoint};

use crate::exit::Exit;

/// A camera of a task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Place {
    /// All of the theatre
    Overview,
    /// The endoscope
    Endoscope,
    /// The left lens of the endoscope
    Left,
    /// The right lens of the endoscope
    Right,
}

impl Place {
    pub(super) fn lens(self) -> Lens {
        match self {
            Self::Overview => Lens::Overview,
            Self::Endoscope => Lens::Endoscope,
            Self::Left => Lens::Left,
            Self::Right => Lens::Right,
        }
    }
}

/// Least distance of an eye from its target along an axis, m.
const LEAST_DISTANCE: f64 = 1e-3;

/// From one point (m) towards another; `view` is in degrees.
pub(super) fn towards(eye: [f64; 3], target: [f64; 3], view: f64) -> anyhow::Result<Viewpoint> {
    if eye.iter().zip(target).all(|(eye, target)| (eye - target).abs() < LEAST_DISTANCE) {
        return Err(Exit::Usage("--eye must be 1 mm from --target at least".into()).into());
    }
    let viewpoint = Viewpoint::towards(eye, target, view.to_radians());
    Ok(Viewpoint { near: 0.005, ..viewpoint })
}

/// Reads `x,y,z`.
pub(super) fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let numbers = numbers.ok().and_then(|numbers| <[f64; 3]>::try_from(numbers).ok());
    let is_near = |point: &[f64; 3]| point.iter().all(|number| number.abs() < 100.0);
    numbers.filter(is_near).ok_or_else(|| "expected X,Y,Z in m".into())
}

/// Reads an angle of view in degrees.
pub(super) fn angle(text: &str) -> Result<f64, String> {
    let angle = text.parse().ok().filter(|angle| (1.0..=150.0).contains(angle));
    angle.ok_or_else(|| "expected 1 to 150 degrees".into())
}

/// Reads `WIDTHxHEIGHT`.
pub(super) fn size(text: &str) -> Result<[usize; 2], String> {
    let read = |text: &str| text.parse().ok().filter(|pixels| (8..=2048).contains(pixels));
    let size = text.split_once('x').and_then(|(width, height)| Some([read(width)?, read(height)?]));
    size.ok_or_else(|| "expected WIDTHxHEIGHT, each 8 to 2048".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_points_and_angles_are_read() {
        assert_eq!(size("640x480"), Ok([640, 480]));
        assert!(size("640").is_err() && size("0x9").is_err() && size("9x9000").is_err());
        assert_eq!(point("0.5, 0,-1"), Ok([0.5, 0.0, -1.0]));
        assert!(point("1,2").is_err() && point("1,2,x").is_err() && point("nan,0,0").is_err());
        assert!(angle("60").is_ok() && angle("180").is_err() && angle("nan").is_err());
        assert!(towards([0.5, 0.0, 1.0], [0.5, 0.0, 0.0], 60.0).is_ok());
        assert!(towards([0.5, 0.0, 1.0], [0.5, 0.0, 1.0], 60.0).is_err());
    }
}
