//! The arrays of a reply, row by row.

use std::mem::take;

use trocar_proto::columns::Flag;
use trocar_proto::wire::{Region, ReplyLayout};

use crate::env::{Shot, Step};
use crate::render::Scene;

/// The pictures of some rows.
#[derive(Debug, Default)]
pub(crate) struct Pictures<'a> {
    rgb: Column<'a, u8>,
    depth: Column<'a, f32>,
    mask: Column<'a, i32>,
    points: Column<'a, f32>,
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
pub(crate) struct Column<'a, T> {
    cells: &'a mut [T],
    width: usize,
}

impl<T> Default for Column<'_, T> {
    fn default() -> Self {
        Self { cells: &mut [], width: 0 }
    }
}

impl<'a, T> Column<'a, T> {
    /// All rows, and empty ones without end where a row is empty.
    fn into_rows(self) -> impl Iterator<Item = &'a mut [T]> {
        let is_empty = self.width == 0;
        let rows = self.cells.chunks_exact_mut(self.width.max(1));
        rows.chain(std::iter::repeat_with(Default::default).take_while(move |_| is_empty))
    }
}

impl<T> Column<'_, T> {
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

macro_rules! rows {
    ($($(#[$doc:meta])* $name:ident: $element:ident [$width:ident] $role:tt;)*) => {
        /// The first rows of every array of a reply, to be written.
        #[derive(Debug)]
        pub(crate) struct Rows<'a> {
            $($(#[$doc])* pub(crate) $name: Column<'a, $element>,)*
        }

        impl<'a> Rows<'a> {
            /// The first `rows` rows of a reply's payload.
            ///
            /// # Panics
            /// Where the payload is shorter than its layout.
            pub(crate) fn of(layout: &ReplyLayout, payload: &'a mut [u8], rows: usize) -> Self {
                // Regions lie one after another: each takes its part from the front of what is left.
                let mut left = Left { bytes: payload, done: 0 };
                let rows = Self { $($name: left.take(layout.$name, rows)),* };
                debug_assert!(left.done + left.bytes.len() == layout.bytes);
                rows
            }

            /// The first `at` rows, and the rest.
            pub(crate) fn split_at(self, at: usize) -> (Self, Self) {
                $(let $name = self.$name.split_at(at);)*
                (Self { $($name: $name.0),* }, Self { $($name: $name.1),* })
            }

            /// Writes what a step brought; `fault` is the code of a failure, or 0.
            pub(crate) fn write_step(&mut self, row: usize, step: &Step, fault: u8) {
                $(trocar_proto::if_step!($role if let Some(number) = self.$name.row(row).first_mut() {
                    *number = step.$name.into();
                });)*
                self.fault.row(row)[0] = fault;
            }
        }
    };
}

trocar_proto::reply_columns!(rows);

impl<'a> Rows<'a> {
    /// Where pictures go: of states, and of the last states of episodes that were replaced. Nothing is left of them.
    pub(crate) fn take_pictures(&mut self) -> [Pictures<'a>; 2] {
        let Self { rgb, depth, mask, points, .. } = self;
        let now =
            Pictures { rgb: take(rgb), depth: take(depth), mask: take(mask), points: take(points) };
        let Self {
            final_rgb: rgb, final_depth: depth, final_mask: mask, final_points: points, ..
        } = self;
        let last =
            Pictures { rgb: take(rgb), depth: take(depth), mask: take(mask), points: take(points) };
        [now, last]
    }
}

/// What of a payload no column has taken yet.
struct Left<'a> {
    bytes: &'a mut [u8],
    /// Bytes before it.
    done: usize,
}

impl<'a> Left<'a> {
    /// The first `rows` rows of a region.
    fn take<T: bytemuck::Pod>(&mut self, region: Region, rows: usize) -> Column<'a, T> {
        let range = region.range(rows);
        let (skipped, rest) = take(&mut self.bytes).split_at_mut(range.end - self.done);
        let cells = bytemuck::cast_slice_mut(&mut skipped[range.start - self.done..]);
        (self.bytes, self.done) = (rest, range.end);
        Column { cells, width: region.width }
    }
}
