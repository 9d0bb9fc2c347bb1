//! `trocar replay`: plays recordings again, and compares every state that was recorded, bit by bit.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use serde::Serialize;
use trocar_server::env::recording::{self, Course, Replay as Replaying};
use trocar_server::render::Scene;
use trocar_server::service::StopSignal;
use trocar_server::tasks::Registry;
use trocar_server::view::View;
use trocar_server::view::reel::Reel;

use crate::output;
use crate::render::image::{self, Image};
use crate::render::look::{Format, GAP, Look};
use crate::serve::parse_address;

/// Play a recording again, compare its bits, draw it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar replay pick.trocar                               what happened, and whether it is still the same
  trocar replay pick.trocar --out pick.gif --camera endoscope
  trocar replay pick.trocar --episode 2 --out third.png --moments 6
  trocar replay pick.trocar --view 8080                   in the browser, with a slider for the time
  trocar replay --json ~/.local/state/trocar/failures/*.trocar

Where the bits of a state are not those that were recorded, it says which and fails. With --json, an episode a
line: {file, episode, task, seed, number, steps, snapshots, return, success, failed}.")]
pub(crate) struct Replay {
    /// Recordings of `trocar record`, or of failures
    #[arg(required = true, value_name = "FILE.trocar")]
    files: Vec<PathBuf>,
    /// Only this episode of each file, counted from 0
    #[arg(long, value_name = "K")]
    episode: Option<usize>,
    /// Draw them: .png is a contact sheet, .gif moves
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// In a contact sheet: how many moments of an episode
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=100))]
    moments: u32,
    #[command(flatten)]
    look: Look,
    /// Serve a page that plays them, until Ctrl-C, at this address: a port of 127.0.0.1, or ADDRESS:PORT
    #[arg(long, value_name = "ADDR", value_parser = parse_address)]
    view: Option<SocketAddr>,
    /// One JSON object per episode and line, on stdout
    #[arg(long)]
    json: bool,
}

/// How an episode went when it was played again.
#[derive(Debug, Serialize)]
struct Row {
    file: String,
    episode: usize,
    task: String,
    seed: u64,
    number: u64,
    steps: u32,
    snapshots: usize,
    #[serde(rename = "return")]
    total: f64,
    success: bool,
    failed: bool,
}

impl Replay {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let format = self.out.as_deref().map(Format::of).transpose()?;
        let registry = Registry::builtin();
        let header =
            ["file", "episode", "task", "seed", "steps", "snapshots", "return", "ends in success"];
        let mut table = output::table(&header, 3);
        let (mut rows, mut frames, mut seconds) = (vec![], vec![], 0.1);
        let mut watched = vec![];
        for file in &self.files {
            let name = file.display().to_string();
            let bytes = std::fs::read(file).with_context(|| format!("reading {name}"))?;
            let courses = recording::read(&bytes).with_context(|| name.clone())?;
            let chosen = courses.into_iter().enumerate();
            let chosen: Vec<_> = chosen
                .filter(|(index, _)| self.episode.is_none_or(|wanted| wanted == *index))
                .collect();
            if self.view.is_some() {
                let courses = chosen.iter().map(|(_, course)| course.clone()).collect();
                watched.push((short(file), courses));
            }
            for (index, course) in chosen {
                let (row, scenes) = play(&registry, &name, index, course, format.is_some())
                    .with_context(|| name.clone())?;
                if self.json {
                    output::json_line(&row)?;
                }
                match format {
                    Some(Format::Sheet) => rows.push(self.look.row(&scenes, self.moments)?),
                    Some(Format::Moving) => {
                        seconds = registry
                            .spec(&row.task, &trocar_proto::Options::new())?
                            .seconds_per_step;
                        for scene in &scenes {
                            frames.push(self.look.picture(scene)?);
                        }
                    }
                    None => {}
                }
                let ending = match (row.failed, row.success) {
                    (true, _) => "simulation failed",
                    (false, true) => "yes",
                    (false, false) => "no",
                };
                table.add_row([
                    row.file,
                    index.to_string(),
                    row.task,
                    row.seed.to_string(),
                    row.steps.to_string(),
                    format!("{} same", row.snapshots),
                    format!("{:.2}", row.total),
                    ending.into(),
                ]);
            }
        }
        if table.is_empty() {
            anyhow::bail!("there is no such episode in what was given");
        }
        if !self.json {
            eprintln!("{table}");
        }
        if let (Some(path), Some(format)) = (&self.out, format) {
            match format {
                Format::Sheet => Image::below(&rows, GAP).write_png(path)?,
                Format::Moving => image::write_gif(path, &frames, seconds)?,
            }
            eprintln!("wrote {}", path.display());
        }
        match self.view {
            Some(address) => serve(address, Reel::new(registry, watched)?),
            None => Ok(()),
        }
    }
}

/// A file's name without its folders.
fn short(file: &Path) -> String {
    file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned()
}

/// Serves the page that plays recordings until Ctrl-C.
fn serve(address: SocketAddr, reel: Reel) -> anyhow::Result<()> {
    let view = View::start(address, Arc::new(reel)).with_context(|| format!("--view {address}"))?;
    eprintln!("watch it at http://{}/; Ctrl-C ends it", view.address());
    let stop = StopSignal::default();
    let on_signal = stop.clone();
    ctrlc::set_handler(move || on_signal.set())?;
    while !stop.is_set() {
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// Plays an episode; with all that there is to see if `is_drawn`.
fn play(
    registry: &Registry,
    file: &str,
    index: usize,
    course: Course,
    is_drawn: bool,
) -> anyhow::Result<(Row, Vec<Scene>)> {
    let mut row = Row {
        file: file.into(),
        episode: index,
        task: course.task().into(),
        seed: course.seed(),
        number: course.episode(),
        steps: 0,
        snapshots: course.marks(),
        total: 0.0,
        success: false,
        failed: false,
    };
    let mut replay = Replaying::new(registry, course)?;
    let mut scenes: Vec<_> = is_drawn.then(|| replay.env().scene()).into_iter().collect();
    while let Some(step) = replay.next() {
        let step = step?;
        row.steps += 1;
        row.total += f64::from(step.reward);
        row.success = step.is_success;
        if is_drawn && !replay.has_failed() {
            scenes.push(replay.env().scene());
        }
    }
    row.failed = replay.has_failed();
    Ok((row, scenes))
}
