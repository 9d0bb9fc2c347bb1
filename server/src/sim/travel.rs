//! How instruments move in an environment step: smoothly, at the same time, and not at any price.
//!
//! Within a step wrist and jaw angle follow a smoothstep profile, so their velocity is continuous and
//! zero at both ends. Five rules belong to the model's definition:
//!
//! - **Yield**: where an object that is in the way pushes back too hard or is pressed into what is
//!   behind it, an instrument goes back along its path instead of forward; just before, it waits.
//!   Where its path does not lead out of what it presses on, or it is jammed, one that grips gives way,
//!   as a real arm bends.
//! - **Crush**: jaws that press too deep into what they hold open: what they close on near their hinge
//!   they would squeeze with many times their force at the tip, and keep.
//! - **Furniture** stops an instrument that grips before wrist or fingers are in it: fingers give way to
//!   what they close on, not to what they are pushed into.
//! - **Distance**: the shafts of two instruments, which nothing else keeps apart, wait where they
//!   would come closer than they are thick.
//! - **Quiescence**: while every free object sleeps and the volumes that the instruments sweep, jaws
//!   as they are and as they are to be, meet no object, no furniture (where they grip) and not each
//!   other, the instruments move and no substep runs, since nothing else would change. Where objects
//!   do move, an instrument that none can meet in a substep takes no part in it.

use nalgebra::{Point3, Vector3};

use super::instrument::{Instrument, Posture};
use super::world::{Overlap, Push, World};

/// Net force of objects against the motion beyond which an instrument yields, N: the contacts of a needle of
/// 0.4 g give in to it by 0.26 mm, half the radius of its wire.
const YIELD_FORCE: f64 = 1.0;

/// Net force beyond which an instrument that grips gives way to it, wherever it was going, N: it is
/// jammed.
const JAM_FORCE: f64 = 4.0 * YIELD_FORCE;

/// Overlap of a pushed object with anything beyond which an instrument yields, m. Contact stiffness
/// is per mass: a needle of 0.4 g would be pressed through its support before it pushed back with
/// [`YIELD_FORCE`].
const YIELD_OVERLAP: f64 = 0.05e-3;

/// How far a gripping instrument gives way in a substep where going back does not help, m: jaws that
/// close swing their tips down by 0.6 mm, onto what may lie under them.
const ASIDE: f64 = 0.05e-3;

/// Vertical part of a direction that counts as level.
const LEVEL: f64 = 0.1;

/// What counts as the way covered by an instrument that is beside its path at the end: not all of it.
const BESIDE: f64 = 1.0 - f64::EPSILON;

/// Overlap beyond which locked jaws wait, m.
const HOLD_OVERLAP_LOCKED: f64 = 0.5 * YIELD_OVERLAP;

/// Overlap beyond which gripping jaws wait, m: in one substep they move by up to 0.5 mm, as much as
/// the radius of a needle's wire.
const HOLD_OVERLAP_GRIPPING: f64 = 0.01e-3;

/// Movement of a point that counts as one, m.
const LEAST_MOTION: f64 = 1e-9;

/// One instrument on its way.
struct Way<'a> {
    instrument: &'a mut Instrument,
    start: Posture,
    end: Posture,
    /// Substeps' worth of the way that the wrist has covered.
    done: u32,
    /// What pushed in the last substep.
    push: Push,
    /// How far it has given way off its path, m.
    aside: Vector3<f64>,
}

impl Way<'_> {
    /// The posture in substep `now` of `substeps` where the wrist has covered `done` of them.
    fn along(&self, done: u32, now: u32, substeps: u32) -> Posture {
        let (wrist, jaw) = (smoothstep(done, substeps), smoothstep(now, substeps));
        let mut posture = self.start.towards(&self.end, wrist, jaw);
        posture.world_from_wrist.translation.vector += self.aside;
        posture
    }
}

/// Moves instruments to `ends` within `substeps` substeps and returns how far along the wrists got,
/// from 0 to 1: less than 1 where one yielded.
pub fn travel<const N: usize>(
    instruments: [&mut Instrument; N],
    world: &mut World,
    ends: [Posture; N],
    substeps: u32,
) -> [f64; N] {
    let mut ends = ends.into_iter();
    let mut ways = instruments.map(|instrument| Way {
        start: *instrument.posture(),
        end: ends.next().expect("as many ends as instruments"),
        done: 0,
        push: Push::NONE,
        aside: Vector3::zeros(),
        instrument,
    });
    for now in 1..=substeps {
        if world.at_rest() {
            if have_free_ways(&ways, world, |way| way.end) {
                for way in &mut ways {
                    way.instrument.place(way.end);
                }
                return [1.0; N];
            }
            let next = |way: &Way| way.along(way.done + 1, now, substeps);
            if have_free_ways(&ways, world, next) {
                for way in &mut ways {
                    way.done += 1;
                    way.instrument.place(way.along(way.done, now, substeps));
                    way.push = Push::NONE;
                }
                continue;
            }
        }
        let waits = approaching(&ways, now, substeps);
        let volumes = ways
            .each_ref()
            .map(|way| way.instrument.swept(world, &way.along(way.done + 1, now, substeps)));
        for (index, way) in ways.iter_mut().enumerate() {
            let volume = &volumes[index];
            let meets_others = volumes
                .iter()
                .enumerate()
                .any(|(other, each)| other != index && volume.meets(each));
            if !waits && !meets_others && way.instrument.is_apart(world, volume) {
                way.done += 1;
                way.instrument.pass(world, way.along(way.done, now, substeps));
                continue;
            }
            let (from, to) = (*way.instrument.posture(), way.along(way.done + 1, now, substeps));
            let hold =
                if way.instrument.grips() { HOLD_OVERLAP_GRIPPING } else { HOLD_OVERLAP_LOCKED };
            let done = way.done;
            let stop = way.instrument.stopped_by(world, &to);
            way.done = match resistance(&way.push, &from, &to, hold) {
                Resistance::Drives => way.done.saturating_sub(1),
                Resistance::Holds => way.done,
                Resistance::None if waits || stop.is_some() => way.done,
                Resistance::None => way.done + 1,
            };
            let overlap = stop.as_ref().unwrap_or(&way.push.overlap);
            let stays_on = way.done >= done && overlap.depth > YIELD_OVERLAP;
            // Locked jaws that gave way upwards or downwards would press what lies under them.
            let is_level = overlap.into.z.abs() < LEVEL;
            if way.instrument.grips() && way.push.force.norm() > JAM_FORCE {
                way.aside += way.push.force.normalize() * ASIDE;
            } else if stays_on && (way.instrument.grips() || is_level) {
                way.aside -= overlap.into * ASIDE;
            }
            let next = way.along(way.done, now, substeps);
            way.instrument.drive(world, next, way.push.crushes);
        }
        world.step();
        for way in &mut ways {
            way.push = way.instrument.push(world);
        }
    }
    ways.map(|way| {
        let reached = smoothstep(way.done, substeps);
        if way.aside == Vector3::zeros() { reached } else { reached.min(BESIDE) }
    })
}

/// Whether no instrument meets anything on its way to the posture that `to` tells.
fn have_free_ways(ways: &[Way], world: &World, to: impl Fn(&Way) -> Posture) -> bool {
    let swept = |way: &Way| way.instrument.swept(world, &to(way));
    ways.iter().enumerate().all(|(index, way)| {
        let volume = swept(way);
        way.instrument.has_free_way(world, &volume)
            && ways[..index].iter().all(|other| !volume.meets(&swept(other)))
    })
}

/// Whether the next substep would bring two shafts closer that are too close already.
fn approaching(ways: &[Way], now: u32, substeps: u32) -> bool {
    ways.iter().enumerate().any(|(index, way)| {
        let next = way.along(way.done + 1, now, substeps);
        ways[..index].iter().any(|other| {
            let other_next = other.along(other.done + 1, now, substeps);
            let gap = next.gap(&other_next);
            gap < 0.0 && gap < way.instrument.posture().gap(other.instrument.posture())
        })
    })
}

/// What an object in the way does to a motion.
enum Resistance {
    /// The motion goes on.
    None,
    /// It waits until the object has given way.
    Holds,
    /// It goes back.
    Drives,
}

/// What `push` does to the motion from `start` to `end`, which waits beyond an overlap of `hold`, m.
fn resistance(push: &Push, start: &Posture, end: &Posture, hold: f64) -> Resistance {
    let end_from_start = end.world_from_wrist * start.world_from_wrist.inverse();
    let moves = |point: &Point3<f64>| end_from_start * point - point;
    let force = match moves(&push.point).try_normalize(LEAST_MOTION) {
        Some(direction) => -push.force.dot(&direction),
        None => 0.0,
    };
    let Overlap { depth, point, into } = push.overlap;
    let presses_on = moves(&point).dot(&into) > LEAST_MOTION;
    if force > YIELD_FORCE || (presses_on && depth > YIELD_OVERLAP) {
        Resistance::Drives
    } else if presses_on && depth > hold {
        Resistance::Holds
    } else {
        Resistance::None
    }
}

/// The smooth profile: 0 at 0, 1 at `total`, with velocity 0 at both ends.
fn smoothstep(done: u32, total: u32) -> f64 {
    let x = f64::from(done) / f64::from(total);
    x * x * (3.0 - 2.0 * x)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests {
    use super::*;
    use crate::sim::frames::{self, Pose};
    use crate::sim::instrument::{JAW_CLOSED, JAW_OPEN, TIP_OFFSET};
    use crate::sim::world::{Motion, Part, SUBSTEPS_PER_SECOND, Shape, Solver};

    const SUBSTEPS: u32 = 48;

    /// Straight down, tip at `tip`.
    fn down(tip: [f64; 3]) -> Posture {
        let [x, y, z] = tip;
        let pose = frames::pose([x, y, z + TIP_OFFSET], [std::f64::consts::PI, 0.0, 0.0]);
        Posture { world_from_wrist: pose, jaw: JAW_CLOSED }
    }

    #[test]
    fn instruments_far_apart_both_arrive_and_those_that_meet_stop_each_other() {
        for (height, passes) in [(0.04, true), (0.0, false)] {
            let mut world = World::new(Solver::LIGHT);
            let starts = [down([-0.02, 0.0, 0.0]), down([0.02, 0.0, height])];
            let ends = [down([0.02, 0.0, 0.0]), down([-0.02, 0.0, height])];
            let [mut left, mut right] =
                starts.map(|start| Instrument::insert(&mut world, start, 1.0));
            let mut reached = [0.0; 2];
            for _ in 0..5 {
                reached = travel([&mut left, &mut right], &mut world, ends, SUBSTEPS);
            }
            assert_eq!(reached == [1.0; 2], passes, "{reached:?}");
            if !passes {
                let apart = [&left, &right].map(|arm| arm.posture().world_from_tip().translation.x);
                assert!(apart[1] - apart[0] > 1e-3, "{apart:?}");
                assert!(left.posture().gap(right.posture()) > -0.2e-3);
                // Both may leave as they came.
                let back = travel([&mut left, &mut right], &mut world, starts, SUBSTEPS);
                assert_eq!(back, [1.0; 2]);
            }
        }
    }

    #[test]
    fn a_finger_that_comes_down_on_a_peg_stops_there_while_objects_sleep() {
        let mut world = World::new(Solver::LIGHT);
        let at = |z: f64| Pose::translation(0.0, 0.0, z);
        let cube = |half: f64| Part {
            body_from_part: Pose::identity(),
            shape: Shape::Cuboid(Vector3::repeat(half)),
        };
        world.insert(Motion::Fixed, &at(-0.05), 1.0, &[cube(0.05)]);
        let far = Pose::translation(0.04, 0.0, 5e-3);
        world.insert(Motion::Free { mass: 1e-3 }, &far, 1.0, &[cube(5e-3)]);
        // The end of one open finger, 2.9 mm off the middle, comes down on the peg.
        let (a, b) = (Point3::new(0.0, -2.6e-3, 0.0), Point3::new(0.0, -2.6e-3, 0.02));
        let peg =
            Part { body_from_part: Pose::identity(), shape: Shape::Capsule { a, b, radius: 1e-3 } };
        world.insert(Motion::Fixed, &Pose::identity(), 1.0, &[peg]);
        let open = |z: f64| Posture { jaw: JAW_OPEN, ..down([0.0, 0.0, z]) };
        let mut arm = Instrument::insert(&mut world, open(0.025), 1.0);
        let mut widest: f64 = 0.0;
        for _ in 0..SUBSTEPS_PER_SECOND as u32 {
            world.step();
        }
        for _ in 0..4 {
            let end = open(arm.posture().world_from_tip().translation.z - 0.01);
            travel([&mut arm], &mut world, [end], SUBSTEPS);
            assert!(world.at_rest());
            widest = widest.max(arm.opening(&world));
        }
        // It would have come down by 40 mm.
        let tip = arm.posture().world_from_tip().translation.z;
        assert!(tip > 0.017, "it went on to {tip}");
        assert!(widest < JAW_OPEN + 0.1, "forced open to {widest}");
    }

    #[test]
    fn motion_is_smooth() {
        let speeds: Vec<f64> = (0..48).map(|i| smoothstep(i + 1, 48) - smoothstep(i, 48)).collect();
        assert!(speeds[0] < 0.1 / 48.0 * 2.0 && speeds[47] < 0.1 / 48.0 * 2.0);
        let jump = speeds.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
        assert!(jump < 0.15 / 48.0);
        assert_eq!(smoothstep(48, 48), 1.0);
    }
}
