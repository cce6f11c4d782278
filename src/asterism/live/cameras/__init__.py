"""Cameras behind one interface: webcams, machine vision cameras, videos played at their own rate, and simulated ones."""

from asterism.live.cameras.camera import CameraAbout, CameraGone, LiveCamera
from asterism.live.cameras.opening import CameraSpec, open_camera
from asterism.live.cameras.settings import SETTINGS, SettingOutcome, SettingValue, parse_setting

__all__ = [
    "SETTINGS",
    "CameraAbout",
    "CameraGone",
    "CameraSpec",
    "LiveCamera",
    "SettingOutcome",
    "SettingValue",
    "open_camera",
    "parse_setting",
]
