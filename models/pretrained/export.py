"""`simnfnd export-weights`: trained weights in 16 bits with a card, or for other programs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...factory import __version__
from ...factory.cli import Parser
from ...factory.cli.extras import Need, require
from ...factory.errors import FactoryError
from ...factory.files import check_writable, sha256_of, write_atomically
from . import find_weights

_CARD = """---
license: apache-2.0
library_name: simnfnd
pipeline_tag: image-to-image
tags: [sonar, denoising, forward-looking-sonar]
---

# {name}

A denoiser for forward-looking sonar pictures, made by `simnfnd train` of SimNFND {version}.
`simnfnd denoise IN... --out DIR --weights {name}` uses it.

| | |
|---|---|
| network | {network} |
| parameters | {parameters:,} |
| GMAC for a 256x256 picture | {gmac} |
| file | {size_mb:.2f} MB, 16-bit safetensors |
| seed | {seed} |
| steps kept | {step} |

## The training that wrote them

A key `start` names weights that it began from, by their hash.

{recipe}

## Figures

{figures}
How the recipe was chosen is not recorded: figures on pictures that had a part in it are optimistic.

## Limits

{limits}
"""

_LIMITS = (
    "Trained on simulated noise: a picture whose noise, geometry or grey scale differs from what "
    "is described above may come out worse than it went in.  It learned what a sonar picture of "
    "the training scenes looks like, so small targets unlike anything there can be smoothed away; "
    "do not measure on denoised pictures what you could measure on the originals."
)


SUFFIXES = {"safetensors": ".safetensors", "onnx": ".onnx", "runtime": ".onnx"}
"""What `--to` may say, and how the files end."""


def main(arguments: Sequence[str]) -> int:
    """Write the weights in the form that is asked for."""
    parser = Parser(prog="simnfnd export-weights")
    parser.add_argument("weights", help="weights.safetensors of a training, or a name that ships")
    parser.add_argument("--out", required=True, help="file to write")
    parser.add_argument(
        "--to",
        choices=tuple(SUFFIXES),
        default="safetensors",
        help="safetensors: 16 bits with a model card (default); onnx: for other programs, see "
        "docs/deploy.md; runtime: the graph without weights by which `simnfnd denoise` does "
        "without torch",
    )
    parser.add_argument(
        "--geometry",
        choices=("none", "fan", "polar"),
        default="none",
        help="of the pictures that an onnx file gets with their range and bearing",
    )
    chosen = parser.parse_args(list(arguments))
    out = Path(chosen.out).expanduser()
    if out.suffix != SUFFIXES[chosen.to]:
        raise FactoryError(f"--out {out}: must end in {SUFFIXES[chosen.to]} for --to {chosen.to}")
    if chosen.geometry != "none" and chosen.to != "onnx":
        raise FactoryError(f"--geometry {chosen.geometry}: is for --to onnx")
    weights = find_weights(chosen.weights)
    if chosen.to == "safetensors":
        size_mb = export(weights, out)
        print(f"weights: {out}, {size_mb:.2f} MB; card: {out.with_suffix('.md')}")
        return 0
    require(Need(f"--to {chosen.to}", module) for module in ("onnx", "onnxruntime"))
    from ..networks.weights import load_weights
    from .onnx_graph import OPSET, Graph, write_onnx, write_runtime

    if chosen.to == "runtime":
        difference = write_runtime(weights, out)
    else:
        trained = load_weights(weights)
        about = {
            "simnfnd": __version__,
            "model": json.dumps(dict(trained.model), sort_keys=True),
            "weights_sha256": sha256_of(weights),
        }
        difference = write_onnx(Graph(trained.network, chosen.geometry), out, about)
    size_mb = out.stat().st_size / 1e6
    print(f"{out}: ONNX, opset {OPSET}, {size_mb:.2f} MB, within {difference:.1e} of torch")
    return 0


def export(weights: str | Path, out: Path) -> float:
    """Write `out` and its card; returns the megabytes of the weights.

    Raises FactoryError when the weights cannot be read or hold what 16 bits cannot.
    """
    import torch  # slow; mistakes on the command line are reported before

    from ..networks.network import count_macs
    from ..networks.weights import load_weights, save_weights

    trained = load_weights(weights)
    for name, tensor in trained.network.state_dict().items():
        if tensor.is_floating_point() and not torch.isfinite(tensor.half()).all():
            raise FactoryError(f"weights={weights}: {name} does not fit into 16 bits")
    count = sum(parameter.numel() for parameter in trained.network.parameters())
    check_writable(out.parent, "--out")
    save_weights(out, trained.network, trained.model, trained.training, half=True)
    facts = dict(trained.training)
    validation = facts.pop("validation", {})
    card = _CARD.format(
        name=out.stem,
        version=__version__,
        network=", ".join(f"{key} {value}" for key, value in trained.model.items()),
        parameters=count,
        gmac=f"{count_macs(trained.network, 256) / 1e9:.2f}",
        size_mb=out.stat().st_size / 1e6,
        seed=facts.get("seed", "unknown"),
        step=validation.get("step", "unknown"),
        recipe=_table(
            {
                key: value
                for key, value in facts.items()
                if key != "seed" and not key.startswith("model.")
            }
        ),
        figures=_validation(validation),
        limits=_LIMITS,
    )
    write_atomically(out.with_suffix(".md"), card.encode(), key="--out")
    return out.stat().st_size / 1e6


def _validation(row: Mapping[str, Any]) -> str:
    if "psnr" not in row:
        return "Validation figures are not known."
    return (
        "On the validation images of its training (never trained on): PSNR "
        f"{row['psnr_noisy']:.2f} -> {row['psnr']:.2f} dB, SSIM {row['ssim_noisy']:.3f} -> "
        f"{row['ssim']:.3f}."
    )


def _table(values: Mapping[str, Any]) -> str:
    lines = ["| key | value |", "|---|---|"]
    for key, value in values.items():
        shown = value if isinstance(value, str) else json.dumps(value)
        lines.append(f"| `{key}` | {shown} |")
    return "\n".join(lines)
