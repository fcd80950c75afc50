#!/usr/bin/env bash
# What a machine can do for a release (docs/releasing.md): `make release`.  Uploads nothing.
#   PYTHON  the environment's python (default: .venv/bin/python)
#   PIP_ARGS  options of the one pip call, for example --index-url URL
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
python="${PYTHON:-.venv/bin/python}"

"$python" -m tools.release_check
rm -rf build/lib build/bdist.* dist
# From what is committed alone: a checkout holds more.
source="$(mktemp -d)"
trap 'rm -rf "$source"' EXIT
git archive HEAD | tar -x -C "$source"
"$python" -m build --no-isolation --outdir "$PWD/dist" "$source" >"$source.log" 2>&1 \
    || { tail -30 "$source.log" >&2; exit 1; }
rm -f "$source.log"
"$python" -m twine check --strict dist/*

# A fresh environment with nothing but the wheel and what it needs.
"$python" -m venv "$source/fresh"
# shellcheck disable=SC2086
"$source/fresh/bin/python" -m pip install --quiet --disable-pip-version-check ${PIP_ARGS:-} \
    -c constraints.txt "$(ls "$PWD"/dist/*.whl)"
mkdir "$source/elsewhere"
cd "$source/elsewhere"
simnfnd="$source/fresh/bin/simnfnd"
"$simnfnd" --version
"$simnfnd" demo render=analytic scenes.frames_per_location=1 scenes.width=484 scenes.height=304
"$simnfnd" validate outputs/demo --deep
"$source/fresh/bin/python" - <<'PY'
from simnfnd import PairDataset

with PairDataset("outputs/demo", "all") as pairs:
    print(len(pairs), "pairs of", pairs[0]["noisy"].shape, "read by the wheel")
PY
echo "ready: dist/"
