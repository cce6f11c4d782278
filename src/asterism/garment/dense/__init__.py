"""Circles that cameras read on a garment in; points with identities, their covariance and their trajectories out (GaMoCap 2.2)."""

from asterism.garment.dense.points import DensePoints, DenseRules, UsedCircles, dense_points, fused_midpoints
from asterism.garment.dense.trajectories import DenseTrajectories, dense_trajectories

__all__ = [
    "DensePoints",
    "DenseRules",
    "DenseTrajectories",
    "UsedCircles",
    "dense_points",
    "dense_trajectories",
    "fused_midpoints",
]
