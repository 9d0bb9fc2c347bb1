//! How time passes for a task: a command, the substeps of the motion that it asks for, and a look at where the
//! arms are.

use super::Task;
use crate::sim::motion::{Effort, Instruments, Motion};
use crate::sim::world::World;

/// The motion of a task's arms, which may begin and end in the middle of a step.
#[derive(Debug, Clone, Default)]
pub(crate) struct Time {
    motion: Motion,
}

impl Time {
    /// Gives `action` to the task, or lets its arms hold where there is none, within `substeps`.
    pub(crate) fn command(
        &mut self,
        task: &mut dyn Task,
        world: &mut World,
        action: Option<&[f32]>,
        substeps: u32,
    ) {
        task.command(world, action);
        self.motion.begin(task.arms().iter().map(|arm| arm.profile().clone()), substeps);
    }

    /// Lets `substeps` pass, at most as many as are left of the motion.
    pub(crate) fn pass(&mut self, task: &mut dyn Task, world: &mut World, substeps: u32) -> Effort {
        let mut arms = task.arms();
        let mut instruments: Instruments<'_> =
            arms.iter_mut().map(|arm| arm.instrument()).collect();
        self.motion.pass(substeps, &mut instruments, world)
    }

    /// Lets the arms' sensors report where the arms are. The endoscope, which touches nothing, moves only then; its
    /// part of the effort is given.
    pub(crate) fn sense(&self, task: &mut dyn Task) -> Effort {
        for (arm, arrival) in task.arms().iter_mut().zip(self.motion.arrivals()) {
            arm.arrive(arrival);
        }
        let mut effort = Effort::default();
        if let Some(endoscope) = task.endoscope() {
            let joints = endoscope.true_joints();
            endoscope.glide(self.motion.passed());
            effort.tip_path = endoscope.tip_path(&joints);
        }
        effort
    }
}

/// Lets a step of `substeps` pass for a task whose commands are not late.
pub(crate) fn step(task: &mut dyn Task, world: &mut World, action: Option<&[f32]>, substeps: u32) {
    let mut time = Time::default();
    time.command(task, world, action, substeps);
    time.pass(task, world, substeps);
    time.sense(task);
    task.after_step(world);
}
