"""`python -m evaluation dataset=DIR`: a dataset's noisy images, and baselines, against its clean.

`python -m evaluation tune dataset=DIR` finds the best parameters of the baselines first.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from omegaconf import DictConfig, OmegaConf

from factory.cli import accept_dataset_folder, run_app
from factory.errors import FactoryError
from factory.settings import build

if TYPE_CHECKING:
    from evaluation.measure import EvaluationSettings
    from evaluation.tuning import BaselineSettings


def run(config: DictConfig) -> None:
    """Measure, print the table and write the files."""
    # Only after the configuration is known: `--help` and typing errors answer at once.
    from evaluation import leaderboard, leaderboard_files, measure, summary

    settings, own = settings_of(config)
    methods, untuned = leaderboard.methods_of(settings, own)
    name = Path(settings.dataset.dir).resolve().name
    out = Path(settings.out or Path("outputs", "evaluation", f"{name}-{settings.split}"))
    scores = measure.measure(settings)
    estimates = measure.summarise(scores, settings)
    summary.write(out, scores, estimates, settings)
    print(summary.table(estimates))
    if methods:
        items, rows = leaderboard.leaderboard(settings, methods, texture=own.texture)
        leaderboard_files.write(out, items, rows)
        print(f"\n{leaderboard_files.table(rows)}")
        if untuned:
            print(
                f"not tuned: {', '.join(untuned)}; `python -m evaluation tune dataset=DIR` gives "
                "them rows with tuned parameters and levels"
            )
    print(f"report: {out / 'summary.md'}")


def run_tune(config: DictConfig) -> None:
    """Tune the baselines on validation pairs."""
    from evaluation import tuning

    print("\n".join(tuning.tune(*settings_of(config))))


def settings_of(config: DictConfig) -> tuple[EvaluationSettings, BaselineSettings]:
    """The checked settings.  FactoryError names the key that is wrong."""
    from evaluation.measure import EvaluationSettings
    from evaluation.tuning import BaselineSettings

    if config.dataset.dir is None:
        raise FactoryError("dataset: give the folder that `python -m factory` made, dataset=DIR")
    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    own = {key: values.pop(key) for key in ("baselines", "texture", "tuning")}
    settings: EvaluationSettings = build(EvaluationSettings, values)
    return settings, build(BaselineSettings, own)


def main() -> None:
    """Entry point of `fls-evaluation`."""
    task = run
    if sys.argv[1:2] == ["tune"]:
        del sys.argv[1]
        task = run_tune
    accept_dataset_folder()
    sys.exit(run_app(task, "evaluation"))


if __name__ == "__main__":
    main()
