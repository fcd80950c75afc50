"""`python -m benchmarks [NAME...]`: run every bench_*.py in these rooms and write one report.

A benchmark is a module `bench_<name>.py`, in any of the rooms, with a `measure(options)` that
returns a `benchmarks.report.Section`.  Each runs in a process of its own, so that no import, cache,
memory peak or thread setting of one reaches the next.  One that fails is named, and the exit code
says so.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from importlib import metadata
from pathlib import Path

from benchmarks.picture import draw
from benchmarks.report import Options, Section, from_json, to_json

HERE = Path(__file__).resolve().parent
PREFIX = "bench_"
LIBRARIES = ("numpy", "bpy", "open3d-cpu", "numba", "h5py", "torch")

# Imported by name, not run as __main__: its functions can then be sent to worker processes.
_CHILD = """
import importlib, json, sys
from benchmarks.report import Options, to_json
module, options, target = sys.argv[1:]
section = importlib.import_module(module).measure(Options(**json.loads(options)))
open(target, "w").write(json.dumps(to_json(section)))
"""


def discover(package: Path = HERE) -> dict[str, str]:
    """Name -> module, sorted by names: `render` for making/bench_render.py."""
    found = {}
    for path in package.rglob(f"{PREFIX}*.py"):
        parts = path.relative_to(package.parent).with_suffix("").parts
        found[path.stem.removeprefix(PREFIX)] = ".".join(parts)
    return dict(sorted(found.items()))


def machine() -> str:
    """What the figures were measured on, as one Markdown line (nothing that names the host)."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = info.read_text(encoding="utf-8").splitlines()
        cpu = next((line.partition(":")[2].strip() for line in lines if "model name" in line), cpu)
    versions = [f"{name} {found}" for name in LIBRARIES if (found := _version(name))]
    return f"{cpu}, {os.cpu_count()} cores; Python {platform.python_version()}, " + ", ".join(
        versions
    )


def _version(distribution: str) -> str | None:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return None


def run(name: str, options: Options) -> Section:
    """Run one benchmark in a fresh interpreter."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "section.json"
        words = [discover()[name], json.dumps(asdict(options)), str(target)]
        code = subprocess.run([sys.executable, "-c", _CHILD, *words], check=False).returncode
        if code or not target.exists():
            section = Section(failed=f"ended with exit code {code}")
        else:
            section = from_json(json.loads(target.read_text(encoding="utf-8")))
    return replace(section, seconds=time.perf_counter() - start)


def write_report(
    folder: Path, stem: str, sections: Mapping[str, Section], options: Options
) -> list[Path]:
    """Write STEM.md, STEM.json and (where there is something to see) STEM.png; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    load = f"load of the machine at the end: {os.getloadavg()[0]:.1f}"
    warning = "**--quick: the amounts are too small for the figures to mean anything.**\n\n"
    head = f"# Benchmarks\n\n{warning if options.quick else ''}{machine()}; {load}\n"
    paths = [folder / f"{stem}.md", folder / f"{stem}.json"]
    picture = folder / f"{stem}.png"
    picture.unlink(missing_ok=True)
    drawn = draw(sections, picture)
    body = [section.markdown(name) for name, section in sections.items()]
    link = f"\n![ratios and times]({picture.name})\n" if drawn else ""
    paths[0].write_text("\n".join([head + link, *body]), encoding="utf-8")
    document = {
        "machine": machine(),
        "options": {"quick": options.quick, "frame": bool(options.frame)},
        "sections": {name: to_json(section) for name, section in sections.items()},
    }
    paths[1].write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return [*paths, picture] if drawn else paths


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the named benchmarks, or all.  Returns 0, 1 when one failed, 2 for a bad name."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Run benchmarks.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="which ones (default: all)")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="smallest amounts: does it run? The figures mean nothing",
    )
    parser.add_argument(
        "--frame", default="", metavar="DIR", help="FLSea VI whose first frame is measured, too"
    )
    parser.add_argument(
        "--peer",
        default="",
        metavar="DIR",
        help="checkout of simple_sonar_simulator to compare with",
    )
    parser.add_argument(
        "--peer-python", default="", metavar="FILE", help="the Python that has what it needs"
    )
    parser.add_argument(
        "--shards", type=int, default=Options.shards, metavar="N", help="that `streams` reads"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("outputs/benchmarks"), metavar="DIR", help="for the report"
    )
    given = parser.parse_args(arguments)
    known = discover()
    if given.list:
        print("\n".join(known))
        return 0
    unknown = [name for name in given.names if name not in known]
    if unknown or not known:
        what = f"no benchmark {', '.join(unknown)}" if unknown else "no benchmarks"
        print(f"error: {what}; there are: {', '.join(known) or 'none'}", file=sys.stderr)
        return 2
    options = Options(
        given.quick, given.frame, given.peer, given.peer_python, max(20, given.shards)
    )
    for key, path in (("--frame", given.frame), ("--peer", given.peer)):
        if path and not Path(path).is_dir():
            print(f"error: {key} {path}: no such folder", file=sys.stderr)
            return 2
    print(f"# Benchmarks\n\n{machine()}", flush=True)
    sections: dict[str, Section] = {}
    for name in given.names or known:
        sections[name] = run(name, options)
        print(f"\n{sections[name].markdown(name)}", flush=True)
    stem = ("quick-" if given.quick else "") + ("-".join(given.names) or "report")
    for path in write_report(given.out, stem, sections, options):
        print(f"report: {path}")
    failed = [name for name, section in sections.items() if section.failed]
    if failed:
        print(f"error: failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
