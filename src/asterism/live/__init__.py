"""Frames from cameras and streams while they come in; labels, and what follows from them, at once, out."""

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
