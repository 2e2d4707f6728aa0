//! Sheets, tubes, blocks and threads as regular grids.

use nalgebra::{Point3, Vector3};

use super::OrganError;
use crate::mesh::{SurfaceData, TetData};

/// Most cells along one side of a grid.
pub const SIDE_MAX: usize = 1024;
/// Most vertices of a grid.
pub const VERTICES_MAX: usize = 1_000_000;

fn check(field: &'static str, lengths: &[f64], cells: &[usize]) -> Result<(), OrganError> {
    for &length in lengths {
        if !(1e-5..=10.0).contains(&length) {
            return Err(OrganError::OutOfRange { field, value: length, valid: "lengths of 1e-5 to 10 m" });
        }
    }
    for &count in cells {
        if !(1..=SIDE_MAX).contains(&count) {
            return Err(OrganError::OutOfRange { field, value: count as f64, valid: "1 to 1024 cells" });
        }
    }
    let vertices: usize = cells.iter().map(|count| count + 1).product();
    if vertices > VERTICES_MAX {
        let valid = "at most 1,000,000 vertices";
        return Err(OrganError::OutOfRange { field, value: vertices as f64, valid });
    }
    Ok(())
}

/// A rectangle in the xy plane about the origin, seen from above, `size` \[m\], of `cells` squares of two triangles each,
/// whose diagonals alternate. Texture coordinates run from 0 to 1.
///
/// # Errors
/// Lengths or numbers out of range.
pub fn sheet(size: [f64; 2], cells: [usize; 2]) -> Result<SurfaceData, OrganError> {
    check("sheet", &size, &cells)?;
    let [nx, ny] = cells;
    let mut data = SurfaceData::default();
    let mut uv = Vec::new();
    for j in 0..=ny {
        for i in 0..=nx {
            let (u, v) = (i as f64 / nx as f64, j as f64 / ny as f64);
            data.positions.push(Point3::new((u - 0.5) * size[0], (v - 0.5) * size[1], 0.0));
            uv.push([u, v]);
        }
    }
    let at = |i: usize, j: usize| (j * (nx + 1) + i) as u32;
    for j in 0..ny {
        for i in 0..nx {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            // Diagonals in one direction would make the sheet stiffer along it.
            let pair = if (i + j) % 2 == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] };
            data.triangles.extend(pair);
        }
    }
    data.uvs = Some(data.triangles.iter().map(|t| t.map(|vertex| uv[vertex as usize])).collect());
    Ok(data)
}

/// A tube without lids along z about the origin, `length` and `radius` \[m\], with `around` by `along` cells.
///
/// # Errors
/// Lengths or numbers out of range; at least three cells around.
pub fn tube(radius: f64, length: f64, around: usize, along: usize) -> Result<SurfaceData, OrganError> {
    check("tube", &[radius, length], &[around, along])?;
    if around < 3 {
        let valid = "3 to 1024 cells around";
        return Err(OrganError::OutOfRange { field: "tube", value: around as f64, valid });
    }
    let mut data = SurfaceData::default();
    for j in 0..=along {
        for i in 0..around {
            // Each ring is rotated by half a cell against the one below, so that all triangles are alike.
            let angle = std::f64::consts::TAU * (i as f64 + 0.5 * (j % 2) as f64) / around as f64;
            let z = (j as f64 / along as f64 - 0.5) * length;
            data.positions.push(Point3::new(radius * angle.cos(), radius * angle.sin(), z));
        }
    }
    let at = |i: usize, j: usize| (j * around + i % around) as u32;
    for j in 0..along {
        for i in 0..around {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)];
            let pair = if j % 2 == 0 { [[a, b, c], [b, d, c]] } else { [[a, b, d], [a, d, c]] };
            data.triangles.extend(pair);
        }
    }
    Ok(data)
}

/// Tetrahedra of a cube, its corners numbered by their three bits, x first.
const SIX: [[usize; 4]; 6] =
    [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];

/// The wall of a tube along z about the origin: outer `radius`, thickness of the `wall` and `length` \[m\], with `around` by
/// `along` by `across` cells of six tetrahedra each.
///
/// # Errors
/// Lengths or numbers out of range; a wall that leaves no lumen; at least three cells around.
pub fn pipe(
    radius: f64,
    wall: f64,
    length: f64,
    [around, along, across]: [usize; 3],
) -> Result<TetData, OrganError> {
    check("tube", &[radius, wall, length], &[around, along, across])?;
    if around < 3 {
        let valid = "3 to 1024 cells around";
        return Err(OrganError::OutOfRange { field: "tube", value: around as f64, valid });
    }
    if wall >= radius {
        let valid = "a wall thinner than the radius";
        return Err(OrganError::OutOfRange { field: "tube", value: wall, valid });
    }
    let mut data = TetData::default();
    for i in 0..around {
        let angle = std::f64::consts::TAU * i as f64 / around as f64;
        for j in 0..=along {
            let z = (j as f64 / along as f64 - 0.5) * length;
            for k in 0..=across {
                let r = radius - wall * (1.0 - k as f64 / across as f64);
                data.positions.push(Point3::new(r * angle.cos(), r * angle.sin(), z));
            }
        }
    }
    let cells = (0..around).flat_map(|i| (0..along).flat_map(move |j| (0..across).map(move |k| (i, j, k))));
    for (i, j, k) in cells {
        let corner = |local: usize| {
            let (a, b, c) = (local >> 2, (local >> 1) & 1, local & 1);
            (((i + a) % around * (along + 1) + j + b) * (across + 1) + k + c) as u32
        };
        data.tets.extend(SIX.map(|tet| tet.map(corner)));
    }
    data.tags = vec![0; data.tets.len()];
    data.flip_inverted();
    Ok(data)
}

/// A box about the origin, `size` \[m\], of cubes of six tetrahedra each around their diagonals.
///
/// # Errors
/// Lengths or numbers out of range.
pub fn block(size: [f64; 3], cells: [usize; 3]) -> Result<TetData, OrganError> {
    check("block", &size, &cells)?;
    let [nx, ny, nz] = cells;
    let mut data = TetData::default();
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                let share = Vector3::new(i as f64 / nx as f64, j as f64 / ny as f64, k as f64 / nz as f64);
                let centred = share.add_scalar(-0.5);
                data.positions.push(Point3::from(centred.component_mul(&Vector3::from(size))));
            }
        }
    }
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                let corner = |local: usize| {
                    let (a, b, c) = (local >> 2, (local >> 1) & 1, local & 1);
                    (((i + a) * (ny + 1) + j + b) * (nz + 1) + k + c) as u32
                };
                data.tets.extend(SIX.map(|tet| tet.map(corner)));
            }
        }
    }
    data.tags = vec![0; data.tets.len()];
    data.flip_inverted();
    Ok(data)
}

/// A straight thread along x about the origin, `length` \[m\], of that many segments: its vertices, and their pairs.
///
/// # Errors
/// Lengths or numbers out of range.
#[allow(clippy::type_complexity)] // two plain lists
pub fn line(length: f64, segments: usize) -> Result<(Vec<Point3<f64>>, Vec<[u32; 2]>), OrganError> {
    check("line", &[length], &[segments])?;
    let place = |k: usize| Point3::new((k as f64 / segments as f64 - 0.5) * length, 0.0, 0.0);
    let points = (0..=segments).map(place).collect();
    Ok((points, (0..segments as u32).map(|k| [k, k + 1]).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{validate_surface, validate_tets};

    #[test]
    fn grids_have_the_areas_and_volumes_of_what_they_are() {
        let gauze = sheet([0.1, 0.08], [10, 7]).unwrap();
        assert!((gauze.area() - 0.008).abs() < 1e-15);
        assert!(gauze.triangles.iter().enumerate().all(|(t, _)| gauze.area_vector(t).z > 0.0));
        let report = validate_surface(&gauze);
        assert!(report.is_manifold() && report.is_oriented() && report.euler_characteristic() == 1);

        let walled = pipe(0.01, 0.002, 0.08, [48, 20, 2]).unwrap();
        let ring = std::f64::consts::PI * (0.01_f64.powi(2) - 0.008_f64.powi(2)) * 0.08;
        assert!((walled.volume() / ring - 1.0).abs() < 3e-3, "{} of {ring}", walled.volume());
        let report = validate_tets(&walled);
        assert_eq!((report.inverted.count, report.non_manifold_faces.count, report.components), (0, 0, 1));
        assert!(pipe(0.01, 0.01, 0.08, [48, 20, 2]).is_err() && pipe(0.01, 0.002, 0.08, [2, 20, 2]).is_err());

        let pipe = tube(0.01, 0.08, 48, 20).unwrap();
        let exact = std::f64::consts::TAU * 0.01 * 0.08;
        assert!((pipe.area() / exact - 1.0).abs() < 3e-3, "{} of {exact}", pipe.area());
        let report = validate_surface(&pipe);
        assert!(report.is_manifold() && report.is_oriented() && report.euler_characteristic() == 0);
        let outward = (0..pipe.triangles.len()).all(|t| {
            let middle = pipe.corners(t).iter().fold(Vector3::zeros(), |sum, p| sum + p.coords) / 3.0;
            pipe.area_vector(t).dot(&Vector3::new(middle.x, middle.y, 0.0)) > 0.0
        });
        assert!(outward);

        let pad = block([0.06, 0.04, 0.02], [6, 4, 3]).unwrap();
        let report = validate_tets(&pad);
        assert!((report.volume - 0.06 * 0.04 * 0.02).abs() < 1e-15, "{report}");
        assert_eq!((report.inverted.count, report.non_manifold_faces.count, report.components), (0, 0, 1));

        let (points, pairs) = line(0.12, 60).unwrap();
        let length: f64 = pairs.iter().map(|[a, b]| (points[*a as usize] - points[*b as usize]).norm()).sum();
        assert!((length - 0.12).abs() < 1e-15);
    }

    #[test]
    fn out_of_range_is_told() {
        assert!(sheet([0.1, 0.1], [0, 4]).is_err());
        assert!(sheet([0.1, f64::NAN], [4, 4]).is_err());
        assert!(tube(0.01, 0.1, 2, 4).is_err());
        assert!(block([0.1; 3], [200, 200, 200]).is_err());
        assert!(line(0.1, 5000).is_err());
    }
}
