//! The rows of `domain` for what is wrong with real arms, and what an episode draws of them.
//!
//! | row | what it is | preset `dvrk` |
//! |---|---|---|
//! | `lag_AXIS` | time constant with which the encoder follows its set-point, s | 15 to 54 ms |
//! | `play_JOINT` | half-width of the play between encoder and link, rad or m | 0.2 mm, 1.5°, 8 to 9°, 12.5 to 15° |
//! | `play_weight_JOINT` | the part of the link's motion that has the play | 0.55 to 1.2 |
//! | `gain_JOINT` | what the link moves by for each unit that the encoder does, once the play is taken up | 0.90 to 1 |
//! | `coupling_weight` | what the wrist pitch moves by for each unit that the play of the wrist yaw does | −0.65 |
//! | `coupling_gain_wrist_pitch` | what the wrist pitch moves by for each unit that the encoder of the wrist yaw does, once the play is taken up | 0.12 |
//! | `coupling_gain_wrist_yaw` | what the wrist yaw moves by for each unit that the encoder of the wrist pitch does | 0.2 |
//! | `base_position` | shift of the arm's base along each axis of the scene, m | ±3.5 mm |
//! | `base_angle` | turn of the arm's base about each axis of the scene, rad; the middle of the workspace stays | ±2° |
//!
//! AXIS is `yaw`, `pitch`, `insertion`, `roll`, of a PSM also `wrist_pitch`, `wrist_yaw`, `jaw`; JOINT is one of
//! `insertion`, `roll`, `wrist_pitch`, `wrist_yaw`. Each arm draws its own numbers.
//!
//! Sources of `dvrk`: lags from set-points and encoders of a PSM at 75 to 80 mm/s, published by Johns Hopkins; that of the
//! jaw was not measured, and is that of the wrist. Plays, weights and gains are fits to commanded and optically measured
//! joints (Hwang et al., RA-L 2020). The base errs as registrations do: 2 to 5 mm (SurgCalib; Shademan et al. 2016). Plays
//! of an ECM were not measured, so the preset gives it none; its lags are those of the same joints of a PSM.

use std::collections::BTreeMap;

use trocar_proto::spec::RowSpec;
use trocar_proto::{Options, Rejection};

use super::domain::{Range, range_given, range_row};
use crate::robots::drivetrain::{Backlash, Coupling, MAX_AXES, Transmission};
use crate::sim::frames::{self, Pose};
use crate::sim::random::Rng;

/// The preset with the measured numbers.
pub const DVRK: &str = "dvrk";

/// Joints of an ECM.
const ECM_AXES: usize = 4;

const AXES: [&str; MAX_AXES] =
    ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"];

/// The axes that have a play.
const PLAYING: std::ops::Range<usize> = 2..6;

/// The least and the largest that rows may have: s, rad or m, or ratios. Every combination can be inverted.
const LAG: [f64; 2] = [0.0, 0.1];
const PLAY: [[f64; 2]; 4] = [[0.0, 1e-3], [0.0, 0.05], [0.0, 0.35], [0.0, 0.35]];
const WEIGHT: [f64; 2] = [0.0, 1.2];
const GAIN: [f64; 2] = [0.8, 1.2];
const COUPLING: [[f64; 2]; 3] = [[-0.8, 0.8], [-0.4, 0.4], [-0.4, 0.4]];
const BASE_POSITION: [f64; 2] = [-0.006, 0.006];
const BASE_ANGLE: [f64; 2] = [-0.06, 0.06];

const COUPLING_ROWS: [&str; 3] =
    ["coupling_weight", "coupling_gain_wrist_pitch", "coupling_gain_wrist_yaw"];

/// What [`DVRK`] gives.
mod dvrk {
    const DEGREE: f64 = std::f64::consts::PI / 180.0;
    pub(super) const LAG: [[f64; 2]; 7] = [
        [0.047, 0.051],
        [0.047, 0.051],
        [0.049, 0.054],
        [0.015, 0.015],
        [0.033, 0.036],
        [0.028, 0.028],
        [0.028, 0.036],
    ];
    pub(super) const PLAY: [[f64; 2]; 4] = [
        [0.2e-3, 0.2e-3],
        [1.5 * DEGREE, 1.5 * DEGREE],
        [8.0 * DEGREE, 9.0 * DEGREE],
        [12.5 * DEGREE, 15.0 * DEGREE],
    ];
    pub(super) const WEIGHT: [[f64; 2]; 4] = [[1.1, 1.2], [0.55, 0.55], [0.55, 0.55], [0.62, 0.62]];
    pub(super) const GAIN: [[f64; 2]; 4] = [[1.0, 1.0], [1.0, 1.0], [0.97, 0.97], [0.90, 0.90]];
    pub(super) const COUPLING: [[f64; 2]; 3] = [[-0.65, -0.65], [0.12, 0.12], [0.2, 0.2]];
    pub(super) const BASE_POSITION: [f64; 2] = [-0.0035, 0.0035];
    pub(super) const BASE_ANGLE: [f64; 2] = [-2.0 * DEGREE, 2.0 * DEGREE];
}

/// How far from the middle of the workspace a turn of the base is felt by the arm's reach, m.
const LEVER: f64 = 0.1;

/// The rows of PSMs.
pub fn psm_rows() -> Vec<RowSpec> {
    rows(MAX_AXES)
}

/// The rows of an ECM.
pub fn ecm_rows() -> Vec<RowSpec> {
    rows(ECM_AXES)
}

fn rows(axes: usize) -> Vec<RowSpec> {
    let is_psm = axes > ECM_AXES;
    let row = |name: String, summary: &str, [min, max]: [f64; 2], preset: Option<[f64; 2]>| {
        let presets = preset.map(|range| (DVRK.to_string(), range.to_vec()));
        let presets: BTreeMap<_, _> = presets.into_iter().collect();
        RowSpec { presets, ..range_row(&name, summary, min, max) }
    };
    let mut rows = vec![];
    let lag = "Time constant with which the encoder follows its set-point, s.";
    for (name, preset) in AXES.into_iter().zip(dvrk::LAG).take(axes) {
        rows.push(row(format!("lag_{name}"), lag, LAG, Some(preset)));
    }
    let play = "Half-width of the play between encoder and link, rad; of the insertion m.";
    let weight = "The part of the link's motion that has the play; 1 where none is given.";
    let gain = "What the link moves by for each unit that its encoder does, once the play is taken up; 1 where none \
                is given.";
    for (index, axis) in PLAYING.enumerate().filter(|(_, axis)| *axis < axes) {
        let measured = |of: &[[f64; 2]; 4]| is_psm.then_some(of[index]);
        let name = AXES[axis];
        rows.push(row(format!("play_{name}"), play, PLAY[index], measured(&dvrk::PLAY)));
        rows.push(row(format!("play_weight_{name}"), weight, WEIGHT, measured(&dvrk::WEIGHT)));
        rows.push(row(format!("gain_{name}"), gain, GAIN, measured(&dvrk::GAIN)));
    }
    if is_psm {
        let summaries = [
            "What the wrist pitch moves by for each unit that the play of the wrist yaw does.",
            "What the wrist pitch moves by for each unit that the encoder of the wrist yaw does, once the play is \
             taken up.",
            "What the wrist yaw moves by for each unit that the encoder of the wrist pitch does.",
        ];
        for (index, name) in COUPLING_ROWS.into_iter().enumerate() {
            let preset = Some(dvrk::COUPLING[index]);
            rows.push(row(name.into(), summaries[index], COUPLING[index], preset));
        }
    }
    let position = "Shift of each arm's base along each axis of the scene, m.";
    let angle = "Turn of each arm's base about each axis of the scene, rad, about the middle of its workspace.";
    let (shift, turn) = (Some(dvrk::BASE_POSITION), Some(dvrk::BASE_ANGLE));
    rows.push(row("base_position".into(), position, BASE_POSITION, shift));
    rows.push(row("base_angle".into(), angle, BASE_ANGLE, turn));
    rows
}

/// The ranges of these rows, as far as they are given.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ArmErrors {
    lag: [Option<Range>; MAX_AXES],
    play: [Option<Range>; MAX_AXES],
    weight: [Option<Range>; MAX_AXES],
    gain: [Option<Range>; MAX_AXES],
    coupling: [Option<Range>; 3],
    base_position: Option<Range>,
    base_angle: Option<Range>,
}

impl ArmErrors {
    /// The ranges that resolved options give.
    pub fn of(options: &Options) -> Result<Self, Rejection> {
        let mut errors = Self::default();
        for (axis, name) in AXES.into_iter().enumerate() {
            errors.lag[axis] = range_given(options, &format!("lag_{name}"))?;
            errors.play[axis] = range_given(options, &format!("play_{name}"))?;
            errors.weight[axis] = range_given(options, &format!("play_weight_{name}"))?;
            errors.gain[axis] = range_given(options, &format!("gain_{name}"))?;
        }
        for (range, name) in errors.coupling.iter_mut().zip(COUPLING_ROWS) {
            *range = range_given(options, name)?;
        }
        errors.base_position = range_given(options, "base_position")?;
        errors.base_angle = range_given(options, "base_angle")?;
        Ok(errors)
    }

    /// The transmission of an arm in the episode of `rng`; none where no row of it was given.
    pub fn draw_transmission(&self, rng: &Rng) -> Option<Transmission> {
        let Self { lag, play, weight, gain, coupling, .. } = self;
        let is_given = [lag, play, weight, gain].into_iter().flatten().chain(coupling);
        is_given.flatten().next()?;
        let mut rng = aside(rng, TRANSMISSION);
        // All numbers are drawn, so that a row leaves the others' as they were.
        let mut draw = |range: &Option<Range>, none: f64| {
            let part = rng.unit();
            range.map_or(none, |range| range.at(part))
        };
        let mut transmission = Transmission::default();
        for axis in 0..MAX_AXES {
            transmission.lag[axis] = draw(&lag[axis], 0.0);
            let half_width = draw(&play[axis], 0.0);
            let weight = draw(&weight[axis], 1.0);
            let slope = draw(&gain[axis], 1.0) - weight;
            transmission.backlash[axis] = Backlash { half_width, weight, slope, begin: 0.0 };
        }
        let [pitch_weight, pitch_gain, yaw_slope] = coupling.each_ref().map(|of| draw(of, 0.0));
        let pitch_slope = pitch_gain - pitch_weight;
        transmission.coupling = Coupling { pitch_weight, pitch_slope, yaw_slope };
        for backlash in &mut transmission.backlash {
            backlash.begin = rng.uniform(-1.0, 1.0);
        }
        Some(transmission)
    }

    /// Where the base of an arm is in the episode of `rng`, seen from where it should be in a scene in which `middle`
    /// (m) stays where it is but for the shift; none where neither range was given.
    pub fn draw_base_error(&self, rng: &Rng, middle: [f64; 3]) -> Option<Pose> {
        let ranges = [self.base_position, self.base_angle];
        ranges.iter().flatten().next()?;
        let mut rng = aside(rng, BASE);
        let mut three = |range: Option<Range>| {
            [(); 3].map(|()| rng.unit()).map(|part| range.map_or(0.0, |range| range.at(part)))
        };
        // The turn first, so that it is drawn for a shift of any kind.
        let (turn, shift) = (three(self.base_angle), three(self.base_position));
        let [there, back] = [middle, middle.map(|along| -along)];
        let [there, back] = [there, back].map(|along| frames::pose(along, [0.0; 3]));
        Some(frames::pose(shift, [0.0; 3]) * there * frames::pose([0.0; 3], turn) * back)
    }

    /// How much further than its nominal reach an arm must be let go to come to all of its workspace, m.
    pub fn reach_margin(&self) -> f64 {
        let most = |range: Option<Range>| range.map_or(0.0, |range| range.largest());
        most(self.base_position) + LEVER * most(self.base_angle)
    }
}

/// How many numbers of an episode are drawn aside before those of a base, and before those of a transmission.
const BASE: usize = 32;
const TRANSMISSION: usize = 64;

/// A generator for what arms draw aside, of which others draw the first numbers.
fn aside(rng: &Rng, others: usize) -> Rng {
    let mut rng = rng.aside();
    for _ in 0..others {
        rng.unit();
    }
    rng
}
