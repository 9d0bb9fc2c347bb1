//! What is read of an arm in one tick, as messages with one stamp.

use std::rc::Rc;

use nalgebra::{Matrix6xX, Quaternion, UnitQuaternion, Vector3, Vector6};
use trocar_client::LiveWorld;
use trocar_client::proto::dvrk::record::Question;
use trocar_client::proto::dvrk::{ArmInfo, ArmRecord};

use crate::messages::{
    Bool, CartesianState, Header, JointState, Numbers, PoseStamped, Stamp, TwistStamped, Wrench,
    WrenchStamped,
};

/// An arm in one tick. What it does not have without a tool is `None`, and not published.
pub(crate) struct Reading {
    stamp: Stamp,
    info: Rc<ArmInfo>,
    arm: ArmRecord,
    frame: String,
    /// The Jacobians in the axes of the end and at the remote centre, row by row.
    jacobians: Option<[Vec<f64>; 2]>,
}

impl Reading {
    /// The arm as it was in the latest reply. The node asks the server for Jacobians only where a subscriber takes them.
    pub(crate) fn new(
        world: &mut LiveWorld,
        info: &Rc<ArmInfo>,
        stamp: Stamp,
        with_jacobians: bool,
    ) -> anyhow::Result<Self> {
        let arm = *world.arm(&info.name)?;
        let mut jacobians = None;
        if with_jacobians && arm.has_tool != 0 {
            let body = world.ask(&info.name, Question::BodyJacobian, [&[], &[]])?;
            let spatial = world.ask(&info.name, Question::SpatialJacobian, [&[], &[]])?;
            jacobians = body.ok().zip(spatial.ok()).map(|(body, spatial)| [body, spatial]);
        }
        Ok(Self { stamp, info: Rc::clone(info), arm, frame: arm.reference_frame.read(), jacobians })
    }

    fn header(&self) -> Header {
        Header::new(self.stamp, &self.frame)
    }

    /// That of the remote centre's frame.
    fn local_header(&self) -> Header {
        Header::new(self.stamp, &format!("{}_base", self.info.name))
    }

    fn has_tool(&self) -> bool {
        self.arm.has_tool != 0
    }

    /// Joints in this order of positions and velocities, the jaw left out.
    fn joints(&self, position: &[f64], velocity: &[f64]) -> JointState {
        let name = if self.has_tool() { &self.info.joints } else { &self.info.raw_joints };
        let count = name.len();
        JointState {
            header: Header::new(self.stamp, ""),
            name: name.clone(),
            position: position[..count].to_vec(),
            velocity: velocity[..count].to_vec(),
            effort: vec![0.0; count],
        }
    }

    fn jaw(&self, position: &[f64], velocity: &[f64]) -> Option<JointState> {
        let at = self.info.joints.len();
        (self.has_tool() && self.info.has_jaw).then(|| JointState {
            header: Header::new(self.stamp, ""),
            name: vec!["jaw".into()],
            position: vec![position[at]],
            velocity: velocity.get(at).copied().into_iter().collect(),
            effort: vec![0.0],
        })
    }

    fn pose(&self, header: Header, pose: [f64; 7]) -> Option<PoseStamped> {
        self.has_tool().then(|| PoseStamped { header, pose: pose.into() })
    }

    fn no_wrench(&self) -> Option<WrenchStamped> {
        let header = self.header();
        self.has_tool().then(|| WrenchStamped { header, wrench: Wrench::default() })
    }

    /// The twist that velocities of joints give in the axes of the end.
    fn local_twist(&self, velocity: &[f64]) -> Option<Vector6<f64>> {
        let [body, _] = self.jacobians.as_ref()?;
        let count = self.info.joints.len();
        let jacobian = Matrix6xX::from_row_slice(body);
        let velocity = nalgebra::DVector::from_column_slice(&velocity[..count]);
        (jacobian.ncols() == count).then(|| jacobian * velocity)
    }

    pub(crate) fn measured_js(&self) -> JointState {
        self.joints(&self.arm.measured_position, &self.arm.measured_velocity)
    }

    pub(crate) fn setpoint_js(&self) -> JointState {
        self.joints(&self.arm.setpoint_position, &self.arm.setpoint_velocity)
    }

    pub(crate) fn jaw_measured_js(&self) -> Option<JointState> {
        self.jaw(&self.arm.measured_position, &self.arm.measured_velocity)
    }

    /// It has no velocity, as in dVRK.
    pub(crate) fn jaw_setpoint_js(&self) -> Option<JointState> {
        self.jaw(&self.arm.setpoint_position, &[])
    }

    pub(crate) fn measured_cp(&self) -> Option<PoseStamped> {
        self.pose(self.header(), self.arm.measured_cp)
    }

    pub(crate) fn setpoint_cp(&self) -> Option<PoseStamped> {
        self.pose(self.header(), self.arm.setpoint_cp)
    }

    pub(crate) fn local_measured_cp(&self) -> Option<PoseStamped> {
        self.pose(self.local_header(), self.arm.local_measured_cp)
    }

    pub(crate) fn local_setpoint_cp(&self) -> Option<PoseStamped> {
        self.pose(self.local_header(), self.arm.local_setpoint_cp)
    }

    pub(crate) fn measured_cv(&self) -> Option<TwistStamped> {
        let (header, twist) = (self.header(), self.arm.measured_cv.into());
        self.has_tool().then_some(TwistStamped { header, twist })
    }

    /// In the axes of the end, as dVRK has it.
    pub(crate) fn local_measured_cv(&self) -> Option<TwistStamped> {
        let twist: [f64; 6] = self.local_twist(&self.arm.measured_velocity)?.into();
        Some(TwistStamped { header: self.local_header(), twist: twist.into() })
    }

    pub(crate) fn setpoint_cv(&self) -> Option<TwistStamped> {
        let local = self.local_twist(&self.arm.setpoint_velocity)?;
        let [.., i, j, k, w] = self.arm.measured_cp;
        let turn = UnitQuaternion::new_normalize(Quaternion::new(w, i, j, k));
        let part = |row: usize| turn * Vector3::new(local[row], local[row + 1], local[row + 2]);
        let ([x, y, z], [a, b, c]) = (part(0).into(), part(3).into());
        Some(TwistStamped { header: self.header(), twist: [x, y, z, a, b, c].into() })
    }

    /// Efforts are not simulated.
    pub(crate) fn measured_cf(&self) -> Option<WrenchStamped> {
        self.no_wrench()
    }

    pub(crate) fn body_jacobian(&self) -> Option<Numbers> {
        self.jacobians.as_ref().map(|[body, _]| Numbers::matrix(6, body.clone()))
    }

    pub(crate) fn spatial_jacobian(&self) -> Option<Numbers> {
        self.jacobians.as_ref().map(|[_, spatial]| Numbers::matrix(6, spatial.clone()))
    }

    pub(crate) fn measured_cs(&self) -> CartesianState {
        let is = |data: bool| Bool { data };
        let has_tool = self.has_tool();
        CartesianState {
            header: self.header(),
            pose: self.arm.measured_cp.into(),
            pose_is_valid: is(has_tool),
            twist: self.arm.measured_cv.into(),
            twist_is_valid: is(has_tool),
            wrench: Wrench::default(),
            wrench_is_valid: is(false),
        }
    }
}
