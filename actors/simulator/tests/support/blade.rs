//! A blade that cuts a volume, and what is measured on the pieces.

use std::collections::BTreeMap;

use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use rand::Rng;
use trocar_dynamics::tet_mesh::{
    BoxCells, MeshRules, NodeMotion, OpenCut, Sweep, TetMesh, Volume, VolumeChange, box_cells, mean_ratio,
};

/// A block of 60 mm by 50 mm by 40 mm in cells of this size \[m\], its smallest corner at the origin.
pub fn block(cell: f64) -> TetMesh {
    let size = Vector3::new(0.06, 0.05, 0.04);
    let cells = [0, 1, 2].map(|axis| (size[axis] / cell).round() as usize);
    let (nodes, tets) = box_cells(&BoxCells { cells, size, origin: Point3::origin() });
    TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh")
}

/// A direction, evenly distributed.
pub fn direction(random: &mut impl Rng) -> Vector3<f64> {
    loop {
        let way = Vector3::from([0; 3].map(|_| random.random_range(-1.0..1.0)));
        if (0.1..1.0).contains(&way.norm()) {
            return way.normalize();
        }
    }
}

/// A plane and the direction in which a blade goes through it.
#[derive(Clone, Copy, Debug)]
pub struct Cut {
    pub point: Point3<f64>,
    pub normal: Vector3<f64>,
    pub way: Vector3<f64>,
}

impl Cut {
    /// Through a point near the middle of a mesh, in random directions.
    pub fn random(mesh: &TetMesh, random: &mut impl Rng) -> Self {
        let [low, high] = bounds(mesh);
        let off = Vector3::from([0; 3].map(|_| random.random_range(-0.2..0.2)));
        let point = nalgebra::center(&low, &high) + off.component_mul(&(high - low));
        let normal = direction(random);
        Self { point, normal, way: normal.cross(&direction(random)).normalize() }
    }

    /// The blade at a fraction of the way: it is longer than the mesh and begins and ends outside of it; turned in the
    /// plane by an angle.
    pub fn blade(&self, share: f64, turn: f64) -> [Point3<f64>; 2] {
        let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(self.normal), turn);
        let across = turn * self.normal.cross(&self.way) * 0.15;
        let middle = self.point + self.way * (0.2 * share - 0.1);
        [middle - across, middle + across]
    }
}

/// Smallest and largest coordinates.
pub fn bounds(mesh: &TetMesh) -> [Point3<f64>; 2] {
    let first = [mesh.rest()[0]; 2];
    mesh.rest().iter().fold(first, |[low, high], point| [low.inf(point), high.sup(point)])
}

/// A volume under a blade.
pub struct Bench {
    pub mesh: TetMesh,
    pub volume: Volume,
    pub nodes: NodeMotion,
    pub slit: OpenCut,
    /// Number of faces opened so far.
    pub opened: usize,
}

impl Bench {
    pub fn new(mesh: &TetMesh) -> Self {
        let still = vec![Vector3::zeros(); mesh.rest().len()];
        Self {
            mesh: mesh.clone(),
            volume: Volume::new(mesh),
            nodes: NodeMotion { positions: mesh.rest().to_vec(), moved: still },
            slit: OpenCut::default(),
            opened: 0,
        }
    }

    pub fn sweep(&mut self, before: [Point3<f64>; 2], after: [Point3<f64>; 2]) {
        let mut change = VolumeChange::default();
        let sweeps = [Sweep { before, after }];
        let cut = self.volume.cut(&mut self.nodes, &sweeps, &mut self.slit, &mut change);
        self.opened += cut.expect("a cut").len();
    }

    /// Along a path of the blade, from 0 to 1, in this many ticks.
    pub fn follow(&mut self, ticks: u32, path: impl Fn(f64) -> [Point3<f64>; 2]) {
        let at = |tick: u32| path(f64::from(tick) / f64::from(ticks));
        (0..ticks).for_each(|tick| self.sweep(at(tick), at(tick + 1)));
    }

    /// Straight through.
    pub fn pass(&mut self, cut: &Cut, ticks: u32) {
        self.follow(ticks, |share| cut.blade(share, 0.0));
    }

    /// Volumes of the pieces \[m³\], the largest first.
    pub fn pieces(&self) -> Vec<f64> {
        let tets: Vec<[u32; 4]> = self.volume.tets().map(|(_, tet)| tet).collect();
        let mut piece: Vec<usize> = (0..tets.len()).collect();
        fn root(piece: &mut [usize], mut at: usize) -> usize {
            while piece[at] != at {
                piece[at] = piece[piece[at]];
                at = piece[at];
            }
            at
        }
        let mut faces: Vec<([u32; 3], usize)> = Vec::with_capacity(4 * tets.len());
        for (at, [a, b, c, d]) in tets.iter().enumerate() {
            for mut face in [[*b, *c, *d], [*a, *c, *d], [*a, *b, *d], [*a, *b, *c]] {
                face.sort_unstable();
                faces.push((face, at));
            }
        }
        faces.sort_unstable();
        // Two faces of a slit may have the same corners as long as their nodes are not parted.
        let opened: std::collections::BTreeSet<[u32; 3]> = self
            .volume
            .surface()
            .map(|mut face| {
                face.sort_unstable();
                face
            })
            .collect();
        for two in faces.windows(2).filter(|two| two[0].0 == two[1].0 && !opened.contains(&two[0].0)) {
            let (one, other) = (root(&mut piece, two[0].1), root(&mut piece, two[1].1));
            piece[one] = other;
        }
        let mut volumes: BTreeMap<usize, f64> = BTreeMap::new();
        for (at, tet) in tets.iter().enumerate() {
            *volumes.entry(root(&mut piece, at)).or_default() += self.volume_of(tet);
        }
        let mut volumes: Vec<f64> = volumes.into_values().collect();
        volumes.sort_by(|a, b| b.total_cmp(a));
        assert_eq!(volumes.len(), self.volume.pieces());
        volumes
    }

    fn volume_of(&self, tet: &[u32; 4]) -> f64 {
        let [a, b, c, d] = tet.map(|node| self.volume.rest()[node as usize]);
        (b - a).cross(&(c - a)).dot(&(d - a)) / 6.0
    }

    /// Area of one lip: half of what the surface has grown by \[m²\].
    pub fn lip(&self) -> f64 {
        let area = |[a, b, c]: [Point3<f64>; 3]| (b - a).cross(&(c - a)).norm() / 2.0;
        let before =
            self.mesh.surface().iter().map(|face| area(face.map(|node| self.mesh.rest()[node as usize])));
        let after =
            self.volume.surface().map(|face| area(face.map(|node| self.volume.rest()[node as usize])));
        (after.sum::<f64>() - before.sum::<f64>()) / 2.0
    }

    /// No volume is lost, no element is inverted or flatter than a cut may make it.
    pub fn is_sound(&self, name: &str) {
        let least = |tets: &mut dyn Iterator<Item = f64>| tets.fold(1.0, f64::min);
        let flattest = least(&mut self.mesh.tets().iter().map(|tet| mean_ratio(self.mesh.rest(), tet)));
        let quality = least(&mut self.volume.tets().map(|(_, tet)| mean_ratio(self.volume.rest(), &tet)));
        assert!(quality >= flattest.min(0.05) - 1e-12, "{name}: a mean ratio of {quality}");
        let whole: f64 = self.volume.tets().map(|(_, tet)| self.volume_of(&tet)).sum();
        assert!((whole / self.mesh.volume() - 1.0).abs() < 1e-9, "{name}: {whole} m³");
    }

    /// It is in this many pieces, all larger than a share of the whole.
    pub fn has_pieces(&self, count: usize, share: f64, name: &str) {
        self.is_sound(name);
        let pieces = self.pieces();
        let least = pieces.last().copied().unwrap_or(0.0) / self.mesh.volume();
        assert_eq!(pieces.len(), count, "{name}: {pieces:?} m³");
        assert!(least > share, "{name}: {pieces:?} m³");
    }
}

/// Area of the section of a mesh by a plane \[m²\].
pub fn section(mesh: &TetMesh, cut: &Cut) -> f64 {
    let along = cut.way.normalize();
    let across = cut.normal.cross(&along);
    let of = |tet: &[u32; 4]| {
        let corners = tet.map(|node| mesh.rest()[node as usize]);
        let heights = corners.map(|corner| cut.normal.dot(&(corner - cut.point)));
        let mut points: Vec<[f64; 2]> = Vec::with_capacity(4);
        for (i, j) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
            if (heights[i] < 0.0) != (heights[j] < 0.0) {
                let share = heights[i] / (heights[i] - heights[j]);
                let at = corners[i] + (corners[j] - corners[i]) * share - cut.point;
                points.push([at.dot(&along), at.dot(&across)]);
            }
        }
        if points.len() < 3 {
            return 0.0;
        }
        let count = points.len() as f64;
        let middle =
            points.iter().fold([0.0, 0.0], |sum, at| [sum[0] + at[0] / count, sum[1] + at[1] / count]);
        points.sort_by(|a, b| {
            let angle = |at: &[f64; 2]| (at[1] - middle[1]).atan2(at[0] - middle[0]);
            angle(a).total_cmp(&angle(b))
        });
        let turned = points.iter().cycle().skip(1);
        points.iter().zip(turned).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>().abs() / 2.0
    };
    mesh.tets().iter().map(of).sum()
}
