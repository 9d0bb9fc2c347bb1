//! An arm that is elsewhere than its joint sensors have it: where its base truly is, and the drivetrain between what its
//! motors are told and its links.
//!
//! Motors go from one commanded posture to the next in joint space, with the timing of an arm that does not err. Where
//! there is a transmission, encoders follow them late and links follow those with play, so that the path of the
//! instrument is known substep by substep.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::{ActionMode, Commanded, PsmArm};
use crate::robots::{Axes, Drivetrain};
use crate::sim::frames::Pose;
use crate::sim::instrument::{JAW_CLOSED, Posture, TIP_OFFSET};
use crate::sim::motion::Arrival;
use crate::sim::motion::profile::{Profile, smoothstep};
use crate::sim::random::Rng;
use crate::sim::world::SUBSTEPS_PER_SECOND;

/// The joints of a posture, rad; index 2 in m, and the jaw behind them.
pub(super) fn axes(joints: &[f64; 6], jaw: f64) -> Axes {
    joints.iter().copied().chain([jaw]).collect()
}

/// The joints among axes.
pub(super) fn first(axes: &[f64]) -> [f64; 6] {
    std::array::from_fn(|joint| axes[joint])
}

impl PsmArm {
    /// Draws what is wrong with the arm in this episode besides these offsets of its encoders, rad.
    pub(super) fn draw_errors(&mut self, offsets: [f64; 7], rng: &Rng) {
        self.drivetrain = Drivetrain::new(offsets);
        if let Some(transmission) = self.errors.draw_transmission(rng) {
            let start = axes(&self.start_joints, JAW_CLOSED);
            self.drivetrain = self.drivetrain.clone().with_transmission(transmission, &start);
        }
        self.asked_drivetrain.clone_from(&self.drivetrain);
        let error = self.errors.draw_base_error(rng, self.middle);
        self.scene_from_true_base =
            error.map_or(self.scene_from_base, |error| error * self.scene_from_base);
    }

    /// What the joints really are, rad; index 2 in m.
    pub(super) fn true_joints(&self) -> [f64; 6] {
        self.drivetrain.settled(&self.joints)
    }

    /// Whether cables tilt its jaws and its actions cannot tilt them back.
    pub fn stays_tilted(&self) -> bool {
        self.drivetrain.gives() && self.mode == ActionMode::Paper
    }

    /// A true wrist as an expert counts with it whose arm [stays tilted](Self::stays_tilted): as much tilted as sensors
    /// have it, with the true tip of the closed jaws, and truly turned about them. Of others the true wrist itself.
    pub fn as_upright_as(&self, sensed: &Pose, truth: &Pose) -> Pose {
        if !self.stays_tilted() {
            return *truth;
        }
        let jaws = sensed.rotation * Vector3::z_axis();
        let error = truth.rotation * sensed.rotation.inverse();
        // The part of the error that is about the jaws.
        let (scalar, about) = (error.scalar(), error.vector().dot(&jaws));
        let turn = 2.0 * libm::atan2(about, scalar);
        let rotation = UnitQuaternion::from_axis_angle(&jaws, turn) * sensed.rotation;
        let tip = truth * Point3::new(0.0, 0.0, TIP_OFFSET);
        Pose::from_parts((tip.coords - *jaws * TIP_OFFSET).into(), rotation)
    }

    /// The true wrist as an expert counts with it.
    pub fn seen_wrist(&self) -> Pose {
        self.as_upright_as(&self.scene_from_wrist, self.true_wrist())
    }

    /// The path of the instrument while its motors are told to go to `end`, from where they were told to be: past where
    /// the command `before` asked the arm to be, where commands come more often than at the nominal rate.
    pub(super) fn stream(&mut self, before: &Commanded, end: &Axes) -> Profile {
        let substeps = self.rate.substeps();
        let start = self.told.pop().map_or_else(|| end.clone(), |(told, _)| told);
        let via = axes(&before.joints, before.jaw);
        let middle = between(&via, end, 0.5);
        let is_nominal = self.rate.is_nominal();
        let mut drivetrain = self.drivetrain.clone();
        self.told.clear();
        self.told.push((start.clone(), drivetrain.clone()));
        let mut postures = vec![*self.instrument.posture()];
        for now in 1..=substeps {
            let told = if is_nominal {
                between(&start, end, smoothstep(now, substeps))
            } else {
                let part = f64::from(now) / f64::from(substeps);
                between(&between(&start, &via, part), &between(&via, &middle, part), part)
            };
            let [_, links] = drivetrain.advance(&told, 1.0 / SUBSTEPS_PER_SECOND);
            let world_from_wrist = self.pose_of(&first(&links));
            postures.push(Posture { world_from_wrist, jaw: links[6] });
            self.told.push((told, drivetrain.clone()));
        }
        Profile::Traced(postures)
    }

    /// Takes note of how far an arm with a transmission came. What holds the links holds the encoders, too.
    pub(super) fn arrive_along(&mut self, arrival: Arrival) {
        let substeps = self.told.len() - 1;
        let done = (arrival.covered * substeps as f64).round() as usize;
        let jaw = self.told[substeps].0[6];
        let (told, drivetrain) = self.told[done].clone();
        self.drivetrain = drivetrain;
        let mut links = self.drivetrain.settled(&first(self.drivetrain.present()));
        if arrival.is_blocked {
            let posture = Posture { world_from_wrist: self.pose_of(&links), jaw };
            links = self.links_near(&links, &posture);
        }
        self.drivetrain.displace(&axes(&links, self.instrument.posture().jaw));
        self.joints = first(self.drivetrain.present());
        self.scene_from_wrist = self.pose_at(&self.joints);
        let told = if arrival.is_blocked { self.joints } else { first(&told) };
        self.told.clear();
        self.told.push((axes(&told, jaw), self.drivetrain.clone()));
    }
}

/// A part of the way from some axes to others.
fn between(from: &[f64], to: &[f64], part: f64) -> Axes {
    from.iter().zip(to).map(|(from, to)| from + (to - from) * part).collect()
}
