"""What a command says while it works, on a terminal and in a file."""

import os
import pty
import re
import subprocess
import sys

from simnfnd.factory import progress
from tests.factory.scheduler.staged import staged
from tests.fake_source import FakeConfig
from tests.project_files import ROOT

COUNTS = re.compile(r"frames (\d+)/16.*, pairs (\d+)/32; \d+:\d\d gone(?:, \d+:\d\d left)?")


def test_a_run_counts_frames_and_pairs_from_the_first_one_on(tmp_path, capfd):
    staged(tmp_path / "dataset", FakeConfig(delay_s=0.01), scheduler={"backend": "serial"})
    lines = capfd.readouterr().err.splitlines()
    assert lines[0] == "starting 2 workers (2 of them for renders) for 32 pairs"
    counted = [COUNTS.fullmatch(line) for line in lines if line.startswith("frames")]
    assert counted[0] is not None
    assert counted[0].groups() == ("1", "0")
    assert "left" in counted[0].group()
    assert counted[-1] is not None
    assert counted[-1].groups() == ("16", "32")
    assert lines[-1] == "writing index, card"


def test_a_bar_in_a_file_is_a_few_whole_lines(capfd):
    with progress.progress_bar(total=5000, unit="step", desc="training") as bar:
        for step in range(5000):
            bar.set_postfix(loss=f"{step / 3:.3g}")
            bar.update()
    text = capfd.readouterr().err
    assert "\r" not in text
    lines = text.splitlines()
    assert len(lines) <= 3
    assert lines[0].startswith("training: 1 of 5000 steps in 0:00, ")
    assert lines[-1] == "training: 5000 of 5000 steps in 0:00; loss 1.67e+03"


TERMINAL = """
import sys
from pathlib import Path
from tests.factory.scheduler.staged import staged
from tests.fake_source import FakeConfig
staged(Path(sys.argv[1]), FakeConfig(delay_s=0.02), scheduler={"backend": "serial"})
"""


def test_on_a_terminal_one_bar_counts_both(tmp_path):
    command = [sys.executable, "-c", TERMINAL, str(tmp_path / "dataset")]
    shown = on_terminal(command)
    assert "frames 1/16, pairs 0/32; " in shown
    shares = [int(share) for share in re.findall(r"(\d+)%\|", shown)]
    assert shares[0] == 0
    assert shares[-1] == 100
    assert shares == sorted(shares), "it never goes back"


def on_terminal(command: list[str]) -> str:
    """All that a command shows on a terminal."""
    parent, child = pty.openpty()
    process = subprocess.Popen(command, cwd=ROOT, stderr=child, stdout=child, close_fds=True)
    os.close(child)
    shown = b""
    try:
        while more := os.read(parent, 4096):
            shown += more
    except OSError:  # the other end is closed
        pass
    process.wait(timeout=60)
    os.close(parent)
    return shown.decode()
