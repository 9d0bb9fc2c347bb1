//! A sheet of fat that one edge holds, on the pad in the tray, in the scene frame of
//! [`psm_scene`](super::psm_scene).
//!
//! The sheet is 60 mm × 60 mm × 8 mm. Its edge at the lowest x is held where it is; the free edge faces the endoscope.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_proto::spec::RowSpec;
use trocar_proto::{Code, Rejection};

use super::options::{self, Domain, Preset};
use super::tray;
use crate::sim::frames::{Aabb, Pose};
use crate::sim::random::Rng;
use crate::sim::soft::{
    Form, Friction, Material, MaterialError, MaterialPoint, Skin, SoftBody, box_distance,
};
use crate::sim::world::{SoftId, World};

/// Thickness where `domain` has none, m.
const THICKNESS: f64 = 8e-3;

/// Half extents then, m.
pub const HALF: Vector3<f64> = Vector3::new(0.03, 0.03, 0.5 * THICKNESS);

/// Middle of the sheet, x and y, m.
const MIDDLE: [f64; 2] = [0.545, 0.0];

/// Edge of an element, m.
const SPACING: f64 = 5e-3;

/// How much of the held edge is held, m: the first layer of nodes.
const HELD: f64 = 1e-3;

/// What it is made of: fat that is compressed by a third has about this Young's modulus, and fat that is compressed to half
/// its thickness or less those that `domain` may have.
const SUBSTANCE: Substance = Substance {
    material: "fat",
    modulus: 5e3,
    moduli: [3e3, 8e3],
    thickness: THICKNESS,
    thicknesses: [6e-3, 10e-3],
};

/// Substeps within which a sheet comes to rest.
const SETTLING: u32 = 4800;

/// Colour in pictures.
const COLOUR: [f32; 3] = [0.93, 0.78, 0.42];

/// Points of the upper face that the state has: x and y, m, sheet's frame.
const OBSERVED: [[f64; 3]; 2] = [[5e-3, 17e-3, 29e-3], [-29e-3, -10e-3, 10e-3]];

/// The sheet in the world.
#[derive(Debug, Clone)]
pub struct Sheet {
    soft: SoftId,
    observed: Vec<MaterialPoint>,
    domain: Domain,
    /// Of this episode, m.
    thickness: f64,
}

impl Sheet {
    /// The rows of `domain` that say what it is like.
    pub fn rows() -> Vec<RowSpec> {
        SUBSTANCE.rows()
    }

    /// A world with table, tray, pad and the sheet on it, at rest.
    pub fn furnish(domain: Domain) -> Result<(World, Self), Rejection> {
        let bounds = Aabb { min: -HALF, max: HALF };
        let distance = box_distance(&HALF);
        let mut form = SUBSTANCE
            .form(&domain, |material| Form::carved(&bounds, SPACING, material, &distance))?;
        form.hold(|point| point.x < HELD - HALF.x);
        let skin = Skin::new(&form, &bounds, SPACING, &distance);
        let [xs, ys] = OBSERVED;
        let observed = ys.iter().chain(&[29e-3]).flat_map(|y| {
            xs.iter().map(|x| MaterialPoint::of(&form, &Point3::new(*x, *y, HALF.z)))
        });
        let observed = observed.collect();
        let mut world = tray::furnished_world(Preset::Paper);
        let body = SoftBody::new("sheet", COLOUR, Arc::new(form), Arc::new(skin), &Self::pose());
        let thickness = SUBSTANCE.thickness;
        let sheet = Self { soft: world.insert_soft(body), observed, domain, thickness };
        settle(&mut world);
        Ok((world, sheet))
    }

    /// Where it lies, undeformed.
    pub fn pose() -> Pose {
        let [x, y] = MIDDLE;
        Pose::translation(x, y, tray::pad().max.z + HALF.z)
    }

    /// Draws what this episode's sheet is like, where that varies, and lets it come to rest.
    pub fn vary(&mut self, world: &mut World, rng: &mut Rng) {
        self.thickness = SUBSTANCE.vary(&self.domain, self.soft, &Self::pose(), world, rng);
    }

    /// Height of its upper face where it lies undeformed, m.
    pub fn top(&self) -> f64 {
        let half = 0.5 * self.thickness;
        tray::pad().max.z + half + half
    }

    /// The body in the world.
    pub fn soft(&self) -> SoftId {
        self.soft
    }

    /// The point of its upper face with these x and y, m, sheet's frame.
    pub fn upper_point(&self, world: &World, [x, y]: [f64; 2]) -> MaterialPoint {
        let form = world.soft(self.soft).lattice().form();
        MaterialPoint::of(form, &Point3::new(x, y, HALF.z))
    }

    /// Where a point of it is, m.
    pub fn at(&self, world: &World, point: &MaterialPoint) -> Vector3<f64> {
        world.soft(self.soft).lattice().point(point).coords
    }

    /// Where the points are that the state has, m.
    pub fn observed<'a>(&'a self, world: &'a World) -> impl Iterator<Item = Vector3<f64>> + 'a {
        world.soft(self.soft).points(&self.observed).map(|point| point.coords)
    }

    /// How many points the state has.
    pub fn observed_count(&self) -> usize {
        self.observed.len()
    }
}

/// What a soft body of a task is made of.
#[derive(Debug, Clone, Copy)]
pub struct Substance {
    /// Its row in `assets/materials.csv`.
    pub material: &'static str,
    /// Young's modulus where `domain` has none, Pa.
    pub modulus: f64,
    /// Young's moduli that `domain` may have, Pa: from, to.
    pub moduli: [f64; 2],
    /// Thickness where `domain` has none, m.
    pub thickness: f64,
    /// Thicknesses that `domain` may have, m: from, to.
    pub thicknesses: [f64; 2],
}

/// Ultimate strains that `domain` may have: from, to.
const STRENGTHS: [f64; 2] = [0.1, 1.0];

impl Substance {
    /// The rows of `domain` that say what it is like.
    pub fn rows(&self) -> Vec<RowSpec> {
        let material = Material::named(self.material).expect("it is in the table");
        let row = options::tissue_row;
        let friction = "Friction coefficient of profiled jaws on it";
        let mut rows = vec![
            row("modulus", "Young's modulus of what is soft, Pa", self.modulus, self.moduli),
            row("friction", friction, material.friction.profiled, [0.1, 2.0]),
            row("thickness", "Thickness of what is soft, m", self.thickness, self.thicknesses),
        ];
        if let Some(strain) = material.ultimate_strain {
            rows.push(row("strength", "Ultimate strain of what is soft", strain, STRENGTHS));
        }
        rows
    }

    /// The form that `carve` makes of it, of its usual thickness and as stiff as `domain` has it at most.
    pub fn form(
        &self,
        domain: &Domain,
        carve: impl FnOnce(Material) -> Result<Form, MaterialError>,
    ) -> Result<Form, Rejection> {
        let stiffest = domain.modulus.greatest().unwrap_or(self.modulus);
        let thinnest = domain.thickness.least().unwrap_or(self.thickness);
        let material = Material::named(self.material).map(|soft| soft.with_modulus(stiffest));
        let form = material.and_then(carve);
        form.and_then(|form| form.thickened(thinnest / self.thickness).and(Ok(form))).map_err(
            |error| {
                let field = "options.domain.modulus";
                Rejection::new(Code::InvalidOption, field, stiffest.to_string(), error.to_string())
            },
        )
    }

    /// Draws what an episode's body is like, where that varies, and lets one of another modulus or thickness come to rest
    /// on what lies under `world_from_body`, where it lies when it is as thick as usual. Returns its thickness, m.
    pub fn vary(
        &self,
        domain: &Domain,
        soft: SoftId,
        world_from_body: &Pose,
        world: &mut World,
        rng: &mut Rng,
    ) -> f64 {
        let Domain { modulus, friction, thickness, strength, .. } = domain;
        if let Some(profiled) = friction.draw_if_given(rng) {
            let smooth = world.soft(soft).lattice().form().material().friction.smooth;
            world.soft_mut(soft).set_friction(Friction { smooth, profiled });
        }
        if let (Some(drawn), Some(greatest)) = (modulus.draw_if_given(rng), modulus.greatest()) {
            world.soft_mut(soft).soften(drawn / greatest);
        }
        let drawn = thickness.draw_if_given(rng);
        if let Some(drawn) = drawn {
            let raised = Pose::from(Vector3::z() * (0.5 * (drawn - self.thickness)));
            let thickened =
                world.soft_mut(soft).thicken(drawn / self.thickness, &(raised * world_from_body));
            thickened.expect("the thinnest was possible");
        }
        if let Some(strain) = strength.draw_if_given(rng) {
            world.soft_mut(soft).set_ultimate_strain(Some(strain));
        }
        settle(world);
        drawn.unwrap_or(self.thickness)
    }
}

/// Lets a world come to rest.
pub fn settle(world: &mut World) {
    for _ in 0..SETTLING {
        if world.at_rest() {
            return;
        }
        world.advance();
    }
}
