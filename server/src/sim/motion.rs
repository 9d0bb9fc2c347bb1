//! How instruments move: each along its [`Profile`], as far as the [`guard`] lets it, substep by substep.
//!
//! A [`Motion`] is that of all instruments of a task at the same time. [`Motion::advance`] lets one substep pass
//! for them and for the world. [`Motion::pass`] lets several pass, and knows **quiescence**: every free object
//! sleeps, and the volumes that the instruments sweep, jaws as they are and as they are to be, meet no
//! object, no static body and not each other. Then nothing else would change: it moves the
//! instruments alone, and the world needs no substep. Where objects do move, an instrument that none can meet
//! in a substep takes no part in it.

use std::collections::VecDeque;

use arrayvec::ArrayVec;
use nalgebra::Vector3;

use super::instrument::{Instrument, Posture};
use super::world::{Push, World};

mod effort;
mod guard;
pub(crate) mod profile;

pub use effort::Effort;
pub use profile::Profile;

/// Most instruments of a task.
pub const MAX_INSTRUMENTS: usize = 2;

/// The instruments of a task.
pub type Instruments<'a> = ArrayVec<&'a mut Instrument, MAX_INSTRUMENTS>;

/// The profiles of a task's instruments.
pub type Profiles = ArrayVec<Profile, MAX_INSTRUMENTS>;

/// How far an instrument of a chase that gave way comes back to its path in a substep, m: a tenth of what it gives
/// way, so that it does not swing.
const COMING_BACK: f64 = 0.1 * guard::ASIDE;

/// Substeps over which a jaw force is averaged: 1/60 s. Impulses of single substeps depend on the solver.
const FORCE_SUBSTEPS: usize = 4;

/// Where the instruments are to be.
type Places = ArrayVec<Posture, MAX_INSTRUMENTS>;

/// Set-points that are kept of a stream, behind the latest: as far back as an instrument may be driven.
const KEPT: usize = 48;

/// How far an instrument that chases its set-point goes in a substep, m and rad: 0.6 m/s and 2400 °/s, more than
/// the joints' limits of velocity allow together.
const CHASE: [f64; 2] = [2.5e-3, 10.0 * std::f64::consts::PI / 180.0];

/// How far an instrument came along its profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arrival {
    /// Part of the way that it covered: 1 where it is at the profile's end.
    pub covered: f64,
    /// Whether it was held up or pushed aside: it is not where the profile has it now.
    pub is_blocked: bool,
}

/// What counts as the way covered by an instrument that is beside its path at the end: not all of it.
const BESIDE: f64 = 1.0 - f64::EPSILON;

/// One instrument on its way.
#[derive(Debug, Clone)]
struct Way {
    profile: Profile,
    /// Substeps' worth of the way that the wrist has covered.
    done: u32,
    /// What pushed in the last substep.
    push: Push,
    /// How far it has given way off its path, m.
    aside: Vector3<f64>,
}

impl Way {
    fn new(profile: Profile) -> Self {
        Self { profile, done: 0, push: Push::NONE, aside: Vector3::zeros() }
    }

    /// The set-points of a streamed motion.
    fn points(&mut self) -> &mut VecDeque<Posture> {
        match &mut self.profile {
            Profile::Streamed(points) => points,
            _ => panic!("only streamed motions take set-points"),
        }
    }

    /// Makes the place that the instrument of a chase came to the newest that is kept, and lets it come back to its
    /// path where it gave way no further than `before`.
    fn arrive(&mut self, before: &Vector3<f64>) {
        let came = self.done as usize + 1;
        let points = self.points();
        points.truncate(came);
        while points.len() <= KEPT {
            let oldest = *points.front().expect("it begins somewhere");
            points.push_front(oldest);
        }
        points.drain(..points.len() - KEPT - 1);
        self.done = KEPT as u32;
        if self.aside == *before {
            let left = (self.aside.norm() - COMING_BACK).max(0.0);
            self.aside = self.aside.try_normalize(0.0).unwrap_or_default() * left;
        }
    }

    /// The posture in substep `now` of `substeps` where the wrist has covered `done` of them.
    fn along(&self, done: u32, now: u32, substeps: u32) -> Posture {
        let mut posture = self.profile.at(done, now, substeps);
        posture.world_from_wrist.translation.vector += self.aside;
        posture
    }
}

/// The motion of a task's instruments: along profiles that are known, through set-points that come one by one
/// ([`Self::streamed`]), or towards the latest set-point ([`Self::chasing`]).
#[derive(Debug, Clone, Default)]
pub struct Motion {
    ways: ArrayVec<Way, MAX_INSTRUMENTS>,
    /// Substeps that have passed.
    now: u32,
    substeps: u32,
    /// Jaw forces of the latest substeps of each instrument, N, the latest first; not of the present motion alone.
    forces: ArrayVec<[f64; FORCE_SUBSTEPS], MAX_INSTRUMENTS>,
}

impl Motion {
    /// A motion along profiles of `substeps` substeps, one for each instrument.
    pub fn new(profiles: impl IntoIterator<Item = Profile>, substeps: u32) -> Self {
        let mut motion = Self::default();
        motion.begin(profiles, substeps);
        motion
    }

    /// Begins another motion in place of this one.
    pub fn begin(&mut self, profiles: impl IntoIterator<Item = Profile>, substeps: u32) {
        (self.now, self.substeps) = (0, substeps);
        self.ways.clear();
        self.ways.extend(profiles.into_iter().map(Way::new));
    }

    /// A motion of instruments from `starts` through set-points that come one by one, see [`Self::push`].
    pub fn streamed(starts: impl IntoIterator<Item = Posture>) -> Self {
        let profile = |start: Posture| Profile::Streamed([start].into());
        Self::new(starts.into_iter().map(profile), 0)
    }

    /// Adds a substep in which each instrument is to go to its set-point. One that was held up is as many
    /// substeps behind, until nothing is in its way any more and the world rests.
    ///
    /// # Panics
    /// Where the motion is not a streamed one, or has another number of instruments.
    pub fn push(&mut self, set_points: &[Posture]) {
        assert_eq!(set_points.len(), self.ways.len(), "one set-point for each instrument");
        self.substeps += 1;
        let mut can_forget = self.now as usize >= KEPT;
        for (way, set_point) in self.ways.iter_mut().zip(set_points) {
            way.points().push_back(*set_point);
            can_forget &= way.done > 0;
        }
        if can_forget {
            (self.now, self.substeps) = (self.now - 1, self.substeps - 1);
            for way in &mut self.ways {
                way.done -= 1;
                way.points().pop_front();
            }
        }
    }

    /// A motion of instruments from `starts` to set-points of which each takes the place of the one before, see
    /// [`Self::chase`].
    pub fn chasing(starts: impl IntoIterator<Item = Posture>) -> Self {
        let here = KEPT as u32;
        let trail = |start| Profile::Streamed(std::iter::repeat_n(start, KEPT + 1).collect());
        let mut motion = Self::new(starts.into_iter().map(trail), here);
        motion.now = here;
        motion.ways.iter_mut().for_each(|way| way.done = here);
        motion
    }

    /// Lets a substep pass in which each instrument goes straight towards its set-point, whatever the ones before were.
    /// It goes no further than instruments can in a substep, and is held up as on any path.
    ///
    /// # Panics
    /// Where the motion is no chase, or has another number of instruments.
    pub fn chase(
        &mut self,
        set_points: &[Posture],
        instruments: &mut [&mut Instrument],
        world: &mut World,
    ) {
        assert_eq!(set_points.len(), self.ways.len(), "one set-point for each instrument");
        for (way, set_point) in self.ways.iter_mut().zip(set_points) {
            let points = way.points();
            let here = points.back().expect("it begins somewhere");
            points.push_back(within_reach(here, set_point));
        }
        self.substeps += 1;
        let before: ArrayVec<_, MAX_INSTRUMENTS> = self.ways.iter().map(|way| way.aside).collect();
        self.pass(1, instruments, world);
        for (way, before) in self.ways.iter_mut().zip(&before) {
            way.arrive(before);
        }
        (self.now, self.substeps) = (self.now - 1, self.substeps - 1);
    }

    /// Substeps that are left.
    pub fn left(&self) -> u32 {
        self.substeps - self.now
    }

    /// The part of the motion's time that has passed, from 0 to 1.
    pub fn passed(&self) -> f64 {
        if self.substeps == 0 { 1.0 } else { f64::from(self.now) / f64::from(self.substeps) }
    }

    /// Lets one substep pass: instruments go on as far as they may, and the world advances.
    pub fn advance(&mut self, instruments: &mut [&mut Instrument], world: &mut World) -> Effort {
        self.now += 1;
        let before: Places = instruments.iter().map(|each| *each.posture()).collect();
        guard::drive(&mut self.ways, instruments, world, self.now, self.substeps);
        world.advance();
        let mut effort = Effort::default();
        while self.forces.len() < self.ways.len() {
            self.forces.push([0.0; FORCE_SUBSTEPS]);
        }
        for (((way, instrument), before), forces) in
            self.ways.iter_mut().zip(instruments).zip(before).zip(&mut self.forces)
        {
            forces.rotate_right(1);
            forces[0] = instrument.jaw_force(world);
            way.push = instrument.push(world);
            let tip = |posture: &Posture| posture.world_from_tip().translation.vector;
            effort += Effort {
                tip_path: (tip(instrument.posture()) - tip(&before)).norm(),
                peak_force: forces.iter().sum::<f64>() / FORCE_SUBSTEPS as f64,
                tissue_pressure: instrument.tissue_pressure(world),
            };
        }
        effort
    }

    /// Lets `substeps` substeps pass, of those that are left; while nothing else would change, of the instruments
    /// alone.
    pub fn pass(
        &mut self,
        substeps: u32,
        instruments: &mut [&mut Instrument],
        world: &mut World,
    ) -> Effort {
        let until = self.now + substeps;
        let mut effort = Effort::default();
        while self.now < until {
            let mut quiet = None;
            if world.at_rest() {
                quiet = self.skip(until, instruments, world);
                if quiet.is_none() {
                    quiet = self.glide(1, instruments, world);
                }
            }
            effort += match quiet {
                Some(tip_path) => {
                    self.forces.clear(); // nothing touches the jaws
                    Effort { tip_path, ..Effort::default() }
                }
                None => self.advance(instruments, world),
            };
        }
        effort
    }

    fn skip(
        &mut self,
        until: u32,
        instruments: &mut [&mut Instrument],
        world: &World,
    ) -> Option<f64> {
        let may_bend = |way: &Way| matches!(way.profile, Profile::Streamed(_) | Profile::Traced(_));
        if until - self.now > 1 && self.ways.iter().any(may_bend) {
            None // its set-points need not be on a straight way
        } else if until == self.substeps {
            self.finish(instruments, world)
        } else {
            self.glide(until - self.now, instruments, world)
        }
    }

    /// Moves the instruments to the end of the motion if their way is free. Returns the path length of the tips, m, or
    /// `None` if a body is in the way. The world must be at rest.
    fn finish(&mut self, instruments: &mut [&mut Instrument], world: &World) -> Option<f64> {
        let ends: Places = self.ways.iter().map(|way| way.profile.end()).collect();
        if !are_free(&ends, instruments, world) {
            return None;
        }
        let mut tip_path = 0.0;
        for ((way, instrument), end) in self.ways.iter_mut().zip(instruments).zip(ends) {
            way.aside = Vector3::zeros();
            tip_path += way.tip_path(instrument.posture(), self.substeps, self.substeps);
            way.done = self.substeps;
            instrument.place(end);
        }
        self.now = self.substeps;
        Some(tip_path)
    }

    /// Moves the instruments by `substeps` substeps if their way is free. Returns the path length of the tips, m, or
    /// `None` if a body is in the way. The world must be at rest.
    fn glide(
        &mut self,
        substeps: u32,
        instruments: &mut [&mut Instrument],
        world: &World,
    ) -> Option<f64> {
        let now = self.now + substeps;
        let next = |way: &Way| way.along(way.done + substeps, now, self.substeps);
        let places: Places = self.ways.iter().map(next).collect();
        if !are_free(&places, instruments, world) {
            return None;
        }
        let mut tip_path = 0.0;
        for ((way, instrument), place) in self.ways.iter_mut().zip(instruments).zip(places) {
            tip_path += way.tip_path(instrument.posture(), way.done + substeps, self.substeps);
            (way.done, way.push) = (way.done + substeps, Push::NONE);
            instrument.place(place);
        }
        self.now = now;
        Some(tip_path)
    }

    /// How far the instruments came, one after the other.
    pub fn arrivals(&self) -> impl Iterator<Item = Arrival> {
        let arrival = move |way: &Way| {
            let (covered, aside) = (way.profile.covered(way.done, self.substeps), way.aside);
            let is_beside = aside != Vector3::zeros();
            Arrival {
                covered: if is_beside { covered.min(BESIDE) } else { covered },
                is_blocked: is_beside || way.done < self.now,
            }
        };
        self.ways.iter().map(arrival)
    }
}

/// As far on the straight way to a set-point as an instrument goes in a substep; the jaws are told at once.
fn within_reach(here: &Posture, set_point: &Posture) -> Posture {
    let [from, to] = [here, set_point].map(|posture| &posture.world_from_wrist);
    let way = (to.translation.vector - from.translation.vector).norm();
    let part = (CHASE[0] / way).min(CHASE[1] / from.rotation.angle_to(&to.rotation));
    if part < 1.0 { here.towards(set_point, part, 1.0) } else { *set_point }
}

/// Whether no instrument meets anything on its way to its place.
fn are_free(places: &[Posture], instruments: &[&mut Instrument], world: &World) -> bool {
    let swept = |index: usize| instruments[index].swept(world, &places[index]);
    (0..places.len()).all(|index| {
        let volume = swept(index);
        instruments[index].has_free_way(world, &volume)
            && (0..index).all(|other| !volume.meets(&swept(other)))
    })
}

/// Moves instruments from rest to rest within `substeps` substeps and returns the part of their way that they
/// covered: less than 1 where one yielded.
pub fn carry_out<const N: usize>(
    mut instruments: [&mut Instrument; N],
    world: &mut World,
    ends: [Posture; N],
    substeps: u32,
) -> [f64; N] {
    let starts = instruments.iter().map(|each| *each.posture());
    let profiles = starts.zip(ends).map(|(start, end)| Profile::Smoothstep { start, end });
    let mut motion = Motion::new(profiles, substeps);
    motion.pass(substeps, &mut instruments, world);
    let mut covered = motion.arrivals().map(|arrival| arrival.covered);
    std::array::from_fn(|_| covered.next().expect("as many as instruments"))
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "these results are exact")]
mod tests {
    use nalgebra::Point3;

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
                reached = carry_out([&mut left, &mut right], &mut world, ends, SUBSTEPS);
            }
            assert_eq!(reached == [1.0; 2], passes, "{reached:?}");
            if !passes {
                let apart = [&left, &right].map(|arm| arm.posture().world_from_tip().translation.x);
                assert!(apart[1] - apart[0] > 1e-3, "{apart:?}");
                assert!(left.posture().gap(right.posture()) > -0.2e-3);
                // Both may leave as they came.
                let back = carry_out([&mut left, &mut right], &mut world, starts, SUBSTEPS);
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
            world.advance();
        }
        for _ in 0..4 {
            let end = open(arm.posture().world_from_tip().translation.z - 0.01);
            carry_out([&mut arm], &mut world, [end], SUBSTEPS);
            assert!(world.at_rest());
            widest = widest.max(arm.opening(&world));
        }
        // It would have come down by 40 mm.
        let tip = arm.posture().world_from_tip().translation.z;
        assert!(tip > 0.017, "it went on to {tip}");
        assert!(widest < JAW_OPEN + 0.1, "forced open to {widest}");
    }

    #[test]
    fn a_chase_goes_to_the_latest_set_point_as_fast_as_instruments_go() {
        let mut world = World::new(Solver::LIGHT);
        let start = down([0.0, 0.0, 0.05]);
        let mut arm = Instrument::insert(&mut world, start, 1.0);
        let mut motion = super::Motion::chasing([start]);
        // What was asked for before is forgotten.
        let (there, back) = (down([0.1, 0.0, 0.05]), down([-0.05, 0.0, 0.05]));
        for _ in 0..10 {
            motion.chase(&[there], &mut [&mut arm], &mut world);
        }
        let x = |arm: &Instrument| arm.posture().world_from_wrist.translation.x;
        assert!((x(&arm) - 10.0 * CHASE[0]).abs() < 1e-12);
        for left in (0..30).rev() {
            motion.chase(&[back], &mut [&mut arm], &mut world);
            assert!((x(&arm) + 0.05 - f64::from(left) * CHASE[0]).abs() < 1e-12);
        }
        assert_eq!(*arm.posture(), back);
    }

    #[test]
    fn a_chase_that_was_held_up_has_nothing_to_catch_up_with() {
        let mut world = World::new(Solver::LIGHT);
        let half = Vector3::new(0.05, 0.05, 0.01);
        let block = Part { body_from_part: Pose::identity(), shape: Shape::Cuboid(half) };
        world.insert(Motion::Fixed, &Pose::identity(), 1.0, &[block]);
        let start = down([0.0, 0.0, 0.02]);
        let mut arm = Instrument::insert(&mut world, start, 1.0);
        let mut motion = super::Motion::chasing([start]);
        let (deep, up) = (down([0.0, 0.0, -0.03]), down([0.0, 0.0, 0.02]));
        for _ in 0..2000 {
            motion.chase(&[deep], &mut [&mut arm], &mut world);
        }
        let tip = arm.posture().world_from_tip().translation.z;
        assert!(tip > 9e-3, "it went on to {tip}");
        for _ in 0..10 {
            motion.chase(&[up], &mut [&mut arm], &mut world);
        }
        assert_eq!(*arm.posture(), up);
    }
}
