"""Meshes of two propellers, a soft pipeline and a cylinder, as the NKSID dataset has them.

python examples/make_targets.py targets

Metres, z points up; each lies on the ground as it would after sinking.
"""

import sys
from pathlib import Path

import numpy as np
import open3d

make = open3d.geometry.TriangleMesh
folder = Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)


def turned(mesh, x=0.0, y=0.0, z=0.0):
    """The mesh turned about its origin, radians."""
    return mesh.rotate(open3d.geometry.get_rotation_matrix_from_xyz((x, y, z)), (0, 0, 0))


def propeller(diameter_m):
    """A hub with four twisted blades, leaning on its edge."""
    mesh = make.create_cylinder(0.1 * diameter_m, 0.3 * diameter_m, 24)
    for number in range(4):
        blade = make.create_box(0.38 * diameter_m, 0.28 * diameter_m, 0.02 * diameter_m)
        blade = turned(blade.translate((0.08 * diameter_m, -0.14 * diameter_m, 0)), x=0.5)
        mesh += turned(blade, z=number * np.pi / 2)
    return turned(mesh, y=1.2)


def pipeline(length_m, radius_m):
    """A hose in gentle curves."""
    x = np.linspace(-length_m / 2, length_m / 2, 40)
    y = 0.35 * np.sin(2.2 * x) + 0.15 * np.sin(5 * x)
    mesh = make()
    for start, end in zip(np.c_[x, y][:-1], np.c_[x, y][1:], strict=True):
        step = end - start
        part = make.create_cylinder(radius_m, 1.1 * float(np.hypot(*step)), 16)
        part = turned(turned(part, y=np.pi / 2), z=float(np.arctan2(step[1], step[0])))
        mesh += part.translate((*(start + end) / 2, 0.0))
    return mesh


targets = {
    "big_propeller": propeller(1.0),
    "small_propeller": propeller(0.5),
    "soft_pipeline": pipeline(3.0, 0.08),
    "cylinder": turned(make.create_cylinder(0.25, 1.0, 32), y=np.pi / 2),
}
for name, mesh in targets.items():
    mesh.translate((0, 0, -mesh.get_min_bound()[2]))
    mesh.compute_vertex_normals()
    open3d.io.write_triangle_mesh(str(folder / f"{name}.ply"), mesh)
    size_m = mesh.get_max_bound() - mesh.get_min_bound()
    print(f"{folder / name}.ply: " + " x ".join(f"{side:.2f}" for side in size_m) + " m")
