//! The inputs that are kept: one file for each target, each input behind its length.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Where the inputs of the target `name` are kept.
pub fn file_of(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(format!("{name}.bin"))
}

/// The kept inputs of the target `name`; none where nothing is kept.
pub fn read(name: &str) -> io::Result<Vec<Vec<u8>>> {
    let bytes = match fs::read(file_of(name)) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(vec![]),
        read => read?,
    };
    let mut inputs = vec![];
    let mut rest = bytes.as_slice();
    while let Some((length, later)) = rest.split_first_chunk() {
        let found = later.split_at_checked(u32::from_le_bytes(*length) as usize);
        let (input, later) = found.ok_or(io::ErrorKind::UnexpectedEof)?;
        inputs.push(input.to_vec());
        rest = later;
    }
    if rest.is_empty() { Ok(inputs) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
}

/// Keeps these inputs of the target `name`, each once, short ones first.
pub fn write(name: &str, mut inputs: Vec<Vec<u8>>) -> io::Result<()> {
    inputs.sort_by(|one, other| (one.len(), one).cmp(&(other.len(), other)));
    inputs.dedup();
    let with_length =
        |input: &Vec<u8>| [&(input.len() as u32).to_le_bytes(), input.as_slice()].concat();
    let bytes: Vec<u8> = inputs.iter().flat_map(with_length).collect();
    let path = file_of(name);
    fs::create_dir_all(path.parent().ok_or(io::ErrorKind::NotFound)?)?;
    fs::write(path, bytes)
}
