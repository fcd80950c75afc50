"""`simnfnd export-weights`: trained weights in 16 bits with a card, or for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.extras import Need, require
from ...factory.common.files import check_writable, sha256_of, write_atomically
from ..pretrained import find_weights
from ..pretrained.card import CardFile, write_card

SUFFIXES = {"safetensors": ".safetensors", "onnx": ".onnx", "runtime": ".onnx"}
"""What `--to` may say, and how the files end."""


def main(arguments: Sequence[str]) -> int:
    """Write the weights in the form that is asked for."""
    parser = Parser(prog="simnfnd export-weights")
    add = parser.add_argument
    add("weights", help="weights.safetensors of a training, or a name that ships")
    add("--out", required=True, metavar="FILE", help="file to write")
    form = (
        "safetensors: 16 bits with a model card (default); onnx: for other programs, see "
        "docs/how-to/deploy.md; runtime: the graph without weights, with which `simnfnd denoise` "
        "runs without torch"
    )
    add("--to", choices=tuple(SUFFIXES), default="safetensors", help=form)
    geometry_help = "for onnx: the images come with range and bearing of this geometry (none)"
    add("--geometry", choices=("none", "fan", "polar"), default="none", help=geometry_help)
    reports = "real.json or report.json of evaluations; the model card states their figures"
    add("--figures", nargs="*", default=[], metavar="REPORT", help=reports)
    chosen = parser.parse_args(list(arguments))
    out = Path(chosen.out).expanduser()
    if out.suffix != SUFFIXES[chosen.to]:
        raise FactoryError(f"--out {out}: must end in {SUFFIXES[chosen.to]} for --to {chosen.to}")
    if chosen.figures and chosen.to != "safetensors":
        raise FactoryError("--figures: is for --to safetensors, which has a model card")
    if chosen.geometry != "none" and chosen.to != "onnx":
        raise FactoryError(f"--geometry {chosen.geometry}: is for --to onnx")
    weights = find_weights(chosen.weights)
    if chosen.to == "safetensors":
        size_mb = export(weights, out, [Path(name).expanduser() for name in chosen.figures])
        print(f"weights: {out}, {size_mb:.2f} MB; card: {out.with_suffix('.md')}")
        return 0
    require(Need(f"--to {chosen.to}", module) for module in ("onnx", "onnxruntime"))
    from .onnx_graph import OPSET, write_onnx

    difference = write_onnx(weights, out, chosen.geometry if chosen.to == "onnx" else None)
    size_mb = out.stat().st_size / 1e6
    print(f"{out}: ONNX, opset {OPSET}, {size_mb:.2f} MB, within {difference:.1e} of torch")
    return 0


def export(weights: str | Path, out: Path, reports: Sequence[Path] = ()) -> float:
    """Write `out` and its card; returns the megabytes of the weights.

    weights: the curve and the cost of the training are taken from the same folder.  reports: of
    evaluations, whose figures go into the card.
    Raises FactoryError when the weights or a report cannot be read, or for weights that do not fit
    into 16 bits.
    """
    import torch  # slow; mistakes on the command line are reported before

    from ..networks.network import count_macs
    from ..networks.weights import load_weights, save_weights

    trained = load_weights(weights)
    for name, tensor in trained.network.state_dict().items():
        if tensor.is_floating_point() and not torch.isfinite(tensor.half()).all():
            raise FactoryError(f"weights={weights}: {name} does not fit into 16 bits")
    check_writable(out.parent, "--out")
    save_weights(out, trained.network, trained.model, trained.training, half=True)
    size_mb = out.stat().st_size / 1e6
    file = CardFile(
        name=out.stem,
        sha256=sha256_of(out),
        source_sha256=sha256_of(Path(weights)),
        parameters=sum(parameter.numel() for parameter in trained.network.parameters()),
        gmac=count_macs(trained.network, 256) / 1e9,
        size_mb=size_mb,
    )
    card = write_card(file, trained.model, trained.training, Path(weights).parent, reports)
    write_atomically(out.with_suffix(".md"), card.encode(), key="--out")
    return size_mb
