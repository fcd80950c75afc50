"""`python -m models dataset=DIR` trains a denoiser; `python -m models denoise IN...` uses it.

`python -m models export-weights WEIGHTS --out FILE` makes trained weights ready to ship.
"""

from __future__ import annotations

import sys
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from factory.cli import accept_dataset_folder, guard, run_app
from factory.errors import FactoryError
from factory.settings import build
from models import WEIGHTS_NAME


def run(config: DictConfig) -> None:
    """Train as the configuration says."""
    if config.dataset.dir is None and config.data.get("kind") in ("pairs", "renders"):
        raise FactoryError(
            "dataset: give the folder that `python -m factory` made, dataset=DIR "
            "(or `python -m models denoise --help` to use trained weights)"
        )
    from models.settings import ModelsSettings

    container = OmegaConf.to_container(config, resolve=True, throw_on_missing=True)
    values = cast(dict[str, Any], container)
    settings: ModelsSettings = build(ModelsSettings, values)
    # torch and Lightning take seconds to import: only when there is something to train.
    from models.train import is_main_process, output_folder, train

    best = train(settings, values)
    if not is_main_process():
        return
    if "psnr" in best:
        print(
            f"validation: {best['psnr_noisy']:.2f} -> {best['psnr']:.2f} dB "
            f"({best['gain_db']:+.2f}), SSIM {best['ssim_noisy']:.3f} -> {best['ssim']:.3f}, "
            f"step {best['step']}"
        )
    else:
        print(f"validation: loss {best['validation_loss']:.5f}, step {best['step']}")
    print(f"weights: {output_folder(settings) / WEIGHTS_NAME}")


def main() -> None:
    """Entry point of `fls-models`."""
    arguments = sys.argv[2:]
    if sys.argv[1:2] == ["denoise"]:
        from models.denoise import main as denoise

        sys.exit(guard(lambda: denoise(arguments)))
    if sys.argv[1:2] == ["export-weights"]:
        from models.weights_export import main as export

        sys.exit(guard(lambda: export(arguments)))
    accept_dataset_folder()
    sys.exit(run_app(run, "models"))


if __name__ == "__main__":
    main()
