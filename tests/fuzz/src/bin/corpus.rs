//! Kept inputs and folders of libFuzzer: `corpus unpack TARGET FOLDER` writes a file for every input and seed,
//! `corpus pack TARGET FOLDER` keeps what the folder has.

use std::path::PathBuf;
use std::process::ExitCode;
use std::{env, fs, io};

use trocar_fuzz::{Target, corpus};

fn main() -> io::Result<ExitCode> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [what, name, folder] = arguments.as_slice() else {
        eprintln!("corpus unpack|pack TARGET FOLDER");
        return Ok(ExitCode::from(2));
    };
    let (target, folder) = (Target::named(name), PathBuf::from(folder));
    if what == "unpack" {
        fs::create_dir_all(&folder)?;
        let inputs = corpus::read(name)?.into_iter().chain((target.seeds)());
        for (number, input) in inputs.enumerate() {
            fs::write(folder.join(format!("{number:05}")), input)?;
        }
    } else {
        let inputs = fs::read_dir(&folder)?.map(|entry| fs::read(entry?.path()));
        corpus::write(name, inputs.collect::<io::Result<_>>()?)?;
    }
    Ok(ExitCode::SUCCESS)
}
