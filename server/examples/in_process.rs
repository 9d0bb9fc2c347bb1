//! One environment without a server, for programs that load C libraries: what
//! `client-py/benches/async_vector_env.py` gives to Gymnasium's worker processes, and what
//! `client-py/benches/tiny_renderer.py` draws.
//!
//! An environment is used by one thread at a time. Arrays are float32 of the specification's sizes,
//! which [`trocar_dims`] tells; `outcome` is reward, terminated, truncated, success.

#![allow(unsafe_code)]

use std::ffi::{CStr, c_char};
use std::slice::{from_raw_parts, from_raw_parts_mut};

use trocar_server::Registry;
use trocar_server::render::camera::extrinsics;
use trocar_server::render::light::Lamp;
use trocar_server::render::{Canvas, Lens, Renderer, Scene, Software, material};
use trocar_server::{Env, Step};

/// Where what is seen goes: observation, achieved goal, desired goal.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Seen {
    observation: *mut f32,
    achieved: *mut f32,
    desired: *mut f32,
}

impl Seen {
    /// The arrays of an environment like `env`.
    ///
    /// # Safety
    /// They have its sizes, and no other code uses them meanwhile.
    unsafe fn arrays<'a>(self, env: &Env) -> [&'a mut [f32]; 3] {
        let (observation, goal) = (env.spec().observation_dim(), env.spec().goal_dim());
        // SAFETY: the caller's promise.
        unsafe {
            [
                from_raw_parts_mut(self.observation, observation),
                from_raw_parts_mut(self.achieved, goal),
                from_raw_parts_mut(self.desired, goal),
            ]
        }
    }
}

/// An environment of a task with its default options; null where there is no such task.
///
/// # Safety
/// `task` is a text that ends with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_make(task: *const c_char) -> *mut Env {
    // SAFETY: the caller's promise.
    let task = unsafe { CStr::from_ptr(task) }.to_str().unwrap_or_default();
    let made = Registry::builtin().make(task, &trocar_proto::Options::new());
    made.map_or(std::ptr::null_mut(), |env| Box::into_raw(Box::new(env)))
}

/// Ends an environment.
///
/// # Safety
/// `env` comes from [`trocar_make`] and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_free(env: *mut Env) {
    // SAFETY: the caller's promise.
    drop(unsafe { Box::from_raw(env) });
}

/// Sizes of actions, observations and goals.
///
/// # Safety
/// `env` comes from [`trocar_make`], `dims` has room for three numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_dims(env: *const Env, dims: *mut [u32; 3]) {
    // SAFETY: the caller's promise.
    let (spec, dims) = unsafe { ((*env).spec(), &mut *dims) };
    *dims = [spec.action_dim(), spec.observation_dim(), spec.goal_dim()].map(|dim| dim as u32);
}

/// Begins an episode: the first of `seed`, or the next where `seed` is negative.
///
/// # Safety
/// `env` comes from [`trocar_make`]; `seen` has its sizes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_reset(env: *mut Env, seed: i64, seen: Seen) {
    // SAFETY: the caller's promise.
    let env = unsafe { &mut *env };
    env.reset(u64::try_from(seed).ok());
    // SAFETY: the caller's promise.
    let [observation, achieved, desired] = unsafe { seen.arrays(env) };
    env.observe(observation, achieved, desired);
}

/// Lets one step pass; false where the action is refused or the simulation fails.
///
/// # Safety
/// `env` comes from [`trocar_make`]; `action` and `seen` have its sizes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_step(
    env: *mut Env,
    action: *const f32,
    seen: Seen,
    outcome: *mut [f32; 4],
) -> bool {
    // SAFETY: the caller's promise.
    let (env, outcome) = unsafe { (&mut *env, &mut *outcome) };
    // SAFETY: the caller's promise.
    let action = unsafe { from_raw_parts(action, env.spec().action_dim()) };
    // SAFETY: the caller's promise.
    let [observation, achieved, desired] = unsafe { seen.arrays(env) };
    let Ok(step) = env.step_into(action, observation, achieved, desired) else { return false };
    let Step { reward, terminated, truncated, is_success, .. } = step;
    *outcome = [reward, terminated.into(), truncated.into(), is_success.into()];
    true
}

/// Begins the first episode of `seed` and takes so many steps of the scripted expert; false where one fails.
///
/// # Safety
/// `env` comes from [`trocar_make`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_follow_expert(env: *mut Env, seed: u64, steps: u32) -> bool {
    // SAFETY: the caller's promise.
    let env = unsafe { &mut *env };
    env.reset(Some(seed));
    let mut action = vec![0.0; env.spec().action_dim()];
    (0..steps).all(|_| {
        env.expert(&mut action);
        env.step(&action).is_ok()
    })
}

/// Number of meshes that there are to see.
///
/// # Safety
/// `env` comes from [`trocar_make`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_meshes(env: *const Env) -> u32 {
    // SAFETY: the caller's promise.
    unsafe { &*env }.scene().instances().len() as u32
}

/// Number of the body of a mesh, and how many vertices and triangles it has.
///
/// # Safety
/// `env` comes from [`trocar_make`] and has more than `index` meshes; `sizes` has room for three numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_mesh_sizes(env: *const Env, index: u32, sizes: *mut [u32; 3]) {
    // SAFETY: the caller's promise.
    let (scene, sizes) = unsafe { ((*env).scene(), &mut *sizes) };
    let instance = &scene.instances()[index as usize];
    *sizes =
        [instance.body as u32, instance.mesh.vertices().count() as u32, instance.mesh.len() as u32];
}

/// Vertices of a mesh (x, y, z each, m, in the world), triangles (numbers of three vertices each) and colour
/// (red, green, blue as pictures store it, in 0 to 1).
///
/// # Safety
/// `env` comes from [`trocar_make`] and has more than `index` meshes; the arrays have room for what
/// [`trocar_mesh_sizes`] tells.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_mesh(
    env: *const Env,
    index: u32,
    vertices: *mut f32,
    triangles: *mut u32,
    colour: *mut [f32; 3],
) {
    // SAFETY: the caller's promise.
    let scene = unsafe { &*env }.scene();
    let instance = &scene.instances()[index as usize];
    let (count, mesh) = (instance.mesh.vertices().count(), &instance.mesh);
    // SAFETY: the caller's promise.
    let (vertices, triangles, colour) = unsafe {
        let vertices = from_raw_parts_mut(vertices.cast::<[f32; 3]>(), count);
        (vertices, from_raw_parts_mut(triangles.cast::<[u32; 3]>(), mesh.len()), &mut *colour)
    };
    for (out, vertex) in vertices.iter_mut().zip(mesh.vertices()) {
        let at = instance.world_from_mesh * (vertex.cast::<f64>() * instance.size);
        *out = [at.x as f32, at.y as f32, at.z as f32];
    }
    triangles.copy_from_slice(mesh.triangles());
    *colour = instance.material.colour.map(material::stored);
}

/// A camera in OpenCV's convention, and its light.
#[repr(C)]
pub struct CameraData {
    camera_from_world: [[f64; 4]; 3],
    /// fx, fy, cx, cy.
    intrinsics: [f64; 4],
    near: f64,
    far: f64,
    towards_lamp: [f64; 3],
}

fn lens(number: u32) -> Lens {
    if number == 0 { Lens::Endoscope } else { Lens::Overview }
}

/// The camera of a lens: 0 is the endoscope, 1 the overview. False where there is none.
///
/// # Safety
/// `env` comes from [`trocar_make`]; `data` has room for the camera.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_camera(
    env: *const Env,
    number: u32,
    width: u32,
    height: u32,
    data: *mut CameraData,
) -> bool {
    // SAFETY: the caller's promise.
    let (scene, data) = unsafe { ((*env).scene(), &mut *data) };
    let camera = scene.camera(lens(number), width as usize, height as usize);
    let Some(camera) = camera else { return false };
    let Lamp::Far(towards_lamp) = scene.light.place else { return false };
    let intrinsics = camera.intrinsics;
    *data = CameraData {
        camera_from_world: extrinsics(&camera.world_from_camera),
        intrinsics: [intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy],
        near: camera.near,
        far: camera.far,
        towards_lamp: towards_lamp.into(),
    };
    true
}

/// Draws colour, depth (m) and bodies as observations have them, with the scene put together anew. False where
/// there is no such camera.
///
/// # Safety
/// `env` comes from [`trocar_make`]; the arrays have room for `height` × `width` pixels.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn trocar_draw(
    env: *const Env,
    number: u32,
    width: u32,
    height: u32,
    rgb: *mut u8,
    depth: *mut f32,
    mask: *mut i32,
) -> bool {
    // SAFETY: the caller's promise.
    let scene: Scene = unsafe { &*env }.scene();
    let camera = scene.camera(lens(number), width as usize, height as usize);
    let Some(camera) = camera else { return false };
    let pixels = width as usize * height as usize;
    // SAFETY: the caller's promise.
    let canvas = unsafe {
        Canvas {
            rgb: Some(from_raw_parts_mut(rgb, 3 * pixels)),
            depth: Some(from_raw_parts_mut(depth, pixels)),
            mask: Some(from_raw_parts_mut(mask, pixels)),
        }
    };
    Software::default().render(&scene, &camera, canvas);
    true
}
