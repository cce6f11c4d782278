"""The programs of docs/live-outputs.md that receive labelled frames, run as they stand until they print something."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from asterism.live import AnalysedFrame, FrameAnalysis, LabelledFrame, LiveFrame

ENDLESS = "# Ctrl-C ends it.\n"
"""The first line of a program of the pages that does not end by itself."""
PAGE = Path(__file__).parent.parent / "docs" / "live-outputs.md"
KNEE = 61.5
"""The angle of the frames that are sent, degrees."""


class _Printed(BaseException):
    """Ends a receiver; no Exception, which servers catch."""


def free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def printed_by_receiver(heading: str, send: Callable[[AnalysedFrame], None], *names: tuple[str, str]) -> tuple[Any, ...]:
    """What the receiver below a heading prints first, while frames are sent; names: (as on the page, instead), such as ports."""
    section = PAGE.read_text(encoding="utf-8").partition(f"## {heading}\n")[2].partition("\n## ")[0]
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", section, re.DOTALL) if block.startswith(ENDLESS))
    for name, instead in names:
        assert name in code
        code = code.replace(name, instead)
    points = np.array([[0.5, 0.25, 0.125], [1.0, 2.0, 3.0]])
    labelled = LabelledFrame(LiveFrame(7, 2.5, 1.0, points), ("LKNE",), np.array([0]), np.array([0.75]), done=1.001)
    frame = AnalysedFrame(labelled, FrameAnalysis({"left knee flexion": KNEE}, {"left knee flexion": "degrees"}))
    ended, came = threading.Event(), list[tuple[Any, ...]]()

    def go_on() -> None:
        while not ended.wait(0.01):
            send(frame)

    def printed(*words: Any) -> NoReturn:
        came.append(words)
        raise _Printed

    sender = threading.Thread(target=go_on)
    sender.start()
    try:
        exec(compile(code, f"{PAGE.name}, {heading}", "exec"), {"print": printed})
    except _Printed:
        pass
    finally:
        ended.set()
        sender.join()
    return came[0]
