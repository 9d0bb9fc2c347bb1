//! A PSM instrument in the world: a driven wrist, and two fingers.
//!
//! Fingers that grip are bodies of their own on hinges: what they hold, they hold by friction. Their
//! motors drive the opening between them with no more than the grip's squeeze, and keep both about the
//! middle of the wrist, as the real jaws' gearing and yaw joint do, with a limited torque too. Fingers
//! that are locked are driven like the wrist, and nothing moves them. How instruments move is in
//! [`motion`](super::motion).
//!
//! What the grip is like is measured in `server/tests/mechanics.rs` and `server/tests/grasp.rs`. A finger
//! presses with the squeeze that is asked for where that is defined, 1 mm from the tip, and with 0.95 of it
//! half a millimetre further out. A slab slips at 0.85 to 0.91 of 2·μ·N, where μ is the mean of
//! both coefficients. Friction has no memory of places: under load, what is held creeps
//! by some micrometres with every movement.

use nalgebra::{Unit, UnitQuaternion, Vector3};

use super::frames::{Aabb, Pose};
use super::world::{
    AttachmentId, BodyId, Hinge, HingedId, JawMotor, Motion, Overlap, PREDICTION, Part, Push,
    Shape, SoftId, World,
};

mod carry;
mod jaws;
mod posture;
use jaws::SIDES;
pub use jaws::{BetweenFingers, FINGER_HALF, Jaws};
use posture::{CLEVIS_RADIUS, clevis_ends};
pub use posture::{JAW_CLOSED, JAW_OPEN, Posture, TIP_OFFSET};

/// Height that the lowest point of the closed jaws keeps above a rigid support, m: jaws that close on
/// an object while they press on such a support lose it. One that gives may be pressed in.
pub const CLEARANCE: f64 = 0.05e-3;

/// Distance at which an object counts as met, m: more than that from which on contacts are looked at,
/// and than the bulge of the path of a jaw tip that turns by 50°.
const MARGIN: f64 = 1.5 * PREDICTION;

/// Distance at which an object may come near in a substep, m: an object of 1.5 m/s moves by 6.3 mm.
const REACH_OF_OBJECTS: f64 = 8e-3;

/// Friction coefficient of the jaws' serrated metal, as in the original.
const FRICTION: f64 = 1.0;

/// Mass of a finger, kg. Source: the original.
const FINGER_MASS: f64 = 0.02;

/// Where a finger's turning ends, rad: 0 is the middle.
const FINGER_LIMITS: [f64; 2] = [-0.5, 0.8];

/// How far jaws may be forced open, rad.
pub const FORCED_OPEN: f64 = 2.0 * FINGER_LIMITS[1];

/// Torque with which each finger stays in the middle of the wrist, over that of its squeeze. Beyond, what
/// pushes the fingers to one side turns both, as it turns the yaw joint of a real wrist, whose torque is
/// as limited.
const YAW: f64 = 2.0;

/// What counts as deeper, m: more than rounding.
const LEAST_DEPTH: f64 = 1e-6;

/// From the hinge to where an object is gripped, m: the tip less 1 mm.
const LEVER: f64 = TIP_OFFSET - 1e-3;

/// The bodies of an instrument and where they are.
#[derive(Debug, Clone)]
pub struct Instrument {
    jaws: Jaws,
    wrist: BodyId,
    fingers: Fingers,
    posture: Posture,
    /// What is attached to the wrist, and by what.
    attached: Option<(BodyId, AttachmentId)>,
    /// Whether the bodies in the world are where they were before the instrument moved without
    /// substeps.
    stale: bool,
}

/// The bodies of the fingers.
#[derive(Debug, Clone)]
enum Fingers {
    /// Driven along with the wrist.
    Locked([BodyId; 2]),
    /// On hinges with motors, whose target is up to `deflection` (rad) from the fingers' mean angle
    /// where they squeeze.
    Gripping { fingers: [HingedId; 2], deflection: f64 },
}

impl Instrument {
    /// Puts an instrument into the world whose fingers squeeze with `squeeze` each, N; where that
    /// is infinite, the jaws are locked at the angle that is asked for.
    pub fn insert(world: &mut World, posture: Posture, squeeze: f64) -> Self {
        Self::with_jaws(world, posture, squeeze, Jaws::NEEDLE_DRIVER)
    }

    /// The same with other jaws than a needle driver's.
    pub fn with_jaws(world: &mut World, posture: Posture, squeeze: f64, jaws: Jaws) -> Self {
        let [a, b] = clevis_ends();
        let clevis = Part {
            body_from_part: Pose::identity(),
            shape: Shape::Capsule { a, b, radius: CLEVIS_RADIUS },
        };
        let wrist = world.insert(Motion::Driven, &posture.world_from_wrist, FRICTION, &[clevis]);
        let finger = |side| Part {
            body_from_part: Pose::from(jaws.finger_box(side).centre()),
            shape: Shape::Cuboid(jaws.finger_half),
        };
        let fingers = if squeeze.is_finite() {
            Fingers::Gripping {
                fingers: SIDES
                    .map(|side| world.insert_hinged(wrist, &hinge(side), &[finger(side)])),
                deflection: hinge(SIDES[0]).deflection(squeeze * LEVER),
            }
        } else {
            Fingers::Locked(SIDES.map(|side| {
                let pose = posture.world_from_finger(side);
                world.insert(Motion::Driven, &pose, FRICTION, &[finger(side)])
            }))
        };
        let instrument = Self { jaws, wrist, fingers, posture, attached: None, stale: true };
        if jaws.is_profiled {
            instrument.finger_bodies().iter().for_each(|finger| world.set_profiled(*finger));
        }
        instrument
    }

    /// Where it is, with the jaw angle that is asked for.
    pub fn posture(&self) -> &Posture {
        &self.posture
    }

    /// Opening of the jaws, rad: larger than the asked opening while the jaws hold an object.
    pub fn opening(&self, world: &World) -> f64 {
        match &self.fingers {
            Fingers::Gripping { fingers, .. } if !self.stale => opening(world, fingers),
            _ => self.posture.jaw,
        }
    }

    /// Where its fingers are, those of [`Posture`]'s −y and +y sides: hinges at the origins, lengths along z.
    pub fn world_from_fingers(&self, world: &World) -> [Pose; 2] {
        if self.stale {
            SIDES.map(|side| self.posture.world_from_finger(side))
        } else {
            self.finger_bodies().map(|finger| world.pose(finger))
        }
    }

    /// Whether `object` is in its jaws: both fingers press on it, or it is attached to the wrist.
    pub fn holds(&self, world: &World, object: BodyId) -> bool {
        self.is_tied_to(object) || self.fingers_touching(world, object) == 2
    }

    /// How many of its fingers press on `object`.
    pub fn fingers_touching(&self, world: &World, object: BodyId) -> usize {
        if self.stale {
            return 0;
        }
        self.finger_bodies().iter().filter(|finger| world.touch(**finger, object)).count()
    }

    /// Which of its fingers press on an object, rigid or soft; both where one is attached to the wrist.
    pub fn contacts(&self, world: &World) -> [bool; 2] {
        if self.stale || self.attached.is_some() {
            return [self.attached.is_some(); 2];
        }
        self.finger_bodies().map(|finger| {
            world.touches_soft(finger) || world.objects().any(|object| world.touch(finger, object))
        })
    }

    /// How hard everything together pressed on each finger in the last substep, N.
    pub fn pressures(&self, world: &World) -> [f64; 2] {
        if self.stale {
            return [0.0; 2];
        }
        self.finger_bodies().map(|finger| world.pressure(finger))
    }

    /// Largest force between one of its jaws and a body that it touched in the last substep, N; friction is not in it.
    pub fn jaw_force(&self, world: &World) -> f64 {
        if self.stale {
            return 0.0;
        }
        let own = self.bodies();
        let forces = self.finger_bodies().map(|finger| world.strongest_contact(finger, &own));
        forces.into_iter().fold(0.0, f64::max)
    }

    /// How many of its fingers press on a soft body.
    pub fn fingers_on(&self, world: &World, soft: SoftId) -> usize {
        if self.stale {
            return 0;
        }
        let presses = |finger: &&BodyId| world.soft_pressure(soft, **finger) > 0.0;
        self.finger_bodies().iter().filter(presses).count()
    }

    /// The mean pressure of tissue on that of its bodies on which it was greatest in the last substep, Pa.
    pub fn tissue_pressure(&self, world: &World) -> f64 {
        if self.stale { 0.0 } else { world.tissue_pressure(&self.bodies()) }
    }

    /// Attaches what is between its fingers of a soft body's skin, or up to `distance` (m) from there, to its wrist.
    pub fn attach_skin(&self, world: &mut World, soft: SoftId, distance: f64) {
        if self.stale {
            return;
        }
        let between = self.between_fingers(world);
        world.attach_skin(soft, self.wrist, |point| between.has(point, distance));
    }

    /// The room between its fingers.
    pub fn between_fingers(&self, world: &World) -> BetweenFingers {
        BetweenFingers::new(&self.jaws, self.world_from_fingers(world))
    }

    /// The force of a soft body on all of it, N, friction included.
    pub fn force_of(&self, world: &World, soft: SoftId) -> Vector3<f64> {
        if self.stale {
            return Vector3::zeros();
        }
        self.bodies().iter().map(|body| world.soft_force(soft, *body)).sum()
    }

    /// Whether `object` is attached to the wrist.
    pub fn is_tied_to(&self, object: BodyId) -> bool {
        self.attached.is_some_and(|(attached, _)| attached == object)
    }

    /// Attaches `object` to the wrist where it is, whatever was attached before.
    pub fn attach(&mut self, world: &mut World, object: BodyId) {
        self.detach(world);
        if self.stale {
            self.put_bodies(world);
        }
        self.attached = Some((object, world.attach(self.wrist, object)));
    }

    /// Lets go what is attached to the wrist.
    pub fn detach(&mut self, world: &mut World) {
        if let Some((_, attachment)) = self.attached.take() {
            world.detach(attachment);
        }
    }

    /// Sets the friction coefficient of its fingers.
    pub fn set_friction(&self, world: &mut World, friction: f64) {
        for finger in self.finger_bodies() {
            world.set_friction(finger, friction);
        }
    }

    /// How far its lowest point lies below a wrist of this orientation, m, however far the jaws can
    /// be open.
    pub fn depth_below_wrist(&self, world_from_wrist: &UnitQuaternion<f64>) -> f64 {
        /// A finger turns by 2.5° from one opening looked at to the next: less than 3 µm are missed.
        const OPENINGS: u32 = 8;
        let world_from_wrist = Pose::from_parts(Vector3::zeros().into(), *world_from_wrist);
        let depth = |jaw: f64| -Posture { world_from_wrist, jaw }.aabb(&self.jaws).min.z;
        match self.fingers {
            Fingers::Locked(_) => depth(self.posture.jaw),
            Fingers::Gripping { .. } => (0..=OPENINGS)
                .map(|index| f64::from(index) / f64::from(OPENINGS))
                .map(|part| depth(JAW_CLOSED + (JAW_OPEN - JAW_CLOSED) * part))
                .fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// Sets where it is, at once.
    pub fn place(&mut self, posture: Posture) {
        self.posture = posture;
        self.stale = true;
    }

    /// Whether the fingers are bodies of their own.
    pub(crate) fn grips(&self) -> bool {
        matches!(self.fingers, Fingers::Gripping { .. })
    }

    /// A box around all that it passes through on its way to `end`, m.
    pub(super) fn swept(&self, world: &World, end: &Posture) -> Aabb {
        let planned = self.posture.aabb(&self.jaws).merged(&end.aabb(&self.jaws));
        if self.stale {
            return planned;
        }
        let fingers = self.finger_bodies().map(|finger| world.pose(finger));
        planned.merged(&self.posture.aabb_with(&self.jaws, fingers))
    }

    /// Whether it meets nothing in the volume that it sweeps.
    pub(super) fn has_free_way(&self, world: &World, swept: &Aabb) -> bool {
        self.attached.is_none() && !world.object_in(&swept.grown(MARGIN)) && !world.static_in(swept)
    }

    /// Whether gripping jaws that sweep a volume in a substep are out of reach of all objects and of
    /// static bodies.
    pub(super) fn is_apart(&self, world: &World, swept: &Aabb) -> bool {
        self.grips()
            && self.attached.is_none()
            && !world.object_in(&swept.grown(REACH_OF_OBJECTS))
            && !world.static_in(swept)
    }

    /// Deepest overlap with static bodies and other instruments at `next`, if the overlap is larger than now: these stop
    /// wrist and fingers there, also if the fingers are locked. Bodies that were carried without substeps are placed first.
    pub(super) fn stopped_by(&mut self, world: &mut World, next: &Posture) -> Option<Overlap> {
        if self.stale {
            self.put_bodies(world);
        }
        let motion = next.world_from_wrist * self.posture.world_from_wrist.inverse();
        let deepest = |motion: &Pose| {
            let own = self.bodies();
            let meets = |body| {
                world.meets_static(body, motion).or(world.meets_instruments(body, motion, &own))
            };
            own.map(meets).into_iter().reduce(Overlap::or).expect("it has bodies")
        };
        let then = deepest(&motion);
        let deeper = || then.depth > deepest(&Pose::identity()).depth + LEAST_DEPTH;
        (then.depth > 0.0 && deeper()).then_some(then)
    }

    /// Goes to `next` without taking part in the substep to come.
    pub(super) fn pass(&mut self, world: &mut World, next: Posture) {
        for body in self.bodies() {
            world.withdraw(body);
        }
        self.place(next);
    }

    /// Takes it out of all that happens, until it moves.
    pub(crate) fn withdraw(&mut self, world: &mut World) {
        self.pass(world, self.posture);
    }

    /// How deep it is, where it was put, in objects and in what is fixed, m.
    pub(crate) fn deepest_overlap(&self, world: &World) -> f64 {
        let (mut own, mut world) = (self.clone(), world.clone());
        own.put_bodies(&mut world);
        let overlaps =
            own.bodies().map(|body| world.overlap(body, |other| world.is_fixed_or_free(other)));
        overlaps.into_iter().fold(0.0, f64::max)
    }

    fn bodies(&self) -> [BodyId; 3] {
        let [left, right] = self.finger_bodies();
        [self.wrist, left, right]
    }

    pub(super) fn finger_bodies(&self) -> [BodyId; 2] {
        match &self.fingers {
            Fingers::Locked(fingers) => *fingers,
            Fingers::Gripping { fingers: [left, right], .. } => [left.body(), right.body()],
        }
    }

    /// Makes it go to `next` in the substep to come; jaws that crush what they hold open instead of
    /// closing on it, whichever way they are turned.
    pub(super) fn drive(&mut self, world: &mut World, next: Posture, crushes: bool) {
        if self.stale {
            self.put_bodies(world);
        }
        world.drive(self.wrist, &next.world_from_wrist);
        match &self.fingers {
            Fingers::Locked(fingers) => {
                for (finger, side) in fingers.iter().zip(SIDES) {
                    world.drive(*finger, &next.world_from_finger(side));
                }
            }
            Fingers::Gripping { fingers, deflection } => {
                let motor = JawMotor {
                    opening: 0.5 * next.jaw,
                    deflection: *deflection,
                    most_aside: YAW * deflection,
                    opens: crushes,
                };
                let angles = fingers.each_ref().map(|finger| world.hinge_angle(finger));
                for ((finger, angle), target) in
                    fingers.iter().zip(angles).zip(motor.targets(angles))
                {
                    world.turn_hinged(finger, angle, target);
                    world.carry_hinged(finger, angle, &next.world_from_wrist);
                }
                let bodies = fingers.each_ref().map(HingedId::body);
                world.set_grip(bodies, motor);
                world.resist_rolling(bodies);
            }
        }
        if let Some((object, _)) = self.attached {
            world.wake(object);
        }
        self.posture = next;
    }

    /// Puts the bodies where the instrument is.
    fn put_bodies(&mut self, world: &mut World) {
        for body in self.bodies() {
            world.bring_back(body);
        }
        world.place(self.wrist, &self.posture.world_from_wrist);
        for (index, side) in SIDES.into_iter().enumerate() {
            let pose = self.posture.world_from_finger(side);
            match &self.fingers {
                Fingers::Locked(fingers) => world.place(fingers[index], &pose),
                Fingers::Gripping { fingers, .. } => {
                    world.place_hinged(&fingers[index], &pose);
                }
            }
        }
        self.stale = false;
    }

    /// What the rest of the world did to it, and to what is attached to it, in the last substep.
    pub(super) fn push(&self, world: &World) -> Push {
        if self.stale {
            return Push::NONE;
        }
        let [left, right] = self.finger_bodies();
        if let Some((object, _)) = self.attached {
            return world.push_on(&[self.wrist, left, right, object]);
        }
        match self.fingers {
            // Locked jaws cannot give way: what they squeeze counts as pressed.
            Fingers::Locked(_) => {
                let is_between = |object| world.touch(left, object) && world.touch(right, object);
                let crushes = world.objects().any(is_between);
                let [left, right] = [left, right].map(|finger| world.push_on(&[finger]));
                Push { crushes, ..world.push_on(&[self.wrist]).with(left).with(right) }
            }
            Fingers::Gripping { .. } => world.push_on(&[self.wrist, left, right]),
        }
    }
}

/// How far jaws are open whose fingers hang on hinges, rad.
fn opening(world: &World, fingers: &[HingedId; 2]) -> f64 {
    fingers.iter().map(|finger| world.hinge_angle(finger)).sum()
}

/// The hinge of the finger of a side: the angle grows as it opens.
fn hinge(side: f64) -> Hinge {
    Hinge {
        axis: Unit::new_unchecked(Vector3::new(-side, 0.0, 0.0)),
        limits: FINGER_LIMITS,
        mass: FINGER_MASS,
        inertia: FINGER_MASS * TIP_OFFSET * TIP_OFFSET / 3.0, // a rod about its end
        friction: FRICTION,
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests {
    use nalgebra::Point3;

    use super::posture::CLEVIS_LENGTH;
    use super::*;
    use crate::sim::frames;
    use crate::sim::motion::carry_out;
    use crate::sim::world::Solver;

    const SUBSTEPS: u32 = 48;

    /// Of gripping and of locked jaws, N.
    const SQUEEZES: [f64; 2] = [1.0, f64::INFINITY];

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

    fn go(instrument: &mut Instrument, world: &mut World, end: Posture) -> f64 {
        let [reached] = carry_out([instrument], world, [end], SUBSTEPS);
        reached
    }

    #[test]
    fn jaws_point_along_z_and_reach_to_the_tip() {
        let posture = down([0.0; 3]);
        assert!(posture.world_from_tip().translation.vector.norm() < 1e-12);
        for squeeze in SQUEEZES {
            let instrument = Instrument::insert(&mut World::new(Solver::LIGHT), posture, squeeze);
            let depth = instrument.depth_below_wrist(&posture.world_from_wrist.rotation);
            assert!((depth - TIP_OFFSET).abs() < 1e-12);
        }
        let jaws = Jaws::NEEDLE_DRIVER;
        let aabb = posture.aabb(&jaws);
        assert!(aabb.min.z.abs() < 1e-12 && aabb.max.z > TIP_OFFSET + CLEVIS_LENGTH);
        let open = Posture { jaw: JAW_OPEN, ..posture };
        let open = open.aabb(&jaws);
        assert!(open.max.y > aabb.max.y + 0.5e-3 && open.min.z > 0.0);
    }

    #[test]
    fn far_from_sleeping_objects_no_time_passes_for_them() {
        for squeeze in SQUEEZES {
            let (mut world, wire) = pad_and_wire();
            let before = world.pose(wire);
            let mut instrument = Instrument::insert(&mut world, down([0.0, 0.0, 0.05]), squeeze);
            let end = down([0.01, 0.0, 0.04]);
            assert_eq!(go(&mut instrument, &mut world, end), 1.0);
            assert_eq!(*instrument.posture(), end);
            assert!(world.at_rest());
            assert_eq!(world.pose(wire), before);
        }
    }

    #[test]
    fn a_wire_in_the_way_is_pushed_aside() {
        for squeeze in SQUEEZES {
            let (mut world, wire) = pad_and_wire();
            let mut instrument =
                Instrument::insert(&mut world, down([-0.008, 0.0, 0.1e-3]), squeeze);
            let end = down([0.002, 0.0, 0.1e-3]);
            assert!(go(&mut instrument, &mut world, end) > 0.95);
            // The finger's flank is 0.9 mm from the tip's middle, the wire's axis 0.5 mm further.
            let pushed = world.pose(wire).translation.vector;
            let tip = instrument.posture().world_from_tip().translation.x;
            assert!(pushed.x > tip + 0.9e-3 && pushed.x < 0.02, "{pushed}");
            assert!(pushed.z > 0.4e-3 && pushed.z < 0.02);
        }
    }

    #[test]
    fn a_wire_under_the_tip_stops_it_and_is_not_pressed_through_the_pad() {
        for squeeze in SQUEEZES {
            let (mut world, wire) = pad_and_wire();
            let mut instrument = Instrument::insert(&mut world, down([0.0, 0.0, 5e-3]), squeeze);
            let mut fastest: f64 = 0.0;
            for _ in 0..10 {
                let reached = go(&mut instrument, &mut world, down([0.0, 0.0, CLEARANCE]));
                assert!(reached < 1.0);
                fastest = fastest.max(world.velocity(wire).norm());
            }
            let tip = instrument.posture().world_from_tip().translation.z;
            let height = world.pose(wire).translation.z;
            assert!(height > 0.2e-3, "{height}");
            assert!(tip > 0.5e-3 && tip < 1.2e-3, "{tip}");
            assert!(fastest < 0.5, "{fastest}");
            // It is free to leave.
            assert_eq!(go(&mut instrument, &mut world, down([0.0, 0.0, 5e-3])), 1.0);
        }
    }

    #[test]
    fn jaws_that_close_on_a_wall_near_their_hinge_do_not_crush_it() {
        let (mut world, _) = pad_and_wire();
        let half = Vector3::new(4e-3, 0.8e-3, 4e-3);
        let wall = Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(half) };
        let pose = Pose::translation(0.03, 0.0, half.z);
        let wall = world.insert(Motion::Free { mass: 0.3e-3 }, &pose, 1.0, &[wall]);
        let down = |jaw: f64| Posture { jaw, ..down([0.03, 0.0, 0.3e-3]) };
        let mut instrument = Instrument::insert(&mut world, down(JAW_OPEN), SQUEEZES[0]);
        // What closes with 1 N at its tip would close with 4 N where the wall's edge is.
        let mut deepest: f64 = 0.0;
        for _ in 0..10 {
            go(&mut instrument, &mut world, down(JAW_CLOSED));
            deepest = deepest.max(world.deepest_overlap());
        }
        assert!(instrument.fingers_touching(&world, wall) > 0);
        assert!(deepest < 0.4e-3, "{deepest}");
    }
}
