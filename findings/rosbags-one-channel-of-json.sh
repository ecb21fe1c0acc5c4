#!/usr/bin/env bash
# rosbags 0.11.9 and mcap-ros2-support 0.6.0 on MCAP files that hold messages of ROS 2, encoded and defined as these should be.
#
# Guess: whoever reads messages of ROS 2 reads those of a file that has a topic of JSON beside them (a viewer's, say), and of a
# file whose header names no profile, which MCAP leaves free and its own writer leaves out.
# Seen: mcap-ros2-support reads both. rosbags opens neither: of the first it knows no schema encoding `jsonschema`, though nobody
# asks for that topic, and the second is "not ros2".
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0
env/bin/python - <<'PYTHON'
from mcap.writer import Writer
from mcap_ros2.reader import read_ros2_messages
from rosbags.rosbag2 import Reader

TEXT = b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00"


def write(name, profile, json):
    with open(name, "wb") as sink:
        writer = Writer(sink)
        writer.start(**profile)
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/words", "cdr", schema)
        writer.add_message(channel, log_time=10, data=TEXT, publish_time=10)
        if json:
            other = writer.register_channel("/scene", "json", writer.register_schema("Scene", "jsonschema", b"{}"))
            writer.add_message(other, log_time=11, data=b"{}", publish_time=11)
        writer.finish()


def opened(name):
    try:
        with Reader(name) as reader:
            return [one.topic for one in reader.connections]
    except Exception as error:
        return repr(error)


write("plain.mcap", {"profile": "ros2"}, json=False)
write("json.mcap", {"profile": "ros2"}, json=True)
write("noprofile.mcap", {}, json=False)
for name in ("plain.mcap", "json.mcap", "noprofile.mcap"):
    words = [one.ros_msg.data for one in read_ros2_messages(name, topics=["/words"])]
    print(f"{name}: mcap-ros2-support {words}, rosbags {opened(name)}")
    assert words == ["hi"]
assert opened("plain.mcap") == ["/words"]
assert opened("json.mcap") == "KeyError('jsonschema')"
assert "Profile is not ros2" in opened("noprofile.mcap")
PYTHON
