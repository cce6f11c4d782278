"""Blobs of several cameras as they come in; frames of points out."""

from asterism.live.blobs.rig_health import RigCameraHealth
from asterism.live.blobs.rig_process import RigProcess
from asterism.live.blobs.rig_source import RigSource
from asterism.live.blobs.sources import JsonBlobs, ReplayBlobs, blobs_as_json, blobs_of_json

__all__ = ["JsonBlobs", "ReplayBlobs", "RigCameraHealth", "RigProcess", "RigSource", "blobs_as_json", "blobs_of_json"]
