//! From where a scene is looked at, what of it is shown, and into what kind of file.

use std::path::Path;

use anyhow::Context;
use clap::{Args, ValueEnum};
use trocar_server::render::{Camera, Renderer, Scene, Software};

use super::image::Image;
use super::place::{self, Place};
use crate::exit::Exit;

/// Pixels between pictures of a sheet.
pub(crate) const GAP: usize = 4;

/// How scenes become pictures.
#[derive(Debug, Args)]
pub(crate) struct Look {
    /// Pictures side by side of every moment: overview, endoscope, left, right
    #[arg(long, value_enum, value_delimiter = ',', default_value = "overview,endoscope")]
    camera: Vec<Place>,
    /// Look from here instead: x, y, z, m
    #[arg(long, value_name = "X,Y,Z", value_parser = place::point, requires = "target")]
    eye: Option<[f64; 3]>,
    /// Look at this point: x, y, z, m
    #[arg(long, value_name = "X,Y,Z", value_parser = place::point, requires = "eye")]
    target: Option<[f64; 3]>,
    /// With --eye: vertical field of view, degrees
    #[arg(long, default_value_t = 45.0, value_parser = place::angle)]
    fov: f64,
    /// What is shown: rgb, depth, mask
    #[arg(long, value_enum, value_delimiter = ',', default_value = "rgb")]
    show: Vec<Layer>,
    /// Width and height of each picture, pixels
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "320x240", value_parser = place::size)]
    size: [usize; 2],
}

/// What of a picture is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Layer {
    /// Colours
    Rgb,
    /// The nearer, the brighter
    Depth,
    /// A colour for each body
    Mask,
}

/// How a file is written.
pub(crate) enum Format {
    Sheet,
    Moving,
}

impl Format {
    /// What the name of a file asks for.
    pub(crate) fn of(path: &Path) -> anyhow::Result<Self> {
        let extension =
            path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        match extension.to_ascii_lowercase().as_str() {
            "png" => Ok(Self::Sheet),
            "gif" => Ok(Self::Moving),
            "mp4" => {
                let why = "MP4 is not written: no well-kept encoder works without other programs; write a .gif";
                Err(Exit::Usage(why.into()).into())
            }
            _ => {
                let text = format!("{}: the name ends neither in .png nor in .gif", path.display());
                Err(Exit::Usage(text).into())
            }
        }
    }
}

impl Look {
    /// So many moments of an episode, the first and last among them, beside each other.
    pub(crate) fn row(&self, episode: &[Scene], moments: u32) -> anyhow::Result<Image> {
        let count = (moments as usize).min(episode.len());
        let moment = |index: usize| index * (episode.len() - 1) / (count - 1).max(1);
        let pictures: Result<Vec<_>, _> =
            (0..count).map(|index| self.picture(&episode[moment(index)])).collect();
        Ok(Image::beside(&pictures?, GAP))
    }

    /// All that is shown of one moment, side by side.
    pub(crate) fn picture(&self, scene: &Scene) -> anyhow::Result<Image> {
        let [width, height] = self.size;
        let cameras: Vec<Camera> = if let (Some(eye), Some(target)) = (self.eye, self.target) {
            vec![place::towards(eye, target, self.fov)?.camera(width, height)]
        } else {
            let camera = |place: &Place| {
                let camera = scene.camera(place.lens(), width, height);
                camera.context("this task's scene has no endoscope")
            };
            self.camera.iter().map(camera).collect::<anyhow::Result<_>>()?
        };
        let renderer = Software::fine();
        let mut parts = Vec::new();
        for camera in &cameras {
            let picture = renderer.picture(scene, camera);
            parts.extend(self.show.iter().map(|layer| Image::of(&picture, *layer)));
        }
        Ok(Image::beside(&parts, 0))
    }
}
