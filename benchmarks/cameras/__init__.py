"""The issue about cameras (calibrate, detect, compose, merge): one function per row of its table."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.cameras.accuracy import accuracy, plan
from benchmarks.cameras.boards import charuco, rig_files, stereo
from benchmarks.cameras.demo import demo
from benchmarks.cameras.detection import centroids, detection, particles
from benchmarks.cameras.matches import matches
from benchmarks.cameras.reconstruction import ghosts, speed
from benchmarks.cameras.refine import refine
from benchmarks.cameras.walk import walk
from benchmarks.cameras.wand import real_wand, wand, wand_rigs
from benchmarks.cameras.wand_peer import wand_peer
from benchmarks.figures import Figure

ISSUE = "From cameras to points: calibrate, detect, compose, merge"

ROWS: dict[str, Callable[[BenchmarkRun], Iterator[Figure]]] = {
    "rig-files": rig_files,
    "stereo": stereo,
    "charuco": charuco,
    "accuracy": accuracy,
    "plan": plan,
    "detection": detection,
    "centroids": centroids,
    "particles": particles,
    "points-speed": speed,
    "ghosts": ghosts,
    "matches": matches,
    "vicon-rig-walk": walk,
    "demo": demo,
    "real-wand": real_wand,
    "wand": wand,
    "wand-peer": wand_peer,
    "refine": refine,
    "wand-rigs": wand_rigs,
}
"""Cheap rows first: a run that is cut short has measured most of them."""
