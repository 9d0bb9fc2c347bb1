//! Random actions, drawn before they are needed: the same in every mode that is measured.

use std::path::{Path, PathBuf};

use anyhow::Context;
use trocar_server::sim::random::Rng;

/// How many actions of single environments there are, unless that makes fewer than [`LEAST`] rounds.
const ACTIONS: usize = 65_536;
const LEAST: usize = 64;

/// Uniformly random actions: (rounds, environments, action dim). After the last round comes the first.
#[derive(Debug)]
pub(super) struct Pool {
    values: Vec<f32>,
    /// Numbers of one round.
    width: usize,
}

impl Pool {
    pub(super) fn new(envs: u32, action_dim: usize) -> Self {
        let envs = envs as usize;
        let width = envs * action_dim;
        // No environment has the randomness of this episode.
        let mut rng = Rng::new(0, u64::MAX);
        let count = (ACTIONS / envs).max(LEAST) * width;
        Self { values: (0..count).map(|_| rng.uniform(-1.0, 1.0) as f32).collect(), width }
    }

    /// The actions of a round: (environments, action dim).
    pub(super) fn round(&self, round: usize) -> &[f32] {
        let rounds = self.values.len() / self.width;
        &self.values[round % rounds * self.width..][..self.width]
    }

    /// Writes all of them to a file, which ends with what is returned.
    pub(super) fn write(&self) -> anyhow::Result<PoolFile> {
        let path = std::env::temp_dir().join(format!("trocar-bench-{}", std::process::id()));
        let file = PoolFile(path);
        let bytes: Vec<u8> = self.values.iter().flat_map(|value| value.to_ne_bytes()).collect();
        std::fs::write(&file.0, bytes).with_context(|| file.0.display().to_string())?;
        Ok(file)
    }
}

/// A file of actions; removed when this is dropped.
#[derive(Debug)]
pub(super) struct PoolFile(PathBuf);

impl PoolFile {
    pub(super) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for PoolFile {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounds_come_again_and_are_what_the_file_holds() {
        let pool = Pool::new(1000, 5);
        assert_eq!(pool.values.len(), 65 * 5000);
        assert_eq!(pool.round(3), pool.round(68));
        assert_ne!(pool.round(3), pool.round(4));
        assert!(pool.values.iter().all(|value| (-1.0..1.0).contains(value)));
        let file = pool.write().unwrap();
        let (path, bytes) = (file.path().to_path_buf(), std::fs::read(file.path()).unwrap());
        let first: Vec<f32> = bytes[..20_000]
            .chunks(4)
            .map(|bytes| f32::from_ne_bytes(bytes.try_into().unwrap()))
            .collect();
        assert_eq!(first, pool.round(0));
        drop(file);
        assert!(!path.exists());
    }
}
