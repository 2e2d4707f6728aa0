#!/usr/bin/env python3
"""Position-based soft bodies: pypbd beside ours, blocks of one alternating with blocks of the other in one run.

    python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements-simulator.txt
    cargo build --release -p trocar-simulator --example soft_speed
    peers/bin/python tests/peers/simulator_xpbd.py --ours target/release/examples/soft_speed --json

A beam of six-tetrahedra cells is held at x = 0 and sags under its weight. Told are the processor time of a step, median
over the blocks, and the deflection of its end at rest over that of the same tetrahedra in linear elasticity, which is
computed here: for loads under which that is small it is the answer. Exits with 1 where ours takes more than --ratio of the
peer's time, or has the larger error.

What pypbd calls "FEM" has no time in it: its stiffness is that of its iterations. Its "XPBD" is distances and volumes.
It refuses tetrahedra whose edge matrix has a determinant below 1e-6, so that lengths are scaled by 100 there, density and
time such that the strains are the same.
"""
import argparse
import json
import os
import statistics
import subprocess
import sys
import time

os.environ["OMP_NUM_THREADS"] = "1"  # before the library is loaded
import numpy as np
import pypbd as pbd

SIX = [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]
SCALE = 100.0
GRAVITY = 9.81
METHODS = {"fem": 2, "xpbd": 6}


def beam(cells, edge):
    nx, ny, nz = cells
    node = lambda i, j, k: (i * (ny + 1) + j) * (nz + 1) + k
    points = [(i * edge, j * edge, k * edge) for i in range(nx + 1) for j in range(ny + 1) for k in range(nz + 1)]
    tets = [
        [node(i + (c >> 2), j + (c >> 1 & 1), k + (c & 1)) for c in tet]
        for i in range(nx)
        for j in range(ny)
        for k in range(nz)
        for tet in SIX
    ]
    return np.array(points), np.array(tets)


def masses(points, tets, density):
    edges = points[tets[:, 1:]] - points[tets[:, :1]]
    volumes = np.linalg.det(edges) / 6.0
    mass = np.zeros(len(points))
    np.add.at(mass, tets.ravel(), np.repeat(density * volumes / 4.0, 4))
    return mass, volumes


def linear_deflection(points, tets, young, poisson, density):
    """Mean deflection of the end by linear elements."""
    mass, volumes = masses(points, tets, density)
    shear = young / 2 / (1 + poisson)
    lame = young * poisson / (1 + poisson) / (1 - 2 * poisson)
    size = 3 * len(points)
    stiffness = np.zeros((size, size))
    for tet, volume in zip(tets, volumes):
        slopes = np.linalg.inv((points[tet[1:]] - points[tet[0]]).T)
        slopes = np.vstack([-slopes.sum(0), slopes])
        dofs = (3 * tet[:, None] + np.arange(3)).ravel()
        across = np.einsum("ap,bq->apbq", slopes, slopes)
        block = lame * across + shear * np.einsum("apbq->aqbp", across)
        block += shear * np.einsum("ab,pq->apbq", slopes @ slopes.T, np.eye(3))
        stiffness[np.ix_(dofs, dofs)] += volume * block.reshape(12, 12)
    load = np.zeros(size)
    load[2::3] = -GRAVITY * mass
    free = np.repeat(points[:, 0] > 1e-9, 3)
    moved = np.zeros(size)
    moved[free] = np.linalg.solve(stiffness[np.ix_(free, free)], load[free])
    return float(-moved[2::3][points[:, 0] > points[:, 0].max() - 1e-9].mean())


class Pypbd:
    def __init__(self, ask, method):
        points, tets = beam(ask["cells"], ask["edge"])
        # Its gravity is along y.
        turned = SCALE * np.stack([points[:, 0], points[:, 2], -points[:, 1]], axis=1)
        self.simulation = pbd.Simulation.getCurrent()
        self.simulation.initDefault()
        self.model = self.simulation.getModel()
        mesh = self.model.addTetModel(turned, tets.ravel().astype(np.uint32))
        self.particles = self.model.getParticles()
        mass, _ = masses(turned, tets, ask["density"] / SCALE)
        for node, own in enumerate(mass):
            self.particles.setMass(node, 0.0 if points[node, 0] < 1e-9 else own)
        self.model.addSolidConstraints(mesh, method, ask["young"], ask["poisson"], ask["young"], False, False)
        self.constraints = len(self.model.getConstraints())
        self.stepper = self.simulation.getTimeStep()
        self.stepper.setValueUInt(pbd.TimeStepController.NUM_SUB_STEPS, ask["parts"])
        self.stepper.setValueUInt(pbd.TimeStepController.MAX_ITERATIONS, ask["iterations"])
        pbd.TimeManager.getCurrent().setTimeStepSize(ask["dt"] * SCALE**0.5)
        self.kept = 1.0 / (1.0 + ask["dt"] * ask["damping"])
        self.end = np.flatnonzero(points[:, 0] > points[:, 0].max() - 1e-9)
        self.rest = turned[self.end, 1]

    def steps(self, count):
        spent = 0.0
        for _ in range(count):
            begin = time.thread_time()
            self.stepper.step(self.model)
            spent += time.thread_time() - begin
            # It has no damping of its own; that of ours, outside its time.
            for node in range(self.particles.size()):
                self.particles.setVelocity(node, self.particles.getVelocity(node) * self.kept)
        now = np.array([self.particles.getPosition(int(node))[1] for node in self.end])
        return {"ms": 1e3 * spent / count, "tip": float((self.rest - now).mean()) / SCALE}


class Ours:
    def __init__(self, path, ask):
        self.child = subprocess.Popen([path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.ask(ask)

    def ask(self, request):
        print(json.dumps(request), file=self.child.stdin, flush=True)
        answer = json.loads(self.child.stdout.readline())
        if "error" in answer:
            raise RuntimeError(answer["error"])
        return answer

    def steps(self, count):
        return self.ask({"steps": count})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ours", required=True, help="the example soft_speed, built")
    parser.add_argument("--method", choices=METHODS, default="fem", help="of pypbd")
    parser.add_argument("--cells", type=int, nargs=3, default=[20, 7, 3])
    parser.add_argument("--edge", type=float, default=0.005, help="of a cell [m]")
    parser.add_argument("--young", type=float, default=1e6, help="[Pa]")
    parser.add_argument("--dt", type=float, default=5e-3, help="[s]")
    parser.add_argument("--iterations", type=int, default=5, help="sweeps per step, of both")
    parser.add_argument("--parts", type=int, default=5, help="parts of a step among which its sweeps are shared out")
    parser.add_argument("--peer-parts", type=int, default=1, help="the same of pypbd")
    parser.add_argument("--blocks", type=int, default=12)
    parser.add_argument("--steps", type=int, default=40, help="in a block")
    parser.add_argument("--ratio", type=float, default=0.5)
    parser.add_argument("--json", action="store_true", help="one object on stdout")
    wanted = parser.parse_args()
    if wanted.iterations % wanted.parts or wanted.iterations % wanted.peer_parts:
        parser.error("--iterations is to be a multiple of --parts and of --peer-parts")
    ask = {"cells": wanted.cells, "edge": wanted.edge, "young": wanted.young, "poisson": 0.3, "density": 1000.0}
    ask |= {"damping": 20.0, "dt": wanted.dt}
    share = lambda parts: ask | {"parts": parts, "iterations": wanted.iterations // parts}
    theirs = Pypbd(share(wanted.peer_parts), METHODS[wanted.method])
    ours = Ours(wanted.ours, share(wanted.parts))
    times = {"ours": [], "pypbd": []}
    tips = {}
    for _ in range(wanted.blocks):
        for name, side in (("ours", ours), ("pypbd", theirs)):
            answer = side.steps(wanted.steps)
            times[name].append(answer["ms"])
            tips[name] = answer["tip"]
    points, tets = beam(wanted.cells, wanted.edge)
    truth = linear_deflection(points, tets, wanted.young, 0.3, 1000.0)
    result = {
        "tets": len(tets),
        "dt_secs": wanted.dt,
        "sweeps_per_step": wanted.iterations,
        "parts": {"ours": wanted.parts, "pypbd": wanted.peer_parts},
        "pypbd_method": wanted.method,
        "pypbd_constraints": theirs.constraints,
        "deflection_linear_m": truth,
        "step_ms": {name: statistics.median(of) for name, of in times.items()},
        "deflection_m": tips,
        "error": {name: abs(tip / truth - 1.0) for name, tip in tips.items()},
    }
    result["ratio"] = result["step_ms"]["ours"] / result["step_ms"]["pypbd"]
    # A peer that has lost its numbers is no measure of error.
    lost = not np.isfinite(result["error"]["pypbd"])
    result["pass"] = result["ratio"] <= wanted.ratio and (lost or result["error"]["ours"] <= result["error"]["pypbd"])
    if lost:
        result["error"]["pypbd"] = result["deflection_m"]["pypbd"] = None
    if wanted.json:
        print(json.dumps(result))
    else:
        for key, value in result.items():
            print(f"{key:22} {value}")
    return 0 if result["pass"] else 1


if __name__ == "__main__":
    sys.exit(main())
