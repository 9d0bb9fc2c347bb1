//! Moving pictures: as long as the episode at every rate, and the same of a recording.

use std::fs::File;
use std::path::PathBuf;
use std::process::Command;

fn scratch(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("films-{name}"))
}

fn trocar(arguments: &[&str]) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
    command.args(arguments).env_remove("TROCAR_SERVER").env("TROCAR_LOG", "warn");
    let output = command.output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// Pictures of a film, and how long it is, in 1/100 s.
fn length(path: &PathBuf) -> (usize, u32) {
    let mut decoder = gif::DecodeOptions::new().read_info(File::open(path).unwrap()).unwrap();
    let (mut pictures, mut centiseconds) = (0, 0);
    while let Some(frame) = decoder.next_frame_info().unwrap() {
        pictures += 1;
        centiseconds += u32::from(frame.delay);
    }
    (pictures, centiseconds)
}

#[test]
fn a_film_is_as_long_as_the_episode_at_every_rate() {
    let path = scratch("rate.gif");
    let file = path.to_str().unwrap();
    let look = ["--camera", "endoscope", "--size", "64x48", "--out", file];
    let common = [&["render", "--task", "NeedlePick-v0", "--policy", "random"], &look[..]].concat();
    let centiseconds = |more: &[&str], most: usize| {
        trocar(&[&common[..], more].concat());
        let (pictures, centiseconds) = length(&path);
        // Pictures that are the same are one.
        assert!((most / 2..=most).contains(&pictures), "{more:?}: {pictures} pictures");
        centiseconds
    };
    // 10 s; the last picture is shown as long as the others.
    assert_eq!(centiseconds(&[], 251), 1004);
    assert_eq!(centiseconds(&["--option", "rate=20"], 251), 1004);
    assert_eq!(centiseconds(&["--option", "rate=30", "--fps", "10"], 101), 1010);
}

#[test]
fn a_recording_gives_the_film_of_its_episode() {
    let [recording, one, other] = ["same.trocar", "same.gif", "again.gif"].map(scratch);
    let [recording, one_file, other_file] =
        [&recording, &one, &other].map(|path| path.to_str().unwrap());
    let task =
        ["--task", "ActiveTrack-v0", "--seed", "5", "--option", "domain.latency_seconds=0.04,0.04"];
    let look = ["--size", "64x48", "--camera", "overview", "--fps", "20"];
    trocar(&[&["record", "--out", recording], &task[..]].concat());
    trocar(&[&["replay", recording, "--out", other_file], &look[..]].concat());
    trocar(&[&["render", "--out", one_file], &task[..], &look[..]].concat());
    assert!(std::fs::read(one).unwrap() == std::fs::read(other).unwrap());
}
