//! The moments of an episode that are shown.

use std::sync::Arc;

use trocar_proto::Stage;
use trocar_server::render::Scene;

use super::image::Image;

/// What there is to see at one moment.
pub(crate) struct Moment {
    pub(crate) sight: Sight,
    /// What the expert is about.
    pub(crate) stage: Stage,
}

/// The view of one moment.
#[derive(Clone)]
pub(crate) enum Sight {
    /// A scene, to be drawn.
    Scene(Box<Scene>),
    /// A picture that a server drew.
    Image(Arc<Image>),
}

impl From<Scene> for Sight {
    fn from(scene: Scene) -> Self {
        Self::Scene(scene.into())
    }
}

/// Collects moments of an episode while it is played, part of a step by part.
pub(crate) struct Moments {
    list: Vec<Moment>,
    /// Even parts of a step at whose ends a moment may be taken.
    parts: u32,
    /// Parts from one moment to the next, at least 1.
    every: f64,
    /// Ends of parts so far; the beginning of the episode is one.
    ends: u64,
}

impl Moments {
    /// The beginning, and the end of every step.
    pub(crate) fn each_step() -> Self {
        Self { list: vec![], parts: 1, every: 1.0, ends: 0 }
    }

    /// So many a second, from the beginning on, of steps of so many seconds.
    pub(crate) fn per_second(fps: u32, seconds_per_step: f64) -> Self {
        let each_step = f64::from(fps) * seconds_per_step;
        let every = |parts: u32| f64::from(parts) / each_step;
        // With that many parts every moment is the end of one; otherwise the nearest ends are taken.
        let is_whole = |parts: &u32| {
            let whole = every(*parts).round();
            whole >= 1.0 && (every(*parts) - whole).abs() < 1e-6
        };
        let parts = (1..=fps).find(is_whole).unwrap_or(fps.max(each_step.ceil() as u32));
        Self { list: vec![], parts, every: every(parts), ends: 0 }
    }

    /// Parts into which steps are to be divided.
    pub(crate) fn parts(&self) -> u32 {
        self.parts
    }

    /// Takes the moment at the beginning of the episode, or at the end of the next part, if it is one of those.
    pub(crate) fn see<S: Into<Sight>>(&mut self, stage: Stage, sight: impl FnOnce() -> S) {
        if self.ends == (self.list.len() as f64 * self.every).round() as u64 {
            self.list.push(Moment { sight: sight().into(), stage });
        }
        self.ends += 1;
    }

    /// All that were taken.
    pub(crate) fn into_list(self) -> Vec<Moment> {
        self.list
    }
}

/// Which of the moments with these stages a contact sheet of `count` shows: the first, the last and those at
/// which the stage changes, then the middles of the longest gaps; fewer where there are fewer.
pub(crate) fn chosen(stages: &[Stage], count: usize) -> Vec<usize> {
    let last = stages.len().saturating_sub(1);
    let is_marked =
        |index: &usize| [0, last].contains(index) || stages[*index] != stages[*index - 1];
    let mut chosen: Vec<usize> = (0..stages.len()).filter(is_marked).collect();
    if chosen.len() > count {
        let even = |place: usize| chosen[place * (chosen.len() - 1) / (count - 1).max(1)];
        return (0..count).map(even).collect();
    }
    while chosen.len() < count.min(stages.len()) {
        let gap = |place: &usize| (chosen[*place] - chosen[*place - 1], usize::MAX - place);
        let Some(place) = (1..chosen.len()).max_by_key(gap) else { break };
        chosen.insert(place, usize::midpoint(chosen[place - 1], chosen[place]));
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The parts of `steps` steps at whose ends moments are taken.
    fn taken(mut moments: Moments, steps: u32) -> Vec<u64> {
        let mut ends = vec![];
        for end in 0..=u64::from(steps * moments.parts()) {
            moments.see(Stage::Reach, || {
                ends.push(end);
                Scene::default()
            });
        }
        ends
    }

    #[test]
    fn a_film_has_its_pictures_at_every_rate() {
        for hertz in [5.0, 10.0, 20.0, 30.0, 40.0, 60.0] {
            for fps in [1, 10, 24, 25, 30, 50] {
                let moments = Moments::per_second(fps, 1.0 / hertz);
                let parts = f64::from(moments.parts());
                let ends = taken(moments, 2 * hertz as u32);
                assert_eq!(ends.len(), 2 * fps as usize + 1, "{hertz} Hz, {fps} pictures a second");
                for (number, end) in ends.iter().enumerate() {
                    let seconds = *end as f64 / parts / hertz;
                    assert!((seconds - number as f64 / f64::from(fps)).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn odd_steps_have_the_nearest_parts() {
        let ends = taken(Moments::per_second(25, 0.123_456), 100);
        assert_eq!(ends.len(), 1 + (12.3456 * 25.0) as usize);
        assert_eq!(taken(Moments::each_step(), 3), [0, 1, 2, 3]);
    }

    #[test]
    fn sheets_show_where_the_stage_changes() {
        use Stage::{Approach, Carry, Lift, Pick};
        let stages =
            [Approach, Approach, Approach, Approach, Pick, Lift, Carry, Carry, Carry, Carry, Carry];
        assert_eq!(chosen(&stages, 5), [0, 4, 5, 6, 10]);
        assert_eq!(chosen(&stages, 7), [0, 2, 4, 5, 6, 8, 10]);
        assert_eq!(chosen(&stages, 3), [0, 5, 10]);
        assert_eq!(chosen(&stages, 1), [0]);
        assert_eq!(chosen(&stages, 40), (0..11).collect::<Vec<_>>());
        assert_eq!(chosen(&[Stage::Reach; 9], 5), [0, 2, 4, 6, 8]);
        assert_eq!(chosen(&[Stage::Reach], 4), [0]);
    }
}
