//! The inputs that are kept in `corpus/`: for each target one file with those that reach the most code, each behind
//! its length, and beside it files `TARGET-WHAT.bin`, each an input with which something went wrong once.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

fn packed(name: &str) -> PathBuf {
    folder().join(format!("{name}.bin"))
}

/// The kept inputs of the target `name`.
pub fn read(name: &str) -> io::Result<Vec<Vec<u8>>> {
    let mut inputs = match fs::read(packed(name)) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => vec![],
        bytes => unpack(&bytes?)?,
    };
    let mut paths = vec![];
    for entry in fs::read_dir(folder())? {
        let path = entry?.path();
        let file = path.file_name().and_then(|file| file.to_str()).unwrap_or_default();
        if file.split_once('-').is_some_and(|(target, _)| target == name) {
            paths.push(path);
        }
    }
    paths.sort();
    for path in paths {
        inputs.push(fs::read(path)?);
    }
    Ok(inputs)
}

fn unpack(bytes: &[u8]) -> io::Result<Vec<Vec<u8>>> {
    let mut inputs = vec![];
    let mut rest = bytes;
    while let Some((length, later)) = rest.split_first_chunk() {
        let found = later.split_at_checked(u32::from_le_bytes(*length) as usize);
        let (input, later) = found.ok_or(io::ErrorKind::UnexpectedEof)?;
        inputs.push(input.to_vec());
        rest = later;
    }
    if rest.is_empty() { Ok(inputs) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

/// Keeps these inputs of the target `name`, each once, short ones first, and what once went wrong.
pub fn write(name: &str, mut inputs: Vec<Vec<u8>>) -> io::Result<()> {
    inputs.sort_by(|one, other| (one.len(), one).cmp(&(other.len(), other)));
    inputs.dedup();
    let with_length =
        |input: &Vec<u8>| [&(input.len() as u32).to_le_bytes(), input.as_slice()].concat();
    fs::write(packed(name), inputs.iter().flat_map(with_length).collect::<Vec<_>>())
}
