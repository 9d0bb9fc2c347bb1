//! Time-optimal trajectories from any velocity to rest, of several axes that arrive together.
//!
//! This is what dVRK's generator (Reflexxes Type II) does: velocity and acceleration are limited, jerk is not. A
//! trajectory is planned once for its goal and then sampled. All of it is arithmetic and square roots, which have
//! the same bits on every machine.
//!
//! The profile of an axis has three segments: it changes its velocity to that of a cruise, cruises, and comes to
//! rest. The slowest axis decides how long all take:
//!
//! - From rest, all axes follow the profile of the slowest one, each by its own distance: a straight line in joint
//!   space.
//! - Where an axis moves already, or would break its limits on that line, each axis has the cruise that takes it to
//!   its goal in that time.

use arrayvec::ArrayVec;

use crate::robots::{Axes, MAX_AXES};

/// What counts as rounding, as a part of a limit or of a time.
const ROUNDING: f64 = 1e-12;

/// How fast an axis may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisLimit {
    /// Largest speed, rad/s or m/s, above 0.
    pub velocity: f64,
    /// Largest acceleration, rad/s² or m/s², above 0.
    pub acceleration: f64,
}

/// The way of one axis to rest at a distance, in three segments.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Profile {
    /// Where it ends, from where it begins, rad or m.
    distance: f64,
    /// Velocity at the beginning.
    start: f64,
    /// Velocity of the cruise.
    cruise: f64,
    acceleration: f64,
    /// When the cruise begins and ends, s.
    cruises: [f64; 2],
    /// When it is at rest, s.
    end: f64,
}

impl Profile {
    /// The profile with a cruise of this velocity for `seconds`.
    fn new(distance: f64, start: f64, cruise: f64, seconds: f64, acceleration: f64) -> Self {
        let begin = (cruise - start).abs() / acceleration;
        let until = begin + seconds;
        let end = until + cruise.abs() / acceleration;
        Self { distance, start, cruise, acceleration, cruises: [begin, until], end }
    }

    /// The fastest one.
    fn fastest(distance: f64, start: f64, limit: AxisLimit) -> Self {
        let AxisLimit { velocity, acceleration } = limit;
        // Where braking at once would end decides which way the cruise goes.
        let beyond = distance - start * start.abs() / (2.0 * acceleration);
        let way = if beyond < 0.0 { -1.0 } else { 1.0 };
        let (ahead, speed) = (way * distance, way * start);
        let peak = (acceleration * ahead + 0.5 * speed * speed).max(0.0).sqrt();
        if peak <= velocity {
            return Self::new(distance, start, way * peak, 0.0, acceleration);
        }
        let change = (velocity - speed).abs() / acceleration;
        let covered =
            0.5 * (speed + velocity) * change + velocity * velocity / (2.0 * acceleration);
        let seconds = ((ahead - covered) / velocity).max(0.0);
        Self::new(distance, start, way * velocity, seconds, acceleration)
    }

    /// The way of this fastest profile, taking `seconds`.
    ///
    /// The distance covered in that time grows with the velocity of the cruise, which follows from it in closed
    /// form: of less than 0, between 0 and the velocity at the beginning, or of more.
    fn stretched(&self, seconds: f64) -> Self {
        if seconds - self.end <= ROUNDING * seconds {
            return *self;
        }
        let Self { distance, start, acceleration, .. } = *self;
        let way = if start < 0.0 { -1.0 } else { 1.0 };
        let (ahead, speed) = (way * distance, way * start);
        let braking = speed * speed / (2.0 * acceleration);
        let to_rest = seconds - speed / acceleration;
        let cruise = if ahead < braking {
            -slow_root(braking - ahead, to_rest, acceleration)
        } else if ahead <= speed * seconds - braking {
            if to_rest > 0.0 { (ahead - braking) / to_rest } else { 0.0 }
        } else {
            slow_root(ahead + braking, seconds + speed / acceleration, acceleration)
        };
        let changes = ((cruise - speed).abs() + cruise.abs()) / acceleration;
        let cruising = (seconds - changes).max(0.0);
        Self::new(distance, start, way * cruise, cruising, acceleration)
    }

    /// Position from the beginning and velocity after `seconds`.
    fn at(&self, seconds: f64) -> [f64; 2] {
        let Self { distance, start, cruise, acceleration, cruises: [begin, until], end } = *self;
        let way = if cruise < 0.0 { -1.0 } else { 1.0 };
        let braking = way * acceleration;
        let rest = cruise * cruise.abs() / (2.0 * acceleration);
        if seconds < begin {
            let change = if cruise < start { -acceleration } else { acceleration };
            [(start + 0.5 * change * seconds) * seconds, start + change * seconds]
        } else if seconds < until {
            [distance - rest - cruise * (until - seconds), cruise]
        } else {
            let left = (end - seconds).max(0.0);
            [distance - 0.5 * braking * left * left, braking * left]
        }
    }
}

/// The smaller solution v of v²/a − v·t + c = 0, which has one: a speed at which a distance takes a time.
fn slow_root(c: f64, t: f64, a: f64) -> f64 {
    let root = (t * t - 4.0 * c / a).max(0.0).sqrt();
    let sum = t + root;
    if sum > 0.0 { 2.0 * c / sum } else { 0.0 }
}

/// How the axes of a trajectory move.
#[expect(
    clippy::large_enum_variant,
    reason = "planned in place, at every set-point of a stream at most"
)]
#[derive(Debug, Clone, PartialEq)]
enum Ways {
    /// All on one straight line: along the profile of one of them, by their distances.
    Line { profile: Profile, distances: Axes },
    /// Each along its own.
    Each(ArrayVec<Profile, MAX_AXES>),
}

/// A trajectory of several axes to rest at a goal.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    start: Axes,
    goal: Axes,
    ways: Ways,
    duration: f64,
}

impl Trajectory {
    /// The fastest trajectory from `start` with `velocity` to rest at `goal`. All are finite.
    ///
    /// # Panics
    /// Where not all have the same number of axes.
    pub fn plan(start: &[f64], velocity: &[f64], goal: &[f64], limits: &[AxisLimit]) -> Self {
        let count = start.len();
        assert!(
            [velocity.len(), goal.len(), limits.len()] == [count; 3],
            "one number for each axis"
        );
        let distances: Axes = goal.iter().zip(start).map(|(goal, start)| goal - start).collect();
        let fastest: ArrayVec<Profile, MAX_AXES> = (0..count)
            .map(|axis| Profile::fastest(distances[axis], velocity[axis], limits[axis]))
            .collect();
        let slowest = (0..count).fold(0, |slowest, axis| {
            if fastest[axis].end > fastest[slowest].end { axis } else { slowest }
        });
        let duration = fastest.get(slowest).map_or(0.0, |profile| profile.end);
        let is_at_rest = velocity.iter().all(|velocity| *velocity == 0.0);
        let ways = match fastest.get(slowest) {
            Some(profile) if is_at_rest && fits(profile, &distances, limits) => {
                Ways::Line { profile: *profile, distances }
            }
            _ => Ways::Each((0..count).map(|axis| fastest[axis].stretched(duration)).collect()),
        };
        Self {
            start: start.iter().copied().collect(),
            goal: goal.iter().copied().collect(),
            ways,
            duration,
        }
    }

    /// How long it takes, s.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// Where it ends.
    pub fn goal(&self) -> &Axes {
        &self.goal
    }

    /// Whether the axes keep a straight line in joint space.
    pub fn is_line(&self) -> bool {
        matches!(self.ways, Ways::Line { .. })
    }

    /// Positions and velocities after `seconds`; at the end and past it, those of the goal.
    pub fn at(&self, seconds: f64) -> [Axes; 2] {
        if seconds >= self.duration {
            return [self.goal.clone(), self.start.iter().map(|_| 0.0).collect()];
        }
        let [mut positions, mut velocities] = [self.start.clone(), Axes::new()];
        match &self.ways {
            Ways::Line { profile, distances } => {
                let passed = profile.at(seconds).map(|passed| passed / profile.distance);
                for (position, distance) in positions.iter_mut().zip(distances) {
                    *position += distance * passed[0];
                    velocities.push(distance * passed[1]);
                }
            }
            Ways::Each(profiles) => {
                for (position, profile) in positions.iter_mut().zip(profiles) {
                    let [passed, velocity] = profile.at(seconds);
                    *position += passed;
                    velocities.push(velocity);
                }
            }
        }
        [positions, velocities]
    }
}

/// Whether all axes may follow a profile, each by its own distance.
fn fits(profile: &Profile, distances: &[f64], limits: &[AxisLimit]) -> bool {
    let [speed, acceleration] =
        [profile.cruise, profile.acceleration].map(|most| (most / profile.distance).abs());
    distances.iter().zip(limits).all(|(distance, limit)| {
        let within = |part: f64, most: f64| distance.abs() * part <= most * (1.0 + ROUNDING);
        *distance == 0.0
            || (within(speed, limit.velocity) && within(acceleration, limit.acceleration))
    })
}
