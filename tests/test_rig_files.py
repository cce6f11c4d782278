"""Rig files: ours bit for bit; others' by what their numbers mean, checked against points, plates and published residuals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.cameras import Camera, Rig, rotation_from_vector
from asterism.cameras.files import read_rig, write_rig
from asterism.errors import AsterismError


def a_rig() -> Rig:
    one = Camera(
        "front left",
        (1280, 1024),
        (1500.125, 1490.0),
        (640.1, 500.2),
        rotation_from_vector([0.2, -0.4, 0.1]),
        np.array([0.1, -0.2, 3.0]),
        (-0.28, 0.1, 0.02, 0.001),
        (0.0011, -0.0007),
        (0.1, 0.2, 0.3),
        error=0.21,
    )
    two = Camera("2", None, (800.0, 800.0), (320.0, 240.0), posed=False)
    return Rig((one, two), np.array([0.0, 0.6, 0.8]), {"file": "x.c3d", "residuals": {"wand, m": [1e-3, np.nan]}}, ("image sizes",))


def same_cameras(one: Rig, other: Rig) -> bool:
    return one.names == other.names and all(
        np.array_equal(a.lens, b.lens)
        and np.array_equal(a.rotation, b.rotation)
        and np.array_equal(a.translation, b.translation)
        and (a.size, a.posed, repr(a.error)) == (b.size, b.posed, repr(b.error))
        for a, b in zip(one, other, strict=True)
    )


def test_our_file_brings_everything_back_bit_for_bit(tmp_path: Path) -> None:
    rig = a_rig()
    assert write_rig(rig, tmp_path / "rig.toml") == []
    again = read_rig(tmp_path / "rig.toml")
    assert same_cameras(rig, again)
    assert np.array_equal(again.vertical, rig.vertical)  # type: ignore[arg-type]
    assert again.lacks == rig.lacks
    assert repr(again.metadata) == repr(rig.metadata)


@pytest.mark.parametrize(
    ("find", "put", "said"),
    [
        ("version = 1", "version = 7", "later Asterism"),
        ("version = 1", "version = 'x'", "format version"),
        ("focal = [1500.125, 1490.0]", "", "camera front left: no focal"),
        ("focal = [1500.125, 1490.0]", "focal = [1500.125]", "camera front left"),
        ("focal = [1500.125, 1490.0]", "focal = ['a', 'b']", "camera front left"),
        ("focal = [1500.125, 1490.0]", "focal = [-1.0, 2.0]", "focal length must be positive"),
        ("focal = [1500.125, 1490.0]", "focal = [1500.125, 14", "no TOML"),
        ('name = "2"', 'name = "front left"', "called front left"),
        ("translation = [0.1, -0.2, 3.0]", "", "no translation"),
        ("translation = [0.1, -0.2, 3.0]", "translation = [nan, 0.0, 0.0]", "finite"),
        ("[[camera]]", "[[kamera]]", "at least one camera"),
    ],
)
def test_a_damaged_file_of_ours_is_refused(tmp_path: Path, find: str, put: str, said: str) -> None:
    path = tmp_path / "rig.toml"
    write_rig(a_rig(), path)
    text = path.read_text(encoding="utf-8")
    assert find in text
    path.write_text(text.replace(find, put), encoding="utf-8")
    with pytest.raises(AsterismError) as caught:
        read_rig(path)
    assert said in str(caught.value) and str(path) in str(caught.value)


def test_a_file_that_breaks_off_is_refused_or_lacks_nothing_that_was_written(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    write_rig(replace(a_rig(), metadata={}), path)
    data = path.read_bytes()
    whole = len(data.rstrip())
    for end in range(0, whole - 1, 17):
        path.write_bytes(data[:end])
        try:
            rig = read_rig(path)
        except AsterismError:
            continue
        assert rig.names == ("front left",) or len(rig) == 2
