"""Arrays in; rotations, rigid motions, ray intersections and small matrices out.

Points are rows (..., 3) in metres. A rotation R (3, 3) acts as R @ point, for rows as points @ R.T. Kernels for other rooms are in
`geometry.shared_kernels`.
"""

from asterism.geometry.rays import intersect_rays, nearest_point_to_lines
from asterism.geometry.rigid import align_about_z, best_rotation, fit_rigid, place_objects
from asterism.geometry.rotations import (
    axis_rotations,
    cross_matrix,
    nearest_orthogonal,
    rotate_z_up,
    rotation_from_vector,
    vector_from_rotation,
    z_up_rotation,
)

__all__ = [
    "align_about_z",
    "axis_rotations",
    "best_rotation",
    "cross_matrix",
    "fit_rigid",
    "intersect_rays",
    "nearest_orthogonal",
    "nearest_point_to_lines",
    "place_objects",
    "rotate_z_up",
    "rotation_from_vector",
    "vector_from_rotation",
    "z_up_rotation",
]
