"""A sonar picture by another open simulator, on the triangles of the same frame.

--peer DIR is a checkout of simple_sonar_simulator (github.com/bottad/simple_sonar_simulator), which
casts rays into a PLY mesh; --peer-python FILE the Python that has what its requirements.txt names.
Its picture is one clean one, without noise and without intensity of the surface, so it is set
beside our clean picture from the same depth map, cold.  It is run as its Readme says, in a copy.

Simulators that need a GPU with a window system (Stonefish, HoloOcean, Gazebo) cannot be run by a
command that starts and ends, so they are not compared.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml

from benchmarks.making.bench_pair import PICTURES, cold
from benchmarks.report import Cell, Options, Section, Table
from benchmarks.shared import Command, frame_words, in_own_process, run_command
from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.frame import Frame
from simnfnd.factory.render.cloud import back_project, surface_triangles
from simnfnd.factory.scenes import open_reader

PICTURES_A_RUN = 5
ELEVATIONS = 64
SKIPPED = (
    "Skipped: --peer DIR names no checkout of simple_sonar_simulator "
    "(https://github.com/bottad/simple_sonar_simulator)."
)


def measure(options: Options) -> Section:
    """A row for each, or a line that says why there is none."""
    if not options.peer:
        return Section(note=SKIPPED)
    checkout = Path(options.peer)
    if not (checkout / "run_simulation.py").exists():
        return Section(failed=f"{checkout}: no run_simulation.py; not simple_sonar_simulator?")
    config = compose_config([*frame_words(options.frame), *PICTURES])
    reader = open_reader(config.scenes)
    frame = reader.load(reader.discover().frames[0])
    python = options.peer_python or sys.executable
    count = options.amount(PICTURES_A_RUN, 1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "peer")
        shutil.copytree(checkout, folder, ignore=shutil.ignore_patterns(".git", "output", ".venv"))
        far_m = _write_mesh(folder / "scenes" / "frame.ply", frame)
        sonar = config.sonar
        one, many = (
            _run(folder, python, number, sonar.hfov_deg, sonar.vfov_deg, far_m)
            for number in (2, 2 + count)
        )
    theirs = max((many.cpu - one.cpu) / count, 1e-9)
    words = [*frame_words(options.frame), *PICTURES, "noise=none"]
    rows: list[tuple[Cell, ...]] = [("simple_sonar_simulator, a clean picture", 1.0, theirs)]
    for label, render in (("ours, embree", "embree"), ("ours, Cycles", "cycles")):
        if options.quick and render == "cycles":
            continue
        spent = in_own_process(cold, [*words, f"render={render}"], options.amount(5))
        rows.append((f"{label}, render to pair on disk", theirs / spent.cpu, spent.cpu))
    note = (
        f"512 beams, 512 range bins, {ELEVATIONS} rays a beam for theirs (ours: every pixel of the "
        "frame); loading the mesh is not counted."
    )
    table = Table(("picture", "times less CPU", "CPU s"), tuple(rows), note=note, bars="CPU s")
    return Section((table,))


def _run(
    folder: Path, python: str, pictures: int, hfov_deg: float, vfov_deg: float, far_m: float
) -> Command:
    pose = {"position": [0.0, 0.0, 0.0], "rotation_euler": [0.0, 0.0, 0.0]}
    files = {
        "bench_trajectory": {"poses": [pose, pose], "total_time": 1.0, "timesteps": pictures},
        "bench_sonar": {
            "v_fov": float(vfov_deg),
            "h_fov": float(hfov_deg),
            "max_range": far_m,
            "azimuth_bins": 512,
            "range_bins": 512,
            "elevation_bins": ELEVATIONS,
        },
        "bench_run": {
            "trajectory_file": "config/bench_trajectory.yaml",
            "sonar_config_file": "config/bench_sonar.yaml",
            "scene_file": "scenes/frame.ply",
            "output_folder": "output/",
            "name": "frame",
            "normalize": True,
            "incident_dependency": True,
            "smoothing_sigma": None,
        },
    }
    for name, values in files.items():
        (folder / "config" / f"{name}.yaml").write_text(yaml.safe_dump(values), encoding="utf-8")
    (folder / "output").mkdir(exist_ok=True)
    done = run_command([python, "run_simulation.py", "bench_run.yaml"], folder)
    if not any((folder / "output").rglob("*.png")):
        raise SystemExit(f"{folder}: the simulator made no picture")
    return done


def _write_mesh(path: Path, frame: Frame, edge_ratio: float = 0.1) -> float:
    """The frame's surface as PLY, x forward, y left, z up; returns its largest range, metres."""
    import open3d

    points_m = back_project(frame.depth_m, frame.intrinsics)
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(
            np.stack([points_m[..., 2], -points_m[..., 0], -points_m[..., 1]], axis=-1)
            .reshape(-1, 3)
            .astype(np.float64)
        ),
        open3d.utility.Vector3iVector(surface_triangles(frame.depth_m, edge_ratio)),
    )
    mesh.remove_unreferenced_vertices()
    path.parent.mkdir(exist_ok=True)
    open3d.io.write_triangle_mesh(path, mesh)
    return float(np.linalg.norm(points_m[frame.valid], axis=-1).max())
