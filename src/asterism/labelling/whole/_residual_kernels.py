"""Residual kernels: labelled frames in; how far points lie from where all others predict their markers, and which tracklets deviate, out.

The plain twins are in `tests/twins_tracks.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from asterism._jit import kernel
from asterism.labelling.body._frame_kernels import frame_settings
from asterism.labelling.body._score_kernels import best_pose, leave_one_out, place_on_body, rescore
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.whole._kernels import points_of_markers


class ResidualLimits(NamedTuple):
    """Which residuals are compared.

    noise       m, standard deviation of a residual beyond that of the marker's residuals in the recording
    min_frames  residuals of a marker's other tracklets that a comparison needs
    """

    noise: float
    min_frames: int


@kernel
def prediction_residuals(xyz, offsets, track, label, body, settings, out):
    """How far each labelled point lies from where all other labelled points of its frame predict its marker.

    IN  xyz (P, 3) m, z up; offsets (E + 1,); track (P,) tracklet of each point; label (J,) marker of each tracklet, -1 for none;
        body BodyArrays; settings FrameSettings
    OUT out (P, 3) m along the axes of the placed body; NaN for points without a label, and in frames with fewer than four labelled ones
    O(E (K M r^2 + r^3)); memory for one frame.
    """
    markers, latents = body.load.shape[1], body.load.shape[3]
    point_of = np.empty(markers, dtype=np.int64)
    workspace = make_body_workspace(0, markers, latents)
    out[:] = np.nan
    for t in range(len(offsets) - 1):
        first, n = offsets[t], offsets[t + 1] - offsets[t]
        # A point and three others that predict it.
        if points_of_markers(track[first : first + n], label, point_of) < 4:
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
                # Predicted without its own point, which would pull the body towards itself.
                _, at, _ = leave_one_out(m, not workspace.outlier[m], workspace)
                place = place_on_body(body, k, m, at)
                for a in range(3):
                    out[first + c, a] = workspace.aligned[c, a] - place[a]


@kernel
def residual_deviations(residuals, track, label, limits, out):
    """How far each tracklet's mean residual is from the residuals of the other tracklets of its marker.

    IN  residuals (P, 3) m, see `prediction_residuals`; track (P,); label (J,) marker of each tracklet, -1 for none; limits ResidualLimits
    OUT out (J,) root mean square over the three axes, in standard deviations; NaN where it cannot be told. A tracklet is compared only
        where the others of its marker have at least as many residuals as itself. Middle and standard deviation are medians, so that one
        wrong tracklet does not spoil them. O(P log P + labelled tracklets * residuals of their marker).

    Bounds: a residual for each point: P.
    """
    tracks = len(label)
    out[:] = np.nan
    own, other, values = np.empty((len(track), 3)), np.empty((len(track), 3)), np.empty(len(track))
    of_label = np.full(len(track), -1, dtype=np.int64)
    for q in range(len(track)):
        if not np.isnan(residuals[q, 0]):
            of_label[q] = label[track[q]]
    # By label, so that the residuals of a marker stand together.
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
            # Fewer others than its own points cannot judge it: they may be the wrong ones.
            if n_own == 0 or n_other < max(limits.min_frames, n_own):
                continue
            total = 0.0
            for a in range(3):
                # Medians, so that one wrong tracklet among the others does not spoil them.
                middle = np.median(other[:n_other, a])
                for s in range(n_other):
                    values[s] = abs(other[s, a] - middle)
                std = 1.4826 * np.median(values[:n_other])
                # The noise keeps an axis with hardly any spread from deciding alone.
                total += (own[:n_own, a].mean() - middle) ** 2 / (std * std + limits.noise * limits.noise)
            out[j] = np.sqrt(total / 3.0)
        begin = end
