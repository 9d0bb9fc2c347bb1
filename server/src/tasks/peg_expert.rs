//! The scripted expert that moves a block from peg to peg with one arm.
//!
//! It looks only at the present state, so it picks up again what it has lost. It opens the jaws above a
//! wall of the block, goes down with one finger between wall and peg, closes, and lifts the block over the
//! pegs. It brings the block over its target, lets it down, opens, and leaves.

use nalgebra::{Point3, Vector3};
use trocar_proto::Stage;

use super::expert::{ArmView, ExpertInput};
use super::peg_board::{Block, PegBoard};
use super::pick::jaws_across;
use super::psm_scene::PsmArm;
use super::relative::Grip;
use super::start::{Extent, Start};
use crate::sim::frames::Pose;
use crate::sim::instrument::{FINGER_HALF, JAW_CLOSED, JAW_OPEN, TIP_OFFSET};
use crate::sim::random::Rng;
use crate::sim::world::World;

/// How far the tips of closed jaws reach below the block's top, m.
const DEPTH: f64 = 3.5e-3;

/// How high what is carried, and an empty jaw, pass over the pegs, m.
pub(super) const PASS: f64 = 2e-3;

/// How deep in the block the fingers must have room when they come down, m: what is deeper pushes the block aside.
const ENTRY: f64 = 2e-3;

/// How far off the wrist may be when it goes down, on its way, and when the jaws close, m: across the wall and along it.
const ALIGNED: [f64; 2] = [0.8e-3, 2e-3];
const COMING: [f64; 2] = [1.5e-3, 3e-3];
const ABOUT: [f64; 2] = [2e-3, 3e-3];

/// How far the jaws may be turned from where they are to close, rad.
const TURNED: f64 = 0.06;

/// How low the wrist must be for the jaws to close, m above the grasp, and where it was held up.
const LOW: f64 = 1e-3;
const LOW_ENOUGH: f64 = 2e-3;

/// How far the wrist may be from the grasp while the jaws close, m.
const CLOSING: f64 = 4e-3;

/// How far a wrist goes up that was held up on its way down, m.
const BACK: f64 = 3e-3;

/// Room that may be missing beside a wall for a radian less to turn, m.
const TIGHT: f64 = 0.1e-3;

/// Part of a wall's way from the axis along y that is well on its side.
const WELL_ASIDE: f64 = 0.5;

/// Part of it that may be missing for a radian less to turn.
const AWKWARD: f64 = 0.1;

/// Jaws open at least this far are about a wall, and how exactly, rad and m.
const OPEN: f64 = 0.9 * JAW_OPEN;
const EXACTLY: f64 = 0.4e-3;

/// How far the peg is from the block's axis when the block is let down, m, away from the wall that
/// is held: there the jaws have room to open.
const OFF_AXIS: f64 = 1.5e-3;

/// How exactly the block is over its target before it is let down, m.
const OVER: f64 = 1.5e-3;

/// How far a block that is being let down may be off, m: more, and it is lifted again.
const STILL_OVER: f64 = 3e-3;

/// Height over the board at which a block is let go, m.
const LET_GO: f64 = 1e-3;

/// How far below the board a block is sent that is let down, m: the board stops it.
const PRESS: f64 = 0.5e-3;

/// How much a block hangs askew that cannot be let down all the way about a peg, rad.
const ASKEW: f64 = 0.15;

/// How deep the peg must be in such a block that is let go, m, and where it was held up; and from how far above it is let
/// down.
const SLIDES: f64 = 6e-3;
const CATCHES: f64 = 2e-3;
const ABOVE: f64 = 6e-3;

/// Largest way of a block that begins lifted from its prepared place along x and y, m, and the distance of the wrist
/// from the edge of its reach.
const SHIFT: f64 = 0.015;
const INSET: f64 = 2e-3;

/// The same of a block that stands about its peg, m: there is room for 2.7 mm.
const PLAY: f64 = 1e-3;

/// A block that is to go to a target.
#[derive(Debug, Clone, Copy)]
pub struct Transfer {
    /// The block.
    pub block: Block,
    /// The peg to which it is to go.
    pub target: usize,
    /// Where the wall lies by which it is best held, seen from its axis: 1 towards y, −1 against it, 0
    /// wherever.
    pub side: f64,
}

impl Transfer {
    /// How far the work is done.
    pub fn progress(&self, arm: &PsmArm, world: &World) -> Start {
        let block = world.pose(self.block.body());
        if arm.holds(world, self.block.body()) {
            let passes = bottom(self.block, &block) - peg_top();
            return if passes >= 0.5 * PASS { Start::Lift } else { Start::Pick };
        }
        let wrist = arm.seen_wrist();
        let (grasp, _) = self.grasp(&block, &wrist, |pose| arm.shortfall(&pose.translation.vector));
        let off = wrist.translation.vector - grasp.translation.vector;
        let about = off.xy().norm() < EXACTLY && off.z < LOW && arm.opening(world) > OPEN;
        if about { Start::Approach } else { Start::Reset }
    }

    /// Places the block of a prepared start, which has grown by `growth` and was at `before`, anew, and moves the wrist
    /// with it. `is_lifted`: true if it hangs in the air.
    pub fn vary(
        &self,
        arm: &PsmArm,
        world: &mut World,
        (before, growth): (&Pose, f64),
        is_lifted: bool,
        rng: &mut Rng,
        extent: Extent,
    ) -> Pose {
        let mut wrist = *arm.true_wrist();
        let mut draw = |low: f64, high: f64| rng.uniform(low.min(0.0), high.max(0.0));
        let way = if is_lifted {
            let (at, reach) = (wrist.translation.vector, arm.reach());
            let mut along = |axis: usize| {
                let low = (reach.min[axis] + INSET - at[axis]).max(-SHIFT);
                draw(low, (reach.max[axis] - INSET - at[axis]).min(SHIFT))
            };
            Vector3::new(along(0), along(1), 0.0)
        } else {
            Vector3::new(draw(-PLAY, PLAY), draw(-PLAY, PLAY), 0.0)
        };
        let wall = held_wall(self.block, before, &wrist);
        let way = way * extent.share;
        wrist.translation.vector +=
            self.block.place_grown(world, before, (wall, growth), is_lifted, &way);
        wrist
    }

    /// What is done now: where the wrist goes for it, and the angle of the jaws, rad.
    pub fn plan(
        &self,
        arm: &ArmView<'_>,
        world: &World,
        input: &ExpertInput<'_>,
    ) -> (Stage, (Pose, f64)) {
        let by = |way: Vector3<f64>| Pose::from(way) * arm.wrist;
        let held = arm.has(world, self.block.body(), input);
        let block = input.pose(world, self.block.body());
        let height = bottom(self.block, &block) - PegBoard::top();
        if PegBoard::is_on(world, self.block, self.target) && (height < LET_GO || !held) {
            // Open, then straight up and out of the way.
            let up = if arm.is_open() { pass() - arm.wrist.translation.z } else { 0.0 };
            return (Stage::Place, (by(Vector3::z() * up.max(0.0)), JAW_OPEN));
        }
        if held {
            let (stage, way, jaw) = self.carry(arm, &block);
            return (stage, (by(way), jaw));
        }
        self.pick(arm, &block)
    }

    /// What is done with a held block now, the way on which it goes, and the angle of the jaws, rad.
    fn carry(&self, arm: &ArmView<'_>, block: &Pose) -> (Stage, Vector3<f64>, f64) {
        if arm.arm().stays_tilted() && (block.rotation * Vector3::z()).z < libm::cos(ASKEW) {
            return self.carry_askew(arm, block);
        }
        let held = held_wall(self.block, block, &arm.wrist);
        let goal = PegBoard::peg(self.target) + outwards(self.block, block, held) * OFF_AXIS;
        let way = level(&(goal - block.translation.vector));
        let bottom = bottom(self.block, block);
        let passes = bottom - peg_top();
        let near = if passes < 0.0 { STILL_OVER } else { OVER };
        let (stage, way) = if way.norm() < near && arm.is_held_up() && passes < 0.0 {
            (Stage::Place, way + Vector3::z() * BACK) // it came down on the peg
        } else if way.norm() < near {
            (Stage::Place, way + Vector3::z() * (PegBoard::top() - PRESS - bottom))
        } else if passes < 0.5 * PASS {
            (Stage::Lift, lifting(arm, self.block, block, PASS - passes))
        } else {
            (Stage::Carry, way + Vector3::z() * (PASS - passes))
        };
        (stage, way, JAW_CLOSED)
    }

    /// The same of a block that hangs askew: it goes along its axis, is let go about the peg, and slides down that.
    fn carry_askew(&self, arm: &ArmView<'_>, block: &Pose) -> (Stage, Vector3<f64>, f64) {
        let peg = PegBoard::peg(self.target);
        let tip = Point3::new(peg.x, peg.y, peg_top());
        let tip_in_block = block.inverse_transform_point(&tip);
        let half = self.block.half_height();
        let on_axis = |deep: f64| block * Point3::new(0.0, 0.0, deep - half);
        // How deep the peg is in the block.
        let deep = tip_in_block.z + half;
        let is_about = deep > 0.0 && level(&tip_in_block.coords).norm() < STILL_OVER;
        let way = level(&(tip - on_axis(0.0)));
        let is_over = (-ABOVE..=0.0).contains(&deep) && way.norm() < OVER;
        let passes = bottom(self.block, block) - peg_top();
        if is_about && (deep > SLIDES || deep > CATCHES && arm.is_held_up()) {
            (Stage::Place, Vector3::zeros(), JAW_OPEN)
        } else if is_about && !arm.is_held_up() || is_over {
            (Stage::Place, tip - on_axis(SLIDES + CATCHES), JAW_CLOSED)
        } else if passes < 0.5 * PASS {
            (Stage::Lift, lifting(arm, self.block, block, PASS - passes), JAW_CLOSED)
        } else {
            (Stage::Carry, way + Vector3::z() * (PASS - passes), JAW_CLOSED)
        }
    }

    /// The wrist that grasps the block best for an arm with its wrist at `wrist`, and the wall. `shortfall`: how far a
    /// wrist is outside of where the arm may go, m.
    fn grasp(&self, block: &Pose, wrist: &Pose, shortfall: impl Fn(&Pose) -> f64) -> (Pose, usize) {
        let (grasp, _, wall) = (0..Block::WALLS)
            .map(|wall| {
                let (pose, missing) = grasp(self.block, block, wall, wrist);
                let aside = self.side * outwards(self.block, block, wall).y;
                let awkward = (self.side.abs() * WELL_ASIDE - aside).max(0.0) / AWKWARD;
                let missing = missing + shortfall(&pose);
                (pose, turn(&pose, wrist) + missing / TIGHT + awkward, wall)
            })
            .min_by(|(_, a, _), (_, b, _)| a.total_cmp(b))
            .expect("a block has walls");
        (grasp, wall)
    }

    /// How the block is picked up.
    fn pick(&self, arm: &ArmView<'_>, block: &Pose) -> (Stage, (Pose, f64)) {
        let closes = arm.closes() && !arm.is_closed();
        let (grasp, wall) = if closes {
            // What it closes about, though the block moves and another wall would be the better one now.
            let wall = held_wall(self.block, block, &arm.aim);
            (grasp(self.block, block, wall, &arm.aim).0, wall)
        } else {
            self.grasp(block, &arm.aim, |pose| arm.shortfall(pose))
        };
        let off = arm.aim.translation.vector - grasp.translation.vector;
        let out = outwards(self.block, block, wall);
        let across = off.dot(&out);
        let aside = [across.abs(), (level(&off) - out * across).norm()];
        let is_within = |most: [f64; 2]| aside[0] < most[0] && aside[1] < most[1];
        let is_turned = turn(&grasp, &arm.aim) < TURNED;
        let hover = grasp.translation.z.max(pass());
        let is_high = arm.aim.translation.z > hover - PASS;
        let is_low = off.z < LOW || off.z < LOW_ENOUGH && arm.is_held_up();
        let is_about = is_turned && is_within(ABOUT) && is_low;
        let is_ready = arm.is_open() && !arm.closes();
        let is_closing = closes && off.norm() < CLOSING;
        if is_closing || is_about && is_ready {
            return (Stage::Pick, (grasp, JAW_CLOSED));
        }
        let over = Vector3::new(grasp.translation.x, grasp.translation.y, hover);
        let over = Pose::from_parts(over.into(), grasp.rotation);
        let is_aligned = is_within(if is_high { ALIGNED } else { COMING })
            || is_within(COMING) && arm.shortfall(&over) > 0.0;
        let goes_down = is_ready && is_turned && is_aligned;
        let mut target = grasp;
        if goes_down && arm.is_held_up() {
            target.translation.z = arm.aim.translation.z + BACK;
        } else if !goes_down && is_high {
            target = over;
        } else if !goes_down {
            // Out from between the pegs first.
            target = arm.aim;
            target.translation.z = hover;
        }
        (Stage::Approach, (target, JAW_OPEN))
    }
}

/// The wall of a block at `pose` that is nearest to a wrist.
pub(super) fn held_wall(block: Block, pose: &Pose, wrist: &Pose) -> usize {
    let off = |wall: usize| distance(&(pose * block.block_from_wall(wall)), wrist);
    (0..Block::WALLS).min_by(|a, b| off(*a).total_cmp(&off(*b))).expect("a block has walls")
}

/// The level direction from a block's axis to the middle of a wall.
pub(super) fn outwards(block: Block, pose: &Pose, wall: usize) -> Vector3<f64> {
    let wall = pose * block.block_from_wall(wall);
    // A block that lies on its side has no wall to grasp: any direction does.
    level(&(wall.rotation * -Vector3::x())).try_normalize(1e-3).unwrap_or(-Vector3::x())
}

/// Where the tips of jaws go that grasp a block in the air of which wall `seen` is observed: on each of its walls, that
/// one first.
pub(super) fn grips_in_air(block: Block, seen: usize) -> Vec<Grip> {
    grips(block, seen, &Pose::identity(), grasp_in_air)
}

/// The same of a block that stands about a peg.
pub(super) fn grips_on_peg(block: Block, seen: usize) -> Vec<Grip> {
    let on_peg = Pose::from(PegBoard::peg(0)); // whichever: they are alike
    grips(block, seen, &on_peg, |block, pose, wall, wrist| grasp(block, pose, wall, wrist).0)
}

fn grips(
    block: Block,
    seen: usize,
    pose: &Pose,
    grasp: impl Fn(Block, &Pose, usize, &Pose) -> Pose,
) -> Vec<Grip> {
    let grip = |wall: usize| {
        let wrist = grasp(block, pose, wall, pose);
        let tip = wrist.translation.vector - Vector3::z() * TIP_OFFSET;
        let scene_from_seen = pose * block.block_from_wall(seen);
        let along = (pose * block.block_from_wall(wall)).rotation * Vector3::y();
        Grip {
            name: format!("wall {wall}"),
            place: 0,
            offset: scene_from_seen.inverse_transform_point(&tip.into()).coords,
            along: scene_from_seen.inverse_transform_vector(&along),
        }
    };
    (0..Block::WALLS).map(|next| grip((seen + next) % Block::WALLS)).collect()
}

/// Height of the middle of a block that hangs straight and clears the pegs, m.
pub(super) fn clear_of_pegs(block: Block) -> f64 {
    peg_top() + PASS + block.half_height()
}

/// The wrist that grasps a wall of a block in the air: jaws straight down across the wall.
pub(super) fn grasp_in_air(block: Block, pose: &Pose, wall: usize, wrist: &Pose) -> Pose {
    let middle = (pose * block.block_from_wall(wall)).translation.vector;
    let top = pose.translation.z + block.half_height();
    let at = Vector3::new(middle.x, middle.y, top - DEPTH + TIP_OFFSET);
    let across = Vector3::z().cross(&outwards(block, pose, wall));
    Pose::from_parts(at.into(), jaws_across(&across, wrist))
}

/// The way on which a held block is lifted by `up`, m: where one that may hang askew is caught on its peg, off that.
pub(super) fn lifting(arm: &ArmView<'_>, block: Block, pose: &Pose, up: f64) -> Vector3<f64> {
    let is_caught = arm.is_held_up() && arm.arm().stays_tilted();
    Vector3::z() * up + if is_caught { way_off_peg(block, pose) } else { Vector3::zeros() }
}

/// The level way that brings the axis of a block to the peg that it is about, m; none where it is about no peg.
fn way_off_peg(block: Block, pose: &Pose) -> Vector3<f64> {
    let axis = pose.rotation * Vector3::z();
    let centre = pose.translation.vector;
    // The middle of the part of the peg that is in the block.
    let half = block.half_height() * axis.z;
    let height = 0.5 * ((centre.z - half).max(PegBoard::top()) + (centre.z + half).min(peg_top()));
    let middle = centre + axis * ((height - centre.z) / axis.z.max(0.5));
    let ways = (0..PegBoard::PEGS).map(|peg| level(&(PegBoard::peg(peg) - middle)));
    let nearest = ways.min_by(|a, b| a.norm().total_cmp(&b.norm())).expect("there are pegs");
    let is_about = nearest.norm() < block.radius() && centre.z - half < peg_top();
    if is_about { nearest } else { Vector3::zeros() }
}

/// Height of the lowest point of a block, m: it may hang askew.
fn bottom(block: Block, pose: &Pose) -> f64 {
    block.form().aabb(pose).min.z
}

/// The way up on which a block clears the pegs, m; below 0 where it is higher.
pub(super) fn way_over_pegs(block: Block, pose: &Pose) -> f64 {
    peg_top() + PASS - bottom(block, pose)
}

/// The wrist that grasps a wall of a block: jaws straight down across the wall, the inner finger
/// between wall and peg. Also what is missing of the room for it, m.
fn grasp(block: Block, pose: &Pose, wall: usize, wrist: &Pose) -> (Pose, f64) {
    let inwards = -outwards(block, pose, wall);
    let middle = (pose * block.block_from_wall(wall)).translation.vector;
    let (sin, cos) = libm::sincos(0.5 * JAW_OPEN);
    // From the middle of open jaws: the far side of a finger at its tip, the near side at the block's
    // top when the fingers enter.
    let far = TIP_OFFSET * sin + 2.0 * FINGER_HALF.y * cos;
    let near = (TIP_OFFSET - ENTRY) * sin / cos;
    // So far outside the wall's middle the jaws' may be at most, and must be at least.
    let most = near - block.half_wall();
    let pegs = (0..PegBoard::PEGS).map(PegBoard::peg);
    let in_ring =
        pegs.filter(|peg| level(&(peg - pose.translation.vector)).norm() < block.radius());
    let least = in_ring
        .map(|peg| far - ((peg - middle).dot(&inwards) - PegBoard::peg_radius()))
        .fold(-most, f64::max);
    let tip = middle - inwards * (0.5 * (least + most));
    let top = pose.translation.z + block.half_height();
    let at = Vector3::new(tip.x, tip.y, top - DEPTH + TIP_OFFSET);
    let across = Vector3::z().cross(&inwards);
    (Pose::from_parts(at.into(), jaws_across(&across, wrist)), (least - most).max(0.0))
}

/// Height of a wrist whose jaws pass over the pegs, m.
fn pass() -> f64 {
    peg_top() + PASS + TIP_OFFSET
}

fn peg_top() -> f64 {
    PegBoard::peg_box(0).max.z
}

fn level(vector: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(vector.x, vector.y, 0.0)
}

/// How far one pose is beside another, m.
fn distance(one: &Pose, other: &Pose) -> f64 {
    (one.translation.vector - other.translation.vector).xy().norm()
}

/// How far one pose is turned about the vertical from another, rad.
fn turn(one: &Pose, other: &Pose) -> f64 {
    (one.rotation * other.rotation.inverse()).scaled_axis().z.abs()
}
