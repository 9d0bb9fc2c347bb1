//! Suggestions for mistyped names.

/// The most similar of the `known` names, as the words "; did you mean …?"; empty if no name is similar.
///
/// Case and the version `-v0` of task ids are ignored. A third of a name's letters may differ.
pub fn hint<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    // Names of another length are not compared: words of clients may be long.
    let similar =
        known.into_iter().filter(|known| word.len().abs_diff(known.len()) <= known.len() / 2);
    let distances = similar.map(|known| (edit_distance(word, known), known));
    let closest = distances.min_by_key(|(distance, _)| *distance);
    let similar = closest.filter(|(distance, known)| *distance <= known.len() / 3);
    similar.map_or(String::new(), |(_, known)| format!("; did you mean {known:?}?"))
}

/// Levenshtein distance of two names, without regard to case and to the version `-v0`.
fn edit_distance(one: &str, other: &str) -> usize {
    let plain = |name: &str| name.trim_end_matches("-v0").to_lowercase();
    let (one, other) = (plain(one), plain(other));
    let mut row: Vec<usize> = (0..=other.chars().count()).collect();
    for (i, a) in one.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, b) in other.chars().enumerate() {
            let replaced = diagonal + usize::from(a != b);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[other.chars().count()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_similar_name_is_suggested() {
        let known = ["NeedlePick-v0", "NeedleReach-v0", "PegTransfer-v0"];
        assert_eq!(hint("needelpick", known), "; did you mean \"NeedlePick-v0\"?");
        assert_eq!(hint("Juggle-v0", known), "");
        assert_eq!(hint("reward", []), "");
    }
}
