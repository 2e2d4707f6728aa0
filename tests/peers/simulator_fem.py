#!/usr/bin/env python3
"""MuJoCo's flexible bodies as a child process that times steps when asked, so that a benchmark can alternate blocks of
its own with blocks of theirs.

    python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements-simulator.txt

One JSON object per line in and out; times in milliseconds, of one thread.
  {"cells": [20, 3, 3], "size": [0.1, 0.02, 0.02], "young": 1e5, "poisson": 0.3, "density": 1000, "damping": 1e-3,
   "dt": 1e-3}
        -> {"tets": 1080, "version": "...", "clamped": 16}: a beam of six-tetrahedra cells held at x = 0 under its weight
  {"steps": 200} -> {"ms": [per step], "cpu_ms": [the same, of the processor], "tip": mean deflection of the end [m]}
An object with "error" says what was wrong with a request.
"""
import json
import sys
import time

import mujoco
import numpy as np

SIX = [(0, 4, 6, 7), (0, 6, 2, 7), (0, 2, 3, 7), (0, 3, 1, 7), (0, 1, 5, 7), (0, 5, 4, 7)]


def beam(cells, size):
    nx, ny, nz = cells
    node = lambda i, j, k: (i * (ny + 1) + j) * (nz + 1) + k
    points = [
        (size[0] * i / nx, size[1] * j / ny, size[2] * k / nz)
        for i in range(nx + 1)
        for j in range(ny + 1)
        for k in range(nz + 1)
    ]
    tets = [
        [node(i + (c >> 2), j + (c >> 1 & 1), k + (c & 1)) for c in tet]
        for i in range(nx)
        for j in range(ny)
        for k in range(nz)
        for tet in SIX
    ]
    return np.array(points), tets


class Beam:
    def __init__(self, request):
        points, tets = beam(request["cells"], request["size"])
        held = [index for index, point in enumerate(points) if point[0] < 1e-9]
        self.end = [index for index, point in enumerate(points) if point[0] > request["size"][0] - 1e-9]
        words = lambda rows: " ".join(str(x) for row in rows for x in row)
        mass = request["density"] * float(np.prod(request["size"]))
        xml = f"""
<mujoco>
  <option timestep="{request["dt"]}" gravity="0 0 -9.81" integrator="discrete">
    <flag contact="disable"/>
  </option>
  <size memory="200M"/>
  <worldbody>
    <flexcomp name="beam" type="direct" dim="3" mass="{mass}" radius="1e-4"
              point="{words(points)}" element="{words(tets)}">
      <pin id="{" ".join(map(str, held))}"/>
      <contact selfcollide="none"/>
      <edge equality="false"/>
      <elasticity young="{request["young"]}" poisson="{request["poisson"]}" damping="{request["damping"]}"/>
    </flexcomp>
  </worldbody>
</mujoco>"""
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.rest = self.data.flexvert_xpos.copy()
        self.answer = {"tets": len(tets), "version": mujoco.__version__, "clamped": len(held)}

    def steps(self, count):
        times, of_processor = [], []
        for _ in range(count):
            begin, begin_processor = time.perf_counter(), time.thread_time()
            mujoco.mj_step(self.model, self.data)
            times.append((time.perf_counter() - begin) * 1e3)
            of_processor.append((time.thread_time() - begin_processor) * 1e3)
        tip = float(np.mean(self.rest[self.end, 2] - self.data.flexvert_xpos[self.end, 2]))
        return {"ms": times, "cpu_ms": of_processor, "tip": tip}


def main():
    body = None
    for line in sys.stdin:
        try:
            request = json.loads(line)
            if "cells" in request:
                body = Beam(request)
                answer = body.answer
            elif body is None:
                answer = {"error": "no beam yet: begin with cells, size, young, poisson, density, damping, dt"}
            else:
                answer = body.steps(int(request["steps"]))
        except Exception as error:  # whatever it was, the other side is to hear of it
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
