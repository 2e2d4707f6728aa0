//! The program `trocar`.

fn main() {}
