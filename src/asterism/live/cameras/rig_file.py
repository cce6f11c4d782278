"""A file of the cameras of a rig in, and what is to be set on them; the same, with what the cameras said, out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically
from asterism.files.toml import read_toml, toml_line
from asterism.live.cameras.opening import CameraSpec
from asterism.live.cameras.played import path_of
from asterism.live.cameras.settings import SETTINGS, SettingValue, setting_value

_MOST = 64
"""Cameras of a file: more than twice as many as the largest halls have; half and double do as well."""


def load_cameras(path: Path) -> list[CameraSpec]:
    """The cameras of a TOML file: a table `[[camera]]` each with its name, its address and its settings, and `[all]` with those of all.

    Paths are relative to the file. What cameras said of themselves (`has`) is passed over.
    Raises AsterismError, naming the camera, where something is missing, unknown or there twice.
    """
    tables = read_toml(path)
    other = sorted(set(tables) - {"all", "camera"})
    if other:
        raise AsterismError(f"{path}: {other[0]} means nothing there; write [all] and a table [[camera]] for each camera.")
    listed, shared = tables.get("camera"), tables.get("all", {})
    if not isinstance(listed, list) or not 0 < len(listed) <= _MOST or not isinstance(shared, dict):
        raise AsterismError(f"{path} has no cameras, or more than {_MOST}; write a table [[camera]] with name and address for each.")
    of_all = _settings(f"{path}, [all]", shared)
    found = list[CameraSpec]()
    for place, table in enumerate(listed, start=1):
        where = f"{path}, camera {place}"
        if not isinstance(table, dict):
            raise AsterismError(f"{where} is no table; write [[camera]].")
        name, address = table.get("name", f"camera{place}"), table.get("address")
        if not isinstance(name, str) or not name.strip() or not isinstance(address, str) or not address.strip():
            raise AsterismError(f'{where}: give it a name and an address, as in name = "left" and address = "camera://0".')
        own = _settings(f"{path}, camera {name}", {key: value for key, value in table.items() if key not in ("name", "address", "has")})
        found.append(CameraSpec(name, _from(path.parent, address), {**of_all, **own}))
    for what, values in (("name", [spec.name for spec in found]), ("address", [spec.address for spec in found])):
        twice = next((value for value in values if values.count(value) > 1), None)
        # Simulated cameras differ in nothing but their names.
        if twice is not None and not twice.startswith("simulated://"):
            raise AsterismError(f"{path}: two cameras have the {what} {twice}; each needs its own.")
    return found


def _settings(where: str, table: dict[str, Any]) -> dict[str, SettingValue]:
    try:
        return {name: setting_value(name, value) for name, value in table.items()}
    except AsterismError as problem:
        raise AsterismError(f"{where}: {problem}") from None


def _from(folder: Path, address: str) -> str:
    """The address of a file as seen from here."""
    return address if "://" in address else str(folder / address)


def save_cameras(path: Path, specs: Iterable[CameraSpec], said: Mapping[str, Mapping[str, SettingValue]]) -> None:
    """Write cameras to a file that `load_cameras` reads: what is to be set on each, and below `has` what it said that it had.

    said: what cameras say of themselves, by their names; of those that could not be opened nothing
    """
    lines = list[str]()
    for spec in specs:
        address = spec.address if "://" in spec.address else _absolute(spec.address)
        lines += ["[[camera]]", toml_line("name", spec.name), toml_line("address", address)]
        # As a person would write them; features of GenICam after what all cameras have.
        order = [name for name in SETTINGS if name in spec.settings] + sorted(set(spec.settings) - set(SETTINGS))
        lines += [toml_line(name, spec.settings[name]) for name in order]
        if said.get(spec.name):
            lines += ["", "[camera.has]", *(toml_line(name, value) for name, value in said[spec.name].items())]
        lines.append("")
    units = ", ".join(f"{name} in {kind.unit}" for name, kind in SETTINGS.items() if kind.unit)
    write_atomically(path, "\n".join([f"# The cameras of a rig, for `asterism live --cameras`. {units}.", "", *lines]).encode())


def _absolute(address: str) -> str:
    path = path_of(address)
    return str(path.absolute()) + address[len(str(path)) :]


def with_settings(specs: Sequence[CameraSpec], settings: dict[str, SettingValue], names: Sequence[str] = ()) -> list[CameraSpec]:
    """Cameras with settings over their own. names: of those that get them, all where none is named. Raises AsterismError for others."""
    other = next((name for name in names if name not in [spec.name for spec in specs]), None)
    if other is not None:
        raise AsterismError(f"there is no camera {other}; choose from {', '.join(spec.name for spec in specs)}.")
    return [replace(spec, settings={**spec.settings, **settings}) if not names or spec.name in names else spec for spec in specs]
