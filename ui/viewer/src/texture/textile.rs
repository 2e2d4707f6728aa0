//! Textiles: gauze, drapes, sutures.

use super::noise::{Fbm, Field, Perlin, lerp, mix, smoothstep, wave, wrap};
use super::recipe::{Canvas, Recipe, Texel, TexelPainter};

/// Open plain weave of cotton; transparent between the threads.
pub(super) const GAUZE: Recipe =
    Recipe { name: "gauze", tile: 0.03, relief: 0.0006, drawn_min: 256, painter: gauze };

fn gauze(canvas: &Canvas) -> TexelPainter {
    let weave = Weave::new(canvas, 24.0);
    Box::new(move |u, v| weave.at(u, v))
}

/// The gauze of the pattern cutting exercise: a circle of 50 mm drawn on 100 mm. Not meant to be tiled.
pub(super) const INK_CIRCLE: Recipe =
    Recipe { name: "ink_circle", tile: 0.1, relief: 0.0006, drawn_min: 512, painter: ink_circle };

fn ink_circle(canvas: &Canvas) -> TexelPainter {
    let weave = Weave::new(canvas, 72.0);
    let texel = 1.0 / canvas.size as f32;
    let bleed = Fbm::field(canvas.seed(11), [20, 20], 4, 0.6, canvas.size);
    Box::new(move |u, v| {
        let gauze = weave.at(u, v);
        let (x, y) = (u - 0.5, v - 0.5);
        // A line of 1.8 mm, slightly spread by the cotton.
        let off = ((x * x + y * y).sqrt() - 0.25).abs() + 0.003 * bleed.at(u, v);
        let ink = 1.0 - smoothstep(0.009 - texel, 0.009 + texel + 0.002, off);
        Texel { color: mix(gauze.color, [0.16, 0.10, 0.42], ink * (0.62 + 0.38 * gauze.height)), ..gauze }
    })
}

/// Plain weave: threads alternately over and under each other.
struct Weave {
    /// Threads across the tile: an even number, so that the pattern is continuous at the seam.
    threads: f32,
    drift: [Field; 2],
    fuzz: Field,
    thickness: [Perlin; 2],
    tone: Field,
}

impl Weave {
    fn new(canvas: &Canvas, threads: f32) -> Self {
        let count = threads as u32;
        let size = canvas.size;
        Self {
            threads,
            drift: [1, 2].map(|i| Fbm::field(canvas.seed(i), [count / 6, count / 6], 2, 0.5, size)),
            fuzz: Fbm::field(canvas.seed(3), [count * 2, count * 2], 3, 0.6, size),
            thickness: [
                Perlin::new(canvas.seed(4), [count / 3, count]),
                Perlin::new(canvas.seed(5), [count, count / 3]),
            ],
            tone: Fbm::field(canvas.seed(6), [4, 4], 4, 0.5, size),
        }
    }

    fn at(&self, u: f32, v: f32) -> Texel {
        let slack = 0.42 / self.threads;
        let (x, y) = (
            (u + slack * self.drift[0].at(u, v)) * self.threads,
            (v + slack * self.drift[1].at(u, v)) * self.threads,
        );
        let fuzz = self.fuzz.at(u, v);
        // Distance from the axis of the weft thread (along u) and of the warp thread (along v), in pitches.
        let weft_off = wrap(y) - 0.5;
        let warp_off = wrap(x) - 0.5;
        let half = |noise: f32| 0.30 + 0.09 * noise + 0.05 * fuzz;
        let round = |off: f32, half: f32| (1.0 - (off / half) * (off / half)).max(0.0);
        let weft = round(weft_off, half(self.thickness[0].at(u, v)));
        let warp = round(warp_off, half(self.thickness[1].at(u, v)));
        // The weft is on top of every second warp thread, shifted by one from row to row.
        let parity = if (y.floor() as i64) & 1 == 0 { 0.25 } else { 0.75 };
        let lift = 0.26 * wave(0.5 * x - 0.25 + parity);
        let weft_height = if weft > 0.0 { 0.36 + lift + 0.34 * weft.sqrt() } else { 0.0 };
        let parity = if (x.floor() as i64) & 1 == 0 { 0.75 } else { 0.25 };
        let lift = 0.26 * wave(0.5 * y - 0.25 + parity);
        let warp_height = if warp > 0.0 { 0.36 + lift + 0.34 * warp.sqrt() } else { 0.0 };
        let height = weft_height.max(warp_height);
        let there = smoothstep(0.0, 0.22, weft.max(warp));
        // Twisted yarn: fine strands run obliquely over the thread that is on top.
        let strands = if weft_height > warp_height {
            wave(2.0 * x + 2.2 * weft_off)
        } else {
            wave(2.0 * y + 2.2 * warp_off)
        };
        let color = mix([0.68, 0.66, 0.61], [0.975, 0.965, 0.94], smoothstep(0.1, 0.9, height));
        let shade = 1.0 + 0.05 * strands + 0.10 * fuzz + 0.04 * self.tone.at(u, v);
        Texel {
            color: color.map(|c| c * shade),
            alpha: there,
            height: there * (height + 0.03 * strands + 0.06 * fuzz),
            roughness: 0.93,
            wetness: 0.0,
            metalness: 0.0,
        }
    }
}

/// Blue-green non-woven drape: pressed fibres, a grid of bonding points, soft creases.
pub(super) const DRAPE: Recipe =
    Recipe { name: "drape", tile: 0.08, relief: 0.0022, drawn_min: 256, painter: drape };

fn drape(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let fibres = [
        Fbm::field(canvas.seed(1), [18, 90], 3, 0.6, size),
        Fbm::field(canvas.seed(2), [90, 18], 3, 0.6, size),
        Fbm::field(canvas.seed(3), [60, 60], 3, 0.6, size),
    ];
    let creases = Fbm::field(canvas.seed(4), [2, 2], 4, 0.45, size);
    let tone = Fbm::field(canvas.seed(5), [5, 5], 4, 0.5, size);
    const BONDS: f32 = 40.0;
    Box::new(move |u, v| {
        let fibre = fibres.iter().map(|noise| noise.at(u, v)).sum::<f32>() * 0.6;
        // Diamonds in staggered rows.
        let row = (v * BONDS).floor();
        let x = wrap(u * BONDS * 0.5 + if (row as i64) & 1 == 0 { 0.0 } else { 0.5 }) - 0.5;
        let y = wrap(v * BONDS) - 0.5;
        let bond = 1.0 - smoothstep(0.16, 0.32, x.abs() * 2.0 + y.abs());
        // Creases have sharp crests.
        let crease = 1.0 - (creases.at(u, v) * 2.2).abs().min(1.0);
        let mut color =
            mix([0.055, 0.33, 0.36], [0.17, 0.52, 0.53], smoothstep(-0.7, 0.7, fibre + 0.5 * tone.at(u, v)));
        color = mix(color, [0.06, 0.35, 0.385], 0.4 * bond);
        color = mix(color, [0.24, 0.58, 0.585], 0.16 * crease * crease);
        Texel {
            color,
            alpha: 1.0,
            height: 0.25 + 0.5 * crease * crease + 0.07 * fibre - 0.05 * bond,
            roughness: lerp(0.86, 0.7, bond),
            wetness: 0.0,
            metalness: 0.0,
        }
    })
}

/// Braided thread: u once around, v along. Neutral, so that the material's base colour dyes it.
pub(super) const SUTURE: Recipe =
    Recipe { name: "suture", tile: 0.001, relief: 0.00006, drawn_min: 128, painter: suture };

fn suture(canvas: &Canvas) -> TexelPainter {
    let fuzz = Fbm::field(canvas.seed(1), [24, 24], 3, 0.6, canvas.size);
    let strands = Fbm::field(canvas.seed(2), [16, 16], 2, 0.5, canvas.size);
    Box::new(move |u, v| {
        // Carriers wind in both directions and alternate over each other, as in a maypole braid.
        let (x, y) = (4.0 * (u + v), 4.0 * (v - u));
        let bulge = |off: f32| (1.0 - 3.6 * off * off).max(0.0);
        let (a, b) = (bulge(wrap(x) - 0.5), bulge(wrap(y) - 0.5));
        let over = ((x.floor() + y.floor()) as i64) & 1 == 0;
        let (top, off) = if over { (a * (0.55 + 0.45 * b), y) } else { (b * (0.55 + 0.45 * a), x) };
        let strand = wave(3.0 * off) * 0.5 + strands.at(u, v);
        let fuzz = fuzz.at(u, v);
        let shade = 0.60 + 0.34 * top.sqrt() + 0.05 * strand + 0.05 * fuzz;
        Texel {
            color: [shade, shade, shade * 0.995],
            alpha: 1.0,
            height: 0.1 + 0.8 * top.sqrt() + 0.04 * strand,
            roughness: 0.55,
            wetness: 0.15,
            metalness: 0.0,
        }
    })
}
