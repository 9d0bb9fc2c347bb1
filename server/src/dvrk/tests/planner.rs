//! Trajectories against closed forms, against an integral, and against another planner.

use rsruckig::prelude::*;

use super::{DEGREE, rest_to_rest};
use crate::dvrk::planner::{AxisLimit, Trajectory};
use crate::robots::Axes;
use crate::sim::random::Rng;

/// Tolerance of positions, rad or m, and of times, s: far above rounding, far below what an arm resolves.
const TOLERANCE: f64 = 1e-9;

fn limit(velocity: f64, acceleration: f64) -> AxisLimit {
    AxisLimit { velocity, acceleration }
}

/// The limits of a PSM's axes.
fn psm() -> Vec<AxisLimit> {
    let [slow, slide, fast] = [
        limit(90.0 * DEGREE, 90.0 * DEGREE),
        limit(0.2, 0.2),
        limit(1080.0 * DEGREE, 720.0 * DEGREE),
    ];
    vec![slow, slow, slide, fast, fast, fast, fast]
}

fn ecm() -> Vec<AxisLimit> {
    let turn = limit(30.0 * DEGREE, 90.0 * DEGREE);
    vec![turn, turn, limit(0.06, 0.06), turn]
}

/// The time of one axis from a velocity to rest, as the reference has it for velocities within the limit.
fn closed_form(distance: f64, velocity: f64, limit: AxisLimit) -> f64 {
    let AxisLimit { velocity: most, acceleration: a } = limit;
    let beyond = distance - velocity * velocity.abs() / (2.0 * a);
    let sign = if beyond < 0.0 { -1.0 } else { 1.0 };
    let (e, w) = (sign * distance, sign * velocity);
    let peak = (a * e + 0.5 * w * w).sqrt();
    if peak <= most {
        (2.0 * peak - w) / a
    } else {
        let cruise = e - (most * most - w * w) / (2.0 * a) - most * most / (2.0 * a);
        (most - w) / a + most / a + cruise / most
    }
}

/// Some plan: start, velocity, goal.
fn random(rng: &mut Rng, limits: &[AxisLimit], fastest: f64) -> [Axes; 3] {
    let mut axes = |size: &dyn Fn(&AxisLimit) -> f64| -> Axes {
        limits.iter().map(|limit| size(limit) * rng.uniform(-1.0, 1.0)).collect()
    };
    let way = |limit: &AxisLimit| 1.5 * limit.velocity;
    [axes(&way), axes(&|limit| fastest * limit.velocity), axes(&way)]
}

#[test]
fn a_single_axis_takes_the_time_of_the_closed_form() {
    let mut rng = Rng::new(1, 0);
    for _ in 0..20_000 {
        let limits = [limit(rng.uniform(0.05, 20.0), rng.uniform(0.05, 20.0))];
        let [start, velocity, goal] = random(&mut rng, &limits, 1.0);
        let still = Trajectory::plan(&start, &[0.0], &goal, &limits);
        let distance = goal[0] - start[0];
        let seconds = rest_to_rest(distance, limits[0].velocity, limits[0].acceleration);
        assert!((still.duration() - seconds).abs() < TOLERANCE);
        let moving = Trajectory::plan(&start, &velocity, &goal, &limits);
        let seconds = closed_form(distance, velocity[0], limits[0]);
        assert!((moving.duration() - seconds).abs() < TOLERANCE * seconds.max(1.0));
    }
}

#[test]
fn trajectories_keep_their_limits_and_join_what_was_with_what_is_to_be() {
    let mut rng = Rng::new(2, 0);
    for round in 0..4000 {
        let limits = if round % 2 == 0 { psm() } else { ecm() };
        // At rest, within the limits, and faster than they allow: after a ratio was lowered.
        let fastest = [0.0, 1.0, 3.0][round % 3];
        let [start, velocity, goal] = random(&mut rng, &limits, fastest);
        let trajectory = Trajectory::plan(&start, &velocity, &goal, &limits);
        let seconds = trajectory.duration();
        let steps = 200;
        let at = |step: usize| trajectory.at(seconds * step as f64 / steps as f64);
        let [mut position, mut speed] = at(0);
        for axis in 0..limits.len() {
            assert!((position[axis] - start[axis]).abs() < TOLERANCE);
            assert!((speed[axis] - velocity[axis]).abs() < TOLERANCE);
        }
        let step = seconds / steps as f64;
        for index in 1..=steps {
            let [next, then] = at(index);
            for (axis, limit) in limits.iter().enumerate() {
                let most = limit.velocity.max(velocity[axis].abs());
                assert!(then[axis].abs() <= most + TOLERANCE, "{trajectory:?}");
                let change = (then[axis] - speed[axis]).abs();
                assert!(change <= limit.acceleration * step + TOLERANCE, "{trajectory:?}");
                // The velocity is the position's: the mean is exact but where the acceleration changes.
                let moved = next[axis] - position[axis];
                let mean = 0.5 * (then[axis] + speed[axis]) * step;
                let bend = 0.5 * limit.acceleration * step * step;
                assert!((moved - mean).abs() <= bend + TOLERANCE, "{trajectory:?}");
            }
            (position, speed) = (next, then);
        }
        assert_eq!(trajectory.at(seconds), [goal.clone(), goal.iter().map(|_| 0.0).collect()]);
        // Just before its end it is nearly there, on every axis.
        let [before, _] = trajectory.at(seconds * (1.0 - 1e-12));
        for (axis, limit) in limits.iter().enumerate() {
            assert!((before[axis] - goal[axis]).abs() < TOLERANCE * limit.velocity.max(1.0));
        }
    }
}

#[test]
fn positions_are_the_integral_of_velocities() {
    let mut rng = Rng::new(3, 0);
    for _ in 0..200 {
        let [start, velocity, goal] = random(&mut rng, &psm(), 1.0);
        let trajectory = Trajectory::plan(&start, &velocity, &goal, &psm());
        let (steps, mut sum) = (20_000, start.clone());
        let step = trajectory.duration() / f64::from(steps);
        for index in 0..steps {
            let [_, speed] = trajectory.at((f64::from(index) + 0.5) * step);
            for (sum, speed) in sum.iter_mut().zip(&speed) {
                *sum += speed * step;
            }
        }
        for (sum, goal) in sum.iter().zip(&goal) {
            // The midpoint rule errs by a·step² at each change of the acceleration.
            assert!((sum - goal).abs() < 1e-5, "{sum} {goal}");
        }
    }
}

#[test]
fn from_rest_all_axes_of_a_psm_keep_a_straight_line() {
    let mut rng = Rng::new(4, 0);
    let (limits, still) = (psm(), [0.0; 7]);
    let reach = [3.0, 1.8, 0.24, 9.0, 2.7, 2.7, 2.0];
    for _ in 0..2000 {
        let start: Axes = reach.iter().map(|reach| reach * rng.unit()).collect();
        let goal: Axes = reach.iter().map(|reach| reach * rng.unit()).collect();
        let trajectory = Trajectory::plan(&start, &still, &goal, &limits);
        assert!(trajectory.is_line());
        let alone = (0..7).map(|axis| {
            rest_to_rest(goal[axis] - start[axis], limits[axis].velocity, limits[axis].acceleration)
        });
        assert!((trajectory.duration() - alone.fold(0.0, f64::max)).abs() < TOLERANCE);
    }
    // An insertion of the ECM that is nearly the slowest would break its acceleration on the line of a turn.
    let goal = [60.0 * DEGREE, 0.0, 0.0759, 0.0];
    let trajectory = Trajectory::plan(&[0.0; 4], &[0.0; 4], &goal, &ecm());
    assert!(!trajectory.is_line());
    assert!((trajectory.duration() - (2.0 + 1.0 / 3.0)).abs() < TOLERANCE);
}

#[test]
fn an_axis_that_only_has_to_brake_brakes() {
    let limits = [limit(1.0, 2.0)];
    for way in [1.0, -1.0] {
        let trajectory = Trajectory::plan(&[0.0], &[way], &[0.25 * way], &limits);
        assert!((trajectory.duration() - 0.5).abs() < TOLERANCE);
        let [position, velocity] = trajectory.at(0.25);
        assert!((position[0] - 0.1875 * way).abs() < TOLERANCE);
        assert!((velocity[0] - 0.5 * way).abs() < TOLERANCE);
    }
}

#[test]
fn another_planner_finds_the_same_times() {
    let mut rng = Rng::new(5, 0);
    let mut ruckig = Ruckig::<7, ThrowErrorHandler>::new(None, 0.01);
    let mut slower = 0;
    for round in 0..20_000 {
        let limits = psm();
        let fastest = if round % 2 == 0 { 0.0 } else { 0.99 };
        let [start, velocity, goal] = random(&mut rng, &limits, fastest);
        let ours = Trajectory::plan(&start, &velocity, &goal, &limits);
        let mut input = InputParameter::<7>::new(None);
        for axis in 0..7 {
            input.current_position[axis] = start[axis];
            input.current_velocity[axis] = velocity[axis];
            input.target_position[axis] = goal[axis];
            input.max_velocity[axis] = limits[axis].velocity;
            input.max_acceleration[axis] = limits[axis].acceleration;
            input.max_jerk[axis] = f64::INFINITY;
        }
        let mut theirs = rsruckig::prelude::Trajectory::<7>::new(None);
        ruckig.calculate(&input, &mut theirs).expect("it plans without a limit of jerk");
        let difference = ours.duration() - theirs.get_duration();
        assert!(difference.abs() < TOLERANCE, "{difference}: {start:?} {velocity:?} {goal:?}");
        slower += usize::from(ours.duration() > 1.0);
    }
    assert!(slower > 1000, "the trajectories are all short");
}

#[test]
fn absurd_goals_plan_without_a_nan() {
    let mut rng = Rng::new(6, 0);
    let numbers = [0.0, -0.0, 1e-300, -1e-300, 1e-12, 1.0, -1.0, 1e6, -1e6, 1e12];
    for _ in 0..20_000 {
        let mut pick = || numbers[rng.index(numbers.len())];
        let [start, velocity, goal] = [(); 3].map(|()| [pick(), pick(), pick()]);
        let limits = [limit(1.0, 1.0), limit(1e-6, 1e-6), limit(20.0, 0.2)];
        let trajectory = Trajectory::plan(&start, &velocity, &goal, &limits);
        let seconds = trajectory.duration();
        assert!(seconds >= 0.0, "{seconds}");
        for part in [0.0, 0.1, 0.5, 0.9, 1.0, 2.0] {
            let [position, speed] = trajectory.at(part * seconds);
            let all = position.iter().chain(&speed);
            assert!(all.clone().all(|value| value.is_finite()), "{trajectory:?}");
        }
    }
}
