"""Filters of the paper's related work, each written after what is public of it: not reproductions.

Their programs are not public, and of most not more than the abstract: what their authors report
cannot be checked against these.
"""

from __future__ import annotations

from ..base import Baseline
from .convolutional import convolutional
from .dtcwt_map import dtcwt_map
from .laplacian_pyramid import lpmsde
from .logarithm import recursive_least_squares
from .ridgelet import ridgelet
from .structural import structural

LITERATURE = (
    Baseline("dtcwt_map", dtcwt_map, {"strength": 1.0, "levels": 5},
             {"strength": (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 1000.0), "levels": (1, 2, 3, 5, 8)},
             "Isar, Moga and Isar 2009, from the papers, not reproduced"),
    Baseline("ridgelet", ridgelet, {"strength": 1.0, "block_px": 11},
             {"strength": (0.5, 1.0, 1.4, 2.0, 4.0, 1000.0), "block_px": (7, 11, 17, 31)},
             "Shang et al. 2008, after the abstract, not reproduced"),
    Baseline("convolutional", convolutional, {"strength": 0.1, "iterations": 20},
             {"strength": (0.01, 0.03, 0.06, 0.1, 0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 1000.0)},
             "Vishwakarma 2022, after the abstract, not reproduced"),
    Baseline("structural", structural, {"strength": 1.0, "patches": 64},
             {"strength": (0.35, 0.7, 1.0, 1.4, 2.0, 4.0, 1000.0), "patches": (16, 64, 256)},
             "Jin et al. 2019, after the abstract, not reproduced"),
    Baseline("lpmsde", lpmsde, {"strength": 1.0, "levels": 3},
             {"strength": (0.25, 1.0, 4.0, 16.0, 64.0, 256.0, 1000.0), "levels": (1, 2, 3, 4, 5)},
             "IEEE Access 2023, 3335372, after the abstract, not reproduced"),
    Baseline("recursive", recursive_least_squares, {"memory": 1.0},
             {"memory": (0.5, 0.7, 0.85, 0.95, 1.0)},
             "least squares over several looks at a frame, after the abstract, not reproduced",
             looks=True),
)  # fmt: skip
