//! What tasks share in which one arm hands an object to the other: what is observed of both, and the
//! expert's way of handing over.

use nalgebra::{Point3, Vector3};
use trocar_proto::Stage;
use trocar_proto::spec::Element;

use super::expert::{ArmView, ExpertInput};
use super::objects::{self, THEATRE};
use super::options::{self, Preset};
use super::psm_scene::PsmArm;
use super::state::State;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN, TIP_OFFSET};
use crate::sim::world::{BodyId, World};

/// How far outside of the two workspaces together an arm may be dragged by the other, m: arms yield to an object
/// that both hold.
const DRAGGED: f64 = 0.02;

/// What a state has of two arms and an object: both arms (7 each), the object's origin (3), that less PSM1's and PSM2's
/// wrist (3 each), and the two places at which it is grasped, each by position (3) and extrinsic XYZ Euler angles (3).
/// `object` and `places` are names and where they are.
pub fn state(
    arms: [&PsmArm; 2],
    (object, scene_from_object): (&str, &Pose),
    places: [(&str, &Pose); 2],
    preset: Preset,
    world: &World,
    state: &mut State<'_>,
) {
    let bounds = arms[0].reach().merged(arms[1].reach()).grown(DRAGGED);
    for (name, arm) in ARMS.into_iter().zip(arms) {
        state.named(name, |state| arm.state_within(&bounds, world, state));
    }
    let origin = scene_from_object.translation.vector;
    objects::position(object, &THEATRE, preset, &origin, state);
    let scale = options::position_scale(preset);
    for (arm, wrist) in ARMS.into_iter().zip(arms.map(PsmArm::scene_from_wrist)) {
        let less_wrist = (origin - wrist.translation.vector) * scale;
        let elements = || {
            let relative = Aabb { min: THEATRE.min - bounds.max, max: THEATRE.max - bounds.min };
            objects::position_elements(&format!("{object} from {arm} wrist"), &relative, preset)
        };
        state.fields(elements, less_wrist.iter().copied());
    }
    for (name, place) in places {
        objects::position(name, &THEATRE, preset, &place.translation.vector, state);
        state.angles(name, "scene", frames::euler_xyz(&place.rotation));
    }
}

/// The names of the arms.
const ARMS: [&str; 2] = ["PSM1", "PSM2"];

/// The elements of an action: those of PSM1, then those of PSM2.
pub fn action_elements(arms: [&PsmArm; 2]) -> Vec<Element> {
    State::elements(|state| {
        for (name, arm) in ARMS.into_iter().zip(arms) {
            state.named(name, |state| state.fields(|| arm.action_elements(), []));
        }
    })
}

/// How near an arm is to where it offers an object before the other comes, and for as long as that goes on, m and rad.
const OFFERED: [f64; 2] = [3e-3, 0.05];
const STILL_OFFERED: [f64; 2] = [10e-3, 0.25];

/// How far off the taking arm may be before it comes, on its way, and when its jaws close, m: along their hinge and across
/// it; and how far turned, rad.
const ALIGNED: [f64; 2] = [2e-3, 1.5e-3];
const COMING: [f64; 2] = [3e-3, 2.5e-3];
const CLOSING: [f64; 2] = [3e-3, 2e-3];
const TURNED: f64 = 0.1;

/// How far short of its grasp the taking arm may be when its jaws close, and how far off while they do, m.
const SHORT: f64 = 0.7e-3;
const NEAR: f64 = 4e-3;

/// For how long both arms hold an object before the giving one opens its jaws, s: until the taking
/// one's have closed and what they moved is at rest.
const GRIPPED: f64 = 0.4;

/// Distance of an open jaw's tip from the object at which the arm is clear of it, m.
const CLEAR: f64 = 0.003;

/// How far an arm backs off at once, m.
const BACK: f64 = 0.01;

/// What an arm is to do: where its wrist goes, and its jaw angle, rad.
pub type Waypoint = (Pose, f64);

/// A hand-over as the expert does it.
#[derive(Debug, Clone, Copy)]
pub struct HandOver {
    /// What is handed over.
    pub object: BodyId,
    /// The giving arm's wrist where it offers the object.
    pub offer: Pose,
    /// The taking arm's wrist that grasps the object when it is offered, and where the object is; it comes along its jaws.
    pub take: [Pose; 2],
    /// For how long both have held the object, s: see [`holding_together`].
    pub together: f64,
    /// How far before its grasp the taking arm opens its jaws, m.
    pub hover: f64,
    /// Whether closed jaws near the object have it as soon as the other arm lets go, whatever they
    /// touch.
    pub by_nearness: bool,
}

/// How far a hand-over is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Phase {
    /// No arm has the object.
    Lost,
    /// It is not over: what giver and taker do now.
    Under([Waypoint; 2]),
    /// The taker alone has the object; what the giver does now. The taker may go when it is clear.
    Over {
        /// What the giver does now.
        giver: Waypoint,
        /// Whether its jaws are clear of the object.
        clear: bool,
    },
}

impl HandOver {
    /// What `giver` and `taker` are to do now.
    pub fn phase(
        &self,
        giver: &ArmView<'_>,
        taker: &ArmView<'_>,
        world: &World,
        input: &ExpertInput<'_>,
    ) -> Phase {
        let given = giver.has(world, self.object, input);
        let taken = taker.has(world, self.object, input)
            || self.by_nearness && given && self.has_closed(taker);
        match (given, taken) {
            (false, false) => Phase::Lost,
            (true, false) => {
                let offered = self.is_offered(giver, taker);
                Phase::Under([(self.offer, JAW_CLOSED), self.taking(taker, offered)])
            }
            (true, true) => {
                let safe = self.by_nearness || self.together >= GRIPPED - ROUNDING;
                let giver_jaw = if safe { JAW_OPEN } else { JAW_CLOSED };
                Phase::Under([(giver.aim, giver_jaw), (taker.aim, JAW_CLOSED)])
            }
            (false, true) => {
                let tip = giver.wrist * Point3::new(0.0, 0.0, TIP_OFFSET);
                let clear = world.distance(self.object, &tip) > CLEAR;
                let back = if clear || !giver.is_open() { 0.0 } else { -BACK };
                let back = giver.wrist * Pose::translation(0.0, 0.0, back);
                Phase::Over { giver: (back, JAW_OPEN), clear }
            }
        }
    }

    /// What is done while the giver has the object.
    pub fn giving(
        &self,
        giver: &ArmView<'_>,
        taker: &ArmView<'_>,
        world: &World,
        input: &ExpertInput<'_>,
    ) -> Stage {
        let is_taken = || taker.has(world, self.object, input);
        if self.is_offered(giver, taker) || is_taken() { Stage::HandOver } else { Stage::Carry }
    }

    /// Whether the object is where the taker may come for it; where it is about to take it, that may be farther off.
    fn is_offered(&self, giver: &ArmView<'_>, taker: &ArmView<'_>) -> bool {
        let most = if self.is_near(taker) { STILL_OFFERED } else { OFFERED };
        let off = distance(&giver.wrist, &self.offer);
        let is_there = off[0] < most[0] && off[1] < most[1];
        is_there || off[0] < STILL_OFFERED[0] && giver.shortfall(&self.offer) > 0.0
    }

    /// Whether the taker is about to take the object.
    pub fn is_near(&self, taker: &ArmView<'_>) -> bool {
        distance(&taker.wrist, &self.take[1])[0] < self.hover + NEAR
    }

    fn taking(&self, taker: &ArmView<'_>, offered: bool) -> Waypoint {
        let take = self.take[usize::from(offered)];
        let hover = take * Pose::translation(0.0, 0.0, -self.hover);
        let off = take.inv_mul(&taker.aim);
        let is_within = |[along, across]: [f64; 2]| {
            let aside = off.translation.vector.map(f64::abs);
            aside.x < along && aside.y < across && off.rotation.angle() < TURNED
        };
        let short = -off.translation.z;
        let is_closing =
            taker.closes() && !taker.is_closed() && off.translation.vector.norm() < NEAR;
        let comes = is_within(if short < 0.8 * self.hover { COMING } else { ALIGNED });
        if !offered || !is_closing && (taker.closes() || !taker.is_open()) {
            (hover, JAW_OPEN)
        } else if is_closing || is_within(CLOSING) && short < SHORT {
            (take, JAW_CLOSED)
        } else if comes && !taker.is_held_up() {
            (take, JAW_OPEN)
        } else {
            (hover, JAW_OPEN)
        }
    }

    fn has_closed(&self, taker: &ArmView<'_>) -> bool {
        let off = distance(&taker.wrist, &self.take[1]);
        off[0] < NEAR && off[1] < 2.0 * TURNED && taker.is_empty()
    }
}

/// What counts as no time, s.
const ROUNDING: f64 = 1e-9;

/// For how long both arms have held `object` after another step, s, if it was `before` until then.
pub fn holding_together(arms: [&PsmArm; 2], world: &World, object: BodyId, before: f64) -> f64 {
    let hold = arms.iter().all(|arm| arm.holds(world, object));
    if hold { before + arms[0].rate().seconds() } else { 0.0 }
}

/// How far a wrist is from where it shall be, m, and turned, rad.
fn distance(wrist: &Pose, target: &Pose) -> [f64; 2] {
    let off = target.inv_mul(wrist);
    [off.translation.vector.norm(), off.rotation.angle()]
}

/// Writes the action with which both arms go towards their waypoints.
pub fn act(arms: &[ArmView<'_>; 2], waypoints: &[Waypoint; 2], action: &mut [f32]) {
    let count = action.len() / arms.len();
    let parts = action.chunks_exact_mut(count);
    for ((arm, (target, jaw)), part) in arms.iter().zip(waypoints).zip(parts) {
        arm.act(target, *jaw, part);
    }
}

/// A wrist moved by `way` (m), jaws closed.
pub fn carried(arm: &ArmView<'_>, way: Vector3<f64>) -> Waypoint {
    (Pose::from(way) * arm.wrist, JAW_CLOSED)
}

/// Where an arm is asked to be, with its jaws closed.
pub fn staying(arm: &ArmView<'_>) -> Waypoint {
    (arm.aim, JAW_CLOSED)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::sim::random::Rng;
    use crate::tasks::bi_peg_transfer::BiPegTransfer;
    use crate::tasks::needle_regrasp::NeedleRegrasp;
    use crate::tasks::psm_scene::RATE;
    use crate::tasks::time;
    use crate::tasks::{Registered, Task};
    use trocar_proto::Options;

    /// How far shafts may overlap that pushed against each other, m: what they move in a substep.
    const TOUCHING: f64 = 0.2e-3;

    /// A task whose arms and object tests look at.
    pub(in crate::tasks) trait Watched: Registered {
        fn both(&self) -> &[PsmArm; 2];
        fn object(&self) -> BodyId;
    }

    /// So many trials: `full` in a soak.
    pub(in crate::tasks) fn count(reduced: u64, full: u64) -> u64 {
        if std::env::var_os("TROCAR_SOAK").is_some() { full } else { reduced }
    }

    /// Lets a step pass, in which nothing is attached and no arm passes through the other.
    pub(in crate::tasks) fn act<T: Watched>(task: &mut T, world: &mut World, action: &[f32]) {
        let action: Vec<_> = action.iter().map(|number| number.clamp(-1.0, 1.0)).collect();
        time::step(task, world, Some(&action), RATE.substeps());
        let is_tied = world.joints().flatten().any(|body| body == task.object());
        assert!(!is_tied, "friction, and nothing else");
        let [one, two] = task.both();
        assert!(one.gap(two) > -TOUCHING, "{} m", one.gap(two));
    }

    /// Lets a step pass as the expert wants it.
    pub(in crate::tasks) fn act_as_expert<T: Watched>(task: &mut T, world: &mut World) {
        let mut action = [0.0; 10];
        Task::expert(task, world, &ExpertInput::default(), &mut action);
        act(task, world, &action);
    }

    fn push_arms_together<T: Watched>(episodes: u64) {
        let (mut task, mut world) = T::new(&Options::new()).unwrap();
        if task.begins_prepared() {
            Task::prepare(&mut task, &mut world, &mut Rng::start(0));
        }
        let (first, before) = (task, world);
        let mut nearest = f64::INFINITY;
        for seed in 0..episodes {
            let mut rng = Rng::new(seed, 0);
            let (mut task, mut world) = (first.clone(), before.clone());
            Task::reset(&mut task, &mut world, &mut rng);
            // At the same height first, then at random.
            for step in 0..T::INFO.steps {
                let mut action: Vec<_> = (0..10).map(|_| rng.uniform(-1.0, 1.0) as f32).collect();
                let [one, two] = task.both().each_ref().map(|arm| *arm.scene_from_wrist());
                let off = two.translation.vector - one.translation.vector;
                for axis in [0, 2] {
                    let towards = (off[axis] / 0.01) as f32;
                    action[axis] = if step % 3 > 0 { towards } else { action[axis] };
                }
                (action[1], action[6]) = (-1.0, 1.0);
                act(&mut task, &mut world, &action);
                let [one, two] = task.both();
                nearest = nearest.min(one.gap(two));
            }
        }
        assert!(nearest < 10e-3, "they never met: {nearest} m");
    }

    #[test]
    fn arms_that_push_against_each_other_do_not_pass() {
        push_arms_together::<BiPegTransfer>(count(4, 100));
        push_arms_together::<NeedleRegrasp>(count(4, 100));
    }
}
