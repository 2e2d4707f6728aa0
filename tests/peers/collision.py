#!/usr/bin/env python3
"""coal and FCL as a long-lived child process that times collision queries when asked, so that a benchmark can alternate
blocks of its own with blocks of theirs.

    python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements.txt

One JSON object per line in and out; times in microseconds, of one thread.
  {"mesh": "path.obj"}                     -> {"peers": {"coal": {"version", "empty_us"}, "fcl": ...}}
        reads the mesh (OBJ, triangles), which the next requests are about
  {"poses": "poses.csv"}                   -> {"poses": 200}: rotation by rows and translation of the second mesh
  {"peer": "coal", "query": "first", "repeats": 3}
        -> {"us": [per pose, least of the repeats], "answers": [[hit, pairs or distance] per pose]}
        query: "first" (contact), "all" (pairs), "distance". The time of the same call with two single triangles that
        are far apart, which is what the way through Python costs, has been subtracted.
  {"peer": "coal", "query": "build", "repeats": 5} -> {"us": [one]}
An object with "error" says what was wrong with a request.
"""
import json
import sys
import time

import numpy as np

FAR = np.array([[1e6, 0, 0], [1e6, 1, 0], [1e6, 0, 1]], dtype=float)
ONE = np.array([[0, 1, 2]], dtype=int)
MANY = 1_000_000


def read_obj(path):
    vertices, faces = [], []
    with open(path, encoding="utf-8") as lines:
        for line in lines:
            words = line.split()
            if words and words[0] == "v":
                vertices.append([float(word) for word in words[1:4]])
            elif words and words[0] == "f":
                faces.append([int(word.split("/")[0]) - 1 for word in words[1:4]])
    return np.array(vertices), np.array(faces, dtype=int)


class Coal:
    def __init__(self):
        import coal

        self.lib, self.version = coal, coal.__version__

    def build(self, vertices, faces):
        points, triangles = self.lib.StdVec_Vec3s(), self.lib.StdVec_Triangle()
        for vertex in vertices:
            points.append(vertex)
        for a, b, c in faces.tolist():
            triangles.append(self.lib.Triangle(a, b, c))

        def make():
            model = self.lib.BVHModelOBBRSS()
            model.beginModel(len(triangles), len(points))
            model.addSubModel(points, triangles)
            model.endModel()
            return model

        return make

    def place(self, rotation, translation):
        return self.lib.Transform3s(rotation, translation)

    def calls(self, query, first, second, pose):
        lib, identity = self.lib, self.lib.Transform3s()
        if query == "distance":
            request, result = lib.DistanceRequest(), lib.DistanceResult()

            def call():
                result.clear()
                return lib.distance(first, identity, second, pose, request, result)

            return call, lambda: [result.min_distance <= 0, max(0.0, result.min_distance)]
        most = 1 if query == "first" else MANY
        request, result = lib.CollisionRequest(lib.CollisionRequestFlag.CONTACT, most), lib.CollisionResult()

        def call():
            result.clear()
            return lib.collide(first, identity, second, pose, request, result)

        return call, lambda: [result.isCollision(), result.numContacts()]


class Fcl:
    def __init__(self):
        import fcl
        from importlib.metadata import version

        self.lib, self.version = fcl, version("python-fcl")

    def build(self, vertices, faces):
        def make():
            model = self.lib.BVHModel()
            model.beginModel(len(vertices), len(faces))
            model.addSubModel(vertices, faces)
            model.endModel()
            return model

        return make

    def place(self, rotation, translation):
        return self.lib.Transform(rotation, translation)

    def calls(self, query, first, second, pose):
        lib = self.lib
        one, other = lib.CollisionObject(first, lib.Transform()), lib.CollisionObject(second, pose)
        if query == "distance":
            request, result = lib.DistanceRequest(), lib.DistanceResult()
            return (lambda: lib.distance(one, other, request, result)), (
                lambda: [result.min_distance <= 0, max(0.0, result.min_distance)])
        most = 1 if query == "first" else MANY
        # Without contacts the wrapper does not build a list of them, which would be counted as FCL's time.
        request = lib.CollisionRequest(num_max_contacts=most, enable_contact=False)
        result = lib.CollisionResult()
        return (lambda: lib.collide(one, other, request, result)), (
            lambda: [bool(result.is_collision), len(result.contacts)])


def least(call, repeats):
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return best * 1e6


class Bench:
    def __init__(self):
        self.peers, self.poses, self.models, self.empty = {}, [], {}, {}
        for name, peer in (("coal", Coal), ("fcl", Fcl)):
            try:
                self.peers[name] = peer()
            except ImportError as error:
                print(f"{name} is not installed: {error}", file=sys.stderr)

    def answer(self, request):
        if "mesh" in request:
            vertices, faces = read_obj(request["mesh"])
            self.makers = {name: peer.build(vertices, faces) for name, peer in self.peers.items()}
            self.models = {name: make() for name, make in self.makers.items()}
            return {"peers": {name: {"version": peer.version} for name, peer in self.peers.items()}}
        if "poses" in request:
            rows = np.loadtxt(request["poses"], delimiter=",")
            self.poses = [(row[:9].reshape(3, 3).copy(), row[9:].copy()) for row in rows]
            return {"poses": len(self.poses)}
        name, query, repeats = request["peer"], request["query"], request.get("repeats", 1)
        peer = self.peers[name]
        if query == "build":
            return {"us": [least(self.makers[name], repeats)]}
        near, far = peer.build(FAR * 0, ONE)(), peer.build(FAR, ONE)()
        nowhere = peer.place(np.eye(3), np.zeros(3))
        call, _ = peer.calls(query, near, far, nowhere)
        empty = least(call, 200)
        model, times, answers = self.models[name], [], []
        for rotation, translation in self.poses:
            pose = peer.place(rotation, translation)
            best = float("inf")
            for _ in range(repeats):
                # Results keep what was found: a fresh one each time, made outside the clock.
                call, found = peer.calls(query, model, model, pose)
                best = min(best, least(call, 1))
            times.append(max(0.0, best - empty))
            hit, value = found()
            answers.append([bool(hit), float(value)])
        return {"us": times, "empty_us": empty, "answers": answers}


def main():
    bench = Bench()
    for line in sys.stdin:
        try:
            answer = bench.answer(json.loads(line))
        except Exception as error:  # A bad request is answered, whatever it was.
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
