"""Recordings of the Lab Streaming Layer: what their streams say, clocks that were set, gaps and damage."""

from __future__ import annotations

import math
import os
import struct
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import asterism
from asterism.cli import main
from asterism.errors import AsterismError, NoMarkers
from asterism.formats.xdf import xdf_streams
from asterism.live import LiveFrame, Replay, SourceEnded

RATE, MARKERS = 100.0, 4
BOUNDARY = bytes.fromhex("43a546dccbf5410fb30ed5467383cbe4")


def chunk(tag: int, content: bytes) -> bytes:
    size = len(content) + 2
    return (b"\x01" + bytes([size]) if size < 256 else b"\x04" + struct.pack("<I", size)) + struct.pack("<H", tag) + content


def header(number: int, name: str, kind: str, channels: list[tuple[str, str]], form: str = "float32") -> bytes:
    described = "".join(
        f"<channel><marker>{marker}</marker><type>Position{axis}</type><unit>meters</unit></channel>" for marker, axis in channels
    )
    text = (
        f'<?xml version="1.0"?><info><name>{name}</name><type>{kind}</type><channel_count>{len(channels)}</channel_count>'
        f"<nominal_srate>{RATE:g}</nominal_srate><channel_format>{form}</channel_format><desc><channels>{described}</channels></desc></info>"
    )
    return chunk(2, struct.pack("<I", number) + text.encode())


def samples(number: int, stamps: list[float | None], values: np.ndarray) -> bytes:
    rows = [
        (b"\x00" if stamp is None else b"\x08" + struct.pack("<d", stamp)) + row.astype("<f4").tobytes()
        for stamp, row in zip(stamps, values, strict=True)
    ]
    return chunk(3, struct.pack("<IBI", number, 4, len(rows)) + b"".join(rows))


def walk(frames: int = 600) -> np.ndarray:
    """(T, M, 3) m: a few points that walk."""
    body = np.random.default_rng(0).uniform((-0.3, -0.3, 0.1), (0.3, 0.3, 1.7), (MARKERS, 3))
    return body + np.linspace(0, 3, frames)[:, None, None] * np.array([1.0, 0.0, 0.0])


def recorded(points: np.ndarray, *, reset: int, lost: slice = slice(0, 0), damage: int = 0) -> bytes:
    """A file of a stream whose sender starts anew at a sample: its clock, 5,000 s before the recorder's, then begins at 0."""
    channels = [(f"M{n}", axis) for n in range(MARKERS) for axis in "XYZ"]
    data = b"XDF:" + chunk(1, b"<info><version>1.0</version></info>")
    data += header(1, "texts", "Markers", [("e", "X")], "string") + header(2, "body", "MoCap", channels)
    values, ahead = points.reshape(len(points), -1), np.where(np.arange(len(points)) < reset, 5000.0, 9000.0)
    gone = np.zeros(len(points), dtype=bool)
    gone[lost] = True
    for first in range(0, len(points), 50):
        some = [n for n in range(first, first + 50) if not gone[n]]
        # The recorder asks each half second, a little late.
        data += chunk(4, struct.pack("<Idd", 2, 9000.5 + first / RATE - ahead[first], ahead[first] + 1e-4 * (first % 3)))
        # Stamps are left out where a sample follows the one before at the rate.
        stamps = [None if n % 7 == 3 and n - 1 in some else 9000.0 + n / RATE - ahead[n] for n in some]
        data += samples(2, stamps, values[some]) if some else b""
        data += chunk(3, struct.pack("<IBB", 1, 1, 1) + b"\x00\x01\x03one")
        data += chunk(5, BOUNDARY)
        if damage and first == 50:
            data += bytes(range(2, 2 + damage))
    return data


def told(recording: asterism.Recording) -> set[str]:
    return {finding.code for finding in recording.metadata["findings"]}


def test_a_clock_that_was_set_back_while_it_was_recorded_breaks_nothing(tmp_path: Path) -> None:
    points = walk()
    (tmp_path / "walk.xdf").write_bytes(recorded(points, reset=300, lost=slice(400, 550)))
    ((stream,), unread) = xdf_streams(tmp_path / "walk.xdf")
    times, resets = stream.times()
    assert resets == 1 and unread == 0
    kept = np.r_[0:400, 550:600]
    np.testing.assert_allclose(times, 9000.0 + kept / RATE, atol=1e-3)
    recording = asterism.read(tmp_path / "walk.xdf")
    assert recording.rate == RATE and recording.labels == tuple(f"M{n}" for n in range(MARKERS)) and len(recording) == 600
    np.testing.assert_allclose(recording.positions[kept], points[kept], atol=1e-6)
    assert np.isnan(recording.positions[400:550]).all(), "what was lost leaves frames without points"
    assert "format-clock-set" in told(recording)


def test_a_recording_of_streams_is_played_live(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "walk.xdf").write_bytes(recorded(walk(150), reset=50))
    source, came = Replay(tmp_path / "walk.xdf", speed=math.inf), list[LiveFrame]()
    with suppress(SourceEnded):
        while frame := source.read(1.0):
            came.append(frame)
    assert source.about.rate == RATE and [len(frame.points) for frame in came] == [MARKERS] * 150
    assert main(["info", str(tmp_path)]) == 0 and "XDF" in capsys.readouterr().out
    with pytest.raises(AsterismError, match="read and not written"):
        asterism.write(tmp_path / "other.xdf", asterism.read(tmp_path / "walk.xdf"))


def test_of_several_streams_one_is_chosen_by_name_or_number(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points, path = walk(100), tmp_path / "two.xdf"
    channels = [(f"H{n}", axis) for n in range(MARKERS) for axis in "XYZ"]
    other = samples(7, [9000.0 + n / RATE for n in range(100)], points.reshape(100, -1))
    path.write_bytes(recorded(points, reset=0) + header(7, "Hand", "MoCap", channels) + other)
    assert asterism.read(path).labels == tuple(f"M{n}" for n in range(MARKERS))
    (found,) = Replay(path).findings()
    assert (
        found.code == "format-several-streams"
        and found.sentence.startswith(f"{path}: ")
        and found.sentence.count("two.xdf") == 1
        and "not read: Hand" in found.sentence
    )
    for name in ("hand", "7"):
        assert asterism.read(path, stream=name).labels[0] == "H0" and not Replay(path, stream=name).findings()
    with pytest.raises(AsterismError, match=r"is called foot; choose by name or number from: .*Hand \(number 7, 4 markers\)"):
        asterism.read(path, stream="foot")
    assert main(["convert", str(path), str(tmp_path / "hand.trc"), "--stream", "Hand"]) == 0
    assert asterism.read(tmp_path / "hand.trc").labels[0] == "H0"
    for words in (["convert", "hand.trc", "x.c3d"], ["live", "--replay", "hand.trc"], ["live", "udp://127.0.0.1:0"]):
        assert main([str(tmp_path / word) if "." in word and ":" not in word else word for word in words] + ["--stream", "Hand"]) == 2
        assert "--stream" in capsys.readouterr().err


def test_damage_costs_what_is_up_to_the_next_boundary(tmp_path: Path) -> None:
    (tmp_path / "walk.xdf").write_bytes(recorded(walk(), reset=0, damage=40))
    ((stream,), unread) = xdf_streams(tmp_path / "walk.xdf")
    assert unread > 40 and len(stream.stamps) == 550
    assert "format-damaged-parts" in told(asterism.read(tmp_path / "walk.xdf"))


def test_what_holds_no_markers_says_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "eeg.xdf").write_bytes(b"XDF:" + header(1, "BioSemi", "EEG", [("", "")] * 8))
    with pytest.raises(NoMarkers, match=r"BioSemi \(EEG, 8 channels\)"):
        asterism.read(tmp_path / "eeg.xdf")


@settings(max_examples=60)
@given(st.data())
def test_damaged_files_are_read_or_refused(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    content = bytearray(WHOLE)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(4, len(content) - 1))
        content[at] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.getbasetemp() / "damaged.xdf"
    path.write_bytes(content[: data.draw(st.integers(5, len(content)))])
    with suppress(AsterismError):
        assert len(asterism.read(path)) < 20 * 200


WHOLE = recorded(walk(100), reset=50)


def test_a_real_file_is_read_as_its_own_reader_reads_it() -> None:
    pyxdf = pytest.importorskip("pyxdf", reason="pyxdf is not installed")
    path = Path(os.environ.get("ASTERISM_DATA", "")) / "live" / "xdf" / "clock_resets.xdf"
    if "ASTERISM_DATA" not in os.environ or not path.exists():
        pytest.skip("ASTERISM_DATA with live/xdf is needed")
    ((stream,), unread) = xdf_streams(path)
    theirs = next(each for each in pyxdf.load_xdf(str(path), dejitter_timestamps=False)[0] if each["info"]["name"] == ["BioSemi"])
    times, resets = stream.times()
    assert (resets, unread, stream.name) == (1, 0, "BioSemi") and (np.diff(times) > 0).all()
    np.testing.assert_array_equal(stream.values, theirs["time_series"])
    np.testing.assert_allclose(times, theirs["time_stamps"], atol=1e-3)
