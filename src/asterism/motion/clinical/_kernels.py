"""Joint centres and turns, frame by frame, on flat arrays. Twin: tests/test_clinical.py."""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel
from asterism.geometry.shared_kernels import within_half_a_turn


@kernel
def joint_centres(upper, marker, wand, offset, turn, tilt, steps, centres):
    """The centre of a joint in each frame, by the chord function of Davis et al. (1991).

    IN  upper, marker, wand (T, 3) m; offset m, from marker to centre; turn rad, of the marker behind the wand about the line between the
        centres; tilt rad, more than a right angle at the centre; steps, at most, in which the turn is reached
    OUT centres (T, 3) m, NaN where an input is
    O(T), no allocation per frame. Bounds: offset is not 0.
    """
    axis, first, second, line = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    to_marker, to_wand, arm = np.empty(3), np.empty(3), np.empty(3)
    angle, gain = 0.0, 1.0
    sine_of_corner, cosine_of_corner = math.sin(0.5 * math.pi + tilt), math.cos(0.5 * math.pi + tilt)
    for frame in range(len(centres)):
        for k in range(3):
            axis[k] = marker[frame, k] - upper[frame, k]
            arm[k] = wand[frame, k] - upper[frame, k]
        length = _unit(axis)
        # A joint nearer than its own half width would have no such triangle.
        across = math.sqrt(max(length**2 - (offset * sine_of_corner) ** 2, 0.0))
        sine = (offset**2 + length**2 - (offset * cosine_of_corner + across) ** 2) / (2 * length * offset)
        sine = min(max(sine, -0.9), 0.9)
        cosine = math.sqrt(1 - sine**2)
        along = _dot(arm, axis)
        for k in range(3):
            first[k] = arm[k] - along * axis[k]
        _unit(first)
        _cross(axis, first, second)
        # The frame before ends near where this one does: half of the steps.
        if not abs(angle) < 4.0:
            angle, gain = 0.0, 1.0
        change, before = 0.0, 0.0
        for done in range(steps):
            c, s = math.cos(angle), math.sin(angle)
            for k in range(3):
                out = c * first[k] + s * second[k]
                centres[frame, k] = marker[frame, k] - offset * (sine * axis[k] + cosine * out)
            if turn == 0.0:
                break
            for k in range(3):
                line[k] = centres[frame, k] - upper[frame, k]
                to_marker[k] = marker[frame, k] - centres[frame, k]
                to_wand[k] = wand[frame, k] - centres[frame, k]
            _unit(line)
            one, other = _dot(to_marker, line), _dot(to_wand, line)
            for k in range(3):
                to_marker[k] -= one * line[k]
                to_wand[k] -= other * line[k]
            _cross(to_wand, to_marker, arm)
            step = turn - math.atan2(_dot(arm, line), _dot(to_wand, to_marker))
            # the shorter way round: a wand behind the limb stands half a turn away
            step = (step + math.pi) % (2 * math.pi) - math.pi
            # What the last change did tells how far to go (the secant method): a whole step leaves a twentieth.
            moved = before - step
            if done > 0:
                gain = change / moved if 0.5 < moved / change < 2.0 else 1.0
            change = step * gain
            before = step
            angle += change
            # What is left is a hundredth of it, or less: 1e-13 m of a joint.
            if not abs(step) > 1e-10:
                break


@kernel
def segment_axes(first, second, along, across, axes):
    """Axes of a segment in each frame: one along a direction, one at right angles with it and with a second direction.

    IN  first, second (T, 3), of any length; along, across the columns of the axis along `first` and of that along the vector product of
        that axis and `second`
    OUT axes (T, 3, 3), x, y and z as columns; NaN where what tells them is, or has a length of 1e-12 or less
    O(T), no allocation per frame. Bounds: `along` and `across` are two of 0, 1, 2.
    """
    one, other, third, way = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    last = 3 - along - across
    for frame in range(len(axes)):
        for k in range(3):
            one[k], way[k] = first[frame, k], second[frame, k]
        if not _unit(one) > 1e-12:
            one[:] = math.nan
        _cross(one, way, other)
        if not _unit(other) > 1e-12:
            other[:] = math.nan
        # Right-handed: x, y and z in this order.
        if (across - along) % 3 == 1:
            _cross(one, other, third)
        else:
            _cross(other, one, third)
        for k in range(3):
            axes[frame, k, along], axes[frame, k, across], axes[frame, k, last] = one[k], other[k], third[k]


@kernel
def unit_normals(one, other, normals):
    """The direction of the vector product of two vectors in each frame.

    IN  one, other (T, 3), of any length
    OUT normals (T, 3), of length 1; NaN where a vector is, or where the product has a length of 1e-12 or less
    O(T), no allocation. Bounds: none.
    """
    for frame in range(len(normals)):
        normal = normals[frame]
        _cross(one[frame], other[frame], normal)
        if not _unit(normal) > 1e-12:
            normal[:] = math.nan


@kernel
def relative_turns(parent, child, x_first, near_right, signs, zero, found):
    """Turns of a child in its parent's axes in each frame, about y, x and z, or about x, y and z.

    IN  parent (T, 3, 3), or (1, 3, 3) the same in all frames; child (T, 3, 3): axes as columns; x_first, whether the turn about x comes
        first; near_right rad: where no middle turn is larger to either side, none can have gone past a right angle; signs (3,) of the
        turns in `found`; zero rad, what is added to the first of them
    OUT found (T, 3) rad, in the order of the turns, from -pi to pi; NaN where an input is. Of the two triples that make one rotation that
        nearer to the frame before, by the sum of the three differences; of the first frame's that with less of the other turns
    O(T), no allocation per frame. Bounds: none.
    """
    r = np.empty((3, 3))
    largest = 0.0
    for frame in range(len(found)):
        fixed = 0 if len(parent) == 1 else frame
        for i in range(3):
            for k in range(3):
                r[i, k] = (
                    parent[fixed, 0, i] * child[frame, 0, k]
                    + parent[fixed, 1, i] * child[frame, 1, k]
                    + parent[fixed, 2, i] * child[frame, 2, k]
                )
        sine = r[0, 2] if x_first else -r[1, 2]
        # Rounding may leave a sine beyond 1; NaN passes.
        sine = 1.0 if sine > 1.0 else (-1.0 if sine < -1.0 else sine)
        found[frame, 0] = math.atan2(-r[1, 2], r[2, 2]) if x_first else math.atan2(r[0, 2], r[2, 2])
        found[frame, 1] = math.asin(sine)
        found[frame, 2] = math.atan2(-r[0, 1], r[0, 0]) if x_first else math.atan2(r[1, 0], r[1, 1])
        # NaN is never larger.
        if abs(found[frame, 1]) > largest:
            largest = abs(found[frame, 1])
    # An arm may be raised in the first frame: there both triples are weighed.
    if x_first or largest > near_right:
        _steady(found)
    for frame in range(len(found)):
        for k in range(3):
            angle = signs[k] * found[frame, k] + (zero if k == 0 else 0.0)
            # Most are within half a turn, and a remainder takes as long as the turns themselves.
            found[frame, k] = within_half_a_turn(angle) if abs(angle) > math.pi else angle


@kernel
def any_known(values):
    """Whether a value of some rows is known.

    IN  values (T, 3), NaN for what is missing
    Returns whether one of them is finite. O(T).
    """
    for row in values:
        for value in row:
            if math.isfinite(value):
                return True
    return False


@kernel
def _steady(found):
    """See `relative_turns`: the triples of all frames, (T, 3) rad, the first ones before, the chosen ones after."""
    before, other = np.empty(3), np.empty(3)
    begun = False
    for frame in range(len(found)):
        if not math.isfinite(found[frame, 0] + found[frame, 1] + found[frame, 2]):
            continue
        for k in range(3):
            other[k] = (found[frame, k] if k != 1 else -found[frame, k]) + math.pi
        if not begun:
            begun = True
            here = abs(found[frame, 0]) + abs(found[frame, 2])
            there = abs(within_half_a_turn(other[0])) + abs(within_half_a_turn(other[2]))
            for k in range(3):
                before[k] = within_half_a_turn(other[k]) if there < here else found[frame, k]
        here, there = 0.0, 0.0
        for k in range(3):
            here += abs(within_half_a_turn(found[frame, k] - before[k]))
            there += abs(within_half_a_turn(other[k] - before[k]))
        for k in range(3):
            if there < here:
                found[frame, k] = other[k]
            before[k] = found[frame, k]


@kernel(inline=True)
def _dot(one, other):
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


@kernel(inline=True)
def _cross(one, other, out):
    out[0] = one[1] * other[2] - one[2] * other[1]
    out[1] = one[2] * other[0] - one[0] * other[2]
    out[2] = one[0] * other[1] - one[1] * other[0]


@kernel(inline=True)
def _unit(vector):
    """Make a vector one of length 1 (NaN for length 0); its length before."""
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for k in range(3):
        vector[k] /= length
    return length
