//! A snapshot as bytes: what led to the state of an environment, from which it is rebuilt.
//!
//! The same seed and actions give the same bits. So the seed of an episode, its number, the placement with
//! which it began and the actions since *are* the state. They take a few hundred bytes, and do not say how the
//! state is laid out in memory. Bytes from anywhere can then do no more harm than actions can. The process that
//! rebuilds a state compares its fingerprint with the one that was written down.
//!
//! One environment's part is: magic (8 bytes), protocol version, length of the body (u32 each),
//! checksum of the body (u64), all little-endian; the body, serde and bincode. Several environments
//! are their parts one after another.

use serde::{Deserialize, Serialize};

use crate::control::{self, MAX_MESSAGE};
use crate::error::{Code, Rejection};
use crate::placement::Placement;
use crate::spec::Options;

/// Largest part of one environment, bytes: it travels in one control message.
pub const MAX_PART: usize = MAX_MESSAGE - 1024;

/// First bytes of every part.
const MAGIC: [u8; 8] = *b"TRCRSNAP";

/// Bytes before the body.
const HEAD: usize = MAGIC.len() + 4 + 4 + 8;

/// What led to the state of one environment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Release that wrote it.
    pub version: String,
    /// Task id.
    pub task: String,
    /// Every option of the task.
    pub options: Options,
    /// Seed of the episode.
    pub seed: u64,
    /// Number of the episode under that seed.
    pub episode: u64,
    /// How it was made to begin.
    pub placement: Placement,
    /// Actions since the episode began: (steps, action dim), row by row.
    pub actions: Vec<f32>,
    /// Stands for every bit of the state that must come of it.
    pub fingerprint: u64,
}

impl Recipe {
    /// The part of one environment.
    pub fn to_bytes(&self) -> Result<Vec<u8>, Rejection> {
        let mut bytes = vec![0; MAX_PART];
        let length = control::encode(self, &mut bytes[HEAD..]).map_err(|_| {
            let found = format!("{} numbers of actions and the options", self.actions.len());
            let allowed = format!("an exported snapshot has at most {MAX_PART} bytes");
            Rejection::new(Code::Unsupported, "snapshot", found, allowed)
        })?;
        bytes.truncate(HEAD + length);
        let sum = fingerprint(bytes[HEAD..].iter().copied());
        bytes[..8].copy_from_slice(&MAGIC);
        bytes[8..12].copy_from_slice(&crate::PROTOCOL_VERSION.to_le_bytes());
        bytes[12..16].copy_from_slice(&(length as u32).to_le_bytes());
        bytes[16..HEAD].copy_from_slice(&sum.to_le_bytes());
        Ok(bytes)
    }

    /// Reads what [`Self::to_bytes`] wrote; `bytes` may be anything.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, Rejection> {
        let (head, body) = front(bytes)?;
        let (_, beyond) = body.split_at(head.length);
        if !beyond.is_empty() {
            return Err(refuse(
                "length",
                bytes.len(),
                format!("one part of {}", bytes.len() - beyond.len()),
            ));
        }
        let sum = fingerprint(body.iter().copied());
        if sum != head.checksum {
            let found = format!("{sum:016x}");
            return Err(refuse(
                "checksum",
                found,
                format!("the bytes were changed; expected {:016x}", head.checksum),
            ));
        }
        control::decode(body)
            .map_err(|error| refuse("body", error.value, "what exporting a snapshot wrote".into()))
    }
}

/// The parts of which `bytes` consist, one for each environment; none of them is looked into.
pub fn split(bytes: &[u8]) -> Result<Vec<&[u8]>, Rejection> {
    let mut parts = vec![];
    let mut rest = bytes;
    while parts.is_empty() || !rest.is_empty() {
        let (head, _) = front(rest)?;
        let (part, later) = rest.split_at(HEAD + head.length);
        parts.push(part);
        rest = later;
    }
    Ok(parts)
}

/// A number that stands for all of `bytes` (FNV-1a, 64 bits).
pub fn fingerprint(bytes: impl IntoIterator<Item = u8>) -> u64 {
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |sum, byte| {
        (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The fixed beginning of a part.
struct Head {
    length: usize,
    checksum: u64,
}

/// The head of the first part, and everything after it: at least the part's body.
fn front(bytes: &[u8]) -> Result<(Head, &[u8]), Rejection> {
    let Some((head, rest)) = bytes.split_at_checked(HEAD) else {
        let allowed = format!("cut off; a part has at least {HEAD} bytes");
        return Err(refuse("length", bytes.len(), allowed));
    };
    if head[..8] != MAGIC {
        let found = format!("{:?}", String::from_utf8_lossy(&head[..8]));
        return Err(refuse(
            "magic",
            found,
            "expected TRCRSNAP: these bytes are no snapshot".into(),
        ));
    }
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let (protocol, length) = (word(8), word(12) as usize);
    if protocol != crate::PROTOCOL_VERSION {
        return Err(Rejection::new(
            Code::VersionMismatch,
            "snapshot.protocol version",
            protocol,
            format!(
                "this is version {}; export it again with this release",
                crate::PROTOCOL_VERSION
            ),
        ));
    }
    if length > rest.len() || HEAD + length > MAX_PART {
        let found = format!("{} bytes", rest.len());
        let allowed = format!("cut off, or changed; the body should have {length} bytes");
        return Err(refuse("body", found, allowed));
    }
    let checksum = u64::from(word(16)) | u64::from(word(20)) << 32;
    Ok((Head { length, checksum }, rest))
}

fn refuse(part: &str, value: impl std::fmt::Display, allowed: String) -> Rejection {
    Rejection::new(Code::InvalidSnapshot, format!("snapshot.{part}"), value, allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(steps: usize) -> Recipe {
        Recipe {
            version: "1.2.3".into(),
            task: "Test-v0".into(),
            options: Options::new().with_text("reward", "dense"),
            seed: u64::MAX,
            episode: 3,
            placement: Placement { goal: Some(vec![0.5; 3]), ..Placement::default() },
            actions: vec![0.25; 5 * steps],
            fingerprint: 7,
        }
    }

    #[test]
    fn recipes_survive_as_bytes_alone_and_one_after_another() {
        let recipes = [recipe(0), recipe(1), recipe(500)];
        let parts: Vec<_> = recipes.iter().map(|recipe| recipe.to_bytes().unwrap()).collect();
        for (part, recipe) in parts.iter().zip(&recipes) {
            assert_eq!(Recipe::from_bytes(part).unwrap(), *recipe);
        }
        assert_eq!(split(&parts.concat()).unwrap(), parts);
    }

    #[test]
    fn cut_extended_and_changed_bytes_are_refused_by_name() {
        let bytes = recipe(20).to_bytes().unwrap();
        for end in 0..bytes.len() {
            let refusal = Recipe::from_bytes(&bytes[..end]).unwrap_err();
            assert_eq!(refusal.code, Code::InvalidSnapshot, "{refusal}");
            assert!(split(&bytes[..end]).is_err());
        }
        let twice = [bytes.clone(), bytes.clone()].concat();
        assert_eq!(Recipe::from_bytes(&twice).unwrap_err().field, "snapshot.length");
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut changed = bytes.clone();
                changed[at] ^= 1 << bit;
                assert!(Recipe::from_bytes(&changed).is_err(), "bit {bit} of byte {at}");
            }
        }
        let mut old = bytes;
        old[8] ^= 0xff;
        assert_eq!(Recipe::from_bytes(&old).unwrap_err().code, Code::VersionMismatch);
    }

    #[test]
    fn what_does_not_fit_into_a_message_is_refused() {
        let refusal = recipe(10_000).to_bytes().unwrap_err();
        assert_eq!((refusal.code, refusal.field.as_str()), (Code::Unsupported, "snapshot"));
    }
}
