//! Technical materials: metals, plastics, rubber, foam; and a checker for tests.
//!
//! Plastic, rubber, board and the metals are neutral, so that the material's base colour tints them.

use super::noise::{Fbm, Perlin, Worley, lerp, mix, smoothstep, wrap};
use super::recipe::{Canvas, Recipe, Texel, TexelPainter};

/// Open-celled polyurethane foam as in box trainers.
pub(super) const FOAM: Recipe =
    Recipe { name: "foam", tile: 0.03, relief: 0.0008, drawn_min: 256, painter: foam };

fn foam(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let warp = [
        Fbm::field(canvas.seed(1), [10, 10], 2, 0.5, size),
        Fbm::field(canvas.seed(2), [10, 10], 2, 0.5, size),
    ];
    let coarse = Worley::new(canvas.seed(3), [19, 19], 0.35);
    let fine = Worley::new(canvas.seed(4), [43, 43], 0.35);
    let tone = Fbm::field(canvas.seed(5), [3, 3], 4, 0.5, size);
    let grain = Fbm::field(canvas.seed(6), [72, 72], 2, 0.5, size);
    Box::new(move |u, v| {
        let (du, dv) = (0.018 * warp[0].at(u, v), 0.018 * warp[1].at(u, v));
        let (large, small) = (coarse.at(u + du, v + dv), fine.at(u + du, v + dv));
        // Pores of random size and depth, with walls between them.
        let pore = |cell: super::noise::Cell, open: f32| {
            smoothstep(open, open + 0.25, cell.value) * smoothstep(0.06, 0.5, cell.border())
        };
        let hollow = pore(large, 0.25).max(0.7 * pore(small, 0.05));
        let grain = grain.at(u, v);
        let mut color = mix([0.90, 0.80, 0.60], [0.55, 0.44, 0.28], hollow);
        color = mix(color, [0.95, 0.87, 0.69], 0.35 * smoothstep(-0.3, 0.5, tone.at(u, v)) * (1.0 - hollow));
        Texel {
            color: color.map(|c| c * (1.0 + 0.05 * grain)),
            alpha: 1.0,
            height: 0.92 - 0.8 * hollow + 0.05 * grain,
            roughness: 0.95,
            wetness: 0.0,
            metalness: 0.0,
        }
    })
}

/// Steel brushed along u.
pub(super) const BRUSHED_METAL: Recipe =
    Recipe { name: "brushed_metal", tile: 0.03, relief: 0.00006, drawn_min: 256, painter: brushed_metal };

fn brushed_metal(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let streaks = Fbm::field(canvas.seed(1), [2, 60], 4, 0.75, size);
    let long = Perlin::new(canvas.seed(2), [1, 127]);
    let tone = Fbm::field(canvas.seed(3), [3, 5], 4, 0.5, size);
    Box::new(move |u, v| {
        let streak = streaks.at(u, v) + 0.5 * long.at(u, v);
        let shade = 0.735 + 0.13 * streak + 0.03 * tone.at(u, v);
        Texel {
            color: [shade, shade * 1.003, shade * 1.012],
            alpha: 1.0,
            height: 0.5 + 0.45 * streak,
            roughness: 0.30 + 0.10 * streak.abs(),
            wetness: 0.0,
            metalness: 1.0,
        }
    })
}

/// Polished steel that has been in use: faint smears, hairline scratches.
pub(super) const STEEL: Recipe =
    Recipe { name: "steel", tile: 0.03, relief: 0.00002, drawn_min: 256, painter: steel };

fn steel(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let smear = Fbm::field(canvas.seed(1), [3, 3], 6, 0.55, size);
    let scratches = [Perlin::new(canvas.seed(2), [3, 61]), Perlin::new(canvas.seed(3), [2, 53])];
    Box::new(move |u, v| {
        let smear = smear.at(u, v);
        // A hairline runs along the zero crossings of a stretched noise; shears by whole numbers keep the period.
        let hairline = |x: f32| 1.0 - smoothstep(0.0, 0.05, x.abs());
        let scratch = hairline(scratches[0].at(u + v, v + 2.0 * u)) * smoothstep(0.1, 0.4, smear)
            + hairline(scratches[1].at(u - v, v - u)) * smoothstep(0.1, 0.4, -smear);
        let shade = 0.80 + 0.025 * smear + 0.04 * scratch;
        Texel {
            color: [shade, shade * 1.002, shade * 1.01],
            alpha: 1.0,
            height: 0.6 + 0.2 * smear - 0.25 * scratch,
            roughness: 0.16 + 0.14 * smoothstep(0.0, 0.5, smear) + 0.1 * scratch,
            wetness: 0.0,
            metalness: 1.0,
        }
    })
}

/// Injection-moulded plastic: a fine orange peel with speckle.
pub(super) const PLASTIC: Recipe =
    Recipe { name: "plastic", tile: 0.02, relief: 0.00005, drawn_min: 256, painter: plastic };

fn plastic(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let peel = Fbm::field(canvas.seed(1), [34, 34], 3, 0.45, size);
    let tone = Fbm::field(canvas.seed(2), [3, 3], 4, 0.5, size);
    let speckle = Worley::new(canvas.seed(3), [60, 60], 0.35);
    Box::new(move |u, v| {
        let peel = peel.at(u, v);
        let cell = speckle.at(u, v);
        let speck = (1.0 - smoothstep(0.06, 0.22, cell.nearest)) * smoothstep(0.7, 0.95, cell.value);
        let shade = 0.93 + 0.025 * peel + 0.02 * tone.at(u, v) - 0.10 * speck;
        Texel {
            color: [shade; 3],
            alpha: 1.0,
            height: 0.5 + 0.5 * peel,
            roughness: 0.40 + 0.06 * peel + 0.08 * speck,
            wetness: 0.0,
            metalness: 0.0,
        }
    })
}

/// Moulded rubber: matt, grained, a little dusty.
pub(super) const RUBBER: Recipe =
    Recipe { name: "rubber", tile: 0.02, relief: 0.00014, drawn_min: 256, painter: rubber };

fn rubber(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let grain = Fbm::field(canvas.seed(1), [52, 52], 3, 0.65, size);
    let tone = Fbm::field(canvas.seed(2), [4, 4], 5, 0.55, size);
    let bumps = Worley::new(canvas.seed(3), [44, 44], 0.35);
    Box::new(move |u, v| {
        let bump = 1.0 - smoothstep(0.0, 0.55, bumps.at(u, v).nearest);
        let (grain, tone) = (grain.at(u, v), tone.at(u, v));
        let dust = smoothstep(0.15, 0.6, tone + 0.3 * grain);
        let shade = 0.83 + 0.05 * grain + 0.06 * tone - 0.05 * bump;
        Texel {
            color: [lerp(shade, 0.93, 0.35 * dust); 3],
            alpha: 1.0,
            height: 0.35 + 0.4 * bump + 0.25 * grain,
            roughness: 0.78 + 0.1 * dust,
            wetness: 0.0,
            metalness: 0.0,
        }
    })
}

/// Spark-eroded board: an even, satin leather grain, as on trainers' bases.
pub(super) const BOARD: Recipe =
    Recipe { name: "board", tile: 0.03, relief: 0.00003, drawn_min: 256, painter: board };

fn board(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let warp = [
        Fbm::field(canvas.seed(1), [14, 14], 2, 0.5, size),
        Fbm::field(canvas.seed(2), [14, 14], 2, 0.5, size),
    ];
    let leather = Worley::new(canvas.seed(3), [38, 38], 0.35);
    let tone = Fbm::field(canvas.seed(4), [3, 3], 5, 0.5, size);
    let grain = Fbm::field(canvas.seed(5), [90, 90], 2, 0.5, size);
    Box::new(move |u, v| {
        let (du, dv) = (0.012 * warp[0].at(u, v), 0.012 * warp[1].at(u, v));
        let plate = smoothstep(0.02, 0.4, leather.at(u + du, v + dv).border());
        let (tone, grain) = (tone.at(u, v), grain.at(u, v));
        let shade = 0.84 + 0.055 * plate + 0.03 * tone + 0.02 * grain;
        Texel {
            color: [shade; 3],
            alpha: 1.0,
            height: 0.2 + 0.65 * plate + 0.1 * grain,
            roughness: 0.58 - 0.08 * plate + 0.05 * tone,
            wetness: 0.0,
            metalness: 0.0,
        }
    })
}

/// Eight by eight squares, flat: for tests and for judging texture coordinates. The upper left square is dark.
pub(super) const CHECKER: Recipe =
    Recipe { name: "checker", tile: 0.08, relief: 0.0, drawn_min: 64, painter: checker };

fn checker(_: &Canvas) -> TexelPainter {
    Box::new(|u, v| {
        let odd = ((wrap(u) * 8.0) as u32 + (wrap(v) * 8.0) as u32) % 2 == 1;
        Texel {
            color: if odd { [0.8; 3] } else { [0.2; 3] },
            alpha: 1.0,
            height: 1.0,
            roughness: 0.6,
            wetness: 0.0,
            metalness: 0.0,
        }
    })
}
