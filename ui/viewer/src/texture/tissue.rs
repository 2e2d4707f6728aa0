//! Solid tissues: liver, fat, muscle, skin; and blood.

use super::noise::{Fbm, Perlin, Worley, lerp, mix, smoothstep};
use super::recipe::{Canvas, Recipe, Texel, TexelPainter};
use super::vessels::{Growth, VesselTree};

/// Deep red-brown under a glistening capsule, mottled, with lobules of one to two millimetres: darker around
/// their central veins, paler where they meet.
pub(super) const LIVER: Recipe =
    Recipe { name: "liver", tile: 0.045, relief: 0.0014, drawn_min: 256, painter: liver };

fn liver(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let mottle = Fbm::field(canvas.seed(1), [3, 3], 6, 0.55, size);
    let swell = Fbm::field(canvas.seed(2), [2, 2], 3, 0.4, size);
    let warp =
        [Fbm::field(canvas.seed(3), [7, 7], 3, 0.5, size), Fbm::field(canvas.seed(4), [7, 7], 3, 0.5, size)];
    let lobules = Worley::new(canvas.seed(5), [30, 30], 0.35);
    let grain = Fbm::field(canvas.seed(6), [64, 64], 3, 0.6, size);
    Box::new(move |u, v| {
        let (du, dv) = (warp[0].at(u, v), warp[1].at(u, v));
        let cell = lobules.at(u + 0.03 * du, v + 0.03 * dv);
        let meeting = 1.0 - smoothstep(0.02, 0.42, cell.border());
        let centre = 1.0 - smoothstep(0.05, 0.4, cell.nearest);
        let tone = mottle.at(u, v);
        let grain = grain.at(u, v);
        let mut color = mix([0.33, 0.09, 0.075], [0.555, 0.195, 0.145], smoothstep(-0.55, 0.55, tone));
        color = mix(color, [0.60, 0.27, 0.19], meeting * (0.13 + 0.15 * cell.value));
        color = mix(color, [0.21, 0.045, 0.045], centre * (0.12 + 0.22 * cell.value));
        let shade = 1.0 + 0.22 * grain;
        Texel {
            color: color.map(|c| c * shade),
            alpha: 1.0,
            height: 0.5 + 0.6 * swell.at(u, v) + 0.022 * (0.5 - meeting) + 0.014 * grain,
            roughness: 0.24 + 0.06 * meeting + 0.07 * tone.abs(),
            wetness: 0.92 - 0.1 * meeting,
            metalness: 0.0,
        }
    })
}

/// Yellow lobules in two sizes, separated by thin septa with fine vessels.
pub(super) const FAT: Recipe =
    Recipe { name: "fat", tile: 0.04, relief: 0.0019, drawn_min: 256, painter: fat };

fn fat(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let canvas = *canvas;
    let warp =
        [Fbm::field(canvas.seed(1), [4, 4], 4, 0.5, size), Fbm::field(canvas.seed(2), [4, 4], 4, 0.5, size)];
    let lobes = Worley::new(canvas.seed(3), [6, 6], 0.35);
    let lobules = Worley::new(canvas.seed(4), [17, 17], 0.35);
    let tone = Fbm::field(canvas.seed(5), [3, 3], 5, 0.5, size);
    let grain = Fbm::field(canvas.seed(6), [48, 48], 3, 0.5, size);
    let growth = Growth {
        root: [0.3, 0.55],
        trunk: [0.35, 0.25],
        attractors: 150,
        step: 0.012,
        tip_radius: 0.0011,
        radius_max: 0.005,
    };
    let vessels = VesselTree::grow(canvas.seed(7), &growth).draw(size, 0.0028);
    Box::new(move |u, v| {
        let (du, dv) = (0.055 * warp[0].at(u, v), 0.055 * warp[1].at(u, v));
        let (lobe, lobule) = (lobes.at(u + du, v + dv), lobules.at(u + 1.3 * du, v + 1.3 * dv));
        // A dome over each cell, rounded into the furrow at its border.
        let dome = |nearest: f32, border: f32| {
            (1.0 - 0.9 * nearest * nearest).max(0.0) * (0.45 + 0.55 * smoothstep(-0.1, 0.4, border))
        };
        let large = dome(lobe.nearest, lobe.border());
        let small = dome(lobule.nearest, lobule.border());
        let height = 0.06 + 0.62 * large + 0.24 * small;
        let tone = tone.at(u, v);
        let mut color = mix([0.80, 0.53, 0.20], [0.965, 0.83, 0.47], smoothstep(0.15, 0.8, height));
        color = mix(color, [0.90, 0.66, 0.30], 0.5 * lobe.value + 0.25 * lobule.value * (1.0 - lobe.value));
        color = mix(color, [0.98, 0.88, 0.60], 0.35 * smoothstep(0.0, 0.5, tone));
        let septum = (1.0 - smoothstep(0.0, 0.28, lobe.border()))
            .max(0.45 * (1.0 - smoothstep(0.0, 0.2, lobule.border())));
        color = mix(color, [0.76, 0.40, 0.23], 0.55 * septum);
        let vessel = vessels[canvas.index(u, v)];
        color = mix(color, [0.70, 0.17, 0.12], 0.75 * smoothstep(0.05, 0.9, vessel));
        let shade = 1.0 + 0.08 * grain.at(u, v);
        Texel {
            color: color.map(|c| c * shade),
            alpha: 1.0,
            height: height + 0.02 * vessel,
            roughness: 0.34 + 0.08 * septum,
            wetness: 0.72,
            metalness: 0.0,
        }
    })
}

/// Bundles of red fibres along u, separated by pale connective tissue.
pub(super) const MUSCLE: Recipe =
    Recipe { name: "muscle", tile: 0.035, relief: 0.0009, drawn_min: 256, painter: muscle };

fn muscle(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let bend = Fbm::field(canvas.seed(1), [2, 3], 3, 0.45, size);
    let bundles = Worley::new(canvas.seed(2), [3, 13], 0.35);
    let fibres = Fbm::new(canvas.seed(3), [4, 44], 4, 0.62, size);
    let strands = Perlin::new(canvas.seed(4), [7, 26]);
    let tone = Fbm::field(canvas.seed(5), [3, 4], 4, 0.5, size);
    let marbling = Fbm::new(canvas.seed(6), [3, 14], 4, 0.55, size);
    Box::new(move |u, v| {
        let across = v + 0.035 * bend.at(u, v);
        let bundle = bundles.at(u, across);
        let gap = 1.0 - smoothstep(0.0, 0.26, bundle.border());
        let fibre = fibres.at(u, across) + 0.35 * strands.at(u, across);
        let tone = tone.at(u, v);
        let fatty = smoothstep(0.26, 0.5, marbling.at(u, across) + 0.25 * gap);
        let mut color =
            mix([0.36, 0.065, 0.06], [0.70, 0.235, 0.19], smoothstep(-0.6, 0.6, fibre + 0.5 * tone));
        color = mix(color, [0.55, 0.13, 0.11], 0.4 * bundle.value);
        color = mix(color, [0.80, 0.48, 0.42], 0.42 * gap);
        color = mix(color, [0.90, 0.72, 0.58], 0.55 * fatty);
        Texel {
            color,
            alpha: 1.0,
            height: 0.42 + 0.25 * (1.0 - gap) + 0.3 * fibre + 0.12 * tone,
            roughness: 0.33 + 0.1 * gap,
            wetness: 0.8,
            metalness: 0.0,
        }
    })
}

/// Polygons of fine furrows, pores, and freckled tone.
pub(super) const SKIN: Recipe =
    Recipe { name: "skin", tile: 0.02, relief: 0.00007, drawn_min: 256, painter: skin };

fn skin(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let warp =
        [Fbm::field(canvas.seed(1), [9, 9], 3, 0.5, size), Fbm::field(canvas.seed(2), [9, 9], 3, 0.5, size)];
    let plates = Worley::new(canvas.seed(3), [22, 26], 0.35);
    let creases = Worley::new(canvas.seed(4), [8, 11], 0.35);
    let pores = Worley::new(canvas.seed(5), [15, 15], 0.35);
    let tone = Fbm::field(canvas.seed(6), [3, 3], 6, 0.55, size);
    let flush = Fbm::field(canvas.seed(7), [4, 4], 4, 0.5, size);
    let grain = Fbm::field(canvas.seed(8), [80, 80], 2, 0.5, size);
    Box::new(move |u, v| {
        let (du, dv) = (0.02 * warp[0].at(u, v), 0.02 * warp[1].at(u, v));
        let plate = smoothstep(0.0, 0.3, plates.at(u + du, v + dv).border());
        let crease = smoothstep(0.0, 0.16, creases.at(u + 1.4 * du, v + 1.4 * dv).border());
        let pore_cell = pores.at(u, v);
        let pore = (1.0 - smoothstep(0.05, 0.2, pore_cell.nearest)) * smoothstep(0.35, 0.6, pore_cell.value);
        let grain = grain.at(u, v);
        let mut color = mix([0.78, 0.56, 0.44], [0.93, 0.75, 0.63], smoothstep(-0.5, 0.5, tone.at(u, v)));
        color = mix(color, [0.86, 0.52, 0.44], 0.45 * smoothstep(0.0, 0.5, flush.at(u, v)));
        color = mix([0.70, 0.43, 0.33], color, 0.70 + 0.2 * plate + 0.1 * crease);
        color = mix(color, [0.55, 0.31, 0.23], 0.6 * pore);
        Texel {
            color: color.map(|c| c * (1.0 + 0.06 * grain)),
            alpha: 1.0,
            height: 0.2 + 0.4 * plate + 0.25 * crease - 0.3 * pore + 0.1 * grain,
            roughness: 0.52 - 0.08 * plate,
            wetness: 0.08,
            metalness: 0.0,
        }
    })
}

/// A pool of blood: dark where it is deep, with clots.
pub(super) const BLOOD: Recipe =
    Recipe { name: "blood", tile: 0.04, relief: 0.0008, drawn_min: 128, painter: blood };

fn blood(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let depth = Fbm::field(canvas.seed(1), [3, 3], 5, 0.5, size);
    let clots = Fbm::field(canvas.seed(2), [6, 6], 4, 0.45, size);
    let ripple = Fbm::field(canvas.seed(3), [4, 4], 2, 0.4, size);
    Box::new(move |u, v| {
        let clot = smoothstep(0.05, 0.5, clots.at(u, v));
        let color = mix([0.47, 0.02, 0.02], [0.30, 0.008, 0.012], smoothstep(-0.4, 0.4, depth.at(u, v)));
        Texel {
            color: mix(color, [0.17, 0.01, 0.012], 0.8 * clot),
            alpha: 1.0,
            height: 0.45 + 0.35 * ripple.at(u, v) + 0.2 * clot,
            roughness: lerp(0.08, 0.24, clot),
            wetness: 1.0,
            metalness: 0.0,
        }
    })
}
