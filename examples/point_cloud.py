"""A point cloud of what a sonar hears: one point for each echo, as PLY.

simnfnd make experiment=physical render=embree scenes.locations=1 dataset.dir=outputs/cloud \
    dataset.layers=[range,azimuth,elevation,intensity_db,segmentation] dataset.columns=[pose]
python examples/point_cloud.py outputs/cloud cloud.ply [SAMPLE]

Points are in metres, in the axes of the recording's world where its poses are known, else in those
of the sonar (x ahead, y left, z up); with strength (dB re 1 uPa), class and instance.  The sonar
cannot tell elevations apart: they are known here because the scene is.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

NEEDED = ("range", "azimuth", "elevation", "intensity_db", "segmentation", "instance")


def point_cloud(shard: h5py.File, number: int) -> np.ndarray:
    """(N,) points with fields x, y, z, strength, class, instance."""
    image = {name: shard[name][number].ravel() for name in NEEDED}
    heard = np.isfinite(image["range"]) & np.isfinite(image["intensity_db"])
    r, a, e = (image[name][heard].astype(float) for name in NEEDED[:3])
    points = np.stack(
        [r * np.cos(e) * np.cos(a), -r * np.cos(e) * np.sin(a), r * np.sin(e)], axis=-1
    )
    row = shard["meta"][number]
    if "sonar.qw" in row.dtype.names and np.isfinite(row["sonar.qw"]):
        x, y, z, w = (row[f"sonar.q{part}"] for part in "xyzw")
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        points = points @ (np.eye(3) + 2 * w * cross + 2 * cross @ cross).T
        points += [row[f"sonar.{axis}_m"] for axis in "xyz"]
    kinds = [(axis, "<f4") for axis in "xyz"]
    points_out = np.empty(
        len(r), [*kinds, ("strength", "<f4"), ("class", "u1"), ("instance", "<u2")]
    )
    points_out["x"], points_out["y"], points_out["z"] = points.T
    points_out["strength"] = image["intensity_db"][heard]
    points_out["class"], points_out["instance"] = (image[name][heard] for name in NEEDED[4:])
    return points_out


def write_ply(path: Path, points: np.ndarray) -> None:
    """A binary PLY, which MeshLab, CloudCompare and Open3D read."""
    words = {"<f4": "float", "|u1": "uchar", "<u2": "ushort"}
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    head += [f"property {words[points.dtype[n].str]} {n}" for n in points.dtype.names]
    path.write_bytes("\n".join([*head, "end_header\n"]).encode() + points.tobytes())


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    folder = Path(sys.argv[1])
    target = Path(sys.argv[2])
    shards = sorted(folder.glob("*/shard-*.h5"))
    if not shards:
        sys.exit(f"{folder}: no shards below it; give the folder of a dataset")
    with h5py.File(shards[0]) as shard:
        missing = [name for name in NEEDED if name not in shard]
        if missing:
            sys.exit(f"{folder} has no layers {', '.join(missing)}; make it as the first lines say")
        cloud = point_cloud(shard, int(sys.argv[3]) if len(sys.argv) > 3 else 0)
    write_ply(target, cloud)
    print(f"{target}: {len(cloud)} points, {len(np.unique(cloud['instance'])) - 1} objects")
