//! What holds something soft in the jaws: friction alone or, to compare with simulators that drag vertices along with a tool,
//! attachments of its skin to the wrist.

use trocar_proto::Options;
use trocar_proto::spec::OptionSpec;

use super::options;
use super::psm_scene::PsmArm;
use crate::sim::grasp::GraspMode;
use crate::sim::world::{SoftId, World};

/// Jaws that are asked to be less open than this are told to close, rad.
const CLOSING: f64 = 0.1;

/// How jaws hold something soft.
#[derive(Debug, Clone, Copy)]
pub struct SoftGrasp {
    soft: SoftId,
    mode: GraspMode,
}

impl SoftGrasp {
    /// `grasp` and `grasp_distance` of tasks with something soft.
    pub fn options() -> [OptionSpec; 2] {
        let [_, distance] = options::grasp();
        let grasp = OptionSpec::choice(
            "grasp",
            "interact: friction, and nothing else; approx: the skin between closed jaws is attached to the wrist.",
            &["interact", "approx"],
        );
        let summary = "approx: how far from between the jaws skin may be, m.".into();
        [grasp, OptionSpec { summary, ..distance }]
    }

    /// How jaws hold a soft body under these options.
    pub fn new(options: &Options, soft: SoftId) -> Self {
        Self { soft, mode: options::grasp_of(options) }
    }

    /// What happens when the jaws of an arm were told to open or to close, before they move.
    pub fn command(&self, arm: &PsmArm, world: &mut World) {
        if arm.asked_opening() > CLOSING && world.soft(self.soft).is_attached() {
            world.soft_mut(self.soft).detach();
        }
    }

    /// What happens after they moved.
    pub fn after_step(&self, arm: &mut PsmArm, world: &mut World) {
        let GraspMode::Approx { distance } = self.mode else { return };
        if arm.asked_opening() <= CLOSING && !world.soft(self.soft).is_attached() {
            arm.instrument().attach_skin(world, self.soft, distance);
        }
    }

    /// Whether both fingers press on it, or it is attached.
    pub fn holds(&self, arm: &PsmArm, world: &World) -> bool {
        world.soft(self.soft).is_attached() || arm.fingers_on(world, self.soft) == 2
    }

    /// Whether no finger presses on it, and it is not attached.
    pub fn is_free(&self, arm: &PsmArm, world: &World) -> bool {
        !world.soft(self.soft).is_attached() && arm.fingers_on(world, self.soft) == 0
    }
}
