"""Damaged and lying C3D files end in one clear sentence or in a right answer, never in anything else, and in no time."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.formats import describe, read, write
from asterism.formats.c3d._file import open_c3d
from asterism.recording import Event, Recording

RELAXED = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SMALL = (
    "conformance/c3d/sample_02/dec_int.c3d",
    "conformance/c3d/sample_02/sgi_real.c3d",
    "conformance/c3d/sample_27/kyowadengyo.c3d",
    "conformance/c3d/sample_16/golf.c3d",
    "movement/clinical-lower/sydney_static.c3d",
)


@pytest.fixture(scope="module")
def simulated() -> bytes:
    """A small file of ours: six markers of somebody walking, two events, gaps."""
    import tempfile

    rng = np.random.default_rng(3)
    positions = (
        rng.uniform(0, 1.7, size=(1, 6, 3)) + np.linspace(0, 1, 40)[:, None, None] * [1, 0, 0] + rng.normal(scale=0.001, size=(40, 6, 3))
    )
    positions[5:9, 2] = np.nan
    events = (Event("Foot Strike", 0.1, "Left"), Event("Foot Off", 0.3, "Left"))
    recording = Recording(positions, ("LKNE", "RKNE", "LANK", "RANK", "C7", "*1"), 100.0, events=events, metadata={"subject": "Ann"})
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder) / "small.c3d", recording)
        return (Path(folder) / "small.c3d").read_bytes()


def survives(path: Path, raw: bytes) -> Recording | None:
    """Reading, describing, writing unchanged and relabelled: each works or is refused in one sentence that names a file."""
    path.write_bytes(raw)
    try:
        describe(path)
    except AsterismError as problem:
        assert path.name in str(problem)
        assert "\n" not in str(problem)
    try:
        recording = read(path)
    except AsterismError as problem:
        assert path.name in str(problem)
        assert "\n" not in str(problem)
        return None
    out = path.with_name("out.c3d")
    write(out, recording)
    assert out.read_bytes() == raw, "unchanged, but other bytes"
    try:
        write(out, replace(recording, labels=tuple(f"A{i}" for i in range(len(recording.labels)))))
    except AsterismError as problem:
        assert "out.c3d" in str(problem) or path.name in str(problem)
    else:
        again = open_c3d(out)
        assert again.layout.frames == len(recording)
        assert again.layout.points >= len(recording.labels)
    return recording


def test_empty_short_and_foreign_files_are_refused(tmp_path: Path) -> None:
    for name, content, said in (
        ("empty.c3d", b"", "empty"),
        ("short.c3d", b"\x02\x50" + bytes(100), "only 102 bytes"),
        ("zeros.c3d", bytes(5000), ""),
        ("text.c3d", b"frame,time,x\n" * 200, ""),
        ("head.c3d", b"\x02\x50" + bytes(510), "breaks off"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(AsterismError, match=rf"{name}.*{said}"):
            read(tmp_path / name)
    with pytest.raises(AsterismError, match=r"absent\.c3d"):
        read(tmp_path / "absent.c3d")
    with pytest.raises(AsterismError, match="folder"):
        (tmp_path / "folder.c3d").mkdir()
        read(tmp_path / "folder.c3d")


def test_a_file_cut_anywhere_gives_its_whole_frames_or_a_sentence(tmp_path: Path, simulated: bytes) -> None:
    (tmp_path / "whole.c3d").write_bytes(simulated)
    whole = read(tmp_path / "whole.c3d")
    start, frames_seen = whole.source.layout.start, set()
    for cut in [*range(0, start, 37), *range(start - 3, len(simulated), 61)]:
        recording = survives(tmp_path / "cut.c3d", simulated[:cut])
        if recording is None:
            continue
        frames = len(recording)
        frames_seen.add(frames)
        assert frames == min(40, (cut - start) // (6 * 16)), f"cut at {cut}"
        np.testing.assert_array_equal(recording.positions, whole.positions[:frames])
        if frames < 40:
            assert any("breaks off" in finding.sentence for finding in recording.metadata["findings"])
    assert len(frames_seen) > 30


@RELAXED
@given(damage=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=12), early=st.booleans())
def test_flipped_bytes_of_a_file_of_ours(tmp_path: Path, simulated: bytes, damage: list[tuple[float, int]], early: bool) -> None:
    raw = bytearray(simulated)
    span = 1600 if early else len(raw)
    for place, value in damage:
        raw[int(place * span)] = value
    survives(tmp_path / "flipped.c3d", bytes(raw))


@RELAXED
@given(
    which=st.integers(0, len(SMALL) - 1),
    damage=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=12),
    span=st.sampled_from([24, 512, 4000, 10**9]),
    keep=st.just(1.0) | st.floats(0, 1),
)
def test_flipped_and_cut_bytes_of_real_files(
    data: Path, tmp_path: Path, which: int, damage: list[tuple[float, int]], span: int, keep: float
) -> None:
    raw = bytearray((data / SMALL[which]).read_bytes())
    for place, value in damage:
        raw[int(place * min(span, len(raw)))] = value
    survives(tmp_path / "flipped.c3d", bytes(raw[: int(len(raw) * keep)]))


def test_a_header_that_lies_about_its_size_costs_no_memory(tmp_path: Path, simulated: bytes) -> None:
    raw = bytearray(simulated)
    raw[2:6] = b"\xff" * 4
    raw[6:10] = b"\x01\x00\xff\xff"
    for record in (b"FRAMES", b"USED", b"ACTUAL_END_FIELD"):
        at = raw.find(record) + len(record) + 4
        raw[at : at + 2] = b"\xff\xff"
    (tmp_path / "liar.c3d").write_bytes(raw)
    tracemalloc.start()
    try:
        try:
            read(tmp_path / "liar.c3d")
        except AsterismError as problem:
            assert "liar.c3d" in str(problem)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 50_000_000, f"{peak / 1e6:.0f} MB for a file of {len(raw) / 1e3:.0f} kB"


def test_a_parameter_that_claims_huge_dimensions_is_left_alone(tmp_path: Path, simulated: bytes) -> None:
    raw = bytearray(simulated)
    at = raw.find(b"LABELS") + len(b"LABELS") + 3
    raw[at : at + 8] = bytes([7, 0, 255, 255, 255, 255, 255, 255])
    recording = survives(tmp_path / "huge.c3d", bytes(raw))
    assert recording is None or len(recording) == 40


def test_no_rate_and_no_points_are_named(tmp_path: Path, simulated: bytes) -> None:
    raw = bytearray(simulated)
    rate = np.float32(100.0).tobytes()
    assert raw.count(rate) >= 2
    (tmp_path / "still.c3d").write_bytes(raw.replace(rate, bytes(4)))
    with pytest.raises(AsterismError, match=r"still\.c3d.*rate"):
        read(tmp_path / "still.c3d")
    raw[2:4] = bytes(2)
    at = raw.find(b"USED") + len(b"USED") + 4
    raw[at : at + 2] = bytes(2)
    (tmp_path / "pointless.c3d").write_bytes(raw)
    with pytest.raises(AsterismError, match=r"pointless\.c3d holds no points"):
        read(tmp_path / "pointless.c3d")
    assert describe(tmp_path / "pointless.c3d")["points"]["physical"] == []


def test_the_same_label_twice_is_read_but_not_guessed(data: Path) -> None:
    path = data / "conformance/c3d/sample_00/Motion_Analysis_Corporation/Walk1.c3d"
    recording = read(path)
    assert recording.labels.count("RKNE") == 2
    with pytest.raises(AsterismError, match=r"Walk1\.c3d.*RKNE"):
        read(path, markers=("RKNE", "LASI"))


def test_a_file_that_breaks_off_keeps_its_frames_where_they_become_smaller(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    write(tmp_path / "whole.c3d", Recording(rng.normal(size=(30, 40, 3)), tuple(f"*{i + 1}" for i in range(40)), 100.0))
    whole = (tmp_path / "whole.c3d").read_bytes()
    start = read(tmp_path / "whole.c3d").source.layout.start
    # nearly a whole frame of 40 points is left over, which holds many frames of 4
    (tmp_path / "cut.c3d").write_bytes(whole[: start + 11 * 640 - 8])
    cut = read(tmp_path / "cut.c3d")
    assert len(cut) == 10 and cut.source.layout.cut
    fewer = replace(cut, positions=cut.positions[:, :4], labels=cut.labels[:4], origin=cut.origin[:, :4])
    write(tmp_path / "fewer.c3d", fewer)
    again = read(tmp_path / "fewer.c3d")
    np.testing.assert_array_equal(again.positions, fewer.positions)
