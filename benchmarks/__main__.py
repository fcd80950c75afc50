"""`python -m benchmarks [NAME...]`: run every bench_*.py here and print one Markdown report.

A benchmark is a module `bench_<name>.py` with a `main()` that prints a Markdown table.  Each runs
in a process of its own, so that no import, cache, memory peak or thread setting of one reaches the
next.  One that fails is named, and the exit code says so.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).resolve().parent
PREFIX = "bench_"
LIBRARIES = ("numpy", "bpy", "open3d-cpu", "numba", "h5py", "torch")


def discover(folder: Path = HERE) -> list[str]:
    """Names of the benchmarks in `folder`, sorted: `render` for bench_render.py."""
    return sorted(path.stem.removeprefix(PREFIX) for path in folder.glob(f"{PREFIX}*.py"))


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


def run(name: str, package: str = "benchmarks") -> int:
    """Run one benchmark in a fresh interpreter and return its exit code."""
    module = f"{package}.{PREFIX}{name}"
    # Imported by name, not run as __main__: its functions can then be sent to worker processes.
    code = f"import importlib; importlib.import_module({module!r}).main()"
    return subprocess.run([sys.executable, "-c", code], check=False).returncode


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the named benchmarks, or all.  Returns 0, 1 when one failed, 2 for a bad name."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Run benchmarks.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="which ones (default: all)")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    options = parser.parse_args(arguments)
    known = discover()
    if options.list:
        print("\n".join(known))
        return 0
    unknown = [name for name in options.names if name not in known]
    if unknown or not known:
        what = f"no benchmark {', '.join(unknown)}" if unknown else "no benchmarks"
        print(f"error: {what}; there are: {', '.join(known) or 'none'}", file=sys.stderr)
        return 2
    print(f"# Benchmarks\n\n{machine()}", flush=True)
    failed = []
    for name in options.names or known:
        print(f"\n## {name}\n", flush=True)
        start = time.perf_counter()
        if run(name):
            failed.append(name)
        print(f"\n({time.perf_counter() - start:.1f} s)", flush=True)
    if failed:
        print(f"error: failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
