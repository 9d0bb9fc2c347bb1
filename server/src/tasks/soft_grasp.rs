//! What holds something soft in the jaws: friction alone or, to compare with simulators that drag vertices along with a tool,
//! attachments of its skin to the wrist. And how a scripted expert takes it from above.

use nalgebra::{Point3, Vector3};
use trocar_proto::spec::OptionSpec;
use trocar_proto::{Options, Stage};

use super::expert::{ArmView, Sees};
use super::options;
use super::psm_scene::PsmArm;
use crate::sim::frames::Pose;
use crate::sim::grasp::GraspMode;
use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN, TIP_OFFSET};
use crate::sim::world::{SoftId, World};

/// Jaws that are asked to be less open than this are told to close, rad.
const CLOSING: f64 = 0.1;

/// Jaws that are closed and this far open have something between them, rad.
const EMPTY: f64 = 0.01;

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

    /// Whether the jaws of an arm that an expert looks at have closed on it: they hold it, or, as far as measured values
    /// tell, something keeps them apart that is `near` (m) where it was `taken`.
    pub fn has_closed(
        &self,
        arm: &ArmView<'_>,
        world: &World,
        sees: Sees,
        taken: &Vector3<f64>,
        near: f64,
    ) -> bool {
        let holds = || match sees {
            Sees::Truth => self.holds(arm.arm(), world),
            Sees::Measured => {
                let tip = arm.wrist * Point3::new(0.0, 0.0, TIP_OFFSET);
                arm.opening > EMPTY && (tip.coords - taken).norm() < near
            }
        };
        arm.is_closed() && holds()
    }

    /// Whether no finger presses on it, and it is not attached.
    pub fn is_free(&self, arm: &PsmArm, world: &World) -> bool {
        !world.soft(self.soft).is_attached() && arm.fingers_on(world, self.soft) == 0
    }
}

/// What an expert does to take something soft with this `grasp` of the wrist: it closes the jaws where `is_there`, goes down
/// where they `are_about` it, and else opens them `hover` (m) above.
pub fn go_for(grasp: &Pose, are_about: bool, is_there: bool, hover: f64) -> (Stage, Pose, f64) {
    if is_there {
        (Stage::Pick, *grasp, JAW_CLOSED)
    } else if are_about {
        (Stage::Approach, *grasp, JAW_OPEN)
    } else {
        (Stage::Approach, Pose::from(Vector3::z() * hover) * grasp, JAW_OPEN)
    }
}
