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
    from asterism.live.found import WithFindings, own_findings, session_findings
    from asterism.live.frames import LiveFrame, LiveSource, OfCameras, SourceAbout, SourceEnded
    from asterism.live.movement import MovementAnalysis
    from asterism.live.outputs import InOwnThread, ToDatagrams, ToLines, labels_as_json
    from asterism.live.recording import KeptSession, LiveRecorder, recording_of
    from asterism.live.replay import Replay
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

_MODULES = {
    "analysis": "AnalysedFrame FrameAnalysis LiveAnalysis LiveEvent",
    "angles": "AngleOptions",
    "blobs": "RigSource",
    "chain": "LabelChain LabelledFrame OfModel make_labeller",
    "clock": "FrameCount SourceClock",
    "cues": "Cue FeedbackRule",
    "datagrams": "HostPort JsonDatagrams frame_as_json frame_of_json",
    "feedback": "Feedback example_names load_feedback",
    "found": "WithFindings own_findings session_findings",
    "frames": "LiveFrame LiveSource OfCameras SourceAbout SourceEnded",
    "movement": "MovementAnalysis",
    "outputs": "InOwnThread ToDatagrams ToLines labels_as_json",
    "recording": "KeptSession LiveRecorder recording_of",
    "replay": "Replay",
    "running": "Health LiveOutput LiveSession",
    "sending": "open_output open_outputs",
    "sources": "host_port open_source",
    "watch": "SessionWatch",
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a name when it is first used: the processes that read cameras or make points need no labelling, and start in half the time."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'asterism.live' has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value
