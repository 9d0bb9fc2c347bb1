//! `trocar record`: episodes as a file from which they come again, bit by bit.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use indicatif::ProgressBar;
use trocar_client::{CallError, Client, Code};
use trocar_proto::part::{self, Kind, MAX_PART};
use trocar_proto::seed;
use trocar_proto::snapshot::Recipe;
use trocar_server::Registry;
use trocar_server::recording::{EVERY, Recorder};

use crate::exit::Exit;
use crate::options::Given;
use crate::output;
use crate::policy::Chooser;

/// How often a session is asked for what it has recorded.
const INTERVAL: Duration = Duration::from_millis(200);

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Record episodes, of a policy or of a session of a server, to play them again.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar record --task NeedlePick-v0 --episodes 5 --out pick.trocar   the scripted expert
  trocar record --policy NeedlePick --out trained.trocar              one of `trocar policies`
  trocar record --name lab --session 3 --env 0 --out live.trocar      a trainer, until Ctrl-C
  trocar replay pick.trocar                                           compares every bit

A recording has the task, its options, seeds and actions, and a snapshot each --every steps and at
the end of every episode; Python can go on from any of them (trocar.Snapshot.from_bytes). A
session is recorded from the beginning of its present episode on; its trainer notices nothing. A
live world is recorded from its beginning on, with all commands to its arms.")]
pub(crate) struct Record {
    /// A task id of `trocar tasks` [default: the policy's]
    #[arg(long, conflicts_with = "session", value_parser = crate::options::task_id)]
    task: Option<String>,
    /// The agent: oracle (the task's scripted expert), random, or a trained policy: FILE.onnx, or a name
    /// of `trocar policies`
    #[arg(long, default_value = "oracle", conflicts_with = "session")]
    policy: String,
    /// How many episodes [default: 1; of a session, until Ctrl-C]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: Option<u32>,
    /// Episode k has the seed SEED + k
    #[arg(long, default_value_t = 0, conflicts_with = "session")]
    seed: u64,
    #[command(flatten)]
    options: Given,
    /// Record this session, as `trocar status` numbers them
    #[arg(long, value_name = "ID")]
    session: Option<u64>,
    /// With --session: which of its environments
    #[arg(long, default_value_t = 0, requires = "session")]
    env: u32,
    /// With --session: the server
    #[arg(long, default_value = "default", requires = "session")]
    name: String,
    /// Steps from one snapshot to the next
    #[arg(long, default_value_t = EVERY, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// The recording
    #[arg(long, value_name = "FILE.trocar")]
    out: PathBuf,
}

impl Record {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Release))?;
        output::check_file(Some(&self.out))?;
        // Connected, or its policy read, before a file is made.
        let episodes = match self.session {
            Some(session) => {
                let client = Client::connect(&self.name)?;
                client.record(session, self.env, self.every)?;
                self.follow(&client, session, &mut create(&self.out)?)?
            }
            None => self.roll_out()?,
        };
        eprintln!("wrote {}: {episodes} episodes", self.out.display());
        Ok(())
    }

    /// Records a policy's episodes in this process; how many.
    fn roll_out(&self) -> anyhow::Result<u32> {
        let registry = Registry::builtin();
        let policy = Chooser::read(&self.policy)?;
        let task = match (&self.task, &policy) {
            (Some(task), _) => task.clone(),
            (None, Chooser::Network(network)) => network.task().unwrap_or_default().to_string(),
            (None, Chooser::Policy(_)) => String::new(),
        };
        if task.is_empty() {
            return Err(Exit::Usage("--task: which task is to be recorded?".into()).into());
        }
        let spec = registry.spec(&task, &trocar_proto::Options::new())?;
        let assignments = policy.with_options(self.options.assignments())?;
        let chosen = crate::options::for_tasks(&assignments, &[spec])?;
        let (task, options) = chosen.into_iter().next().context("one task was chosen")?;
        let mut env = registry.make(&task, &options)?;
        policy.check(env.spec())?;
        let count = self.episodes.unwrap_or(1);
        let (mut out, mut recorder) = (create(&self.out)?, Recorder::new(self.every));
        let progress = ProgressBar::new(count.into());
        for k in 0..count {
            let seed = seed::of(u128::from(self.seed) + u128::from(k));
            let mut is_stopped = false;
            let played = policy.play(&mut env, seed, |env, _| {
                is_stopped = INTERRUPTED.load(Ordering::Acquire);
                let part = recorder.after_step(env);
                let part =
                    if is_stopped { part.or_else(|| recorder.before_leaving(env)) } else { part };
                out.write_all(&part.unwrap_or_default())?;
                anyhow::ensure!(!is_stopped, "interrupted");
                Ok(())
            });
            if is_stopped {
                progress.finish_and_clear();
                out.flush()?;
                eprintln!("interrupted: the last episode ends at step {}", env.steps());
                return Ok(k + 1);
            }
            played?;
            progress.inc(1);
        }
        progress.finish_and_clear();
        out.flush()?;
        Ok(count)
    }

    /// Writes down what a session records, until there are enough episodes, Ctrl-C, or its end.
    fn follow(&self, client: &Client, session: u64, out: &mut impl Write) -> anyhow::Result<u32> {
        let progress = ProgressBar::new_spinner().with_message("Ctrl-C ends the recording");
        let (mut ended, mut last, mut lost) = (0, None, 0);
        loop {
            let interrupted = INTERRUPTED.load(Ordering::Acquire);
            let (bytes, missing) = match client.recorded(session) {
                Ok(fetched) => fetched,
                Err(CallError::Refused(refusal)) if refusal.code == Code::UnknownSession => {
                    eprintln!("the session has ended");
                    break;
                }
                Err(CallError::ServerLost { .. }) => {
                    eprintln!("the server has ended, and the recording with it");
                    break;
                }
                Err(error) => return Err(error.into()),
            };
            lost += missing;
            // A live world may be commanded without a pause: a message that is not nearly full had all that there was.
            let is_live = Kind::of(&bytes) == Some(Kind::Live);
            let is_all = bytes.is_empty() || is_live && bytes.len() < MAX_PART / 2;
            for part in if bytes.is_empty() { vec![] } else { part::split(&bytes)? } {
                if Kind::of(part) == Some(Kind::Live) {
                    // All that was done in a live world, from its beginning on, is one episode.
                    last = Some((0, 0));
                    out.write_all(part)?;
                    continue;
                }
                let recipe = Recipe::from_bytes(part)?;
                let now = (recipe.seed, recipe.episode);
                if last.is_some_and(|last| last != now) {
                    ended += 1;
                    progress.set_message(format!("{ended} episodes; Ctrl-C ends the recording"));
                }
                if self.episodes.is_some_and(|wanted| ended >= wanted) {
                    out.flush()?;
                    return Ok(ended);
                }
                last = Some(now);
                out.write_all(part)?;
            }
            if interrupted && is_all {
                break;
            }
            progress.tick();
            if is_all {
                std::thread::sleep(INTERVAL);
            }
        }
        progress.finish_and_clear();
        if lost > 0 {
            eprintln!("{lost} snapshots are missing: the session was faster than this could write");
        }
        out.flush()?;
        Ok(ended + u32::from(last.is_some()))
    }
}

fn create(path: &Path) -> anyhow::Result<BufWriter<File>> {
    let file = File::create(path).with_context(|| format!("creating {}", path.display()))?;
    Ok(BufWriter::new(file))
}
