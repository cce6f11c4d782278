"""The nodes of a machine vision camera in; its settings by the names that all cameras have, out."""

from __future__ import annotations

import math
from typing import Any

from asterism.errors import AsterismError
from asterism.live.cameras.settings import SettingValue, size_of

_NUMBERS: dict[str, tuple[tuple[str, float], ...]] = {
    "exposure": (("ExposureTime", 1e-3), ("ExposureTimeAbs", 1e-3)),
    "gain": (("Gain", 1.0), ("GainAbs", 1.0), ("GainRaw", 1.0)),
    "rate": (("AcquisitionFrameRate", 1.0), ("AcquisitionFrameRateAbs", 1.0)),
}
"""Nodes of a number, the standard's first and older ones after it, and what one of the node's units is in ours: its exposures are in µs."""
_AUTOMATIC = {"exposure": "ExposureAuto", "gain": "GainAuto"}
_RESULTING = ("ResultingFrameRate", "AcquisitionResultingFrameRate", "ResultingFrameRateAbs")
_TEMPERATURES = ("DeviceTemperature", "DeviceTemperatureRaw")


class Features:
    """Settings of a GenICam camera by its node map (Standard Features Naming Convention), values rounded as its nodes round them.

    Any other feature has its own name, as ReverseX or GammaEnable.
    """

    def __init__(self, nodes: Any) -> None:
        from genicam import genapi

        self._nodes, self._failed = nodes, genapi.GenericException

    def names(self) -> tuple[str, ...]:
        """Those of all cameras that this one has."""
        found = [name for name, nodes in _NUMBERS.items() if any(self.has(node) for node, _ in nodes)]
        for name, node in (("trigger", "TriggerMode"), ("size", "Width"), ("format", "PixelFormat")):
            if self.has(node):
                found.append(name)
        return tuple(found)

    def has(self, node: str) -> bool:
        """Whether the camera has a node of this name that can be read or written now."""
        found = self._node(node)
        return found is not None

    def _node(self, name: str) -> Any:
        from genicam import genapi

        try:
            node = self._nodes.get_node(name)
            there = node is not None and genapi.EAccessMode(node.get_access_mode()) not in (genapi.EAccessMode.NI, genapi.EAccessMode.NA)
        except (self._failed, AttributeError, ValueError):
            return None
        return node if there else None

    def value(self, node: str) -> SettingValue | None:
        """What a node has; None where there is none, or it cannot be read."""
        found = self._node(node)
        try:
            value = None if found is None else found.value
        except (self._failed, AttributeError):
            return None
        if isinstance(value, bool | str) or value is None:
            return value
        return float(value) if isinstance(value, int | float) and math.isfinite(value) else None

    def get(self, name: str) -> SettingValue | None:
        """What a setting is, in the unit of `SETTINGS`."""
        if name in _NUMBERS:
            if name in _AUTOMATIC and self.value(_AUTOMATIC[name]) in ("Continuous", "Once"):
                return "auto"
            node, scale = self._number_node(name)
            value = self.value(node)
            return value * scale if isinstance(value, float) else None
        if name == "trigger":
            source = self.value("TriggerSource")
            return "off" if self.value("TriggerMode") != "On" else str(source).casefold() if source else "on"
        if name == "size":
            width, height = self.value("Width"), self.value("Height")
            return f"{width:.0f}x{height:.0f}" if isinstance(width, float) and isinstance(height, float) else None
        return self.value("PixelFormat" if name == "format" else name)

    def set(self, name: str, value: SettingValue) -> None:
        """Set it, to the nearest value that the camera can have. Raises AsterismError where it cannot."""
        if name in _NUMBERS:
            self._set_number(name, value)
        elif name == "trigger":
            self._set_trigger(str(value))
        elif name == "size":
            for node, pixels in zip(("Width", "Height"), size_of(value), strict=True):
                self._write(node, float(pixels))
        else:
            self._write("PixelFormat" if name == "format" else name, value)

    @property
    def temperature(self) -> float:
        """Degrees Celsius, NaN where it does not say."""
        found = [value for value in map(self.value, _TEMPERATURES) if isinstance(value, float)]
        return found[0] if found else math.nan

    @property
    def rate(self) -> float:
        """Images per second that come of all that is set, NaN where it does not say."""
        found = [value for value in map(self.value, _RESULTING) if isinstance(value, float)]
        asked = self.get("rate")
        return found[0] if found else asked if isinstance(asked, float) else math.nan

    def _number_node(self, name: str) -> tuple[str, float]:
        return next((pair for pair in _NUMBERS[name] if self.has(pair[0])), _NUMBERS[name][0])

    def _set_number(self, name: str, value: SettingValue) -> None:
        automatic = _AUTOMATIC.get(name)
        if value == "auto":
            if automatic is None or not self.has(automatic):
                raise AsterismError("it cannot be automatic in this camera; give a number.")
            self._write(automatic, "Continuous")
            return
        # A number is taken only where the camera does not choose it itself.
        if automatic is not None and self.has(automatic):
            self._write(automatic, "Off")
        if name == "rate" and self.has("AcquisitionFrameRateEnable"):
            self._write("AcquisitionFrameRateEnable", True)
        node, scale = self._number_node(name)
        self._write(node, float(value) / scale)

    def _set_trigger(self, value: str) -> None:
        if self.has("TriggerSelector"):
            # Of the triggers that a camera has, the one that begins an image.
            self._write("TriggerSelector", "FrameStart")
        if value not in ("off", "on"):
            self._write("TriggerSource", value)
        self._write("TriggerMode", "Off" if value == "off" else "On")

    def _write(self, name: str, value: SettingValue) -> None:
        node = self._node(name)
        if node is None:
            raise AsterismError(f"it has no feature {name} now.")
        try:
            if hasattr(node, "symbolics"):
                symbols = {str(symbol).casefold(): str(symbol) for symbol in node.symbolics}
                if str(value).casefold() not in symbols:
                    raise AsterismError(f"{name} cannot be {value}; choose from {', '.join(symbols.values())}.")
                node.value = symbols[str(value).casefold()]
            elif isinstance(value, float) and hasattr(node, "min"):
                node.value = _within(value, node)
            else:
                node.value = value
        except self._failed as problem:
            why = str(problem).partition(" : ")[0].strip(" .")
            raise AsterismError(
                f"the camera does not take it ({why}); it may be fixed while another setting is automatic, or while images run."
            ) from problem
        except TypeError:
            raise AsterismError(f"{name} cannot be {value}.") from None


def _within(value: float, node: Any) -> float | int:
    """The value nearest to one that was asked for which a node can have."""
    low, high = node.min, node.max
    value = min(max(value, low), high)
    if not isinstance(low, int):
        return value
    step = max(1, int(node.inc))
    return int(low + min(round((value - low) / step), (high - low) // step) * step)
