//! Output of the commands: JSON lines on stdout, tables on stderr or stdout.

use std::fs::OpenOptions;
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::time::Duration;

use comfy_table::{CellAlignment, ContentArrangement, Table, presets};
use serde::Serialize;

use crate::exit::Exit;

/// Width of tables in a log, characters.
const LOG_WIDTH: u16 = 120;

/// Writes one JSON object as a line on stdout.
pub(crate) fn json_line(object: &impl Serialize) -> anyhow::Result<()> {
    let mut stdout = io::stdout().lock();
    serde_json::to_writer(&mut stdout, object).map_err(io::Error::from)?;
    writeln!(stdout)?;
    stdout.flush()?;
    Ok(())
}

/// Checks that the file of `--out`, if there is one, can be written, and leaves its path unchanged.
pub(crate) fn check_file(out: Option<&Path>) -> anyhow::Result<()> {
    let check = |path: &Path| -> io::Result<()> {
        let is_new = !path.try_exists()?;
        OpenOptions::new().append(true).create(true).open(path)?;
        if is_new { std::fs::remove_file(path) } else { Ok(()) }
    };
    let Some(path) = out else { return Ok(()) };
    check(path).map_err(|error| Exit::Usage(format!("--out {}: {error}", path.display())).into())
}

/// An empty table; columns from `first_number` on hold numbers and are aligned to the right.
pub(crate) fn table(header: &[&str], first_number: usize) -> Table {
    let mut table = plain_table(header, io::stderr().is_terminal(), first_number);
    table.use_stderr();
    table
}

/// The same for stdout.
pub(crate) fn stdout_table(header: &[&str], first_number: usize) -> Table {
    plain_table(header, io::stdout().is_terminal(), first_number)
}

fn plain_table(header: &[&str], is_terminal: bool, first_number: usize) -> Table {
    let mut table = Table::new();
    table
        .load_preset(presets::UTF8_BORDERS_ONLY)
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_header(header);
    if !is_terminal {
        table.set_width(LOG_WIDTH);
    }
    for column in table.column_iter_mut().skip(first_number) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

/// A share in per cent, or a dash.
pub(crate) fn percent(share: Option<f64>) -> String {
    share.map_or("–".into(), |share| format!("{:.1} %", 100.0 * share))
}

/// A length of time in the two largest units that matter.
pub(crate) fn duration(time: Duration) -> String {
    let seconds = time.as_secs();
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
        3600..86_400 => format!("{} h {} min", seconds / 3600, seconds / 60 % 60),
        _ => format!("{} d {} h", seconds / 86_400, seconds / 3600 % 24),
    }
}

/// A number of bytes in mebibytes.
pub(crate) fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_shares_read_well() {
        assert_eq!(duration(Duration::from_secs(59)), "59 s");
        assert_eq!(duration(Duration::from_secs(61)), "1 min 1 s");
        assert_eq!(duration(Duration::from_mins(121)), "2 h 1 min");
        assert_eq!(duration(Duration::from_hours(25)), "1 d 1 h");
        assert_eq!(percent(Some(0.995)), "99.5 %");
        assert_eq!(percent(None), "–");
    }
}
