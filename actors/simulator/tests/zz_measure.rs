use nalgebra::{Point3, Vector3};
use trocar_simulator::xpbd::{Body, Distance, Xpbd, XpbdConfig, XpbdInput};
use trocar_simulator::fluid::{Fluid, FluidConfig};
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
fn chain(dt: f64, iterations: u32) -> f64 {
    let rest: Vec<_> = (0..21).map(|node| Point3::new(0.0, 0.0, -0.05 * f64::from(node))).collect();
    let distances: Vec<_> = (0..20)
        .map(|node| Distance { nodes: [node, node + 1], rest: 0.05, compliance: 1.0 / 50.0 })
        .collect();
    let body = Body { rest: &rest, masses: &[1e-3; 21], distances: &distances, ..Body::default() };
    let config = XpbdConfig { parts: 1, iterations, damping: 4.0, ..XpbdConfig::default() };
    let mut solver = Xpbd::new(&body, &[0], config).expect("a body");
    for _ in 0..(40.0 / dt) as usize {
        solver.step(dt, &XpbdInput { gravity: DOWN, ..XpbdInput::default() }).expect("a step");
    }
    (-solver.state().positions[20].z - 1.0) / 0.041202
}
#[test]
fn table() {
    for dt in [2.5e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 1.0/60.0] {
        let row: Vec<_> = [1,2,5,10,20,50].map(|i| format!("{:.5}", chain(dt, i))).to_vec();
        eprintln!("{dt:.5} {row:?}");
    }
}
const GRAVITY: f64 = 9.81;
fn basin(size: [i32; 3], spacing: f64) -> Vec<Point3<f64>> {
    let [nx, ny, nz] = size;
    let mut samples = Vec::new();
    for (i, j, k) in (-1..=nx).flat_map(|i| (-1..=ny).flat_map(move |j| (-1..=nz).map(move |k| (i, j, k)))) {
        if i == -1 || i == nx || j == -1 || j == ny || k == -1 {
            samples.push(Point3::from([i, j, k].map(|index| (f64::from(index) + 0.5) * spacing)));
        }
    }
    samples
}
fn fill(fluid: &mut Fluid, size: [i32; 3], spacing: f64) {
    let [nx, ny, nz] = size;
    for (i, j, k) in (0..nx).flat_map(|i| (0..ny).flat_map(move |j| (0..nz).map(move |k| (i, j, k)))) {
        let position = Point3::from([i, j, k].map(|index| (f64::from(index) + 0.5) * spacing));
        fluid.add(position, Vector3::zeros()).expect("in the box");
    }
}
fn tank(size: [i32; 3], liquid: [i32; 3], spacing: f64, config: FluidConfig) -> Fluid {
    let margin = Vector3::repeat(4.0 * spacing);
    let max = Point3::from(size.map(|count| f64::from(count) * spacing)) + margin;
    let config = FluidConfig { spacing, min: Point3::origin() - margin, max, ..config };
    let mut fluid = Fluid::new(config).expect("a liquid");
    let walls = basin(size, spacing);
    fluid.set_walls(&walls, &vec![Vector3::zeros(); walls.len()]).expect("walls");
    fill(&mut fluid, liquid, spacing);
    fluid
}
#[test]
fn ritter() {
    for (n, long, wide) in [(20, 4, 4), (40, 4, 4), (20,8,4)] {
        let height = 0.55; let spacing = height / n as f64;
        let config = FluidConfig { density: 1000.0, viscosity: 1e-6, parts_max: 1000, particles_max: 200_000, ..FluidConfig::default() };
        let mut fluid = tank([n * (long + 10), wide, n + 4], [n * long, wide, n], spacing, config);
        let dam = f64::from(n * long) * spacing;
        let t0 = std::time::Instant::now();
        let speed = (GRAVITY * height as f64).sqrt();
        let mut last = [dam; 6];
        for step in 1..=100 {
            fluid.step(0.01).expect("a step");
            if step % 10 == 0 {
                let time = 0.01 * step as f64;
                // front by depth thresholds
                let pieces = (n * (long + 10) / 2) as usize;
                let mut depths = vec![0.0; pieces];
                for p in &fluid.state().positions {
                    let i = ((p.x / (2.0 * spacing)) as usize).min(pieces - 1);
                    depths[i] += fluid.particle_volume() / (2.0 * f64::from(wide) * spacing * spacing);
                }
                let at = |depth: f64| -> f64 {
                    // last place where depth >= given, linear
                    let k = depths.iter().rposition(|d| *d >= depth).unwrap_or(0);
                    let (a, b) = (depths[k], depths.get(k + 1).copied().unwrap_or(0.0));
                    (k as f64 + 0.5 + (a - depth) / (a - b)) * 2.0 * spacing
                };
                let mut xs: Vec<f64> = fluid.state().positions.iter().map(|p| p.x).collect();
                xs.sort_by(f64::total_cmp);
                let fr = [xs[xs.len() - 9], at(0.5*spacing), at(1.0 * spacing), at(2.0 * spacing), at(0.1 * height), at(0.2*height)];
                let v: Vec<_> = (0..6).map(|i| format!("{:.3}/{:.3}", (fr[i]-last[i]) / 0.1 / (2.0*speed), (fr[i]-dam)/time/(2.0*speed))).collect();
                last = fr;
                let k = (n * long / 2) as usize;
                let d = (depths[k-1] + depths[k]) / 2.0;
                // where is ritter's depth of the thresholds: 1 - 1.5 sqrt(h/h0)
                let expect: Vec<_> = [1.0/n as f64, 2.0/n as f64, 0.1, 0.2].map(|h: f64| format!("{:.3}", 1.0 - 1.5 * h.sqrt())).to_vec();
                eprintln!("n {n} t {time:.2} speeds/mean over 2c: {v:?} expect {expect:?} dam {:.4} ({:.3}) {:?}", d, d/0.24444, t0.elapsed());
            }
        }
    }
}
