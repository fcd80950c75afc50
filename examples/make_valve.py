"""A gate valve out of Open3D's primitives, to stand for a mesh of your own.

python examples/make_valve.py valve.glb

Metres; the spindle points along y, which .glb files call up.
"""

import sys

import numpy as np
import open3d

if len(sys.argv) < 2:
    sys.exit(__doc__)

BODY = (0.25, 0.28, 0.30)
WHEEL = (0.55, 0.08, 0.05)
TURNS = {"x": (0, np.pi / 2, 0), "y": (np.pi / 2, 0, 0), "z": (0, 0, 0)}
make = open3d.geometry.TriangleMesh
valve = make()


def add(part, centre, axis="z", colour=BODY):
    """Put a part, round about z, at its place."""
    global valve
    part.rotate(open3d.geometry.get_rotation_matrix_from_xyz(TURNS[axis]), (0, 0, 0))
    valve += part.translate(centre).paint_uniform_color(colour)


add(make.create_cylinder(0.09, 0.62, 40), (0, 0.12, 0), "x")  # the pipe
for x in (-0.31, -0.20, 0.20, 0.31):  # two pairs of flanges
    add(make.create_cylinder(0.15, 0.035, 40), (x, 0.15, 0), "x")
add(make.create_sphere(0.145, 24), (0, 0.14, 0))
add(make.create_cylinder(0.075, 0.16, 40), (0, 0.32, 0), "y")  # the bonnet
add(make.create_cylinder(0.02, 0.28, 40), (0, 0.46, 0), "y")  # the spindle
add(make.create_torus(0.15, 0.018, 48, 12), (0, 0.56, 0), "y", WHEEL)
for axis in "xz":  # its spokes
    add(make.create_cylinder(0.012, 0.30, 40), (0, 0.56, 0), axis, WHEEL)
valve.compute_vertex_normals()
if not open3d.io.write_triangle_mesh(sys.argv[1], valve):
    sys.exit(f"{sys.argv[1]}: not written; give a name that ends in .glb, .ply or .obj")
print(f"{sys.argv[1]}: {len(valve.triangles)} faces, {valve.get_max_bound()[1]:.2f} m high")
