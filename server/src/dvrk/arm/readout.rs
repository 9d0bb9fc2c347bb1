//! What can be read of an arm, and asked of its kinematics. All of a tick has the same stamp.

use nalgebra::{Matrix6xX, Vector3, Vector6};

use trocar_proto::dvrk::record::{ArmRecord, Text};

use super::{ArmController, Motion, Stamp};
use crate::dvrk::command::PoseMessage;
use crate::dvrk::mechanism::{self, Mechanism, NoSolution, Pose};
use crate::dvrk::numbers_of;
use crate::robots::{Axes, Drivetrain};

/// Positions, velocities and efforts of joints (`sensor_msgs/JointState`).
#[derive(Debug, Clone, PartialEq)]
pub struct JointState {
    /// The joints' names.
    pub names: &'static [&'static str],
    /// Positions, rad; m for the insertion.
    pub position: Axes,
    /// Velocities, rad/s; m/s for the insertion. Empty where dVRK leaves it so.
    pub velocity: Axes,
    /// Efforts, N·m; N for the insertion: 0, since no dynamics of joints are simulated.
    pub effort: Axes,
}

impl ArmController {
    /// The arm's name: PSM1, ECM.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its mechanics.
    pub fn mechanism(&self) -> &Mechanism {
        &self.mechanism
    }

    /// The stamp of all that is read until the next tick.
    pub fn stamp(&self) -> Stamp {
        Stamp::of_tick(self.ticks)
    }

    /// The frame that Cartesian values are in but `local/*` (`header.frame_id`).
    pub fn reference_frame(&self) -> &str {
        &self.base.reference
    }

    /// Where the remote centre is in the reference frame.
    pub fn base_frame(&self) -> &Pose {
        &self.base.reference_from_base
    }

    /// The tool or endoscope, by name, if there is one.
    pub fn tool(&self) -> Option<&str> {
        self.tool.as_deref()
    }

    /// The ratio of velocities and accelerations of moves; 0 where they differ, as dVRK has it.
    pub fn ratio(&self) -> f64 {
        let [velocity, acceleration] = self.ratios;
        if velocity == acceleration { velocity } else { 0.0 }
    }

    /// All that a client reads of it at once.
    pub fn record(&self) -> ArmRecord {
        let mut record = ArmRecord::in_state(self.operating_state());
        record.stamp = self.stamp().nanoseconds();
        record.has_tool = u32::from(self.tool.is_some());
        record.ratio = self.ratio();
        record.base_frame = numbers_of(self.base_frame());
        record.reference_frame = Text::new(self.reference_frame());
        let fill = |room: &mut [f64], numbers: &[f64]| {
            let count = numbers.len().min(room.len());
            room[..count].copy_from_slice(&numbers[..count]);
        };
        let axes = |of: &Motion| {
            if self.tool.is_some() {
                return (of.position.clone(), of.velocity.clone());
            }
            let raw = self.joint_state(of);
            (raw.position, raw.velocity)
        };
        let [measured, setpoint] = [axes(&self.measured), axes(&self.setpoint)];
        fill(&mut record.measured_position, &measured.0);
        fill(&mut record.measured_velocity, &measured.1);
        fill(&mut record.setpoint_position, &setpoint.0);
        fill(&mut record.setpoint_velocity, &setpoint.1);
        if let (Some(measured), Some(setpoint)) =
            (self.local_measured_cp(), self.local_setpoint_cp())
        {
            let [in_reference, to] = [self.base_frame() * measured, self.base_frame() * setpoint];
            record.local_measured_cp = numbers_of(&measured);
            record.local_setpoint_cp = numbers_of(&setpoint);
            (record.measured_cp, record.setpoint_cp) = (numbers_of(&in_reference), numbers_of(&to));
        }
        if let Some(twist) = self.measured_cv() {
            record.measured_cv.copy_from_slice(twist.as_slice());
        }
        record
    }

    /// What lies between its set-points, encoders and links.
    pub fn drivetrain(&self) -> &Drivetrain {
        &self.drivetrain
    }

    /// What the encoders of all axes say, the jaw behind the joints: rad; index 2 in m.
    pub fn encoders(&self) -> &Axes {
        &self.measured.position
    }

    /// `measured_js`: what the encoders say. Without a tool, three joints and the discs that would drive it.
    pub fn measured_js(&self) -> JointState {
        self.joint_state(&self.measured)
    }

    /// `setpoint_js`: where the arm was to be at the end of the tick.
    pub fn setpoint_js(&self) -> JointState {
        self.joint_state(&self.setpoint)
    }

    /// Where the arm is to be in the end (CRTK's `goal_js`).
    pub fn goal_js(&self) -> JointState {
        let position = self.mechanism.clipped(&self.goal());
        self.joint_state(&Motion { velocity: super::zeros(position.len()), position })
    }

    /// `jaw/measured_js`, of an arm that has a jaw.
    pub fn jaw_measured_js(&self) -> Option<JointState> {
        self.jaw_state(&self.measured)
    }

    /// `jaw/setpoint_js`, which has no velocity, as in dVRK.
    pub fn jaw_setpoint_js(&self) -> Option<JointState> {
        self.jaw_state(&self.setpoint).map(|state| JointState { velocity: Axes::new(), ..state })
    }

    /// `measured_cp` in the reference frame; nothing without a tool.
    pub fn measured_cp(&self) -> Option<Pose> {
        self.local_measured_cp().map(|pose| self.base.reference_from_base * pose)
    }

    /// `setpoint_cp` in the reference frame; nothing without a tool.
    pub fn setpoint_cp(&self) -> Option<Pose> {
        self.local_setpoint_cp().map(|pose| self.base.reference_from_base * pose)
    }

    /// Where the end is to be in the end, in the reference frame (CRTK's `goal_cp`); nothing without a tool.
    pub fn goal_cp(&self) -> Option<Pose> {
        let goal = self.mechanism.clipped(&self.goal());
        self.pose_at(&goal).map(|pose| self.base.reference_from_base * pose)
    }

    /// `local/measured_cp` in the base frame; nothing without a tool.
    pub fn local_measured_cp(&self) -> Option<Pose> {
        self.pose_at(&self.measured.position)
    }

    /// `local/setpoint_cp` in the base frame; nothing without a tool.
    pub fn local_setpoint_cp(&self) -> Option<Pose> {
        self.pose_at(&self.setpoint.position)
    }

    /// `measured_cv`: the twist of the end in the axes of the reference frame, m/s and rad/s; nothing without a tool.
    pub fn measured_cv(&self) -> Option<Vector6<f64>> {
        self.twist(&self.measured)
    }

    /// `setpoint_cv`: that of the set-point.
    pub fn setpoint_cv(&self) -> Option<Vector6<f64>> {
        let velocity = self.setpoint.velocity.clone();
        self.twist(&Motion { position: self.measured.position.clone(), velocity })
    }

    /// `local/measured_cv`, which dVRK gives in the axes of the end; nothing without a tool.
    pub fn local_measured_cv(&self) -> Option<Vector6<f64>> {
        let jacobian = self.body_jacobian()?;
        Some(self.product(&jacobian, &self.measured.velocity))
    }

    /// `body/measured_cf` and `spatial/measured_cf`: 0, since no efforts of joints are simulated; nothing without a
    /// tool.
    pub fn measured_cf(&self) -> Option<Vector6<f64>> {
        self.tool.as_ref().map(|_| Vector6::zeros())
    }

    /// `body/jacobian`: in the axes of the end, linear rows first; nothing without a tool.
    pub fn body_jacobian(&self) -> Option<Matrix6xX<f64>> {
        self.tool.as_ref().map(|_| self.mechanism.body_jacobian(&self.measured.position))
    }

    /// `spatial/jacobian`: of the point at the remote centre, linear rows first; nothing without a tool.
    pub fn spatial_jacobian(&self) -> Option<Matrix6xX<f64>> {
        self.tool.as_ref().map(|_| self.mechanism.spatial_jacobian(&self.measured.position))
    }

    /// The service `forward_kinematics`: the frame along the chain that these joints lead to, in the reference frame.
    pub fn forward_kinematics(&self, joints: &[f64]) -> Result<Pose, NoSolution> {
        self.local_forward_kinematics(joints).map(|pose| self.base.reference_from_base * pose)
    }

    /// The service `local/forward_kinematics`: the same in the base frame.
    pub fn local_forward_kinematics(&self, joints: &[f64]) -> Result<Pose, NoSolution> {
        self.mechanism.forward_along(joints)
    }

    /// The service `inverse_kinematics`: joints for a pose **in the base frame**, as dVRK has it, near to others.
    /// They need not be within the limits of a PSM.
    pub fn inverse_kinematics(
        &self,
        base_from_end: &PoseMessage,
        seed: &[f64],
    ) -> Result<Axes, NoSolution> {
        let is_finite = seed.iter().all(|value| value.is_finite());
        match base_from_end.pose() {
            Ok(pose) if is_finite => self.mechanism.inverse(&pose, seed),
            _ => Err(crate::robots::IkError::NotFinite.into()),
        }
    }

    /// The service `actuator_to_joint_position`: joints that turns of a PSM's motors lead to, the jaw behind them.
    /// Those of an ECM are its joints.
    pub fn actuator_to_joint_position(&self, actuators: &[f64]) -> Result<Axes, NoSolution> {
        let (got, expected) = (actuators.len(), self.mechanism.axes());
        if got != expected {
            return Err(NoSolution::WrongCount { got, expected });
        }
        Ok(match *actuators {
            [yaw, pitch, insertion, a, b, c, d] => {
                let rest = Mechanism::joints_from_discs([a, b, c, d]);
                [yaw, pitch, insertion].into_iter().chain(rest).collect()
            }
            _ => actuators.iter().copied().collect(),
        })
    }

    fn joint_state(&self, of: &Motion) -> JointState {
        let joints = self.mechanism.joints();
        if self.tool.is_none() {
            let discs = |axes: &Axes| match *axes.as_slice() {
                [yaw, pitch, insertion, a, b, c, d] => {
                    let rest = Mechanism::discs_from_joints([a, b, c, d]);
                    [yaw, pitch, insertion].into_iter().chain(rest).collect()
                }
                _ => axes.clone(),
            };
            return JointState {
                names: &mechanism::DISC_NAMES,
                position: discs(&of.position),
                velocity: discs(&of.velocity),
                effort: super::zeros(of.position.len()),
            };
        }
        part(self.mechanism.names(), of, 0..joints)
    }

    fn jaw_state(&self, of: &Motion) -> Option<JointState> {
        let range = self.mechanism.joints()..self.mechanism.axes();
        (!range.is_empty() && self.tool.is_some()).then(|| part(self.mechanism.names(), of, range))
    }

    fn pose_at(&self, positions: &[f64]) -> Option<Pose> {
        self.tool.as_ref().map(|_| self.mechanism.forward(positions))
    }

    fn twist(&self, of: &Motion) -> Option<Vector6<f64>> {
        self.tool.as_ref()?;
        let local = self.product(&self.mechanism.jacobian(&of.position), &of.velocity);
        let turned = |row: usize| {
            let part: Vector3<f64> = local.fixed_rows::<3>(row).into_owned();
            self.base.reference_from_base.rotation * part
        };
        let [linear, angular] = [turned(0), turned(3)];
        Some(Vector6::from_iterator(linear.iter().chain(&angular).copied()))
    }

    fn product(&self, jacobian: &Matrix6xX<f64>, velocity: &[f64]) -> Vector6<f64> {
        let columns = jacobian.column_iter().zip(&velocity[..self.mechanism.joints()]);
        columns.fold(Vector6::zeros(), |sum, (column, velocity)| sum + column * *velocity)
    }
}

/// Some of the axes.
fn part(names: &'static [&'static str], of: &Motion, range: std::ops::Range<usize>) -> JointState {
    let slice = |axes: &Axes| axes[range.clone()].iter().copied().collect();
    JointState {
        names: &names[range.clone()],
        position: slice(&of.position),
        velocity: slice(&of.velocity),
        effort: super::zeros(range.len()),
    }
}
