"""The table of docs/presets.md: python -m benchmarks.device_table."""

from __future__ import annotations

from pathlib import Path

from simnfnd.factory.simulation.config.compose import compose_config


def row(name: str) -> str:
    """A line of Markdown for a device."""
    config = compose_config([f"sonar={name}"])
    sonar = config.sonar
    absorption = config.water.absorption_db_per_m(config.sonar.frequency_khz)
    fields = (
        f"`{name}`", f"{sonar.frequency_khz:g}", f"{sonar.hfov_deg:g} x {sonar.vfov_deg:g}",
        f"{sonar.beams}", f"{sonar.range.min_m:g}-{sonar.range.max_m:g}",
        f"{sonar.array.beamwidth_deg}", f"{sonar.array.bandwidth_khz:g}", f"{absorption:.3f}",
    )  # fmt: skip
    return f"| {' | '.join(fields)} |"


if __name__ == "__main__":
    folder = Path(__file__).parents[1] / "conf" / "sonar"
    print("\n".join(row(name) for name in sorted(path.stem for path in folder.glob("*.yaml"))))
