"""Opens recordings with the MCAP project's own reader and holds them against their runs' summaries.

recording.py RECORDING SUMMARY    one recording
recording.py --same A B           A.mcap and B.mcap hold the same messages, and the runs ended in the same state
"""

import json
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory


def summary_of(path: str) -> dict:
    with open(path, encoding="utf-8") as file:
        run = json.load(file)
    assert run["error"] is None, run["error"]
    assert run["recording_complete"] is True, "the program says that its recording has gaps"
    for fault in run["faults"]:
        assert fault["resumed_secs"] is not None, fault
    return run


def opened(recording: str, summary: str) -> None:
    run = summary_of(summary)
    with open(recording, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        statistics = reader.get_summary().statistics
        channels = reader.get_summary().channels
        counts, last, size, told, blocks = {}, 0, 0, {}, []
        decoders = DecoderFactory()
        for schema, channel, message in reader.iter_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            if schema is not None and schema.encoding == "protobuf":
                blocks.append(decoders.decoder_for(channel.message_encoding, schema)(message.data))
            elif schema is not None:
                told.setdefault(channel.topic, []).append(by_schema(schema, message))
            last = max(last, message.log_time)
            size += len(message.data)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = [record.name for record in reader.iter_attachments()]

    total = sum(counts.values())
    assert total == statistics.message_count > 0, (total, statistics.message_count)
    seconds = last * 1e-9
    assert abs(seconds - run["sim_secs"]) < 0.1, (seconds, run["sim_secs"])
    assert any(run["scenario"] in json.dumps(entry) for entry in metadata.values()), metadata.keys()
    assert attachments == ["scenario.toml"], attachments
    check_blocks(blocks, metadata["trocar.end"])
    lives = 1 + next(row["restarts"] for row in run["controllers"] if row["name"] == "recorder")
    check_told(told, run)
    print(f"{len(channels)} channels, {total} messages, {size} bytes, {seconds:.3f} s, {lives} lives of the recorder")
    for topic in sorted(counts):
        print(f"  {topic}: {counts[topic]}")


def check_blocks(blocks: list, end: dict) -> None:
    """The columns that only Trocar reads: their frame is told to all, and the last hashes are those of the end."""
    assert [blocks[-1].stored_hash.hex(), blocks[-1].state_hash.hex()] == [end["hash"], end["state_hash"]], end
    revisions = [block.revision for block in blocks]
    assert max(revisions) <= int(end["revision"]) and all(block.columns for block in blocks), revisions


def by_schema(schema, message) -> dict:
    """A message for tools, which has the fields that its schema asks for."""
    form = json.loads(schema.data)
    assert schema.encoding == "jsonschema" and form["title"] == schema.name, schema.name
    told = json.loads(message.data)
    assert set(form["required"]) <= set(told) <= set(form["properties"]), (schema.name, told)
    assert None not in told.values(), (schema.name, told)
    return told


def check_told(told: dict, run: dict) -> None:
    """Poses, forces, events, phases, score and what is to be seen, against the run's summary."""
    transforms = [one for topic in ("/tf", "/tf_static") for message in told[topic] for one in message["transforms"]]
    frames = {"world"} | {one["child_frame_id"] for one in transforms}
    for one in transforms:
        assert abs(sum(part**2 for part in one["rotation"].values()) - 1) < 1e-4, one
        assert one["parent_frame_id"] in frames, one
    assert len(frames) > 5, frames
    for topic in ("/scene", "/scene/deforming"):
        for message in told.get(topic, []):
            assert message["entities"] and all(one["frame_id"] in frames for one in message["entities"]), topic

    hands = [topic for topic in told if topic.startswith("/hands/")]
    assert hands, "no hands"
    for topic in hands:
        assert abs(len(told[topic]) - 30 * run["sim_secs"]) <= 2, (topic, len(told[topic]))
        force = max(message["applied_norm"] for message in told[topic])
        assert force <= run["force_newtons_max"] + 1e-3, (topic, force)

    names = {one["subject"] for one in told.get("/events", [])}
    assert all(0 <= one["at_secs"] <= run["sim_secs"] and one["name"] for one in told.get("/events", [])), names

    before = None
    for one in told["/task/phases"]:
        assert one.get("before") == before, (one, before)
        before = one["phase"]
    last, task = told["/task"][-1], run["task"]
    assert last["phase"] == before, (last, before)
    assert abs(last["seconds"] - task["seconds"]) < 1e-3, (last["seconds"], task["seconds"])
    assert last["errors"] == len(task["errors"]) and last["completed"] == task["completed"], (last, task)
    score = task["score"]
    told_score = last.get("score")
    assert told_score == score or abs(told_score - score) < 1e-4 * abs(score), (told_score, score)


def same(first: str, second: str) -> None:
    def messages(name: str) -> list:
        with open(f"{name}.mcap", "rb") as file:
            reader = make_reader(file, validate_crcs=True)
            return [(channel.topic, m.log_time, m.data) for _schema, channel, m in reader.iter_messages()]

    runs = [summary_of(f"{name}.json") for name in (first, second)]
    assert runs[0]["state_hash"] == runs[1]["state_hash"], "the runs ended in different states"
    assert messages(first) == messages(second), "the recordings differ"
    print("the same messages, whether the recorder was killed or not")


if __name__ == "__main__":
    if sys.argv[1] == "--same":
        same(*sys.argv[2:])
    else:
        opened(*sys.argv[1:])
