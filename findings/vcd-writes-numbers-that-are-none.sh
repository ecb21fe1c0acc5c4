#!/usr/bin/env bash
# vcd 6.0.3 (OpenLABEL): NaN is written into the file, and the check against OpenLABEL's schema lets it pass.
#
# Guess: stringify(), which validates, refuses a cuboid of NaN, as JSON has no such number.
# Seen: {"val":[NaN, ...]}, which no strict reader of JSON takes (JavaScript, jq, Go, Rust); a tool that marks what it does not
# know by NaN makes files that open in Python alone.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet vcd==6.0.3
env/bin/python - <<'PYTHON'
import json

from vcd import core, types

labels = core.OpenLABEL()
car = labels.add_object("car", "car", frame_value=0)
labels.add_object_data(car, types.cuboid("shape", [1.0, 2.0, 3.0, 0.0, 0.0, float("nan"), 4.0, 2.0, 1.5]), frame_value=0)
text = labels.stringify(False, True)


def refuse(word):
    raise ValueError(word)


try:
    json.loads(text, parse_constant=refuse)
    strict = "read"
except ValueError as error:
    strict = f"refused: {error}"
print(text[text.index("cuboid"):][:90], "| a strict reader:", strict)
assert strict == "refused: NaN"
PYTHON
