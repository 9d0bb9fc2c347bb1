//! What lies between an arm's set-points, its encoders and its links.
//!
//! On a perfect arm all three are the same. On a real one an error of homing is between encoders and links to begin
//! with, and a [`Transmission`] of cables besides:
//!
//! - **Lag**: each encoder follows its set-point as a first-order system, T dq/dt = s − q.
//! - **Backlash**: a play of half-width r follows an encoder where that pushes it, p ← min(max(p, q − r), q + r). A link is
//!   the sum of slope × q and weight × p. An instrument's wrist links are also moved by each other's motors.
//!
//! Source of the form: fits to optically measured recordings of a PSM (Hwang et al., "Efficiently Calibrating Cable-Driven
//! Surgical Robots With RGBD Fiducial Sensing", RA-L 2020). Encoders less links of the wrist have a standard deviation of
//! 8° to 10° there; 2° to 4° of it are left.

use std::sync::Arc;

use arrayvec::ArrayVec;

/// Most axes of an arm: six joints and a jaw.
pub const MAX_AXES: usize = 7;

/// One number for each axis, rad or m, or their derivatives.
pub type Axes = ArrayVec<f64, MAX_AXES>;

/// The axes of a PSM's wrist: pitch and yaw.
const WRIST: [usize; 2] = [4, 5];

/// How near to its set-point an encoder is there, rad or m.
const THERE: f64 = 1e-9;

/// The drivetrain of one arm, and where it is. A clone of it goes on as it does.
#[derive(Debug, Clone, PartialEq)]
pub struct Drivetrain {
    /// What each link really is, less what its encoder says, rad or m.
    offsets: Axes,
    transmission: Option<(Arc<Transmission>, State)>,
}

/// What cables do between motors and links, for each axis: of PSMs the six joints and the jaw, of ECMs four joints.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Transmission {
    /// Time constants with which encoders follow their set-points, s.
    pub lag: [f64; MAX_AXES],
    /// How encoders move links.
    pub backlash: [Backlash; MAX_AXES],
    /// How the wrist's links are moved by each other's motors.
    pub coupling: Coupling,
}

/// How an encoder moves its link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Backlash {
    /// Half-width of the play, rad or m.
    pub half_width: f64,
    /// What the link moves by for each unit that the play does.
    pub weight: f64,
    /// What the link moves by for each unit that the encoder does, besides.
    pub slope: f64,
    /// Where in its play the link begins, −1 to 1 half-widths.
    pub begin: f64,
}

impl Default for Backlash {
    /// None: the link is where the encoder is.
    fn default() -> Self {
        Self { half_width: 0.0, weight: 1.0, slope: 0.0, begin: 0.0 }
    }
}

/// How the motors of wrist pitch and wrist yaw move each other's link.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Coupling {
    /// What the pitch link moves by for each unit that the yaw's play does.
    pub pitch_weight: f64,
    /// What the pitch link moves by for each unit that the yaw's encoder does, besides.
    pub pitch_slope: f64,
    /// What the yaw link moves by for each unit that the pitch's encoder does.
    pub yaw_slope: f64,
}

/// Where a transmission is.
#[derive(Debug, Clone, Default, PartialEq)]
struct State {
    encoders: Axes,
    plays: Axes,
}

impl Drivetrain {
    /// One of links that are where their encoders say, but for these offsets, rad or m: an error of homing.
    pub fn new(offsets: impl IntoIterator<Item = f64>) -> Self {
        Self { offsets: offsets.into_iter().collect(), transmission: None }
    }

    /// The same with a transmission, at rest where the encoders say `encoders`. There the links would be where they are
    /// without it if all plays were in their middle: an arm is calibrated where it works.
    #[must_use]
    pub fn with_transmission(self, transmission: Transmission, encoders: &[f64]) -> Self {
        let middle = State {
            encoders: encoders.iter().copied().collect(),
            plays: encoders.iter().copied().collect(),
        };
        let there = middle.links(&transmission, &self.offsets);
        let without = self.offset(encoders);
        let offsets = self.offsets.iter().zip(without.iter().zip(&there));
        let offsets = offsets.map(|(offset, (without, there))| offset + (without - there));
        let begin =
            |(encoder, backlash): (&f64, &Backlash)| encoder + backlash.begin * backlash.half_width;
        let plays = encoders.iter().zip(&transmission.backlash).map(begin).collect();
        let state = State { encoders: encoders.iter().copied().collect(), plays };
        Self { offsets: offsets.collect(), transmission: Some((Arc::new(transmission), state)) }
    }

    /// Brings the encoders here while something holds the links there, rad or m, as far as the plays allow.
    pub fn load(&mut self, encoders: &[f64], links: &[f64]) {
        let Some((transmission, state)) = &mut self.transmission else { return };
        state.encoders.clone_from(&encoders.iter().copied().collect());
        state.plays.clone_from(&state.encoders);
        // The play of the wrist's yaw moves its pitch, so the last axes come first.
        for axis in (0..state.plays.len()).rev() {
            let Backlash { half_width, weight, .. } = transmission.backlash[axis];
            let missing = links[axis] - state.links(transmission, &self.offsets)[axis];
            if weight > 0.0 {
                state.plays[axis] += (missing / weight).clamp(-half_width, half_width);
            }
        }
    }

    /// Brings the encoders here, rad or m; plays move along.
    pub fn displace_to(&mut self, encoders: &[f64]) {
        let Some((_, state)) = &mut self.transmission else { return };
        for ((encoder, play), to) in state.encoders.iter_mut().zip(&mut state.plays).zip(encoders) {
            *play += to - *encoder;
            *encoder = *to;
        }
    }

    /// Whether there is a transmission.
    pub fn gives(&self) -> bool {
        self.transmission.is_some()
    }

    /// Whether links are elsewhere than their encoders say.
    pub fn errs(&self) -> bool {
        self.gives() || self.offsets.iter().any(|offset| *offset != 0.0)
    }

    /// Lets `seconds` pass in which the motors are told these set-points; returns what the encoders then say, and where
    /// the links are.
    pub fn advance(&mut self, set_points: &[f64], seconds: f64) -> [Axes; 2] {
        if let Some((transmission, state)) = &mut self.transmission {
            state.advance(transmission, set_points, seconds);
            return [state.encoders.clone(), self.links()];
        }
        [set_points.iter().copied().collect(), self.offset(set_points)]
    }

    /// Lets the motors come to rest at these set-points, to which they go straight.
    pub fn settle(&mut self, set_points: &[f64]) {
        if let Some((transmission, state)) = &mut self.transmission {
            state.settle(transmission, set_points);
        }
    }

    /// Where the links would be if the motors went straight to these set-points, of all axes or of the first `N`, and
    /// came to rest there.
    ///
    /// # Panics
    /// Where there are fewer axes.
    pub fn settled<const N: usize>(&self, set_points: &[f64; N]) -> [f64; N] {
        let Some((transmission, state)) = &self.transmission else {
            return std::array::from_fn(|axis| set_points[axis] + self.offsets[axis]);
        };
        let mut state = state.clone();
        state.settle(transmission, set_points);
        let links = state.links(transmission, &self.offsets);
        std::array::from_fn(|axis| links[axis])
    }

    /// Where links are whose encoders say this, without a transmission.
    fn offset(&self, encoders: &[f64]) -> Axes {
        encoders.iter().zip(&self.offsets).map(|(encoder, offset)| encoder + offset).collect()
    }

    /// What the encoders say now.
    ///
    /// # Panics
    /// Where there is no transmission: then they say what set-points do.
    pub fn present(&self) -> &[f64] {
        &self.transmission.as_ref().expect("it has a state").1.encoders
    }

    /// Where the links are now.
    ///
    /// # Panics
    /// Where there is no transmission: then links are where set-points say.
    fn links(&self) -> Axes {
        let (transmission, state) = self.transmission.as_ref().expect("it has a state");
        state.links(transmission, &self.offsets)
    }

    /// What the encoders say of links that something holds here, rad or m.
    pub fn encoders(&self, links: &[f64]) -> Axes {
        let Some((transmission, state)) = &self.transmission else {
            return links.iter().zip(&self.offsets).map(|(link, offset)| link - offset).collect();
        };
        let moved = transmission.motion(links, &self.links());
        state.encoders.iter().zip(moved).map(|(encoder, by)| encoder + by).collect()
    }

    /// Brings links and encoders to where something holds the links, rad or m; the plays are as they were.
    pub fn displace(&mut self, links: &[f64]) {
        let Some(from) = self.gives().then(|| self.links()) else { return };
        let Some((transmission, state)) = &mut self.transmission else { return };
        let moved = transmission.motion(links, &from);
        for ((encoder, play), by) in state.encoders.iter_mut().zip(&mut state.plays).zip(moved) {
            *encoder += by;
            *play += by;
        }
    }
}

impl Transmission {
    /// How far the encoders go while the links go from one place to another, and plays go along.
    fn motion(&self, to: &[f64], from: &[f64]) -> Axes {
        let total = |axis: usize| self.backlash[axis].weight + self.backlash[axis].slope;
        let way: Axes = to.iter().zip(from).map(|(to, from)| to - from).collect();
        let mut moved: Axes = way.iter().enumerate().map(|(axis, by)| by / total(axis)).collect();
        let [pitch, yaw] = WRIST;
        if way.len() > yaw {
            let Coupling { pitch_weight, pitch_slope, yaw_slope } = self.coupling;
            let (own, other) =
                ([total(pitch), total(yaw)], [pitch_weight + pitch_slope, yaw_slope]);
            let determinant = own[0] * own[1] - other[0] * other[1];
            moved[pitch] = (own[1] * way[pitch] - other[0] * way[yaw]) / determinant;
            moved[yaw] = (own[0] * way[yaw] - other[1] * way[pitch]) / determinant;
        }
        moved
    }
}

impl State {
    fn advance(&mut self, transmission: &Transmission, set_points: &[f64], seconds: f64) {
        let encoders = self.encoders.iter().zip(set_points).zip(&transmission.lag);
        let follow = |((encoder, set_point), lag): ((&f64, &f64), &f64)| {
            // Backward Euler: a ramp is followed exactly the lag late.
            let next = encoder + (set_point - encoder) * (seconds / (lag + seconds));
            if *lag == 0.0 || (set_point - next).abs() < THERE { *set_point } else { next }
        };
        let encoders: Axes = encoders.map(follow).collect();
        self.settle(transmission, &encoders);
    }

    fn settle(&mut self, transmission: &Transmission, encoders: &[f64]) {
        let axes = self.encoders.iter_mut().zip(&mut self.plays).zip(&transmission.backlash);
        for (((encoder, play), backlash), to) in axes.zip(encoders) {
            *encoder = *to;
            *play = play.max(to - backlash.half_width).min(to + backlash.half_width);
        }
    }

    fn links(&self, transmission: &Transmission, offsets: &[f64]) -> Axes {
        let axes = self.encoders.iter().zip(&self.plays).zip(&transmission.backlash).zip(offsets);
        let mut links: Axes = axes
            .map(|(((encoder, play), backlash), offset)| {
                backlash.slope * encoder + backlash.weight * play + offset
            })
            .collect();
        let [pitch, yaw] = WRIST;
        if links.len() > yaw {
            let Coupling { pitch_weight, pitch_slope, yaw_slope } = transmission.coupling;
            links[pitch] += pitch_slope * self.encoders[yaw] + pitch_weight * self.plays[yaw];
            links[yaw] += yaw_slope * self.encoders[pitch];
        }
        links
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: f64 = 1.0 / 240.0;

    /// One axis with a lag of 50 ms and a play of 0.1 with weight 0.6 and slope 0.4.
    fn axis(begin: f64) -> Drivetrain {
        let mut transmission = Transmission::default();
        transmission.lag[0] = 0.05;
        transmission.backlash[0] = Backlash { half_width: 0.1, weight: 0.6, slope: 0.4, begin };
        Drivetrain::new([0.01]).with_transmission(transmission, &[0.0])
    }

    #[test]
    fn a_ramp_is_followed_its_lag_late_and_a_jump_exponentially() {
        let mut arm = axis(0.0);
        let mut encoder = 0.0;
        for tick in 1..=240 {
            encoder = arm.advance(&[f64::from(tick) * TICK], TICK)[0][0];
        }
        assert!((encoder - (1.0 - 0.05)).abs() < 1e-8, "{encoder}");
        let mut arm = axis(0.0);
        for tick in 1..=480 {
            encoder = arm.advance(&[1.0], TICK)[0][0];
            let exact = 1.0 - libm::exp(-f64::from(tick) * TICK / 0.05);
            assert!((encoder - exact).abs() < 0.05, "{tick}: {encoder} {exact}");
        }
        for _ in 0..480 {
            encoder = arm.advance(&[1.0], TICK)[0][0];
        }
        assert_eq!(encoder.to_bits(), 1.0_f64.to_bits(), "it comes to rest");
    }

    #[test]
    fn a_link_turns_back_only_when_its_play_is_taken_up() {
        let mut arm = axis(0.0);
        let mut link = |to: f64| {
            arm.settle(&[to]);
            arm.settled(&[to])[0] - 0.01
        };
        let near = |is: f64, should: f64| assert!((is - should).abs() < 1e-12, "{is} {should}");
        near(link(0.05), 0.4 * 0.05);
        near(link(1.0), 0.4 + 0.6 * 0.9);
        near(link(0.9), 0.4 * 0.9 + 0.6 * 0.9);
        near(link(0.8), 0.4 * 0.8 + 0.6 * 0.9);
        near(link(0.0), 0.6 * 0.1);
        near(axis(-1.0).settled(&[0.0])[0], 0.01 - 0.06);
    }

    #[test]
    fn links_that_are_held_move_the_encoders_that_are_coupled_to_them() {
        let mut transmission = Transmission::default();
        transmission.backlash[4] =
            Backlash { half_width: 0.15, weight: 0.55, slope: 0.42, begin: 0.3 };
        transmission.backlash[5] =
            Backlash { half_width: 0.25, weight: 0.62, slope: 0.28, begin: -0.7 };
        transmission.coupling = Coupling { pitch_weight: -0.65, pitch_slope: 0.77, yaw_slope: 0.2 };
        let there = [0.1, 0.2, 0.15, 0.3, -0.4, 0.5, 0.6];
        let mut arm = Drivetrain::new([0.0; 7]).with_transmission(transmission, &there);
        let links = arm.settled(&there);
        // The wrist is off by where its plays begin, and by nothing else.
        let begin = [0.55 * 0.3 * 0.15 + 0.65 * 0.7 * 0.25, -0.62 * 0.7 * 0.25];
        assert!((links[4] - there[4] - begin[0]).abs() < 1e-12);
        assert!((links[5] - there[5] - begin[1]).abs() < 1e-12);
        assert!(links[..4] == there[..4] && links[6] == there[6]);
        let held: Axes = links.iter().map(|link| link + 0.02).collect();
        let encoders = arm.encoders(&held).into_inner().expect("one for each axis");
        arm.displace(&held);
        let is = arm.settled(&encoders);
        for (is, held) in is.iter().zip(&held) {
            assert!((is - held).abs() < 1e-12, "{is} {held}");
        }
        assert!((encoders[4] + 0.4 - 0.02).abs() > 1e-3, "pitch and yaw move each other");
    }
}
