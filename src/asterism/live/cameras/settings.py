"""What can be set on a camera, as text or numbers, in; values in one unit each, and what the camera made of them, out."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from asterism.errors import AsterismError

SettingValue = float | bool | str
"""What a setting is, in the unit of its `SettingKind`: a number, whether it is on, or a word such as "auto"."""

_EXACT = 1e-3
"""Share of what was asked by which a camera's own value may differ and still be it: registers of cameras hold whole microseconds, of 4 ms a
fourth of this. Half of it calls a rate of 29.97 another one than 30; twice as much would hide that a webcam has only some exposures."""

_MOST = float(2**53)
"""Beyond it a number has no exact value as a float; no setting is half or double as large."""


@dataclass(frozen=True)
class SettingKind:
    """One of the settings that all cameras know by the same name.

    unit   of its number, "" for none
    scale  units that may be written, and how much of `unit` each is
    words  texts that it may be instead; None where any text is one
    about  what it is, for the help
    """

    unit: str
    about: str
    scale: Mapping[str, float]
    words: tuple[str, ...] | None = ()


SETTINGS: Mapping[str, SettingKind] = {
    "exposure": SettingKind("ms", "how long an image collects light", {"ms": 1.0, "us": 1e-3, "µs": 1e-3, "s": 1e3}, ("auto",)),
    "gain": SettingKind("dB", "by how much the signal is amplified; webcams have steps of their own instead", {"db": 1.0}, ("auto",)),
    "rate": SettingKind("Hz", "images per second", {"hz": 1.0, "fps": 1.0}),
    "trigger": SettingKind("", "what begins an image: off, or the input of the camera, as in line1", {}, None),
    "threshold": SettingKind("", "grey values that a marker exceeds, of 255", {}, ("auto",)),
    "size": SettingKind("", "width and height of the image in pixels, as in 640x480", {}, None),
    "format": SettingKind("", "of the pixels on their way, as in MJPG, YUYV or Mono8", {}, None),
    "white-balance": SettingKind("K", "temperature of the light", {"k": 1.0}, ("auto",)),
    "focus": SettingKind("", "in steps of the camera", {}, ("auto",)),
}
"""In the order in which they must be set: see `in_order`."""

_ORDER = ("format", "size", "trigger", "rate", "exposure", "gain")


def in_order(names: list[str]) -> list[str]:
    """Names of settings, those first on which others depend: the format decides which sizes there are, the rate how long one is."""
    return sorted(names, key=lambda name: _ORDER.index(name) if name in _ORDER else len(_ORDER))


def parse_setting(text: str) -> tuple[str, SettingValue]:
    """A setting as in "exposure=4ms", "gain=6" or "trigger=line1". Raises AsterismError where it is none.

    >>> parse_setting("exposure=4000us"), parse_setting("ReverseX=true")
    (('exposure', 4.0), ('ReverseX', True))
    """
    name, equals, value = text.partition("=")
    if not equals or not name.strip() or not value.strip():
        raise AsterismError(f"{text!r} is no setting; write NAME=VALUE, as in exposure=4ms.")
    return name.strip(), setting_value(name.strip(), value.strip())


def setting_value(name: str, value: object) -> SettingValue:
    """A value in the unit of its setting (ms, dB, Hz, K), from a number or a text with or without a unit.

    A name that begins with a capital letter is a feature of GenICam; its value is taken as it is. Raises AsterismError where the name is
    unknown or the value none of that setting.
    """
    kind = SETTINGS.get(name)
    if kind is None and not name[:1].isupper():
        raise AsterismError(f"there is no setting {name!r}; choose from {', '.join(SETTINGS)}, or a feature of GenICam by its name.")
    if isinstance(value, bool):
        if kind is not None:
            raise AsterismError(f"{name} = {str(value).lower()}: give {_wanted(name)}.")
        return value
    if isinstance(value, int | float):
        if not abs(value) <= _MOST or (kind is not None and (value < 0 or kind.words is None)):
            raise AsterismError(f"{name} = {value}: give {_wanted(name)}.")
        return float(value)
    if not isinstance(value, str):
        raise AsterismError(f"{name} = {value!r}: give {_wanted(name)}.")
    if kind is None:
        return {"true": True, "false": False}.get(value.casefold(), _number(value))
    if kind.words is None:
        return _word(name, value.strip())
    if value.casefold() in kind.words:
        return value.casefold()
    match = re.fullmatch(r"([0-9.]+(?:e[+-]?[0-9]+)?)\s*([a-zµ]*)", value.strip().casefold())
    number = None if match is None else _number(match[1])
    if match is None or not isinstance(number, float) or match[2] not in {"", *kind.scale}:
        raise AsterismError(f"{name} = {value}: give {_wanted(name)}.")
    return setting_value(name, round(number * kind.scale.get(match[2], 1.0), 9))


def size_of(value: SettingValue) -> tuple[int, int]:
    """The width and the height in px of a `size`. Raises AsterismError where it is none."""
    match = re.fullmatch(r"([0-9]{1,5})\s*[x×]\s*([0-9]{1,5})", str(value))
    if match is None or not int(match[1]) or not int(match[2]):
        raise AsterismError(f"size = {value}: write it as 640x480.")
    return int(match[1]), int(match[2])


def setting_text(name: str, value: SettingValue | None) -> str:
    """A value with its unit, as a person reads it."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value
    unit = SETTINGS[name].unit if name in SETTINGS else ""
    return f"{value:.6g} {unit}".strip()


def _word(name: str, value: str) -> str:
    if name == "size":
        return "{}x{}".format(*size_of(value))
    return value.casefold() if name == "trigger" else value


def _number(text: str) -> float | str:
    """A text as a number where it is a finite one."""
    try:
        number = float(text)
    except ValueError:
        return text
    return number if math.isfinite(number) else text


def _wanted(name: str) -> str:
    if name not in SETTINGS:
        return "a number, a text, true or false"
    kind = SETTINGS[name]
    if kind.words is None:
        return kind.about
    units = f" in {kind.unit}" if kind.unit else ""
    return f"a number from 0 on{units}" + "".join(f", or {word}" for word in kind.words)


@dataclass(frozen=True)
class SettingOutcome:
    """What became of a setting on one camera.

    camera   its name in the rig
    setting  the name of the setting
    asked    the value, in the unit of the setting
    has      what the camera says that it has now; None where it does not say
    problem  why it could not be set, "" where it could
    """

    camera: str
    setting: str
    asked: SettingValue
    has: SettingValue | None
    problem: str = ""

    @property
    def as_asked(self) -> bool:
        """Whether the camera has what was asked for."""
        if self.problem or self.has is None:
            return False
        if isinstance(self.asked, float) and isinstance(self.has, float):
            return math.isclose(self.asked, self.has, rel_tol=_EXACT, abs_tol=1e-6)
        return str(self.asked).casefold() == str(self.has).casefold()

    def __str__(self) -> str:
        asked = setting_text(self.setting, self.asked)
        if self.problem:
            return f"{self.camera}: {self.setting} is not set to {asked}: {self.problem}"
        if self.has is None:
            return f"{self.camera}: {self.setting}: asked {asked}; the camera does not say what it has."
        if self.as_asked:
            return f"{self.camera}: {self.setting} {asked}."
        return f"{self.camera}: {self.setting}: asked {asked}, has {setting_text(self.setting, self.has)}."
