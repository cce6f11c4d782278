"""Residual kernels: labelled frames in; how far points lie from where all others predict their markers, and which tracklets deviate, out.

The plain twins are in `tests/twins_tracks.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.geometry._kernels import cofactors
from asterism.labelling.body._frame_kernels import frame_settings
from asterism.labelling.body._score_kernels import best_pose, rescore
from asterism.labelling.body._workspace_kernels import make_body_workspace


class ResidualLimits(NamedTuple):
    """Which residuals are compared.

    noise       m, standard deviation of a residual beyond that of the marker's residuals in the recording
    min_frames  residuals of a marker's other tracklets that a comparison needs
    """

    noise: float
    min_frames: int


@kernel
def predicted_place(body, k, m, counts, workspace, place):
    """Where all other labelled points predict marker m, after `rescore` of a frame.

    IN  body BodyArrays; k key pose; counts: whether m's own point is among those that the workspace has counted; workspace BodyWorkspace
    OUT place (3,) m, on the placed body. O(1).
    """
    markers, own = len(workspace.residual), workspace.residual[m]
    x, y, z = workspace.centre[m], workspace.centre[markers + m], workspace.centre[2 * markers + m]
    if counts:  # e - (I - h)^-1 (e - centre) takes the point's own residual e out of the prediction
        h = workspace.variance[:, m]
        xy, xz, yz = -h[1], -h[2], -h[4]
        det, c00, c01, c02, c11, c12, c22 = cofactors(1.0 - h[0], xy, xz, xy, 1.0 - h[3], yz, xz, yz, 1.0 - h[5])
        det = max(det, 1e-9)
        dx, dy, dz = own[0] - x, own[1] - y, own[2] - z
        x = own[0] - (c00 * dx + c01 * dy + c02 * dz) / det
        y = own[1] - (c01 * dx + c11 * dy + c12 * dz) / det
        z = own[2] - (c02 * dx + c12 * dy + c22 * dz) / det
    spread, mean = body.spread[k, m], body.mean[k, m]
    place[0] = mean[0] + spread[0, 0] * x
    place[1] = mean[1] + spread[1, 0] * x + spread[1, 1] * y
    place[2] = mean[2] + spread[2, 0] * x + spread[2, 1] * y + spread[2, 2] * z


@kernel
def prediction_residuals(xyz, offsets, track, label, body, settings, out):
    """How far each labelled point lies from where all other labelled points of its frame predict its marker.

    IN  xyz (P, 3) m, z up; offsets (E + 1,); track (P,) tracklet of each point; label (J,) marker of each tracklet, -1 for none;
        body BodyArrays; settings FrameSettings
    OUT out (P, 3) m along the axes of the placed body; NaN for points without a label, and in frames with fewer than four labelled ones
    O(E (K M r^2 + r^3)); memory for one frame.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    point_of, place = np.empty(markers, dtype=np.int64), np.empty(3)
    workspace = make_body_workspace(0, markers, latents)
    out[:] = np.nan
    for t in range(len(offsets) - 1):
        first, n = offsets[t], offsets[t + 1] - offsets[t]
        point_of[:] = -1
        labelled = 0
        for c in range(n):
            m = label[track[first + c]]
            if m >= 0:
                point_of[m] = c
                labelled += 1
        if labelled < 4:
            continue
        if n != len(workspace.aligned):
            workspace = make_body_workspace(n, markers, latents)
        points, own_settings = xyz[first : first + n], frame_settings(settings, n, markers)
        workspace.outlier[:] = False
        k, _ = best_pose(body, points, point_of, own_settings, workspace)
        rescore(body, k, points, point_of, own_settings, workspace)
        for m in range(markers):
            c = point_of[m]
            if c >= 0:
                predicted_place(body, k, m, not workspace.outlier[m], workspace, place)
                for a in range(3):
                    out[first + c, a] = workspace.aligned[c, a] - place[a]


@kernel
def residual_deviations(residuals, track, label, limits, out):
    """How far each tracklet's mean residual is from the residuals of the other tracklets of its marker.

    IN  residuals (P, 3) m, see `prediction_residuals`; track (P,); label (J,) marker of each tracklet, -1 for none; limits ResidualLimits
    OUT out (J,) root mean square over the three axes, in standard deviations; NaN where it cannot be told. A tracklet is compared only
        where the others of its marker have at least as many residuals as itself. Middle and standard deviation are medians, so that one
        wrong tracklet does not spoil them. O(P log P + labelled tracklets * residuals of their marker).
    """
    tracks = len(label)
    out[:] = np.nan
    own, other, values = np.empty((len(track), 3)), np.empty((len(track), 3)), np.empty(len(track))
    of_label = np.full(len(track), -1, dtype=np.int64)
    for q in range(len(track)):
        if not np.isnan(residuals[q, 0]):
            of_label[q] = label[track[q]]
    order = np.argsort(of_label, kind="mergesort")
    begin = 0
    while begin < len(order):
        end = begin
        m = of_label[order[begin]]
        while end < len(order) and of_label[order[end]] == m:
            end += 1
        for j in range(tracks if m >= 0 else 0):
            if label[j] != m:
                continue
            n_own, n_other = 0, 0
            for s in range(begin, end):
                q = order[s]
                if track[q] == j:
                    own[n_own] = residuals[q]
                    n_own += 1
                else:
                    other[n_other] = residuals[q]
                    n_other += 1
            if n_own == 0 or n_other < max(limits.min_frames, n_own):
                continue
            total = 0.0
            for a in range(3):
                middle = np.median(other[:n_other, a])
                for s in range(n_other):
                    values[s] = abs(other[s, a] - middle)
                std = 1.4826 * np.median(values[:n_other])
                total += (own[:n_own, a].mean() - middle) ** 2 / (std * std + limits.noise * limits.noise)
            out[j] = np.sqrt(total / 3.0)
        begin = end
