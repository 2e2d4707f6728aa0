//! Hollow organs and the membranes around them: peritoneum, stomach, bowel, gallbladder.

use super::noise::{Fbm, Worley, lerp, mix, smoothstep};
use super::recipe::{Canvas, Recipe, Texel, TexelPainter};
use super::vessels::{Growth, VesselTree};

/// Blends a vessel over a colour: a fine edge in the wall's own shade, then the vessel's colour.
fn with_vessel(color: [f32; 3], vessel: f32, shade: [f32; 3], strength: f32) -> [f32; 3] {
    mix(color, shade, strength * smoothstep(0.02, 0.85, vessel))
}

/// Pale pink, thin and glistening, with arteries and veins that branch into fine vessels; fat shimmers through.
pub(super) const PERITONEUM: Recipe =
    Recipe { name: "peritoneum", tile: 0.05, relief: 0.001, drawn_min: 256, painter: peritoneum };

fn peritoneum(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let canvas = *canvas;
    let tone = Fbm::field(canvas.seed(1), [3, 3], 5, 0.5, size);
    let below = Fbm::field(canvas.seed(2), [2, 2], 4, 0.5, size);
    let folds = Fbm::field(canvas.seed(3), [3, 2], 3, 0.4, size);
    let fibres = Fbm::field(canvas.seed(4), [40, 24], 3, 0.55, size);
    let veins = Growth {
        root: [0.15, 0.35],
        trunk: [0.55, 0.3],
        attractors: 130,
        step: 0.011,
        tip_radius: 0.0013,
        radius_max: 0.0085,
    };
    let arteries = Growth {
        root: [0.72, 0.8],
        trunk: [0.1, -0.55],
        attractors: 110,
        step: 0.011,
        tip_radius: 0.001,
        radius_max: 0.0055,
    };
    let fine = Growth {
        root: [0.45, 0.1],
        trunk: [0.5, 0.4],
        attractors: 900,
        step: 0.007,
        tip_radius: 0.00045,
        radius_max: 0.0012,
    };
    let veins = VesselTree::grow(canvas.seed(5), &veins).draw(size, 0.004);
    let arteries = VesselTree::grow(canvas.seed(6), &arteries).draw(size, 0.0028);
    let fine = VesselTree::grow(canvas.seed(7), &fine).draw(size, 0.0009);
    Box::new(move |u, v| {
        let at = canvas.index(u, v);
        let (vein, artery, fine) = (veins[at], arteries[at], fine[at]);
        let tone = tone.at(u, v);
        let fibre = fibres.at(u, v);
        let mut color = mix([0.83, 0.52, 0.47], [0.945, 0.735, 0.675], smoothstep(-0.5, 0.5, tone));
        color = mix(color, [0.945, 0.79, 0.56], 0.75 * smoothstep(0.05, 0.5, below.at(u, v)));
        color = color.map(|c| c * (1.0 + 0.05 * fibre));
        color = with_vessel(color, fine, [0.80, 0.30, 0.28], 0.55);
        color = with_vessel(color, vein, [0.45, 0.13, 0.21], 0.82);
        color = with_vessel(color, artery, [0.75, 0.10, 0.09], 0.88);
        Texel {
            color,
            alpha: 1.0,
            height: 0.42 + 0.4 * folds.at(u, v) + 0.16 * vein.max(0.8 * artery) + 0.03 * fibre,
            roughness: 0.2 + 0.05 * tone.abs(),
            wetness: 0.95,
            metalness: 0.0,
        }
    })
}

/// The stomach's lining: winding folds (rugae) along u, covered with the small fields of the gastric pits.
pub(super) const STOMACH: Recipe =
    Recipe { name: "stomach", tile: 0.06, relief: 0.005, drawn_min: 256, painter: stomach };

fn stomach(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let course = Fbm::field(canvas.seed(1), [2, 3], 3, 0.5, size);
    let ridges = Fbm::new(canvas.seed(2), [2, 6], 2, 0.22, size);
    let pits = Worley::new(canvas.seed(3), [46, 46], 0.35);
    let warp =
        [Fbm::field(canvas.seed(4), [9, 9], 3, 0.5, size), Fbm::field(canvas.seed(5), [9, 9], 3, 0.5, size)];
    let tone = Fbm::field(canvas.seed(6), [4, 4], 5, 0.55, size);
    Box::new(move |u, v| {
        let (du, dv) = (0.02 * warp[0].at(u, v), 0.02 * warp[1].at(u, v));
        // The zero crossings of gradient noise are winding lines: the clefts between folds.
        let bent = v + 0.13 * course.at(u, v);
        let distance = ridges.at(u + du, bent + dv).abs();
        // Folds are round: steep at the clefts, flat on top.
        let off = (1.0 - 1.7 * distance).max(0.0);
        let crest = (1.0 - off * off).sqrt() * smoothstep(-0.03, 0.12, distance);
        let pit = pits.at(u + du, v + dv);
        let field = smoothstep(0.0, 0.4, pit.border());
        let tone = tone.at(u, v);
        let mut color =
            mix([0.50, 0.15, 0.14], [0.86, 0.47, 0.40], smoothstep(0.0, 1.0, crest + 0.18 * tone));
        color =
            mix(color, [0.93, 0.62, 0.53], 0.4 * smoothstep(0.75, 1.0, crest) * smoothstep(-0.1, 0.5, tone));
        color = mix(color, [0.68, 0.24, 0.21], 0.26 * (1.0 - field));
        color = mix(color, [0.78, 0.30, 0.26], 0.25 * pit.value);
        Texel {
            color,
            alpha: 1.0,
            height: 0.06 + 0.8 * crest + 0.009 * field + 0.04 * tone,
            roughness: 0.26 + 0.06 * (1.0 - field),
            wetness: 0.95,
            metalness: 0.0,
        }
    })
}

/// Small bowel from outside: smooth pink serosa over fine muscle around it, with vessels that run round.
pub(super) const BOWEL: Recipe =
    Recipe { name: "bowel", tile: 0.05, relief: 0.0012, drawn_min: 256, painter: bowel };

fn bowel(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let canvas = *canvas;
    let tone = Fbm::field(canvas.seed(1), [3, 3], 5, 0.5, size);
    let swell = Fbm::field(canvas.seed(2), [3, 2], 3, 0.4, size);
    let rings = Fbm::field(canvas.seed(3), [36, 5], 3, 0.5, size);
    let large = Growth {
        root: [0.5, 0.02],
        trunk: [0.05, 0.6],
        attractors: 90,
        step: 0.012,
        tip_radius: 0.0012,
        radius_max: 0.005,
    };
    let fine = Growth {
        root: [0.2, 0.6],
        trunk: [0.5, 0.4],
        attractors: 1000,
        step: 0.007,
        tip_radius: 0.00045,
        radius_max: 0.0013,
    };
    let large = VesselTree::grow(canvas.seed(4), &large).draw(size, 0.0032);
    let fine = VesselTree::grow(canvas.seed(5), &fine).draw(size, 0.001);
    Box::new(move |u, v| {
        let at = canvas.index(u, v);
        let (tone, ring) = (tone.at(u, v), rings.at(u, v));
        let mut color =
            mix([0.77, 0.42, 0.38], [0.91, 0.63, 0.56], smoothstep(-0.5, 0.5, tone + 0.35 * ring));
        color = with_vessel(color, fine[at], [0.72, 0.22, 0.22], 0.5);
        color = with_vessel(color, large[at], [0.60, 0.10, 0.13], 0.75);
        Texel {
            color,
            alpha: 1.0,
            height: 0.45 + 0.45 * swell.at(u, v) + 0.06 * ring + 0.08 * large[at],
            roughness: 0.22 + 0.05 * ring.abs(),
            wetness: 0.95,
            metalness: 0.0,
        }
    })
}

/// Bile shines blue-green through the wall; fine vessels run over it, here and there a film of fat.
pub(super) const GALLBLADDER: Recipe =
    Recipe { name: "gallbladder", tile: 0.04, relief: 0.001, drawn_min: 256, painter: gallbladder };

fn gallbladder(canvas: &Canvas) -> TexelPainter {
    let size = canvas.size;
    let canvas = *canvas;
    let tone = Fbm::field(canvas.seed(1), [3, 3], 6, 0.55, size);
    let film = Fbm::field(canvas.seed(2), [2, 3], 5, 0.55, size);
    let swell = Fbm::field(canvas.seed(3), [2, 2], 3, 0.45, size);
    let grain = Fbm::field(canvas.seed(4), [56, 56], 3, 0.55, size);
    let large = Growth {
        root: [0.8, 0.3],
        trunk: [-0.5, 0.3],
        attractors: 120,
        step: 0.011,
        tip_radius: 0.0011,
        radius_max: 0.005,
    };
    let fine = Growth {
        root: [0.3, 0.8],
        trunk: [0.5, 0.4],
        attractors: 800,
        step: 0.008,
        tip_radius: 0.0005,
        radius_max: 0.0013,
    };
    let large = VesselTree::grow(canvas.seed(5), &large).draw(size, 0.003);
    let fine = VesselTree::grow(canvas.seed(6), &fine).draw(size, 0.001);
    Box::new(move |u, v| {
        let at = canvas.index(u, v);
        let (tone, grain) = (tone.at(u, v), grain.at(u, v));
        let film = smoothstep(0.08, 0.42, film.at(u, v));
        let mut color = mix([0.30, 0.37, 0.29], [0.55, 0.60, 0.44], smoothstep(-0.5, 0.5, tone));
        color = mix(color, [0.62, 0.55, 0.42], 0.35 * smoothstep(0.1, 0.6, tone));
        color = mix(color, [0.90, 0.76, 0.48], 0.75 * film);
        color = with_vessel(color, fine[at], [0.56, 0.20, 0.18], lerp(0.45, 0.2, film));
        color = with_vessel(color, large[at], [0.55, 0.10, 0.12], 0.75);
        Texel {
            color: color.map(|c| c * (1.0 + 0.09 * grain)),
            alpha: 1.0,
            height: 0.4 + 0.4 * swell.at(u, v) + 0.12 * film + 0.1 * large[at] + 0.03 * grain,
            roughness: 0.2 + 0.08 * film,
            wetness: 0.95,
            metalness: 0.0,
        }
    })
}
