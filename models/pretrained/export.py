"""`simnfnd export-weights`: trained weights in 16 bits, with a model card."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from simnfnd.factory import __version__
from simnfnd.factory.cli import Parser
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import check_writable, write_atomically

LIMIT_MB = 8.0
"""What ships must be small enough to live in the repository."""

_CARD = """# {name}

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

## Trained on

{history}

{recipe}

## Figures

{figures}

## Limits

{limits}
"""

_ONE_TRAINING = "The table describes the training that wrote these weights."
_LAST_STAGE = (
    "**The table describes the last stage of training alone.** It began from other weights, which "
    "the key `start` names by their hash; their own trainings are not in this file."
)
_SELECTION = (
    "How the recipe was chosen is not recorded either: figures on pictures that had a part in "
    "choosing it, test pictures included, are optimistic."
)
_LIMITS = (
    "Trained on simulated noise: a picture whose noise, geometry or grey scale differs from what "
    "is described above may come out worse than it went in.  It learned what a sonar picture of "
    "the training scenes looks like, so small targets unlike anything there can be smoothed away; "
    "do not measure on denoised pictures what you could measure on the originals."
)


def main(arguments: Sequence[str]) -> int:
    """Write the 16-bit weights and, beside them, a model card of their name."""
    parser = Parser(prog="simnfnd export-weights")
    parser.add_argument("weights", help="weights.safetensors of a training")
    parser.add_argument("--out", required=True, help="file to write, NAME.safetensors")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a setting of the network that may change after training, for example mirror=true",
    )
    parser.add_argument("--figures", help="Markdown file with measured figures for the card")
    parser.add_argument("--limits", help="Markdown file that replaces the card's words on limits")
    chosen = parser.parse_args(list(arguments))
    out = Path(chosen.out).expanduser()
    if out.suffix != ".safetensors":
        raise FactoryError(f"--out {out}: must end in .safetensors")
    figures, limits = (_text(path) for path in (chosen.figures, chosen.limits))
    size_mb = export(chosen.weights, out, figures, limits, changes=_changes(chosen.set))
    print(f"weights: {out}, {size_mb:.2f} MB; card: {out.with_suffix('.md')}")
    return 0


def export(
    weights: str | Path,
    out: Path,
    figures: str = "",
    limits: str = "",
    changes: Mapping[str, Any] | None = None,
) -> float:
    """Write `out` and its card; returns the megabytes of the weights.

    figures, limits: Markdown for the card; empty: the validation of the training, and general
    words.  changes: of the network's settings.  Raises FactoryError when the weights cannot be
    read, hold what 16 bits cannot, are too large to ship, or do not fit the changed network.
    """
    import torch  # slow; mistakes on the command line are reported before

    from simnfnd.models.networks import build_network
    from simnfnd.models.networks.cost import count_macs
    from simnfnd.models.networks.weights import load_weights, save_weights

    trained = load_weights(weights)
    for name, tensor in trained.network.state_dict().items():
        if tensor.is_floating_point() and not torch.isfinite(tensor.half()).all():
            raise FactoryError(f"weights={weights}: {name} does not fit into 16 bits")
    count = sum(parameter.numel() for parameter in trained.network.parameters())
    size_mb = 2 * count / 1e6
    if size_mb > LIMIT_MB:
        raise FactoryError(
            f"weights={weights}: {size_mb:.1f} MB in 16 bits are more than the {LIMIT_MB:g} MB "
            "that may ship; train a smaller network"
        )
    model = {**trained.model, **(changes or {})}
    try:
        build_network(model).load_state_dict(trained.network.state_dict())
    except RuntimeError as error:
        raise FactoryError(
            f"--set {', '.join(changes or {})}: the weights do not fit such a network; set only "
            "what does not change its sizes"
        ) from error
    check_writable(out.parent, "--out")
    save_weights(out, trained.network, model, trained.training, half=True)
    facts = dict(trained.training)
    validation = facts.pop("validation", {})
    card = _CARD.format(
        name=out.stem,
        version=__version__,
        network=", ".join(f"{key} {value}" for key, value in model.items()),
        parameters=count,
        gmac=f"{count_macs(trained.network, 256) / 1e9:.2f}",
        size_mb=out.stat().st_size / 1e6,
        seed=facts.get("seed", "unknown"),
        step=validation.get("step", "unknown"),
        history=f"{_LAST_STAGE if 'start' in facts else _ONE_TRAINING} {_SELECTION}",
        recipe=_table(
            {
                key: value
                for key, value in facts.items()
                if key != "seed" and not key.startswith("model.")
            }
        ),
        figures=figures or _validation(validation),
        limits=limits or _LIMITS,
    )
    write_atomically(out.with_suffix(".md"), card.encode(), key="--out")
    return out.stat().st_size / 1e6


def _changes(words: Sequence[str]) -> dict[str, Any]:
    changes = {}
    for word in words:
        key, equals, text = word.partition("=")
        if not equals:
            raise FactoryError(f"--set {word}: is no KEY=VALUE")
        changes[key] = yaml.safe_load(text)
    return changes


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


def _text(path: str | None) -> str:
    if path is None:
        return ""
    try:
        return Path(path).expanduser().read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise FactoryError(f"{path}: cannot be read as text") from error
