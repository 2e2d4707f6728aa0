"""Opens recordings with the MCAP project's own reader and holds them against their runs' summaries.

recording.py RECORDING SUMMARY    one recording
recording.py --same A B           A.mcap and B.mcap hold the same messages, and the runs ended in the same state
"""

import json
import sys

from mcap.reader import make_reader


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
        counts, last, size = {}, 0, 0
        for _schema, channel, message in reader.iter_messages():
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
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
    lives = 1 + next(row["restarts"] for row in run["controllers"] if row["name"] == "recorder")
    print(f"{len(channels)} channels, {total} messages, {size} bytes, {seconds:.3f} s, {lives} lives of the recorder")
    for topic in sorted(counts):
        print(f"  {topic}: {counts[topic]}")


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
