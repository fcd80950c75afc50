"""What computes a network: onnxruntime for the weights that ship, torch for weights of one's own.

Neither torch nor lightning is imported for an ONNX file of `simnfnd export-weights --to runtime`.
What is quick in NumPy stands around the graph: the beam and the arc of each cell, and the sector.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ...factory.cli.extras import Need, require
from ...factory.errors import FactoryError

Gray = npt.NDArray[np.float32]
Maps = Mapping[str, Gray]

EXACT = "32-true"
PRECISIONS = ("auto", EXACT, "bf16-mixed")
"""Arithmetic of a denoiser, in the words of `train.precision`."""


class Runtime(Protocol):
    """A network ready to denoise.

    extras: names of its optional inputs (see `models.networks`).  looks: pictures that it sees at
    once.  wide_grain: see `models.denoise.scales`.  on_gpu: whether it runs on a GPU.
    """

    extras: tuple[str, ...]
    looks: int
    wide_grain: float
    on_gpu: bool

    def run(self, gray: Gray, maps: Maps, told: Gray | None) -> tuple[Gray, float]:
        """The picture (H, W) with its whole change, and the part of that it should get, 0 to 1.

        gray: (H, W) in 0..1.  maps: (H, W) planes by the names of `extras`; `looks` (H, W, T).
        told: (6,), what to remove; None where the network is not told.
        """


def open_runtime(weights: Path, device: str, precision: str = EXACT) -> Runtime:
    """The network of a weights file (`.safetensors`) or of an ONNX file of `--to runtime`.

    device: auto, cpu or gpu.  Raises FactoryError for a file that holds no network, a GPU that is
    not there, an unknown precision, and packages that are not installed.
    """
    if precision not in PRECISIONS:
        raise FactoryError(f"--precision {precision}: is none of {', '.join(PRECISIONS)}")
    if weights.suffix == ".onnx":
        return OnnxNetwork(weights, device, precision)
    return TorchNetwork(weights, device, precision)


class OnnxNetwork:
    """A network in onnxruntime, in 32 bits; a `Runtime`."""

    looks = 1

    def __init__(self, path: Path, device: str, precision: str = EXACT) -> None:
        """See `open_runtime`."""
        require([Need("these weights", "onnxruntime")])
        import onnxruntime

        if precision == "bf16-mixed":
            raise FactoryError(
                "--precision bf16-mixed: is for weights of your own; those that ship compute in 32 "
                "bits"
            )
        has_gpu = "CUDAExecutionProvider" in onnxruntime.get_available_providers()
        if device == "gpu" and not has_gpu:
            raise FactoryError(
                "--device gpu: onnxruntime finds no usable GPU here; install onnxruntime-gpu, or "
                "use --device cpu"
            )
        self.on_gpu = has_gpu and device != "cpu"
        providers = ["CUDAExecutionProvider"] if self.on_gpu else []
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        # Waiting threads would burn as much time as computing ones.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(
                path.read_bytes(), options, providers=[*providers, "CPUExecutionProvider"]
            )
            facts = self._session.get_modelmeta().custom_metadata_map
            self.extras = tuple(filter(None, facts["extras"].split(",")))
            self.wide_grain, self._stride = float(facts["wide_grain"]), int(facts["stride"])
        except Exception as error:
            # onnxruntime reports a damaged file with a dozen exception types.
            raise FactoryError(
                f"weights={path}: not an ONNX file of `simnfnd export-weights --to runtime`, or a "
                "damaged one"
            ) from error
        self._inputs = tuple(one.name for one in self._session.get_inputs())

    def run(self, gray: Gray, maps: Maps, told: Gray | None) -> tuple[Gray, float]:
        """See `Runtime`."""
        found = inputs_of(gray, maps, told, self._stride)
        image, weight = self._session.run(
            ["image", "weight"], {name: found[name] for name in self._inputs}
        )
        inside = maps["sector"] > 0 if _known(maps) and "sector" in maps else True
        return np.asarray(np.where(inside, image[0, 0], gray), np.float32), float(weight[0])


def inputs_of(gray: Gray, maps: Maps, told: Gray | None, stride: int) -> dict[str, Any]:
    """What an ONNX file of `--to runtime` computes a picture from, (H, W) in 0..1.

    maps: `range_fraction` and `azimuth_rad` where the geometry is known, `sector` where it is not
    all of the picture, `frames` (log2 of how many were averaged) where these are several.
    Returns `noisy` and `frames` (1, 1, H, W), `maps` (1, 3, H, W), `beams` and `arcs` (1, cells)
    int64, the line of each cell at half resolution, and `remove` (1, 6).
    """
    height, width = gray.shape
    rows, columns = (-(-side // stride) * stride // 2 for side in gray.shape)
    if _known(maps):
        sector = maps.get("sector", np.ones_like(gray))
        radius, azimuth = maps["range_fraction"], maps["azimuth_rad"]
        planes = 2 * radius - 1, azimuth, 1 - sector
        inside = _cells(sector, stride) > 0
        beams = _numbers(_cells(azimuth, stride), inside, columns)
        arcs = _numbers(_cells(radius, stride), inside, rows)
    else:
        # Columns count as beams and rows as arcs; -1 occurs in no known geometry.
        nothing = np.zeros_like(gray)
        planes = nothing, nothing, nothing - 1
        beams = np.broadcast_to(np.arange(columns), (rows, columns))
        arcs = np.broadcast_to(np.arange(rows)[:, None], (rows, columns))
    frames = maps.get("frames")
    return {
        "noisy": np.ascontiguousarray(gray, np.float32)[None, None],
        "maps": np.stack(planes)[None].astype(np.float32),
        "beams": np.ascontiguousarray(beams, np.int64).reshape(1, -1),
        "arcs": np.ascontiguousarray(arcs, np.int64).reshape(1, -1),
        "frames": np.zeros((1, 1, height, width), np.float32)
        if frames is None
        else np.ascontiguousarray(frames, np.float32)[None, None],
        "remove": None if told is None else told[None],
    }


def _known(maps: Maps) -> bool:
    return "range_fraction" in maps and "azimuth_rad" in maps


def _cells(plane: Gray, stride: int) -> Gray:
    """Every second pixel of a plane that is lengthened to a multiple of the stride."""
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % stride), (0, -width % stride)), mode="edge")
    return padded[::2, ::2]


def _numbers(values: Gray, inside: npt.NDArray[np.bool_], count: int) -> npt.NDArray[np.int64]:
    """Which of `count` even steps between the extremes inside a value lies in."""
    least, most = (values[inside].min(), values[inside].max()) if inside.any() else (0, 1)
    extent = max(np.float32(most) - np.float32(least), np.float32(1e-6))
    step = (values - np.float32(least)) / extent
    return np.clip(step * np.float32(count), 0, count - 1).astype(np.int64)


class TorchNetwork:
    """A network in torch; a `Runtime`."""

    def __init__(self, path: Path, device: str, precision: str = EXACT) -> None:
        """See `open_runtime`."""
        require(Need(f"weights={path.name}", module) for module in ("torch", "safetensors"))
        import torch

        from ..networks.weights import load_weights

        network = load_weights(path).network
        has_gpu = torch.cuda.is_available()
        if device == "gpu" and not has_gpu:
            raise FactoryError("--device gpu: no usable GPU here; use --device cpu")
        self.on_gpu = has_gpu and device != "cpu"
        self._device = "cuda" if self.on_gpu else "cpu"
        self._network = network.to(self._device)
        self.extras, self.looks = network.extras, network.looks
        self.wide_grain = network.wide_grain
        self._half = _is_half(precision, self._device)

    def run(self, gray: Gray, maps: Maps, told: Gray | None) -> tuple[Gray, float]:
        """See `Runtime`."""
        import torch

        known = {
            name: torch.from_numpy(np.ascontiguousarray(plane))[None, None]
            for name, plane in maps.items()
            if name in self.extras and name != "looks"
        }
        if "looks" in maps:
            looks = np.ascontiguousarray(np.moveaxis(maps["looks"], -1, 0))
            known["looks"] = torch.from_numpy(looks)[None]
        if told is not None:
            known["remove"] = torch.from_numpy(told)[None]
        known = {name: plane.to(self._device) for name, plane in known.items()}
        noisy, weight = torch.from_numpy(np.ascontiguousarray(gray))[None, None], 1.0
        noisy = noisy.to(self._device)
        with (
            torch.inference_mode(),
            torch.autocast(self._device, torch.bfloat16, enabled=self._half),
        ):
            if self._network.has_heads:
                output = self._network.with_heads(noisy, **known)
                image, weight = output.image, float(output.weight[0])
            else:
                image = self._network(noisy, **known)
        return np.asarray(image[0, 0].float().cpu().numpy(), np.float32), weight


def _is_half(precision: str, device: str) -> bool:
    """Whether to compute in bfloat16."""
    if precision == EXACT:
        return False
    from ..training.precision import cpu_has_bf16, gpu_has_bf16

    if precision == "auto":
        return cpu_has_bf16() if device == "cpu" else gpu_has_bf16()
    return True
