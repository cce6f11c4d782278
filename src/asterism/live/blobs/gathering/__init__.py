"""Blobs as they come from each camera in; frames of all cameras, in their order and as soon as they are whole, out."""

from asterism.live.blobs.gathering.arrivals import LONGEST_WAIT, CameraArrivals, RigFrame
from asterism.live.blobs.gathering.by_number import ByNumber
from asterism.live.blobs.gathering.by_time import ByTime

__all__ = ["LONGEST_WAIT", "ByNumber", "ByTime", "CameraArrivals", "RigFrame"]
