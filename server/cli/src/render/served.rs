//! Pictures of episodes in a server, which draws them: its tasks may be unknown to this program.
//!
//! A session draws one camera. For several cameras, the same episode is played in a session of each.

use std::sync::Arc;

use trocar_client::{Autoreset, Client, Session, SessionRequest};
use trocar_network::Seen;
use trocar_proto::{Options, Stage};

use super::image::Image;
use super::look::{Format, Look};
use super::moments::{Moment, Sight};
use crate::policy::Chooser;

/// An episode to be drawn, up to `seconds` of simulated time.
pub(super) struct Request<'a> {
    pub(super) policy: &'a Chooser,
    pub(super) task: &'a str,
    pub(super) options: &'a Options,
    pub(super) seed: u64,
    pub(super) seconds: f64,
    pub(super) format: Format,
}

/// Plays an episode in a server, and returns the pictures of the ends of its steps.
pub(super) fn episode(
    client: &Client,
    look: &Look,
    request: &Request<'_>,
) -> anyhow::Result<Vec<Moment>> {
    let Request { policy, task, options, seed, seconds, format } = *request;
    let views = look.views()?;
    let mut sessions = vec![];
    for (view, _) in &views {
        let request = SessionRequest::new(task)
            .envs(1)
            .autoreset(Autoreset::Disabled)
            .options(options.clone())
            .view(view.clone());
        let mut session = client.open(&request)?;
        session.want_expert(true);
        sessions.push(session);
    }
    let spec = sessions[0].spec().clone();
    policy.check(&spec)?;
    let mut player = policy.player(seed);
    let mut action = vec![0.0; spec.action_dim()];
    let mut moments = look.moments(format, spec.seconds_per_step);
    let parts = moments.parts();
    let mut replies = sessions
        .iter_mut()
        .map(|session| session.reset_envs(&[0], Some(&[seed])))
        .collect::<Result<Vec<_>, _>>()?;
    let mut steps = 0_u32;
    loop {
        let reply = replies.swap_remove(0);
        replies.clear();
        let stage = Stage::ALL.get(usize::from(reply.expert_stage()[0])).copied();
        let picture = picture(&mut sessions, look, &views)?;
        moments.see(stage.unwrap_or_default(), || Sight::Image(picture.clone()));
        let is_over = reply.terminated()[0] == 1 || reply.truncated()[0] == 1;
        if is_over || f64::from(steps) * spec.seconds_per_step >= seconds {
            return Ok(moments.into_list());
        }
        for _ in 1..parts {
            moments.see(stage.unwrap_or_default(), || Sight::Image(picture.clone()));
        }
        let seen = Seen {
            observation: reply.observation(),
            achieved: reply.achieved_goal(),
            desired: reply.desired_goal(),
        };
        player.act(&seen, &mut action, |action| action.copy_from_slice(reply.expert_action()))?;
        drop(reply);
        for session in &mut sessions {
            replies.push(session.step(&action)?);
        }
        steps += 1;
    }
}

/// The present pictures of all cameras, side by side.
fn picture(
    sessions: &mut [Session],
    look: &Look,
    views: &[(Options, usize)],
) -> anyhow::Result<Arc<Image>> {
    let [width, height] = look.size();
    let bytes = 3 * width * height;
    let mut parts = vec![];
    for (session, (_, lens)) in sessions.iter_mut().zip(views) {
        let reply = session.render(0, false)?;
        let rgb = reply.picture_rgb()[lens * bytes..][..bytes].to_vec();
        parts.push(Image { width, height, rgb });
    }
    Ok(Arc::new(Image::beside(&parts, 0)))
}
