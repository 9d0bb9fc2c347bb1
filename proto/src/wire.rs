//! Frequent messages: reset and step as plain arrays in shared memory.
//!
//! A message is a [`Header`] and a payload of bytes. The payload holds struct-of-arrays regions
//! at offsets that both sides compute from the session's specification; each region starts on a
//! 64-byte boundary and is sized for every environment, of which the first `rows` rows are used.

use iceoryx2::prelude::ZeroCopySend;

use crate::columns::{Flag, Width};
use crate::dvrk::LiveInfo;
use crate::dvrk::record::{
    AnswerRecord, ArmRecord, CommandRecord, EventRecord, QuestionRecord, WorldRecord,
};
use crate::spec::{ImageSpec, TaskSpec};

/// First word of every message: "TRCR".
pub const MAGIC: u32 = u32::from_le_bytes(*b"TRCR");

/// Alignment of payloads and of every region, bytes (a cache line).
pub const ALIGNMENT: usize = 64;

/// Requests that a client may have in flight: two disjoint groups of environments.
pub const MAX_IN_FLIGHT: usize = 2;

/// Replies that a client may hold on to, besides those that are in flight: one is being read, one
/// is the view handed out before it.
pub const MAX_HELD_REPLIES: usize = 4;

/// What a data message asks for.
pub mod kind {
    /// Reset the listed environments.
    pub const RESET: u32 = 1;
    /// Step the listed environments.
    pub const STEP: u32 = 2;
    /// Save the state of each of the listed environments under a number that the reply tells.
    pub const SNAPSHOT: u32 = 3;
    /// Let each of the listed environments go on from the snapshot of that row. The reply shows
    /// where they are; it reports no transition.
    pub const RESTORE: u32 = 4;
    /// Let each of the listed environments go on from the state that the environment of that row's
    /// number has before the request. The reply is as for [`RESTORE`].
    pub const FORK: u32 = 5;
    /// Draw one environment as the session's view shows it; the reply is a [`super::PictureLayout`].
    pub const RENDER: u32 = 6;
    /// Let the episode of each of the listed environments, in which no step was taken, begin as the placement
    /// of that row's number asks for. The reply is as for [`RESTORE`].
    pub const ARRANGE: u32 = 7;
    /// Give a live world's arms commands, as many as the message has rows, and let ticks pass. Payloads:
    /// [`super::LiveRequestLayout`] and [`super::LiveReplyLayout`].
    pub const LIVE: u32 = 32;
    /// Ask about the kinematics of a live world's arm.
    pub const ASK: u32 = 33;
}

/// Bits of [`Header::flags`].
pub mod flag {
    /// Request: the reply shall carry the scripted expert's action, and its stage, for the state
    /// it returns.
    pub const WANT_EXPERT: u32 = 1;
    /// Reset request: the numbers are seeds, and the episodes say which of each seed; otherwise each
    /// environment goes on to the next episode of its seed.
    pub const HAS_SEEDS: u32 = 2;
    /// Render request: depth is wanted, and not colours.
    pub const DEPTH: u32 = 4;
    /// Live request: time stops after a tick in which an arm told something.
    pub const UNTIL_EVENT: u32 = 8;
}

/// The fixed part of every message, control and data, both directions. Its size and alignment make payloads, which
/// follow it, begin at cache lines: bytes that asked for that alignment themselves would each get a line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ZeroCopySend)]
#[type_name("TrocarHeader")]
#[repr(C)]
#[repr(align(64))]
pub struct Header {
    /// Always [`MAGIC`].
    pub magic: u32,
    /// Always [`crate::PROTOCOL_VERSION`].
    pub protocol: u32,
    /// What is asked: [`kind`] on data services, [`crate::control::ControlRequest`]'s on control.
    pub kind: u32,
    /// Bits of [`flag`].
    pub flags: u32,
    /// Number of the request, chosen by the client, returned by the server.
    pub request: u64,
    /// The session, 0 outside of one.
    pub session: u64,
    /// The run of the server that opened the session.
    pub epoch: u64,
    /// Rows used in every region.
    pub rows: u32,
    /// Bytes used in the payload where it holds an encoded message.
    pub length: u32,
    /// Reply: 0, or the [`crate::Code`] of a refusal that the payload explains.
    pub status: u32,
    /// Zero.
    pub reserved: u32,
}

const _: () = assert!(size_of::<Header>() == ALIGNMENT && align_of::<Header>() == ALIGNMENT);

impl Header {
    /// A header of this protocol version with everything else zero.
    pub fn new(kind: u32) -> Self {
        Self { magic: MAGIC, protocol: crate::PROTOCOL_VERSION, kind, ..Self::default() }
    }
}

/// Where an array lies in a payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    /// First byte.
    pub offset: usize,
    /// Elements per row.
    pub width: usize,
    /// Bytes per element.
    pub element: usize,
    /// Rows there is room for.
    pub rows: usize,
}

impl Region {
    /// Bytes of the first `rows` rows.
    pub fn range(&self, rows: usize) -> std::ops::Range<usize> {
        debug_assert!(rows <= self.rows);
        self.offset..self.offset + rows * self.width * self.element
    }

    /// The first `rows` rows as numbers.
    ///
    /// # Panics
    /// Where `T` is not the region's element type or the payload is shorter than its layout.
    pub fn view<'a, T: bytemuck::Pod>(&self, payload: &'a [u8], rows: usize) -> &'a [T] {
        assert_eq!(self.element, size_of::<T>());
        bytemuck::cast_slice(&payload[self.range(rows)])
    }

    /// The first `rows` rows as numbers that can be written.
    ///
    /// # Panics
    /// As [`Self::view`].
    pub fn view_mut<'a, T: bytemuck::Pod>(
        &self,
        payload: &'a mut [u8],
        rows: usize,
    ) -> &'a mut [T] {
        assert_eq!(self.element, size_of::<T>());
        bytemuck::cast_slice_mut(&mut payload[self.range(rows)])
    }
}

/// Lays regions one after another, each on its own cache line.
struct Planner {
    rows: usize,
    end: usize,
}

impl Planner {
    fn region<T>(&mut self, width: usize) -> Region {
        let offset = self.end.next_multiple_of(ALIGNMENT);
        let element = size_of::<T>();
        self.end = offset + self.rows * width * element;
        Region { offset, width, element, rows: self.rows }
    }

    fn bytes(&self) -> usize {
        self.end.next_multiple_of(ALIGNMENT)
    }
}

/// Smallest payload of a reply, bytes: an encoded refusal must fit into any.
const MIN_REPLY: usize = 8192;

/// The arrays of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestLayout {
    /// Which environments: u32 (rows), each below the session's number, none twice.
    pub env_ids: Region,
    /// Actions: f32 (rows, action dim).
    pub actions: Region,
    /// u64 (rows): seeds for a reset; snapshots for a restore; for a fork, the environments to go on
    /// from.
    pub numbers: Region,
    /// u64 (rows): for a reset with seeds, which episode of its seed each environment begins.
    pub episodes: Region,
    /// Size of the payload.
    pub bytes: usize,
}

impl RequestLayout {
    /// The layout for a session of `envs` environments.
    pub fn new(envs: usize, spec: &TaskSpec) -> Self {
        let mut plan = Planner { rows: envs, end: 0 };
        let env_ids = plan.region::<u32>(1);
        let actions = plan.region::<f32>(spec.action_dim());
        let numbers = plan.region::<u64>(1);
        let episodes = plan.region::<u64>(1);
        Self { env_ids, actions, numbers, episodes, bytes: plan.bytes() }
    }
}

macro_rules! reply_layout {
    ($($(#[$doc:meta])* $name:ident: $element:ident [$width:ident] $role:tt;)*) => {
        /// The arrays of a reply. Row r belongs to the r-th environment of the request.
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub struct ReplyLayout {
            $($(#[$doc])* pub $name: Region,)*
            /// Size of the payload.
            pub bytes: usize,
        }

        impl ReplyLayout {
            /// The layout for a session of `envs` environments.
            pub fn new(envs: usize, spec: &TaskSpec) -> Self {
                let mut plan = Planner { rows: envs, end: 0 };
                Self {
                    $($name: plan.region::<$element>(Width::$width.of(spec)),)*
                    bytes: plan.bytes().max(MIN_REPLY),
                }
            }

            #[cfg(test)]
            fn regions(&self) -> Vec<Region> {
                vec![$(self.$name),*]
            }
        }
    };
}

crate::reply_columns!(reply_layout);

/// A picture that was asked for, of one environment: colours or depth, both at the beginning of the payload.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PictureLayout {
    /// u8 (1, views · height · width · 3): red, green, blue.
    pub rgb: Region,
    /// f32 (1, views · height · width), m.
    pub depth: Region,
    /// Size of the payload.
    pub bytes: usize,
}

impl PictureLayout {
    /// The layout of pictures of this kind.
    pub fn new(spec: &ImageSpec) -> Self {
        let pixels = spec.views.len() * spec.height * spec.width;
        let mut plan = Planner { rows: 1, end: 0 };
        let depth = plan.region::<f32>(pixels);
        let rgb = Region { width: 3 * pixels, element: size_of::<u8>(), ..depth };
        Self { rgb, depth, bytes: plan.bytes().max(MIN_REPLY) }
    }
}

/// Most commands of a message to a live world.
pub const MAX_COMMANDS: usize = 32;

/// Most events in a reply of a live world.
pub const MAX_EVENTS: usize = 32;

/// Most ticks that a message may let pass: 100 s.
pub const MAX_TICKS: u32 = 24_000;

/// A message to a live world.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LiveRequestLayout {
    /// u32 (1): ticks that shall pass once the commands were given.
    pub ticks: Region,
    /// Commands, of which the first [`Header::rows`] are meant.
    pub commands: Region,
    /// A question, of [`kind::ASK`].
    pub question: Region,
    /// u64 (1): the snapshot, of [`kind::RESTORE`].
    pub snapshot: Region,
    /// u64 (1): the seed whose first episode begins, of [`kind::RESET`].
    pub seed: Region,
    /// Size of the payload.
    pub bytes: usize,
}

impl LiveRequestLayout {
    /// The layout for any live world.
    pub fn new() -> Self {
        let mut plan = Planner { rows: 1, end: 0 };
        let ticks = plan.region::<u32>(1);
        let commands = plan.region::<CommandRecord>(MAX_COMMANDS);
        let question = plan.region::<QuestionRecord>(1);
        let snapshot = plan.region::<u64>(1);
        let seed = plan.region::<u64>(1);
        Self { ticks, commands, question, snapshot, seed, bytes: plan.bytes() }
    }
}

impl Default for LiveRequestLayout {
    fn default() -> Self {
        Self::new()
    }
}

/// A live world's reply.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LiveReplyLayout {
    /// The world.
    pub world: Region,
    /// Its arms.
    pub arms: Region,
    /// What they have told, of which the first [`WorldRecord::events`] are meant.
    pub events: Region,
    /// f64 (objects, 7): where the objects are in the world: x, y, z, m; x, y, z, w of a unit quaternion.
    pub objects: Region,
    /// f32 (observation dim).
    pub observation: Region,
    /// f32 (goal dim).
    pub achieved_goal: Region,
    /// f32 (goal dim).
    pub desired_goal: Region,
    /// The answer to a question; there is nothing else then.
    pub answer: Region,
    /// u64 (1): the number of the snapshot that was taken, of [`kind::SNAPSHOT`].
    pub snapshot: Region,
    /// Size of the payload.
    pub bytes: usize,
}

impl LiveReplyLayout {
    /// The layout for a live world of a task.
    pub fn new(live: &LiveInfo, spec: &TaskSpec) -> Self {
        let mut plan = Planner { rows: 1, end: 0 };
        Self {
            world: plan.region::<WorldRecord>(1),
            arms: plan.region::<ArmRecord>(live.arms.len()),
            events: plan.region::<EventRecord>(MAX_EVENTS),
            objects: plan.region::<f64>(7 * live.objects.len()),
            observation: plan.region::<f32>(spec.observation_dim()),
            achieved_goal: plan.region::<f32>(spec.goal_dim()),
            desired_goal: plan.region::<f32>(spec.goal_dim()),
            answer: plan.region::<AnswerRecord>(1),
            snapshot: plan.region::<u64>(1),
            bytes: plan.bytes().max(MIN_REPLY),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::goal::{Reward, SuccessRule};
    use crate::relative::Relative;
    use crate::spec::{Element, GoalSpec, ImageKind};

    fn spec(action: usize, observation: usize, goal: usize) -> TaskSpec {
        let elements = |count| vec![Element::new("x", "world", "m", -1.0, 1.0); count];
        TaskSpec {
            id: "Test-v0".into(),
            summary: String::new(),
            max_steps: 50,
            seconds_per_step: 0.2,
            action: elements(action),
            observation: elements(observation),
            goal: Some(GoalSpec {
                elements: elements(goal),
                success: SuccessRule::Distance { tolerance: 0.005 },
            }),
            reward: Reward::Sparse,
            options: vec![],
            relative: Relative::default(),
            images: None,
            has_tissue: false,
        }
    }

    fn with_images(spec: TaskSpec, kinds: &[ImageKind]) -> TaskSpec {
        let images = ImageSpec {
            kinds: kinds.to_vec(),
            views: vec!["_left".into(), "_right".into()],
            height: 3,
            width: 5,
            intrinsics: [4.0, 4.0, 2.0, 1.0],
            camera_from_world: vec![],
            far: 10.0,
            bodies: vec![],
            with_state: true,
        };
        TaskSpec { images: Some(images), ..spec }
    }

    #[test]
    fn regions_are_aligned_and_do_not_overlap() {
        let plain = spec(5, 19, 3);
        let some = with_images(plain.clone(), &[ImageKind::Rgb, ImageKind::Mask]);
        let all = with_images(plain.clone(), &ImageKind::ALL);
        for (envs, spec) in [(1, &plain), (3, &all), (64, &some), (4096, &plain)] {
            let layout = ReplyLayout::new(envs, spec);
            let regions = layout.regions();
            for pair in regions.windows(2) {
                assert!(pair[0].range(envs).end <= pair[1].offset);
            }
            for region in regions {
                assert_eq!(region.offset % ALIGNMENT, 0);
                assert!(region.range(envs).end <= layout.bytes);
            }
        }
    }

    #[test]
    fn only_pictures_that_are_asked_for_take_room() {
        let layout = ReplyLayout::new(2, &with_images(spec(5, 19, 3), &[ImageKind::Depth]));
        assert_eq!((layout.rgb.width, layout.depth.width, layout.points.width), (0, 30, 0));
        let layout = ReplyLayout::new(2, &spec(5, 19, 3));
        assert_eq!((layout.rgb.width, layout.final_points.width), (0, 0));
    }

    #[test]
    fn what_is_written_in_a_region_is_read_there() {
        let layout = RequestLayout::new(4, &spec(5, 7, 3));
        let mut words = vec![0u64; layout.bytes / 8];
        let payload: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
        layout.actions.view_mut::<f32>(payload, 4).fill(0.5);
        layout.numbers.view_mut::<u64>(payload, 4).copy_from_slice(&[1, 2, 3, u64::MAX]);
        assert!(layout.actions.view::<f32>(payload, 4).iter().all(|value| *value == 0.5));
        assert_eq!(layout.numbers.view::<u64>(payload, 2), [1, 2]);
        assert_eq!(layout.env_ids.view::<u32>(payload, 4), [0; 4]);
    }
}
