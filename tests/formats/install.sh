#!/usr/bin/env bash
# install.sh FOLDER [NAME...]: an environment for each devkit, or for those named, below FOLDER; for `pytest -m formats`.
# Their packages contradict one another and fgrecon's (numpy 1, Python 3.10), so that each has its own.
set -euo pipefail
mkdir -p "$1"; folder=$(cd "$1" && pwd); shift
here=$(cd "$(dirname "$0")" && pwd)
for file in "$here"/devkits/*.txt; do
  name=$(basename "$file" .txt)
  [ $# = 0 ] || [[ " $* " == *" $name "* ]] || continue
  python=$(sed -n 's/^# python: //p' "$file")
  "${python:-python3.11}" -m venv "$folder/$name"
  "$folder/$name/bin/pip" install --quiet $(sed -n 's/^# pip: //p' "$file") -r "$file"
done
