//! `trocar dvrk`: a live world as a da Vinci Research Kit on ROS 2, without an installation of ROS.
//!
//! | file | holds |
//! |---|---|
//! | `bus.rs` | the node: publishers, subscriptions, services, subscribers |
//! | `messages.rs` | the messages, field by field |
//! | `dvrk.rs` | the world: looks at it, gives commands, publishes |
//! | `arm.rs`, `reading.rs` | the topics of one arm; its state as messages |
//! | `console.rs` | the topics of console and system |
//! | `truth.rs` | the topics of objects and of the task |
//! | `images.rs` | the endoscope's pictures |
//! | `clock.rs`, `statistics.rs` | the world's time in the system's; how regular publications are |

mod arm;
mod bus;
mod clock;
mod console;
mod dvrk;
mod images;
mod messages;
mod reading;
mod statistics;
mod truth;

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use clap::{Parser, ValueEnum};
use tracing_subscriber::EnvFilter;
use trocar_client::proto::dvrk::{Homing, LiveRequest};
use trocar_client::{
    CallError, Client, Code, ConnectError, OptionValue, Rejection, SessionRequest,
};

use crate::bus::Bus;
use crate::dvrk::Dvrk;
use crate::images::Images;

/// A live world as a da Vinci Research Kit on ROS 2: scripts of dVRK 2.4 drive its arms.
#[derive(Debug, Parser)]
#[command(name = "trocar dvrk", version, after_help = AFTER_HELP)]
struct Options {
    /// The task whose world it is
    #[arg(long, default_value = "BiPegTransfer-v0")]
    task: String,
    /// Name of a running server (default: a private one)
    #[arg(long)]
    server: Option<String>,
    /// Which episode it is
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// How many times as fast as life
    #[arg(long, default_value_t = 1.0)]
    speed: f64,
    /// What an arm does when it is homed
    #[arg(long, value_enum, default_value_t = HomingWord::ToZero)]
    homing: HomingWord,
    /// Errors of real arms: a preset of the task's option `domain`, such as dvrk
    #[arg(long, value_name = "PRESET")]
    errors: Option<String>,
    /// Address of the network interface on which ROS 2 finds it
    #[arg(long, default_value = "127.0.0.1")]
    interface: IpAddr,
    /// The domain of ROS 2 (default: $ROS_DOMAIN_ID, else 0)
    #[arg(long, value_parser = clap::value_parser!(u16).range(0..=232))]
    domain: Option<u16>,
    /// How often states are published, times a second
    #[arg(long, default_value_t = 100.0, value_parser = rate)]
    rate: f64,
    /// In which frame the poses of arms are
    #[arg(long, value_enum, default_value_t = Frames::Rcm)]
    frames: Frames,
    /// The endoscope's pictures are published, so many times a second (10)
    #[arg(long, num_args = 0..=1, default_missing_value = "10", value_parser = rate)]
    images: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum HomingWord {
    /// All joints go to 0, the insertion to 0.12 m
    #[value(name = "to_zero")]
    ToZero,
    /// It stays where it is
    #[value(name = "in_place")]
    InPlace,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Frames {
    /// That of each arm's remote centre
    Rcm,
    /// That of the world, as if all arms were registered
    World,
}

const AFTER_HELP: &str = "\
Examples:
  trocar dvrk                                          both PSMs and the ECM, on this machine
  trocar dvrk --task NeedlePick-v0 --frames world --images
  trocar dvrk --server lab --interface 192.168.0.7     on a server that runs, for a network

The domain of ROS 2 is $ROS_DOMAIN_ID unless --domain says otherwise.";

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse().map_err(|error| format!("{error}"))?;
    if (1.0..=240.0).contains(&rate) { Ok(rate) } else { Err("allowed is 1 to 240".into()) }
}

fn main() -> ExitCode {
    let options = Options::parse();
    let filter = EnvFilter::try_from_env("TROCAR_LOG").unwrap_or_else(|_| {
        // What lies below complains where the loopback interface has no multicast, which it does without.
        EnvFilter::new("info,rustdds=error,rustdds::network=off,ros2_client=error")
    });
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    match run(&options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tracing::error!("{error:#}");
            ExitCode::from(code_of(&error))
        }
    }
}

/// The exit codes of `trocar`: 2 for what a user asked wrongly, 3 where no server runs, else 1.
fn code_of(error: &anyhow::Error) -> u8 {
    let of_refusal = |refusal: &Rejection| match refusal.code {
        Code::UnknownTask | Code::UnknownOption | Code::InvalidOption => 2,
        _ => 1,
    };
    if let Some(error) = error.downcast_ref() {
        return match error {
            ConnectError::NoServer { .. } => 3,
            ConnectError::Refused(refusal) => of_refusal(refusal),
            _ => 1,
        };
    }
    match error.downcast_ref() {
        Some(CallError::ServerLost { .. }) => 3,
        Some(CallError::Refused(refusal)) => of_refusal(refusal),
        _ => 1,
    }
}

fn run(options: &Options) -> anyhow::Result<()> {
    let stop = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stop);
    ctrlc::set_handler(move || asked.store(true, Ordering::Release)).context("SIGINT")?;
    let client = match &options.server {
        Some(name) => Client::connect(name)?,
        None => Client::connect_private()?,
    };
    let homing = match options.homing {
        HomingWord::ToZero => Homing::ToZero,
        HomingWord::InPlace => Homing::InPlace,
    };
    let live = LiveRequest { homing, speed: Some(options.speed), ..LiveRequest::default() };
    let errors = options
        .errors
        .iter()
        .map(|preset| ("domain".to_string(), OptionValue::Preset(preset.clone(), BTreeMap::new())));
    let request = SessionRequest::new(&options.task)
        .seed(options.seed)
        .options(trocar_client::Options(errors.collect()))
        .live(live);
    let world = client.open_live(&request)?;
    let session = world.info().session;
    let arms: Vec<_> = world.live().arms.iter().map(|arm| arm.name.clone()).collect();
    let status = format!("simulated by Trocar: {}, seed {}", options.task, options.seed);
    let domain = match options.domain {
        Some(domain) => domain,
        None => match std::env::var("ROS_DOMAIN_ID") {
            Ok(text) if !text.is_empty() => text.parse().context("ROS_DOMAIN_ID")?,
            _ => 0,
        },
    };
    let mut bus = Bus::new(domain, options.interface)?;
    let mut dvrk = Dvrk::new(&mut bus, world, options.rate, &status)?;
    let interface = options.interface;
    if options.frames == Frames::World {
        dvrk.register();
    }
    let images =
        options.images.map(|rate| Images::start(&mut bus, &client, &request, session, rate));
    let _images = images.transpose()?;
    tracing::info!(arms = arms.join(", "), %interface, domain, "ready; Ctrl-C ends it");
    while !stop.load(Ordering::Acquire) {
        let patience = dvrk.patience();
        bus.deliver(&mut dvrk, patience)?;
        dvrk.act(&mut bus)?;
    }
    Ok(())
}
