"""Prediction kernels: the ends of tracks in; where each is expected in the next frame, and the ends after it, out.

The plain twins are in `tests/twins_links.py`.
"""

from __future__ import annotations

import math

import numpy as np

from asterism._jit import kernel


@kernel
def predict_tracks(ends, count, limits, predicted, gate):
    """Where every track is expected in the next frame, and how far from there its point may be.

    A track of three points or more goes on with its velocity and half its acceleration; one of two with its velocity; a single point
    moves as its three nearest neighbours that have a velocity, or stays where it is.
    IN  ends TrackEnds of `count` tracks; limits LinkLimits. OUT predicted (count, 3) m; gate (count,) m
    O(count), and O(count) more for each single point.

    Bounds: the three nearest are kept, the third in place of what is farther.
    """
    near, near2 = np.empty(3, dtype=np.int64), np.empty(3)
    for a in range(count):
        # Half the acceleration: it changes, too, and all of it would overshoot.
        if ends.age[a] > 2:
            for i in range(3):
                predicted[a, i] = ends.position[a, i] + ends.velocity[a, i] + 0.5 * ends.acceleration[a, i]
            gate[a] = min(
                limits.noise + limits.usual_change + limits.residual_gain * ends.recent_error[a], limits.noise + limits.max_change
            )
            continue
        # Two points give a velocity, whose change is not known yet.
        if ends.age[a] == 2:
            for i in range(3):
                predicted[a, i] = ends.position[a, i] + ends.velocity[a, i]
            gate[a] = limits.noise + 3.0 * limits.usual_change
            continue
        neighbours = 0
        # Only neighbours that have a velocity can lend it.
        for b in range(count):
            if ends.age[b] < 2:
                continue
            far2 = 0.0
            for i in range(3):
                far2 += (ends.position[a, i] - ends.position[b, i]) ** 2
            # Insertion into the three nearest.
            if neighbours == 3 and far2 >= near2[2]:
                continue
            # Insertion into the three nearest, kept in order.
            where = min(neighbours, 2)
            while where > 0 and near2[where - 1] > far2:
                near2[where], near[where] = near2[where - 1], near[where - 1]
                where -= 1
            near2[where], near[where] = far2, b
            neighbours = min(neighbours + 1, 3)
        for i in range(3):
            predicted[a, i] = ends.position[a, i]
        gate[a] = limits.max_step
        # Nobody near has a velocity: the point is expected where it is, as far as it may have moved.
        if neighbours == 0:
            continue
        # By the inverse square of the distance: the nearest marker is likely on the same segment.
        total = 0.0
        for k in range(neighbours):
            # The nearer a neighbour, the more alike it moves; the constant keeps coincident ones finite.
            total += 1.0 / (near2[k] + 1e-4)
        for i in range(3):
            for k in range(neighbours):
                predicted[a, i] += ends.velocity[near[k], i] / ((near2[k] + 1e-4) * total)
        # Neighbours that differ leave the point more room.
        most2 = 0.0
        for k in range(neighbours):
            off2 = 0.0
            for i in range(3):
                off2 += (predicted[a, i] - ends.position[a, i] - ends.velocity[near[k], i]) ** 2
            most2 = max(most2, off2)
        away = limits.neighbour_velocity_tol + limits.rotation_tol * math.sqrt(near2[0]) + limits.disagreement_gain * math.sqrt(most2)
        gate[a] = min(limits.noise + away, limits.max_step)


@kernel
def start_links(ends, count, points, limits, next_point, previous):
    """First links, where no track has a velocity yet: a point is linked if it moves like its neighbours.

    A point is linked to its nearest, both ways and without a rival, if two of its three nearest neighbours are, and move alike. A pattern
    that moves by its own spacing might deceive one point, but not its neighbourhood.
    IN  ends TrackEnds of `count` tracks; points (n, 3) m; limits LinkLimits
    OUT next_point (count,), previous (n,), written where a link is made. O(count (count + n)).

    Bounds: the three nearest are kept, the third in place of what is farther.
    """
    n = len(points)
    nearest, back = np.full(count, -1, dtype=np.int64), np.full(n, -1, dtype=np.int64)
    miss, rival = np.full(count, np.inf), np.full(count, np.inf)
    point_miss, point_rival = np.full(n, np.inf), np.full(n, np.inf)
    for a in range(count):
        for b in range(n):
            far = 0.0
            for i in range(3):
                far += (points[b, i] - ends.position[a, i]) ** 2
            far = math.sqrt(far)
            # Nearest and second nearest, for points and tracks alike: a rival is the second.
            if far < miss[a]:
                rival[a], miss[a], nearest[a] = miss[a], far, b
            elif far < rival[a]:
                rival[a] = far
            if far < point_miss[b]:
                point_rival[b], point_miss[b], back[b] = point_miss[b], far, a
            elif far < point_rival[b]:
                point_rival[b] = far
    for a in range(count):
        b = nearest[a]
        least_rival = limits.ratio_test * miss[a] + limits.rival_gap
        # Both must be each other's nearest, and no rival near either of them.
        if b >= 0 and (back[b] != a or miss[a] > limits.max_step or rival[a] <= least_rival or point_rival[b] <= least_rival):
            nearest[a] = -1
    near, near2 = np.empty(3, dtype=np.int64), np.empty(3)
    for a in range(count):
        if nearest[a] < 0:
            continue
        neighbours = 0
        for b in range(count):
            far2 = 0.0
            for i in range(3):
                far2 += (ends.position[a, i] - ends.position[b, i]) ** 2
            if b == a or (neighbours == 3 and far2 >= near2[2]):
                continue
            where = min(neighbours, 2)
            while where > 0 and near2[where - 1] > far2:
                near2[where], near[where] = near2[where - 1], near[where - 1]
                where -= 1
            near2[where], near[where] = far2, b
            neighbours = min(neighbours + 1, 3)
        alike = 0
        for k in range(neighbours):
            b = near[k]
            if nearest[b] < 0:
                continue
            off2 = 0.0
            for i in range(3):
                off2 += (points[nearest[a], i] - ends.position[a, i] - points[nearest[b], i] + ends.position[b, i]) ** 2
            # A turning body gives neighbours other velocities, the more the farther they are.
            alike += math.sqrt(off2) <= limits.noise + limits.neighbour_velocity_tol + limits.rotation_tol * math.sqrt(near2[k])
        # Two neighbours: one alone may be deceived by the same pattern.
        if alike >= 2:
            next_point[a] = nearest[a]
            previous[nearest[a]] = a


@kernel
def extend_tracks(ends, points, predicted, previous, following):
    """The tracks' ends in the next frame: every point continues its track, or begins one.

    IN  ends TrackEnds; points (n, 3) m; predicted (count, 3) m, where the tracks were expected; previous (n,), -1 for none
    OUT following TrackEnds of n tracks. O(n).
    """
    for b in range(len(points)):
        a = previous[b]
        age = ends.age[a] + 1 if a >= 0 else 1
        change2, error2 = 0.0, 0.0
        following.age[b] = age
        for i in range(3):
            following.position[b, i] = points[b, i]
            following.velocity[b, i] = points[b, i] - ends.position[a, i] if age > 1 else 0.0
            following.acceleration[b, i] = following.velocity[b, i] - ends.velocity[a, i] if age > 2 else 0.0
            change2 += following.acceleration[b, i] ** 2
            error2 += (points[b, i] - predicted[a, i]) ** 2 if age > 3 else 0.0
        # Errors fade by a fifth per frame: a track that was rough stays doubtful for a while.
        following.recent_error[b] = max(0.8 * ends.recent_error[a], math.sqrt(error2)) if age > 3 else math.sqrt(change2)
