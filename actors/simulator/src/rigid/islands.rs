//! Islands: contacts connected by movable bodies or jaws. Fixed bodies connect nothing.

use trocar_scene::disjoint_sets::DisjointSets;

/// Islands of contacts and joints; buffers reused in the next step.
#[derive(Clone, Debug, Default)]
pub(super) struct Islands {
    /// Bodies, then joints.
    joined: DisjointSets,
    /// Island of each root.
    number: Vec<u32>,
    /// Contacts and joints by island, each in order, and the start of each island.
    contacts: Vec<u32>,
    joints: Vec<u32>,
    starts: Vec<[u32; 2]>,
}

const NONE: u32 = u32::MAX;

impl Islands {
    /// Starts with unconnected bodies and joints.
    pub fn begin(&mut self, bodies: usize, joints: usize) {
        self.joined.reset(bodies + joints);
    }

    /// Connects two of them.
    pub fn join(&mut self, a: usize, b: usize) {
        self.joined.join(a, b);
    }

    /// Sorts contacts, each given by a body that it pushes, and joints, which are numbered after the bodies, into
    /// islands.
    pub fn sort(&mut self, bodies: usize, pushed: impl Iterator<Item = usize> + Clone) {
        let all = self.joined.elements();
        self.number.clear();
        self.number.resize(all, NONE);
        self.starts.clear();
        let (mut contacts, mut joints) = (0, 0);
        // Counts per island: in the order of the first contact, then joints without contact.
        for (of, is_joint) in
            pushed.clone().map(|body| (body, false)).chain((bodies..all).map(|of| (of, true)))
        {
            let first = self.joined.root(of);
            if self.number[first] == NONE {
                self.number[first] = self.starts.len() as u32;
                self.starts.push([0; 2]);
            }
            self.starts[self.number[first] as usize][usize::from(is_joint)] += 1;
            *(if is_joint { &mut joints } else { &mut contacts }) += 1;
        }
        let mut sums = [0; 2];
        for counts in &mut self.starts {
            for (count, sum) in counts.iter_mut().zip(&mut sums) {
                let own = std::mem::replace(count, *sum);
                *sum += own;
            }
        }
        self.contacts.clear();
        self.contacts.resize(contacts, 0);
        self.joints.clear();
        self.joints.resize(joints, 0);
        // Each start becomes the end.
        for (contact, body) in pushed.enumerate() {
            let first = self.joined.root(body);
            let island = self.number[first] as usize;
            let place = &mut self.starts[island][0];
            self.contacts[*place as usize] = contact as u32;
            *place += 1;
        }
        for joint in bodies..all {
            let first = self.joined.root(joint);
            let island = self.number[first] as usize;
            let place = &mut self.starts[island][1];
            self.joints[*place as usize] = (joint - bodies) as u32;
            *place += 1;
        }
    }

    /// The island of a body, after sorting, if it has contacts or jaws.
    pub fn island_of(&mut self, body: usize) -> Option<u32> {
        let island = self.number[self.joined.root(body)];
        (island != NONE).then_some(island)
    }

    /// Contacts and joints of each island.
    pub fn each(&self) -> impl Iterator<Item = (&[u32], &[u32])> {
        let mut from = [0; 2];
        self.starts.iter().map(move |to| {
            let to = to.map(|to| to as usize);
            let island = (&self.contacts[from[0]..to[0]], &self.joints[from[1]..to[1]]);
            from = to;
            island
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_pushes_the_same_body_or_turns_the_same_jaws_is_together_and_each_is_there_once() {
        // Bodies 0 to 5, two joints: 0 - 3 and 3 - 5 touch, 4 carries the first joint, 1 and 2 rest on the world.
        let mut islands = Islands::default();
        for _ in 0..2 {
            islands.begin(6, 2);
            islands.join(3, 0);
            islands.join(5, 3);
            islands.join(4, 6);
            islands.sort(6, [1, 3, 4, 2, 5, 1, 4].into_iter());
            let all: Vec<_> = islands.each().map(|(a, b)| (a.to_vec(), b.to_vec())).collect();
            let wanted = [
                (vec![0, 5], vec![]),
                (vec![1, 4], vec![]),
                (vec![2, 6], vec![0]),
                (vec![3], vec![]),
                (vec![], vec![1]),
            ];
            assert_eq!(all, wanted);
        }
        islands.begin(0, 0);
        islands.sort(0, std::iter::empty());
        assert_eq!(islands.each().count(), 0);
    }
}
