use super::*;
use trocar_scene::random::SplitMix64;

/// A patch of `n × n` quads with jittered corners, mapped into the middle of the texture.
fn patch(n: u32, seed: u64) -> (Vec<[u32; 3]>, Vec<Vector2<f64>>) {
    let mut random = SplitMix64::new(seed);
    let mut uv = Vec::new();
    for (i, j) in (0..=n).flat_map(|j| (0..=n).map(move |i| (i, j))) {
        let shake = |random: &mut SplitMix64| 0.3 * (f64::from(random.unit_f32()) - 0.5) / f64::from(n);
        let at = [i, j].map(|k| 0.1 + 0.8 * f64::from(k) / f64::from(n) + shake(&mut random));
        uv.push(Vector2::new(at[0], at[1]));
    }
    let mut triangles = Vec::new();
    for (i, j) in (0..n).flat_map(|j| (0..n).map(move |i| (i, j))) {
        let a = j * (n + 1) + i;
        let (b, c, d) = (a + 1, a + n + 2, a + n + 1);
        triangles.extend(if random.next_u64() & 1 == 0 {
            [[a, b, c], [a, c, d]]
        } else {
            [[a, b, d], [b, c, d]]
        });
    }
    (triangles, uv)
}

fn burned(omega: &[f64]) -> SurfaceState<'_> {
    SurfaceState { omega: Some(omega), blood: None }
}

#[test]
fn what_is_painted_at_a_vertex_is_read_at_its_texture_coordinate() {
    for seed in 0..20 {
        let n = 3 + (seed % 6) as u32;
        let (triangles, uv) = patch(n, seed);
        let mut random = SplitMix64::new(100 + seed);
        // A smooth field, so that values between texels are known as well.
        let center = Vector2::new(f64::from(random.unit_f32()), f64::from(random.unit_f32()));
        let omega: Vec<f64> = uv.iter().map(|at| 2.5 * (-(at - center).norm_squared() / 0.2).exp()).collect();
        let blood: Vec<f64> = uv.iter().map(|at| at.x).collect();
        let mut map = EditMap::new(256, 256).expect("a valid size");
        map.set_surface(&triangles, &uv);
        map.paint(&SurfaceState { omega: Some(&omega), blood: Some(&blood) });
        for (vertex, at) in uv.iter().enumerate() {
            let [damage, bloody, cut, gloss] = map.sample(*at);
            assert!((damage - damage::encoded(omega[vertex])).abs() < 0.02, "seed {seed}, vertex {vertex}");
            assert!((f64::from(bloody) - blood[vertex]).abs() < 0.01, "seed {seed}, vertex {vertex}");
            assert!((gloss - damage::gloss(omega[vertex])).abs() < 0.03, "seed {seed}, vertex {vertex}");
            assert_eq!(cut, 0.0);
        }
        // Between the vertices: the mean of the corners at each triangle's centre.
        for triangle in &triangles {
            let corners = triangle.map(|v| uv[v as usize]);
            let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
            let mean = triangle.iter().map(|v| damage::encoded(omega[*v as usize])).sum::<f32>() / 3.0;
            assert!((map.sample(middle)[0] - mean).abs() < 0.02, "seed {seed}");
        }
    }
}

#[test]
fn only_texels_of_burned_triangles_change() {
    let (triangles, uv) = patch(8, 4);
    let mut map = EditMap::new(128, 128).expect("a valid size");
    map.set_surface(&triangles, &uv);
    let mut omega = vec![0.0; uv.len()];
    let everything = DirtyRect { x: 0, y: 0, width: 128, height: 128 };
    assert_eq!(map.paint(&burned(&omega)), Some(everything), "a new topology is uploaded as a whole");
    assert!(map.image().pixels.iter().all(|pixel| *pixel == UNTOUCHED));
    assert_eq!(map.paint(&burned(&omega)), None, "nothing changed");

    let vertex = 40;
    omega[vertex] = 3.0;
    let before = map.image().clone();
    let dirty = map.paint(&burned(&omega)).expect("a vertex was burned");
    let mut atlas = Atlas::new(128, 128);
    atlas.assign(&triangles, &uv);
    let mut changed = 0;
    for (texel, (old, new)) in before.pixels.iter().zip(&map.image().pixels).enumerate() {
        if old != new {
            changed += 1;
            let owner = atlas.owner(texel).expect("a texel of a triangle");
            assert!(triangles[owner].contains(&(vertex as u32)), "texel {texel} of triangle {owner}");
            let (x, y) = (texel as u32 % 128, texel as u32 / 128);
            assert!(
                (dirty.x..dirty.x + dirty.width).contains(&x)
                    && (dirty.y..dirty.y + dirty.height).contains(&y)
            );
        }
    }
    assert!(changed > 50, "{changed}");
    assert!(dirty.width < 50 && dirty.height < 50, "{dirty:?}");

    // A smaller burn than before (a session that was reset) shows as such.
    omega[vertex] = 0.0;
    assert!(map.paint(&burned(&omega)).is_some());
    assert_eq!(map.image(), &before);
}

#[test]
fn painting_step_by_step_gives_the_same_as_painting_once() {
    let (triangles, uv) = patch(6, 9);
    let mut random = SplitMix64::new(5);
    let mut stepwise = EditMap::new(100, 60).expect("a valid size");
    stepwise.set_surface(&triangles, &uv);
    let mut omega = vec![0.0; uv.len()];
    for _ in 0..60 {
        let vertex = random.next_u64() as usize % omega.len();
        omega[vertex] += f64::from(random.unit_f32()) * 10f64.powi((random.next_u64() % 4) as i32);
        stepwise.paint(&burned(&omega));
    }
    let mut once = EditMap::new(100, 60).expect("a valid size");
    once.set_surface(&triangles, &uv);
    once.paint(&burned(&omega));
    assert_eq!(stepwise.image(), once.image());
}

#[test]
fn no_untouched_texel_bleeds_into_a_burned_surface() {
    // All of the surface is burned, so every sample inside it is fully burned, also on its border.
    let (triangles, uv) = patch(5, 2);
    let mut map = EditMap::new(64, 64).expect("a valid size");
    map.set_surface(&triangles, &uv);
    map.paint(&burned(&vec![1e5; uv.len()]));
    let mut random = SplitMix64::new(1);
    for _ in 0..20_000 {
        let corners = triangles[random.next_u64() as usize % triangles.len()].map(|v| uv[v as usize]);
        let (a, b) = (f64::from(random.unit_f32()), f64::from(random.unit_f32()));
        let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
        let on_rim = if random.next_u64() & 1 == 0 { 0.0 } else { b };
        let at = corners[0] + (corners[1] - corners[0]) * a + (corners[2] - corners[0]) * on_rim;
        assert!(map.sample(at)[0] > 0.999_999, "{at}");
    }
}

#[test]
fn burns_survive_a_cut() {
    let (triangles, uv) = patch(8, 4);
    let mut map = EditMap::new(128, 128).expect("a valid size").with_cut_width(0.0);
    map.set_surface(&triangles, &uv);
    let omega: Vec<f64> = uv.iter().map(|at| if at.x < 0.5 { 50.0 * at.y } else { 0.0 }).collect();
    map.paint(&burned(&omega));
    let before = map.image().clone();

    // The cut separates the mesh along a column of vertices: the triangles to the right get new vertices.
    let (mut parted, mut longer) = (triangles.clone(), uv.clone());
    for row in 0..=8u32 {
        let old = row * 9 + 4;
        let new = longer.len() as u32;
        longer.push(uv[old as usize]);
        for triangle in parted.iter_mut().filter(|t| t.iter().any(|v| v % 9 > 4 && *v < 81)) {
            triangle.iter_mut().filter(|v| **v == old).for_each(|v| *v = new);
        }
    }
    assert_ne!(parted, triangles);
    map.set_surface(&parted, &longer);
    // The state does not say yet how burned the new vertices are.
    map.paint(&burned(&omega));
    let close = |now: &Image8, tolerance: u8| {
        now.pixels.iter().zip(&before.pixels).all(|(a, b)| (0..4).all(|c| a[c].abs_diff(b[c]) <= tolerance))
    };
    assert!(close(map.image(), 8), "new vertices keep what was at their place");
    // Now the state is complete.
    let mut known = omega.clone();
    known.extend((0..=8).map(|row| omega[row * 9 + 4]));
    map.paint(&burned(&known));
    assert!(close(map.image(), 1));
}

#[test]
fn a_cut_is_marked_and_stays() {
    let (triangles, uv) = patch(4, 7);
    let mut map = EditMap::new(64, 64).expect("a valid size");
    map.set_surface(&triangles, &uv);
    map.paint(&SurfaceState::default());
    assert!(map.image().pixels.iter().all(|pixel| pixel[2] == 0), "a rim is no cut");
    let fewer = &triangles[..triangles.len() - 2];
    map.set_surface(fewer, &uv);
    assert!(map.paint(&SurfaceState::default()).is_some());
    let marked = map.image().pixels.iter().filter(|pixel| pixel[2] > 0).count();
    assert!((20..200).contains(&marked), "{marked}");
    map.set_surface(fewer, &uv);
    map.paint(&SurfaceState::default());
    assert_eq!(map.image().pixels.iter().filter(|pixel| pixel[2] > 0).count(), marked);
}

#[test]
fn a_line_has_its_width_and_a_soft_edge() {
    let mut map = EditMap::new(64, 64).expect("a valid size");
    let line = [Vector2::new(0.25, 0.5), Vector2::new(0.75, 0.5)];
    let dirty = map.mark_cut(&line, 4.0).expect("a line was drawn");
    let column: Vec<u8> = (0..64).map(|y| map.image().get(32, y).expect("inside")[2]).collect();
    assert_eq!(column[30..34], [255; 4]);
    assert_eq!(column.iter().map(|c| u32::from(*c)).sum::<u32>(), 4 * 255);
    map.mark_cut(&[Vector2::new(0.25, 0.26), Vector2::new(0.75, 0.26)], 1.0);
    let total: u32 = (10..24).map(|y| u32::from(map.image().get(32, y).expect("inside")[2])).sum();
    assert!((250..=260).contains(&total), "one texel's worth between the rows: {total}");
    assert!(dirty.x >= 13 && dirty.x + dirty.width <= 51 && dirty.y == 30 && dirty.height == 4, "{dirty:?}");
    assert_eq!(map.mark_cut(&line, 4.0), None, "it is there already");
    assert_eq!(map.mark_cut(&[Vector2::new(f64::NAN, 0.0), Vector2::new(1e308, -1e308)], 4.0), None);
    assert_eq!(map.mark_cut(&line, f32::NAN), None);
}

#[test]
fn painting_adds_to_the_base_picture() {
    let mut base = Image8::filled(64, 64, [100, 30, 10, 200]);
    base.pixels[0] = [0, 0, 0, 255];
    let (triangles, uv) = patch(4, 3);
    let mut map = EditMap::with_base(base.clone()).expect("a valid size");
    map.set_surface(&triangles, &uv);
    map.paint(&burned(&vec![0.1; uv.len()]));
    assert_eq!(map.image(), &base, "a faint burn is not seen on a strong one");
    map.paint(&burned(&vec![1e4; uv.len()]));
    assert_eq!(map.image().get(32, 32), Some([255, 30, 10, 0]));
    map.paint(&burned(&vec![0.0; uv.len()]));
    assert_eq!(map.image(), &base);
}

#[test]
fn impossible_maps_are_refused_and_odd_states_do_no_harm() {
    assert!(EditMap::new(0, 5).is_err() && ScalarMap::new(5, 5000, 0.0, 1.0).is_err());
    let message = EditMap::new(5, 4097).expect_err("it is refused").to_string();
    assert!(message.contains("5 × 4097") && message.contains("1 to 4096"), "{message}");
    assert!(EditMap::with_base(Image8 { width: 4, height: 4, pixels: Vec::new() }).is_err());
    let mut map = EditMap::new(1, 1).expect("a valid size");
    assert_eq!(map.paint(&burned(&[1.0])), None, "there is no surface");
    map.set_surface(&[[0, 1, 9], [7, 7, 7]], &[Vector2::new(0.0, f64::NAN)]);
    map.paint(&burned(&[f64::NAN, f64::INFINITY, -1.0]));
    assert_eq!(map.image().pixels, [UNTOUCHED]);
    assert!(map.sample(Vector2::new(-1e300, f64::NAN)).iter().all(|x| x.is_finite()));
}

#[test]
fn temperatures_fill_their_range() {
    let (triangles, uv) = patch(6, 11);
    let mut map = ScalarMap::new(200, 200, 20.0, 120.0).expect("a valid size");
    map.set_surface(&triangles, &uv);
    let celsius: Vec<f64> = uv.iter().map(|at| 20.0 + 100.0 * at.y).collect();
    assert!(map.paint(&celsius).is_some());
    for at in &uv {
        let (x, y) = ((at.x * 200.0) as usize, (at.y * 200.0) as usize);
        let shown = 20.0 + f64::from(map.values()[y * 200 + x]) / 255.0 * 100.0;
        assert!((shown - (20.0 + 100.0 * at.y)).abs() < 1.0, "{shown} at {at}");
    }
    assert_eq!(map.paint(&celsius), None);
    let cold = vec![-300.0; celsius.len()];
    map.paint(&cold);
    assert!(map.values().iter().all(|value| *value == 0));
}
