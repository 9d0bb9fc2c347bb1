//! Episodes that begin as a reset asks for, instead of as their seed has it.

use nalgebra::Vector3;
use trocar_proto::{Code, Placement, Rejection};

use super::{Env, State};
use crate::sim::frames::{self, Pose};
use crate::sim::world::{BodyId, SUBSTEPS_PER_SECOND, World};
use crate::tasks::Task;

/// Time in which an object that was placed must have come to rest, s.
const SETTLING: f64 = 2.0;

/// How far an object may come to rest from where it was put: m and rad (3°).
const MOVED: f64 = 1e-3;
const TURNED: f64 = 0.052;

/// How deep an object may be put into another body, m: it comes out of it as it settles.
const OVERLAP: f64 = 0.2e-3;

/// An object that is put somewhere.
struct Placed {
    field: String,
    body: BodyId,
    target: Pose,
}

impl Placed {
    fn refuse(&self, why: impl Into<String>) -> Rejection {
        refuse(&self.field, position(&self.target), why)
    }
}

impl Env {
    /// The objects that [`Self::arrange`] may place, by name, and where they are.
    pub fn objects(&self) -> impl Iterator<Item = (&'static str, Pose)> {
        self.task.objects().into_iter().map(|(name, body)| (name, self.world.pose(body)))
    }

    /// Lets the episode, in which no step was taken, begin as `placement` asks for: objects first, which come to rest
    /// where they are put, then tips, then the goal. What cannot be is refused, and then all is as the reset left it.
    pub fn arrange(&mut self, placement: &Placement) -> Result<(), Rejection> {
        placement.check()?;
        if placement.is_empty() {
            return Ok(());
        }
        let is_fresh = self.steps == 0 && !self.is_driven && self.placement.is_empty();
        if self.state != State::Running || !is_fresh {
            let why = "an episode is arranged once, before its first step; reset it";
            return Err(Rejection::new(Code::ResetNeeded, "options", self.steps, why));
        }
        let (mut task, mut world) = (self.task.clone(), self.world.clone());
        arrange(task.as_mut(), &mut world, placement, self.spec.goal_dim())?;
        (self.task, self.world) = (task, world);
        self.placement = placement.clone();
        self.seen.is_present = false;
        self.measure();
        Ok(())
    }
}

fn arrange(
    task: &mut dyn Task,
    world: &mut World,
    placement: &Placement,
    goal_dim: usize,
) -> Result<(), Rejection> {
    let Placement { goal, objects, tip } = placement;
    if task.begins_prepared() && !(objects.is_empty() && tip.is_none()) {
        let field = if objects.is_empty() { "options.tip" } else { "options.objects" };
        let why = "the episode begins with the jaws at the object (by the task, or its option `start`): only \
                   a goal may be given";
        return Err(refuse(field, "given", why));
    }
    if !objects.is_empty() {
        let objects = objects.iter().map(|(name, pose)| place(task, world, name, pose));
        let objects = objects.collect::<Result<Vec<_>, _>>()?;
        settle(task, world, &objects)?;
        task.objects_placed(world);
    }
    if let Some(tip) = tip {
        put_tips(task, tip)?;
    }
    if tip.is_some() || !objects.is_empty() {
        check_arms(task, world, tip.is_some())?;
    }
    if let Some(goal) = goal {
        set_goal(task, world, goal, goal_dim)?;
    }
    Ok(())
}

/// Sets the position of the goal, its first three numbers. The task fixes all other numbers.
fn set_goal(
    task: &mut dyn Task,
    world: &World,
    goal: &[f64],
    goal_dim: usize,
) -> Result<(), Rejection> {
    /// Greatest difference of a fixed number: rounding to single precision.
    const ROUNDING: f64 = 1e-6;
    if goal.len() != goal_dim || goal_dim == 0 {
        let allowed = format!("expected {goal_dim} numbers, as many as a goal of the task has");
        return Err(refuse("options.goal", format!("{} numbers", goal.len()), allowed));
    }
    let (mut achieved, mut desired) = (vec![0.0; goal_dim], vec![0.0; goal_dim]);
    task.goals(world, &mut achieved, &mut desired);
    let positions = if goal_dim < 3 { 0 } else { 3 };
    for (index, (number, fixed)) in goal.iter().zip(&desired).enumerate().skip(positions) {
        let difference = number - f64::from(*fixed);
        if difference.is_nan() || difference.abs() > ROUNDING {
            let allowed = format!("number {} is fixed by the task: allowed is {fixed}", index + 1);
            return Err(refuse("options.goal", format!("{goal:?}"), allowed));
        }
    }
    if positions == 3 {
        task.set_goal(&Vector3::from_column_slice(&goal[..3]))?;
    }
    Ok(())
}

/// Puts an object where it shall be.
fn place(
    task: &dyn Task,
    world: &mut World,
    name: &str,
    pose: &[f64],
) -> Result<Placed, Rejection> {
    let known = task.objects();
    let field = format!("options.objects.{name}");
    let Some((_, body)) = known.iter().find(|(known, _)| *known == name) else {
        let names: Vec<_> = known.iter().map(|(name, _)| *name).collect();
        let allowed = format!("the task has no such object; it has {names:?}");
        return Err(refuse("options.objects", format!("{name:?}"), allowed));
    };
    let left = world.pose(*body);
    let target = match *pose {
        [x, y, z] => Pose::from_parts(Vector3::new(x, y, z).into(), left.rotation),
        [x, y, z, roll, pitch, yaw] => frames::pose([x, y, z], [roll, pitch, yaw]),
        _ => {
            let allowed = "expected 3 numbers (x, y, z in m), or 6 (and roll, pitch, yaw in rad)";
            return Err(refuse(&field, format!("{} numbers", pose.len()), allowed));
        }
    };
    world.place(*body, &target);
    Ok(Placed { field, body: *body, target })
}

/// Lets time pass until the objects rest where they were put, while no instrument takes part.
fn settle(task: &mut dyn Task, world: &mut World, objects: &[Placed]) -> Result<(), Rejection> {
    for arm in &mut task.arms() {
        arm.instrument().withdraw(world);
    }
    for object in objects {
        let depth = world.overlap(object.body, |_| true);
        if depth > OVERLAP {
            let depth = 1e3 * depth;
            return Err(object.refuse(format!("it is in another body there, {depth:.2} mm deep")));
        }
        let middle = world.bounds(object.body).centre();
        let reaches = |reach: &frames::Aabb| reach.clamp(&middle).xy() == middle.xy();
        if !task.arms().iter().any(|arm| reaches(arm.reach())) {
            let ranges: Vec<_> = task.arms().iter().map(|arm| range(arm.reach())).collect();
            let [x, y] = [middle.x, middle.y];
            let allowed = format!(
                "out of reach: its middle, at x {x:.4}, y {y:.4} m, must be in {}",
                ranges.join(" or ")
            );
            return Err(object.refuse(allowed));
        }
    }
    let others = world.objects().filter(|body| objects.iter().all(|object| object.body != *body));
    let others: Vec<_> = others.map(|body| (body, world.pose(body))).collect();
    for object in objects {
        world.wake(object.body);
    }
    for _ in 0..(SETTLING * SUBSTEPS_PER_SECOND) as u32 {
        world.advance();
        if world.at_rest() {
            break;
        }
    }
    for object in objects {
        let now = world.pose(object.body);
        let [moved, turned] = difference(&object.target, &now);
        if !(world.at_rest() && moved <= MOVED && turned <= TURNED) {
            let (moved, turned) = (1e3 * moved, turned.to_degrees());
            let allowed = format!(
                "it does not rest there: after {SETTLING} s it is {moved:.1} mm and {turned:.1}° away, at {}",
                position(&now)
            );
            return Err(object.refuse(allowed));
        }
    }
    for (body, before) in others {
        let [moved, turned] = difference(&before, &world.pose(body));
        if moved > MOVED || turned > TURNED {
            let names = task.objects();
            let name = names.iter().find(|(_, other)| *other == body).map(|(name, _)| *name);
            let (name, moved) = (name.unwrap_or("another object"), 1e3 * moved);
            return Err(objects[0].refuse(format!("it moves {name:?} by {moved:.1} mm")));
        }
    }
    Ok(())
}

/// Puts the arms where their tips shall be.
fn put_tips(task: &mut dyn Task, tip: &[f64]) -> Result<(), Rejection> {
    let mut arms = task.arms();
    let count = arms.len();
    if count == 0 {
        return Err(refuse("options.tip", "given", "the task has no instrument with a tip"));
    }
    if tip.len() != 3 * count && tip.len() != 6 * count {
        let allowed = format!(
            "expected {} numbers (x, y, z in m for each instrument), or {} (and roll, pitch, yaw in rad)",
            3 * count,
            6 * count
        );
        return Err(refuse("options.tip", format!("{} numbers", tip.len()), allowed));
    }
    for (arm, pose) in arms.iter_mut().zip(tip.chunks_exact(tip.len() / count)) {
        arm.put_tip(pose).map_err(|why| refuse("options.tip", format!("{pose:?}"), why))?;
    }
    Ok(())
}

/// Whether no arm is in anything where it begins; `is_put` tells whether the reset asked for that.
fn check_arms(task: &mut dyn Task, world: &World, is_put: bool) -> Result<(), Rejection> {
    let field = if is_put { "options.tip" } else { "options.objects" };
    let arms = task.arms();
    for arm in &arms {
        if arm.is_in_something(world) {
            let at = arm.tip();
            let why = "the instrument would be in an object or a fixed body";
            return Err(refuse(field, position(&Pose::from(at)), why));
        }
    }
    if let [one, other] = arms.as_slice()
        && one.gap(other) < 0.0
    {
        return Err(refuse(
            field,
            position(&Pose::from(one.tip())),
            "the instruments would overlap",
        ));
    }
    Ok(())
}

/// How far a pose is from another: m and rad.
fn difference(from: &Pose, to: &Pose) -> [f64; 2] {
    let moved = to.translation.vector - from.translation.vector;
    [moved.norm(), from.rotation.angle_to(&to.rotation)]
}

fn position(pose: &Pose) -> String {
    let [x, y, z] = pose.translation.vector.into();
    format!("[{x:.4}, {y:.4}, {z:.4}]")
}

fn range(reach: &frames::Aabb) -> String {
    let frames::Aabb { min, max } = reach;
    format!("x [{:.4}, {:.4}], y [{:.4}, {:.4}]", min.x, max.x, min.y, max.y)
}

fn refuse(field: &str, value: impl std::fmt::Display, why: impl Into<String>) -> Rejection {
    Rejection::new(Code::InvalidOption, field, value, why)
}
