//! `trocar drive`: arms in a live world, driven by hand from the viewer's page.

use std::io::Write;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Context;
use clap::Args;
use trocar_client::{Client, SessionRequest};
use trocar_proto::Options;
use trocar_proto::dvrk::{Homing, LiveRequest};

use crate::options::Given;
use crate::output;
use crate::process::OwnServer;

/// How often it looks whether it is to end.
const INTERVAL: Duration = Duration::from_millis(100);

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Drive the arms of a task by keyboard or gamepad, in the browser.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  trocar drive                                    NeedlePick, in your browser; Ctrl-C ends it
  trocar drive --task BiPegTransfer-v0 --out mine.trocar
  trocar replay mine.trocar                       plays again what you did, bit by bit

The address has a token, which lets a page drive the arms: keep it to yourself. Key ? shows all
keys.")]
pub(crate) struct Drive {
    /// A task id of `trocar tasks`
    #[arg(long, default_value = "NeedlePick-v0", value_parser = crate::options::task_id)]
    task: String,
    #[command(flatten)]
    options: Given,
    /// The episode's seed
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// The server [default: one of its own, which ends with this]
    #[arg(long, value_name = "NAME")]
    server: Option<String>,
    /// Times real time
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// Write what was done, for `trocar replay`
    #[arg(long, value_name = "FILE.trocar")]
    out: Option<PathBuf>,
}

impl Drive {
    pub(crate) fn run(self) -> anyhow::Result<()> {
        ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Release))?;
        output::check_file(self.out.as_deref())?;
        let own = match &self.server {
            Some(_) => None,
            None => Some(OwnServer::start(&format!("drive-{}", std::process::id()).parse()?, &[])?),
        };
        let name = self.server.as_deref().or(own.as_ref().map(OwnServer::name));
        let client = Client::connect(name.context("one of both")?)?;
        let spec = client.describe(&self.task, &Options::new())?;
        let chosen = crate::options::for_tasks(&self.options.assignments(), &[spec])?;
        let (task, options) = chosen.into_iter().next().context("one task was chosen")?;
        let live = LiveRequest {
            homing: Homing::InPlace,
            speed: Some(self.speed),
            ..LiveRequest::default()
        };
        let request = SessionRequest::new(&task).options(options).seed(self.seed).live(live);
        let mut world = client.open_live(&request)?;
        let session = world.info().session;
        writeln!(std::io::stdout(), "{}&session={session}&env=0", client.driving_page()?)?;
        eprintln!("Open it in your browser, and press Drive. Ctrl-C ends it.");
        while !INTERRUPTED.load(Ordering::Acquire) {
            std::thread::sleep(INTERVAL);
            world.look()?;
        }
        if let Some(path) = &self.out {
            let recording = world.recording()?;
            std::fs::write(path, recording)
                .with_context(|| format!("writing {}", path.display()))?;
            eprintln!("wrote {}", path.display());
        }
        drop(world);
        drop(client);
        own.map_or(Ok(()), OwnServer::stop)
    }
}
