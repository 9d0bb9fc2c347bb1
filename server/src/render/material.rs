//! What surfaces look like: the colours, metals and roughness of `assets/materials.csv`.

use std::collections::BTreeMap;
use std::sync::LazyLock;

/// The look of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Part of the light that it sends back, red, green, blue, in 0 to 1: linear, not as stored in
    /// pictures.
    pub colour: [f32; 3],
    /// 0 for plastics and paints, 1 for bare metals.
    pub metallic: f32,
    /// From 0 (a mirror) to 1 (chalk).
    pub roughness: f32,
}

impl Material {
    /// A material of the table.
    ///
    /// # Panics
    /// Where the table has none of that name.
    pub fn named(name: &str) -> Self {
        Self::find(name).unwrap_or_else(|| panic!("no material {name:?}"))
    }

    /// A material of the table, if it is there.
    pub fn find(name: &str) -> Option<Self> {
        TABLE.get(name).copied()
    }

    /// The same surface in another colour: red, green, blue as stored in pictures, in 0 to 1.
    #[must_use]
    pub fn coloured(self, colour: [f32; 3]) -> Self {
        Self { colour: colour.map(linear), ..self }
    }
}

/// A part of the light from how pictures store it, both in 0 to 1 (sRGB, IEC 61966-2-1).
pub fn linear(stored: f32) -> f32 {
    if stored <= 0.040_45 { stored / 12.92 } else { libm::powf((stored + 0.055) / 1.055, 2.4) }
}

/// How pictures store a part of the light: the inverse of [`linear`].
pub fn stored(light: f32) -> f32 {
    if light <= 0.003_130_8 { light * 12.92 } else { 1.055 * libm::powf(light, 1.0 / 2.4) - 0.055 }
}

static TABLE: LazyLock<BTreeMap<&str, Material>> = LazyLock::new(|| {
    let rows = include_str!("../../../assets/materials.csv").lines().skip(1);
    let read = |row: &'static str| {
        let columns: Vec<_> = row.split(',').collect();
        let number = |column: usize| -> f32 { columns[column].parse().expect("a number") };
        let colour = [1, 2, 3].map(|column| linear(number(column)));
        (columns[0], Material { colour, metallic: number(6), roughness: number(7) })
    };
    rows.map(read).collect()
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steel_is_a_metal_and_silicone_is_not() {
        let (steel, silicone) = (Material::named("steel"), Material::named("silicone"));
        assert!(steel.metallic == 1.0 && silicone.metallic == 0.0);
        assert!(steel.roughness < silicone.roughness);
        assert!(silicone.colour[0] > silicone.colour[2]);
        assert!(TABLE.values().all(|each| (0.03..=1.0).contains(&each.roughness)));
        assert_eq!(Material::find("velvet"), None);
    }

    #[test]
    fn what_is_stored_comes_back() {
        for step in 0..=255_u8 {
            let value = f32::from(step) / 255.0;
            assert!((stored(linear(value)) - value).abs() < 1e-6, "{step}");
        }
    }
}
