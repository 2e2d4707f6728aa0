"""Opens a recording with the MCAP project's own reader and holds it against the run's summary."""

import json
import sys

from mcap.reader import make_reader


def main(recording: str, summary: str) -> None:
    with open(summary, encoding="utf-8") as file:
        run = json.load(file)
    assert run["error"] is None, run["error"]
    assert run["recording_complete"] is True, "the program says that its recording has gaps"

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

    total = sum(counts.values())
    assert total == statistics.message_count > 0, (total, statistics.message_count)
    seconds = last * 1e-9
    assert abs(seconds - run["sim_secs"]) < 0.1, (seconds, run["sim_secs"])
    assert any(run["scenario"] in json.dumps(entry) for entry in metadata.values()), metadata.keys()
    print(f"{len(channels)} channels, {total} messages, {size} bytes, {seconds:.3f} s")
    for topic in sorted(counts):
        print(f"  {topic}: {counts[topic]}")


if __name__ == "__main__":
    main(*sys.argv[1:])
