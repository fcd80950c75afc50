"""Layers of a SonarNet as an exported graph computes them fastest on a CPU.

They compute what the layers of training compute, but for rounding: `exporting.onnx_graph` compares
both before it writes a graph.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from .line_context import MapLines

_IMAGE_PLANES = 3  # of the head that weighs


def unshuffled_conv(conv: nn.Conv2d, image: Tensor) -> Tensor:
    """A 3x3 convolution of `pixel_unshuffle(image, 2)`, without moving pixels to channels.

    conv: of 4 C channels, padded by 1.  image: (N, C, H, W) with even sides.
    """
    return functional.conv2d(
        image, _at_full_size(conv, 0), conv.bias, 2 * conv.stride[0], padding=2
    )


def unshuffled_part_conv(conv: nn.Conv2d, features: Tensor, image: Tensor) -> Tensor:
    """A 3x3 convolution of features (N, F, h, w) beside `pixel_unshuffle(image, 2)`.

    conv: of F + 12 channels, padded by 1.  image: (N, 3, 2 h, 2 w).
    """
    # Shapes by the layers, not by the traced tensors: the exporter must know those of weights.
    depth = conv.in_channels - 4 * _IMAGE_PLANES
    of_features = functional.conv2d(
        features, conv.weight[:, :depth], conv.bias, conv.stride[0], padding=1
    )
    weight = _at_full_size(conv, depth)
    return of_features + functional.conv2d(image, weight, None, 2 * conv.stride[0], padding=2)


def _at_full_size(conv: nn.Conv2d, first: int) -> Tensor:
    """Weights for unshuffled pixels, from channel `first` on -> (D, C, 6, 6) for the pixels."""
    planes = (conv.in_channels - first) // 4
    by_place = conv.weight[:, first:].reshape(conv.out_channels, planes, 2, 2, 3, 3)
    in_rows = by_place.permute(0, 1, 4, 2, 5, 3)
    return in_rows.reshape(conv.out_channels, planes, 6, 6)


def scaled_and_shifted(film: nn.Conv2d, level: Tensor, x: Tensor) -> Tensor:
    """Features x scaled and shifted by a 1x1 convolution of a condition, both (N, C, h, w)."""
    width = film.out_channels // 2
    scale = functional.conv2d(level, film.weight[:width], torch.ones(width))
    shift = functional.conv2d(level, film.weight[width:])
    return x * scale + shift


class RowLines(MapLines):
    """The beams and arcs of one image, (1, C, h, w).

    Sums by rows (ScatterND) would be faster, but onnxruntime's threads race in them.
    """

    def add(self, x: Tensor, beams: Tensor, arcs: Tensor, added: nn.Conv2d) -> Tensor:
        """See `GridLines`; each line is convolved once, and not each of its cells."""
        weight = added.weight[..., 0]
        depth = beams.shape[1]
        along = functional.conv1d(beams, weight[:, :depth], added.bias)[0].T
        across = functional.conv1d(arcs, weight[:, depth:])[0].T
        rows = along[self.beam[0]] + across[self.arc[0]]
        return x + rows.T.reshape(1, -1, *self.shape)
