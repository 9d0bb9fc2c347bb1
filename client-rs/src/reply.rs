//! The reply to a request of a session, and which environments a request is about.

use std::sync::Arc;

use trocar_proto::TaskSpec;
use trocar_proto::columns::Flag;
use trocar_proto::control::SessionInfo;
use trocar_proto::wire::{PictureLayout, ReplyLayout};

use crate::snapshot::Snapshot;
use crate::transport::{Link, Owned, RawReply};

/// The reply to a reset, step, restore or fork: arrays in shared memory, valid until this is dropped.
/// Row r belongs to environment `env_id(r)`.
#[derive(Debug)]
pub struct Reply {
    pub(crate) raw: Owned<RawReply>,
    pub(crate) taken: Option<Snapshot>,
    pub(crate) env_ids: EnvIds,
    pub(crate) info: Arc<SessionInfo>,
    pub(crate) layout: Arc<ReplyLayout>,
    /// Of a picture that was asked for; there is nothing else then.
    pub(crate) picture: Option<Arc<PictureLayout>>,
    /// Dropped last: as long as shared memory is used, no process may remove it.
    pub(crate) _link: Arc<Owned<Link>>,
}

impl Reply {
    /// The snapshot that was taken, where one was asked for.
    pub fn into_snapshot(self) -> Option<Snapshot> {
        self.taken
    }

    /// Number of rows; none in the reply to [`Session::render`](crate::Session::render).
    pub fn rows(&self) -> usize {
        if self.picture.is_some() { 0 } else { self.env_ids.len() }
    }

    /// Red, green, blue of the picture that was asked for: u8 (views, height, width, 3).
    pub fn picture_rgb(&self) -> &[u8] {
        self.picture.as_ref().map_or(&[], |layout| layout.rgb.view(self.raw.payload(), 1))
    }

    /// Depth of the picture that was asked for, along the optical axis, m: f32 (views, height, width).
    pub fn picture_depth(&self) -> &[f32] {
        self.picture.as_ref().map_or(&[], |layout| layout.depth.view(self.raw.payload(), 1))
    }

    /// The environment of row `row`.
    pub fn env_id(&self, row: usize) -> u32 {
        match &self.env_ids {
            EnvIds::All(_) => row as u32,
            EnvIds::Some(ids) => ids[row],
        }
    }

    /// The task's specification, which says what each element means.
    pub fn spec(&self) -> &TaskSpec {
        &self.info.spec
    }
}

macro_rules! columns {
    ($($(#[$doc:meta])* $name:ident: $element:ident [$width:ident] $role:tt;)*) => {
        /// Its columns; a row lies after the other.
        impl Reply {
            $(
                $(#[$doc])*
                pub fn $name(&self) -> &[$element] {
                    self.layout.$name.view(self.raw.payload(), self.rows())
                }
            )*
        }
    };
}

trocar_proto::reply_columns!(columns);

/// Which environments a request is about.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum EnvIds {
    All(u32),
    Some(Arc<[u32]>),
}

impl EnvIds {
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::All(count) => *count as usize,
            Self::Some(ids) => ids.len(),
        }
    }

    /// These and others.
    pub(crate) fn and(&self, others: &[u32]) -> Self {
        match self {
            Self::All(count) => Self::All(*count),
            Self::Some(ids) => {
                let mut both = [ids, others].concat();
                both.sort_unstable();
                both.dedup();
                Self::Some(both.into())
            }
        }
    }

    /// An environment that both have.
    pub(crate) fn common(&self, other: &Self) -> Option<u32> {
        match (self, other) {
            (Self::All(_), Self::All(_)) => Some(0),
            (Self::All(_), Self::Some(ids)) | (Self::Some(ids), Self::All(_)) => {
                ids.first().copied()
            }
            // Increasing numbers: found by halving.
            (Self::Some(ids), Self::Some(others)) => {
                ids.iter().copied().find(|id| others.binary_search(id).is_ok())
            }
        }
    }
}
