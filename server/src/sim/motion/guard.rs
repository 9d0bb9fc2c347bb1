//! What the world does to a motion: instruments move, but not at any price.
//!
//! Five rules belong to the model's definition:
//!
//! - **Yield**: where an object that is in the way pushes back too hard or is pressed into what is
//!   behind it, an instrument goes back along its path instead of forward; just before, it waits.
//!   Where its path does not lead out of what it presses on, or it is jammed, one that grips gives way,
//!   as a real arm bends. From what its own jaws crush it does not: that would come along. In the way is
//!   also skin of tissue that is held, or too deep in the instrument.
//! - **Crush**: jaws that press too deep into what they hold open: what they close on near their hinge
//!   they would squeeze with many times their force at the tip, and keep.
//! - **Static bodies** stop every instrument before wrist or fingers enter them, also if the fingers are locked.
//!   Fingers yield to the body on which they close, not to a body into which the wrist pushes them.
//! - **Instruments** stop each other in the same way.
//! - **Distance**: the shafts of two instruments stop before the distance of their axes falls below
//!   the diameter of a shaft.

use nalgebra::Point3;

use super::{Instrument, Profile, Way};
use crate::sim::instrument::Posture;
use crate::sim::world::{Overlap, Push, World};

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

/// Distance by which a gripping instrument gives way in a substep if a way back does not help, m: tips of closing jaws swing
/// down by 0.6 mm, onto bodies below.
pub(super) const ASIDE: f64 = 0.05e-3;

/// Vertical part of a direction that counts as level.
const LEVEL: f64 = 0.1;

/// Overlap beyond which locked jaws wait, m.
const HOLD_OVERLAP_LOCKED: f64 = 0.5 * YIELD_OVERLAP;

/// Overlap beyond which gripping jaws wait, m: in one substep they move by up to 0.5 mm, as much as
/// the radius of a needle's wire.
const HOLD_OVERLAP_GRIPPING: f64 = 0.01e-3;

/// Movement of a point that counts as one, m.
const LEAST_MOTION: f64 = 1e-9;

/// Decides the progress of each instrument along its path in substep `now` of `substeps`, and drives the instrument there.
pub(super) fn drive(
    ways: &mut [Way],
    instruments: &mut [&mut Instrument],
    world: &mut World,
    now: u32,
    substeps: u32,
) {
    let waits = approaching(ways, instruments, now, substeps);
    let volumes: arrayvec::ArrayVec<_, { super::MAX_INSTRUMENTS }> = ways
        .iter()
        .zip(instruments.iter())
        .map(|(way, each)| each.swept(world, &way.along(way.done + 1, now, substeps)))
        .collect();
    for (index, (way, instrument)) in ways.iter_mut().zip(instruments).enumerate() {
        let volume = &volumes[index];
        let meets_others =
            volumes.iter().enumerate().any(|(other, each)| other != index && volume.meets(each));
        if !waits && !meets_others && instrument.is_apart(world, volume) {
            way.done += 1;
            instrument.pass(world, way.along(way.done, now, substeps));
            continue;
        }
        let (from, to) = (*instrument.posture(), way.along(way.done + 1, now, substeps));
        let hold = if instrument.grips() { HOLD_OVERLAP_GRIPPING } else { HOLD_OVERLAP_LOCKED };
        let done = way.done;
        let stop = instrument.stopped_by(world, &to);
        let last = matches!(way.profile, Profile::Traced(_)).then(|| way.profile.end());
        way.done = match resistance(&way.push, [&from, &to], last.as_ref(), hold) {
            Resistance::Drives => way.done.saturating_sub(1),
            Resistance::Holds => way.done,
            Resistance::None if waits || stop.is_some() => way.done,
            Resistance::None => way.done + 1,
        };
        let overlap = stop.as_ref().unwrap_or(&way.push.overlap);
        let stays_on = way.done >= done && overlap.depth > YIELD_OVERLAP;
        // Locked jaws that gave way upwards or downwards would press what lies under them.
        let is_level = overlap.into.z.abs() < LEVEL;
        if instrument.grips() && way.push.force.norm() > JAM_FORCE {
            way.aside += way.push.force.normalize() * ASIDE;
        } else if stays_on && !way.push.crushes && (instrument.grips() || is_level) {
            way.aside -= overlap.into * ASIDE;
        }
        let next = way.along(way.done, now, substeps);
        instrument.drive(world, next, way.push.crushes);
    }
}

/// Whether the next substep would bring two shafts closer that are too close already.
fn approaching(ways: &[Way], instruments: &[&mut Instrument], now: u32, substeps: u32) -> bool {
    let next = |way: &Way| way.along(way.done + 1, now, substeps);
    ways.iter().zip(instruments).enumerate().any(|(index, (way, instrument))| {
        ways[..index].iter().zip(instruments).any(|(other_way, other)| {
            let gap = next(way).gap(&next(other_way));
            gap < 0.0 && gap < instrument.posture().gap(other.posture())
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

/// What `push` does to the motion from one posture to the next, which waits beyond an overlap of `hold`, m; but not
/// where it leads out of that to `last`: plays that are taken up first move jaws by micrometres whichever way.
fn resistance(
    push: &Push,
    [start, next]: [&Posture; 2],
    last: Option<&Posture>,
    hold: f64,
) -> Resistance {
    let way = |end: &Posture, point: &Point3<f64>| {
        end.world_from_wrist * start.world_from_wrist.inverse() * point - point
    };
    let moves = |point: &Point3<f64>| way(next, point);
    let force = match moves(&push.point).try_normalize(LEAST_MOTION) {
        Some(direction) => -push.force.dot(&direction),
        None => 0.0,
    };
    let Overlap { depth, point, into } = push.overlap;
    let presses_on = moves(&point).dot(&into) > LEAST_MOTION;
    let leads_out = || last.is_some_and(|last| way(last, &point).dot(&into) <= 0.0);
    if force > YIELD_FORCE || (presses_on && depth > YIELD_OVERLAP) {
        Resistance::Drives
    } else if presses_on && depth > hold && !leads_out() {
        Resistance::Holds
    } else {
        Resistance::None
    }
}
