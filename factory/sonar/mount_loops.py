"""How surfaces face the camera and a sonar beside it, in compiled loops.

`surface.mount_weight` says what it is for; tests hold it against the same steps in numpy, to the
bit.  Importing this module loads numba.
"""

from __future__ import annotations

import numpy as np

from simnfnd.factory.compiled import compiled
from simnfnd.factory.render.cloud.joints import READ, Bits, Doubles, Floats
from simnfnd.factory.render.shading import unit_normal

_LEAST_M2 = np.float32(1e-12)


@compiled(
    f"void({READ}, uint8[:, ::1], float64[::1], float64[::1], float32[::1],"
    "float32[:, ::1], float32[:, ::1], float32[:, ::1])"
)
def facing(
    depth_m: Floats,
    bits: Bits,
    across: Doubles,
    down: Doubles,
    sonar_m: Floats,
    to_camera: Floats,
    to_sonar: Floats,
    nearer: Floats,
) -> None:
    """Fill the cosines of incidence from camera and sonar, and (range to camera / to sonar)^2.

    depth_m, and what is filled: (H, W).  bits: `joints` of the depth.  across, down: direction of
    each column and row, as depth multiplies it.  sonar_m: (3,) position in camera axes, metres.
    """
    height, width = depth_m.shape
    for row in range(height):
        for column in range(width):
            z = depth_m[row, column]
            x, y = np.float32(across[column] * z), np.float32(down[row] * z)
            nx, ny, nz = unit_normal(depth_m, bits, row, column, across, down)
            camera_m2 = max(x * x + y * y + z * z, _LEAST_M2)
            to_camera[row, column] = -(nx * x + ny * y + nz * z) / np.sqrt(camera_m2)
            tx, ty, tz = sonar_m[0] - x, sonar_m[1] - y, sonar_m[2] - z
            sonar_m2 = max(tx * tx + ty * ty + tz * tz, _LEAST_M2)
            to_sonar[row, column] = (nx * tx + ny * ty + nz * tz) / np.sqrt(sonar_m2)
            nearer[row, column] = camera_m2 / sonar_m2
