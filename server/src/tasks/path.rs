//! The closed path of a target that moves: a smooth curve through random points, gone along at
//! constant speed.
//!
//! The region is split into four blocks at a random centre; each has three random points, sorted so
//! that they lie round the centre. The curve through them is the periodic cubic spline (two
//! continuous derivatives) over the length of their chords, as the original's; the target moves
//! along it by arc length.

use nalgebra::{Cholesky, SMatrix, Vector2};

use crate::sim::random::Rng;

/// Steps of 0.1 s in which the target goes round once. Source: the original.
pub const LAP: usize = 200;

/// Where the points are, m, world frame: smallest and largest x and y. Source: the original.
const REGION: [[f64; 2]; 2] = [[-0.3, -0.4], [0.6, 0.4]];

/// How far from the region's middle the blocks may meet, in parts of its size. Source: the original.
const CENTRE_SPREAD: f64 = 0.1;

/// Points in each block. Source: the original.
const BLOCK_POINTS: usize = 3;

/// Points of the curve.
const POINTS: usize = 4 * BLOCK_POINTS;

/// Parts into which each stretch between two points is cut for measuring its length.
const PARTS: usize = 32;

/// How far the curve may swing out of the region, m: as far as the camera can follow.
const MARGIN: f64 = 0.1;

/// Where a target is after each step of a lap.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    stops: Vec<Vector2<f64>>,
}

impl Path {
    /// A random path.
    pub fn draw(rng: &mut Rng) -> Self {
        loop {
            let stops = evenly(&curve(&knots(rng)));
            if stops.iter().all(in_reach) {
                return Self { stops };
            }
        }
    }

    /// Where the target is after `steps` steps (x, y, m, world frame), whole ones or parts of one.
    pub fn at(&self, steps: f64) -> Vector2<f64> {
        let (whole, part) = (steps.floor() as usize, steps.fract());
        let stop = self.stops[whole % LAP];
        if part == 0.0 { stop } else { stop.lerp(&self.stops[(whole + 1) % LAP], part) }
    }

    /// Where the target is after each step of a lap.
    pub fn stops(&self) -> &[Vector2<f64>] {
        &self.stops
    }
}

/// The middle of the region (x, y, m, world frame).
pub fn middle() -> Vector2<f64> {
    let [low, high] = REGION.map(Vector2::from);
    (low + high) * 0.5
}

/// The points in order, each at some distance from the next.
fn knots(rng: &mut Rng) -> [Vector2<f64>; POINTS] {
    let [low, high] = REGION.map(Vector2::from);
    let size = high - low;
    let mut spread = |axis: usize| rng.uniform(-CENTRE_SPREAD, CENTRE_SPREAD) * size[axis];
    let centre = middle() + Vector2::new(spread(0), spread(1));
    // Round the centre: with small x first down along y, then with large x up again.
    let blocks = [
        (Vector2::new(low.x, centre.y), Vector2::new(centre.x, high.y), -Vector2::y()),
        (low, centre, -Vector2::y()),
        (Vector2::new(centre.x, low.y), Vector2::new(high.x, centre.y), Vector2::x()),
        (centre, high, -Vector2::x()),
    ];
    let mut knots = [Vector2::zeros(); POINTS];
    for (points, (low, high, order)) in knots.chunks_exact_mut(BLOCK_POINTS).zip(blocks) {
        points.fill_with(|| Vector2::new(rng.uniform(low.x, high.x), rng.uniform(low.y, high.y)));
        points.sort_unstable_by(|a, b| order.dot(a).total_cmp(&order.dot(b)));
    }
    knots
}

/// Points along the periodic cubic spline through `knots`, the first not repeated.
fn curve(knots: &[Vector2<f64>; POINTS]) -> Vec<Vector2<f64>> {
    let next = |index: usize| (index + 1) % POINTS;
    let chords: [f64; POINTS] =
        std::array::from_fn(|index| (knots[next(index)] - knots[index]).norm().max(1e-6));
    let slope = |index: usize| (knots[next(index)] - knots[index]) / chords[index];
    // The second derivatives at the knots make the first ones continuous.
    let mut system = SMatrix::<f64, POINTS, POINTS>::zeros();
    let mut right = SMatrix::<f64, POINTS, 2>::zeros();
    for index in 0..POINTS {
        let after = next(index);
        system[(index, index)] += 2.0 * chords[index];
        system[(after, after)] += 2.0 * chords[index];
        system[(index, after)] += chords[index];
        system[(after, index)] += chords[index];
        right.set_row(after, &(6.0 * (slope(after) - slope(index))).transpose());
    }
    let bends = Cholesky::new(system).expect("the diagonal dominates").solve(&right);
    let bend = |index: usize| Vector2::new(bends[(index, 0)], bends[(index, 1)]);
    let stretch = |index: usize| {
        let (from, to) = (knots[index], knots[next(index)]);
        let (from_bend, to_bend) = (bend(index), bend(next(index)));
        let sixth = chords[index] * chords[index] / 6.0;
        (0..PARTS).map(move |part| {
            let b = part as f64 / PARTS as f64;
            let a = 1.0 - b;
            from * a + to * b + (from_bend * (a * a * a - a) + to_bend * (b * b * b - b)) * sixth
        })
    };
    (0..POINTS).flat_map(stretch).collect()
}

/// [`LAP`] points that are equally far apart along the closed polygon through `points`.
fn evenly(points: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let sides = || points.iter().zip(points.iter().cycle().skip(1));
    let length: f64 = sides().map(|(from, to)| (to - from).norm()).sum();
    let mut stops = Vec::with_capacity(LAP);
    let mut gone = 0.0;
    for (from, to) in sides() {
        let side = (to - from).norm();
        while stops.len() < LAP && stops.len() as f64 * length / LAP as f64 <= gone + side {
            let rest = stops.len() as f64 * length / LAP as f64 - gone;
            stops.push(from.lerp(to, if side > 0.0 { rest / side } else { 0.0 }));
        }
        gone += side;
    }
    stops.resize(LAP, points[0]); // rounding may have kept back the last
    stops
}

fn in_reach(stop: &Vector2<f64>) -> bool {
    let [low, high] = REGION.map(Vector2::from);
    (0..2).all(|axis| (low[axis] - MARGIN..=high[axis] + MARGIN).contains(&stop[axis]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_moves_at_constant_speed_and_comes_back() {
        for seed in 0..50 {
            let path = Path::draw(&mut Rng::new(seed, 0));
            assert_eq!(path.stops().len(), LAP);
            let steps: Vec<f64> = (0..LAP)
                .map(|step| (path.at(step as f64 + 1.0) - path.at(step as f64)).norm())
                .collect();
            let mean = steps.iter().sum::<f64>() / LAP as f64;
            // A chord is shorter than its arc: by a little, but for the sharpest bends.
            let most = steps.iter().copied().fold(0.0, f64::max);
            let short = steps.iter().filter(|step| **step < 0.98 * mean).count();
            assert!(most < 1.03 * mean && short < LAP / 20, "{seed}: {short} {mean} {most}");
            // 20 s a lap: the speed that the task's description promises.
            assert!((0.09..0.26).contains(&(mean / 0.1)), "{seed}: {mean}");
            assert_eq!(path.at(0.0), path.at(LAP as f64));
            let between = path.at(2.25) - path.at(2.0) - (path.at(3.0) - path.at(2.0)) * 0.25;
            assert!(between.norm() < 1e-12);
        }
    }

    #[test]
    fn the_curve_goes_through_its_points_and_round_a_circle() {
        let on_circle = |part: f64| {
            let angle = part * std::f64::consts::TAU;
            Vector2::new(libm::cos(angle), libm::sin(angle)) * 0.3
        };
        let knots: [_; POINTS] =
            std::array::from_fn(|index| on_circle(index as f64 / POINTS as f64));
        let curve = curve(&knots);
        for (index, point) in curve.iter().enumerate() {
            // A cubic spline through 12 points of a circle is off by 0.02 % of its radius at most,
            // the seam included, where one with other ends would be off by more than 1 %.
            let part = index as f64 / curve.len() as f64;
            assert!((point - on_circle(part)).norm() < 3e-4, "{part}: {point}");
        }
        for (index, knot) in knots.iter().enumerate() {
            assert!((curve[index * PARTS] - knot).norm() < 1e-12);
        }
    }
}
