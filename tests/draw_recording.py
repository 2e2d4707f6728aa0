"""Draws what a viewer shows of a recording, from its messages for tools alone: the picture in docs/recordings.md.

draw_recording.py RECORDING SECONDS PICTURE    needs the packages mcap and matplotlib
"""

import json
import sys

import matplotlib
import numpy as np
from mcap.reader import make_reader

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402  (the choice of a backend comes first)


def read(file: str) -> dict:
    """Topic → times in seconds and messages."""
    told = {}
    with open(file, "rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            if schema is not None:
                told.setdefault(channel.topic, []).append((message.log_time * 1e-9, json.loads(message.data)))
    return told


def matrix(position: dict, rotation: dict) -> np.ndarray:
    x, y, z, w = (rotation[part] for part in "xyzw")
    of = np.eye(4)
    of[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    of[:3, 3] = [position[part] for part in "xyz"]
    return of


def frames_at(told: dict, at: float) -> dict:
    """`world_from_frame` of every frame: the last that was told of each."""
    last = {}
    for time, message in told["/tf"]:
        if time <= at:
            last |= {one["child_frame_id"]: one for one in message["transforms"]}

    def world_from(frame: str) -> np.ndarray:
        if frame not in last:
            return np.eye(4)
        one = last[frame]
        return world_from(one["parent_frame_id"]) @ matrix(one["translation"], one["rotation"])

    return {frame: world_from(frame) for frame in [*last, "world"]}


def points(of: list) -> np.ndarray:
    return np.array([[one["x"], one["y"], one["z"]] for one in of])


def box(size: np.ndarray) -> list:
    """Faces of a box about the origin."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
    sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return [corners[side] for side in sides]


def round_body(size: np.ndarray, ball: bool, segments: int = 16) -> list:
    """Faces of a ball or a cylinder about the origin."""
    turns = np.linspace(0, 2 * np.pi, segments + 1)
    levels = np.linspace(-np.pi / 2, np.pi / 2, 9) if ball else np.array([-1.0, 1.0])
    rings = []
    for level in levels:
        radius, height = (np.cos(level), np.sin(level)) if ball else (1.0, level)
        ring = [[radius * np.cos(turn), radius * np.sin(turn), height] for turn in turns]
        rings.append(np.array(ring) * size / 2)
    faces = [
        np.array([low[k], low[k + 1], high[k + 1], high[k]])
        for low, high in zip(rings, rings[1:])
        for k in range(segments)
    ]
    return faces if ball else [*faces, rings[0], rings[-1]]


def faces_of(entity: dict) -> list:
    """Faces in the entity's frame, each with its colour."""
    found = []
    for kind, form in (
        ("cubes", box),
        ("spheres", lambda size: round_body(size, True)),
        ("cylinders", lambda size: round_body(size, False)),
    ):
        for one in entity[kind]:
            at = matrix(one["pose"]["position"], one["pose"]["orientation"])
            faces = form(points([one["size"]])[0])
            found += [(face @ at[:3, :3].T + at[:3, 3], one["color"]) for face in faces]
    for one in entity["triangles"]:
        corners = points(one["points"])
        found += [(corners[one["indices"][k : k + 3]], one["color"]) for k in range(0, len(one["indices"]), 3)]
    return found


class View:
    """A picture with depths, seen from a camera that looks at a place."""

    def __init__(self, target: np.ndarray, distance: float, width: int, height: int) -> None:
        away = np.array([0.1, -0.75, 0.62])
        self.back = away / np.linalg.norm(away)
        self.right = np.cross([0, 0, 1], self.back) / np.linalg.norm(np.cross([0, 0, 1], self.back))
        self.up = np.cross(self.back, self.right)
        self.eye = target + distance * self.back
        self.scale = 1.3 * height
        self.size = np.array([width, height])
        self.colors = np.full((height, width, 3), 0.93)
        self.depths = np.full((height, width), np.inf)

    def project(self, at: np.ndarray) -> np.ndarray:
        """Column, row and depth of points; of those behind the camera the depth is not positive."""
        seen = at - self.eye
        depth = -seen @ self.back
        by = np.maximum(depth, 1e-6)
        flat = np.stack([seen @ self.right / by, -seen @ self.up / by], axis=-1) * self.scale + self.size / 2
        return np.concatenate([flat, depth[..., None]], axis=-1)

    def triangle(self, corners: np.ndarray, color: np.ndarray, splits: int = 5) -> None:
        at = self.project(corners)
        if np.any(at[:, 2] < 0.02):
            # Part of it is behind the camera: its parts in front of it are drawn.
            if splits > 0 and np.any(at[:, 2] >= 0.02):
                middles = (corners + np.roll(corners, -1, axis=0)) / 2
                for corner in range(3):
                    part = np.array([corners[corner], middles[corner], middles[corner - 1]])
                    self.triangle(part, color, splits - 1)
                self.triangle(middles, color, splits - 1)
            return
        low = np.clip(np.floor(at[:, :2].min(axis=0)).astype(int), 0, self.size)
        high = np.clip(np.ceil(at[:, :2].max(axis=0)).astype(int) + 1, 0, self.size)
        if np.any(low >= high):
            return
        (ax, ay), (bx, by), (cx, cy) = at[:, :2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            return
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
        c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
        # Depths are linear over the picture as their inverses.
        inverse = (1 - b - c) / at[0, 2] + b / at[1, 2] + c / at[2, 2]
        depth = 1 / np.where(inverse > 0, inverse, 1e-9)
        place = np.s_[low[1] : high[1], low[0] : high[0]]
        nearer = (b >= 0) & (c >= 0) & (b + c <= 1) & (depth < self.depths[place])
        self.depths[place][nearer] = depth[nearer]
        self.colors[place][nearer] = color

    def line(self, ends: np.ndarray, color: np.ndarray, thickness: float) -> None:
        for share in np.linspace(0, 1, 40):
            column, row, depth = self.project(ends[0] + share * (ends[1] - ends[0]))
            if depth < 0.005:
                continue
            half = min(max(1, round(0.5 * thickness * self.scale / depth)), 4)
            rows, columns = (slice(max(int(at) - half, 0), max(int(at) + half, 0)) for at in (row, column))
            place = (rows, columns)
            nearer = depth < self.depths[place] + 1e-3
            self.colors[place][nearer] = color


def draw_scene(axes, told: dict, at: float) -> None:
    frames = frames_at(told, at)
    light = np.array([0.35, -0.45, 0.82])
    shown = []
    for topic in ("/scene", "/scene/deforming"):
        before = [message for time, message in told.get(topic, []) if time <= at]
        shown += before[-1]["entities"] if before else []
    tips = [frames[one["id"]][:3, 3] for one in shown if one["id"].endswith("/jaw_a")]
    places = tips or [frames[one["frame_id"]][:3, 3] for one in shown]
    view = View(np.mean(places, axis=0) - [0, 0, 0.02], 0.3, 980, 860)
    for entity in shown:
        world = frames[entity["frame_id"]]
        for face, color in faces_of(entity):
            face = face @ world[:3, :3].T + world[:3, 3]
            normal = np.cross(face[1] - face[0], face[2] - face[0])
            length = np.linalg.norm(normal)
            share = 0.45 + 0.55 * abs(normal @ light) / length if length > 0 else 1.0
            for corner in range(1, len(face) - 1):
                view.triangle(face[[0, corner, corner + 1]], share * np.array([color[part] for part in "rgb"]))
        for one in entity["lines"]:
            line = points(one["points"]) @ world[:3, :3].T + world[:3, 3]
            for pair in np.array(one["indices"]).reshape(-1, 2):
                view.line(line[pair], np.array([one["color"][part] for part in "rgb"]), one["thickness"])
    # The axes of frames, as the panel draws them; those beside the camera (a light, the scene's own camera) would hide
    # everything else.
    for frame, world in frames.items():
        if "/" not in frame and view.project(world[:3, 3])[2] > 0.15:
            for axis in range(3):
                ends = np.array([world[:3, 3], world[:3, 3] + 0.012 * world[:3, axis]])
                view.line(ends, 0.85 * np.eye(3)[axis], 0.0005)
    axes.imshow(view.colors.reshape(430, 2, 490, 2, 3).mean(axis=(1, 3)).clip(0, 1))
    axes.set_axis_off()


def draw(file: str, at: float, picture: str) -> None:
    told = read(file)
    plt.rcParams.update({"font.size": 8, "font.family": "sans-serif"})
    figure = plt.figure(figsize=(9.6, 4.8), facecolor="#f6f6f6")
    axes = figure.add_axes((0.01, 0.02, 0.51, 0.9))
    draw_scene(axes, told, at)
    figure.text(0.02, 0.94, f"3D: /scene, /scene/deforming, /tf   at {at:.1f} s", weight="bold")

    plot = figure.add_axes((0.58, 0.6, 0.4, 0.32))
    for topic in sorted(topic for topic in told if topic.startswith("/hands/")):
        times, messages = zip(*told[topic])
        forces = [message["applied_norm"] for message in messages]
        plot.plot(times, forces, linewidth=1, label=f"{topic}.applied_norm")
    plot.set_ylabel("N")
    plot.legend(fontsize=7, loc="upper right", framealpha=0.9)
    plot.set_title("Plot", loc="left", weight="bold", fontsize=8)

    opening = figure.add_axes((0.58, 0.36, 0.4, 0.17), sharex=plot)
    for topic in sorted(topic for topic in told if topic.startswith("/hands/")):
        times, messages = zip(*told[topic])
        opening.plot(times, [message["jaw"] for message in messages], linewidth=1, label=f"{topic}.jaw")
    opening.set_ylabel("rad")
    opening.legend(fontsize=7, loc="upper right", framealpha=0.9)

    phases = figure.add_axes((0.58, 0.1, 0.4, 0.09), sharex=plot)
    begins = told.get("/task/phases", [])
    ends = [time for time, _ in begins[1:]] + [told["/tf"][-1][0]]
    colors = {}
    for (begin, message), end in zip(begins, ends):
        color = colors.setdefault(message["phase"], plt.cm.tab10(len(colors) % 10))
        phases.barh(0, end - begin, left=begin, color=color, height=1)
    for name, color in colors.items():
        phases.barh(0, 0, color=color, label=name)
    phases.legend(fontsize=6, loc="upper center", bbox_to_anchor=(0.5, 1.5), ncols=max(len(colors), 1), frameon=False)
    phases.set_yticks([])
    phases.set_xlabel("s")
    phases.set_title("State Transitions: /task.phase", loc="left", weight="bold", fontsize=8, y=1.45)
    for axes in (plot, opening, phases):
        axes.axvline(at, color="#888", linewidth=0.8, linestyle="--")
    figure.savefig(picture, dpi=100)


if __name__ == "__main__":
    draw(sys.argv[1], float(sys.argv[2]), sys.argv[3])
