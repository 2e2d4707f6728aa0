//! Bytes that a station gets of an organ that is pulled, beside all its nodes as plain numbers, in virtual time.

use std::net::Ipv4Addr;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar::network::impairments::Impairments;
use trocar::network::lockstep::{Wire, WireHostStreams, WireStationStream, Wires};
use trocar::network::ticket::HostAddress;
use trocar::summary::{BenchResult, Better};
use trocar_scene::{SimTime, SurfaceMesh, VertexPositions};

use super::Rows;
use super::pair::{Book, Pair};
use crate::failure::Failure;

const NODES: usize = 5_000;
/// Nodes of an edge of the block of tissue, and the distance between two \[m\].
const EDGE: usize = 17;
const SPACING: f64 = 0.015;
/// How fast the organ is computed, and how fast its nodes are shown \[Hz\].
const PHYSICS_HZ: f64 = 100.0;
const SHOWN_HZ: f64 = 30.0;
/// Bytes of a node as plain numbers.
const NODE_BYTES: f64 = 24.0;
/// Step of the machines, time to get all, and span that is measured.
const STEP: SimTime = SimTime::from_millis(4);
const SETTLED: SimTime = SimTime::from_millis(2_000);
const SPAN: SimTime = SimTime::from_millis(4_000);
/// How far a jaw pulls \[m\], and within which distance of it half of that is left \[m\].
const PULL: f64 = 0.02;
const HALF: f64 = 0.02;
/// So many bytes a second may go in datagrams.
const BYTES_PER_SEC: f64 = 1e7;
/// Delay of the path.
const DELAY: SimTime = SimTime::from_millis(10);

/// The nodes of the organ at rest; neighbours have neighbouring numbers, as the mesher of the organs numbers them.
fn at_rest() -> Vec<Point3<f64>> {
    let at = |k: usize| Point3::new((k % EDGE) as f64, (k / EDGE % EDGE) as f64, (k / (EDGE * EDGE)) as f64);
    (0..NODES).map(|k| at(k) * SPACING).collect()
}

/// Bytes a second that come to a station while the organ moves; `share` of a node by its distance from the jaw.
fn bytes_per_sec(share: impl Fn(f64) -> f64) -> Result<f64, Failure> {
    let book = Book::new()?;
    let address = HostAddress::of_socket((Ipv4Addr::LOCALHOST, 7_417).into()).map_err(Failure::internal)?;
    let credential = book.credential(address)?;
    let wires = Wires::default();
    let wire = Wire::new(&Impairments::delay(DELAY), 11);
    let number = wires.add(wire.clone());
    let streams = Box::new(WireHostStreams::new(wires));
    let stream = Box::new(WireStationStream::new(wire, number, SimTime::from_millis(20)));
    let mut pair = Pair::new(&book, streams, stream, credential, (number, BYTES_PER_SEC), SimTime::ZERO)?;
    let rest = at_rest();
    let organ = pair.host.commands.spawn();
    pair.host.commands.put(organ, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]; 4_000]) });
    pair.host.commands.put(organ, VertexPositions { positions: Arc::new(rest.clone()) });
    pair.host.apply(SimTime::ZERO)?;
    let jaw = rest[0];
    let shares: Vec<f64> = rest.iter().map(|at| share((at - jaw).norm())).collect();
    let period = SimTime::from_secs_f64(1.0 / PHYSICS_HZ);
    let (mut now, mut physics_at, mut before) = (SimTime::ZERO, SETTLED, 0);
    while now < SETTLED + SPAN {
        now += STEP;
        if now >= physics_at {
            physics_at += period;
            let pulled = Vector3::new(0.3, 0.1, 1.0) * (PULL * (4.0 * now.as_secs_f64()).sin());
            let positions = rest.iter().zip(&shares).map(|(at, share)| at + pulled * *share).collect();
            pair.host.commands.put(organ, VertexPositions { positions: Arc::new(positions) });
            pair.host.apply(now)?;
        }
        pair.step(now)?;
        if now <= SETTLED {
            before = pair.bytes();
        }
    }
    if !pair.is_running() {
        return Err(Failure::internal("the station has not joined in virtual time"));
    }
    Ok((pair.bytes() - before) as f64 / SPAN.as_secs_f64())
}

/// An organ that is pulled at one place, and one that moves as a whole.
pub fn liver() -> Rows {
    let whole = NODES as f64 * NODE_BYTES * SHOWN_HZ;
    let row =
        |name: &str, bytes: f64| BenchResult::on_ratio(name, "B/s", (bytes, 0.0), whole, None, Better::Lower);
    Ok(vec![
        row("network_liver_5000_nodes_pulled", bytes_per_sec(|far| 0.5_f64.powf((far / HALF).powi(2)))?),
        row("network_liver_5000_nodes_wholly_moving", bytes_per_sec(|_| 1.0)?),
    ])
}
