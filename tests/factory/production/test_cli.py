"""The command line: what it makes, what it says, and how it ends."""

from __future__ import annotations

import csv
import json
import shlex
import signal
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st

from simnfnd.command import main
from simnfnd.factory.common.plots import Curve
from simnfnd.factory.common.words import list_word, shell_line
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.production.cli.sweep_curve import draw_curve, sweep_plot
from simnfnd.factory.simulation.config.compose import compose_config, compose_points, hydra_words
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.config.selection import choose_frames, split_frames, split_warnings
from tests.factory.production.cli_frames import FAST, ground, write_frame


@pytest.fixture(autouse=True)
def words_of_hydra(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["simnfnd"])


def run(*words: str) -> int:
    """Exit code of `simnfnd make WORDS`, in this process."""
    return main(words, default="make")


def samples(folder: Path) -> dict[str, int]:
    """Of each split."""
    totals = json.loads((folder / "manifest.json").read_text())["totals"]
    return {split: counts["samples"] for split, counts in totals.items() if counts["samples"]}


@pytest.fixture
def flsea(tmp_path):
    root = tmp_path / "flsea"
    for number in range(3):
        write_frame(root, f"1623304454176560{number}", ground() * (1 + 0.1 * number))
    write_frame(root, "16316026967750072", ground(), "red_sea/sub_pier")
    return root


def words_for(root, out="out", *more: str) -> list[str]:
    return ["scenes=flsea", f"scenes.root={root}", f"dataset.dir={out}", *FAST, *more]


def test_a_partial_download_makes_what_there_is(tmp_path, flsea, capfd):
    out = tmp_path / "out"
    code = run("experiment=simnfnd", *words_for(flsea, out)[1:])
    printed = capfd.readouterr().out
    assert code == 0
    assert printed.strip().splitlines()[-1] == f"dataset: {out}"
    assert "flatiron" in printed  # absent scenes are listed
    assert samples(out) == {"test": 3, "train": 1}
    with h5py.File(out / "test/shard-00000.h5") as shard:
        assert shard["noisy"].shape == (3, 256, 256)
        assert set(shard["meta"]["scene"]) == {b"u_canyon"}


def test_a_bad_frame_among_good_ones_is_skipped_and_named(tmp_path, flsea, capfd):
    bad = ground()
    bad[3, 4] = np.nan
    write_frame(flsea, "16233045486672034", bad)
    out = tmp_path / "out"
    assert run(*words_for(flsea, out)) == 1
    failures = [json.loads(line) for line in (out / "failed.jsonl").read_text().splitlines()]
    assert len(failures) == 1
    assert "16233045486672034" in failures[0]["frame"]
    assert "1 NaN" in failures[0]["reason"]
    assert "frames.only=" in failures[0]["command"]
    assert sum(samples(out).values()) == 4
    last = capfd.readouterr().out.strip().splitlines()[-1]
    assert last.startswith("failed: 1 of 5 frames, all because: depth has 1 NaN")
    assert last.endswith(f"`simnfnd status {out} --failed` lists them")
    assert main(["status", str(out)]) == 0
    assert "4 of 5 pairs" in capfd.readouterr().out


def test_images_that_show_next_to_nothing_name_the_likeliest_keys(tmp_path, flsea, capfd):
    words = ["scenes=flsea", f"scenes.root={flsea}", f"dataset.dir={tmp_path / 'out'}", *FAST]
    run(*words, "sonar.range={auto: false, min_m: 0, max_m: 900}")
    (message,) = (line for line in capfd.readouterr().err.splitlines() if "sonar.hfov_deg" in line)
    assert "% of the images is lit; check" in message


def test_when_every_frame_is_bad_the_run_ends_with_2(tmp_path, capfd):
    root = tmp_path / "flsea"
    write_frame(root, "16233044541765633", ground())
    depth = root / "canyons/u_canyon/depth/16233044541765633_SeaErra_abs_depth.tif"
    cv2.imwrite(str(depth), ground() * 0)
    assert run(*words_for(root, tmp_path / "o")) == 2
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
def test_bad_input_is_one_clear_line_and_exit_code_2(tmp_path, words, said, capfd):
    (tmp_path / "empty").mkdir()
    words = [word.replace("{empty}", str(tmp_path / "empty")) for word in words]
    code = run(*words, f"dataset.dir={tmp_path / 'out'}")
    error = capfd.readouterr().err
    assert code == 2, error
    assert said in error
    assert len(error.strip().splitlines()) == 1
    assert error.startswith("error: ")
    assert not (tmp_path / "out").exists()


def test_a_traceback_is_shown_with_debug_only(tmp_path):
    with pytest.raises(Exception, match=r"resample\.rate"):
        main(["make", "resample.rate=0", "debug=true"])


@pytest.mark.slow
def test_a_sweep_makes_one_named_dataset_a_point_and_one_table(monkeypatch, tmp_path, flsea, capfd):
    monkeypatch.chdir(tmp_path)
    code = run(
        "-m",
        "noise.background.density=0.1,0.5",
        "resample.rate=0.1,0.3",
        "experiment=physical",  # which names one folder
        "acoustics=pointwise",
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
    assert sheet.shape[0] > 4 * 340, "a point a row"
    assert sheet.std() > 10
    assert all(str(folder.name) in "".join(table) for folder in datasets)
    noisy = {
        line.split("|")[1].strip(): float(line.split("|")[5]) for line in table[2:] if "0.3" in line
    }
    assert noisy["0.1"] > noisy["0.5"]
    names = [cell.strip() for cell in table[0].split("|")]
    assert {"psnr_db", "psnr_db_std", "ssim", "ssim_std", "gmsd", "gmsd_std"} < {*names}
    curve = next(tmp_path.glob("outputs/sweeps/*/sweep.svg")).read_text()
    assert "PSNR, dB" in curve
    said = capfd.readouterr()
    assert said.out.count("render: ") == 1, "what the points have in common is said once"


@pytest.mark.slow
def test_a_bad_point_of_a_sweep_does_not_stop_the_others(monkeypatch, tmp_path, flsea):
    monkeypatch.chdir(tmp_path)
    code = run("-m", "resample.rate=0,0.5", "scenes=flsea", f"scenes.root={flsea}", *FAST)
    assert code == 2
    assert len(list(tmp_path.glob("outputs/*/manifest.json"))) == 1
    table = next(tmp_path.glob("outputs/sweeps/*/sweep.md")).read_text().splitlines()[2:]
    assert ["failed" in line for line in table] == [True, False]
    assert "resample.rate" in table[0]


@pytest.mark.slow
def test_ctrl_c_ends_a_sweep_and_every_point_has_its_row(monkeypatch, tmp_path, flsea, capfd):
    from simnfnd.factory.common.signals import Interrupted
    from simnfnd.factory.production.cli import generate

    calls = []
    make = generate.run

    def interrupted(*arguments, **named):
        calls.append(arguments)
        if len(calls) == 2:
            raise Interrupted(signal.SIGINT)
        return make(*arguments, **named)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(generate, "run", interrupted)
    words = ["seed=1,2,3,4", "scenes=flsea", f"scenes.root={flsea}", *FAST]
    assert run("-m", *words) == 130
    table = next(tmp_path.glob("outputs/sweeps/*/sweep.md")).read_text().splitlines()[2:]
    states = ["made", "interrupted", "not begun", "not begun"]
    assert [state in line for state, line in zip(states, table, strict=True)] == [True] * 4
    assert len(calls) == 2
    assert capfd.readouterr().err.count("interrupted") == 1


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_for_any_number_of_workers(tmp_path, flsea):
    serial = tmp_path / "serial"
    local = tmp_path / "local"
    # FAST has scheduler=serial: this process is the only worker.
    assert run(*words_for(flsea, serial), "scheduler.shard_size=1") == 0
    more = ["scheduler=local", "scheduler.workers=3", "scheduler.shard_size=1"]
    words = [word for word in words_for(flsea, local) if word != "scheduler=serial"]
    assert run(*words, *more) == 0
    shards = sorted(path.relative_to(serial) for path in serial.glob("*/*.h5"))
    assert len(shards) == 4
    for shard in shards:
        assert (serial / shard).read_bytes() == (local / shard).read_bytes()


@pytest.mark.slow
def test_stride_limit_variants_and_only(tmp_path, flsea):
    out = tmp_path / "out"
    words = words_for(flsea, out, "frames.limit=2", "frames.variants=3")
    assert run(*words) == 0
    assert sum(samples(out).values()) == (2 + 1) * 3
    dataset = tmp_path / "one"
    name = "canyons/u_canyon/16233044541765601"
    assert run(*words_for(flsea, dataset), f"frames.only=[{name}]") == 0
    with h5py.File(next(dataset.glob("*/*.h5"))) as shard:
        assert shard["meta"]["frame"].tolist() == [b"16233044541765601"]


def said(capfd, *words: str) -> str:
    """The one line that a command of bad words ends with."""
    assert main(words) == 2
    error: str = capfd.readouterr().err
    assert error.count("\n") == 1, error
    assert "struct" not in error
    assert "hydra" not in error
    return error


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        ("make noise.background.densty=0.1", "did you mean noise.background.density?"),
        ("make noise.backgroud.density={uniform:[0,1]}", "noise.background"),
        ("make frame.limit=3", "frames.limit"),
        ("make limit=3", "frames.limit"),
        ("make nose=simnfnd", "did you mean noise"),
        ("make noise=simnfn", "did you mean noise=simnfnd?"),
        ("make sonar=didson", "sonar=didson_hf"),
        ("make sonar=mars", "there are aris_1200, "),
        ("make scenes.depth_scale=2", "the chosen `scenes` has no such key"),
        ("make +frames.limt=3", "frames.limit"),
        ("make seed=1,2", "-m"),
        ("plan noise.background.densty=1", "noise.background.density"),
        ("train dataset=x train.stps=3", "did you mean train.steps?"),
        ("evaluate dataset=x basline=[all]", "did you mean baselines?"),
        ("evaluate real x modls=[a]", "did you mean models?"),
    ],
)
def test_a_typo_is_answered_with_what_is_nearest(capfd, words, answer):
    assert answer in said(capfd, *words.split())


NAMES = [
    *("dives", "größe/müll", "my dives (2)", "a=b", "it's", "a#b", "q\\'s", "back\\", "深海/潜水"),
    *("2023_05_01", "20230501", "07", "1e3", "0x1F", "1.0", ".5", "-3", "true", "None", "inf"),
    *("dive(2)", "choice(1)", "range(1,5)/x", "[raw] dive", "{x}", "{choice: [1]}", "a]b", "(a"),
    *("dive 1, 2", "a,b", "$HOME", "${x}", "$\\{x}", "\\${x}", "'tis", '"so"', "a: b", "*.csv"),
    *("café", "caf\u00e9 \u2603", "a|b", "a&b;c", "%d", "@home", "a+b", "x" * 80),
]


def read(word: str) -> Any:
    """What a word for a key of `simnfnd make` sets it to."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from omegaconf import OmegaConf

    (stated,) = hydra_words([word], "factory", FactoryConfig)
    value = OverridesParser.create().parse_override(stated).value()
    holder: Any = OmegaConf.create({"key": value})
    container: Any = OmegaConf.to_container(holder, resolve=True)
    return container["key"]


@pytest.mark.parametrize("name", NAMES)
def test_a_path_is_taken_as_it_is_typed(name):
    # Quotes around all of a value are Hydra's.
    assert read(f"dataset.dir={name}") == (name if name != '"so"' else "so")
    assert read(f"scenes.root={name}/frames") == f"{name}/frames"


@pytest.mark.parametrize("name", NAMES)
def test_a_name_in_a_list_is_taken_as_it_is_typed(name):
    if "," in name:
        assert read(f"split.test=['{name}']") == [name]
        return
    wanted = name if name != '"so"' else "so"
    assert read(f"split.test=[{name}]") == [wanted]
    assert read(f"split.test=[first, {name} ,last]") == ["first", wanted, "last"]
    assert read(f"split.test={name}") == [wanted]


def test_null_is_none_only_where_none_may_be():
    assert read("dataset.dir=null") is None
    assert read("split.test=[null]") == ["null"]
    assert read("frames.only=null") is None
    assert read("split.test=[]") == []


@settings_of_hypothesis(max_examples=60, deadline=None)
@given(st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=12))
def test_any_text_of_letters_and_marks_is_a_name(text):
    assert read(list_word("split.test", [text])) == [text]
    quoted = text[0] in "'\"" and text[-1] == text[0]
    if not (quoted or "${" in text or text == "null" or text.startswith("~")):
        assert read(f"dataset.dir={text}") == text


@pytest.mark.parametrize("name", [*NAMES, "both ' and \"", " led by a space"])
def test_a_suggested_list_means_the_same_before_and_after_the_shell(name):
    word = list_word("frames.only", ["reef/1", name])
    assert read(word) == ["reef/1", name]
    assert shlex.split(shell_line([word])) == [word]
    if not set(name) & set(',"$`\\![]{}') and name == name.strip():
        (pasted,) = shlex.split(word)
        assert read(pasted) == ["reef/1", name]


def test_interpolations_that_can_be_resolved_are(monkeypatch):
    monkeypatch.setenv("DIVES", "/data")
    config = compose_config(
        [
            "seed=7",
            "scenes=flsea",
            "scenes.root=${oc.env:DIVES}/${x}",
            "dataset.dir=out/${seed} (a)",
        ]
    )
    assert getattr(config.scenes, "root", None) == "/data/${x}"
    assert config.dataset.dir == "out/7 (a)"


def test_a_name_in_a_mapping_has_quotes(capfd):
    line = said(capfd, "make", "scenes=mesh", "scenes.classes=[{class: Valve, parts: dive (2)*}]")
    assert "put names and paths inside of lists and mappings in quotes" in line
    valve = {"class": "Valve", "parts": "dive (2)*"}
    assert read("scenes.classes=[{class: Valve, parts: 'dive (2)*'}]") == [valve]


def test_a_sweep_over_names_separates_them_by_commas():
    points = compose_points(["-m", "dataset.name=2023_05_01,plain", "dataset.dir=a, b"])
    assert [point.dataset.name for point in points] == ["2023_05_01", "plain"]
    assert {point.dataset.dir for point in points} == {"a, b"}
    points = compose_points(["-m", "split.test=[07],[u_*, Dive (2)]"])
    assert [point.split.test for point in points] == [("07",), ("u_*", "Dive (2)")]
    points = compose_points(["-m", "dataset.name=choice(a,b)"])
    assert [point.dataset.name for point in points] == ["a", "b"]


def test_points_of_a_sweep_do_not_share_a_folder(tmp_path, capfd):
    folder = f"dataset.dir={tmp_path / 'out'}"
    assert run("-m", "seed=1,2", folder, f"hydra.sweep.dir={tmp_path / 'sweep'}", *FAST) == 2
    assert "error: dataset.dir=" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_recipe_may_sweep_by_itself():
    sonars = [point.sonar.name for point in compose_points(["experiment=fish"])]
    assert sonars == ["didson_hf", "aris_1800_hf"]
    assert len(compose_points(["experiment=fish", "sonar=didson_hf"])) == 1


def test_home_is_expanded(tmp_path, monkeypatch):
    home = tmp_path / "me (2)"
    monkeypatch.setenv("HOME", str(home))
    assert read("dataset.dir=~/out") == str(home / "out")


def test_scenes_of_any_name_test_and_train():
    odd = found(**{"Dive [2]": 1, "caf\u00e9": 1, "2023_05_01": 1, "d'Orsay": 1})
    for name in ("Dive [2]", "cafe\u0301", "2023_05_01", "d'Orsay"):
        assert len(split_frames(odd, settings(split={"test": [name]}))["test"]) == 1
    _, warning = warnings(odd, split={"test": ["nowhere"]})
    offered = "split.test=" + warning.partition("split.test=")[2].partition(" would")[0]
    assert warnings(odd, split={"test": read(offered)}) == ()


@pytest.mark.slow
def test_the_printed_commands_can_be_pasted(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    for scene in ("café (2)", "it's, [07]"):
        Path(scene).mkdir()
    rows = [
        f'"{scene}/{n}.png","{scene}/{n}.npy","{scene}"'
        for scene in ("café (2)", "it's, [07]")
        for n in (1, 2)
    ]
    for row in rows[::2]:
        image, depth, _ = next(csv.reader([row]))
        cv2.imwrite(image, np.full((48, 64, 3), 128, np.uint8))
        np.save(depth, ground(48, 64))
    Path("my list.csv").write_text("\n".join(rows))
    words = [
        "scenes=csv_list",
        "scenes.file=my list.csv",
        "scenes.intrinsics=[70,70,31.5,23.5]",
        *FAST,
    ]
    assert run(*words, "scheduler=serial", "dataset.dir=out 1") == 1
    capfd.readouterr()
    assert main(["status", "out 1", "--failed"]) == 1
    lines = [line.strip() for line in capfd.readouterr().out.splitlines() if "simnfnd make" in line]
    assert len(lines) == 2
    for line in lines:
        name, verb, *pasted = shlex.split(line)
        assert (name, verb) == ("simnfnd", "make")
        assert run(*pasted) == 2, "the file is still missing"
        assert "no such file" in capfd.readouterr().err


def test_a_dataset_is_made_in_a_folder_of_any_name(monkeypatch, tmp_path, capfd):
    monkeypatch.setenv("HOME", str(tmp_path))
    write_frame(tmp_path / "Müll (neu)", "1", ground())
    words = ["scenes=flsea", "scenes.root=~/Müll (neu)", "dataset.dir=~/größe 1", *FAST]
    assert main(["make", *words, "scheduler.backend=serial"]) == 0, capfd.readouterr().err
    assert sum(samples(tmp_path / "größe 1").values()) == 1


def test_without_slurm_its_launcher_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    words = ["-m", "hydra/launcher=submitit_slurm", "noise.background.density=0.1,0.4"]
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["make", *words, f"hydra.sweep.dir={tmp_path / 'sweep'}"]) == 2
    said = capfd.readouterr().err.strip().splitlines()
    assert said[-1].startswith("error: hydra/launcher=submitit_slurm: no srun here; ")
    assert not any("Traceback" in line for line in said)


@pytest.mark.slow
def test_submitit_runs_the_points_of_a_sweep(tmp_path: Path) -> None:
    pytest.importorskip("hydra_plugins.hydra_submitit_launcher")
    words = [
        *("make", "-m", "hydra/launcher=submitit_local", "render=analytic", "scheduler=serial"),
        *("dataset.preview_pairs=0", "scenes.locations=2", "scenes.frames_per_location=1"),
        *("scenes.width=240", "scenes.height=160", "noise.background.density=0.1,0.4"),
        *(f"hydra.sweep.dir={tmp_path / 'sweep'}", f"cache.dir={tmp_path / 'cache'}"),
        f"dataset.dir={tmp_path}/set-${{hydra:job.num}}",
    ]
    assert main(words) == 0
    manifests = sorted(tmp_path.glob("set-*/manifest.json"))
    assert len(manifests) == 2
    assert [samples(path.parent)["train"] for path in manifests] == [1, 1]
    table = (tmp_path / "sweep" / "sweep.csv").read_text().splitlines()
    assert len(table) == 3


def settings(**groups):
    return from_mapping({"scenes": {"kind": "flsea", "root": "x"}, **groups})


def found(**scenes: int) -> tuple[FrameRef, ...]:
    return tuple(
        FrameRef("sea", scene, f"{n:04d}") for scene, count in scenes.items() for n in range(count)
    )


def warnings(found_, /, **groups) -> tuple[str, ...]:
    config = settings(**groups)
    return split_warnings(split_frames(choose_frames(found_, config), config), config)


def test_total_counts_all_scenes_and_limit_each():
    frames = found(a=40, b=40, c=40)
    assert len(choose_frames(frames, settings(frames={"limit": 5}))) == 15
    chosen = choose_frames(frames, settings(frames={"total": 6}))
    assert len(chosen) == 6
    assert [ref.scene for ref in chosen] == ["a", "a", "b", "b", "c", "c"]
    assert len(choose_frames(frames, settings(frames={"total": 6, "limit": 1}))) == 3


def test_a_larger_total_keeps_the_frames_of_a_smaller_one():
    frames = found(a=13, b=70, c=5)
    chosen = [set(choose_frames(frames, settings(frames={"total": n}))) for n in range(1, 90)]
    assert all(few <= more for few, more in pairwise(chosen))
    assert [len(group) for group in chosen] == [*range(1, 89), 88]


def test_a_split_that_stays_empty_is_told_with_one_that_works():
    few = found(flatiron=3, pier=2, reef=2)
    lost, empty = warnings(few, split={"test": ["u_canyon", "coral_*"]})
    assert "u_canyon, coral_*" in lost
    assert empty.startswith("the test split is empty")
    assert "split.test=[]" in empty
    assert warnings(few, split={"test": []}) == ()
    (lost,) = warnings(few, split={"test": ["pier", "u_canyon"]})
    assert lost == "split.test: u_canyon: no scene of that name here"
    (empty,) = warnings(few, split={"test": ["*"]})
    assert empty.startswith("the train split is empty")
    (empty,) = warnings(found(pool=9))
    assert "one scene, pool" in empty


def test_an_empty_split_is_told_first_and_last(tmp_path, capfd):
    for scene in ("canyons/flatiron", "red_sea/sub_pier"):
        write_frame(tmp_path / "flsea", "1623304454176560", ground(), scene)
    words = ["experiment=simnfnd", f"scenes.root={tmp_path / 'flsea'}", *FAST]
    assert main(["make", f"dataset.dir={tmp_path / 'o'}", *words]) == 0
    lines = capfd.readouterr().err.splitlines()
    message = [number for number, line in enumerate(lines) if "the test split is empty" in line]
    assert len(message) == 2
    assert message[1] == len(lines) - 1
    assert main(["plan", *words]) == 0
    assert "the test split is empty" in capfd.readouterr().err


def test_a_sweep_draws_the_parameter_with_most_values() -> None:
    rows = [
        {"noise.looks": looks, "seed": seed, "psnr_db": 20 - float(looks)}
        for looks in ("1", "2", "4")
        for seed in ("0", "1")
    ]
    plot = sweep_plot(["noise.looks", "seed"], rows)
    assert plot is not None
    assert plot.curves == {
        "seed=0": Curve((1.0, 2.0, 4.0), (19.0, 18.0, 16.0)),
        "seed=1": Curve((1.0, 2.0, 4.0), (19.0, 18.0, 16.0)),
    }
    drawing = draw_curve(["noise.looks", "seed"], rows)
    texts = {item.text for item in ElementTree.fromstring(drawing).iter()}
    assert {"noise.looks", "PSNR, dB", "seed=0", "seed=1", "1", "2", "4"} <= texts
    assert draw_curve(["noise.looks", "seed"], rows) == drawing
    assert draw_curve(["sonar"], [{"sonar": name, "psnr_db": 9.0} for name in "ab"]) == b""
    assert draw_curve(["seed"], [{"seed": "1", "state": "failed"}] * 2) == b""
