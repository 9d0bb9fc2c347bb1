//! Bytes that outlive a process: parts one after another, each with a checksum. They may come from anywhere.
//!
//! A part is: magic (8 bytes), protocol version, length of the body (u32 each), checksum of the body (u64), all
//! little-endian; the body, serde and bincode.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::control::{self, MAX_MESSAGE};
use crate::error::{Code, Rejection};

/// Largest part, bytes: it travels in one control message.
pub const MAX_PART: usize = MAX_MESSAGE - 1024;

/// Bytes before the body.
const HEAD: usize = 8 + 4 + 4 + 8;

/// What a part is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A [`Recipe`](crate::snapshot::Recipe): what led to the state of an environment.
    Snapshot,
    /// A [`LivePart`](crate::dvrk::recording::LivePart): what led to the state of a live world.
    Live,
}

impl Kind {
    const ALL: [Self; 2] = [Self::Snapshot, Self::Live];

    /// First bytes of a part.
    pub fn magic(self) -> [u8; 8] {
        match self {
            Self::Snapshot => *b"TRCRSNAP",
            Self::Live => *b"TRCRLIVE",
        }
    }

    /// The kind of a part that [`split`] gave.
    pub fn of(part: &[u8]) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| part.starts_with(&kind.magic()))
    }

    /// What refusals call it.
    fn name(self) -> &'static str {
        match self {
            Self::Snapshot => "snapshot",
            Self::Live => "recording",
        }
    }
}

/// A part with this body, unless that is too long: then `what` says what it has.
pub fn seal(
    kind: Kind,
    body: &impl Serialize,
    what: impl FnOnce() -> String,
) -> Result<Vec<u8>, Rejection> {
    let mut bytes = vec![0; MAX_PART];
    let length = control::encode(body, &mut bytes[HEAD..]).map_err(|_| {
        let allowed = format!("an exported {} has at most {MAX_PART} bytes", kind.name());
        Rejection::new(Code::Unsupported, kind.name(), what(), allowed)
    })?;
    bytes.truncate(HEAD + length);
    let sum = fingerprint(bytes[HEAD..].iter().copied());
    bytes[..8].copy_from_slice(&kind.magic());
    bytes[8..12].copy_from_slice(&crate::PROTOCOL_VERSION.to_le_bytes());
    bytes[12..16].copy_from_slice(&(length as u32).to_le_bytes());
    bytes[16..HEAD].copy_from_slice(&sum.to_le_bytes());
    Ok(bytes)
}

/// Reads the body of one part of a kind; `bytes` may be anything.
pub fn open<T: DeserializeOwned>(kind: Kind, bytes: &[u8]) -> Result<T, Rejection> {
    let refuse = |part: &str, value: &dyn std::fmt::Display, allowed| {
        Err(refuse(kind.name(), part, value, allowed))
    };
    let (head, body) = front(bytes)?;
    if head.kind != kind {
        let allowed = format!("these bytes are no {}", kind.name());
        return refuse("magic", &format!("that of a {}", head.kind.name()), allowed);
    }
    let (_, beyond) = body.split_at(head.length);
    if !beyond.is_empty() {
        let allowed = format!("one part of {}", bytes.len() - beyond.len());
        return refuse("length", &bytes.len(), allowed);
    }
    let sum = fingerprint(body.iter().copied());
    if sum != head.checksum {
        let allowed = format!("the bytes were changed; expected {:016x}", head.checksum);
        return refuse("checksum", &format!("{sum:016x}"), allowed);
    }
    control::decode(body).or_else(|error| {
        refuse("body", &error.value, format!("what exporting a {} wrote", kind.name()))
    })
}

/// The parts of which `bytes` consist; none of them is looked into.
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

/// The whole parts of a file that may be cut off, and the number of bytes after the last whole part. At least one part is
/// whole; bytes that begin no part are refused.
pub fn split_whole(bytes: &[u8]) -> Result<(Vec<&[u8]>, usize), Rejection> {
    let mut parts = vec![];
    let mut rest = bytes;
    while parts.is_empty() || !rest.is_empty() {
        let head = match front(rest) {
            Ok((head, _)) => head,
            Err(_) if !parts.is_empty() && is_cut_off(rest) => break,
            Err(refusal) => return Err(refusal),
        };
        let (part, later) = rest.split_at(HEAD + head.length);
        parts.push(part);
        rest = later;
    }
    Ok((parts, rest.len()))
}

/// True if `bytes` are the beginning of a part, and not all of that part.
fn is_cut_off(bytes: &[u8]) -> bool {
    let mut head = [0; HEAD];
    let given = bytes.len().min(HEAD);
    head[..given].copy_from_slice(&bytes[..given]);
    let begins = |kind: Kind| {
        let fixed = [&kind.magic()[..], &crate::PROTOCOL_VERSION.to_le_bytes()].concat();
        bytes.iter().zip(&fixed).all(|(byte, expected)| byte == expected)
    };
    let length = u32::from_le_bytes([head[12], head[13], head[14], head[15]]) as usize;
    Kind::ALL.into_iter().any(begins)
        && (given < HEAD || bytes.len() < HEAD + length && HEAD + length <= MAX_PART)
}

/// A number that stands for all of `bytes` (FNV-1a, 64 bits).
pub fn fingerprint(bytes: impl IntoIterator<Item = u8>) -> u64 {
    bytes.into_iter().fold(0xcbf2_9ce4_8422_2325, |sum, byte| {
        (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The fixed beginning of a part.
struct Head {
    kind: Kind,
    length: usize,
    checksum: u64,
}

/// The head of the first part, and everything after it: at least the part's body.
fn front(bytes: &[u8]) -> Result<(Head, &[u8]), Rejection> {
    let Some((head, rest)) = bytes.split_at_checked(HEAD) else {
        let allowed = format!("cut off; a part has at least {HEAD} bytes");
        return Err(refuse("snapshot", "length", &bytes.len(), allowed));
    };
    let Some(kind) = Kind::of(head) else {
        let found = format!("{:?}", String::from_utf8_lossy(&head[..8]));
        let allowed = "expected TRCRSNAP or TRCRLIVE: these bytes are no snapshot".into();
        return Err(refuse("snapshot", "magic", &found, allowed));
    };
    let word = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
    let (protocol, length) = (word(8), word(12) as usize);
    if protocol != crate::PROTOCOL_VERSION {
        return Err(Rejection::new(
            Code::VersionMismatch,
            format!("{}.protocol version", kind.name()),
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
        return Err(refuse(kind.name(), "body", &found, allowed));
    }
    let checksum = u64::from(word(16)) | u64::from(word(20)) << 32;
    Ok((Head { kind, length, checksum }, rest))
}

fn refuse(name: &str, part: &str, value: &dyn std::fmt::Display, allowed: String) -> Rejection {
    Rejection::new(Code::InvalidSnapshot, format!("{name}.{part}"), value, allowed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_cut_off_anywhere() {
        let part = |number: u32| seal(Kind::Snapshot, &number, String::new).unwrap();
        let parts = [part(1), part(2), part(3)];
        let bytes = parts.concat();
        let length = parts[0].len();
        for end in 0..=bytes.len() {
            match split_whole(&bytes[..end]) {
                Ok((whole, lost)) => {
                    assert_eq!((whole.len(), lost), (end / length, end % length));
                    assert_eq!(split(&bytes[..end]).is_ok(), lost == 0);
                }
                Err(_) => assert!(end < length),
            }
        }
        for at in [0, 8, 12] {
            let mut changed = bytes.clone();
            changed[2 * length + at] ^= 0x80;
            // A greater length looks like the end of the file.
            let is_refused = split_whole(&changed).is_err();
            assert_eq!(is_refused, at != 12, "{at}");
        }
        assert!(split_whole(&[&bytes[..], b"garbage"].concat()).is_err());
    }
}
