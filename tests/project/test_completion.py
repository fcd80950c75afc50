"""What a shell offers at Tab, asked of the shells themselves."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from simnfnd.command import main
from simnfnd.completion import SCRIPTS, complete, script
from simnfnd.factory.cli.nearest import catalogue
from simnfnd.verbs import VERBS
from tests.project_files import ROOT


def needs(shell: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(shell) is None, reason=f"no {shell} here")


@pytest.mark.parametrize(
    ("words", "wanted", "unwanted"),
    [
        ([""], {"make", "evaluate", "--help"}, {"tune"}),
        (["ev"], {"evaluate"}, {"make"}),
        (["evaluate", ""], {"tune", "real", "baselines=", "tuning."}, {"scenes="}),
        (["evaluate", "real", "mod"], {"models="}, {"model="}),
        (["make", "noi"], {"noise=", "noise."}, {"noise.background."}),
        (["make", "noise.background."], {"noise.background.density="}, {"noise.background."}),
        (["make", "sonar=did"], {"sonar=didson_hf", "sonar=didson_lf"}, {"sonar=ping360"}),
        (["make", "sonar=didson_hf", "so"], {"sonar."}, {"sonar="}),
        (["make", "cache.enabled="], {"cache.enabled=true"}, set()),
        (["make", "-m", "frames.t"], {"frames.total="}, set()),
        (["plan", "render=a"], {"render=analytic"}, {"render=cycles"}),
        (["cache", "pack", "experiment=d"], {"experiment=demo"}, set()),
        (["train", "model=u"], {"model=unet"}, set()),
        (["nonsense", ""], set(), {"make"}),
        (["make", "dataset.dir=out"], set(), {"dataset.dir="}),
    ],
)
def test_what_may_come_next(words: list[str], wanted: set[str], unwanted: set[str]) -> None:
    found = set(complete(words))
    assert wanted <= found
    assert not unwanted & found
    assert not any("defaults" in one for one in found)


def test_every_verb_that_takes_settings_has_its_configuration() -> None:
    verbs = [*VERBS.values(), *(own for verb in VERBS.values() for own in verb.verbs.values())]
    for verb in verbs:
        assert not verb.hydra or verb.config, verb
        if verb.config:
            assert catalogue(verb.config).keys


def test_the_scripts_are_told_in_help_and_refused_for_others(capsys) -> None:
    assert main(["--shell-completion", "fish"]) == 0
    assert capsys.readouterr().out.strip() == SCRIPTS["fish"].strip()
    assert main(["make", "--shell-completion", "install=zsh"]) == 0
    assert capsys.readouterr().out.strip() == script("zsh")
    assert main(["--shell-completion", "tcsh"]) == 2
    assert "bash, zsh or fish" in capsys.readouterr().err
    assert main(["--help"]) == 0
    assert "--shell-completion bash" in capsys.readouterr().out


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """One in which `simnfnd` is this checkout's, and a home without settings."""
    folder = tmp_path_factory.mktemp("shells")
    program = folder / "simnfnd"
    program.write_text(f'#!/bin/sh\ncd {ROOT} && exec {sys.executable} -m simnfnd "$@"\n')
    program.chmod(0o755)
    for shell, text in SCRIPTS.items():
        (folder / shell).write_text(text)
    path = f"{folder}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "HOME": str(folder), "SCRIPTS": str(folder)}


def asked(command: list[str], environment: dict[str, str]) -> list[str]:
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout.split()


# What is typed, and what the shell must offer among others.
TYPED = [("ma", "make"), ("make sonar=did", "sonar=didson_hf"), ("evaluate tu", "tuning.")]


@needs("bash")
@pytest.mark.parametrize(("typed", "offered"), TYPED)
def test_bash(environment: dict[str, str], typed: str, offered: str) -> None:
    line = f"simnfnd {typed}"
    code = (
        '. "$SCRIPTS/bash"; complete -p simnfnd >/dev/null || exit 1; COMP_LINE="$0"; '
        'COMP_POINT=${#0}; _simnfnd; printf "%s\\n" "${COMPREPLY[@]}"'
    )
    # Bash breaks words at `=`.
    assert offered.rpartition("=")[2] in asked(["bash", "-c", code, line], environment)


@needs("zsh")
@pytest.mark.parametrize(("typed", "offered"), TYPED)
def test_zsh(environment: dict[str, str], typed: str, offered: str) -> None:
    code = (
        'compdef() { [[ "$*" == "_simnfnd simnfnd" ]] || exit 1 }; '
        'compadd() { while [[ $1 != -- ]]; do shift; done; shift; print -l -- "$@" }; '
        '. "$SCRIPTS/zsh"; words=("${(@s: :)1}"); CURRENT=$#words; _simnfnd'
    )
    assert offered in asked(["zsh", "-fc", code, "zsh", f"simnfnd {typed}"], environment)


@needs("fish")
@pytest.mark.parametrize(("typed", "offered"), TYPED)
def test_fish(environment: dict[str, str], typed: str, offered: str) -> None:
    code = f'source "$SCRIPTS/fish"; complete -C "simnfnd {typed}"'
    assert offered in asked(["fish", "--no-config", "-c", code], environment)
    (Path(environment["HOME"]) / "a-file.csv").touch()
    code = 'cd "$HOME"; source "$SCRIPTS/fish"; complete -C "simnfnd make scenes.file=a-f"'
    assert "scenes.file=a-file.csv" in asked(["fish", "--no-config", "-c", code], environment)
