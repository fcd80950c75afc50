"""`python -m evaluation dataset=DIR`: measure a dataset's noisy images against its clean ones."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from factory.cli import accept_dataset_folder, run_app
from factory.errors import FactoryError
from factory.settings import build


def run(config: DictConfig) -> None:
    """Measure, print the table and write the files."""
    # Only after the configuration is known: `--help` and typing errors answer at once.
    from evaluation import measure, summary

    if config.dataset.dir is None:
        raise FactoryError("dataset: give the folder that `python -m factory` made, dataset=DIR")
    values = cast(dict[str, Any], OmegaConf.to_container(config, resolve=True))
    settings: measure.EvaluationSettings = build(measure.EvaluationSettings, values)
    name = Path(settings.dataset.dir).resolve().name
    out = Path(settings.out or Path("outputs", "evaluation", f"{name}-{settings.split}"))
    scores = measure.measure(settings)
    estimates = measure.summarise(scores, settings)
    summary.write(out, scores, estimates, settings)
    print(summary.table(estimates))
    print(f"report: {out / 'summary.md'}")


def main() -> None:
    """Entry point of `fls-evaluation`."""
    accept_dataset_folder()
    sys.exit(run_app(run, "evaluation"))


if __name__ == "__main__":
    main()
