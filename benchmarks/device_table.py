"""The table of docs/presets.md: python -m benchmarks.device_table."""

from __future__ import annotations

from pathlib import Path

from simnfnd.factory.cli.compose import compose_config
from simnfnd.factory.config import FactoryConfig

ROOT = Path(__file__).parents[1]


def rows() -> list[str]:
    """A line of Markdown for each device."""
    names = sorted(path.stem for path in (ROOT / "conf" / "sonar").glob("*.yaml"))
    return [_row(name, compose_config([f"sonar={name}"])) for name in names]


def _row(name: str, config: FactoryConfig) -> str:
    sonar = config.sonar
    absorption = config.water.absorption_db_per_m(sonar.frequency_khz)
    fields = (
        f"`{name}`", f"{sonar.frequency_khz:g}", f"{sonar.hfov_deg:g} x {sonar.vfov_deg:g}",
        f"{sonar.beams}", f"{sonar.range.min_m:g}-{sonar.range.max_m:g}",
        f"{sonar.array.beamwidth_deg}", f"{sonar.array.bandwidth_khz:g}", f"{absorption:.3f}",
    )  # fmt: skip
    return f"| {' | '.join(fields)} |"


if __name__ == "__main__":
    print("\n".join(rows()))
