"""`simnfnd benchmark`: sets, doors, results and their table, on a tiny benchmark."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.evaluation.benchmark import sets
from simnfnd.evaluation.benchmark.folder import VERSION, Benchmark, sealed
from simnfnd.evaluation.benchmark.pictures import digest_of, in_8_bits, read
from simnfnd.evaluation.metrics.fidelity import psnr
from simnfnd.factory.errors import FactoryError
from tests.evaluation.real.static_scenes import shuffled
from tests.project_files import ROOT

FLSEA = ROOT.parent / "shared" / "data" / "flsea-vi"
SETS = ("places-64", "physical-64", "real-scenes")


def benchmark(*words: str) -> int:
    return main(["benchmark", *words])


def make(out: Path, *words: str) -> Path:
    assert benchmark("make", "--out", str(out), "--pairs", "2", "--sizes", "64", *words) == 0
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of one place, and of three scenes that stand still."""
    folder = tmp_path_factory.mktemp("benchmark")
    scenes = shuffled(folder / "scenes", {0: 7, 1: 7, 2: 8})
    return make(folder / "made", "--real", str(scenes))


@pytest.fixture
def mine(made: Path, tmp_path: Path) -> Path:
    """A copy of it, for entries of this test alone."""
    return Path(shutil.copytree(made, tmp_path / "mine"))


def enter(root: Path, name: str, *words: str) -> int:
    return benchmark("enter", name, "--benchmark", str(root), *words)


def result(root: Path, name: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((root / "results" / f"{name}.json").read_text())
    return content


def outputs(root: Path, name: str) -> dict[str, list[str]]:
    return {one: found["outputs"] for one, found in result(root, name)["sets"].items()}


def blurred(folder: Path, root: Path) -> Path:
    """What a Gaussian of OpenCV makes of the noisy pictures, as an outsider would hand it over."""
    for path in sorted((root / "noisy").glob("*/*.png")):
        picture = cv2.GaussianBlur(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), (5, 5), 1.0)
        target = folder / path.parent.name / path.name
        target.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(target), picture)
    return folder


def mean_of_three(path: Path) -> Path:
    """An ONNX file that takes the mean of 3x3 pixels, as another program might write one."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    kernel = numpy_helper.from_array(np.full((1, 1, 3, 3), 1 / 9, np.float32), "kernel")
    values = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, "height", "width"])
        for name in ("picture", "denoised")
    ]
    node = helper.make_node("Conv", ["picture", "kernel"], ["denoised"], pads=[1, 1, 1, 1])
    graph = helper.make_graph([node], "mean", values[:1], values[1:], [kernel])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, str(path))
    return path


def test_what_an_outsider_gets(made: Path) -> None:
    opened = Benchmark(made)
    assert set(opened.sets) == set(SETS)
    for name, one in opened.sets.items():
        files = sorted(path.name for path in (made / "noisy" / name).iterdir())
        assert files == sorted([*(f"{entry.name}.png" for entry in one.pictures), "geometry.csv"])
        for entry in one.pictures:
            noisy, clean, mask = one.noisy(entry), one.clean(entry), one.mask(entry)
            assert noisy.dtype == np.uint8
            assert noisy.shape == clean.shape == mask.shape
            assert 0 < mask.mean() < 1
    places = opened.sets["places-64"]
    assert len({entry.noisy for entry in places.pictures}) == 2, "two draws of noise"
    assert len({entry.mask for entry in places.pictures}) == 1, "of one place"
    fan = places.geometry(places.pictures[0])
    assert fan is not None
    # Echoes lie in the sector that the table tells.
    lit = places.clean(places.pictures[0]) > 0
    assert (lit & ~fan.sector_mask(64, 64)).sum() <= 0.02 * lit.sum()
    # One group of three is for practice.
    assert len(set(opened.sets["real-scenes"].groups)) == 2
    assert len(set(opened.practice["real-scenes"].groups)) == 1


def test_the_truth_of_a_real_picture_is_cleaner_than_it(made: Path) -> None:
    one = Benchmark(made).sets["real-scenes"]
    entry = one.pictures[0]
    assert psnr(one.clean(entry), one.noisy(entry) / np.float32(255), data_range=1.0) > 20
    assert len(np.unique(one.clean(entry))) > 256, "a mean is finer than 8 bits"


def test_the_same_seed_makes_the_same_pictures(made: Path, tmp_path: Path) -> None:
    known = {n: one.entry.digest for n, one in Benchmark(made).sets.items()}
    recipe = sets.recipes((64,), 2, sets.SEED, None)[0]
    again = sets.make(recipe, 2, tmp_path / "n", tmp_path / "r", sets.Renders())
    assert again.digest == known[recipe.name]
    other = sets.recipes((64,), 2, sets.SEED + 1, None)[0]
    changed = sets.make(other, 2, tmp_path / "n", tmp_path / "r", sets.Renders())
    assert changed.digest != again.digest


@pytest.mark.skipif(not FLSEA.is_dir(), reason="needs ../shared/data/flsea-vi")
def test_frames_of_flsea_make_a_set(tmp_path: Path) -> None:
    recipe = sets.recipes((64,), 4, sets.SEED, FLSEA)[-1]
    found = sets.make(recipe, 4, tmp_path / "n", tmp_path / "r", sets.Renders())
    assert (recipe.name, recipe.practice) == ("flsea-64", "places-64")
    assert len(found.pictures) == 4
    assert len({one.group for one in found.pictures}) == 2


def test_all_doors_give_the_same_pictures_the_same_figures(
    mine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """One blur, as a folder, a function, and a program of each kind."""
    folder = blurred(tmp_path / "blurred", mine)
    (tmp_path / "outsider.py").write_text(
        "import sys, cv2, numpy as np\nfrom pathlib import Path\n"
        "def blur(picture):\n"
        "    grey = np.rint(picture * 255).astype(np.uint8)\n"
        "    return cv2.GaussianBlur(grey, (5, 5), 1.0)\n"
        "def file(source, target):\n"
        "    grey = cv2.imread(str(source), cv2.IMREAD_UNCHANGED)\n"
        "    cv2.imwrite(str(target), cv2.GaussianBlur(grey, (5, 5), 1.0))\n"
        "if __name__ == '__main__':\n"
        "    source, target = map(Path, sys.argv[1:])\n"
        "    for one in [source] if source.is_file() else source.glob('*.png'):\n"
        "        file(one, target if source.is_file() else target / one.name)\n"
    )
    monkeypatch.chdir(tmp_path)
    program = f"'{sys.executable}' outsider.py"
    assert enter(mine, "folder", "--denoised", str(folder), "--about", "by <b>us</b>") == 0
    keep = tmp_path / "kept"
    assert enter(mine, "function", "--function", "outsider:blur", "--keep", str(keep)) == 0
    assert enter(mine, "files", "--command", f"{program} {{in}} {{out}}") == 0
    assert enter(mine, "folders", "--command", f"{program} {{in_folder}} {{out_folder}}") == 0
    figures = {n: one["figures"] for n, one in result(mine, "folder")["sets"].items()}
    for name in ("function", "files", "folders"):
        assert outputs(mine, name) == outputs(mine, "folder")
        assert {n: one["figures"] for n, one in result(mine, name)["sets"].items()} == figures
        assert all(s > 0 for one in result(mine, name)["sets"].values() for s in one["cpu_s"])
    for name in SETS:
        kept = sorted((keep / name).iterdir())
        assert [digest_of(read(path)) for path in kept] == outputs(mine, "folder")[name]
    assert figures["real-scenes"]["psnr_levels"] > result(mine, "noisy")["sets"]["real-scenes"][
        "figures"]["psnr_levels"]  # fmt: skip
    shown = capsys.readouterr().out
    assert "| folders |" in shown
    page = (mine / "table.html").read_text(encoding="utf-8")
    assert "by &lt;b&gt;us" in page
    assert "http" not in page.replace('<html lang="en">', ""), "works without a network"


def test_an_onnx_file_lands_in_the_table(mine: Path, tmp_path: Path, capsys) -> None:
    assert enter(mine, "mean", "--onnx", str(mean_of_three(tmp_path / "mean.onnx"))) == 0
    assert "| mean |" in capsys.readouterr().out
    one = Benchmark(mine).sets["places-64"]
    grey = one.noisy(one.pictures[0]).astype(np.float64)
    expected = cv2.blur(grey, (3, 3), borderType=cv2.BORDER_CONSTANT) / 255
    made = in_8_bits(expected.astype(np.float32), "")
    found = result(mine, "mean")["sets"]["places-64"]
    assert found["figures"]["psnr"][0] == pytest.approx(
        psnr(one.clean(one.pictures[0]), made / np.float32(255), data_range=1.0), abs=0.02
    )
    assert len(result(mine, "mean")["method"]["sha256"]) == 64


def test_a_filter_is_tuned_on_practice_pairs_and_others_are_compared_with_it(
    mine: Path, capsys
) -> None:
    assert enter(mine, "gaussian", "--baseline", "gaussian") == 0
    assert "the best filter is gaussian" in capsys.readouterr().out
    assert enter(mine, "tuned", "--baseline", "gaussian", "--tuned") == 0
    shown = capsys.readouterr().out
    assert "the best filter is tuned" in shown
    method = result(mine, "tuned")["method"]
    assert set(method["levels"]) == {"places-64", "physical-64"}, "real ones have their own"
    assert set(method["parameters"]) == set(SETS)
    assert method["parameters"]["real-scenes"] != {"sigma_px": 1.0}
    rows = shown.split("## real-scenes")[1].splitlines()
    (line,) = (row for row in rows if row.startswith("| noisy |"))
    ahead = line.split("|")[3].strip()
    assert ahead.startswith("-"), "the noisy pictures are behind"


def tampered(path: Path, change: Callable[[dict[str, Any]], object], seal: bool) -> None:
    content = json.loads(path.read_text())
    change(content)
    if seal:
        content.pop("sha256")
        content["sha256"] = sealed(content)
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    ("change", "seal", "told"),
    [
        (lambda c: c["sets"]["places-64"]["figures"]["psnr"].__setitem__(0, 50.0), False,
         "not what its hash says"),
        (lambda c: c.pop("sha256"), False, "not what its hash says"),
        (lambda c: c.update(version=VERSION + 1), True, f"of version {VERSION + 1}"),
        (lambda c: c["sets"]["places-64"].update(benchmark="0" * 64), True, "had other pictures"),
        (lambda c: c["sets"]["places-64"]["cpu_s"].append(1.0), True, "not one figure a picture"),
        (lambda c: c["sets"]["places-64"]["figures"].update(beauty=[1, 1]), True, "not of this"),
        (lambda c: c["sets"]["places-64"]["figures"].update(psnr=["x", 1]), True, "figures.psnr"),
        (lambda c: c.update(sets={}), True, "none of the sets"),
        (lambda c: c.update(name="other"), True, "is the result of other"),
        (lambda c: c.update(more=1), True, "unknown key"),
    ],
)  # fmt: skip
def test_results_that_do_not_fit_are_refused_in_a_line(
    change: Callable[[dict[str, Any]], object], seal: bool, told: str, mine: Path, capsys
) -> None:
    shutil.copy(mine / "results" / "noisy.json", mine / "results" / "changed.json")
    tampered(mine / "results" / "changed.json", lambda c: c.update(name="changed"), True)
    assert benchmark("table", "--benchmark", str(mine)) == 0
    assert "| changed |" in capsys.readouterr().out
    tampered(mine / "results" / "changed.json", change, seal)
    assert benchmark("table", "--benchmark", str(mine)) == 1
    shown = capsys.readouterr()
    assert "| changed |" not in shown.out
    assert "| noisy |" in shown.out
    assert shown.err.startswith("refused: ")
    assert shown.err.count("\n") == 1
    assert told in shown.err


def test_a_result_of_some_of_the_sets_stands_where_it_can(mine: Path, capsys) -> None:
    shutil.copy(mine / "results" / "noisy.json", mine / "results" / "part.json")

    def part(content: dict[str, Any]) -> None:
        content["name"] = "part"
        content["sets"].pop("real-scenes")
        content["sets"]["flsea-64"] = content["sets"]["physical-64"]

    tampered(mine / "results" / "part.json", part, True)
    assert benchmark("table", "--benchmark", str(mine)) == 0
    lines = [one for one in capsys.readouterr().out.splitlines() if one.startswith("| part |")]
    assert len(lines) == 3, "the overview and two sets"
    assert lines[0].endswith("| - |")


def test_pictures_that_do_not_fit_are_named_each(mine: Path, tmp_path: Path, capsys) -> None:
    folder = blurred(tmp_path / "blurred", mine)
    (folder / "places-64" / "0000.png").unlink()
    small = np.zeros((32, 64), np.uint8)
    cv2.imwrite(str(folder / "places-64" / "0001.png"), small)
    (folder / "physical-64" / "0000.png").write_bytes(b"no picture")
    colour = np.dstack([np.zeros((64, 64), np.uint8)] * 2 + [np.ones((64, 64), np.uint8)])
    cv2.imwrite(str(folder / "physical-64" / "0001.png"), colour)
    assert enter(mine, "wrong", "--denoised", str(folder)) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ", 1)[1] for line in lines] == [
        "missing",
        "64x32 pixels, expected 64x64",
        "not a picture of 8 or 16 bits",
        "in colour; sonar pictures are grey, convert it first",
        "wrong: 4 pictures do not fit",
    ]
    assert not (mine / "results" / "wrong.json").exists()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("a/b", "--baseline", "tv"), "a/b: no name of a method"),
        (("noisy", "--baseline", "tv"), "noisy.json: is there already; give another name"),
        (("x", "--baseline", "wiener"), "no 'wiener'"),
        (("x", "--baseline", "recursive"), "name one filter of a single picture"),
        (("x", "--baseline", "all"), "name one filter of a single picture"),
        (("x", "--denoised", "{none}"), "no such folder"),
        (("x", "--function", "json"), "expected MODULE:FUNCTION"),
        (("x", "--function", "json:none"), "has no attribute 'none'"),
        (("x", "--function", "no_such_module:f"), "No module named"),
        (("x", "--function", "json:dumps"), "0000.png: the method failed: TypeError"),
        (("x", "--function", "numpy:transpose", "--tuned"), "--tuned: is for --baseline"),
        (("x", "--function", "numpy:sum"), "gave an array () for a picture (64, 64)"),
        (("x", "--function", "numpy:sqrt", "--about", "a\nb"), "--about: one line"),
        (("x", "--function", "numpy:log"), "has NaN or infinite pixels"),
        (("x", "--onnx", "{none}"), "no such file"),
        (("x", "--onnx", "{text}"), "not usable"),
        (("x", "--command", "cp {in}"), "give the program with {in} and {out}"),
        (("x", "--command", "'cp {in} {out}"), "No closing quotation"),
        (("x", "--command", "true {in} {out}"), "the program wrote no denoised.png"),
        (("x", "--command", "false {in} {out}"), "the program ended with 1"),
        (("x", "--command", "no-such-program {in} {out}"), "cannot be run"),
        (
            (
                "x",
                "--command",
                "python3 -c 'import time; time.sleep(9)' {in} {out}",
                "--timeout-s",
                ".1",
            ),
            "more than 0.1 s",
        ),
        (("x", "--weights", "{none}"), "--weights: "),
        (("x",), "is required"),
    ],
)
@pytest.mark.filterwarnings("ignore:divide by zero")
def test_wrong_entries_are_one_line(
    words: tuple[str, ...], told: str, mine: Path, tmp_path: Path, capsys
) -> None:
    (tmp_path / "text").write_text("no network")
    places = {"{none}": str(tmp_path / "none"), "{text}": str(tmp_path / "text")}
    name, *rest = (places.get(word, word) for word in words)
    assert enter(mine, name, *rest) == 2
    lines = capsys.readouterr().err.splitlines()
    # Bars come before it.
    (line,) = (line for line in lines if line.startswith("error: "))
    assert lines[-1] == line
    assert told in line
    assert [path.name for path in (mine / "results").iterdir()] == ["noisy.json"]


def test_a_command_sees_no_shell(mine: Path, tmp_path: Path, capsys) -> None:
    trap = tmp_path / "trap"
    assert enter(mine, "x", "--command", f"cp {{in}} {{out}}; touch {trap}") == 2
    assert not trap.exists()
    capsys.readouterr()


def test_a_benchmark_that_was_changed_is_told(mine: Path, capsys) -> None:
    path = mine / "noisy" / "places-64" / "0000.png"
    cv2.imwrite(str(path), 255 - cv2.imread(str(path), cv2.IMREAD_UNCHANGED))
    assert enter(mine, "x", "--baseline", "median") == 2
    assert "not the picture of this benchmark" in capsys.readouterr().err
    path.unlink()
    assert enter(mine, "x", "--baseline", "median") == 2
    assert "0000.png: cannot be read" in capsys.readouterr().err
    manifest = mine / "benchmark.json"
    content = json.loads(manifest.read_text())
    manifest.write_text(json.dumps({**content, "version": VERSION + 1}))
    assert enter(mine, "x", "--baseline", "median") == 2
    assert f"version {VERSION + 1} of the benchmark" in capsys.readouterr().err
    manifest.write_text("[")
    assert enter(mine, "x", "--baseline", "median") == 2
    assert "benchmark.json: not JSON" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--pairs", "0"), "--pairs 0: must be 1 to 1000"),
        (("--sizes", "64,64"), "--sizes 64,64"),
        (("--sizes", "8"), "--sizes 8"),
        (("--seed", "-1"), "--seed -1"),
        (("--flsea", "{none}"), "no such folder"),
        (("--real", "{here}/a", "{here}/b/a"), "two of the same name, real-a"),
        (("--out", "{here}"), "holds files already"),
    ],
)
def test_wrong_words_of_make_are_one_line(
    words: tuple[str, ...], told: str, tmp_path: Path, capsys
) -> None:
    (tmp_path / "file").touch()
    filled = [one.replace("{none}", "/no/folder").replace("{here}", str(tmp_path)) for one in words]
    assert benchmark("make", "--out", str(tmp_path / "out"), *filled) == 2
    error = capsys.readouterr().err
    assert told in error
    assert "Traceback" not in error
    assert not (tmp_path / "out").exists()


def test_a_table_of_no_results_and_a_verb_that_is_none(mine: Path, capsys) -> None:
    (mine / "results" / "noisy.json").unlink()
    assert benchmark("table", "--benchmark", str(mine)) == 2
    assert "no results" in capsys.readouterr().err
    assert benchmark() == 2
    assert "verb" in capsys.readouterr().err


def test_pictures_are_known_by_their_pixels(tmp_path: Path) -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert digest_of(grey) != digest_of(grey.reshape(4, 3))
    assert digest_of(grey) != digest_of(grey.astype(np.uint16))
    assert digest_of(grey) == digest_of(np.asfortranarray(grey))
    assert in_8_bits(np.array([[0.0, 0.5, 2.0, -1.0]]), "x").tolist() == [[0, 128, 255, 0]]
    assert in_8_bits(np.array([[65535, 0]], np.uint16), "x").tolist() == [[255, 0]]
    with pytest.raises(FactoryError, match="int64 pixels"):
        in_8_bits(np.array([[1]]), "x")
