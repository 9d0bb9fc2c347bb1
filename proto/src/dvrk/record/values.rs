//! Texts and numbers of a fixed size.

use bytemuck::{Pod, Zeroable};

use crate::error::{Code, Rejection};

/// Most numbers of a command: positions and velocities of a few more axes than there are, so that a wrong count is
/// told by the arm.
pub const MAX_NUMBERS: usize = 24;

/// Most bytes of a text.
const MAX_TEXT: usize = 256;

/// A short text.
#[derive(Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Text {
    bytes: [u8; MAX_TEXT],
    length: u32,
    reserved: u32,
}

const _: () = assert!(size_of::<Text>() == 264);

impl Text {
    /// Most bytes of one.
    pub const MOST: usize = MAX_TEXT;

    /// As much of a text as there is room for.
    pub fn new(text: &str) -> Self {
        let end = (0..=text.len().min(Self::MOST)).rev().find(|end| text.is_char_boundary(*end));
        let kept = &text.as_bytes()[..end.unwrap_or(0)];
        let mut bytes = [0; Self::MOST];
        bytes[..kept.len()].copy_from_slice(kept);
        Self { bytes, length: kept.len() as u32, reserved: 0 }
    }

    /// The text; what is no UTF-8 reads `�`.
    pub fn read(&self) -> String {
        String::from_utf8_lossy(&self.bytes[..(self.length as usize).min(Self::MOST)]).into_owned()
    }
}

impl std::fmt::Debug for Text {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.read())
    }
}

/// Up to [`MAX_NUMBERS`] numbers in two groups, one behind the other.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Numbers {
    values: [f64; MAX_NUMBERS],
    pub(super) counts: [u32; 2],
}

impl Numbers {
    /// The numbers of a `field`, unless they are too many.
    pub fn new(field: &str, groups: [&[f64]; 2]) -> Result<Self, Rejection> {
        let [first, second] = groups;
        let count = first.len() + second.len();
        if count > MAX_NUMBERS {
            return Err(too_many(field, count));
        }
        let mut values = [0.0; MAX_NUMBERS];
        values[..first.len()].copy_from_slice(first);
        values[first.len()..count].copy_from_slice(second);
        Ok(Self { values, counts: groups.map(|group| group.len() as u32) })
    }

    /// Both groups, unless they are too many.
    pub fn read(&self, field: &str) -> Result<[&[f64]; 2], Rejection> {
        let [first, second] = self.counts.map(|count| count as usize);
        if first.saturating_add(second) > MAX_NUMBERS {
            return Err(too_many(field, first.saturating_add(second)));
        }
        let (first, rest) = self.values.split_at(first);
        Ok([first, &rest[..second]])
    }
}

fn too_many(field: &str, count: usize) -> Rejection {
    let allowed = format!("at most {MAX_NUMBERS}");
    Rejection::new(Code::InvalidCommand, field, format!("{count} numbers"), allowed)
}
