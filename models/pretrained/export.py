"""`simnfnd export-weights`: trained weights in 16 bits with a card, or for other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from ...factory import __version__
from ...factory.cli import Parser
from ...factory.cli.extras import Need, require
from ...factory.errors import FactoryError
from ...factory.files import check_writable, write_atomically
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

| key | value |
|---|---|
{facts}

A key `start` names weights that it began from, by their hash.  Figures under `validation` are of
pictures that it never trained on; where they had a part in choosing the recipe they are optimistic.

Trained on simulated noise: a picture whose noise, geometry or grey scale differs from what is
described above may come out worse than it went in.  Small targets unlike anything in the training
scenes can be smoothed away; do not measure on denoised pictures what you could measure on the
originals.
"""
SUFFIXES = {"safetensors": ".safetensors", "onnx": ".onnx", "runtime": ".onnx"}
"""What `--to` may say, and how the files end."""


def main(arguments: Sequence[str]) -> int:
    """Write the weights in the form that is asked for."""
    parser = Parser(prog="simnfnd export-weights")
    add = parser.add_argument
    add("weights", help="weights.safetensors of a training, or a name that ships")
    add("--out", required=True, help="file to write")
    form = (
        "safetensors: 16 bits with a model card (default); onnx: for other programs, see "
        "docs/deploy.md; runtime: the graph without weights by which `simnfnd denoise` does "
        "without torch"
    )
    add("--to", choices=tuple(SUFFIXES), default="safetensors", help=form)
    where = "of the pictures that an onnx file gets with their range and bearing"
    add("--geometry", choices=("none", "fan", "polar"), default="none", help=where)
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
    from .onnx_graph import OPSET, write_onnx

    difference = write_onnx(weights, out, chosen.geometry if chosen.to == "onnx" else None)
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
    size_mb = out.stat().st_size / 1e6
    facts = {
        "parameters": f"{count:,}",
        "GMAC for a 256x256 picture": f"{count_macs(trained.network, 256) / 1e9:.2f}",
        "file": f"{size_mb:.2f} MB, 16-bit safetensors",
        "model": dict(trained.model),
        **trained.training,
    }
    shown = {key: one if isinstance(one, str) else json.dumps(one) for key, one in facts.items()}
    rows = "\n".join(f"| `{key}` | {one} |" for key, one in shown.items())
    card = _CARD.format(name=out.stem, version=__version__, facts=rows)
    write_atomically(out.with_suffix(".md"), card.encode(), key="--out")
    return size_mb
