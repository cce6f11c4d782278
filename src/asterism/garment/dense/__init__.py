"""Circles that cameras read on a garment in; points with identities, their covariance and their trajectories out (GaMoCap 2.2)."""

from asterism.garment.dense.points import Circles, DensePoints, DenseRules, dense_points, fused_midpoints

__all__ = ["Circles", "DensePoints", "DenseRules", "dense_points", "fused_midpoints"]
