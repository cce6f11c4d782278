"""2D data of commercial camera systems: what is read, and what is refused with a sentence that helps."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.cameras.files import read_rig, write_rig
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.formats import read
from asterism.formats.blobs_2d import read_2d
from asterism.recording import Blobs, MarkerSet
from asterism.simulation import simulate_standing, simulate_walks
from asterism.simulation.views_laboratory import simulate_views
from asterism.skeleton import fit_body, save_body

SERIALS = (20658, 20659, 20701, 20702)


def as_qtm(blobs: Blobs) -> dict[str, object]:
    """What the scripting interface of QTM returns for these blobs: whole 64ths of a pixel, null for a frame without an image."""
    cameras = []
    for c, serial in enumerate(SERIALS):
        samples = []
        for t in range(len(blobs)):
            markers = [{"position": np.round(64 * xy).astype(int).tolist(), "size": [512, 448]} for xy in blobs.of(t, c)]
            samples.append(markers or None)
        cameras.append({"serial": serial, "samples": samples})
    return {"frequency": blobs.rate, "cameras": cameras}


def test_qtms_two_dimensional_series_with_its_calibration_are_labelled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    standing, walking = simulate_standing(3, 10, seed=5), simulate_walks(3, 60, seed=5)
    people = [str(trial.metadata["subject"]) for trial in (*standing, *walking)]
    body = fit_body(standing, walking, markers=MarkerSet.load("helen-hayes"), people=people, title="three walkers")
    session = simulate_views(simulate_walks(1, 60, seed=32)[0], body.labels, rng=np.random.default_rng(3))
    rig = replace(session.rig, cameras=tuple(replace(c, name=str(n)) for c, n in zip(session.rig, SERIALS, strict=True)))
    write_rig(rig, tmp_path / "room.qca.txt")
    save_body(body, tmp_path / "body.toml")
    given = session.blobs.frames(slice(0, 15))
    (tmp_path / "2d.json").write_text(json.dumps(as_qtm(given)))
    back = read_2d(tmp_path / "2d.json", cameras=read_rig(tmp_path / "room.qca.txt").names)
    assert back.cameras == tuple(map(str, SERIALS)) and back.rate == given.rate and back.first_frame == 1
    assert (back.offsets == given.offsets).all() and np.abs(back.xy - given.xy).max() <= 0.5 / 64
    assert np.allclose(back.sizes, 7.5)
    words = ["label-views", str(tmp_path / "2d.json"), "--rig", str(tmp_path / "room.qca.txt"), "--body", str(tmp_path / "body.toml")]
    assert main([*words, "--quick", "-o", str(tmp_path / "out.c3d")]) == 2
    assert "--vertical z" in capsys.readouterr().err
    assert main([*words, "--quick", "--vertical", "z", "-o", str(tmp_path / "out.c3d")]) == 0
    assert "places from one camera" in capsys.readouterr().out
    apart = np.linalg.norm(read(tmp_path / "out.c3d").positions - session.recording.positions[:15], axis=2)
    assert np.nanmedian(apart) < 0.02 and np.isfinite(apart).mean() > 0.9


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("trial.x2d", b"\x00\x01", "DataStream"),
        ("trial.mat", b"", "2D data series"),
        ("trial.qtm", b"", "not published"),
        ("trial.tak", b"", "Camera SDK"),
        ("trial.c3d", b"", "3D points"),
        ("trial.tsv", b"NO_OF_FRAMES\t10\nDATA_INCLUDED\t2D\n", "not published"),
        ("trial.json", b"{", "no JSON"),
        ("trial.json", b"[]", "list `cameras`"),
        ("trial.json", b'{"cameras": [{"serial": 7, "samples": []}]}', "no camera 7"),
        ("trial.json", b'{"cameras": [{"serial": 1, "samples": [[{"position": [3]}]]}]}', "two numbers"),
        ("trial.json", b'{"cameras": [{"serial": 1, "samples": [[{"position": [3, "x"]}]]}]}', "two numbers"),
        ("trial.json", b'{"frequency": -1, "cameras": [{"serial": 1, "samples": [[{"position": [3, 4]}]]}]}', "rate"),
        ("trial.json", b'{"cameras": [{"serial": 1, "samples": 5}]}', "trial.json"),
    ],
)
def test_what_is_not_readable_says_what_to_do(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(AsterismError, match=sentence) as told:
        read_2d(tmp_path / name, cameras=["1", "2"])
    assert name in str(told.value)


def test_a_file_that_is_absent_and_other_tsv_and_csv_are_told_as_before(tmp_path: Path) -> None:
    with pytest.raises(AsterismError, match="does not exist"):
        read_2d(tmp_path / "none.json")
    (tmp_path / "2d.tsv").write_text("frame\tcamera\tx\ty\n1\ta\t3.5\t4\n")
    assert read_2d(tmp_path / "2d.tsv").xy.tolist() == [[3.5, 4.0]]
