"""The thesis' composition and merging, frame by frame on flat arrays: the baseline that `method="plain"` names.

`method="plain-covariance"` differs in the distance up to which two versions are one point.
"""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel
from asterism.cameras.accuracy.jacobian_kernels import pixel_jacobians
from asterism.geometry.shared_kernels import symmetric_inverse
from asterism.reconstruction._fit_kernels import add_ray, closest_point, fit, fit_workspace, set_zero
from asterism.reconstruction._frame_kernels import write_point
from asterism.reconstruction._input_kernels import END, FEWEST, FIRST, GATE, LENS, NOISE, frame_arrays, inside_volume
from asterism.reconstruction._order_kernels import ascending


@kernel
def reconstruct_frame_plain(rig, rays, frame_number, by_covariance, out):
    """One frame by algorithms 3.1 and 3.2: no triangulation from all rays, and a blob may show many points.

    IN  rays RayArrays; by_covariance: see `merge_versions`
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
    # The caller comes again with more room.
    if versions > len(out.points):
        return 0, versions
    groups = merge_versions(rig, out.rays, out.points, spreads, versions, by_covariance)
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

    Bounds: what does not fit is counted and not written; the caller comes again with more room.
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
                # Counted on without being written: so the caller learns how much room it takes.
                if count < len(points):
                    _, i0, _, _, i3, _, i5 = symmetric_inverse(work.information)
                    rays[count], points[count], spreads[count] = one, work.point, i0 + i3 + i5
                count += 1
    return count


@kernel
def merge_versions(rig, rays, points, spreads, count, by_covariance):
    """Algorithm 3.2: versions of a point nearer than the sensitivity and without different blobs of one camera become one.

    As printed, every pair of versions gives a point of its own; here each version joins the nearest group it may, so that, as the text
    asks, there is only one. The group's place is the mean of its versions. Versions are near if they are nearer than S, the mean of the
    effective sensitivities that the cameras of both, of a group those of its first version, have in the middle between both (the thesis
    does not say which cameras S is of). Versions come in the order of composition.

    IN  spreads (n,) m2; count: of versions
        by_covariance: near are versions within GATE deviations, by the sum of both spreads; those with the least spread come first
    OUT rays (n, C), points (n, 3) m: groups are written over the versions
    Returns how many groups there are. O(versions * groups * C). Twin: tests/twins_reconstruction.py

    Bounds: there are no more groups than versions.
    """
    groups = 0
    members, first = np.empty(count, np.int64), np.empty(count, np.int64)
    out_rays, out_points = np.empty_like(rays[:count]), np.empty_like(points[:count])
    middle, slopes = np.empty((1, 3)), np.empty((2, 1, 2, 3))
    # The least spread first, so that a group's first version is its best.
    for n in ascending(spreads, count) if by_covariance else np.arange(count):
        nearest, group = np.inf, -1
        for k in range(groups):
            square = 0.0
            for axis in range(3):
                square += (points[n, axis] - out_points[k, axis]) ** 2
                middle[0, axis] = (points[n, axis] + out_points[k, axis]) / 2.0
            # Only a nearer group can win.
            if square >= nearest or not _are_compatible(rays[n], out_rays[k]):
                continue
            if by_covariance:
                limit = rig.limits[GATE] ** 2 * (spreads[n] + spreads[first[k]])
            else:
                both = _sensitivity(rig, rays[n], middle, slopes) + _sensitivity(rig, rays[first[k]], middle, slopes)
                limit = (both / 2.0) ** 2
            if square < limit:
                nearest, group = square, k
        if group < 0:
            out_rays[groups], out_points[groups], first[groups], members[groups] = rays[n], points[n], n, 1
            groups += 1
            continue
        members[group] += 1
        # The running mean, without a second pass.
        out_points[group] += (points[n] - out_points[group]) / members[group]
        for c in range(rays.shape[1]):
            # Compatible rows have equal blobs or none (-1), so that the larger is the one that is there.
            out_rays[group, c] = max(out_rays[group, c], rays[n, c])
    rays[:groups], points[:groups] = out_rays[:groups], out_points[:groups]
    return groups


@kernel
def _sensitivity(rig, rays, place, slopes):
    """The effective sensitivity S(X, Y, Z) of two cameras (thesis 3.3), to first order: the mean of 12 scalars.

    Each pixel coordinate is moved by GATE deviations of its noise to either side, the residual that algorithm 3.1 allows.

    IN  rays (C,) blobs of two cameras; place (1, 3) m
    OUT slopes (2, 1, 2, 3): workspace
    Returns m; NaN where one of the two cannot see the place. O(C). Twin: asterism.cameras.accuracy.sensitivity

    Bounds: of more than two cameras the first two are taken.
    """
    information, side = np.zeros(6), 0
    for c in range(len(rays)):
        if rays[c] >= 0 and side < 2:
            own = rig.cameras[c]
            pixel_jacobians(own[LENS:], own[:9].reshape(3, 3), own[9:12], place, slopes[side])
            # In deviations of the noise, so that both cameras compare.
            slopes[side] /= own[NOISE]
            for row in slopes[side, 0]:
                information[0] += row[0] * row[0]
                information[1] += row[0] * row[1]
                information[2] += row[0] * row[2]
                information[3] += row[1] * row[1]
                information[4] += row[1] * row[2]
                information[5] += row[2] * row[2]
            side += 1
    _, i0, i1, i2, i3, i4, i5 = symmetric_inverse(information)
    total = 0.0
    for side in range(2):
        for row in slopes[side, 0]:
            total += abs(i0 * row[0] + i1 * row[1] + i2 * row[2])
            total += abs(i1 * row[0] + i3 * row[1] + i4 * row[2])
            total += abs(i2 * row[0] + i4 * row[1] + i5 * row[2])
    return 2.0 * rig.limits[GATE] * total / 12.0


@kernel
def _are_compatible(rays, others):
    """Returns whether no camera has different blobs in two rows of rays (C,). O(C)."""
    compatible = True
    for c in range(len(rays)):
        compatible = compatible and (rays[c] < 0 or others[c] < 0 or rays[c] == others[c])
    return compatible
