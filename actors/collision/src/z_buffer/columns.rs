//! Depth layers of a volume in each pixel, each from an entry to an exit.

/// Layers of all pixels in sequence, disjoint and from near to far.
#[derive(Clone, Debug, Default)]
pub(super) struct Columns {
    starts: Vec<u32>,
    layers: Vec<[f64; 2]>,
    /// Filled depth ranges that are drawn but not sorted yet.
    sheets: Vec<(u32, [f64; 2])>,
    /// Crossings of the surface at pixel centres: the depth, and whether into (1) or out of the volume (-1).
    passes: Vec<(u32, (f64, i32))>,
    sorted_sheets: ByPixel<[f64; 2]>,
    sorted_passes: ByPixel<(f64, i32)>,
}

/// A counting sort.
#[derive(Clone, Debug, Default)]
struct ByPixel<T> {
    starts: Vec<u32>,
    items: Vec<T>,
}

impl<T: Copy> ByPixel<T> {
    fn sort(&mut self, drawn: &[(u32, T)], pixels: usize) {
        self.starts.clear();
        self.starts.resize(pixels + 2, 0);
        self.items.clear();
        let Some((_, any)) = drawn.first() else { return };
        self.items.resize(drawn.len(), *any);
        // Counts are offset by two, so that each start is correct once the items are placed.
        for (pixel, _) in drawn {
            self.starts[*pixel as usize + 2] += 1;
        }
        for pixel in 0..pixels {
            self.starts[pixel + 2] += self.starts[pixel + 1];
        }
        for (pixel, item) in drawn {
            let place = &mut self.starts[*pixel as usize + 1];
            self.items[*place as usize] = *item;
            *place += 1;
        }
    }

    fn of(&mut self, pixel: usize) -> &mut [T] {
        if self.items.is_empty() {
            return &mut [];
        }
        &mut self.items[self.starts[pixel] as usize..self.starts[pixel + 1] as usize]
    }
}

impl Columns {
    pub fn clear(&mut self) {
        self.starts.clear();
        self.layers.clear();
        self.sheets.clear();
        self.passes.clear();
    }

    pub fn sheet(&mut self, pixel: usize, range: [f64; 2]) {
        self.sheets.push((pixel as u32, range));
    }

    pub fn pass(&mut self, pixel: usize, depth: f64, into: i32) {
        self.passes.push((pixel as u32, (depth, into)));
    }

    /// Fills columns between each entry and its exit, and where sheets fill them. An entry without exit (of an open
    /// surface) ends at its own depth.
    pub fn finish(&mut self, pixels: usize) {
        self.sorted_passes.sort(&self.passes, pixels);
        for pixel in 0..pixels {
            let passes = self.sorted_passes.of(pixel);
            passes.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
            let (mut winding, mut entry) = (0, 0.0);
            for (depth, into) in passes.iter() {
                if winding == 0 {
                    entry = *depth;
                }
                winding += into;
                if winding == 0 {
                    self.sheets.push((pixel as u32, [entry, *depth]));
                }
            }
        }
        self.sorted_sheets.sort(&self.sheets, pixels);
        self.layers.clear();
        self.starts.clear();
        self.starts.push(0);
        for pixel in 0..pixels {
            let sheets = self.sorted_sheets.of(pixel);
            sheets.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
            let first = self.layers.len();
            for range in sheets.iter() {
                match self.layers[first..].last_mut() {
                    Some(layer) if range[0] <= layer[1] => layer[1] = layer[1].max(range[1]),
                    _ => self.layers.push(*range),
                }
            }
            self.starts.push(self.layers.len() as u32);
        }
        self.sheets.clear();
        self.passes.clear();
    }

    /// The layers of a pixel, from near to far.
    pub fn layers(&self, pixel: usize) -> &[[f64; 2]] {
        match (self.starts.get(pixel), self.starts.get(pixel + 1)) {
            (Some(&from), Some(&to)) => &self.layers[from as usize..to as usize],
            _ => &[],
        }
    }

    /// Nearest entry and farthest exit of all \[m\].
    pub fn range(&self) -> Option<[f64; 2]> {
        self.layers.iter().copied().reduce(|[near, far], [entry, exit]| [near.min(entry), far.max(exit)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_are_joined_where_they_overlap_and_filled_between_entry_and_exit() {
        let mut columns = Columns::default();
        columns.sheet(2, [3.0, 4.0]);
        columns.sheet(0, [1.0, 2.0]);
        columns.sheet(2, [1.0, 2.0]);
        columns.sheet(2, [1.5, 2.5]);
        // Nested: in, in, out, out. Then an inverted one, and one without an exit.
        for (depth, into) in [(9.0, -1), (5.0, 1), (6.0, 1), (7.0, -1), (10.0, -1), (11.0, 1), (12.0, 1)] {
            columns.pass(1, depth, into);
        }
        columns.finish(3);
        assert_eq!(columns.layers(0), [[1.0, 2.0]]);
        assert_eq!(columns.layers(1), [[5.0, 9.0], [10.0, 11.0]]);
        assert_eq!(columns.layers(2), [[1.0, 2.5], [3.0, 4.0]]);
        assert_eq!((columns.layers(3), columns.range()), (&[][..], Some([1.0, 11.0])));
        columns.clear();
        columns.finish(1);
        assert_eq!((columns.layers(0), columns.range()), (&[][..], None));
    }
}
