"""2D CSV: blobs out and in again bit for bit, other people's spellings, and what is refused with file and line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.formats import read_blobs, write_blobs
from asterism.recording import Blobs


def equal(one: Blobs, other: Blobs) -> bool:
    return (
        one.cameras == other.cameras
        and (one.rate, one.first_frame) == (other.rate, other.first_frame)
        and np.array_equal(one.xy, other.xy)
        and np.array_equal(one.offsets, other.offsets)
        and np.array_equal(one.sizes, other.sizes, equal_nan=True)
        and (one.times is None) == (other.times is None)
        and (one.times is None or np.array_equal(one.times, other.times, equal_nan=True))  # type: ignore[arg-type]
    )


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "blobs.csv"
    path.write_text(text)
    return path


@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(0, 40), st.booleans(), st.booleans(), st.integers(-5, 500))
@settings(max_examples=60, deadline=None)
def test_blobs_come_back_as_they_were(
    tmp_path_factory: pytest.TempPathFactory, seed: int, cameras: int, count: int, sized: bool, timed: bool, first: int
) -> None:
    random = np.random.default_rng(seed)
    names = [f"cam {i}" if seed % 2 else str(i) for i in range(cameras)]
    frames = 12
    times = np.arange(frames)[:, None] / 60 + random.uniform(0, 0.01, (frames, cameras))
    times[random.random(times.shape) < 0.2] = np.nan
    frame, camera = random.integers(0, frames, count), random.integers(0, cameras, count)
    times[frame, camera] = frame / 60 + 0.001
    blobs = replace(
        Blobs.from_rows(
            frame,
            camera,
            random.uniform(-10, 2000, (count, 2)),
            names,
            rate=59.94,
            sizes=np.where(random.random(count) < 0.8, random.uniform(1, 9, count), np.nan) if sized else None,
            frames=frames,
            times=times if timed else None,
        ),
        first_frame=first,
    )
    path = tmp_path_factory.mktemp("blobs") / "blobs.csv"
    write_blobs(blobs, path)
    again = read_blobs(path)
    assert equal(again, blobs)
    assert equal(read_blobs(path, cameras=names), blobs)


def test_frames_start_anywhere_and_may_be_left_out(tmp_path: Path) -> None:
    blobs = read_blobs(written(tmp_path, "frame,camera,x,y\n103,b,1,2\n101,a,3,4\n"))
    assert (blobs.first_frame, len(blobs), blobs.cameras) == (101, 3, ("a", "b"))
    assert blobs.of(0, 0).tolist() == [[3, 4]]
    assert blobs.of(2, 1).tolist() == [[1, 2]]


def test_semicolons_decimal_commas_other_names_and_order(tmp_path: Path) -> None:
    text = "X_px;Y (px);cam_id;Frame Number;diameter\r\n1,5;2,25;10;7;3\r\n3;4;9;7;\r\n\r\n"
    blobs = read_blobs(written(tmp_path, text))
    assert blobs.cameras == ("9", "10")
    assert blobs.of(0, 1).tolist() == [[1.5, 2.25]]
    assert np.isnan(blobs.sizes[0]) and blobs.sizes[1] == 3


@pytest.mark.parametrize("nothing", ["", "nan", "NaN", "NA"])
def test_a_row_without_a_position_says_that_the_camera_saw_nothing(tmp_path: Path, nothing: str) -> None:
    blobs = read_blobs(written(tmp_path, f"frame,camera,x,y,time\n0,a,1,2,0.5\n1,a,{nothing},{nothing},0.52\n2,b,5,6,0.54\n"))
    assert blobs.counts.tolist() == [[1, 0], [0, 0], [0, 1]]
    assert blobs.times is not None
    assert np.array_equal(blobs.times, [[0.5, np.nan], [0.52, np.nan], [np.nan, 0.54]], equal_nan=True)


def test_a_blob_that_is_repeated_counts_once(tmp_path: Path) -> None:
    path = tmp_path / "2d.csv"
    path.write_text("frame,camera,x,y\n0,a,1.5,2\n0,a,1.5,3\n0,a,1.5,2\n1,a,1.5,2\n0,b,1.5,2\n", encoding="utf-8")
    blobs = read_blobs(path)
    assert blobs.counts.tolist() == [[2, 1], [1, 0]]
    assert blobs.of(0, 0).tolist() == [[1.5, 2.0], [1.5, 3.0]]


def test_cameras_by_number_take_the_rigs_names(tmp_path: Path) -> None:
    rig = ("left", "middle", "right")
    from_zero = read_blobs(written(tmp_path, "frame,camera,x,y\n0,0,1,2\n0,1.0,3,4\n"), cameras=rig)
    from_one = read_blobs(written(tmp_path, "frame,camera,x,y\n0,3,1,2\n0,1,3,4\n"), cameras=rig)
    assert (from_zero.cameras, from_zero.counts.tolist()) == (rig, [[1, 1, 0]])
    assert from_one.counts.tolist() == [[1, 0, 1]]
    by_name = read_blobs(written(tmp_path, "frame,camera,x,y\n0,right,1,2\n"), cameras=rig)
    assert by_name.counts.tolist() == [[0, 0, 1]]
    numbers_for_names = read_blobs(written(tmp_path, "frame,camera,x,y\n0,7,1,2\n"), cameras=("5", "6", "7"))
    assert numbers_for_names.counts.tolist() == [[0, 0, 1]]


def test_the_rate_comes_from_the_caller_the_comment_or_the_times(tmp_path: Path) -> None:
    rows = "frame,camera,x,y,time\n0,a,1,2,0\n1,a,1,2,0.02\n2,a,1,2,0.04\n"
    assert read_blobs(written(tmp_path, rows)).rate == 50
    assert read_blobs(written(tmp_path, "# rate=60\n" + rows)).rate == 60
    assert read_blobs(written(tmp_path, "# rate=60\n" + rows), rate=25).rate == 25
    # Whole milliseconds of 120 Hz are steps of 8, 8 and 9.
    rounded = "".join(f"{n},{1000 * n // 120 / 1000},a,1,2\n" for n in range(60))
    assert read_blobs(written(tmp_path, "frame,time,camera,x,y\n" + rounded)).rate == 120


HEAD = "frame,camera,x,y,size,time\n0,a,1,2,3,0.1\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("frame,camera,x\n0,a,1\n", "line 1: no column y"),
        ("frame,camera,x,y,x_px\n", "two columns are the x"),
        ("", "empty"),
        ("frame,camera,x,y\n", "no rows"),
        (HEAD + "1,a,oops,2,3,0.2\n", "line 3: 'oops' is not a number"),
        (HEAD + "1,a,1_0,2,3,0.2\n", "line 3: '1_0' is not a number"),
        (HEAD + "1,,1,2,3,0.2\n", "line 3: '' is not a camera"),
        (HEAD + ",a,1,2,3,0.2\n", "line 3: '' is not a number"),
        (HEAD + "1.5,a,1,2,3,0.2\n", "line 3: the frame is not a whole number"),
        (HEAD + "inf,a,1,2,3,0.2\n", "line 3: the frame"),
        (HEAD + "1,a,,2,3,0.2\n", "line 3: only one of x and y"),
        (HEAD + "1,a,inf,2,3,0.2\n", "line 3: a position is infinite"),
        (HEAD + "1,a,1,2,-3,0.2\n", "line 3: a size is negative"),
        (HEAD + "0,a,1,2,3,0.3\n", "line 3: the camera took this frame at two different times"),
        (HEAD + "1,a,1,2\n", "line 3: 4 cells, 6 in the header; the file breaks off"),
        (HEAD + "1,a,1,2,3,0.2,9\n", "line 3: 7 cells"),
        (HEAD + HEAD, "line 3: a second header"),
        (HEAD + "900000000000,a,1,2,3,0.2\n", "frame numbers run from 0 to 900000000000"),
        ("# blobs=3\n" + HEAD, "cut off"),
    ],
)
def test_what_cannot_be_is_named_with_its_line(tmp_path: Path, text: str, said: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(AsterismError) as caught:
        read_blobs(path)
    assert said in str(caught.value) and str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        (["left", "rear"], "no camera rear; the rig has left, right, top"),
        (["0", "3"], "numbered 0 to 3"),
        (["1", "2"], "may count from 0 or from 1"),
        (["0", "7"], "no camera 0"),
    ],
)
def test_cameras_that_the_rig_does_not_have(tmp_path: Path, cells: list[str], said: str) -> None:
    text = "frame,camera,x,y\n" + "".join(f"0,{cell},1,2\n" for cell in cells)
    with pytest.raises(AsterismError, match=said):
        read_blobs(written(tmp_path, text), cameras=("left", "right", "top"))


def test_a_name_that_csv_cannot_carry_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AsterismError, match="comma"):
        write_blobs(Blobs.from_rows([0], [0], [[1, 2]], ("a,b",)), tmp_path / "blobs.csv")


def test_info_tells_what_a_2d_file_holds_and_reading_it_as_a_recording_what_to_do(tmp_path: Path) -> None:
    from asterism import formats

    path = written(tmp_path, "frame,camera,x,y\n5,a,1,2\n5,b,3,4\n7,a,5,6\n")
    told = formats.describe(path)
    assert (told["format"], told["frames"], told["first_frame"], told["blobs"]) == ("2D CSV", 3, 5, {"a": 2, "b": 1})
    with pytest.raises(AsterismError, match="asterism reconstruct"):
        formats.read(path)
