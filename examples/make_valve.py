"""A gate valve out of Open3D's primitives, to stand for a mesh of your own.

python examples/make_valve.py valve.glb

Metres; the spindle points along y, which .glb files call up.
"""

import sys

import numpy as np
import open3d

BODY, WHEEL = (0.25, 0.28, 0.30), (0.55, 0.08, 0.05)


def cylinder(radius, height, centre, axis, colour):
    """A cylinder along x, y or z."""
    made = open3d.geometry.TriangleMesh.create_cylinder(radius, height, resolution=40)
    half = np.pi / 2
    turn = {"x": (0, half, 0), "y": (half, 0, 0), "z": (0, 0, 0)}[axis]
    made.rotate(open3d.geometry.get_rotation_matrix_from_xyz(turn), (0, 0, 0))
    return made.translate(centre).paint_uniform_color(colour)


parts = [cylinder(0.09, 0.62, (0, 0.12, 0), "x", BODY)]  # the pipe
for x in (-0.31, -0.20, 0.20, 0.31):  # two pairs of flanges
    parts.append(cylinder(0.15, 0.035, (x, 0.15, 0), "x", BODY))
body = open3d.geometry.TriangleMesh.create_sphere(0.145, resolution=24)
parts.append(body.translate((0, 0.14, 0)).paint_uniform_color(BODY))
parts.append(cylinder(0.075, 0.16, (0, 0.32, 0), "y", BODY))  # the bonnet
parts.append(cylinder(0.02, 0.28, (0, 0.46, 0), "y", BODY))  # the spindle
wheel = open3d.geometry.TriangleMesh.create_torus(0.15, 0.018, 48, 12)
wheel.rotate(open3d.geometry.get_rotation_matrix_from_xyz((np.pi / 2, 0, 0)), (0, 0, 0))
parts.append(wheel.translate((0, 0.56, 0)).paint_uniform_color(WHEEL))
for axis in "xz":  # its spokes
    parts.append(cylinder(0.012, 0.30, (0, 0.56, 0), axis, WHEEL))

valve = parts[0]
for part in parts[1:]:
    valve += part
valve.compute_vertex_normals()
open3d.io.write_triangle_mesh(sys.argv[1], valve)
print(f"{sys.argv[1]}: {len(valve.triangles)} faces, {valve.get_max_bound()[1]:.2f} m high")
