"""Circles that cameras read on a garment in; points with identities, their covariance and their trajectories out (GaMoCap 2.2)."""

from asterism.garment.dense.points import Circles, DensePoints, DenseRules, dense_points, fused_midpoints
from asterism.garment.dense.trajectories import DenseTrajectories, dense_trajectories

__all__ = [
    "Circles",
    "DensePoints",
    "DenseRules",
    "DenseTrajectories",
    "dense_points",
    "dense_trajectories",
    "fused_midpoints",
]
