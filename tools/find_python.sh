#!/usr/bin/env bash
# Prints the Python 3.11 that the virtual environment is made from, or says what to do.
# Blender's bpy module exists for no other version.  PYTHON311=/path/to/python overrides the search.
set -euo pipefail

is_311() { "$1" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' >/dev/null 2>&1; }

if [[ -n "${PYTHON311:-}" ]]; then
    if is_311 "$PYTHON311"; then
        command -v "$PYTHON311"
        exit
    fi
    echo "error: PYTHON311=$PYTHON311 is not a working Python 3.11" >&2
    exit 2
fi
for name in python3.11 python3 python; do
    # Every match on the PATH: a version manager's shim may stand before a Python that works.
    while read -r candidate; do
        if is_311 "$candidate"; then
            echo "$candidate"
            exit
        fi
    done < <(type -Pa "$name")
done
echo "error: no Python 3.11 found (Blender's bpy exists for no other version);" \
    "install it and run: make setup PYTHON311=/path/to/python3.11" >&2
exit 2
