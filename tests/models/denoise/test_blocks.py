"""Recordings are denoised in blocks: the same bytes however they are cut, interrupted or shared."""

from __future__ import annotations

import csv
import json
import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.models.denoise import options, sequences
from simnfnd.models.denoise.blocks import FOLDER, BlockFrame, BlockStore
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.denoise.records import FrameRecord
from simnfnd.models.denoise.temporal.stream import FrameFacts
from simnfnd.models.recordings.inputs import Geometries, find_items
from tests.models.denoise.test_resumed import (
    FRAMES,
    WRITERS,
    Smoothing,
    contents,
    moving_scene,
    use,
    write_video,
)

WORDS = ["--frames", "3", "--geometry", "none", "--out"]


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_stopped_recording_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Twice, in blocks of another size than an undisturbed run, to the same bytes."""
    WRITERS[name](tmp_path / name)
    words = [str(tmp_path / name), "--compare", "--table", str(tmp_path / "f.csv"), *WORDS]
    whole = use(monkeypatch, Smoothing())
    assert options.main([*words, str(tmp_path / "whole")]) == 0
    table = (tmp_path / "f.csv").read_bytes()
    assert len(table.splitlines()) == FRAMES + 1

    monkeypatch.setattr(sequences, "BLOCK_FRAMES", 8)
    out = tmp_path / "out"
    counts = []
    for at in (whole.count * 45 // 100, whole.count * 40 // 100):
        stopping = use(monkeypatch, Smoothing(at))
        with pytest.raises(KeyboardInterrupt):
            options.main([*words, str(out)])
        counts.append(stopping.count)
    last = use(monkeypatch, Smoothing())
    assert options.main([*words, str(out)]) == 0
    assert contents(out) == contents(tmp_path / "whole")
    assert not (out / FOLDER).exists()
    if name != "images":  # whose rows are of the last run alone
        assert (tmp_path / "f.csv").read_bytes() == table
        assert sum(counts) + last.count < 2.2 * whole.count


@pytest.mark.slow
def test_a_killed_run_goes_on(tmp_path: Path) -> None:
    """By KILL, in processes of their own."""
    write_video(tmp_path / "a.avi")
    script = tmp_path / "run.py"
    script.write_text(
        "import sys\n"
        "from simnfnd.models.denoise import command, options, sequences\n"
        "from tests.models.denoise.test_resumed import Smoothing\n"
        "at = int(sys.argv[1])\n"
        "command.Denoiser = lambda *arguments, **named: Smoothing(at or None, 9)\n"
        "sequences.BLOCK_FRAMES = 8\n"
        "sys.exit(options.main(sys.argv[2:]))\n"
    )

    def run(at: int, out: str) -> subprocess.CompletedProcess[str]:
        words = [str(tmp_path / "a.avi"), *WORDS, str(tmp_path / out)]
        call = [sys.executable, str(script), str(at), *words]
        return subprocess.run(call, capture_output=True, text=True, env={**os.environ})

    assert run(0, "whole").returncode == 0
    for at in (25, 35):
        assert run(at, "out").returncode == -signal.SIGKILL
    assert sorted((tmp_path / "out" / FOLDER).rglob("*.block"))
    last = run(0, "out")
    assert last.returncode == 0, last.stderr
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("causal", [False, True])
def test_a_part_of_a_recording_has_the_bytes_of_the_whole(tmp_path: Path, causal: bool) -> None:
    """Where frames drift, repeat, take turns, step in level and hide behind a title."""
    frames = moving_scene(240, 32)
    frames[1::3] = frames[::3]
    frames[160:180:2] = frames[160:180:2] // 2
    frames[181:183] = 90
    path = tmp_path / "a.npy"
    np.save(path, frames)
    (item,) = find_items([path], tmp_path / "out")
    source = sequences.RecordedFile(item, ())
    denoising = Denoising(Smoothing(), frames=7, causal=causal)
    means = sequences.Means(denoising, Geometries("find"), at_once=1)

    def part(first: int, last: int | None) -> dict[int, bytes]:
        finished = sequences.denoised_part(source, means, first, last)
        return {each.frame.number: each.image.tobytes() for each in finished}

    whole = part(0, None)
    assert sorted(whole) == list(range(240))
    for first, last in ((158, 161), (180, 184)):
        expected = {number: whole[number] for number in range(first, last + 1)}
        assert part(first, last) == expected


@pytest.mark.slow
def test_any_number_of_workers_makes_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, weights: Path
) -> None:
    np.save(tmp_path / "a.npy", moving_scene(60))
    WRITERS["images"](tmp_path / "images")
    results = []
    for workers, size in ((1, 16), (2, 20), (3, 7)):
        monkeypatch.setattr(sequences, "BLOCK_FRAMES", size)
        out = tmp_path / f"{workers}"
        words = [str(tmp_path / "a.npy"), str(tmp_path / "images"), "--weights", str(weights)]
        words += ["--workers", str(workers), *WORDS, str(out)]
        assert options.main(words) == 0
        results.append({**contents(out)})
    assert results[0] == results[1] == results[2]


def _stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The blocks of a recording that was stopped near its end."""
    np.save(tmp_path / "a.npy", moving_scene())
    monkeypatch.setattr(sequences, "BLOCK_FRAMES", 8)
    use(monkeypatch, Smoothing(40))
    with pytest.raises(KeyboardInterrupt):
        options.main([str(tmp_path / "a.npy"), *WORDS, str(tmp_path / "out")])
    return sorted((tmp_path / "out" / FOLDER).rglob("*.block"))


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["cut", "flipped", "of another source", "pickle", "bomb"])
def test_a_block_that_is_not_whole_is_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    path = _stopped(tmp_path, monkeypatch)[1]
    target = tmp_path / "target"
    target.write_text("kept")
    content = path.read_bytes()

    class Evil:
        def __reduce__(self) -> Any:
            return os.truncate, (str(target), 0)

    if damage == "cut":
        path.write_bytes(content[:-20])
    elif damage == "flipped":
        path.write_bytes(content[:-5] + bytes([content[-5] ^ 1]) + content[-4:])
    elif damage == "of another source":
        np.save(tmp_path / "a.npy", moving_scene()[::-1])
    elif damage == "pickle":
        path.write_bytes(pickle.dumps(Evil()))
    else:
        path.write_bytes(json.dumps({"lengths": [1 << 60], "sha256": ""}).encode() + b"\n")
    use(monkeypatch, Smoothing())
    assert options.main([str(tmp_path / "a.npy"), *WORDS, str(tmp_path / "out")]) == 0
    assert options.main([str(tmp_path / "a.npy"), *WORDS, str(tmp_path / "whole")]) == 0
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")
    assert target.read_text() == "kept"


@pytest.mark.slow
def test_a_forged_block_changes_its_own_pixels_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _stopped(tmp_path, monkeypatch)[1]
    key = _key(path)
    record = FrameRecord(FrameFacts(previous=7), None, False, False, False, "")
    frames = [BlockFrame(np.full((48, 48), 9, np.uint8), record)] * 8
    BlockStore(path.parent, key).write(8, frames)
    use(monkeypatch, Smoothing())
    assert options.main([str(tmp_path / "a.npy"), *WORDS, str(tmp_path / "out")]) == 0
    assert options.main([str(tmp_path / "a.npy"), *WORDS, str(tmp_path / "whole")]) == 0
    forged = np.load(tmp_path / "out" / "a.npy")
    whole = np.load(tmp_path / "whole" / "a.npy")
    assert (forged[8:16] == 9).all()
    np.testing.assert_array_equal(
        np.delete(forged, range(8, 16), 0), np.delete(whole, range(8, 16), 0)
    )


def _key(path: Path) -> str:
    """The key of a block, which whoever may write into the folder can find out."""
    from simnfnd.models.denoise.journal import Journal

    keys = []
    original = Journal.key

    def key(self: Journal, item: Any) -> str:
        keys.append(original(self, item))
        return keys[-1]

    source = path.parents[3] / "a.npy"
    (path.parent / "00000000.block").unlink()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Journal, "key", key)
        use(patch, Smoothing(1))
        with pytest.raises(KeyboardInterrupt):
            options.main([str(source), *WORDS, str(path.parents[2])])
    return keys[-1]


def test_the_table_of_frames_tells_how_the_scene_moved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.models.denoise.test_temporal import noisy, scene, view

    wide = scene()
    frames = [noisy(view(wide, 3 * n, -2 * n), n) for n in range(6)]
    np.save(tmp_path / "a.npy", np.stack(frames))
    use(monkeypatch, Smoothing())
    table = tmp_path / "frames.csv"
    words = [str(tmp_path / "a.npy"), "--table", str(table), *WORDS, str(tmp_path / "out")]
    assert options.main(words) == 0
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows[1:]:
        assert float(row["shift_x_px"]) == pytest.approx(3, abs=0.3)
        assert float(row["shift_y_px"]) == pytest.approx(-2, abs=0.3)
        assert float(row["rotation_deg"]) == pytest.approx(0, abs=0.2)
        assert 1 < float(row["frames_fused"]) <= 3
    assert [row["frame"] for row in rows] == list("012345")
