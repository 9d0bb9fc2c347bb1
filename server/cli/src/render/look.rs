//! From where a scene is looked at, what of it is shown, and into what kind of file.

use std::path::Path;

use anyhow::Context;
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use trocar_proto::{OptionValue, Options};
use trocar_server::render::{Camera, Canvas, Picture, Renderer, Software};

use super::film;
use super::image::Image;
use super::moments::{self, Moment, Moments, Sight};
use super::place::{self, Place};
use crate::exit::Exit;

/// Pixels between pictures of a sheet.
pub(crate) const GAP: usize = 4;

/// Most pictures a second: players slow down those that are shown for less than 2/100 s.
const MOST_FPS: i64 = 50;

/// How moving pictures are drawn: four samples a pixel, where [`Software::fine`] takes nine.
const FILM: Software = Software { shadow: 512, samples: 2, parallel: true };

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
    /// In a contact sheet: how many moments of an episode, first those at which the expert's stage changes
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=100))]
    moments: u32,
    /// In a moving picture: pictures in a second of simulated time
    #[arg(long, default_value_t = 25, value_parser = clap::value_parser!(u32).range(1..=MOST_FPS))]
    fps: u32,
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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
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
    /// Ready to collect what a file of this format shows of an episode with steps of so many seconds.
    pub(crate) fn moments(&self, format: Format, seconds_per_step: f64) -> Moments {
        match format {
            Format::Sheet => Moments::each_step(),
            Format::Moving => Moments::per_second(self.fps, seconds_per_step),
        }
    }

    /// A row of a contact sheet: the moments of an episode that tell most, beside each other.
    pub(crate) fn row(&self, episode: &[Moment]) -> anyhow::Result<Image> {
        let stages: Vec<_> = episode.iter().map(|moment| moment.stage).collect();
        let chosen = moments::chosen(&stages, self.moments as usize);
        let pictures: Result<Vec<_>, _> =
            chosen.into_iter().map(|index| self.picture(&episode[index].sight)).collect();
        Ok(Image::beside(&pictures?, GAP))
    }

    /// Writes episodes one after the other as a moving picture.
    pub(crate) fn write_film(&self, path: &Path, episodes: &[Moment]) -> anyhow::Result<()> {
        // On a terminal only.
        let bar = ProgressBar::new((episodes.len() + film::SAMPLED) as u64);
        let draw = |index: usize| {
            bar.inc(1);
            self.drawn(&FILM, &episodes[index].sight)
        };
        film::write(path, self.fps, episodes.len(), draw)?;
        bar.finish_and_clear();
        Ok(())
    }

    /// All that is shown of one moment, side by side.
    pub(crate) fn picture(&self, sight: &Sight) -> anyhow::Result<Image> {
        self.drawn(&Software::fine(), sight)
    }

    /// Width and height of each picture, pixels.
    pub(super) fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The cameras as options of a session's view, each with the index of its lens there.
    pub(super) fn views(&self) -> anyhow::Result<Vec<(Options, usize)>> {
        if self.show != [Layer::Rgb] {
            let text = "--show: a server draws colours only; allowed is rgb";
            return Err(Exit::Usage(text.into()).into());
        }
        let [width, height] = self.size.map(|pixels| pixels as f64);
        let size = OptionValue::Numbers(vec![height, width]);
        let view =
            |camera| Options::new().with_text("camera", camera).with("image_size", size.clone());
        if let (Some(eye), Some(target)) = (self.eye, self.target) {
            let placed = view("placed")
                .with("camera_eye", OptionValue::Numbers(eye.to_vec()))
                .with("camera_target", OptionValue::Numbers(target.to_vec()))
                .with("camera_view", OptionValue::Number(self.fov));
            return Ok(vec![(placed, 0)]);
        }
        let of_place = |place: &Place| match place {
            Place::Overview => (view("overview"), 0),
            Place::Endoscope => (view("endoscope"), 0),
            Place::Left => (view("stereo"), 0),
            Place::Right => (view("stereo"), 1),
        };
        Ok(self.camera.iter().map(of_place).collect())
    }

    fn drawn(&self, renderer: &Software, sight: &Sight) -> anyhow::Result<Image> {
        let scene = match sight {
            Sight::Scene(scene) => scene,
            Sight::Image(image) => return Ok(Image::clone(image)),
        };
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
        let mut parts = Vec::new();
        for camera in &cameras {
            let mut picture = Picture::new(width, height);
            let canvas = picture.canvas();
            let needs_bodies = self.show.iter().any(|layer| *layer != Layer::Rgb);
            let canvas =
                if needs_bodies { canvas } else { Canvas { depth: None, mask: None, ..canvas } };
            renderer.render(scene, camera, canvas);
            parts.extend(self.show.iter().map(|layer| Image::of(&picture, *layer)));
        }
        Ok(Image::beside(&parts, 0))
    }
}
