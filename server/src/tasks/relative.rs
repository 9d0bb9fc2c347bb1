//! The word `relative` of the option `observation`: which features each kind of task has.
//!
//! | tasks | features |
//! |---|---|
//! | all | desired goal from achieved goal, at several scales |
//! | PSM | each wrist: its place, its turn; the goal from the tip of its jaws |
//! | PSM with an object | its jaw; from each tip: every point at which the object can be grasped, and the object; in the wrist's axes: the line along which the jaws lie there, which half a turn leaves alone, and the turns of the object's places; these and the object in the scene, too |
//! | two PSMs | the wrists from each other |
//! | blocks | at which height they clear the pegs |
//! | ECM | the camera's place and turns; what the task sees |
//!
//! Lengths are told as parts of 50 mm, up to 150 mm, and through tanh as parts of 10, 3 and 1 mm: there a policy tells a
//! tenth of a millimetre from nothing. What all rules compute is in [`trocar_proto::relative`].

use nalgebra::Vector3;
use trocar_proto::Options;
use trocar_proto::relative::{Bound, Feature, Place, Relative, Rule};
use trocar_proto::spec::Element;

use super::options::{self, Preset};
use super::psm_scene::PsmArm;
use crate::sim::instrument::TIP_OFFSET;

/// The word.
pub(crate) const WORD: &str = "relative";

/// Whether resolved options ask for these features.
pub(crate) fn is_wanted(options: &Options) -> bool {
    options::observes(options, WORD)
}

/// The whole range of lengths that matter, m, and those that matter nearby.
const FAR: f64 = 0.05;
const NEAR: [f64; 3] = [0.01, 0.003, 0.001];

/// Numbers of what `PsmArm::state` has: where the angles and the jaw begin.
const ANGLES: usize = 3;
const JAW: usize = 6;

/// Jaw angle that is neither open nor closed, and half of its range; and how finely an almost closed one is told, rad.
const JAW_MIDDLE: f32 = 0.35;
const THIN: [f32; 2] = [0.05, 0.02];

/// A list of features that grows.
struct List {
    frame: &'static str,
    /// Numbers of the state for a metre.
    per_metre: f64,
    features: Vec<Feature>,
}

impl List {
    fn new(frame: &'static str, preset: Preset) -> Self {
        Self { frame, per_metre: options::position_scale(preset), features: vec![] }
    }

    fn add(&mut self, name: &str, rule: Rule) {
        self.features.push(Feature { name: name.into(), frame: self.frame.into(), rule });
    }

    /// An offset of three lengths at several scales, m: through tanh where they are small.
    fn offset(&mut self, name: &str, to: Place, from: Place, scales: &[f64]) {
        for metres in scales {
            let bound = if *metres < FAR { Bound::Tanh } else { Bound::Clip };
            let scale = (metres * self.per_metre) as f32;
            self.add(name, Rule::Offset { to, from, count: 3, scale, bound });
        }
    }

    /// Where something is from a fixed place, m.
    fn place(&mut self, name: &str, to: usize, from: &Vector3<f64>, scale: f64) {
        let from = Place::Fixed(self.numbers(from));
        self.offset(name, Place::At(to), from, &[scale]);
    }

    /// How far jaws are open: all of their range, and how nearly they are closed.
    fn jaw(&mut self, name: &str, at: usize) {
        let scales = [(JAW_MIDDLE, JAW_MIDDLE, Bound::Clip), (THIN[0], THIN[1], Bound::Tanh)];
        for (from, scale, bound) in scales {
            let (to, from) = (Place::At(at), Place::Fixed([from; 3]));
            self.add(name, Rule::Offset { to, from, count: 1, scale, bound });
        }
    }

    /// The tip of closed jaws of the arm whose numbers begin at `wrist`: along the y axis of its wrist link.
    fn tip(&self, wrist: usize) -> Place {
        let offset = self.numbers(&(Vector3::y() * TIP_OFFSET));
        Place::On { at: wrist, angles: wrist + ANGLES, offset }
    }

    /// A place or way of so many metres in the unit of the state.
    fn numbers(&self, metres: &Vector3<f64>) -> [f32; 3] {
        metres.map(|metres| (metres * self.per_metre) as f32).into()
    }

    fn done(self) -> Relative {
        Relative { dims: [0; 2], features: self.features }
    }
}

/// A point at which an object is grasped, on one of the places that its state has.
pub(super) struct Grip {
    /// Its name.
    pub(super) name: String,
    /// Which place of the state it is on.
    pub(super) place: usize,
    /// Where the tips of the jaws go, m, in the axes of that place.
    pub(super) offset: Vector3<f64>,
    /// Along what the jaws lie that hold it, in the same axes, length 1. Half a turn about the way in makes no difference.
    pub(super) along: Vector3<f64>,
}

impl Grip {
    /// The place of this number itself, along its y axis.
    pub(super) fn at(place: usize, name: &str) -> Self {
        let (offset, along) = (Vector3::zeros(), Vector3::y());
        Self { name: name.into(), place, offset, along }
    }
}

/// What stands where in the state of a task with PSMs and an object: see [`super::objects::state`] and
/// [`super::bimanual::state`].
pub(super) struct Grasping<'a, const ARMS: usize> {
    /// The arms.
    pub(super) arms: [&'a PsmArm; ARMS],
    /// The object.
    pub(super) object: &'a str,
    /// The places that its state has, by name.
    pub(super) places: [&'a str; ARMS],
    /// Where each arm grasps it, first of all on its own place.
    pub(super) grips: [Vec<Grip>; ARMS],
    /// A height of the object that matters to a millimetre, m, scene frame.
    pub(super) level: Option<f64>,
    /// The unit of the state.
    pub(super) preset: Preset,
}

impl<const ARMS: usize> Grasping<'_, ARMS> {
    /// The features of such a task.
    pub(super) fn features(&self) -> Relative {
        let mut list = List::new("scene", self.preset);
        let object = PsmArm::OBSERVED * ARMS;
        let place = |index: usize| object + 3 + 3 * ARMS + 6 * index;
        let achieved = place(ARMS);
        let desired = achieved + 3;
        let mut centre = Vector3::zeros();
        for (index, arm) in self.arms.iter().enumerate() {
            let name = if ARMS == 1 { String::new() } else { format!("PSM{} ", index + 1) };
            let name = |what: &str| format!("{name}{what}");
            let wrist = PsmArm::OBSERVED * index;
            let seen_from = wrist + ANGLES;
            let tip = list.tip(wrist);
            list.wrist(&name, wrist, arm);
            list.jaw(&name("jaw"), wrist + JAW);
            centre += arm.reach().centre() / ARMS as f64;
            for grip in &self.grips[index] {
                let (at, angles) = (place(grip.place), place(grip.place) + 3);
                let offset = list.numbers(&grip.offset);
                let from_tip = format!("{} from {}", grip.name, name("tip"));
                list.offset(
                    &from_tip,
                    Place::On { at, angles, offset },
                    tip,
                    &[FAR, NEAR[0], NEAR[2]],
                );
                let direction = grip.along.map(|part| part as f32).into();
                let rule = Rule::Line { of: angles, direction, seen_from };
                list.add(&format!("{} in {}", grip.name, name("wrist")), rule);
            }
            for (index, of) in self.places.iter().enumerate() {
                let rule = Rule::Rotation { of: place(index) + 3, seen_from: Some(seen_from) };
                list.add(&format!("{of} in {}", name("wrist")), rule);
            }
            list.offset(
                &format!("{} from {}", self.object, name("tip")),
                Place::At(object),
                tip,
                &[FAR],
            );
            list.offset(&format!("goal from {}", name("tip")), Place::At(desired), tip, &[FAR]);
        }
        if ARMS > 1 {
            let other = Place::At(PsmArm::OBSERVED);
            list.offset("PSM1 wrist from PSM2's", Place::At(0), other, &[FAR, NEAR[0]]);
        }
        list.place(self.object, object, &centre, FAR);
        if let Some(level) = self.level {
            centre.z = level;
            let from = Place::Fixed(list.numbers(&centre));
            list.offset(&format!("{}, level", self.object), Place::At(object), from, &NEAR[..2]);
        }
        for (index, name) in self.places.iter().enumerate() {
            list.add(name, Rule::Rotation { of: place(index) + 3, seen_from: None });
        }
        list.goal(achieved);
        list.done()
    }
}

impl List {
    /// A number of the state as a part of its range.
    fn part(&mut self, to: usize, element: &Element) {
        let from = Place::Fixed([0.5 * (element.min + element.max); 3]);
        let scale = 0.5 * (element.max - element.min);
        let rule = Rule::Offset { to: Place::At(to), from, count: 1, scale, bound: Bound::Clip };
        self.add(&element.name, rule);
    }

    /// Where a wrist is, and how it is turned.
    fn wrist(&mut self, name: &impl Fn(&str) -> String, at: usize, arm: &PsmArm) {
        self.place(&name("wrist"), at, &arm.reach().centre(), FAR);
        self.add(&name("wrist link"), Rule::Rotation { of: at + ANGLES, seen_from: None });
    }

    /// How far the desired goal is from the achieved one, which begins at `achieved`: a place.
    fn goal(&mut self, achieved: usize) {
        let scales = [FAR, NEAR[0], NEAR[1]];
        self.offset("goal from achieved", Place::At(achieved + 3), Place::At(achieved), &scales);
    }
}

/// The features of a task that moves the tip of an empty PSM.
pub(super) fn reaching(arm: &PsmArm, preset: Preset) -> Relative {
    let mut list = List::new("scene", preset);
    let desired = PsmArm::OBSERVED + 3;
    list.wrist(&|what| what.into(), 0, arm);
    list.offset("goal from tip", Place::At(desired), list.tip(0), &[FAR]);
    list.goal(PsmArm::OBSERVED);
    list.done()
}

/// The features of a task that brings a `point` of a soft body somewhere. Its state has the point, that less the wrist's,
/// `points` with this name and so many, and other numbers, told as parts of their range; its goal of `goal_dim` numbers begins with the
/// point's place.
pub(super) fn handling(
    arm: &PsmArm,
    (name, points): (&str, usize),
    point: &str,
    state: &[Element],
    goal_dim: usize,
) -> Relative {
    let mut list = List::new("scene", Preset::Paper);
    let at = PsmArm::OBSERVED;
    let (first, achieved) = (at + 6, state.len());
    let tip = list.tip(0);
    list.wrist(&|what| what.into(), 0, arm);
    list.jaw("jaw", JAW);
    list.offset(&format!("{point} from tip"), Place::At(at), tip, &[FAR, NEAR[0], NEAR[2]]);
    for index in 0..points {
        let what = format!("{name} {} from tip", index + 1);
        list.offset(&what, Place::At(first + 3 * index), tip, &[FAR]);
    }
    for (to, element) in state.iter().enumerate().skip(first + 3 * points) {
        list.part(to, element);
    }
    let (to, from) = (Place::At(achieved + goal_dim), Place::At(achieved));
    list.offset("goal from tip", to, tip, &[FAR]);
    list.offset("goal from achieved", to, from, &[FAR, NEAR[0], NEAR[1]]);
    list.done()
}

/// The features of a task that moves the endoscope, whose pose is the first that its `state` has. From `turns` on it has
/// three Euler angles each; all other numbers are told as parts of their range. `scales` are those of the goal's `count`
/// numbers.
pub(super) fn looking(
    state: &[Element],
    turns: &[usize],
    count: usize,
    scales: &[f32],
) -> Relative {
    /// What camera positions are told as parts of, m: about the arm's reach.
    const REACH: f64 = 0.1;
    /// Numbers of the endoscope's pose.
    const POSE: usize = 6;
    let mut list = List::new("rcm", Preset::Paper);
    list.place("camera", 0, &Vector3::zeros(), REACH);
    list.add("camera", Rule::Rotation { of: ANGLES, seen_from: None });
    for at in turns {
        list.frame = "world";
        list.add("camera", Rule::Rotation { of: *at, seen_from: None });
    }
    list.frame = "";
    for (to, element) in state.iter().enumerate().skip(POSE) {
        if turns.iter().any(|at| (*at..at + 3).contains(&to)) {
            continue;
        }
        list.part(to, element);
    }
    let achieved = state.len();
    for (index, scale) in scales.iter().enumerate() {
        let bound = if index == 0 { Bound::Clip } else { Bound::Tanh };
        let (to, from) = (Place::At(achieved + count), Place::At(achieved));
        list.add("goal from achieved", Rule::Offset { to, from, count, scale: *scale, bound });
    }
    list.done()
}
