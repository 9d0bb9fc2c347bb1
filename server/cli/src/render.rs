//! `trocar render`: pictures of rollouts.

mod film;
pub(crate) mod image;
pub(crate) mod look;
pub(crate) mod moments;
mod place;
mod served;

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use trocar_proto::Options;
use trocar_server::Env;

use crate::catalog::Catalog;
use crate::exit::Exit;
use crate::options::{self, Assignment, OptionFlags};
use crate::output;
use crate::policy::Chooser;
use image::Image;
use look::{Format, GAP, Look};
use moments::Moment;

/// Draw rollouts: a contact sheet, a moving picture, or one picture of each task.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar render --out all.png                                  a contact sheet: a row for each task
  trocar render --task NeedlePick-v0 --out pick.gif            a moving picture of the expert
  trocar render --task ActiveTrack-v0 --fps 50 --out track.gif smoother, in as long
  trocar render --task PegTransfer-v0 --camera endoscope --show rgb,depth,mask --out peg.png
  trocar render --task NeedlePick-v0 --eye 0.8,0.2,0.9 --target 0.55,0,0.7 --out near.png
  trocar render --task NeedlePick-v0 --look cavity --camera endoscope --out dark.png
  trocar render --policy NeedlePick --seconds 5 --out pick.gif one of `trocar policies`
  trocar render --policy policy.onnx --out trained.gif    a policy of `python -m trocar.rl export`
  trocar render --server own --task PushCube-v0 --out push.gif a task of a server of one's own
  trocar render --each pictures/                               one picture of each task

Depth is brighter the nearer; every body has a colour of its own in the mask. MP4 is not written,
since GIF needs no other program.")]
pub(crate) struct Render {
    /// A task id of `trocar tasks`, or all
    #[arg(long, default_value = "all", value_parser = crate::options::task_id)]
    task: String,
    /// The agent: oracle (the task's scripted expert), random, or a trained policy: FILE.onnx, or a
    /// name of `trocar policies`
    #[arg(long, default_value = "oracle")]
    policy: String,
    /// Seed of the episode
    #[arg(long, default_value_t = 3)]
    seed: u64,
    /// Show no more of the episode than this, s of simulated time
    #[arg(long, value_name = "SECONDS", default_value_t = f64::INFINITY, hide_default_value = true)]
    seconds: f64,
    /// Run in the server of that name, which draws colours only and the ends of steps
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    #[command(flatten)]
    look: Look,
    /// In what light: bench, or cavity (from a lamp at the endoscope); the same as --option look=WORD
    #[arg(long = "look", value_name = "WORD")]
    light: Option<String>,
    #[command(flatten)]
    options: OptionFlags,
    /// The file: .png is a contact sheet, .gif moves
    #[arg(long, value_name = "FILE", required_unless_present = "each")]
    out: Option<PathBuf>,
    /// One picture of each task, amid the episode, in this folder
    #[arg(long, value_name = "FOLDER", conflicts_with = "out")]
    each: Option<PathBuf>,
}

impl Render {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        let format = self.out.as_deref().map(Format::of).transpose()?;
        output::check_file(self.out.as_deref())?;
        let policy = Chooser::read(&self.policy)?;
        let catalog = Catalog::open(self.server.as_deref())?;
        let ids = policy.tasks(&self.task, || catalog.tasks())?;
        let light = self.light.iter().map(|word| Assignment::new("look", word));
        let given = light.chain(self.options.assignments()).collect();
        let tasks = options::for_tasks(&policy.with_options(given)?, &catalog.specs(&ids)?)?;
        let (path, format) = match (&self.each, self.out.as_ref().zip(format)) {
            (Some(folder), _) => return self.each(&catalog, &policy, &tasks, folder),
            (None, Some(file)) => file,
            (None, None) => return Err(Exit::Usage("--out or --each is needed".into()).into()),
        };
        match format {
            Format::Sheet => {
                let mut rows = Vec::new();
                for (task, options) in &tasks {
                    let episode = self.episode(&catalog, &policy, task, options, format)?;
                    rows.push(self.look.row(&episode)?);
                    eprintln!("row {}: {task}, {} steps", rows.len(), episode.len() - 1);
                }
                Image::below(&rows, GAP).write_png(path)?;
            }
            Format::Moving => {
                let mut film = Vec::new();
                for (task, options) in &tasks {
                    film.extend(self.episode(&catalog, &policy, task, options, format)?);
                    eprintln!("{task}: {} pictures so far", film.len());
                }
                self.look.write_film(path, &film)?;
            }
        }
        eprintln!("wrote {}", path.display());
        Ok(())
    }

    /// Writes one picture of each task.
    fn each(
        &self,
        catalog: &Catalog,
        policy: &Chooser,
        tasks: &[(String, Options)],
        folder: &Path,
    ) -> anyhow::Result<()> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("creating {}", folder.display()))?;
        for (task, options) in tasks {
            let episode = self.episode(catalog, policy, task, options, Format::Sheet)?;
            let path = folder.join(format!("{task}.png"));
            self.look.picture(&episode[amid(episode.len())].sight)?.write_png(&path)?;
            eprintln!("wrote {}", path.display());
        }
        Ok(())
    }

    /// What a file of this format shows of an episode.
    fn episode(
        &self,
        catalog: &Catalog,
        policy: &Chooser,
        task: &str,
        options: &Options,
        format: Format,
    ) -> anyhow::Result<Vec<Moment>> {
        let registry = match catalog {
            Catalog::Builtin(registry) => registry,
            Catalog::Server(client) => {
                let (seed, seconds) = (self.seed, self.seconds);
                let request = served::Request { policy, task, options, seed, seconds, format };
                return served::episode(client, &self.look, &request);
            }
        };
        let mut env = registry.make(task, options)?;
        policy.check(env.spec())?;
        env.reset(Some(self.seed));
        let mut agent = policy.agent(env.spec(), self.seed);
        let mut moments = self.look.moments(format, env.spec().seconds_per_step);
        moments.see(env.stage(), || env.scene());
        let shown = |env: &Env| f64::from(env.steps()) * env.spec().seconds_per_step;
        while !env.needs_reset() && shown(&env) < self.seconds {
            let (stage, parts) = (env.stage(), moments.parts());
            let action = agent.act(&env)?;
            let step = env
                .step_in_parts(action, parts, &mut |scene| moments.see(stage, || scene))
                .with_context(|| format!("{task} failed"))?;
            moments.see(env.stage(), || env.scene());
            if step.is_success && policy.asks_expert() && is_at_rest(&env) {
                break; // nothing new is to be seen
            }
        }
        Ok(moments.into_list())
    }
}

/// Which of so many moments is amid an episode: the instrument has come to its object.
fn amid(moments: usize) -> usize {
    moments * 2 / 5
}

fn is_at_rest(env: &Env) -> bool {
    env.world().at_rest()
}
