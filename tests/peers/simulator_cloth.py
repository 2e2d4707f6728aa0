#!/usr/bin/env python3
"""A cloth of Bullet's (pybullet) masses and springs as a child process that times steps when asked, so that a benchmark can
alternate blocks of its own with blocks of theirs.

    python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements-simulator.txt

One JSON object per line in and out.
  {"squares": 64, "size": 0.1, "density": 0.15, "stiffness": 10, "dt": 5e-5}
        -> {"nodes": 4225}: a sheet that hangs from one of its edges; springs along the edges of its triangles, and across them
  {"steps": 50} -> {"ms": processor time of a step, "lowest": its lowest place [m], null when it has lost its numbers}
An object with "error" says what was wrong with a request.

Nothing is near it: what its search for contacts costs is that of an empty scene.
"""
import json
import math
import sys
import time

import pybullet

GRAVITY = 9.81


class Cloth:
    def __init__(self, ask):
        squares, size = ask["squares"], ask["size"]
        row = squares + 1
        with open("sheet.obj", "w") as file:
            for i in range(row):
                for j in range(row):
                    file.write(f"v {i * size / squares} {j * size / squares} 0\n")
            for i in range(squares):
                for j in range(squares):
                    a = i * row + j + 1
                    file.write(f"f {a} {a + row} {a + 1}\nf {a + 1} {a + row} {a + row + 1}\n")
        pybullet.connect(pybullet.DIRECT)
        pybullet.resetSimulation(pybullet.RESET_USE_DEFORMABLE_WORLD)
        pybullet.setGravity(0, 0, -GRAVITY)
        pybullet.setTimeStep(ask["dt"])
        self.cloth = pybullet.loadSoftBody(
            "sheet.obj",
            mass=ask["density"] * size * size,
            useMassSpring=1,
            useBendingSprings=1,
            springElasticStiffness=ask["stiffness"],
            springBendingStiffness=ask["stiffness"] / 10,
            springDampingStiffness=0,
            useNeoHookean=0,
            useSelfCollision=0,
            collisionMargin=1e-4,
        )
        self.nodes = row * row
        for node in range(row):
            pybullet.createSoftBodyAnchor(self.cloth, node, -1, -1)

    def steps(self, count):
        begin = time.thread_time()
        for _ in range(count):
            pybullet.stepSimulation()
        spent = time.thread_time() - begin
        _, places = pybullet.getMeshData(self.cloth, -1, flags=pybullet.MESH_DATA_SIMULATION_MESH)
        lowest = min(place[2] for place in places)
        is_sound = math.isfinite(lowest) and all(abs(x) < 1.0 for place in places for x in place)
        return {"ms": 1e3 * spent / count, "lowest": lowest if is_sound else None}


def main():
    cloth = None
    for line in sys.stdin:
        try:
            request = json.loads(line)
            if "squares" in request:
                cloth = Cloth(request)
                answer = {"nodes": cloth.nodes}
            elif cloth is None:
                answer = {"error": "no cloth yet: begin with squares, size, density and so on"}
            else:
                answer = cloth.steps(int(request["steps"]))
        except Exception as error:  # whatever it was, the other side is to hear of it
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
