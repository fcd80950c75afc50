"""Layers of a SonarNet as an exported graph computes them fastest on a CPU.

They compute what the layers of training compute, but for rounding: `exporting.onnx_graph` compares
both before it writes a graph.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

if TYPE_CHECKING:
    from .line_context import LineContext

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


class LineTable(NamedTuple):
    """Which cells lie on each line (beam or arc) of a feature map of `cells` cells.

    number: (cells,) int64 line of each cell.  chunks: (n, k) int64 cells of one line, as many as
    they are and then the number `cells`.  lines: (n,) int64 line of each chunk.  counts: (lines,)
    float32 insonified cells of each line.
    """

    number: Tensor
    chunks: Tensor
    lines: Tensor
    counts: Tensor

    def means(self, rows: Tensor) -> Tensor:
        """Means along each line.  rows: (cells + 1, C), of each cell, then zeros -> (lines, C)."""
        depth = rows.shape[1]
        count, length = self.chunks.shape
        of_chunks = rows[self.chunks.flatten()].reshape(count, length, depth).sum(1)
        index = self.lines[:, None].expand(-1, depth)
        total = torch.zeros(self.counts.shape[0], depth).scatter_add(0, index, of_chunks)
        return total / self.counts.clamp_min(1)[:, None]


class LineTables(NamedTuple):
    """The beams and arcs of one image.

    Sums of all cells by their numbers (ScatterElements) take eight times as long as those of chunks
    that are gathered; sums by rows (ScatterND) are quick, but onnxruntime's threads race in them.
    """

    beams: LineTable
    arcs: LineTable


def first_features(
    intro: nn.Conv2d,
    context: LineContext | None,
    image: Tensor,
    geometry: Tensor,
    tables: LineTables,
) -> Tensor:
    """What `intro` and `context` make of an image and its geometry, (1, C, h, w).

    image: (1, 1, H, W), or with the plane of averaged frames (1, 2, H, W).
    geometry: (h w, C), see `geometry_features`.
    """
    weight = _at_full_size(intro, 0)
    planes = [0, weight.shape[1] - 1][: image.shape[1]]
    x = functional.conv2d(image, weight[:, planes], intro.bias, stride=2, padding=2)
    height, width = x.shape[-2:]
    # A row a cell: what lies on a line is gathered by rows.
    rows = x.reshape(intro.out_channels, -1).T + geometry
    if context is not None:
        rows = rows + _along_lines(context, rows, tables)
    return rows.T.reshape(1, intro.out_channels, height, width)


def geometry_features(intro: nn.Conv2d, maps: Tensor) -> Tensor:
    """What `intro` makes of the maps of a geometry alone, without its bias, (h w, C).

    maps: (1, 3, H, W), the planes behind the image.
    """
    weight = _at_full_size(intro, 0)[:, 1 : 1 + maps.shape[1]]
    features = functional.conv2d(maps, weight, None, stride=2, padding=2)
    return features.reshape(intro.out_channels, -1).T


def _along_lines(context: LineContext, rows: Tensor, tables: LineTables) -> Tensor:
    """What `context` adds to each cell, (cells, C), as rows are.

    Means are taken before the 1x1 convolution, and each line is convolved once at the end.
    """
    depth = context.pooled.out_channels
    padded_rows = torch.cat([rows, torch.zeros(1, rows.shape[1])])
    added = context.added.weight[..., 0]

    def of_lines(table: LineTable, layers: nn.Module, weight: Tensor) -> Tensor:
        means = functional.linear(table.means(padded_rows), context.pooled.weight[..., 0, 0])
        bias = cast(Tensor, context.pooled.bias)
        means = means + bias * (table.counts > 0).float()[:, None]
        return functional.conv1d(layers(means.T[None]), weight)[0].T

    bias = cast(Tensor, context.added.bias)
    along = of_lines(tables.beams, context.beams, added[:, :depth]) + bias
    across = of_lines(tables.arcs, context.arcs, added[:, depth:])
    return along[tables.beams.number] + across[tables.arcs.number]


def shuffled(x: Tensor) -> Tensor:
    """`pixel_shuffle(x, 2)` in two moves, which onnxruntime copies in long runs."""
    depth = x.shape[1] // 4
    height, width = x.shape[-2:]
    columns = x.reshape(-1, 2, height * width).transpose(1, 2)
    rows = columns.reshape(-1, 2, height, 2 * width).transpose(1, 2)
    return rows.reshape(-1, depth, 2 * height, 2 * width)
