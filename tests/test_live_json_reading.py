"""JSON of a sender means the same whether orjson is installed or not."""

import math

import pytest

from asterism.live import json_reading
from asterism.live.blobs import blobs_of_json
from asterism.live.datagrams import frame_of_json, why_damaged

ODD = [
    b"NaN", b"-Infinity", b"1e400", b"-0", b"18446744073709551616", b"1" + b"0" * 400,
    b'"\\ud800"', b'"\xed\xa0\x80"', b"01", b"[" * 3000 + b"]" * 3000,
    b'{"a":1,"a":2}', b"\xef\xbb\xbf1", b'"\x01"', b"[1,]",
]  # fmt: skip


@pytest.mark.parametrize("place", ["camera", "frame", "time", "blobs", "points", "other"])
def test_messages_are_taken_and_refused_alike(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("orjson")
    fields = {"camera": b'"c"', "frame": b"1", "time": b"0.5", "blobs": b"[[1,2]]", "points": b"[[1,2,3]]", "other": b"0"}
    messages = []
    for odd in ODD:
        value = b"[[1," + odd + b"]]" if place == "blobs" else b"[[1,2," + odd + b"]]" if place == "points" else odd
        messages.append(b"{" + b",".join(b'"%s":%s' % (name.encode(), text) for name, text in {**fields, place: value}.items()) + b"}")

    def read() -> list[tuple[object, ...]]:
        blobs = [blobs_of_json(message, 0.0) for message in messages]
        said = [None if each is None else (each.camera, each.number, each.time, each.xy.tolist()) for each in blobs]
        return list(zip(said, map(why_damaged, messages), strict=True))

    with_orjson = read()
    monkeypatch.setattr(json_reading, "_quick_loads", None)
    assert with_orjson == read()


def test_what_orjson_refuses_is_read_by_the_standard_library() -> None:
    assert json_reading.json_of(b'[NaN, "\\ud800"]')[1] == "\ud800"
    assert math.isnan(json_reading.json_of(b"[NaN]")[0])
    with pytest.raises(ValueError):
        json_reading.json_of(b"[1,]")


def test_programs_that_know_floats_alone_are_read() -> None:
    frame = frame_of_json(b'{"frame":12.0,"time":1.0,"points":[[1.0,2.0,3.0]]}', 0.0)
    blobs = blobs_of_json(b'{"camera":3.0,"frame":12.0,"time":1.0,"blobs":[[1.0,2.0]]}', 0.0)
    assert frame is not None and frame.number == 12 and type(frame.number) is int
    assert blobs is not None and (blobs.camera, blobs.number) == ("3", 12) and type(blobs.number) is int
    for number in (b"12.5", b"1e17", b"1e400"):
        assert frame_of_json(b'{"frame":' + number + b',"time":1.0,"points":[]}', 0.0) is None
