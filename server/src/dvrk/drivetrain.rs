//! What lies between an arm's encoders and its links.
//!
//! A controller commands and measures encoders; objects feel the links. Both are the same on a perfect arm. On a real
//! one they differ, by an error of homing to begin with.

use super::planner::Axes;

/// The drivetrain of one arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Drivetrain {
    /// What each link really is, less what its encoder says, rad or m.
    offsets: Axes,
}

impl Drivetrain {
    /// One of links that are where their encoders say, but for these offsets, rad or m: an error of homing.
    pub fn new(offsets: impl IntoIterator<Item = f64>) -> Self {
        Self { offsets: offsets.into_iter().collect() }
    }

    /// Where the links are when the encoders say this.
    pub fn links(&self, encoders: &[f64]) -> Axes {
        encoders.iter().zip(&self.offsets).map(|(encoder, offset)| encoder + offset).collect()
    }

    /// What the encoders say when the links are there.
    pub fn encoders(&self, links: &[f64]) -> Axes {
        links.iter().zip(&self.offsets).map(|(link, offset)| link - offset).collect()
    }
}
