"""Cameras behind one interface: webcams, machine vision cameras, videos played at their own rate, and simulated ones."""

from asterism.live.cameras.camera import CameraAbout, CameraGone, LiveCamera
from asterism.live.cameras.group import CameraGroup
from asterism.live.cameras.health import CameraHealth, CameraWatch, camera_findings
from asterism.live.cameras.opening import CameraSpec, open_camera
from asterism.live.cameras.rig_file import load_cameras, save_cameras, with_settings
from asterism.live.cameras.settings import SETTINGS, SettingOutcome, SettingValue, parse_setting

__all__ = [
    "SETTINGS",
    "CameraAbout",
    "CameraGone",
    "CameraGroup",
    "CameraHealth",
    "CameraSpec",
    "CameraWatch",
    "LiveCamera",
    "SettingOutcome",
    "SettingValue",
    "camera_findings",
    "load_cameras",
    "open_camera",
    "parse_setting",
    "save_cameras",
    "with_settings",
]
