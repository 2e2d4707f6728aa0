//! Sorts segments into chains: from one end or branching to the next, or around a loop.

/// Consecutive vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chain {
    first: u32,
    count: u32,
    /// The last vertex is joined to the first one (which is not repeated).
    pub closed: bool,
    /// Whether other chains meet this one at its beginning and at its end.
    pub meets: [bool; 2],
}

/// Finds chains, and keeps them while the segments stay the same.
#[derive(Clone, Debug, Default)]
pub struct ChainFinder {
    segments: Vec<[u32; 2]>,
    points: usize,
    chains: Vec<Chain>,
    vertices: Vec<u32>,
}

impl ChainFinder {
    /// Takes segments between `points` vertices. Invalid, degenerate and repeated segments are left out. The order of
    /// the chains follows from the numbers of the vertices alone. Returns whether the chains differ from the last ones.
    pub fn find(&mut self, segments: &[[u32; 2]], points: usize) -> bool {
        if self.segments == segments && self.points == points {
            return false;
        }
        self.segments.clear();
        self.segments.extend_from_slice(segments);
        self.points = points;
        self.chains.clear();
        self.vertices.clear();

        let mut edges: Vec<[u32; 2]> = segments
            .iter()
            .map(|[a, b]| if a < b { [*a, *b] } else { [*b, *a] })
            .filter(|[a, b]| a != b && (*b as usize) < points)
            .collect();
        edges.sort_unstable();
        edges.dedup();
        // Only used vertices, so that a few segments among millions of points cost little.
        let mut used: Vec<u32> = edges.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let local = |vertex: u32| used.binary_search(&vertex).unwrap_or(0);
        let mut around: Vec<Vec<(usize, usize)>> = vec![Vec::new(); used.len()];
        for (index, [a, b]) in edges.iter().enumerate() {
            around[local(*a)].push((index, local(*b)));
            around[local(*b)].push((index, local(*a)));
        }
        let mut taken = vec![false; edges.len()];
        // First from all ends and branchings, then around the remaining loops.
        for loops in [false, true] {
            for start in 0..used.len() {
                if !loops && around[start].len() == 2 {
                    continue;
                }
                for &(edge, next) in &around[start] {
                    if !taken[edge] {
                        self.follow(start, edge, next, &around, &mut taken, &used);
                    }
                }
            }
        }
        true
    }

    fn follow(
        &mut self,
        start: usize,
        edge: usize,
        next: usize,
        around: &[Vec<(usize, usize)>],
        taken: &mut [bool],
        used: &[u32],
    ) {
        let first = self.vertices.len() as u32;
        self.vertices.push(used[start]);
        taken[edge] = true;
        let mut at = next;
        while at != start {
            self.vertices.push(used[at]);
            let free = around[at].iter().find(|(edge, _)| around[at].len() == 2 && !taken[*edge]);
            let Some(&(edge, next)) = free else { break };
            taken[edge] = true;
            at = next;
        }
        let meets = |vertex: usize| around[vertex].len() > 2;
        let closed = at == start;
        self.chains.push(Chain {
            first,
            count: self.vertices.len() as u32 - first,
            closed,
            meets: [meets(start), meets(at)],
        });
    }

    /// The chains.
    pub fn chains(&self) -> &[Chain] {
        &self.chains
    }

    /// The vertices of a chain.
    pub fn vertices(&self, chain: Chain) -> &[u32] {
        &self.vertices[chain.first as usize..(chain.first + chain.count) as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(segments: &[[u32; 2]], points: usize) -> Vec<(Vec<u32>, bool, [bool; 2])> {
        let mut finder = ChainFinder::default();
        finder.find(segments, points);
        finder.chains().iter().map(|c| (finder.vertices(*c).to_vec(), c.closed, c.meets)).collect()
    }

    #[test]
    fn a_shuffled_thread_comes_out_in_order() {
        let chains = found(&[[2, 1], [4, 3], [0, 1], [3, 2]], 5);
        assert_eq!(chains, [(vec![0, 1, 2, 3, 4], false, [false; 2])]);
    }

    #[test]
    fn loops_are_closed() {
        let chains = found(&[[7, 5], [5, 6], [6, 7], [1, 2]], 8);
        assert_eq!(chains, [(vec![1, 2], false, [false; 2]), (vec![5, 6, 7], true, [false; 2])]);
    }

    #[test]
    fn branchings_part_chains() {
        let chains = found(&[[0, 1], [1, 2], [1, 3], [3, 4]], 5);
        let expected = [
            (vec![0, 1], false, [false, true]),
            (vec![1, 2], false, [true, false]),
            (vec![1, 3, 4], false, [true, false]),
        ];
        assert_eq!(chains, expected);
        let lasso = found(&[[0, 1], [1, 2], [2, 3], [3, 1]], 4);
        assert_eq!(lasso, [(vec![0, 1], false, [false, true]), (vec![1, 2, 3], true, [true, true])]);
    }

    #[test]
    fn bad_segments_are_left_out_and_every_good_one_is_used_once() {
        assert_eq!(found(&[[0, 0], [0, 9], [1, 0], [0, 1]], 2), [(vec![0, 1], false, [false; 2])]);
        let mut random = trocar_scene::random::SplitMix64::new(4);
        for _ in 0..200 {
            let segments: Vec<[u32; 2]> = (0..random.next_u64() % 40)
                .map(|_| [0, 1].map(|_| (random.next_u64() % 14) as u32))
                .collect();
            let mut expected: Vec<[u32; 2]> = segments
                .iter()
                .map(|[a, b]| [*a.min(b), *a.max(b)])
                .filter(|[a, b]| a != b && *b < 12)
                .collect();
            expected.sort_unstable();
            expected.dedup();
            let mut used = Vec::new();
            for (vertices, closed, _) in found(&segments, 12) {
                assert!(vertices.len() > 1 && (!closed || vertices.len() > 2));
                used.extend(vertices.windows(2).map(|w| [w[0].min(w[1]), w[0].max(w[1])]));
                if closed {
                    let ends = [vertices[0], vertices[vertices.len() - 1]];
                    used.push([ends[0].min(ends[1]), ends[0].max(ends[1])]);
                }
            }
            used.sort_unstable();
            assert_eq!(used, expected);
        }
    }
}
