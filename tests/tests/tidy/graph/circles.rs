//! Cycles of a graph: its strongly connected components of more than one node (Tarjan 1972).

use std::collections::{BTreeMap, BTreeSet};

use super::Edges;

/// The cycles of a graph, largest first.
pub fn circles(edges: &Edges) -> Vec<BTreeSet<String>> {
    let mut after: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (from, to) in edges.keys() {
        after.entry(from).or_default().push(to);
        after.entry(to).or_default();
    }
    let mut search = Search { after, ..Search::default() };
    let nodes: Vec<&str> = search.after.keys().copied().collect();
    for node in nodes {
        if !search.order.contains_key(node) {
            search.visit(node);
        }
    }
    search.found.sort_by_key(|circle| std::cmp::Reverse(circle.len()));
    search.found
}

#[derive(Default)]
struct Search<'a> {
    after: BTreeMap<&'a str, Vec<&'a str>>,
    order: BTreeMap<&'a str, usize>,
    lowest: BTreeMap<&'a str, usize>,
    stack: Vec<&'a str>,
    found: Vec<BTreeSet<String>>,
}

impl<'a> Search<'a> {
    fn visit(&mut self, node: &'a str) {
        let order = self.order.len();
        self.order.insert(node, order);
        self.lowest.insert(node, order);
        self.stack.push(node);
        for next in self.after[node].clone() {
            if !self.order.contains_key(next) {
                self.visit(next);
                self.lower(node, self.lowest[next]);
            } else if self.stack.contains(&next) {
                self.lower(node, self.order[next]);
            }
        }
        if self.lowest[node] == order {
            let start = self.stack.iter().position(|other| *other == node).expect("it was pushed");
            let circle = self.stack.split_off(start);
            if circle.len() > 1 {
                self.found.push(circle.into_iter().map(str::to_owned).collect());
            }
        }
    }

    fn lower(&mut self, node: &'a str, to: usize) {
        let lowest = self.lowest.get_mut(node).expect("it was visited");
        *lowest = (*lowest).min(to);
    }
}
