//! A PSM instrument in the world: wrist and two jaw fingers, driven along smooth paths.
//!
//! Within an environment step the wrist follows a smoothstep profile, so its velocity is
//! continuous and zero at both ends. Two rules belong to the model's definition:
//!
//! - **Yield**: where an object that is in the way pushes back too hard or is pressed into what is
//!   behind it, the instrument goes back along its path instead of forward; just before, it waits.
//! - **Quiescence**: while every free object sleeps and the instrument's swept volume meets none,
//!   the instrument moves and no substep runs, since nothing else would change.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::frames::{self, Aabb, Pose};
use super::world::{BodyId, Motion, Part, Push, Shape, World};
use crate::robots::Psm;

/// From the wrist-yaw axis to the tip of the closed jaws, m, along the approach axis (the z axis
/// of the wrist frame).
pub const TIP_OFFSET: f64 = Psm::TIP_DISTANCE;

/// Jaw angle of closed jaws, rad. The angle is the opening between both fingers.
pub const JAW_CLOSED: f64 = 0.0;

/// Jaw angle of open jaws, rad (40°, as the original's tasks open them).
pub const JAW_OPEN: f64 = 0.698_131_700_797_731_8;

/// Height that the lowest point of the closed jaws keeps above a support, m: jaws that close on
/// an object while they press on its support lose it.
pub const CLEARANCE: f64 = 0.05e-3;

/// Net force of objects against the motion beyond which an instrument yields, N.
const YIELD_FORCE: f64 = 2.5;

/// Overlap of a pushed object with anything beyond which an instrument yields, m. Contact stiffness
/// is per mass: a needle of 0.4 g would be pressed through its support before it pushed back with
/// [`YIELD_FORCE`].
const YIELD_OVERLAP: f64 = 0.05e-3;

/// Distance at which an object counts as met, m: more than the engine's contact prediction
/// (0.2 mm) and than the bulge of the path of a jaw tip that turns by 50°.
const MARGIN: f64 = 1e-3;

/// Half extents of a finger, m: across (along the hinge), thickness, length. Source: the
/// original's collision box, 1.4 mm × 10.2 mm × 1.8 mm.
const FINGER_HALF: Vector3<f64> = Vector3::new(0.9e-3, 0.7e-3, 5.1e-3);

/// Radius of the clevis between the wrist's pitch and yaw axes, m (8 mm shaft, tapered).
const CLEVIS_RADIUS: f64 = 2.5e-3;

/// Distance of the wrist's pitch and yaw axes, m. Source: dVRK, `a` of the sixth joint.
const CLEVIS_LENGTH: f64 = 0.0091;

/// Friction coefficient of the jaws' serrated metal, as in the original.
const FRICTION: f64 = 1.0;

/// Where an instrument is and how far its jaws are open.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Posture {
    /// The wrist-yaw frame of dVRK's `measured_cp`: z along the jaws, x along their hinge.
    pub world_from_wrist: Pose,
    /// Opening between the fingers, rad.
    pub jaw: f64,
}

impl Posture {
    /// The frame at the tip of the closed jaws, parallel to the wrist's.
    pub fn world_from_tip(&self) -> Pose {
        self.world_from_wrist * Pose::translation(0.0, 0.0, TIP_OFFSET)
    }

    /// Between this posture (0) and another (1).
    fn towards(&self, end: &Self, fraction: f64) -> Self {
        Self {
            world_from_wrist: frames::interpolate(
                &self.world_from_wrist,
                &end.world_from_wrist,
                fraction,
            ),
            jaw: self.jaw + (end.jaw - self.jaw) * fraction,
        }
    }

    /// The finger of side −1 or +1: it turns by half the opening.
    fn world_from_finger(&self, side: f64) -> Pose {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -0.5 * side * self.jaw);
        self.world_from_wrist * turn
    }

    /// A box around fingers and clevis.
    fn aabb(&self) -> Aabb {
        let fingers = SIDES.map(|side| {
            let world_from_finger = self.world_from_finger(side);
            Aabb::around(finger_box(side).corners().map(|corner| world_from_finger * corner))
        });
        let clevis = Aabb::around(clevis_ends().map(|end| self.world_from_wrist * end));
        fingers[0].merged(&fingers[1]).merged(&clevis.grown(CLEVIS_RADIUS))
    }
}

/// How far the lowest point of an instrument with closed jaws lies below its wrist, m.
pub fn depth_below_wrist(world_from_wrist: &UnitQuaternion<f64>) -> f64 {
    let pose = Pose::from_parts(Vector3::zeros().into(), *world_from_wrist);
    -Posture { world_from_wrist: pose, jaw: JAW_CLOSED }.aabb().min.z
}

/// The bodies of an instrument and where they are.
#[derive(Debug, Clone)]
pub struct Instrument {
    wrist: BodyId,
    fingers: [BodyId; 2],
    posture: Posture,
}

impl Instrument {
    /// Puts an instrument into the world.
    pub fn insert(world: &mut World, posture: Posture) -> Self {
        let [a, b] = clevis_ends();
        let clevis = Part {
            body_from_part: Pose::identity(),
            shape: Shape::Capsule { a, b, radius: CLEVIS_RADIUS },
        };
        let wrist = world.insert(Motion::Driven, &posture.world_from_wrist, FRICTION, &[clevis]);
        let fingers = SIDES.map(|side| {
            let finger = Part {
                body_from_part: Pose::from(finger_box(side).centre()),
                shape: Shape::Cuboid(FINGER_HALF),
            };
            world.insert(Motion::Driven, &posture.world_from_finger(side), FRICTION, &[finger])
        });
        Self { wrist, fingers, posture }
    }

    /// Where it is.
    pub fn posture(&self) -> &Posture {
        &self.posture
    }

    /// Sets where it is, at once.
    pub fn place(&mut self, posture: Posture) {
        self.posture = posture;
    }

    /// Moves to `end` within `substeps` substeps and returns how far along it got, from 0 to 1:
    /// less than 1 where it yielded.
    pub fn travel(&mut self, world: &mut World, end: Posture, substeps: u32) -> f64 {
        let start = self.posture;
        let along = |done: u32| start.towards(&end, smoothstep(done, substeps));
        let mut done = 0;
        let mut push = Push::NONE;
        for _ in 0..substeps {
            if world.at_rest() {
                push = Push::NONE;
                if !world.object_in(&swept(&self.posture, &end)) {
                    self.posture = end;
                    return 1.0;
                }
                let next = along(done + 1);
                if !world.object_in(&swept(&self.posture, &next)) {
                    done += 1;
                    self.posture = next;
                    continue;
                }
            }
            done = match resistance(&push, &start, &end) {
                Resistance::None => done + 1,
                Resistance::Holds => done,
                Resistance::Drives => done.saturating_sub(1),
            };
            self.drive(world, along(done));
            push = self.push(world);
        }
        smoothstep(done, substeps)
    }

    /// Lets one substep pass in which the instrument goes to `next`.
    fn drive(&mut self, world: &mut World, next: Posture) {
        let bodies = [self.wrist, self.fingers[0], self.fingers[1]];
        let poses = |posture: &Posture| {
            let [left, right] = SIDES.map(|side| posture.world_from_finger(side));
            [posture.world_from_wrist, left, right]
        };
        for (body, (now, next)) in bodies.iter().zip(poses(&self.posture).iter().zip(poses(&next)))
        {
            world.place(*body, now);
            world.drive(*body, &next);
        }
        world.step();
        self.posture = next;
    }

    fn push(&self, world: &World) -> Push {
        let [left, right] = self.fingers;
        world.push_on(self.wrist).with(world.push_on(left)).with(world.push_on(right))
    }
}

/// Sides of the fingers: the sign of their y axis.
const SIDES: [f64; 2] = [-1.0, 1.0];

/// A finger in its own frame: hinge at the origin, length along z.
fn finger_box(side: f64) -> Aabb {
    let centre = Vector3::new(0.0, side * FINGER_HALF.y, FINGER_HALF.z);
    Aabb { min: centre - FINGER_HALF, max: centre + FINGER_HALF }
}

/// The clevis' axis in the wrist frame, from the yaw to the pitch axis of a straight wrist.
fn clevis_ends() -> [Point3<f64>; 2] {
    [Point3::origin(), Point3::new(0.0, 0.0, -CLEVIS_LENGTH)]
}

fn swept(start: &Posture, end: &Posture) -> Aabb {
    start.aabb().merged(&end.aabb()).grown(MARGIN)
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

/// What `push` does to the motion from `start` to `end`.
fn resistance(push: &Push, start: &Posture, end: &Posture) -> Resistance {
    let end_from_start = end.world_from_wrist * start.world_from_wrist.inverse();
    let motion = end_from_start * push.point - push.point;
    let Some(direction) = motion.try_normalize(1e-9) else { return Resistance::None };
    let along = push.force.dot(&direction);
    if along < -YIELD_FORCE || (along < 0.0 && push.overlap > YIELD_OVERLAP) {
        Resistance::Drives
    } else if along < 0.0 && push.overlap > 0.5 * YIELD_OVERLAP {
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
    use crate::sim::world::Solver;

    const SUBSTEPS: u32 = 48;

    /// Straight down, tip at `tip`.
    fn down(tip: [f64; 3]) -> Posture {
        let [x, y, z] = tip;
        let pose = frames::pose([x, y, z + TIP_OFFSET], [std::f64::consts::PI, 0.0, 0.0]);
        Posture { world_from_wrist: pose, jaw: JAW_CLOSED }
    }

    /// A pad with its top at 0 and a wire of a needle's size and mass on it.
    fn pad_and_wire() -> (World, BodyId) {
        let mut world = World::new(Solver::LIGHT);
        let pad = Part {
            body_from_part: Pose::translation(0.0, 0.0, -0.01),
            shape: Shape::Cuboid(Vector3::new(0.1, 0.1, 0.01)),
        };
        world.insert(Motion::Fixed, &Pose::identity(), 1.0, &[pad]);
        let (a, b) = (Point3::new(0.0, -0.01, 0.0), Point3::new(0.0, 0.01, 0.0));
        let wire = Part {
            body_from_part: Pose::identity(),
            shape: Shape::Capsule { a, b, radius: 0.5e-3 },
        };
        let pose = Pose::translation(0.0, 0.0, 0.5e-3);
        let wire = world.insert(Motion::Free { mass: 0.39e-3 }, &pose, 1.0, &[wire]);
        (world, wire)
    }

    #[test]
    fn jaws_point_along_z_and_reach_to_the_tip() {
        let posture = down([0.0; 3]);
        assert!(posture.world_from_tip().translation.vector.norm() < 1e-12);
        assert!((depth_below_wrist(&posture.world_from_wrist.rotation) - TIP_OFFSET).abs() < 1e-12);
        let aabb = posture.aabb();
        assert!(aabb.min.z.abs() < 1e-12 && aabb.max.z > TIP_OFFSET + CLEVIS_LENGTH);
        let open = Posture { jaw: JAW_OPEN, ..posture };
        assert!(open.aabb().max.y > aabb.max.y + 0.5e-3 && open.aabb().min.z > 0.0);
    }

    #[test]
    fn far_from_sleeping_objects_no_time_passes_for_them() {
        let (mut world, wire) = pad_and_wire();
        let before = world.pose(wire);
        let mut instrument = Instrument::insert(&mut world, down([0.0, 0.0, 0.05]));
        let end = down([0.01, 0.0, 0.04]);
        assert_eq!(instrument.travel(&mut world, end, SUBSTEPS), 1.0);
        assert_eq!(*instrument.posture(), end);
        assert!(world.at_rest());
        assert_eq!(world.pose(wire), before);
    }

    #[test]
    fn a_wire_in_the_way_is_pushed_aside() {
        let (mut world, wire) = pad_and_wire();
        let mut instrument = Instrument::insert(&mut world, down([-0.008, 0.0, 0.1e-3]));
        let end = down([0.002, 0.0, 0.1e-3]);
        assert!(instrument.travel(&mut world, end, SUBSTEPS) > 0.95);
        // The finger's flank is 0.9 mm from the tip's middle, the wire's axis 0.5 mm further.
        let pushed = world.pose(wire).translation.vector;
        let tip = instrument.posture().world_from_tip().translation.x;
        assert!(pushed.x > tip + 0.9e-3 && pushed.x < 0.02, "{pushed}");
        assert!(pushed.z > 0.4e-3 && pushed.z < 0.02);
    }

    #[test]
    fn a_wire_under_the_tip_stops_it_and_is_not_pressed_through_the_pad() {
        let (mut world, wire) = pad_and_wire();
        let mut instrument = Instrument::insert(&mut world, down([0.0, 0.0, 5e-3]));
        let mut fastest: f64 = 0.0;
        for _ in 0..10 {
            let reached = instrument.travel(&mut world, down([0.0, 0.0, CLEARANCE]), SUBSTEPS);
            assert!(reached < 1.0);
            fastest = fastest.max(world.velocity(wire).norm());
        }
        let tip = instrument.posture().world_from_tip().translation.z;
        let height = world.pose(wire).translation.z;
        assert!(height > 0.2e-3, "{height}");
        assert!(tip > 0.5e-3 && tip < 1.2e-3, "{tip}");
        assert!(fastest < 0.5, "{fastest}");
        // It is free to leave.
        assert_eq!(instrument.travel(&mut world, down([0.0, 0.0, 5e-3]), SUBSTEPS), 1.0);
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
