//! What scripted experts know, and how they look at an arm.
//!
//! An expert is asked at the beginning of a step. The actions that were given before and are still on their way arrive
//! before its own does, so it counts from where they will have brought the arm: its *aim*. What an object
//! does cannot be foreseen; jaws close, lift and let go by what is so now.
//!
//! `expert_sees = "truth"`, the default, shows an expert the true arm and objects. Increments are commanded to an
//! arm that reports other poses where its encoders err, and they bring the true arm to its target all
//! the same, since the error hardly changes from step to step. Where cables tilt jaws that actions of the mode `paper`
//! cannot tilt back, an expert brings their tip to where it would be. `"measured"` shows it what the environment
//! measures: poses as the joint sensors report them, positions of objects with the episode's noise, and whether
//! something keeps jaws apart in place of what their fingers touch.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_proto::Options;
use trocar_proto::spec::OptionSpec;

use super::psm_scene::{PsmArm, STEP_ANGLE, STEP_LENGTH};
use crate::sim::frames::Pose;
use crate::sim::instrument::{JAW_OPEN, TIP_OFFSET};
use crate::sim::world::{BodyId, World};

/// Jaws open at least this far are open, rad.
const OPEN: f64 = 0.9 * JAW_OPEN;

/// Jaws that closed to less than this hold nothing, rad.
const EMPTY: f64 = 0.02;

/// How near to an object the place is, m, at which jaws grip it if something keeps them apart: from the tip 1 mm
/// towards the hinge.
const NEAR: f64 = 1.5e-3;
const GRIP: f64 = TIP_OFFSET - 1e-3;

/// What an expert may look at.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Sees {
    /// The true state.
    #[default]
    Truth,
    /// What the environment measures.
    Measured,
}

impl Sees {
    /// `expert_sees`: what scripted experts look at.
    pub fn option() -> OptionSpec {
        OptionSpec::choice(
            "expert_sees",
            "What the scripted expert looks at. truth: the true state; measured: poses as joint sensors report \
             them, positions of objects with the observation noise.",
            &["truth", "measured"],
        )
    }

    /// What resolved options ask for.
    pub fn of(options: &Options) -> Self {
        if options.text("expert_sees") == Some("measured") { Self::Measured } else { Self::Truth }
    }
}

/// What an expert is told besides the world.
#[derive(Debug, Clone, Copy, Default)]
pub struct ExpertInput<'a> {
    /// Actions that are on their way, one after the other, the oldest first.
    pub in_flight: &'a [f32],
    /// What it may look at.
    pub sees: Sees,
    /// Error of measured positions of objects, m; 0 for the truth.
    pub position_error: Vector3<f64>,
}

impl ExpertInput<'_> {
    /// Where an object is.
    pub fn pose(&self, world: &World, object: BodyId) -> Pose {
        Pose::from(self.position_error) * world.pose(object)
    }
}

/// One of a task's PSMs as its expert looks at it.
#[derive(Debug, Clone)]
pub struct ArmView<'a> {
    arm: &'a PsmArm,
    /// The arm once the commands on their way have been given, where there are any.
    ahead: Option<Box<PsmArm>>,
    sees: Sees,
    /// The wrist now, scene frame.
    pub wrist: Pose,
    /// The wrist where the commands up to now have asked it to be, scene frame.
    pub aim: Pose,
    /// How far the jaws are open, rad.
    pub opening: f64,
    /// How far the jaws are told to be open now, rad.
    told: f64,
}

impl<'a> ArmView<'a> {
    /// The arms of a task, to each of which belongs an equal part of an action, one after the other.
    pub fn of<const N: usize>(
        arms: [&'a PsmArm; N],
        world: &World,
        input: &ExpertInput<'_>,
    ) -> [Self; N] {
        let count = arms[0].action_len();
        let mut index = 0;
        arms.map(|arm| {
            let first = index * count;
            index += 1;
            let own = input.in_flight.chunks(N * count).map(|action| &action[first..][..count]);
            Self::new(arm, own, world, input.sees)
        })
    }

    fn new<'f>(
        arm: &'a PsmArm,
        in_flight: impl Iterator<Item = &'f [f32]>,
        world: &World,
        sees: Sees,
    ) -> Self {
        let mut in_flight = in_flight.peekable();
        let mut ahead = in_flight.peek().map(|_| Box::new(arm.clone()));
        if let Some(ahead) = &mut ahead {
            in_flight.for_each(|action| ahead.command(Some(action)));
        }
        let will = ahead.as_deref().unwrap_or(arm);
        let (wrist, aim) = match sees {
            Sees::Truth => (
                arm.as_upright_as(arm.scene_from_wrist(), arm.true_wrist()),
                will.as_upright_as(will.commanded(), &will.true_commanded()),
            ),
            Sees::Measured => (*arm.scene_from_wrist(), *will.commanded()),
        };
        Self { arm, ahead, sees, wrist, aim, opening: arm.opening(world), told: arm.told_opening() }
    }

    /// The arm once the commands on their way have been given.
    pub fn arm(&self) -> &PsmArm {
        self.ahead.as_deref().unwrap_or(self.arm)
    }

    /// Whether the jaws are open.
    pub fn is_open(&self) -> bool {
        self.opening > OPEN
    }

    /// Whether the jaws are told to be closed now. Jaws that do not have an object then have missed it.
    pub fn is_closed(&self) -> bool {
        self.told < EMPTY
    }

    /// Whether the jaws have closed and nothing is between them.
    pub fn is_empty(&self) -> bool {
        self.is_closed() && self.opening < EMPTY
    }

    /// Whether the commands up to now close the jaws, or keep them closed.
    pub fn closes(&self) -> bool {
        let asked = self.arm().asked_opening();
        asked < OPEN && asked <= self.told
    }

    /// Whether the arm was held up or pushed aside in the last step.
    pub fn is_held_up(&self) -> bool {
        self.arm().is_held_up()
    }

    /// Whether the commands up to now bring it as low as it may go.
    pub fn is_lowest(&self) -> bool {
        self.arm().is_lowest()
    }

    /// Whether the jaws have closed on `object`: both fingers press on it, or something keeps them apart where it is.
    pub fn has(&self, world: &World, object: BodyId, input: &ExpertInput<'_>) -> bool {
        if !self.is_closed() {
            return false; // open fingers may press on what they come down on
        }
        if self.sees == Sees::Truth && self.arm().holds(world, object) {
            return true;
        }
        let place = self.wrist * Point3::new(0.0, 0.0, GRIP) - input.position_error;
        self.opening > EMPTY && world.distance(object, &place) < NEAR
    }

    /// How far `target` is outside of where the wrist may go, m.
    pub fn shortfall(&self, target: &Pose) -> f64 {
        let way = target.translation.vector - self.aim.translation.vector;
        self.arm().shortfall(&(self.arm().commanded().translation.vector + way))
    }

    /// Writes the action that brings the wrist as far from its aim to `target` as one step goes, along a straight line.
    pub fn act(&self, target: &Pose, jaw: f64, action: &mut [f32]) {
        let scale = self.arm().rate().scale();
        let step = target.translation.vector - self.aim.translation.vector;
        let step = step / (step.amax() / (STEP_LENGTH * scale)).max(1.0);
        let turn = (target.rotation * self.aim.rotation.inverse()).scaled_axis();
        let turn = turn / (turn.norm() / (STEP_ANGLE * scale)).max(1.0);
        let asked = self.arm().commanded();
        let rotation = UnitQuaternion::from_scaled_axis(turn) * asked.rotation;
        let target = Pose::from_parts((asked.translation.vector + step).into(), rotation);
        self.arm().encode(&target, jaw, action);
    }
}
