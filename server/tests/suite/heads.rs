//! The tables in the heads of the tasks' files are what the fields of their states are.

use std::f64::consts::PI;
use std::path::Path;

use trocar_proto::Options;
use trocar_proto::spec::Element;
use trocar_server::Registry;

/// A row of a table: which fields, their ranges, their unit.
struct Row {
    fields: std::ops::RangeInclusive<usize>,
    ends: [Vec<f64>; 2],
    unit: String,
}

/// The rows below a heading of the head of a task's file, but those that have no range of their own.
fn rows(task: &str, heading: &str) -> Vec<Row> {
    let (name, _) = task.split_once("-v").unwrap();
    let mut file = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !file.is_empty() {
            file.push('_');
        }
        file.extend(letter.to_lowercase());
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("src/tasks/{file}.rs"));
    let text = std::fs::read_to_string(&path)
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let section = text.split(&format!("//! # {heading}\n")).nth(1).unwrap();
    let section = section.split("//! # ").next().unwrap();
    let table = section.lines().filter_map(|line| line.strip_prefix("//! | "));
    let row = |line: &str| {
        let cells: Vec<_> = line.trim_end_matches(" |").split(" | ").map(str::trim).collect();
        let [numbers, _, least, most, unit] = cells[..] else { return None };
        let (first, last) = numbers.split_once('–').unwrap_or((numbers, numbers));
        let fields = first.parse().ok()?..=last.parse().ok()?;
        let ends = [least, most].map(|cell| cell.split(", ").map(number).collect());
        Some(Row { fields, ends, unit: unit.into() })
    };
    table.filter_map(row).collect()
}

fn number(text: &str) -> f64 {
    let text = text.replace('−', "-");
    let sign = if text.starts_with('-') { -1.0 } else { 1.0 };
    match text.trim_start_matches('-') {
        "π" => sign * PI,
        "π/2" => sign * PI / 2.0,
        digits => sign * digits.parse::<f64>().unwrap_or_else(|_| panic!("{text:?} is no number")),
    }
}

#[test]
fn the_heads_of_tasks_have_the_ranges_and_units_of_the_state() {
    for task in Registry::builtin().ids() {
        let spec = Registry::builtin().spec(task, &Options::new()).unwrap();
        let rows = rows(task, "Observation Space");
        assert!(rows.len() > 5, "{task}: {} rows", rows.len());
        for Row { fields, ends, unit } in rows {
            let count = fields.clone().count();
            for (index, field) in fields.clone().enumerate() {
                let Element { name, min, max, unit: own, .. } = &spec.observation[field];
                for (numbers, own) in ends.iter().zip([min, max]) {
                    assert!([1, count].contains(&numbers.len()), "{task}, {fields:?}: {numbers:?}");
                    let number = numbers[index % numbers.len()];
                    let off = (number - f64::from(*own)).abs();
                    assert!(
                        off < 0.6e-3,
                        "{task}, {name}: {number} in the head, {own} in the state"
                    );
                }
                let same = unit == *own || unit == "half a picture" && own == "1";
                assert!(same, "{task}, {name}: {unit:?} in the head, {own:?} in the state");
            }
        }
    }
}
