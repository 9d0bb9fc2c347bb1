//! What a robot measures of itself: the words `joints`, `proprioception` and `contact` of the option `observation`.
//!
//! | word | numbers for each arm, as its sensors report them |
//! |---|---|
//! | `joints` | PSM: yaw, pitch (rad), insertion (m), roll, wrist pitch, wrist yaw (rad), jaw (opening, rad); ECM: yaw, pitch (rad), insertion (m), roll (rad) |
//! | `proprioception` | the same; then x, y, z of the jaws' tip (m), or of the camera; and roll, pitch, yaw (rad) of the wrist link, or of the camera, as in the state |
//! | `contact` | for each of the two fingers 1 where it presses on an object, else 0; then how hard everything presses on it, N, up to 10 |

use trocar_proto::Options;
use trocar_proto::spec::Element;

use super::Task;
use super::options;
use super::state::State;
use crate::sim::world::World;

/// Which of these an observation has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Proprioception {
    joints: bool,
    all: bool,
    contact: bool,
}

impl Proprioception {
    /// The words of the option `observation`.
    pub(crate) const WORDS: [&str; 2] = ["joints", "proprioception"];

    /// The one that only tasks have whose arms grasp objects.
    pub(crate) const CONTACT: &str = "contact";

    /// What resolved options ask for.
    pub(crate) fn of(options: &Options) -> Self {
        let [joints, all] = Self::WORDS.map(|word| options::observes(options, word));
        Self { joints, all, contact: options::observes(options, Self::CONTACT) }
    }

    /// Whether there is any.
    pub(crate) fn is_wanted(self) -> bool {
        self.joints || self.all || self.contact
    }

    /// The elements of [`Self::measure`].
    pub(crate) fn elements(self, task: &mut dyn Task) -> Vec<Element> {
        let mut elements = vec![];
        let arms = task.arms();
        let is_one = arms.len() == 1;
        for (index, arm) in arms.iter().enumerate() {
            let mut own = vec![];
            if self.joints {
                own.extend(arm.joint_elements());
            }
            if self.all {
                own.extend(arm.joint_elements());
                own.extend(arm.tip_elements());
            }
            if self.contact {
                own.extend(arm.contact_elements());
            }
            for mut element in own {
                if !is_one {
                    element.name = format!("PSM{} {}", index + 1, element.name);
                }
                elements.push(element);
            }
        }
        drop(arms);
        if let Some(endoscope) = task.endoscope() {
            if self.joints {
                elements.extend(endoscope.joint_elements());
            }
            if self.all {
                elements.extend(endoscope.joint_elements());
                elements.extend(State::elements(|state| endoscope.state(state)));
            }
        }
        elements
    }

    /// Writes what the arms measure now over `numbers`.
    pub(crate) fn measure(self, task: &mut dyn Task, world: &World, numbers: &mut Vec<f32>) {
        numbers.clear();
        for arm in &task.arms() {
            if self.joints {
                numbers.extend(arm.measured_joints(world));
            }
            if self.all {
                numbers.extend(arm.measured_joints(world));
                numbers.extend(arm.measured_tip());
            }
            if self.contact {
                numbers.extend(arm.measured_contact(world));
            }
        }
        if let Some(endoscope) = task.endoscope() {
            let joints = endoscope.measured_joints();
            if self.joints {
                numbers.extend(joints);
            }
            if self.all {
                numbers.extend(joints);
                let mut camera = [0.0; 6];
                endoscope.state(&mut State::read(&mut camera));
                numbers.extend(camera);
            }
        }
    }
}
