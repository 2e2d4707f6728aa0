"""A client of another make: reads the poses of a session over Zenoh, and commands one of its hands if it may.

Needs the client from PyPI (requirements-zenoh.txt) and nothing of Trocar.

    python zenoh_peer.py --connect tcp/127.0.0.1:7447 --session wall --hand right --seconds 5

Prints one JSON object: what was read, whether the claim was given, and how far the hand has moved.
"""

import argparse
import json
import math
import threading
import time
from importlib.metadata import version

import zenoh


def configuration(args):
    """Settings of a client that calls one place."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([args.connect]))
    config.insert_json5("scouting/multicast/enabled", "false")
    if args.authority:
        config.insert_json5("transport/link/tls/root_ca_certificate", json.dumps(args.authority))
    if args.certificate:
        config.insert_json5("transport/link/tls/enable_mtls", "true")
        config.insert_json5("transport/link/tls/connect_certificate", json.dumps(args.certificate))
        config.insert_json5("transport/link/tls/connect_private_key", json.dumps(args.key))
    return config


class Seen:
    """What has been read."""

    def __init__(self):
        self.lock = threading.Lock()
        self.counts, self.poses, self.answer = {}, {}, None

    def take(self, sample):
        """A message of the session."""
        key = str(sample.key_expr)
        value = json.loads(sample.payload.to_string())
        kind = key.split("/")[2]
        with self.lock:
            self.counts[kind] = self.counts.get(kind, 0) + 1
            if kind == "pose":
                self.poses.setdefault(value["child_frame_id"], []).append(value["translation"])
                del self.poses[value["child_frame_id"]][1:-1]
            elif key.endswith("/answer"):
                self.answer = value


def claim(session, base, hand, patience_secs):
    """The claim of a hand, once it is free; none if it is not ours to have."""
    until = time.monotonic() + patience_secs
    refusal = "nobody answers"
    while time.monotonic() < until:
        for reply in session.get(f"{base}/hand/{hand}/claim", timeout=0.5):
            if reply.ok is not None:
                return json.loads(reply.ok.payload.to_string())["claim"], None
            refusal = reply.err.payload.to_string()
        time.sleep(0.05)
    return None, refusal


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--connect", required=True)
    parser.add_argument("--session", required=True)
    parser.add_argument("--hand")
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--reach", type=float, default=0.02, help="how far the hand goes to and fro [m]")
    parser.add_argument("--authority")
    parser.add_argument("--certificate")
    parser.add_argument("--key")
    args = parser.parse_args()

    base, seen = f"trocar/{args.session}", Seen()
    session = zenoh.open(configuration(args))
    told = {"client": version("eclipse-zenoh"), "commands": 0}
    subscriber = session.declare_subscriber(f"{base}/**", seen.take)
    info = [reply.ok for reply in session.get(f"{base}/info", timeout=2.0) if reply.ok is not None]
    told["info"] = json.loads(info[0].payload.to_string()) if info else None
    tokens = session.liveliness().get(f"{base}/alive", timeout=2.0)
    told["alive"] = sum(reply.ok is not None for reply in tokens) > 0
    code = None
    if args.hand:
        code, told["refusal"] = claim(session, base, args.hand, 2.0)
    told["claimed"] = code is not None
    places, begun = [], time.monotonic()
    while (secs := time.monotonic() - begun) < args.seconds:
        # Without a claim it tries all the same: who has no right moves nothing.
        if args.hand:
            told["commands"] += 1
            command = {
                "claim": code or "0" * 16,
                "sequence": told["commands"],
                "position": [args.reach * math.sin(2.0 * math.pi * 0.5 * secs), 0.0, 0.0],
                "gripper": 0.2,
            }
            session.put(f"{base}/hand/{args.hand}/command", json.dumps(command))
            with seen.lock:
                if seen.answer is not None and seen.answer["presence"] == "live":
                    places.append(seen.answer["position"][0])
        time.sleep(0.01)
    with seen.lock:
        told["messages"], told["answer"] = seen.counts, seen.answer
        told["moving"] = sorted(
            name for name, places in seen.poses.items() if math.dist(places[0].values(), places[-1].values()) > 1e-5
        )
        told["poses"] = sorted(seen.poses)
    told["range"] = max(places) - min(places) if places else 0.0
    del subscriber
    session.close()
    print(json.dumps(told))


if __name__ == "__main__":
    main()
