//! The arrays of a reply, row by row.

use trocar_proto::wire::ReplyLayout;

use crate::env::Shot;
use crate::render::Scene;

/// The first rows of every array of a reply, to be written. Widths in elements; see
/// [`ReplyLayout`] for what they mean.
#[derive(Debug)]
pub(crate) struct Rows<'a> {
    pub(crate) observation: Columns<'a, f32>,
    pub(crate) achieved_goal: Columns<'a, f32>,
    pub(crate) desired_goal: Columns<'a, f32>,
    pub(crate) reward: Columns<'a, f32>,
    pub(crate) terminated: Columns<'a, u8>,
    pub(crate) truncated: Columns<'a, u8>,
    pub(crate) is_success: Columns<'a, u8>,
    pub(crate) fault: Columns<'a, u8>,
    pub(crate) steps: Columns<'a, u32>,
    pub(crate) seed: Columns<'a, u64>,
    pub(crate) episode: Columns<'a, u64>,
    pub(crate) final_observation: Columns<'a, f32>,
    pub(crate) final_achieved_goal: Columns<'a, f32>,
    pub(crate) final_desired_goal: Columns<'a, f32>,
    pub(crate) expert_action: Columns<'a, f32>,
    pub(crate) expert_stage: Columns<'a, u8>,
    pub(crate) snapshot: Columns<'a, u64>,
    pub(crate) pictures: Pictures<'a>,
    pub(crate) final_pictures: Pictures<'a>,
}

/// The pictures of some rows.
#[derive(Debug, Default)]
pub(crate) struct Pictures<'a> {
    rgb: Columns<'a, u8>,
    depth: Columns<'a, f32>,
    mask: Columns<'a, i32>,
    points: Columns<'a, f32>,
}

impl<'a> Pictures<'a> {
    /// What there is to see in each row, where its pictures go.
    pub(crate) fn shots<S>(self, scenes: S) -> impl Iterator<Item = Shot<'a>>
    where
        S: IntoIterator<Item = Option<Scene>>,
    {
        let (rgb, depth) = (self.rgb.into_rows(), self.depth.into_rows());
        let (mask, points) = (self.mask.into_rows(), self.points.into_rows());
        let rows = rgb.zip(depth).zip(mask.zip(points));
        scenes.into_iter().zip(rows).filter_map(|(scene, ((rgb, depth), (mask, points)))| {
            Some(Shot { scene: scene?, rgb, depth, mask, points })
        })
    }

    pub(crate) fn split_at(self, at: usize) -> (Self, Self) {
        let (rgb, later_rgb) = self.rgb.split_at(at);
        let (depth, later_depth) = self.depth.split_at(at);
        let (mask, later_mask) = self.mask.split_at(at);
        let (points, later_points) = self.points.split_at(at);
        let later =
            Self { rgb: later_rgb, depth: later_depth, mask: later_mask, points: later_points };
        (Self { rgb, depth, mask, points }, later)
    }
}

/// Some rows of one array.
#[derive(Debug)]
pub(crate) struct Columns<'a, T> {
    cells: &'a mut [T],
    width: usize,
}

impl<T> Default for Columns<'_, T> {
    fn default() -> Self {
        Self { cells: &mut [], width: 0 }
    }
}

impl<'a, T> Columns<'a, T> {
    /// All rows, and empty ones without end where a row is empty.
    fn into_rows(self) -> impl Iterator<Item = &'a mut [T]> {
        let is_empty = self.width == 0;
        let rows = self.cells.chunks_exact_mut(self.width.max(1));
        rows.chain(std::iter::repeat_with(Default::default).take_while(move |_| is_empty))
    }
}

impl<T> Columns<'_, T> {
    /// Row `row`.
    pub(crate) fn row(&mut self, row: usize) -> &mut [T] {
        &mut self.cells[row * self.width..(row + 1) * self.width]
    }

    fn split_at(self, rows: usize) -> (Self, Self) {
        let Self { cells, width } = self;
        let (first, second) = cells.split_at_mut(rows * width);
        (Self { cells: first, width }, Self { cells: second, width })
    }
}

impl<'a> Rows<'a> {
    /// The first `rows` rows of a reply's payload.
    ///
    /// # Panics
    /// Where the payload is shorter than its layout.
    pub(crate) fn of(layout: &ReplyLayout, payload: &'a mut [u8], rows: usize) -> Self {
        // Regions lie one after another: each takes its part from the front of what is left.
        let mut rest = payload;
        let mut done = 0;
        macro_rules! columns {
            ($region:ident) => {{
                let region = layout.$region;
                let range = region.range(rows);
                let (skipped, tail) = std::mem::take(&mut rest).split_at_mut(range.end - done);
                let bytes = &mut skipped[range.start - done..];
                rest = tail;
                done = range.end;
                Columns { cells: bytemuck::cast_slice_mut(bytes), width: region.width }
            }};
        }
        let rows = Self {
            observation: columns!(observation),
            achieved_goal: columns!(achieved_goal),
            desired_goal: columns!(desired_goal),
            reward: columns!(reward),
            terminated: columns!(terminated),
            truncated: columns!(truncated),
            is_success: columns!(is_success),
            fault: columns!(fault),
            steps: columns!(steps),
            seed: columns!(seed),
            episode: columns!(episode),
            final_observation: columns!(final_observation),
            final_achieved_goal: columns!(final_achieved_goal),
            final_desired_goal: columns!(final_desired_goal),
            expert_action: columns!(expert_action),
            expert_stage: columns!(expert_stage),
            snapshot: columns!(snapshot),
            pictures: Pictures {
                rgb: columns!(rgb),
                depth: columns!(depth),
                mask: columns!(mask),
                points: columns!(points),
            },
            final_pictures: Pictures {
                rgb: columns!(final_rgb),
                depth: columns!(final_depth),
                mask: columns!(final_mask),
                points: columns!(final_points),
            },
        };
        debug_assert!(done + rest.len() == layout.bytes);
        rows
    }

    /// The first `at` rows, and the rest.
    pub(crate) fn split_at(self, at: usize) -> (Self, Self) {
        macro_rules! split {
            ($($field:ident),*) => {{
                $(let $field = self.$field.split_at(at);)*
                (Self { $($field: $field.0),* }, Self { $($field: $field.1),* })
            }};
        }
        split!(
            observation,
            achieved_goal,
            desired_goal,
            reward,
            terminated,
            truncated,
            is_success,
            fault,
            steps,
            seed,
            episode,
            final_observation,
            final_achieved_goal,
            final_desired_goal,
            expert_action,
            expert_stage,
            snapshot,
            pictures,
            final_pictures
        )
    }
}
