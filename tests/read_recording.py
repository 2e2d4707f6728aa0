"""The program of docs/recordings.md: reads peg-transfer.mcap in the current folder."""

import json
from mcap.reader import make_reader

forces = {}
with open("peg-transfer.mcap", "rb") as file:
    for schema, channel, message in make_reader(file).iter_messages():
        if schema is None or schema.encoding != "jsonschema":  # Trocar's own
            continue
        told, seconds = json.loads(message.data), message.log_time * 1e-9
        if schema.name == "trocar.Hand":
            forces[told["side"]] = max(forces.get(told["side"], 0.0), told["applied_norm"])
        elif schema.name == "trocar.TaskPhase":
            print(f"{seconds:7.2f} s  {told['phase']}")
        elif schema.name == "trocar.Task":
            score = told.get("score")
print(forces, score)
