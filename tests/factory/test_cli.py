"""The command line: what it makes, what it says, and how it ends."""

import json
import signal
import sys

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.command import main
from tests.factory.cli_frames import FAST, ground, write_frame


def run(monkeypatch, *words: str) -> int:
    """Exit code of `simnfnd make WORDS`, in this process."""
    monkeypatch.setattr(sys, "argv", ["simnfnd"])  # Hydra's words are put there
    return main(words, default="make")


@pytest.fixture
def flsea(tmp_path):
    root = tmp_path / "flsea"
    for number in range(3):
        write_frame(root, f"1623304454176560{number}", ground() * (1 + 0.1 * number))
    write_frame(root, "16316026967750072", ground(), "red_sea/sub_pier")
    return root


def words_for(root, out="out", *more: str) -> list[str]:
    return ["scenes=flsea", f"scenes.root={root}", f"dataset.dir={out}", *FAST, *more]


def test_a_partial_download_makes_what_there_is(monkeypatch, tmp_path, flsea, capfd):
    out = tmp_path / "out"
    code = run(monkeypatch, "experiment=simnfnd", *words_for(flsea, out)[1:])
    printed = capfd.readouterr().out
    assert code == 0
    assert printed.strip().splitlines()[-1] == f"dataset: {out}"
    assert "flatiron" in printed  # absent scenes are told
    manifest = json.loads((out / "manifest.json").read_text())
    assert {shard["split"]: shard["samples"] for shard in manifest["shards"]} == {
        "test": 3,
        "train": 1,
    }
    with h5py.File(out / "test/shard-00000.h5") as shard:
        assert shard["noisy"].shape == (3, 256, 256)
        assert set(shard["meta"]["scene"]) == {b"u_canyon"}


def test_a_bad_frame_among_good_ones_is_skipped_and_named(monkeypatch, tmp_path, flsea, capfd):
    bad = ground()
    bad[3, 4] = np.nan
    write_frame(flsea, "16233045486672034", bad)
    out = tmp_path / "out"
    assert run(monkeypatch, *words_for(flsea, out)) == 1
    failures = [json.loads(line) for line in (out / "failed.jsonl").read_text().splitlines()]
    assert len(failures) == 1
    assert "16233045486672034" in failures[0]["frame"]
    assert "1 NaN" in failures[0]["reason"]
    assert "frames.only=" in failures[0]["command"]
    manifest = json.loads((out / "manifest.json").read_text())
    assert sum(shard["samples"] for shard in manifest["shards"]) == 4
    last = capfd.readouterr().out.strip().splitlines()[-1]
    assert last.startswith("failed: 1 of 5 frames, all because: depth has 1 NaN")
    assert last.endswith(f"`simnfnd status {out} --failed` lists them")
    assert main(["status", str(out)]) == 0
    assert "4 of 5 pairs" in capfd.readouterr().out


def test_pictures_that_show_next_to_nothing_name_the_likeliest_keys(
    monkeypatch, tmp_path, flsea, capfd
):
    words = ["scenes=flsea", f"scenes.root={flsea}", f"dataset.dir={tmp_path / 'out'}", *FAST]
    run(monkeypatch, *words, "sonar.range={auto: false, min_m: 0, max_m: 3000}")
    (told,) = (line for line in capfd.readouterr().err.splitlines() if "sonar.hfov_deg" in line)
    assert "% of the pictures is lit; check" in told


def test_when_every_frame_is_bad_the_run_ends_with_2(monkeypatch, tmp_path, capfd):
    root = tmp_path / "flsea"
    write_frame(root, "16233044541765633", ground())
    depth = root / "canyons/u_canyon/depth/16233044541765633_SeaErra_abs_depth.tif"
    cv2.imwrite(str(depth), ground() * 0)
    assert run(monkeypatch, *words_for(root, tmp_path / "o")) == 2
    error = capfd.readouterr().err
    assert "valid" in error
    assert "Traceback" not in error


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["scenes=flsea"], "scenes.root: a value is required"),
        (["scenes=flsea", "scenes.root=/does/not/exist"], "/does/not/exist"),
        (["scenes=flsea", "scenes.root={empty}"], "no"),
        (["+noise.backgroud.density=1"], "noise.backgroud"),
        (["resample.rate=1.5"], "resample.rate"),
        (["sonar.range.min_m=5", "sonar.range.max_m=5"], "min_m must be smaller than max_m"),
        (["noise.background.density={uniform: [3, 1]}"], "low 3 > high 1"),
        (["frames.only=[nowhere]"], "nowhere"),
        (["render=analytic", "sonar.mount.translation_m=[0,0,1]"], "casts no shadows"),
        (["seed=="], "seed: "),
    ],
)
def test_bad_input_is_one_clear_line_and_exit_code_2(monkeypatch, tmp_path, words, said, capfd):
    (tmp_path / "empty").mkdir()
    words = [word.replace("{empty}", str(tmp_path / "empty")) for word in words]
    code = run(monkeypatch, *words, f"dataset.dir={tmp_path / 'out'}")
    error = capfd.readouterr().err
    assert code == 2, error
    assert said in error
    assert len(error.strip().splitlines()) == 1
    assert error.startswith("error: ")
    assert not (tmp_path / "out").exists()


def test_a_traceback_is_shown_with_debug_only(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    with pytest.raises(Exception, match=r"resample\.rate"):
        main(["make", "resample.rate=0", "debug=true"])


def test_a_sweep_makes_one_named_dataset_a_point_and_one_table(monkeypatch, tmp_path, flsea, capfd):
    monkeypatch.chdir(tmp_path)
    code = run(
        monkeypatch,
        "-m",
        "noise.background.density=0.1,0.5",
        "resample.rate=0.1,0.3",
        "experiment=physical",  # which names one folder
        "acoustics=points",
        "noise=none",
        "noise.background.enabled=true",
        "scenes=flsea",
        f"scenes.root={flsea}",
        *FAST,
    )
    assert code == 0
    datasets = sorted(path.parent for path in tmp_path.glob("outputs/*/manifest.json"))
    assert len(datasets) == 4
    table = next(tmp_path.glob("outputs/sweeps/*/sweep.md")).read_text().splitlines()
    assert len(table) == 2 + 4
    sheet = cv2.imread(str(next(tmp_path.glob("outputs/sweeps/*/sweep.png"))))
    assert sheet.shape[0] > 2 * 340, "two points a row"
    assert sheet.std() > 10
    assert all(str(folder.name) in "".join(table) for folder in datasets)
    noisy = {
        line.split("|")[1].strip(): float(line.split("|")[5]) for line in table[2:] if "0.3" in line
    }
    assert noisy["0.1"] > noisy["0.5"]
    names = [cell.strip() for cell in table[0].split("|")]
    assert {"psnr_db", "psnr_db_std", "ssim", "ssim_std", "gmsd", "gmsd_std"} < {*names}


def test_a_bad_point_of_a_sweep_does_not_stop_the_others(monkeypatch, tmp_path, flsea):
    monkeypatch.chdir(tmp_path)
    code = run(
        monkeypatch, "-m", "resample.rate=0,0.5", "scenes=flsea", f"scenes.root={flsea}", *FAST
    )
    assert code == 2
    assert len(list(tmp_path.glob("outputs/*/manifest.json"))) == 1
    table = next(tmp_path.glob("outputs/sweeps/*/sweep.md")).read_text().splitlines()[2:]
    assert ["failed" in line for line in table] == [True, False]
    assert "resample.rate" in table[0]


def test_ctrl_c_ends_a_sweep_and_every_point_has_its_row(monkeypatch, tmp_path, flsea, capfd):
    from simnfnd.factory.cli import generate
    from simnfnd.factory.scheduler.workers.signals import Interrupted

    made, make = [], generate.run

    def interrupted(*given, **named):
        made.append(given)
        if len(made) == 2:
            raise Interrupted(signal.SIGINT)
        return make(*given, **named)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(generate, "run", interrupted)
    words = ["seed=1,2,3,4", "scenes=flsea", f"scenes.root={flsea}", *FAST]
    assert run(monkeypatch, "-m", *words) == 130
    table = next(tmp_path.glob("outputs/sweeps/*/sweep.md")).read_text().splitlines()[2:]
    states = ["made", "interrupted", "not begun", "not begun"]
    assert [state in line for state, line in zip(states, table, strict=True)] == [True] * 4
    assert len(made) == 2
    assert capfd.readouterr().err.count("interrupted") == 1


def test_the_same_seed_gives_the_same_bytes_for_any_number_of_workers(monkeypatch, tmp_path, flsea):
    for workers in ("1", "3"):
        more = ["scheduler.backend=local", f"scheduler.workers={workers}", "scheduler.shard_size=1"]
        assert run(monkeypatch, *words_for(flsea, tmp_path / workers), *more) == 0
    shards = sorted(path.relative_to(tmp_path / "1") for path in (tmp_path / "1").glob("*/*.h5"))
    assert len(shards) == 4
    for shard in shards:
        assert (tmp_path / "1" / shard).read_bytes() == (tmp_path / "3" / shard).read_bytes()


def test_stride_limit_variants_and_only(monkeypatch, tmp_path, flsea):
    out = tmp_path / "out"
    words = words_for(flsea, out, "frames.limit=2", "frames.variants=3")
    assert run(monkeypatch, *words) == 0
    manifest = json.loads((out / "manifest.json").read_text())
    assert sum(shard["samples"] for shard in manifest["shards"]) == (2 + 1) * 3
    one = tmp_path / "one"
    name = "canyons/u_canyon/16233044541765601"
    assert run(monkeypatch, *words_for(flsea, one), f"frames.only=[{name}]") == 0
    with h5py.File(next(one.glob("*/*.h5"))) as shard:
        assert shard["meta"]["frame"].tolist() == [b"16233044541765601"]
