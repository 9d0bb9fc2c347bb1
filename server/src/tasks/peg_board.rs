//! The board with its pegs and the blocks on them, in the scene frame of
//! [`psm_scene`](super::psm_scene).

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use trocar_proto::Rejection;
use trocar_proto::goal::SuccessRule;
use trocar_proto::spec::GoalSpec;

use super::goal;
use super::objects::{self, Object, THEATRE};
use super::options::{self, Domain, Preset};
use super::tray;
use crate::assets::{Model, Scaled};
use crate::render::Scene;
use crate::sim::frames::{self, Aabb, Pose};
use crate::sim::random::Rng;
use crate::sim::world::{BodyId, World};

/// Middle of the board, m. Source: the original.
const ORIGIN: [f64; 3] = [0.55, 0.0, 0.6861];

/// Pegs to which blocks go. Source: the original.
const TARGETS: std::ops::Range<usize> = 0..6;

/// Pegs on which blocks begin. Source: the original.
const SOURCES: std::ops::Range<usize> = 6..12;

/// How far a block is turned at most at the beginning, rad. Source: the original.
const YAW: f64 = 30.0 * PI / 180.0;

/// Distances of a block's middle from its peg's below which the block is on it, m: a block that
/// stands on the board is 3.75 mm lower. Source: the original.
const HORIZONTAL: f64 = 0.005;
const VERTICAL: f64 = 0.004;

/// Colours of the blocks that stay.
const OTHERS: [[f32; 3]; 5] = [
    [0.85, 0.85, 0.83],
    [0.93, 0.72, 0.18],
    [0.55, 0.35, 0.72],
    [0.20, 0.62, 0.60],
    [0.80, 0.42, 0.30],
];

/// Names of the blocks that stay.
const OTHER_NAMES: [&str; 5] =
    ["other block 1", "other block 2", "other block 3", "other block 4", "other block 5"];

/// Largest tilt of a block that stands about a peg, rad.
const LEANING: f64 = 0.02;

/// Deepest overlap of a block that is turned about its peg with its neighbours, m.
const TOUCHING: f64 = 0.02e-3;

/// How far a goal that is asked for may be from the middle of its peg, m.
const AT_PEG: f64 = 1e-3;

/// A block in the world: a triangular ring.
#[derive(Debug, Clone, Copy)]
pub struct Block(Object);

impl Block {
    /// Mass under `preset = "surrol"`, kg. Source: the original.
    const SURROL_MASS: f64 = 0.01;

    /// Its sizes: one below 0.966 counts as not on its peg when it stands about it, and where it is
    /// much larger, blocks on neighbouring pegs have no room.
    pub const SIZE: [f64; 2] = [0.98, 1.1];

    /// Number of its walls.
    pub const WALLS: usize = 3;

    /// The body in the world.
    pub fn body(&self) -> BodyId {
        self.0.body()
    }

    /// Its shapes in this episode.
    pub fn form(&self) -> &Scaled<'static> {
        self.0.form()
    }

    /// The middle of one of its walls (0, 1, 2), scene frame: x towards the axis of the ring, z along
    /// it.
    pub fn scene_from_wall(&self, world: &World, wall: usize) -> Pose {
        world.pose(self.body()) * self.block_from_wall(wall)
    }

    /// The middle of one of its walls (0, 1, 2) in the block.
    pub fn block_from_wall(&self, wall: usize) -> Pose {
        self.form().body_from(["wall_0", "wall_1", "wall_2"][wall])
    }

    /// Half its height, m.
    pub fn half_height(&self) -> f64 {
        self.form().aabb(&Pose::identity()).max.z
    }

    /// Distance of its corners from its axis, m.
    pub fn radius(&self) -> f64 {
        self.wall().min.xy().norm()
    }

    /// Half the thickness of its walls, m.
    pub fn half_wall(&self) -> f64 {
        0.5 * self.wall().extents().x
    }

    /// The box around its first wall, in the block, m.
    fn wall(&self) -> Aabb {
        self.form().parts().next().expect("a block has walls").aabb(&Pose::identity())
    }

    /// The middle of the upper edge of a wall (0, 1, 2) in the block, m.
    fn edge(&self, wall: usize) -> Point3<f64> {
        let middle = self.block_from_wall(wall).translation.vector;
        Point3::from(middle + Vector3::z() * self.half_height())
    }

    /// Places a block whose lengths have grown by `growth`, and which was at `before`. It grows about the middle of the upper edge of
    /// `wall` if it `is_lifted`, otherwise about the point of the board below. Then it is moved by `way`, m. Returns the
    /// movement of the upper edge, m.
    pub fn place_grown(
        &self,
        world: &mut World,
        before: &Pose,
        (wall, growth): (usize, f64),
        is_lifted: bool,
        way: &Vector3<f64>,
    ) -> Vector3<f64> {
        let at = |pose: &Pose, growth: f64| pose * (self.edge(wall) / growth);
        let edge = at(before, growth);
        let mut grown = *before;
        if is_lifted {
            grown.translation.vector += edge - at(before, 1.0);
        } else {
            let fixed = Vector3::new(edge.x, edge.y, PegBoard::top());
            grown.translation.vector = fixed + (before.translation.vector - fixed) * growth;
        }
        grown.translation.vector += way;
        world.place(self.body(), &grown);
        at(&grown, 1.0) - edge
    }

    /// Stands the block on the board about peg `peg`, at rest, turned by `yaw` (rad).
    pub fn stand(&self, world: &mut World, peg: usize, yaw: f64) {
        world.place(self.body(), &standing(self.form(), peg, yaw));
    }
}

/// Where a block stands on the board about peg `peg`.
fn standing(block: &Scaled, peg: usize, yaw: f64) -> Pose {
    let peg = PegBoard::peg(peg);
    let half_height = block.aabb(&Pose::identity()).max.z;
    frames::pose([peg.x, peg.y, PegBoard::top() + half_height], [0.0, 0.0, yaw])
}

/// How an episode begins.
#[derive(Debug, Clone, Copy)]
pub struct Layout {
    /// The block that is to be moved.
    pub block: Block,
    /// The peg to which it is to go.
    pub target: usize,
}

/// The board and what is on it.
#[derive(Debug, Clone)]
pub struct PegBoard {
    blocks: Vec<Block>,
    domain: Domain,
}

impl PegBoard {
    /// Number of its pegs.
    pub const PEGS: usize = 12;

    /// Puts the board and so many blocks into a world, see [`tray::bare_table`]; at most six. Episodes
    /// draw mass and size of all blocks from `domain`.
    pub fn insert(world: &mut World, preset: Preset, blocks: usize, domain: Domain) -> Self {
        tray::furnish(world, Model::pegboard(), ORIGIN);
        let model = Model::block();
        let mass = match preset {
            Preset::Paper => model.mass,
            Preset::Surrol => Block::SURROL_MASS,
        };
        let mut block = |peg| {
            let at = standing(&model.scaled(1.0), peg, 0.0);
            Block(Object::insert(world, model, mass, &at))
        };
        Self { blocks: SOURCES.take(blocks).map(&mut block).collect(), domain }
    }

    /// Height of the board's top, m.
    pub fn top() -> f64 {
        ORIGIN[2] + Model::pegboard().parts[0].aabb(&Pose::identity()).max.z
    }

    /// Middle of a peg (targets 0 to 5, sources 6 to 11), m.
    pub fn peg(index: usize) -> Vector3<f64> {
        let peg = Model::pegboard().body_from(&format!("peg_{index}"));
        peg.translation.vector + Vector3::from(ORIGIN)
    }

    /// The box around a peg, as blocks and fingers meet it, m.
    pub fn peg_box(index: usize) -> Aabb {
        Model::pegboard().parts[1 + index].aabb(&frames::pose(ORIGIN, [0.0; 3]))
    }

    /// Radius of the pegs, as blocks and fingers meet them, m.
    pub fn peg_radius() -> f64 {
        0.5 * Self::peg_box(0).extents().x
    }

    /// The blocks.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// The blocks by name: the one of `layout` as `block`, then the others, as they are drawn.
    pub fn named(&self, layout: &Layout) -> Vec<(&'static str, BodyId)> {
        let others = self.others(layout).map(|(name, block)| (name, block.body()));
        [("block", layout.block.body())].into_iter().chain(others).collect()
    }

    /// The blocks that stay, by name.
    fn others(&self, layout: &Layout) -> impl Iterator<Item = (&'static str, &Block)> {
        let block = layout.block.body();
        OTHER_NAMES.into_iter().zip(self.blocks.iter().filter(move |other| other.body() != block))
    }

    /// Draws the board and its blocks: the one of `layout` as `block`, in its own colour, and a ring about
    /// the peg to which it is to go.
    pub fn draw(&self, world: &World, layout: &Layout, scene: &mut Scene) {
        scene.add_model("board", Model::pegboard(), &frames::pose(ORIGIN, [0.0; 3]));
        layout.block.0.draw(world, "block", scene);
        for ((name, block), colour) in self.others(layout).zip(OTHERS) {
            scene.begin(name);
            let at = world.pose(block.body());
            scene.draw_scaled(block.0.form(), &at, |material| material.coloured(colour));
        }
        let top = Self::peg_box(layout.target).max.z;
        let peg = Self::peg(layout.target);
        scene.add_goal(&Vector3::new(peg.x, peg.y, top), 1.3 * Self::peg_radius());
    }

    /// Stands the blocks on pegs drawn from the sources, at rest, each turned by up to 30° either
    /// way, and draws a block and a target for it.
    pub fn lay_out(&mut self, world: &mut World, rng: &mut Rng) -> Layout {
        if let Some(variation) = self.domain.draw_variation(rng) {
            for block in &mut self.blocks {
                block.0.vary(world, variation);
            }
        }
        let target = Self::draw_target(rng);
        let sources = shuffled(SOURCES, rng);
        for (block, peg) in self.blocks.iter().zip(sources) {
            block.stand(world, peg, rng.uniform(-YAW, YAW));
        }
        Layout { block: self.blocks[rng.index(self.blocks.len())], target }
    }

    /// Draws mass and size of the blocks, if they vary, and turns the blocks that stand about a peg beside the one of
    /// `layout`; that one must be placed anew. Returns the factor on its lengths.
    pub fn vary(
        &mut self,
        world: &mut World,
        layout: &mut Layout,
        rng: &mut Rng,
        objects: bool,
    ) -> f64 {
        let body = layout.block.body();
        let size = layout.block.form().size();
        let variation = self.domain.draw_variation(rng).filter(|_| objects);
        for block in &mut self.blocks {
            if let Some(variation) = variation {
                block.0.vary(world, variation);
            }
            if block.body() == body {
                layout.block = *block;
                continue;
            }
            let yaw = rng.uniform(-YAW, YAW);
            let before = world.pose(block.body());
            let is_upright = (before.rotation * Vector3::z()).z > libm::cos(LEANING);
            let peg = SOURCES.into_iter().find(|peg| Self::is_on(world, *block, *peg));
            let Some(peg) = peg.filter(|_| is_upright) else { continue };
            block.stand(world, peg, yaw);
            if world.overlap(block.body(), |_| true) > TOUCHING {
                let [_, _, yaw] = frames::euler_xyz(&before.rotation);
                block.stand(world, peg, yaw);
            }
        }
        layout.block.form().size() / size
    }

    /// A peg drawn from the targets.
    pub fn draw_target(rng: &mut Rng) -> usize {
        TARGETS.start + rng.index(TARGETS.len())
    }

    /// The target whose middle, which is the desired goal, is at `goal` (m).
    pub fn target_at(goal: &Vector3<f64>) -> Result<usize, Rejection> {
        let mut targets = TARGETS;
        targets.find(|peg| (goal - Self::peg(*peg)).norm() < AT_PEG).ok_or_else(|| {
            let middle = |peg| {
                let [x, y, z] = Self::peg(peg).into();
                format!("[{x:.4}, {y:.4}, {z:.4}]")
            };
            let pegs: Vec<_> = TARGETS.map(middle).collect();
            let allowed = format!("allowed are the middles of the targets: {}", pegs.join(", "));
            goal::refuse(goal, &allowed)
        })
    }

    /// Whether a block is on a peg: as the goal's rule has it.
    pub fn is_on(world: &World, block: Block, peg: usize) -> bool {
        let off = world.pose(block.body()).translation.vector - Self::peg(peg);
        off.xy().norm() < HORIZONTAL && off.z.abs() < VERTICAL
    }

    /// The goal of bringing a block onto a peg: the middle of the one to that of the other.
    pub fn goal_spec(preset: Preset) -> GoalSpec {
        let scale = options::position_scale(preset);
        GoalSpec {
            elements: objects::position_elements("block", &THEATRE, preset),
            success: SuccessRule::Seated {
                horizontal: (HORIZONTAL * scale) as f32,
                vertical: (VERTICAL * scale) as f32,
            },
        }
    }
}

/// The numbers of `range` in an order drawn at random.
fn shuffled(range: std::ops::Range<usize>, rng: &mut Rng) -> Vec<usize> {
    let mut numbers: Vec<_> = range.collect();
    for last in (1..numbers.len()).rev() {
        numbers.swap(last, rng.index(last + 1));
    }
    numbers
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board(preset: Preset, blocks: usize) -> (World, PegBoard) {
        let mut world = tray::bare_table(preset);
        let board = PegBoard::insert(&mut world, preset, blocks, Domain::default());
        (world, board)
    }

    #[test]
    fn blocks_rest_where_they_are_put() {
        for preset in [Preset::Paper, Preset::Surrol] {
            let (mut world, mut board) = board(preset, 6);
            let mut rng = Rng::new(1, 0);
            for _ in 0..4 {
                board.lay_out(&mut world, &mut rng);
                assert!(world.at_rest());
                let poses: Vec<_> = board.blocks().iter().map(|b| world.pose(b.body())).collect();
                for block in board.blocks() {
                    world.wake(block.body());
                }
                for _ in 0..240 {
                    world.advance();
                }
                assert!(world.at_rest(), "they fall asleep again");
                for (block, put) in board.blocks().iter().zip(poses) {
                    let moved = world.pose(block.body()).inv_mul(&put);
                    assert!(moved.translation.vector.norm() < 0.02e-3, "{moved}");
                    assert!(moved.rotation.angle() < 1e-3, "{moved}");
                    let bottom = world.pose(block.body()).translation.z - block.half_height();
                    assert!(PegBoard::top() - bottom < 0.1e-3, "sunk into the board");
                }
            }
        }
    }

    #[test]
    fn every_episode_has_its_pegs_blocks_and_target() {
        let (mut world, mut board) = board(Preset::Paper, 4);
        let mut rng = Rng::new(2, 0);
        let (mut sources, mut targets, mut chosen) = ([0; 12], [0; 12], [0; 4]);
        for _ in 0..600 {
            let layout = board.lay_out(&mut world, &mut rng);
            targets[layout.target] += 1;
            let is_layouts = |block: &Block| block.body() == layout.block.body();
            chosen[board.blocks().iter().position(is_layouts).unwrap()] += 1;
            for block in board.blocks() {
                let on: Vec<_> =
                    (0..12).filter(|peg| PegBoard::is_on(&world, *block, *peg)).collect();
                assert_eq!(on.len(), 1, "each block is on one peg");
                sources[on[0]] += 1;
                let [_, _, yaw] = frames::euler_xyz(&world.pose(block.body()).rotation);
                assert!(yaw.abs() <= YAW + 1e-6);
            }
        }
        // Standard deviations are below 12.
        assert!(targets[TARGETS].iter().all(|n: &i32| (*n - 100).abs() < 50), "{targets:?}");
        assert!(sources[SOURCES].iter().all(|n: &i32| (*n - 400).abs() < 60), "{sources:?}");
        assert!(chosen.iter().all(|n: &i32| (*n - 150).abs() < 55), "{chosen:?}");
    }

    #[test]
    fn pegs_are_where_the_original_has_them() {
        assert!((PegBoard::peg(0) - Vector3::new(0.52, 0.043, 0.7081)).norm() < 1e-9);
        assert!((PegBoard::peg(11) - Vector3::new(0.5515, -0.046_919, 0.7081)).norm() < 1e-9);
        assert!((PegBoard::top() - 0.6971).abs() < 1e-9);
        let peg = PegBoard::peg_box(7);
        assert!((peg.extents() - Vector3::new(0.002, 0.002, 0.028)).norm() < 1e-9);
        assert!((peg.centre() - PegBoard::peg(7)).norm() < 1e-9);
        let (_, board) = board(Preset::Paper, 1);
        let block = board.blocks()[0];
        assert!((block.half_height() - 0.00725).abs() < 1e-9);
        assert!((block.half_wall() - 0.0008).abs() < 1e-9);
        assert!((block.radius() - 0.00904).abs() < 1e-5);
    }
}
