"""The thesis' composition and merging, frame by frame on flat arrays: the baseline that `method="plain"` names."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.geometry._kernels import symmetric_inverse
from asterism.reconstruction._fit_kernels import add_ray, closest_point, fit, fit_workspace, set_zero
from asterism.reconstruction._frame_kernels import write_point
from asterism.reconstruction._input_kernels import END, FEWEST, FIRST, GATE, NOISE, frame_arrays, inside_volume
from asterism.reconstruction._order_kernels import ascending


@kernel
def reconstruct_frame_plain(rig, rays, frame_number, out):
    """One frame by algorithms 3.1 and 3.2: no triangulation from all rays, and a blob may show many points.

    IN  rays RayArrays
    OUT out PointArrays; blobs are counted over all frames
    Returns the points merged and the versions composed; where these are more than `out` has room for, nothing useful is written.
    O(all pairs of blobs, versions * points). Twin: tests/twins_reconstruction.py
    """
    cameras = len(rig.cameras)
    first = rays.offsets[frame_number * cameras : (frame_number + 1) * cameras + 1] - rays.offsets[frame_number * cameras]
    here = rays.offsets[frame_number * cameras]
    frame = frame_arrays(rays.normalised[here : here + first[cameras]], rays.jacobian[here : here + first[cameras]], first)
    spreads = np.empty(len(out.points))
    versions = _compose_pairs(rig, frame, out.rays, out.points, spreads)
    if versions > len(out.points):
        return 0, versions
    groups = merge_versions(out.rays, out.points, spreads, versions, rig.limits[GATE] ** 2)
    work, one = fit_workspace(), np.empty(cameras, np.int64)
    kept = 0
    for n in range(groups):
        many, pixels = 0, 0.0
        set_zero(work.information)
        work.point[:] = out.points[n]
        for c in range(cameras):
            one[c] = out.rays[n, c]
            if one[c] >= 0:
                many += 1
                pixels += add_ray(rig, frame, c, one[c], work) * rig.cameras[c, NOISE] ** 2
        determinant = symmetric_inverse(work.information)[0]
        if many >= rig.limits[FEWEST] and determinant > 0.0 and pixels < np.inf:
            write_point(rig, frame, one, here, work, out, kept)
            kept += 1
    return kept, versions


@kernel
def _compose_pairs(rig, frame, rays, points, spreads):
    """Algorithm 3.1: every pair of blobs of every pair of cameras whose rays meet within the sensitivity.

    OUT rays (n, C), points (n, 3) m, spreads (n,) m2, the trace of each point's covariance
    Returns how many there are; the arrays are filled as far as they reach. O(all pairs of blobs).
    """
    one, work = np.empty(len(rig.cameras), np.int64), fit_workspace()
    limit = rig.limits[GATE] ** 2
    count = 0
    for pair in range(len(rig.pairs)):
        a, b = rig.pairs[pair, 0], rig.pairs[pair, 1]
        for i in range(int(frame.grid[a, FIRST]), int(frame.grid[a, END])):
            for j in range(int(frame.grid[b, FIRST]), int(frame.grid[b, END])):
                if not closest_point(rig, frame, pair, i, j, work.point):
                    continue
                one[:] = -1
                one[a], one[b] = i, j
                square = fit(rig, frame, one, work, 1)[0]
                if not (square <= limit and inside_volume(rig, work.point)):
                    continue
                if count < len(points):
                    _, i0, _, _, i3, _, i5 = symmetric_inverse(work.information)
                    rays[count], points[count], spreads[count] = one, work.point, i0 + i3 + i5
                count += 1
    return count


@kernel
def merge_versions(rays, points, spreads, count, limit):
    """Algorithm 3.2: versions of a point nearer than the sensitivity and without different blobs of one camera become one.

    As printed, every pair of versions gives a point of its own; here each version joins the nearest group it may, so that, as the text
    asks, there is only one. The group's place is the mean of its versions.

    IN  spreads (n,) m2; count: of versions; limit: the squared distance, in units of the summed spreads, below which versions are one
    OUT rays (n, C), points (n, 3) m: groups are written over the versions
    Returns how many groups there are. O(versions * groups). Twin: tests/twins_reconstruction.py
    """
    groups = 0
    members = np.empty(count, np.int64)
    out_rays, out_points, out_spreads = np.empty_like(rays[:count]), np.empty_like(points[:count]), np.empty(count)
    for n in ascending(spreads, count):
        nearest, group = np.inf, -1
        for k in range(groups):
            square = 0.0
            for axis in range(3):
                square += (points[n, axis] - out_points[k, axis]) ** 2
            if square >= nearest or square >= limit * (spreads[n] + out_spreads[k]):
                continue
            if _are_compatible(rays[n], out_rays[k]):
                nearest, group = square, k
        if group < 0:
            out_rays[groups], out_points[groups], out_spreads[groups], members[groups] = rays[n], points[n], spreads[n], 1
            groups += 1
            continue
        members[group] += 1
        out_points[group] += (points[n] - out_points[group]) / members[group]
        for c in range(rays.shape[1]):
            out_rays[group, c] = max(out_rays[group, c], rays[n, c])
    rays[:groups], points[:groups] = out_rays[:groups], out_points[:groups]
    return groups


@kernel
def _are_compatible(rays, others):
    """Returns whether no camera has different blobs in two rows of rays (C,). O(C)."""
    compatible = True
    for c in range(len(rays)):
        compatible = compatible and (rays[c] < 0 or others[c] < 0 or rays[c] == others[c])
    return compatible
