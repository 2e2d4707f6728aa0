#!/usr/bin/env python3
"""A rod of PyElastica as a child process that times stretches of it when asked, so that a benchmark can alternate blocks of its
own with blocks of theirs.

    python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements-simulator.txt

One JSON object per line in and out.
  {"edges": 100, "length": 0.03, "radius": 2e-4, "density": 1100, "young": 5e7, "damping": 40, "dt": 1e-6}
        -> {"deflection_linear": [m]}: a rod that is clamped at one end and sags under its weight, and by how much the theory of
           slender beams has it sag
  {"secs": 0.06} -> {"ms": processor time of a simulated millisecond, "tip": how far its end has come down [m], null when it
                     has lost its numbers}
An object with "error" says what was wrong with a request.
"""
import json
import sys
import time

import elastica
import numpy as np

GRAVITY = 9.81


class World(elastica.BaseSystemCollection, elastica.Constraints, elastica.Forcing, elastica.Damping):
    pass


class Rod:
    def __init__(self, ask):
        self.dt = ask["dt"]
        self.world = World()
        along, across = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
        self.rod = elastica.CosseratRod.straight_rod(
            ask["edges"],
            np.zeros(3),
            along,
            across,
            ask["length"],
            ask["radius"],
            ask["density"],
            youngs_modulus=ask["young"],
            shear_modulus=ask["young"] / 2.6,
        )
        self.world.append(self.rod)
        ends = {"constrained_position_idx": (0,), "constrained_director_idx": (0,)}
        self.world.constrain(self.rod).using(elastica.OneEndFixedBC, **ends)
        gravity = np.array([0.0, 0.0, -GRAVITY])
        self.world.add_forcing_to(self.rod).using(elastica.GravityForces, acc_gravity=gravity)
        damping = {"uniform_damping_constant": ask["damping"], "time_step": self.dt}
        self.world.dampen(self.rod).using(elastica.AnalyticalLinearDamper, **damping)
        self.world.finalize()
        self.stepper = elastica.PositionVerlet()
        self.now = 0.0
        # What it compiles is none of its time, and hardly moves it.
        for _ in range(3):
            self.now = self.stepper.step(self.world, self.now, self.dt)
        bending = ask["young"] * np.pi * ask["radius"] ** 4 / 4
        weight = ask["density"] * np.pi * ask["radius"] ** 2 * GRAVITY
        self.deflection_linear = weight * ask["length"] ** 4 / 8 / bending

    def stretch(self, secs):
        steps = round(secs / self.dt)
        begin = time.thread_time()
        for _ in range(steps):
            self.now = self.stepper.step(self.world, self.now, self.dt)
        spent = time.thread_time() - begin
        tip = float(-self.rod.position_collection[2, -1])
        return {"ms": spent / secs, "tip": tip if np.isfinite(tip) else None}


def main():
    rod = None
    for line in sys.stdin:
        try:
            request = json.loads(line)
            if "edges" in request:
                rod = Rod(request)
                answer = {"deflection_linear": rod.deflection_linear}
            elif rod is None:
                answer = {"error": "no rod yet: begin with edges, length, radius and so on"}
            else:
                answer = rod.stretch(float(request["secs"]))
        except Exception as error:  # whatever it was, the other side is to hear of it
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
