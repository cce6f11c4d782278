"""A rig and a volume in; out come its accuracy, sensitivity and repeatability, place by place (thesis 3.3), and better rigs (3.2.2)."""

from asterism.cameras.accuracy.checks import check_map
from asterism.cameras.accuracy.maps import RigMap, map_rig
from asterism.cameras.accuracy.measured import WandAccuracy, repeatability, wand_accuracy
from asterism.cameras.accuracy.sensitivity import Sensitivity, covariance, information, sees, sensitivity
from asterism.cameras.accuracy.volume import Volume, lines_of_sight_meet, volume_of

__all__ = [
    "RigMap",
    "Sensitivity",
    "Volume",
    "WandAccuracy",
    "check_map",
    "covariance",
    "information",
    "lines_of_sight_meet",
    "map_rig",
    "repeatability",
    "sees",
    "sensitivity",
    "volume_of",
    "wand_accuracy",
]
