//! How environments of a session are drawn: one on demand, or those of a message once all were stepped.

use super::rows::Pictures;
use super::scheduler::Splittable;
use crate::env::{Env, Imaging, Shot};
use crate::render::Scene;

/// An environment that is drawn, if any.
pub(super) struct One<'a> {
    pub(super) env: Option<&'a Env>,
    pub(super) view: &'a Imaging,
    pub(super) rgb: &'a mut [u8],
    pub(super) depth: &'a mut [f32],
}

impl Splittable for One<'_> {
    fn len(&self) -> usize {
        usize::from(self.env.is_some())
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        let nothing = Self { env: None, view: self.view, rgb: &mut [], depth: &mut [] };
        if at == 0 { (nothing, self) } else { (self, nothing) }
    }

    fn run(self) {
        if let Some(env) = self.env {
            let (rgb, depth) = (self.rgb, self.depth);
            let scene = env.scene();
            let shot = Shot { scene, rgb, depth, mask: &mut [], points: &mut [] };
            self.view.draw(&mut [shot]);
        }
    }
}

/// The pictures of environments that a message was about.
pub(super) struct All<'a> {
    /// All of the session's.
    pub(super) envs: &'a [Env],
    pub(super) env_ids: &'a [u32],
    pub(super) imaging: &'a Imaging,
    /// What there was to see at the ends of episodes that the same step replaced.
    pub(super) finals: &'a mut [Option<Scene>],
    pub(super) pictures: Pictures<'a>,
    pub(super) final_pictures: Pictures<'a>,
}

impl Splittable for All<'_> {
    fn len(&self) -> usize {
        self.env_ids.len()
    }

    fn split_at(self, at: usize) -> (Self, Self) {
        let Self { envs, env_ids, imaging, finals, pictures, final_pictures } = self;
        let (ids, later_ids) = env_ids.split_at(at);
        let (finals, later_finals) = finals.split_at_mut(at);
        let (pictures, later_pictures) = pictures.split_at(at);
        let (final_pictures, later_final_pictures) = final_pictures.split_at(at);
        let part = |env_ids, finals, pictures, final_pictures| Self {
            envs,
            env_ids,
            imaging,
            finals,
            pictures,
            final_pictures,
        };
        let now = part(ids, finals, pictures, final_pictures);
        (now, part(later_ids, later_finals, later_pictures, later_final_pictures))
    }

    fn run(self) {
        let present = self.env_ids.iter().map(|id| Some(self.envs[*id as usize].scene()));
        let last = self.finals.iter_mut().map(Option::take);
        let shots = self.pictures.shots(present).chain(self.final_pictures.shots(last));
        self.imaging.draw(&mut shots.collect::<Vec<_>>());
    }
}
