"""Frames from cameras and streams while they come in; labels, and what follows from them, at once, out."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from asterism.live.analysis import AnalysedFrame, FrameAnalysis, LiveAnalysis, LiveEvent
    from asterism.live.angles import AngleOptions
    from asterism.live.blobs import RigSource
    from asterism.live.chain import LabelChain, LabelledFrame, OfModel, make_labeller
    from asterism.live.clock import FrameCount, SourceClock
    from asterism.live.cues import Cue, FeedbackRule
    from asterism.live.datagrams import HostPort, JsonDatagrams, frame_as_json, frame_of_json
    from asterism.live.feedback import Feedback, example_names, load_feedback
    from asterism.live.frames import LiveFrame, LiveSource, OfCameras, SourceAbout, SourceEnded
    from asterism.live.movement import MovementAnalysis
    from asterism.live.outputs import InOwnThread, ToDatagrams, ToLines, labels_as_json
    from asterism.live.recording import KeptSession, LiveRecorder, recording_of
    from asterism.live.replay import Replay
    from asterism.live.reporting import WithFindings, own_findings, session_findings
    from asterism.live.running import Health, LiveOutput, LiveSession
    from asterism.live.sending import open_output, open_outputs
    from asterism.live.sources import host_port, open_source
    from asterism.live.watch import SessionWatch

__all__ = [
    "AnalysedFrame",
    "AngleOptions",
    "Cue",
    "Feedback",
    "FeedbackRule",
    "FrameAnalysis",
    "FrameCount",
    "Health",
    "HostPort",
    "InOwnThread",
    "JsonDatagrams",
    "KeptSession",
    "LabelChain",
    "LabelledFrame",
    "LiveAnalysis",
    "LiveEvent",
    "LiveFrame",
    "LiveOutput",
    "LiveRecorder",
    "LiveSession",
    "LiveSource",
    "MovementAnalysis",
    "OfCameras",
    "OfModel",
    "Replay",
    "RigSource",
    "SessionWatch",
    "SourceAbout",
    "SourceClock",
    "SourceEnded",
    "ToDatagrams",
    "ToLines",
    "WithFindings",
    "example_names",
    "frame_as_json",
    "frame_of_json",
    "host_port",
    "labels_as_json",
    "load_feedback",
    "make_labeller",
    "open_output",
    "open_outputs",
    "open_source",
    "own_findings",
    "recording_of",
    "session_findings",
]

_MODULE_OF = {
    **dict.fromkeys(("AnalysedFrame", "FrameAnalysis", "LiveAnalysis", "LiveEvent"), "analysis"),
    "AngleOptions": "angles",
    "RigSource": "blobs",
    **dict.fromkeys(("LabelChain", "LabelledFrame", "OfModel", "make_labeller"), "chain"),
    **dict.fromkeys(("FrameCount", "SourceClock"), "clock"),
    **dict.fromkeys(("Cue", "FeedbackRule"), "cues"),
    **dict.fromkeys(("HostPort", "JsonDatagrams", "frame_as_json", "frame_of_json"), "datagrams"),
    **dict.fromkeys(("Feedback", "example_names", "load_feedback"), "feedback"),
    **dict.fromkeys(("WithFindings", "own_findings", "session_findings"), "reporting"),
    **dict.fromkeys(("LiveFrame", "LiveSource", "OfCameras", "SourceAbout", "SourceEnded"), "frames"),
    "MovementAnalysis": "movement",
    **dict.fromkeys(("InOwnThread", "ToDatagrams", "ToLines", "labels_as_json"), "outputs"),
    **dict.fromkeys(("KeptSession", "LiveRecorder", "recording_of"), "recording"),
    "Replay": "replay",
    **dict.fromkeys(("Health", "LiveOutput", "LiveSession"), "running"),
    **dict.fromkeys(("open_output", "open_outputs"), "sending"),
    **dict.fromkeys(("host_port", "open_source"), "sources"),
    "SessionWatch": "watch",
}


def __getattr__(name: str) -> Any:
    """Import a name when it is first used: the processes that read cameras or make points need no labelling, and start in half the time."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return value
