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

/// Half extents, m.
pub const HALF: Vector3<f64> = Vector3::new(0.03, 0.03, 4e-3);

/// Middle of the sheet, x and y, m.
const MIDDLE: [f64; 2] = [0.545, 0.0];

/// Edge of an element, m.
const SPACING: f64 = 5e-3;

/// How much of the held edge is held, m: the first layer of nodes.
const HELD: f64 = 1e-3;

/// What it is made of: fat that is compressed by a third has about this Young's modulus, and fat that is compressed to half
/// its thickness or less those that `domain` may have.
const SUBSTANCE: Substance = Substance { material: "fat", modulus: 5e3, moduli: [3e3, 8e3] };

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
}

impl Sheet {
    /// The rows of `domain` that say what it is like.
    pub fn rows() -> [RowSpec; 2] {
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
        let sheet = Self { soft: world.insert_soft(body), observed, domain };
        settle(&mut world);
        Ok((world, sheet))
    }

    /// Where it lies, undeformed.
    pub fn pose() -> Pose {
        let [x, y] = MIDDLE;
        Pose::translation(x, y, tray::pad().max.z + HALF.z)
    }

    /// Draws this episode's friction and modulus, where they vary, and lets a sheet of another modulus come to rest.
    pub fn vary(&mut self, world: &mut World, rng: &mut Rng) {
        SUBSTANCE.vary(&self.domain, self.soft, world, rng);
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
}

impl Substance {
    /// The rows of `domain` that say what it is like.
    pub fn rows(&self) -> [RowSpec; 2] {
        let friction = Material::named(self.material).expect("it is in the table").friction;
        options::tissue_rows(self.modulus, self.moduli, friction.profiled)
    }

    /// The form that `carve` makes of it, as stiff as `domain` has it at most.
    pub fn form(
        &self,
        domain: &Domain,
        carve: impl FnOnce(Material) -> Result<Form, MaterialError>,
    ) -> Result<Form, Rejection> {
        let stiffest = domain.modulus.greatest().unwrap_or(self.modulus);
        let material = Material::named(self.material).map(|soft| soft.with_modulus(stiffest));
        material.and_then(carve).map_err(|error| {
            let field = "options.domain.modulus";
            Rejection::new(Code::InvalidOption, field, stiffest.to_string(), error.to_string())
        })
    }

    /// Draws an episode's friction and modulus, where they vary, and lets a body of another modulus come to rest.
    pub fn vary(&self, domain: &Domain, soft: SoftId, world: &mut World, rng: &mut Rng) {
        let Domain { modulus, friction, .. } = domain;
        if let Some(profiled) = friction.draw_if_given(rng) {
            let smooth = world.soft(soft).lattice().form().material().friction.smooth;
            world.soft_mut(soft).set_friction(Friction { smooth, profiled });
        }
        if let (Some(drawn), Some(greatest)) = (modulus.draw_if_given(rng), modulus.greatest()) {
            world.soft_mut(soft).soften(drawn / greatest);
            settle(world);
        }
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
