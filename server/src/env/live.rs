//! A world whose arms answer the commands of dVRK scripts, substep by substep.

use arrayvec::ArrayVec;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use trocar_proto::{Code, Rejection};

use super::{Env, State, Step};
use crate::dvrk::{ArmController, Homing, Mechanism, SetPoint};
use crate::error::StepError;
use crate::robots::Drivetrain;
use crate::sim::frames::Pose;
use crate::sim::instrument::Posture;
use crate::sim::motion::{Instruments, MAX_INSTRUMENTS, Motion};
use crate::tasks::theatre;

/// Names of the instrument arms.
const PSMS: [&str; MAX_INSTRUMENTS] = ["PSM1", "PSM2"];

/// How far from its set-point an arm counts as held up, m: more than it gives way in a substep.
const HELD_UP: f64 = 0.1e-3;

/// The world of a task whose arms are in the hands of controllers, one for each: `PSM1`, `PSM2`, `ECM`. Beside PSMs the ECM
/// holds the camera, and touches nothing. A tick lets a
/// substep of 1/240 s pass. What stops a step's motion stops these, too; an arm that is held up goes straight
/// towards its latest set-point once it may.
///
/// The task looks at its world as often as in steps, which are counted. Observations, reward and success are those of the present state;
/// what a task does at its steps (the target of ActiveTrack moves on) it does then. Objects are held by friction. A
/// clone is a snapshot, and the same commands at the same ticks give the same bits.
///
/// The reference frame of an arm is its remote centre, until a client sets another base frame;
/// [`Self::world_from_base`] says where it is.
#[derive(Clone)]
pub struct LiveWorld {
    env: Env,
    motion: Motion,
    psms: ArrayVec<ArmController, MAX_INSTRUMENTS>,
    ecm: Option<ArmController>,
    /// The remote centres of PSMs, then that of the ECM.
    world_from_bases: ArrayVec<Pose, { MAX_INSTRUMENTS + 1 }>,
    /// Ticks since the task looked.
    passed: u32,
}

impl LiveWorld {
    /// Takes the arms of an environment that is in an episode in hand, from where they are. Where they are homed in
    /// place, they keep what they hold.
    pub fn new(mut env: Env, homing: Homing) -> Result<Self, Rejection> {
        if env.needs_reset() {
            let why = "an environment that was reset";
            return Err(Rejection::new(Code::ResetNeeded, "env", "no episode", why));
        }
        if let Some(grasp) = env.options.text("grasp").filter(|grasp| *grasp != "interact") {
            let why = "only \"interact\": jaws of live worlds hold by friction";
            return Err(Rejection::new(Code::InvalidOption, "options.grasp", grasp, why));
        }
        env.is_driven = true;
        let mut arms = env.task.arms();
        let postures = arms.iter_mut().map(|arm| *arm.instrument().posture());
        let motion = Motion::chasing(postures);
        let psms = arms.iter_mut().zip(PSMS).map(|(arm, name)| {
            let jaw = arm.instrument().posture().jaw;
            let start: ArrayVec<f64, 7> = arm.encoders().iter().copied().chain([jaw]).collect();
            ArmController::new(name, Mechanism::Psm(*arm.kinematics()), &start)
                .with_drivetrain(arm.drivetrain().clone())
                .with_homing(homing)
        });
        let psms = psms.collect();
        let beside = arms.first().map(|arm| theatre::endoscope(arm.kinematics().model()));
        let mut world_from_bases: ArrayVec<Pose, { MAX_INSTRUMENTS + 1 }> =
            arms.iter().map(|arm| *arm.scene_from_base()).collect();
        drop(arms);
        world_from_bases.extend(env.task.endoscope().map(|arm| *arm.world_from_rcm()));
        let ecm = |kinematics, start: &[f64; 4], drivetrain| {
            ArmController::new("ECM", Mechanism::Ecm(kinematics), start)
                .with_drivetrain(drivetrain)
                .with_homing(homing)
        };
        let own = env.task.endoscope();
        let own = own.map(|arm| ecm(*arm.kinematics(), arm.encoders(), arm.drivetrain().clone()));
        let ecm = own.or_else(|| {
            let (kinematics, world_from_rcm) = beside?;
            world_from_bases.push(world_from_rcm);
            env.endoscope_joints = Some(theatre::JOINTS);
            Some(ecm(kinematics, &theatre::JOINTS, Drivetrain::new([0.0; 4])))
        });
        Ok(Self { env, motion, psms, ecm, world_from_bases, passed: 0 })
    }

    /// The environment.
    pub fn env(&self) -> &Env {
        &self.env
    }

    /// The environment, out of the controllers' hands: it may be reset.
    pub fn into_env(self) -> Env {
        self.env
    }

    /// The arms.
    pub fn arms(&self) -> impl Iterator<Item = &ArmController> {
        self.psms.iter().chain(&self.ecm)
    }

    /// The arm of a name, to read.
    pub fn arm(&self, name: &str) -> Option<&ArmController> {
        self.arms().find(|arm| arm.name() == name)
    }

    /// The arm of a name, to command.
    pub fn arm_mut(&mut self, name: &str) -> Option<&mut ArmController> {
        self.arms_mut().find(|arm| arm.name() == name)
    }

    /// The arms, to command.
    pub fn arms_mut(&mut self) -> impl Iterator<Item = &mut ArmController> {
        self.psms.iter_mut().chain(&mut self.ecm)
    }

    /// Where the remote centre of an arm is in the world.
    pub fn world_from_base(&self, name: &str) -> Option<&Pose> {
        let index = self.arms().position(|arm| arm.name() == name)?;
        self.world_from_bases.get(index)
    }

    /// The objects and where they are in the world.
    pub fn objects(&self) -> impl Iterator<Item = (&'static str, Pose)> {
        let pose = |(name, body)| (name, self.env.world.pose(body));
        self.env.task.objects().into_iter().map(pose)
    }

    /// Where an arm's numbers of a task's action ask it to be, from where it is: of a PSM the wrist in the arm's reference
    /// frame and the opening of the jaws, of the ECM its joints. Errors say what is wrong with the numbers.
    pub(crate) fn task_set_point(
        &mut self,
        place: usize,
        action: &[f64],
    ) -> Result<Vec<f64>, String> {
        let action: Vec<f32> = action.iter().map(|number| *number as f32).collect();
        let check = |expected: usize| match action.len() {
            _ if action.iter().any(|number| !number.is_finite()) => {
                Err("not all are finite".into())
            }
            count if count != expected => Err(format!("{count} numbers, expected {expected}")),
            _ => Ok(()),
        };
        let reference_from_world = self.reference_from_world(place);
        if let Some(arm) = self.env.task.arms().get(place) {
            check(arm.action_len())?;
            let (wrist, jaw) = arm.aim(&action);
            let pose = crate::dvrk::numbers_of(&(reference_from_world * wrist));
            return Ok(pose.into_iter().chain([jaw]).collect());
        }
        let Some(arm) = self.env.task.endoscope() else {
            return Err("no action moves this arm".into());
        };
        check(arm.action_elements().len())?;
        Ok(arm.aim(&action).to_vec())
    }

    /// The numbers of an action that bring a PSM from one wrist and opening of the jaws, in its reference frame, to
    /// others, or as near as one action can. Errors say what is wrong with the numbers.
    pub(crate) fn task_action(
        &mut self,
        place: usize,
        from: &[f64],
        to: &[f64],
    ) -> Result<Vec<f64>, String> {
        let world_from_reference = self.reference_from_world(place).inverse();
        let read = |numbers: &[f64]| {
            let [x, y, z, i, j, k, w, jaw] = *numbers else {
                return Err(format!(
                    "{} numbers, expected a pose and the jaw angle",
                    numbers.len()
                ));
            };
            let turn = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 0.5);
            let turn = turn.filter(|_| numbers.iter().all(|number| number.is_finite()));
            let turn = turn.ok_or("no pose: a quaternion of length 1 is needed")?;
            let pose = Pose::from_parts(Vector3::new(x, y, z).into(), turn);
            Ok((world_from_reference * pose, jaw))
        };
        let (from, to) = (read(from)?, read(to)?);
        let arms = self.env.task.arms();
        let arm = arms.get(place).ok_or("only of PSMs that the task's actions move")?;
        Ok(arm.action_between(&from, &to).into_iter().map(f64::from).collect())
    }

    /// The world in the reference frame of an arm.
    fn reference_from_world(&self, place: usize) -> Pose {
        let arm = self.arms().nth(place).expect("its place was checked");
        *arm.base_frame() * self.world_from_bases[place].inverse()
    }

    /// A number that stands for every bit of what is seen and of what the objects do.
    pub(crate) fn fingerprint(&self) -> u64 {
        self.env.fingerprint()
    }

    /// Ticks of a step of the task.
    pub fn ticks_per_step(&self) -> u32 {
        self.env.substeps
    }

    /// Goes on from this state after `present`: stamps still increase, and every arm tells its operating state.
    pub(crate) fn resume_after(&mut self, present: &Self) {
        for (arm, now) in self.arms_mut().zip(present.arms()) {
            arm.resume_after(now);
        }
    }

    /// Lets a substep pass: the arms follow their controllers' set-points as far as the world lets them.
    pub fn tick(&mut self) -> Result<(), StepError> {
        if self.env.needs_reset() {
            return Err(StepError::ResetNeeded);
        }
        let set_points: ArrayVec<SetPoint, MAX_INSTRUMENTS> =
            self.psms.iter_mut().map(ArmController::tick).collect();
        self.follow(&set_points);
        if let Some(controller) = &mut self.ecm {
            controller.tick();
            let joints = first(controller.encoders());
            match self.env.task.endoscope() {
                Some(arm) => arm.follow(&joints, controller.drivetrain()),
                None => self.env.endoscope_joints = Some(joints),
            }
        }
        self.env.seen.is_present = false;
        self.passed += 1;
        if self.passed == self.env.substeps {
            self.passed = 0;
            self.env.task.after_step(&mut self.env.world);
            self.env.measure();
            self.env.steps += 1;
            if !self.env.world.is_finite() {
                self.env.state = State::Over;
                let what = "the position or velocity of an object";
                return Err(StepError::Simulation { what, step: self.env.steps });
            }
        }
        Ok(())
    }

    /// Moves the instruments, and lets sensors and controllers know where they came.
    fn follow(&mut self, set_points: &[SetPoint]) {
        let Self { env, motion, psms, .. } = self;
        let mut arms = env.task.arms();
        let aims: ArrayVec<([f64; 6], Posture), MAX_INSTRUMENTS> = arms
            .iter()
            .zip(set_points)
            .map(|(arm, set_point)| {
                let links = first(&set_point.joints);
                (links, arm.posture_of(&links, set_point.jaw.unwrap_or_default()))
            })
            .collect();
        let targets: ArrayVec<Posture, MAX_INSTRUMENTS> =
            aims.iter().map(|(_, posture)| *posture).collect();
        let mut instruments: Instruments<'_> =
            arms.iter_mut().map(|arm| arm.instrument()).collect();
        motion.chase(&targets, &mut instruments, &mut env.world);
        drop(instruments);
        for ((arm, controller), (aim, posture)) in arms.iter_mut().zip(psms).zip(&aims) {
            let links = arm.links_near(aim, posture);
            let jaw = arm.jaw_near(&env.world, posture.jaw);
            let axes: ArrayVec<f64, 7> = links.into_iter().chain([jaw]).collect();
            controller.measure(&axes);
            let is = arm.true_wrist().translation.vector;
            let off = (is - posture.world_from_wrist.translation.vector).norm();
            let is_held_up = off > HELD_UP;
            let drivetrain = controller.drivetrain();
            arm.follow(&first(controller.encoders()), &links, drivetrain, is_held_up);
        }
    }

    /// What the present state is worth to the task: reward, success, whether it is terminal. Live worlds have no time
    /// limit.
    pub fn evaluate(&self) -> Step {
        let spec = self.env.spec();
        let mut observation = vec![0.0; spec.observation_dim()];
        let [mut achieved, mut desired] = [(); 2].map(|()| vec![0.0; spec.goal_dim()]);
        self.observe(&mut observation, &mut achieved, &mut desired)
    }

    /// As [`Self::evaluate`], and writes the present observation and goals, of the specification's dimensions.
    pub fn observe(
        &self,
        observation: &mut [f32],
        achieved: &mut [f32],
        desired: &mut [f32],
    ) -> Step {
        self.env.observe(observation, achieved, desired);
        self.env.evaluate(achieved, desired)
    }
}

/// The first `N` axes.
fn first<const N: usize>(axes: &[f64]) -> [f64; N] {
    std::array::from_fn(|index| axes[index])
}
