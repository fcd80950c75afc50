"""The name of `factory.common.ros_types` in version 0.4, which scripts of users import."""

from __future__ import annotations

from .common.ros_types import SONAR, typestore

__all__ = ["SONAR", "typestore"]
