"""Every example of every --help: the cheap ones really, with tiny settings, the others as far as
they go without what they read.
"""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from simnfnd.command import main
from simnfnd.verbs import VERBS, Verb
from tests.factory.cli_frames import ground, write_frame
from tests.project.page_steps import SMALL_SEABED as SMALL

QUICK = ("render=analytic", "scheduler=serial", "dataset.preview_pairs=0", "frames.total=2")
# What an example of a verb is made small with; None: it has nothing to make small.
REAL: dict[str, tuple[str, ...]] = {
    "demo": (*QUICK, *SMALL),
    "make": QUICK,
    "plan": QUICK,
    "cache stats": (),
    "cache verify": (),
    "cache pack": QUICK,
    "cache clear": (),
    "status": (),
    "inspect": (),
    "validate": (),
    "merge": (),
    "preview": (),
    "export": (),
}
# Take long, and have tests of their own; the sweep is that of a tutorial.
LONG = ("export-weights simnfnd", "evaluate paper", "make -m noise.background.density=0.1,0.5")
NOT_HERE = ("dive.aris", "simnfnd view")


def examples() -> Iterator[tuple[str, str]]:
    def of(name: str, verb: Verb) -> Iterator[tuple[str, str]]:
        yield from ((name, example) for example in verb.examples)
        for own, one in verb.verbs.items():
            yield from of(f"{name} {own}", one)

    for name, verb in VERBS.items():
        yield from of(name, verb)


ALL = dict.fromkeys(examples())


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the examples read."""
    folder = tmp_path_factory.mktemp("examples")
    for number in range(2):
        write_frame(folder / "flsea-vi", f"1623304454176560{number}", ground())
        write_frame(folder / "flsea-vi", f"1623304454176560{number}", ground(), "red_sea/sub_pier")
        write_frame(folder / "dive", f"1623304454176560{number}", ground(480, 640), "a/b")
    images = folder / "dive/a/b"
    listed = [
        f"{images}/imgs/1623304454176560{n}.tiff,"
        f"{images}/depth/1623304454176560{n}_SeaErra_abs_depth.tif"
        for n in range(2)
    ]
    (folder / "frames.csv").write_text("\n".join(listed) + "\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "argv", ["simnfnd"])
        demo = ("experiment=demo", *QUICK, *SMALL)
        for name, first in (("a", 0), ("b", 7)):
            words = (*demo, f"scenes.first_location={first}", f"dataset.dir=outputs/{name}")
            assert main(["make", *words]) == 0
        shutil.copytree("outputs/a", "outputs/demo")
        labelled = (*demo, "dataset.layers=[segmentation]", "dataset.dir=outputs/labelled")
        assert main(["make", *labelled]) == 0
        assert main(["cache", "pack", *demo, "--out", "views.pack"]) == 0
    return folder


def run(example: str, *more: str) -> int:
    words = shlex.split(example)[1:]
    if "seabed" in example or "scenes" not in example or "experiment=demo" in example:
        own = {word.partition("=")[0] for word in words}
        more = (*more, *(one for one in SMALL if more and one.partition("=")[0] not in own))
    try:
        return main([*words, *more])
    except SystemExit as ended:
        return int(ended.code or 0)


@pytest.mark.parametrize(("name", "example"), ALL)
def test_an_example_of_a_help_does_what_it_says(
    name: str, example: str, place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd
) -> None:
    if example == "simnfnd demo" or any(part in example for part in LONG):
        pytest.skip("takes long, and has tests of its own")
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    said = shlex.split(example)
    verb = " ".join(said[1:3]) if said[1] == "cache" else said[1]
    if verb in REAL and not any(part in example for part in NOT_HERE):
        monkeypatch.chdir(place)
        # Words after `--cfg job` would be another option's.
        code = run(example, *(() if "--cfg" in example else REAL[verb]))
        told = capfd.readouterr()
        assert code == 0, told.err
    else:
        # Nothing of what it reads is here: one line says so, and no word of it is unknown.
        monkeypatch.chdir(tmp_path)
        code = run(example)
        told = capfd.readouterr()
        assert code == 2, told.err
        errors = [line for line in told.err.splitlines() if line.startswith("error: ")]
        assert len(errors) == 1
        assert "unrecognized" not in errors[0]
        assert "no such key" not in errors[0]
    assert "Traceback" not in told.err
