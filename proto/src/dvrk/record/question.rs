//! Questions about an arm's kinematics, and their answers.

use bytemuck::{Pod, Zeroable};

use super::values::{Numbers, Text};
use crate::error::{Code, Rejection};

/// Most numbers of an answer: a Jacobian has 36.
pub const MAX_ANSWER: usize = 48;

/// What can be asked of an arm's kinematics; the number is the wire format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Question {
    /// The frame along the chain that these joints lead to, in the reference frame: a pose.
    ForwardKinematics = 0,
    /// The same in the base frame.
    LocalForwardKinematics = 1,
    /// Joints for a pose in the base frame (first group) near to others (second group).
    InverseKinematics = 2,
    /// Joints that turns of motors lead to.
    ActuatorToJointPosition = 3,
    /// The Jacobian in the axes of the end: 6 rows, row by row.
    BodyJacobian = 4,
    /// The Jacobian of the point at the remote centre.
    SpatialJacobian = 5,
    /// Where this arm's numbers of a task's action ask it to be, from where it is: of a PSM a pose in the reference frame
    /// and the jaw angle, of the ECM joints.
    TaskSetPoint = 6,
    /// This arm's numbers of the action that brings a PSM from one pose and jaw angle (first group) to others, or as near
    /// as one action can.
    TaskAction = 7,
}

impl Question {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::ForwardKinematics,
        Self::LocalForwardKinematics,
        Self::InverseKinematics,
        Self::ActuatorToJointPosition,
        Self::BodyJacobian,
        Self::SpatialJacobian,
        Self::TaskSetPoint,
        Self::TaskAction,
    ];
}

/// A question about an arm.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct QuestionRecord {
    /// The arm, by its place.
    pub arm: u32,
    which: u32,
    /// Joints, or a pose and joints.
    pub numbers: Numbers,
}

impl QuestionRecord {
    /// A question about the arm of this place.
    pub fn new(arm: u32, which: Question, groups: [&[f64]; 2]) -> Result<Self, Rejection> {
        Ok(Self { arm, which: which as u32, numbers: Numbers::new("joints", groups)? })
    }

    /// Which question it is.
    pub fn which(&self) -> Result<Question, Rejection> {
        let found = Question::ALL.into_iter().find(|known| *known as u32 == self.which);
        found.ok_or_else(|| {
            let allowed = format!("allowed are numbers below {}", Question::ALL.len());
            Rejection::new(Code::InvalidCommand, "question", self.which, allowed)
        })
    }
}

/// The answer: numbers, or why there are none.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct AnswerRecord {
    values: [f64; MAX_ANSWER],
    count: u32,
    is_answer: u32,
    text: Text,
}

impl AnswerRecord {
    /// An answer of at most [`MAX_ANSWER`] numbers, or why there is none.
    pub fn new(answer: Result<&[f64], &str>) -> Self {
        let mut record = Self::zeroed();
        match answer {
            Ok(numbers) => {
                record.values[..numbers.len()].copy_from_slice(numbers);
                (record.count, record.is_answer) = (numbers.len() as u32, 1);
            }
            Err(why) => record.text = Text::new(why),
        }
        record
    }

    /// The numbers, or why there are none.
    pub fn read(&self) -> Result<&[f64], String> {
        let count = (self.count as usize).min(MAX_ANSWER);
        if self.is_answer == 0 { Err(self.text.read()) } else { Ok(&self.values[..count]) }
    }
}
