//! The arrays of a reply, row by row.

use trocar_proto::wire::ReplyLayout;

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
    pub(crate) rgb: Columns<'a, u8>,
    pub(crate) depth: Columns<'a, f32>,
    pub(crate) mask: Columns<'a, i32>,
    pub(crate) points: Columns<'a, f32>,
    pub(crate) final_rgb: Columns<'a, u8>,
    pub(crate) final_depth: Columns<'a, f32>,
    pub(crate) final_mask: Columns<'a, i32>,
    pub(crate) final_points: Columns<'a, f32>,
}

/// Some rows of one array.
#[derive(Debug)]
pub(crate) struct Columns<'a, T> {
    cells: &'a mut [T],
    width: usize,
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
            rgb: columns!(rgb),
            depth: columns!(depth),
            mask: columns!(mask),
            points: columns!(points),
            final_rgb: columns!(final_rgb),
            final_depth: columns!(final_depth),
            final_mask: columns!(final_mask),
            final_points: columns!(final_points),
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
            rgb,
            depth,
            mask,
            points,
            final_rgb,
            final_depth,
            final_mask,
            final_points
        )
    }
}
