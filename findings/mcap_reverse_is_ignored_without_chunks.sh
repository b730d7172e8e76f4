#!/bin/sh
# mcap 1.6.0: iter_messages(reverse=True), "messages will be yielded in descending log time order".
#
# Expected: the newest message first, for every valid file.
# Seen: for a file without chunks (use_chunking=False here; noChunking for ROS 2's recorder) make_reader's reader does not
# pass the argument on, and the oldest comes first, without a warning. next(reader.iter_messages(reverse=True)), the usual
# way to ask where an arm stood at the end, says where it stood at the beginning.
# The same reader without seeking turns the same file round.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet mcap==1.6.0
"$folder/venv/bin/python" - <<'PY'
import io

from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import Writer

seen = {}
for chunks in (True, False):
    file = io.BytesIO()
    writer = Writer(file, use_chunking=chunks)
    writer.start()
    channel = writer.register_channel("/joint_states", "json", writer.register_schema("joints", "jsonschema", b"{}"))
    for degrees in (0, 10, 20, 30):
        writer.add_message(channel, log_time=degrees, publish_time=degrees, data=b'{"elbow_deg": %d}' % degrees)
    writer.finish()
    for reader in (make_reader, NonSeekingReader):
        file.seek(0)
        seen[chunks, reader] = [message.log_time for _, _, message in reader(file).iter_messages(reverse=True)]
        print(f"chunks {chunks}, {reader.__name__}: {seen[chunks, reader]}")
assert seen.pop((False, make_reader)) == [0, 10, 20, 30]
assert all(times == [30, 20, 10, 0] for times in seen.values())
PY
