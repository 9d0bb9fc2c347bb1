//! Recordings that are watched: each file is a session, each of its episodes an environment. An episode is
//! simulated again for each page that watches it, as fast as that goes; the page plays it, back and forth.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use trocar_proto::Rejection;

use super::source::{About, FrameChannel, Mark, Moment, SessionCard, Source};
use crate::recording::{Course, Replay};
use crate::registry::Registry;

/// How long the simulation waits where the page is behind.
const PAUSE: Duration = Duration::from_millis(2);

/// Recordings, for the viewer.
pub struct ReplaySource {
    registry: Registry,
    files: Vec<(SessionCard, Vec<Course>)>,
}

impl ReplaySource {
    /// Recordings by their names.
    pub fn new(
        registry: Registry,
        files: impl IntoIterator<Item = (String, Vec<Course>)>,
    ) -> Result<Self, Rejection> {
        let mut cards = vec![];
        for (index, (name, courses)) in files.into_iter().enumerate() {
            let Some(first) = courses.first() else { continue };
            let spec = registry.spec(first.task(), first.options())?;
            let card = SessionCard {
                id: index as u64 + 1,
                pid: 0,
                language: name,
                task: spec.id.clone(),
                envs: courses.len() as u32,
                arms: vec![],
                speed: None,
                max_steps: spec.max_steps,
                seconds_per_step: spec.seconds_per_step,
                steps_per_second: 0.0,
                p50_us: 0.0,
                p99_us: 0.0,
                episodes: courses.len() as u64,
                success_rate: None,
            };
            cards.push((card, courses));
        }
        Ok(Self { registry, files: cards })
    }
}

impl Source for ReplaySource {
    fn about(&self) -> About {
        let names: Vec<_> = self.files.iter().map(|(card, _)| card.language.as_str()).collect();
        About {
            name: names.join(", "),
            pid: std::process::id(),
            version: env!("CARGO_PKG_VERSION"),
            recording: true,
        }
    }

    fn sessions(&self) -> Vec<SessionCard> {
        self.files.iter().map(|(card, _)| card.clone()).collect()
    }

    fn watch(&self, session: u64, env: u32, channel: &Arc<FrameChannel>) -> Result<(), String> {
        let file = self.files.iter().find(|(card, _)| card.id == session);
        let (_, courses) = file.ok_or_else(|| format!("there is no recording {session}"))?;
        let course = courses.get(env as usize).ok_or_else(|| {
            format!("recording {session} has no episode {env}; the last is {}", courses.len() - 1)
        })?;
        let replay = Replay::new(&self.registry, course.clone());
        let (replay, channel) =
            (replay.map_err(|refusal| refusal.to_string())?, Arc::clone(channel));
        let playing = thread::Builder::new().name("trocar-replay".into());
        playing.spawn(move || play(replay, &channel)).map_err(|error| error.to_string())?;
        Ok(())
    }
}

/// Shows an episode from its beginning to its end, or to a state that is not as it was recorded.
fn play(mut replay: Replay, channel: &FrameChannel) {
    let begun = Mark { is_step: false, reward: 0.0, ended: false, is_success: false };
    show(&replay, begun, channel);
    while let Some(Ok(step)) = replay.next() {
        if replay.has_failed() || channel.is_closed() {
            return;
        }
        let mark = Mark {
            is_step: true,
            reward: step.reward,
            ended: step.terminated || step.truncated,
            is_success: step.is_success,
        };
        show(&replay, mark, channel);
    }
}

fn show(replay: &Replay, mark: Mark, channel: &FrameChannel) {
    while !channel.is_closed() && !channel.put(Moment::of(replay.env(), vec![mark])) {
        thread::sleep(PAUSE);
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::Options;

    use super::super::source::Pace;
    use super::*;
    use crate::recording::{self, Recorder};

    #[test]
    fn an_episode_is_shown_from_its_beginning_to_its_end_whoever_watches() {
        let registry = Registry::builtin();
        let mut env = registry.make("EcmReach-v0", &Options::new()).unwrap();
        let (mut recorder, mut bytes) = (Recorder::new(10), vec![]);
        for (seed, steps) in [(3, 50), (4, 7)] {
            bytes.extend(recorder.before_leaving(&env).into_iter().flatten());
            env.reset(Some(seed));
            for _ in 0..steps {
                env.step(&[0.5; 3]).unwrap();
                bytes.extend(recorder.after_step(&env).into_iter().flatten());
            }
        }
        bytes.extend(recorder.before_leaving(&env).into_iter().flatten());
        let courses = recording::read(&bytes).unwrap();
        let replays = ReplaySource::new(registry, [("two".to_string(), courses)]).unwrap();
        assert_eq!((replays.sessions().len(), replays.sessions()[0].envs), (1, 2));
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        for (episode, steps) in [(0, 50), (1, 7)] {
            let channel = FrameChannel::new(Pace::Episodes);
            replays.watch(1, episode, &channel).unwrap();
            runtime.block_on(async {
                for step in 0..=steps {
                    let moment = channel.next().await.unwrap();
                    assert_eq!((moment.seed, moment.steps), (3 + u64::from(episode), step));
                    assert_eq!(moment.marks[0].ended, step == 50);
                }
            });
            channel.close();
        }
        let refusal = |session, episode| {
            replays.watch(session, episode, &FrameChannel::new(Pace::Episodes)).unwrap_err()
        };
        assert!(refusal(2, 0).contains("no recording 2"));
        assert!(refusal(1, 2).contains("no episode 2; the last is 1"));
    }
}
