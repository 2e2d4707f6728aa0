#!/usr/bin/env python3
"""Position-based soft bodies of pypbd as a child process that times steps when asked, so that a benchmark can alternate
blocks of its own with blocks of theirs.

    python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements-simulator.txt

One JSON object per line in and out.
  {"cells": [20, 7, 3], "edge": 0.005, "young": 1e6, "poisson": 0.3, "density": 1000, "damping": 20, "dt": 5e-3,
   "parts": 1, "iterations": 5, "method": "fem"}
        -> {"tets": 2520, "constraints": ..., "deflection_linear": [m]}: a beam of six-tetrahedra cells that is held at x = 0
           and sags under its weight, and the mean deflection of its end at rest by the same tetrahedra in linear elasticity,
           computed here: for loads under which it is small it is the answer
  {"steps": 40} -> {"ms": processor time of a step, "tip": mean deflection of the end [m], null when it has lost its numbers}
An object with "error" says what was wrong with a request.

What pypbd calls "fem" has no time in it: its stiffness is that of its iterations. Its "xpbd" is distances and volumes.
It refuses tetrahedra whose edge matrix has a determinant below 1e-6, so that lengths are scaled by 100 there, density and
time such that the strains are the same.
"""
import json
import os
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
        tip = float((self.rest - now).mean()) / SCALE
        return {"ms": 1e3 * spent / count, "tip": tip if np.isfinite(tip) else None}


def main():
    body = None
    for line in sys.stdin:
        try:
            request = json.loads(line)
            if "cells" in request:
                body = Pypbd(request, METHODS[request["method"]])
                points, tets = beam(request["cells"], request["edge"])
                of = [request[key] for key in ("young", "poisson", "density")]
                answer = {
                    "tets": len(tets),
                    "constraints": body.constraints,
                    "deflection_linear": linear_deflection(points, tets, *of),
                }
            elif body is None:
                answer = {"error": "no beam yet: begin with cells, edge, young and so on"}
            else:
                answer = body.steps(int(request["steps"]))
        except Exception as error:  # whatever it was, the other side is to hear of it
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
