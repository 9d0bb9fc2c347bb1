#![allow(missing_docs, clippy::all, clippy::pedantic, unused)]
use trocar_proto::Options;
use trocar_server::render::{Lens, Picture, Renderer, Software};
use trocar_server::tasks::Registry;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let (w, h): (usize, usize) = (args[1].parse().unwrap(), args[2].parse().unwrap());
    let only = args.get(3).cloned().unwrap_or_default();
    let steps: usize = args.get(4).map_or(8, |s| s.parse().unwrap());
    let reg = Registry::builtin();
    for id in reg.ids() {
        if !id.contains(&only) {
            continue;
        }
        let mut env = reg.make(id, &Options::new()).unwrap();
        env.reset(Some(3));
        let mut a = vec![0.0; env.spec().action_dim()];
        for _ in 0..steps {
            env.expert(&mut a);
            if env.step(&a).is_err() {
                break;
            }
        }
        let scene = env.scene();
        for (name, lens) in [("endo", Lens::Endoscope), ("over", Lens::Overview)] {
            let cam = scene.camera(lens, w, h).unwrap();
            let soft = if std::env::var_os("ZZ").is_some() {
                Software::default()
            } else {
                Software::fine()
            };
            for _ in 0..3 {
                soft.picture(&scene, &cam);
            }
            let t = std::time::Instant::now();
            let p = soft.picture(&scene, &cam);
            eprintln!("{id} {name} {} triangles {:?}", scene.triangles(), t.elapsed());
            let mut out = format!("P6\n{w} {h}\n255\n").into_bytes();
            out.extend(&p.rgb);
            std::fs::write(format!("/tmp/w/sight-pics/{id}-{name}.ppm"), out).unwrap();
        }
    }
}
