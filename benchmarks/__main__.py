"""`python -m benchmarks [NAME...]`: run every bench_*.py here and write one report.

A benchmark is a module `bench_<name>.py` with a `measure(options)` that returns a
`benchmarks.shared.Section`.  Each runs in a process of its own, so that no import, cache, memory
peak or thread setting of one reaches the next.  A failure is named and gives exit code 1.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import metadata
from pathlib import Path

from benchmarks.shared import Options, Section, Table, frame_words
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.scenes import open_reader

HERE = Path(__file__).resolve().parent
LIBRARIES = ("numpy", "bpy", "open3d-cpu", "numba", "h5py", "torch", "onnxruntime")

# Imported by name, not run as __main__: its functions can then be sent to worker processes.
_CHILD = """
import dataclasses, importlib, json, sys
from benchmarks.shared import Options
module, options, target = sys.argv[1:]
section = importlib.import_module(module).measure(Options(**json.loads(options)))
open(target, "w").write(json.dumps(dataclasses.asdict(section)))
"""


def discover(folder: Path = HERE) -> dict[str, str]:
    """Name -> module, sorted: `command` for bench_command.py."""
    modules = {}
    for path in folder.rglob("bench_*.py"):
        parts = path.relative_to(folder.parent).with_suffix("").parts
        modules[path.stem.removeprefix("bench_")] = ".".join(parts)
    return dict(sorted(modules.items()))


def machine() -> str:
    """What the figures were measured on, as one line (nothing that names the host)."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    cpu = next(
        (line.partition(":")[2].strip() for line in lines if "model name" in line),
        platform.machine(),
    )
    versions = []
    for name in LIBRARIES:
        try:
            versions.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            continue
    return f"{cpu}, {os.cpu_count()} cores; Python {platform.python_version()}, " + ", ".join(
        versions
    )


def run(name: str, options: Options) -> Section:
    """Run one benchmark in a fresh interpreter."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "section.json"
        words = [discover()[name], json.dumps(asdict(options)), str(target)]
        code = subprocess.run([sys.executable, "-c", _CHILD, *words], check=False).returncode
        if code or not target.exists():
            return Section(failed=f"ended with exit code {code}")
        section = json.loads(target.read_text(encoding="utf-8"))
    return Section(tuple(Table(**table) for table in section["tables"]), section["failed"])


def write_report(
    folder: Path, stem: str, sections: Mapping[str, Section], options: Options
) -> list[Path]:
    """Write STEM.md and STEM.json; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    warning = "**--quick: the amounts are too small for the figures to mean anything.**\n\n"
    head = f"# Benchmarks\n\n{warning if options.quick else ''}{machine()}\n"
    paths = [folder / f"{stem}.md", folder / f"{stem}.json"]
    body = [section.markdown(name) for name, section in sections.items()]
    paths[0].write_text("\n".join([head, *body]), encoding="utf-8")
    document = {
        "machine": machine(),
        "quick": options.quick,
        "sections": {name: asdict(section) for name, section in sections.items()},
    }
    paths[1].write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return paths


def check_frame_folder(root: str) -> None:
    """Find a frame of FLSea VI at `root`, unless that is empty.  Raises FactoryError if none is."""
    if root:
        open_reader(compose_config(frame_words(root)).scenes).discover()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the named benchmarks, or all.  Returns 0, 1 when one failed, 2 for bad words."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Run benchmarks.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="which ones (default: all)")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="smallest amounts, to see that it runs; the figures mean nothing",
    )
    parser.add_argument(
        "--frame", default="", metavar="DIR", help="FLSea VI folder; its first frame is measured"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("outputs/benchmarks"), metavar="DIR", help="for the report"
    )
    options = parser.parse_args(arguments)
    known = discover()
    if options.list:
        print("\n".join(known))
        return 0
    unknown = [name for name in options.names if name not in known]
    if unknown:
        print(
            f"error: no benchmark {', '.join(unknown)}; there are: {', '.join(known)}",
            file=sys.stderr,
        )
        return 2
    try:
        check_frame_folder(options.frame)
    except FactoryError as error:
        print(f"error: --frame: {error}", file=sys.stderr)
        return 2
    bench_options = Options(options.quick, options.frame)
    print(f"# Benchmarks\n\n{machine()}", flush=True)
    sections: dict[str, Section] = {}
    for name in options.names or known:
        sections[name] = run(name, bench_options)
        print(f"\n{sections[name].markdown(name)}", flush=True)
    stem = ("quick-" if options.quick else "") + ("-".join(options.names) or "report")
    for path in write_report(options.out, stem, sections, bench_options):
        print(f"report: {path}")
    failed = [name for name, section in sections.items() if section.failed]
    if failed:
        print(f"error: failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
