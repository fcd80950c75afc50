"""Runs an example as its reader would."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.project_files import ROOT

EXAMPLES = ROOT / "examples"


def run(
    script: str, *words: str, python: str = sys.executable, cwd: Path
) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    if python == sys.executable:
        environment["PYTHONPATH"] = str(ROOT)
    return subprocess.run(
        [python, str(EXAMPLES / script), *words],
        cwd=cwd,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
