//! `trocar replay`: plays recordings again, and compares every state that was recorded, bit by bit.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use serde::Serialize;
use trocar_server::Registry;
use trocar_server::recording::{self, Course, Replay as Replaying};
use trocar_server::service::StopSignal;
use trocar_server::view::View;
use trocar_server::view::replay_source::ReplaySource;

use crate::exit::Exit;
use crate::output;
use crate::render::image::Image;
use crate::render::look::{Format, GAP, Look};
use crate::render::moments::{Moment, Moments};
use crate::serve::parse_address;

/// Play a recording again, compare its bits, draw it.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar replay pick.trocar                               the episodes, and whether bits differ
  trocar replay pick.trocar --out pick.gif --camera endoscope
  trocar replay pick.trocar --episode 2 --out third.png --moments 6
  trocar replay pick.trocar --view 8080                   in the browser, with a slider for the time
  trocar replay --json ~/.local/state/trocar/failures/*.trocar

A recording that was cut off is played up to its last whole part. Where the bits of a state are
not those that were recorded, it says which and fails. With --json, an episode a line: {file,
episode, task, seed, number, steps, snapshots, return, success, failed}.")]
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
        output::check_file(self.out.as_deref())?;
        let registry = Registry::builtin();
        let header =
            ["file", "episode", "task", "seed", "steps", "snapshots", "return", "ends in success"];
        let mut table = output::table(&header, 3);
        let (mut rows, mut film) = (vec![], vec![]);
        let mut watched = vec![];
        for file in &self.files {
            let name = file.display().to_string();
            let bytes =
                std::fs::read(file).map_err(|error| Exit::Usage(format!("{name}: {error}")))?;
            let (courses, lost) = recording::read_whole(&bytes).with_context(|| name.clone())?;
            let last = courses.len() - 1;
            let chosen = courses.into_iter().enumerate();
            let chosen: Vec<_> = chosen
                .filter(|(index, _)| self.episode.is_none_or(|wanted| wanted == *index))
                .collect();
            if self.view.is_some() {
                let courses = chosen.iter().map(|(_, course)| course.clone()).collect();
                watched.push((short(file), courses));
            }
            for (index, course) in chosen {
                let (row, moments) = self
                    .play(&registry, &name, index, course, format)
                    .with_context(|| name.clone())?;
                if self.json {
                    output::json_line(&row)?;
                }
                match format {
                    Some(Format::Sheet) => rows.push(self.look.row(&moments)?),
                    Some(Format::Moving) => film.extend(moments),
                    None => {}
                }
                if lost > 0 && index == last {
                    eprintln!(
                        "{name}: cut off, {lost} bytes of an unfinished part are left out; it ends at step {} of \
                         episode {index}",
                        row.steps
                    );
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
                Format::Moving => self.look.write_film(path, &film)?,
            }
            eprintln!("wrote {}", path.display());
        }
        match self.view {
            Some(address) => serve(address, ReplaySource::new(registry, watched)?),
            None => Ok(()),
        }
    }

    /// Plays an episode, and collects what a file of this format shows of it.
    fn play(
        &self,
        registry: &Registry,
        file: &str,
        index: usize,
        course: Course,
        format: Option<Format>,
    ) -> anyhow::Result<(Row, Vec<Moment>)> {
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
        let seconds = replay.env().spec().seconds_per_step;
        let mut moments = format.map(|format| self.look.moments(format, seconds));
        if let Some(moments) = &mut moments {
            moments.see(replay.env().stage(), || replay.env().scene());
        }
        let parts = moments.as_ref().map_or(1, Moments::parts);
        loop {
            let stage = replay.env().stage();
            let mut see = |scene| {
                if let Some(moments) = &mut moments {
                    moments.see(stage, || scene);
                }
            };
            let Some(step) = replay.next_in_parts(parts, &mut see) else { break };
            let step = step?;
            row.steps += 1;
            row.total += f64::from(step.reward);
            row.success = step.is_success;
            if let Some(moments) = moments.as_mut().filter(|_| !replay.has_failed()) {
                moments.see(replay.env().stage(), || replay.env().scene());
            }
        }
        row.failed = replay.has_failed();
        Ok((row, moments.map_or_else(Vec::new, Moments::into_list)))
    }
}

/// A file's name without its folders.
fn short(file: &Path) -> String {
    file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned()
}

/// Serves the page that plays recordings until Ctrl-C.
fn serve(address: SocketAddr, replays: ReplaySource) -> anyhow::Result<()> {
    let view =
        View::start(address, Arc::new(replays)).with_context(|| format!("--view {address}"))?;
    let stop = StopSignal::default();
    let on_signal = stop.clone();
    ctrlc::set_handler(move || on_signal.set())?;
    eprintln!("watch it at http://{}/; Ctrl-C ends it", view.address());
    while !stop.is_set() {
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}
