"""The Lab Streaming Layer both ways, through liblsl's own outlets and inlets on this machine."""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from receivers import KNEE, printed_by_receiver
from waiting import LONG, taken

from asterism import AsterismError
from asterism.findings import Finding
from asterism.formats.mocap_channels import layout_of_channels
from asterism.live import (
    AnalysedFrame,
    Cue,
    FeedbackRule,
    FrameAnalysis,
    LabelledFrame,
    LiveEvent,
    LiveFrame,
    SourceAbout,
    open_output,
    open_source,
)
from asterism.live.clock import SampleNumbers
from asterism.live.lsl_source import FromLsl, StreamChoice

# Read by the library as it is loaded: nothing leaves this machine, and no other process of the tests is heard.
_CONFIG = Path(tempfile.gettempdir()) / f"asterism-lsl-{os.getpid()}.cfg"
_CONFIG.write_text(
    f"[multicast]\nResolveScope = machine\n[lab]\nKnownPeers = {{127.0.0.1}}\nSessionID = asterism-{os.getpid()}\n[log]\nlevel = -3\n"
)
os.environ["LSLAPICFG"] = str(_CONFIG)
# A process that only collects the tests leaves nothing behind, either.
atexit.register(_CONFIG.unlink, missing_ok=True)
pylsl = pytest.importorskip("pylsl", reason="pylsl is not installed, or brings no liblsl for this system", exc_type=ImportError)


@pytest.fixture(scope="module", autouse=True)
def sockets() -> None:
    try:
        outlet = pylsl.StreamOutlet(pylsl.StreamInfo("probe", "Probe", 1, 0, "float32", uuid.uuid4().hex))
    except RuntimeError:
        pytest.skip("liblsl cannot open its sockets here")
    if not pylsl.resolve_byprop("source_id", outlet.get_info().source_id(), timeout=LONG):
        pytest.skip("liblsl does not find its own streams here")


@pytest.mark.parametrize(("own", "tells"), [("", False), ("[lab]\nSessionID = mine\n", False), ("[log]\nlevel = 0\n", True)])
def test_the_library_tells_no_more_than_the_person_wants(own: str, tells: bool, tmp_path: Path) -> None:
    """Its own words go past Python, to where failures of the command are told."""
    if own:
        (tmp_path / "lsl_api.cfg").write_text(own)
    code = (
        "from asterism.live.lsl_library import lsl_library, lsl_settings; library = lsl_library();"
        "library.StreamOutlet(library.StreamInfo('probe', 'Probe', 1, 0, 'float32', 'probe')); print(lsl_settings())"
    )
    away = {name: value for name, value in os.environ.items() if name != "LSLAPICFG"} | {"HOME": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=away, timeout=LONG, check=True)
    assert bool(done.stderr) == tells
    assert done.stdout.startswith(own) and ("level = -1" in done.stdout) != tells


def points_of(names: Sequence[str], unit: str = "", of: str = "marker") -> list[dict[str, str]]:
    return [{"label": f"{name}_{axis}", of: name, "type": f"Position{axis}", "unit": unit} for name in names for axis in "XYZ"]


def outlet(
    name: str, channels: list[dict[str, str]], rate: float = 100.0, identity: str = "", kind: str = "MoCap", form: str = "float32"
) -> Any:
    info = pylsl.StreamInfo(name, kind, len(channels), rate, form, identity or uuid.uuid4().hex)
    described = info.desc().append_child("channels")
    for channel in channels:
        if channel:
            entry = described.append_child("channel")
            for key, value in channel.items():
                entry.append_child_value(key, value)
    return pylsl.StreamOutlet(info)


def opened(address: str, rate: float = float("nan")) -> FromLsl:
    source = open_source(address, rate)
    assert isinstance(source, FromLsl)
    return source


@pytest.fixture
def name() -> str:
    return f"walk {uuid.uuid4().hex[:8]}"


def told(source: FromLsl) -> list[Finding]:
    """What is said of a stream beside what is true of most."""
    return [finding for finding in source.findings() if finding.code not in ("live-axis-unknown", "live-labels-given")]


def codes(source: FromLsl) -> set[str]:
    return {finding.code for finding in told(source)}


def test_points_have_their_unit_names_gaps_and_times(name: str) -> None:
    sender = outlet(name, [*points_of(["LASI", "RASI", "SACR", "LKNE"], "millimeters"), {"label": "LASI_C", "type": "Confidence"}])
    source = opened(f"lsl://{name}")
    assert source.about.rate == 100.0 and name in source.about.name
    begin = pylsl.local_clock()
    for n in (0, 1, 2, 5, 6):
        sender.push_sample([1000, 250, 800, 0, 0, 0, np.nan, 1, 1, -500, n, 900, 0.9], begin + n / 100)
    came = taken(source, 5)
    source.close()
    assert [frame.number for frame in came] == [0, 1, 2, 5, 6], "two samples were lost"
    np.testing.assert_allclose(came[1].points, [[1.0, 0.25, 0.8], [-0.5, 0.001, 0.9]], atol=1e-6)
    assert came[1].names == ("LASI", "LKNE")
    assert all(abs(frame.time - (begin + frame.number / 100)) < 0.005 for frame in came), "one machine has one clock"
    assert codes(source) == set() and "which axis points up" in str(source.findings()[0])


def test_a_stream_that_is_lost_is_found_again_and_never_another_one(name: str) -> None:
    sender = outlet(name, points_of(["A"], "m"), identity="mine")
    source = opened(f"lsl://{name}")
    sender.push_sample([1.0, 2.0, 3.0])
    before = taken(source, 1)[0]
    del sender
    limit = time.monotonic() + LONG
    while not told(source):
        assert source.read(0.05) is None and time.monotonic() < limit
    assert "is not back" in str(told(source)[0])
    # The same name from elsewhere is somebody else's.
    other = outlet(name, points_of(["A"], "m"), identity="another")
    back = outlet(name, points_of(["A", "B"], "m"), identity="mine")
    sending = threading.Event()

    def send() -> None:
        while not sending.wait(0.01):
            other.push_sample([9.0, 9.0, 9.0])
            back.push_sample([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])

    thread = threading.Thread(target=send)
    thread.start()
    after = taken(source, 2)
    sending.set()
    thread.join()
    source.close()
    assert after[0].points.tolist() == [[1, 2, 3], [4, 5, 6]] and after[0].names == ("A", "B"), "its channels are read anew"
    assert after[0].number > before.number
    (finding,) = told(source)
    assert finding.code == "live-reconnected" and "once" in finding.sentence


def test_a_sender_that_lost_its_power_is_left_for_the_one_that_took_its_place(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("asterism.live.lsl_source._SILENT", 0.05)
    silent = outlet(name, points_of(["A"], "m"), identity="mine")
    source = opened(f"lsl://{name}")
    again = outlet(name, points_of(["A"], "m"), identity="mine")
    # No goodbye came of the first one, and it does not answer who looks for it.
    (found,) = (info for info in pylsl.resolve_byprop("name", name, 2, LONG) if info.uid() != source._stream.info.uid())  # type: ignore[union-attr]
    monkeypatch.setattr(source, "_visible", lambda: [found])
    limit = time.monotonic() + LONG
    while not told(source):
        assert source.read(0.05) is None and time.monotonic() < limit
    # opened anew within the next reads, after which samples come
    came: list[LiveFrame] = []
    while not came and time.monotonic() < limit:
        again.push_sample([4.0, 5.0, 6.0])
        came += [] if (read := source.read(0.05)) is None else [read]
    source.close()
    assert came[0].points.tolist() == [[4, 5, 6]] and "made again" in told(source)[0].sentence
    del silent


def test_two_streams_of_one_name_are_told_apart_by_the_person(name: str) -> None:
    one, two = outlet(name, points_of(["A"], "m"), identity="one"), outlet(name, points_of(["A"], "m"), identity="two")
    belongs = outlet(name, [{"label": "speed"}] * 3, kind="Misc")
    with pytest.raises(AsterismError, match=r"2 streams, which are never mixed: .*source_id (one|two).*source_id=ID"):
        open_source(f"lsl://{name}")
    source = opened(f"lsl://?name={name}&source_id=two&type=mocap")
    for at in range(3):
        one.push_sample([1.0, 1.0, 1.0], at + 1.0)
        two.push_sample([2.0, 2.0, 2.0], at + 1.0)
    assert {frame.points[0, 0] for frame in taken(source, 3)} == {2.0}
    source.close()
    del belongs


def test_what_is_no_motion_capture_is_refused(name: str) -> None:
    eeg = outlet(name, [{"label": each, "type": "EEG", "unit": "microvolts"} for each in ("Fp1", "Fp2", "Cz")], kind="EEG")
    with pytest.raises(AsterismError, match="3 channels, and they are no places of markers"):
        open_source(f"lsl://{name}?type=eeg")
    with pytest.raises(AsterismError, match="colour means nothing there"):
        open_source(f"lsl://{name}?colour=red")
    with pytest.raises(AsterismError, match="names no stream"):
        open_output("lsl://", SourceAbout("given", 100.0))
    del eeg


def test_a_stream_without_a_word_is_read_in_triples_in_the_unit_of_a_body(name: str) -> None:
    rng = np.random.default_rng(0)
    body = 1000.0 * rng.normal((0.5, 1.0, 0.9), (0.2, 0.2, 0.45), (12, 3))
    sender, done = outlet(name, [{}] * 36, rate=0.0, form="double64"), threading.Event()

    def send() -> None:
        while not done.wait(0.01):
            sender.push_sample(body.ravel().tolist())

    thread = threading.Thread(target=send)
    thread.start()
    source = opened(f"lsl://{name}")
    came = taken(source, 40)
    done.set()
    thread.join()
    source.close()
    np.testing.assert_allclose(came[0].points, body / 1000)
    assert [frame.number for frame in came] == list(range(40))
    assert codes(source) == {"live-unit-assumed", "live-channels-assumed", "live-irregular"}
    assert any("read as mm" in str(finding) for finding in source.findings())


def test_a_unit_that_cannot_be_and_a_name_that_is_taken_are_told(name: str) -> None:
    body = 1000 * np.random.default_rng(0).normal((0.5, 1.0, 0.9), (0.2, 0.2, 0.45), (12, 3))
    sender = outlet(name, points_of([f"M{n}" for n in range(12)], "meters"))
    source = opened(f"lsl://{name}")
    sender.push_sample(body.ravel().tolist())
    taken(source, 1)
    source.close()
    (finding,) = told(source)
    assert finding.code == "live-unit-doubtful" and "probably mm" in finding.sentence
    first = open_output(f"lsl://{name}", SourceAbout("given", 100.0))
    with pytest.raises(AsterismError, match="another session on this machine"):
        open_output(f"lsl://{name}", SourceAbout("given", 100.0))
    first.close()


def test_a_counter_numbers_the_frames_until_it_stands_still(name: str) -> None:
    sender = outlet(name, [{"label": "FrameNumber"}, *points_of(["A"], "m")])
    source = opened(f"lsl://{name}")
    begin = pylsl.local_clock()
    for n, count in enumerate([70, 71, 74, 74, 75] + [75] * 8):
        sender.push_sample([count, 1.0, 1.0, 1.0], begin + n / 100)
    numbers = [frame.number for frame in taken(source, 13)]
    source.close()
    assert numbers[:3] == [70, 71, 74] and numbers[4] == 75 and numbers[-3:] == list(range(numbers[-3], numbers[-3] + 3))
    assert codes(source) == {"live-counter"}


def test_a_clock_that_is_set_back_gives_no_gap_and_real_gaps_are_seen_through_bad_stamps() -> None:
    numbers = SampleNumbers(100.0)
    times = np.concatenate([np.arange(500) / 100, np.arange(500) / 100 - 3600])
    assert [numbers.next(at, n / 100) for n, at in enumerate(times)] == list(range(1000)) and numbers.jumps == 1
    rng = np.random.default_rng(1)
    kept = rng.random(20_000) > 0.01
    kept[0] = True
    for rate, noise in ((100.0, 0.0), (99.9, 0.02), (100.0, 0.1)):
        numbers = SampleNumbers(100.0)
        stamps = np.arange(20_000)[kept] / rate + rng.normal(0, noise / rate, kept.sum())
        said = [numbers.next(at, at) for at in stamps]
        assert np.all(np.diff(said) > 0)
        assert said[-1] + 1 - len(said) == pytest.approx((~kept).sum(), abs=0.2 * (~kept).sum() if noise > 0.05 else 4)
        assert numbers.spread == pytest.approx(noise, abs=0.03) and numbers.late < 5
    # Stamps of a busy sender, four at a time, are no losses.
    numbers = SampleNumbers(100.0)
    said = [numbers.next(at, at) for at in np.repeat(np.arange(2000) * 0.04, 4)]
    assert said[-1] + 1 - len(said) < 0.01 * len(said) and numbers.spread > 1
    assert not numbers.is_off
    # A sender that stops for a while and catches up stamps no gap that nothing explains.
    numbers, free, stamps = SampleNumbers(200.0), 0.0, list[float]()
    for due in np.arange(20_000) / 200:
        free = max(due, free) + 0.0003 + (rng.exponential(0.05) if rng.random() < 0.01 else 0.0)
        stamps.append(free)
    said = [numbers.next(at, at) for at in stamps]
    counted = said[-1] + 1 - len(said)
    assert 0.6 * counted < numbers.late <= counted and not numbers.is_off
    # A sender that is slower than it says is told.
    numbers = SampleNumbers(100.0)
    said = [numbers.next(at, at) for at in np.arange(1000) / 60]
    assert numbers.is_off and numbers.measured_rate == pytest.approx(60) and said[-1] == pytest.approx(1665, abs=20)


def test_a_clock_that_was_really_set_back_is_played_through_an_outlet(name: str) -> None:
    xdf = pytest.importorskip("pyxdf", reason="pyxdf is not installed")
    path = Path(os.environ.get("ASTERISM_DATA", "")) / "live" / "xdf" / "clock_resets.xdf"
    if "ASTERISM_DATA" not in os.environ or not path.exists():
        pytest.skip("ASTERISM_DATA with live/xdf is needed")
    (played,), _ = xdf.load_xdf(str(path), select_streams=[{"type": "EEG"}], synchronize_clocks=False, dejitter_timestamps=False)
    at = int(np.argmin(np.diff(played["time_stamps"])))
    times, values = played["time_stamps"][at - 60 : at + 60], played["time_series"][at - 60 : at + 60, :6]
    assert np.diff(times).min() < -600_000
    sender = outlet(name, points_of(["A", "B"], "m"), float(played["info"]["nominal_srate"][0]))
    source = opened(f"lsl://{name}")
    for sample, stamp in zip(values.tolist(), times.tolist(), strict=True):
        sender.push_sample(sample, stamp)
    numbers = [frame.number for frame in taken(source, 120)]
    source.close()
    assert source._numbers.jumps == 1 and numbers[60] == numbers[59] + 1
    assert np.all(np.diff(numbers) > 0) and numbers[-1] < 140, "the device has 92 samples/s and says 100"


def test_labels_values_and_events_go_out_and_can_be_read_again(name: str) -> None:
    output = open_output(f"lsl://{name}", SourceAbout("given", 100.0))
    markers, rule = ("LASI", "RASI", "SACR"), FeedbackRule("squat depth", "height", ("SACR",), below=0.4)
    points = np.array([[0.1, 0.2, 0.9], [0.3, 0.2, 0.9]])

    def frame(n: int, on: bool) -> AnalysedFrame:
        now = time.monotonic()
        labelled = LabelledFrame(LiveFrame(n, 5.0 + n / 100, now, points), markers, np.array([1, -1, 0]), np.array([0.9, 0.1, 0.8]), now)
        events = (LiveEvent("heel strike", "left", 5.0, 0.03),) if n == 3 else ()
        analysis = FrameAnalysis({"left knee flexion": 60.0 + n, "right knee flexion": np.nan}, {"left knee flexion": "degrees"}, events)
        return AnalysedFrame(labelled, analysis, (Cue(rule, 0.3, on, on and n == 2, np.nan),))

    output.send(frame(0, False))
    source = opened(f"lsl://{name}?type=MoCap")
    found = {info.name(): pylsl.StreamInlet(info) for info in pylsl.resolve_bypred(f"starts-with(name,'{name} ')", 2, LONG)}
    values, texts = found[f"{name} values"], found[f"{name} events"]
    for inlet in (values, texts):
        inlet.open_stream(LONG)
    for n in range(1, 5):
        output.send(frame(n, n > 1))
    came = taken(source, 4)
    assert came[0].names == ("LASI", "SACR"), "what is not seen is NaN, and its confidence is none of its coordinates"
    np.testing.assert_allclose(came[0].points, points[[1, 0]], atol=1e-6)
    assert [frame.number for frame in came] == [0, 1, 2, 3]
    assert all(abs(frame.time - time.monotonic()) < LONG for frame in came), "stamps are on this machine's clock"
    assert values.info(LONG).get_channel_labels() == ["left knee flexion", "right knee flexion"]
    assert values.info(LONG).get_channel_units()[0] == "degrees"
    assert values.pull_sample(LONG)[0][0] == 61.0
    said = [texts.pull_sample(LONG) for _ in range(2)]
    assert [text for (text,), _ in said] == ["squat depth on", "left heel strike"]
    # the event of frame 3 happened three frames before it
    assert said[1][1] < said[0][1]
    assert printed_by_receiver("Lab Streaming Layer out", output.send, ("Asterism values", f"{name} values"))[1] == KNEE
    source.close()
    output.close()
    assert source.read(0.0) is None


def test_channels_are_read_by_what_is_said_of_them() -> None:
    body = [*points_of(["Hand"], "meters", of="object"), *({"object": "Hand", "type": f"Orientation{each}"} for each in "ABCD")]
    layout = layout_of_channels([*body, *points_of(["A", "A"])], 13)
    assert layout is not None and layout.columns.tolist() == [[7, 8, 9], [10, 11, 12]] and layout.bodies == 1
    assert layout_of_channels(body, 7) is None, "a body is no marker"
    labels = layout_of_channels([{"label": f"{name}{axis}"} for name in ("head.", "foot.") for axis in "zyx"], 6)
    assert labels is not None and labels.columns.tolist() == [[2, 1, 0], [5, 4, 3]] and labels.names == ("head", "foot")
    before = layout_of_channels([{"label": f"{axis}.{name}", "type": f"Position{axis}"} for axis in "xyz" for name in ("head", "x")], 6)
    assert before is not None and before.columns.tolist() == [[0, 2, 4], [1, 3, 5]] and before.names == ("head", "x")
    alone = layout_of_channels(points_of(["Ball"], "m", of="object"), 3)
    assert alone is not None and alone.names == ("Ball",), "an object without an orientation is a point"
    mouse = [{"label": f"Mouse{axis}", "type": f"Position{axis}", "unit": "pixels"} for axis in "XY"]
    assert layout_of_channels([*mouse, {"label": "buttons", "type": "Buttons"}], 3) is None
    assert layout_of_channels([], 7) is None and layout_of_channels([{"label": "frame"}], 7) is not None
    assert StreamChoice.of("lsl://?type=MoCap").fits({"type": "mocap"}) and not StreamChoice.of("lsl://Walk").fits({"name": "walk"})
