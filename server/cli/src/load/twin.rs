//! The same environments in-process, and what every client does in them: what a session must show,
//! bit by bit.

use trocar_client::Reply;
use trocar_proto::columns::{Flag, Width};
use trocar_proto::{Code, Options, TaskSpec, reply_columns};
use trocar_server::Registry;
use trocar_server::{Env, Step, StepError};

/// Environments without a server, which act by themselves: those of even seeds follow the scripted
/// expert, those of odd seeds draw their actions. `worker.py` does the same.
pub(super) struct Twin {
    envs: Vec<Env>,
    seed: u64,
    shown: Shown,
    /// The next actions, row by row.
    actions: Vec<f32>,
    /// One generator for each number of an action.
    draws: Vec<u32>,
}

macro_rules! shown {
    ($($(#[$doc:meta])* $name:ident: $element:ident [$width:ident] $role:tt;)*) => {
        /// The arrays that a reply must have, row by row.
        #[derive(Debug)]
        struct Shown {
            $($name: Vec<$element>,)*
        }

        impl Shown {
            /// Nothing but zeros.
            fn new(rows: usize, spec: &TaskSpec) -> Self {
                Self { $($name: vec![Default::default(); rows * Width::$width.of(spec)],)* }
            }

            /// The first column that has other bits in a reply, and the row.
            fn difference(&self, reply: &Reply, rows: usize) -> Option<(&'static str, usize)> {
                $(if is_compared(stringify!($name))
                    && let Some(row) = unlike(&self.$name, reply.$name(), rows)
                {
                    return Some((stringify!($name), row));
                })*
                None
            }

            /// What the last message did.
            fn transition(&mut self, row: usize, step: &Step, fault: u8) {
                $(trocar_proto::if_step!($role if let Some(number) = self.$name.get_mut(row) {
                    *number = step.$name.into();
                });)*
                self.fault[row] = fault;
            }
        }
    };
}

reply_columns!(shown);

/// Whether a column means something in every reply. Episodes that a step replaced do not occur here.
fn is_compared(column: &str) -> bool {
    !column.starts_with("final_") && column != "snapshot"
}

impl Twin {
    /// Environments of the default options; environment i has seed `seed + i`.
    pub(super) fn new(task: &str, envs: u32, seed: u64) -> anyhow::Result<Self> {
        let first = Registry::builtin().make(task, &Options::new())?;
        let spec = first.spec();
        let rows = envs as usize;
        let shown = Shown::new(rows, spec);
        let (actions, draws) = (shown.expert_action.clone(), vec![0; rows * spec.action_dim()]);
        Ok(Self { envs: vec![first; rows], seed, shown, actions, draws })
    }

    /// Begins the first episode of every environment, as a new session does.
    pub(super) fn reset(&mut self) {
        let dim = self.action_dim();
        for (row, env) in self.envs.iter_mut().enumerate() {
            let seed = self.seed.wrapping_add(row as u64);
            env.reset(Some(seed));
            self.shown.transition(row, &Step::default(), 0);
            self.shown.state(row, env);
            for (column, draw) in self.draws[row * dim..(row + 1) * dim].iter_mut().enumerate() {
                // A multiplier of Knuth's, so that neighbours begin far apart.
                *draw = (seed as u32).wrapping_mul(2_654_435_761).wrapping_add(column as u32);
            }
        }
        self.act();
    }

    /// Steps every environment with [`Self::actions`]; one whose episode has ended is reset instead.
    pub(super) fn step(&mut self) -> anyhow::Result<()> {
        let dim = self.action_dim();
        for (row, env) in self.envs.iter_mut().enumerate() {
            if env.needs_reset() {
                env.reset(None);
                self.shown.transition(row, &Step::default(), 0);
            } else {
                match env.step(&self.actions[row * dim..(row + 1) * dim]) {
                    Ok(step) => self.shown.transition(row, &step, 0),
                    Err(StepError::Simulation { .. }) => {
                        let step = Step { truncated: true, ..Step::default() };
                        self.shown.transition(row, &step, Code::Simulation as u8);
                    }
                    Err(error) => return Err(error.into()),
                }
            }
            self.shown.state(row, env);
        }
        self.act();
        Ok(())
    }

    /// The actions of the next step: (envs, action dim).
    pub(super) fn actions(&self) -> &[f32] {
        &self.actions
    }

    /// The column of a reply that is not what the twin shows, and where.
    pub(super) fn difference(&self, reply: &Reply) -> Option<String> {
        let (column, row) = self.shown.difference(reply, self.envs.len())?;
        let (seed, step) = (self.shown.seed[row], self.shown.steps[row]);
        Some(format!("{column} of the environment of seed {seed} at step {step} differs"))
    }

    /// The checksum of all that was shown so far, where `before` is that of all but the latest.
    pub(super) fn checksum(&self, before: u32) -> u32 {
        let Shown { observation, achieved_goal, desired_goal, reward, .. } = &self.shown;
        let floats = [observation, achieved_goal, desired_goal, reward, &self.shown.expert_action];
        let checksum = floats.into_iter().fold(before, |checksum, array| {
            array.iter().fold(checksum, |checksum, number| crc32(checksum, &number.to_le_bytes()))
        });
        crc32(crc32(checksum, &self.shown.terminated), &self.shown.truncated)
    }

    fn action_dim(&self) -> usize {
        self.actions.len() / self.envs.len()
    }

    /// Chooses the next actions.
    fn act(&mut self) {
        let dim = self.action_dim();
        for row in 0..self.envs.len() {
            let cells = row * dim..(row + 1) * dim;
            let follows = self.seed.wrapping_add(row as u64).is_multiple_of(2);
            if follows {
                self.actions[cells.clone()].copy_from_slice(&self.shown.expert_action[cells]);
                continue;
            }
            for (action, draw) in self.actions[cells.clone()].iter_mut().zip(&mut self.draws[cells])
            {
                // Numerical Recipes' generator; all arithmetic is exact, in numpy too.
                *draw = draw.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *action = (*draw >> 8) as f32 / (1 << 23) as f32 - 1.0;
            }
        }
    }
}

impl Shown {
    /// Where it led.
    fn state(&mut self, row: usize, env: &Env) {
        fn cells(array: &mut [f32], row: usize, width: usize) -> &mut [f32] {
            &mut array[row * width..(row + 1) * width]
        }
        let spec = env.spec();
        let goal = spec.goal_dim();
        env.observe(
            cells(&mut self.observation, row, spec.observation_dim()),
            cells(&mut self.achieved_goal, row, goal),
            cells(&mut self.desired_goal, row, goal),
        );
        env.expert(cells(&mut self.expert_action, row, spec.action_dim()));
        self.expert_stage[row] = env.stage() as u8;
        self.steps[row] = env.steps();
        self.seed[row] = env.seed();
        self.episode[row] = env.episode();
    }
}

/// The first of `rows` rows in which two arrays are not the same bits.
fn unlike<T: Bits>(expected: &[T], found: &[T], rows: usize) -> Option<usize> {
    if expected.len() != found.len() {
        return Some(0);
    }
    let index = expected.iter().zip(found).position(|(a, b)| a.bits() != b.bits())?;
    Some(index * rows / expected.len())
}

/// A number as the bits it has in memory: −0 is not 0.
trait Bits: Copy {
    fn bits(self) -> u64;
}

impl Bits for f32 {
    fn bits(self) -> u64 {
        self.to_bits().into()
    }
}

impl Bits for u8 {
    fn bits(self) -> u64 {
        self.into()
    }
}

impl Bits for i32 {
    fn bits(self) -> u64 {
        u32::from_ne_bytes(self.to_ne_bytes()).into()
    }
}

impl Bits for u32 {
    fn bits(self) -> u64 {
        self.into()
    }
}

impl Bits for u64 {
    fn bits(self) -> u64 {
        self
    }
}

/// The checksum that Python has as `zlib.crc32(bytes, before)`.
fn crc32(before: u32, bytes: &[u8]) -> u32 {
    /// The polynomial of IEEE 802.3, its lowest power first.
    const POLYNOMIAL: u32 = 0xedb8_8320;
    !bytes.iter().fold(!before, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 { crc >> 1 ^ POLYNOMIAL } else { crc >> 1 }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_zlib() {
        // The check value of every table of CRCs, and the same in two parts.
        assert_eq!(crc32(0, b"123456789"), 0xcbf4_3926);
        assert_eq!(crc32(crc32(0, b"1234"), b"56789"), 0xcbf4_3926);
    }

    #[test]
    fn twins_agree_and_a_changed_bit_is_seen() {
        let run = |seed: u64| {
            let mut twin = Twin::new("EcmReach-v0", 2, seed).unwrap();
            twin.reset();
            let mut checksum = twin.checksum(0);
            // Past the end of an episode.
            for _ in 0..60 {
                twin.step().unwrap();
                checksum = twin.checksum(checksum);
            }
            (twin, checksum)
        };
        let (mut twin, checksum) = run(4);
        assert_eq!(checksum, run(4).1);
        assert_ne!(checksum, run(5).1);
        let before = twin.checksum(0);
        let bits = twin.shown.observation[3].to_bits() ^ 1;
        twin.shown.observation[3] = f32::from_bits(bits);
        assert_ne!(twin.checksum(0), before);
    }

    #[test]
    fn the_row_of_a_difference_is_named() {
        assert_eq!(unlike(&[1.0_f32, 2.0, 3.0, 4.0], &[1.0, 2.0, 3.0, 4.0], 2), None);
        assert_eq!(unlike(&[1.0_f32, 2.0, 3.0, 4.0], &[1.0, 2.0, 3.5, 4.0], 2), Some(1));
        assert_eq!(unlike(&[0.0_f32, 2.0], &[-0.0, 2.0], 2), Some(0));
    }
}
