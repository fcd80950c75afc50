"""What stands in the place of Hydra's grammar and its words for a mistake."""

import json
import sys

import pytest

from simnfnd.command import main
from simnfnd.factory.cli.compose import readable
from tests.factory.cli_frames import FAST, ground, write_frame
from tests.project_files import ROOT


def said(monkeypatch, capfd, *words: str) -> str:
    """The one line that a command of bad words ends with."""
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    assert main(words) == 2
    error: str = capfd.readouterr().err
    assert error.count("\n") == 1, error
    assert "struct" not in error
    assert "hydra" not in error
    return error


@pytest.mark.parametrize(
    ("word", "answer"),
    [
        ("noise.background.densty=0.1", "did you mean noise.background.density?"),
        ("noise.backgroud.density={uniform: [0, 1]}", "noise.background"),
        ("frame.limit=3", "frames.limit"),
        ("limit=3", "frames.limit"),
        ("nose=simnfnd", "did you mean noise"),
        ("noise=simnfn", "did you mean noise=simnfnd?"),
        ("sonar=didson", "sonar=didson_hf"),
        ("sonar=mars", "there are aris_1200, "),
        ("scenes.depth_scale=2", "the chosen `scenes` has no such key"),
        ("+frames.limt=3", "frames.limit"),
        ("seed=1,2", "-m"),
    ],
)
def test_a_typo_is_answered_with_what_is_nearest(monkeypatch, capfd, word, answer):
    assert answer in said(monkeypatch, capfd, "make", word)


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (["plan", "noise.background.densty=1"], "noise.background.density"),
        (["train", "dataset=x", "train.stps=3"], "did you mean train.steps?"),
        (["evaluate", "dataset=x", "basline=[all]"], "did you mean baselines?"),
        (["evaluate", "real", "x", "modls=[a]"], "did you mean models?"),
    ],
)
def test_so_do_the_other_verbs(monkeypatch, capfd, words, answer):
    assert answer in said(monkeypatch, capfd, *words)


@pytest.mark.parametrize(
    "path",
    ["~/dives", "größe/müll", "my dives (2)", "a=b", "it's", "a#b", "q\\'s"],
)
def test_paths_need_no_quotes(path, monkeypatch):
    from hydra.core.override_parser.overrides_parser import OverridesParser

    monkeypatch.setenv("HOME", str(ROOT))
    read = OverridesParser.create().parse_override
    wanted = path.replace("~", str(ROOT))
    assert read(readable([f"scenes.root={path}"])[0]).value() == wanted


@pytest.mark.parametrize(
    "word",
    ["a='{uniform: [0, 1]}'", "a={uniform: [0, 1]}", "a='x y'", "~scenes.root", "--cfg", "a=${b}"],
)
def test_what_hydra_reads_or_must_explain_stays(word):
    assert readable([word]) == [word]


def test_a_dataset_is_made_in_a_folder_of_any_name(monkeypatch, tmp_path, capfd):
    monkeypatch.setenv("HOME", str(tmp_path))
    write_frame(tmp_path / "Müll (neu)", "1", ground())
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    words = ["scenes=flsea", "scenes.root=~/Müll (neu)", "dataset.dir=~/größe 1", *FAST]
    assert main(["make", *words, "scheduler.backend=serial"]) == 0, capfd.readouterr().err
    manifest = json.loads((tmp_path / "größe 1" / "manifest.json").read_text())
    assert sum(shard["samples"] for shard in manifest["shards"]) == 1
