"""Slow, readable twins of the kernels that read garments."""

from __future__ import annotations

from collections import deque
from itertools import permutations

import cv2
import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from asterism.garment.identities import block_rings


def colourfulness(image, smooth):
    """The spread of each pixel's channels without the border."""
    out = np.ptp(cv2.GaussianBlur(image, (3, 3), 0) if smooth else image, axis=2)
    out[[0, -1]] = 0
    out[:, [0, -1]] = 0
    return out


def count_bends(image):
    """How often each absolute second difference of green occurs along every eighth row."""
    return np.bincount(np.abs(np.diff(image[::8, :, 1].astype(int), 2, axis=1)).ravel(), minlength=511)


def regions(grey, lowest, limits):
    """Regions of an ellipse's shape, above a threshold that rises until they have it: boxes, highest value and threshold."""
    found, waiting = set(), [(grey > -1, lowest, 0)]
    while waiting:
        within, threshold, depth = waiting.pop()
        parts, labels, stats, _ = cv2.connectedComponentsWithStats((within & (grey > threshold)).astype(np.uint8), connectivity=4)
        for k in range(1, parts):
            x, y, w, h, area = (int(v) for v in stats[k])
            most = int(grey[labels == k].max()) if area >= limits[0] else 0
            if most - threshold < limits[3]:
                continue
            small = area <= limits[1] and max(w, h) - 1 < limits[4]
            if small and threshold >= limits[5] * most and fill(labels == k) >= limits[2]:
                if x > 1 and y > 1 and x + w < grey.shape[1] - 1 and y + h < grey.shape[0] - 1:
                    found.add((x, x + w - 1, y, y + h - 1, most, threshold))
            elif depth < 8 and area > 2 * limits[0]:
                step = threshold + max(limits[3], (most - threshold) // 4)
                waiting.append((labels == k, int(max(step, limits[5] * most) if small else step), depth + 1))
    return found


def fill(part):
    """Area as a share of that of the ellipse with the same second moments."""
    moments = np.cov(np.stack(np.nonzero(part)), bias=True) + np.eye(2) / 12
    return part.sum() / (4 * np.pi * np.sqrt(np.linalg.det(moments)))


def measure(image, linear, grey, held, regions, noise):
    """Weighted means over the pixels of a region and those two pixels around it that are no other's."""
    out = np.empty((len(regions), 12))
    for i, (left, right, above, below, most, threshold, first, last) in enumerate(regions):
        own = np.zeros(grey.shape, dtype=bool)
        for row, begin, end in held[first:last]:
            own[row, begin : end + 1] = True
        y, x = np.mgrid[max(above - 2, 0) : min(below + 3, len(grey)), max(left - 2, 0) : min(right + 3, grey.shape[1])]
        value, mine = grey[y, x].astype(float), own[y, x]
        half = 0.5 * (most + threshold)
        ground = min(value.min() + 0.6 * noise, 0.5 * half)
        span = max(value[mine & (value >= half)].mean() - ground, 1.0)
        part = mine | (value <= threshold)
        share = np.clip((value - ground) / span, 0, 1)
        cover, weight = np.where(part, share**2, 0), np.where(part, np.where(share < 1, 4 * share**2, 1), 0)
        places = np.stack([x, y], axis=-1).reshape(-1, 2)
        area = cover.sum()
        centre = np.average(places, axis=0, weights=cover.ravel())
        moments = np.cov(places.T, aweights=cover.ravel(), bias=True)
        off = places - 0.5 * np.array([left + right, above + below])
        covariance = 2 * (noise / (span * area)) ** 2 * np.einsum("n,ni,nj->ij", weight.ravel(), off, off)
        inner = image[y, x][mine & part & (cover > 0.4)]
        light = linear[inner].mean(axis=0) if len(inner) else np.zeros(3)
        three = [0, 0, 1], [0, 1, 1]
        out[i] = [*centre, *covariance[three], *moments[three], area, *light]
    return out


def candidates(centres, whiten, reach, most):
    """The nearest others of each by its own ellipse."""
    out = np.full((len(centres), most), -1)
    for i in range(len(centres)):
        far = np.linalg.norm((centres - centres[i]) @ whiten[i].T, axis=1)
        order = [j for j in np.argsort(far, kind="stable") if j != i and far[j] <= reach][:most]
        out[i, : len(order)] = order
    return out


def first_frames(found, offsets, whiten, side, square, fit):
    """Every pair of candidates as lattice vectors, scored by how the others lie on their lattice."""
    frames, scores = np.full((len(found), 2, 2), np.nan), np.full(len(found), -np.inf)
    for i in range(len(found)):
        around = offsets[i, found[i] >= 0]
        for p, q in permutations(around, 2):
            lengths, det = np.linalg.norm([p, q], axis=1), np.linalg.det([p, q])
            if (lengths < side[0]).any() or (lengths > side[1]).any() or det < square * lengths.prod():
                continue
            # Of the four quarter turns of a pair one is taken: the first vector points right, and more so than the second one down.
            if p[0] < 0 or (p[0] < abs(p[1]) and q[1] > abs(q[0])):
                continue
            score = lattice_score(around, p, q, fit) - 2 * ((np.log(lengths) ** 2).sum() + 1 - (det / lengths.prod()) ** 2)
            if score > scores[i]:
                scores[i], frames[i] = score, np.linalg.solve(whiten[i], np.column_stack([p, q]))
    return frames, scores


def lattice_score(around, p, q, fit):
    """Points for circles near the eight places around, half a point less for each in between."""
    total = 0.0
    for place in np.linalg.solve(np.column_stack([p, q]), around.T).T:
        node = np.rint(place)
        far = ((place - node) ** 2).sum()
        if np.abs(node).max() > 1:
            continue
        if node.any() and far <= fit**2:
            total += (0.6 if node.all() else 1.0) * (1 - 0.7 * far / fit**2)
        elif np.abs(place).max() < 1.2:
            total -= 0.5
    return total


def is_right_handed(frame):
    """Whether there is a lattice: two vectors, the second a quarter turn clockwise of the first or nearly so."""
    return np.isfinite(frame).all() and np.linalg.det(frame) > 0


STEPS = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])


def link(centres, found, frames, fit):
    """The candidate nearest to each place one step away, where that is mutual."""
    n = len(found)
    ahead, links = np.full((n, 4), -1), np.full((n, 4, 2), -1)
    for i in range(n):
        near = found[i][found[i] >= 0]
        if not len(near) or not is_right_handed(frames[i]):
            continue
        places = np.linalg.solve(frames[i], (centres[near] - centres[i]).T).T
        for d in range(4):
            far = np.linalg.norm(places - STEPS[d], axis=1)
            if far.min() < fit:
                ahead[i, d] = near[far.argmin()]
    for i, d in np.ndindex(n, 4):
        back = np.flatnonzero(ahead[ahead[i, d]] == i) if ahead[i, d] >= 0 else []
        if len(back):
            links[i, d] = ahead[i, d], back[-1]
    return links


def refine_frames(centres, found, links, frames, fit):
    """Weighted means of the steps to linked neighbours and of the neighbours' own vectors; else the vectors of a linked circle nearby."""
    out = frames.copy()
    for i in range(len(found)):
        steps, weights = [[], []], [[], []]
        for d in range(4):
            j, back = links[i, d]
            if j < 0:
                continue
            steps[d % 2].append((centres[j] - centres[i]) * STEPS[d].sum())
            weights[d % 2].append(1.0)
            for own in range(2):
                # The neighbour's direction `back` points to where ours, d, comes from.
                there = (own + back + 2 - d) % 4
                steps[own].append(frames[j, :, there % 2] * (1 if there < 2 else -1))
                weights[own].append(0.2)
        if steps[0]:
            out[i] = np.column_stack([np.average(s, axis=0, weights=w) for s, w in zip(steps, weights, strict=True)])
            continue
        nearest = fit
        for j in found[i][found[i] >= 0]:
            if (links[j, :, 0] >= 0).sum() < 2 or not is_right_handed(frames[j]):
                continue
            far = np.linalg.norm(np.linalg.solve(frames[j], centres[i] - centres[j]) - STEPS, axis=1).min()
            if far < nearest - 1e-9:
                nearest, out[i] = far, frames[j]
    return out


def along(grey, start, end, steps):
    """An image's values on a way, from its half, quarter or eighth whose pixels are nearest to a step's length; and which one that is."""
    halvings = int(np.clip(np.ceil(np.log2(np.abs(end - start).max() / steps) - 0.5), 0, 3))
    for _ in range(halvings):
        height, width = grey.shape[0] // 2, grey.shape[1] // 2
        blocks = grey[: 2 * height, : 2 * width].reshape(height, 2, width, 2).astype(int)
        grey = (blocks.sum(axis=(1, 3)) + 2) // 4
    x, y = ((start + (end - start) * np.linspace(0, 1, steps + 1)[:, None] + 0.5) / 2**halvings - 0.5).T
    return map_coordinates(grey.astype(float), [y, x], order=1, mode="nearest"), halvings


def cut_skipping(grey, centres, whiten, side, rise, links):
    """Links without those of a wrong length and those along which the colourfulness rises and falls again before the end."""
    links = links.copy()
    for i, d in np.ndindex(links.shape[:2]):
        j, back = links[i, d]
        if j < i:
            continue
        step = centres[j] - centres[i]
        length = np.mean([np.linalg.norm(whiten[k] @ step) for k in (i, j)])
        values, level = along(grey, centres[i], centres[j], 16)
        needed = max(rise[0] * min(values[0], values[-1]), rise[1 + level])
        rises = values - np.minimum.accumulate(values) > needed
        begin = np.flatnonzero(rises[1:-1])
        after = values[begin[0] + 1 :] if len(begin) else values[:1]
        falls = (np.maximum.accumulate(after) - after).max()
        if not side[0] <= length <= side[1] or falls > needed:
            links[i, d] = links[j, back] = -1
    return links


def rings(links):
    """The eight circles around each, by walking both ways to those between two directions."""
    out = np.full((len(links), 8), -1)
    for i in range(len(links)):
        for d in range(4):
            out[i, 2 * d] = links[i, d, 0]
            ends = set()
            for first, turn in ((d, 1), ((d + 1) % 4, -1)):
                j, back = links[i, first]
                if j >= 0:
                    ends.add(int(links[j, (back + 2 + turn) % 4, 0]))
            ends.discard(-1)
            out[i, 2 * d + 1] = ends.pop() if len(ends) == 1 else -1
    return out


def posteriors(points, centres, spreads, outliers):
    """Normal densities plus a constant, normalised."""
    density = np.empty((len(points), len(centres)))
    for k, (centre, spread) in enumerate(zip(centres, spreads, strict=True)):
        off = points - centre
        density[:, k] = np.exp(-0.5 * np.einsum("ni,ij,nj->n", off, np.linalg.inv(spread), off)) / np.sqrt(np.linalg.det(spread)) + outliers
    return density / density.sum(axis=1, keepdims=True)


def fit_mixture(points, least, outliers, rounds, centres, spreads):
    """Expectation and maximisation; a distribution with fewer than three points stays."""
    centres, spreads = centres.copy(), spreads.copy()
    for _ in range(rounds):
        weights = posteriors(points, centres, spreads, outliers) if len(points) else np.empty((0, len(centres)))
        for k in np.flatnonzero(weights.sum(axis=0) >= 3):
            centres[k] = np.average(points, axis=0, weights=weights[:, k])
            spreads[k] = np.cov(points.T, aweights=weights[:, k], bias=True) + least**2 * np.eye(2)
    return centres, spreads


def agreeing(links, cells, turns):
    """The neighbours that are where the grid has them and turned as it says."""
    out = np.full((len(links), 4), -1)
    for i, d in np.ndindex(len(links), 4):
        j, back = links[i, d]
        if j < 0 or turns[i] < 0 or turns[j] < 0:
            continue
        there = STEPS[(d + turns[i]) % 4]
        step = cells[j] - cells[i]
        if (step == there[::-1]).all() and (STEPS[(back + turns[j]) % 4] == -there).all():
            out[i, d] = j
    return out


def groups(links, cells, turns):
    """The first circle of each connected part of the graph of agreeing links."""
    out, agreed = np.arange(len(links)), agreeing(links, cells, turns)
    if not len(links):
        return out
    i, d = np.nonzero(agreed >= 0)
    graph = coo_array((np.ones(len(i)), (i, agreed[i, d])), shape=(len(links), len(links)))
    part = connected_components(graph, directed=False)[1]
    return np.array([np.flatnonzero(part == k)[0] for k in part])


def spread(links, colours, likelihood, order, cells, turns):
    """Breadth first from blocks that were read; nothing goes on from a circle whose colour speaks against its cell, or off the cloth."""
    cells, turns, waiting = cells.copy(), turns.copy(), deque(order)
    while waiting:
        i = waiting.popleft()
        if likelihood[i, colours[tuple(cells[i])]] < 0:
            continue
        for d, (j, back) in enumerate(links[i]):
            cell = cells[i] + STEPS[(d + turns[i]) % 4][::-1]
            if j >= 0 and turns[j] < 0 and (cell >= 0).all() and (cell < colours.shape).all() and colours[tuple(cell)] >= 0:
                cells[j], turns[j] = cell, (d + turns[i] + 2 - back) % 4
                waiting.append(j)
    return cells, turns


def balance(shares, wanted, rounds):
    """Factors that make the mean shares those wanted."""
    gains = np.ones(3)
    for _ in range(rounds):
        seen = shares * gains
        gains = gains * wanted / (seen / seen.sum(axis=1, keepdims=True)).mean(axis=0)
        gains /= np.cbrt(gains.prod())
    return gains


def turned(place, turn):
    """A step of rows and columns after quarter turns: right becomes down, down becomes left."""
    down, right = place
    for _ in range(turn):
        down, right = right, -down
    return down, right


def gather(links, turns, root, most):
    """Breadth first over links; circle -> (rows down, columns right, direction of its direction 0). A place is taken once."""
    found, waiting = {root: (0, 0, 0)}, deque([root])
    while waiting and len(found) < most:
        i = waiting.popleft()
        down, right, turn = found[i]
        for d, (j, back) in enumerate(links[i]):
            way = (d + turn) % 4
            place = (down + STEPS[way][1], right + STEPS[way][0])
            if j >= 0 and turns[j] < 0 and j not in found and place not in [p[:2] for p in found.values()] and len(found) < most:
                found[j] = (*place, (way + 2 - back) % 4)
                waiting.append(j)
    return found


def look_up(ring, read, pattern):
    """Each whole block by the pattern's own look-up, then turned until its ring is the printed one."""
    cells, turns = np.full((len(ring), 2), -1), np.full(len(ring), -1)
    whole = np.flatnonzero((ring >= 0).all(axis=1))
    for i in whole:
        seen = read[ring[i]]
        number = int(pattern.identity(read[i], seen))
        if number < 0:
            continue
        # The pattern's rings begin at the upper left; those of `rings` at direction 0, which is along a row where the turn is 0.
        place = pattern.cells(number)
        printed = np.roll(block_rings(pattern.colours)[tuple(place)], -3)
        for turn in range(4):
            if (np.roll(printed, -2 * turn) == seen).all():
                cells[i], turns[i] = place, turn
    return cells, turns, (len(whole), int((turns >= 0).sum()))


def locate(places, read, colours, misses):
    """Misses of every place and turn: the best (misses, turn, row, column) and the next best's misses, both capped."""
    padded = np.pad(colours, 40, constant_values=-1)
    counts = []
    for turn in range(4):
        for row, col in np.argwhere(colours >= 0):
            steps = [turned(place[:2], turn) for place in places.values()]
            seen = [padded[row + 40 + down, col + 40 + right] for down, right in steps]
            counts.append((int((np.array(seen) != read[list(places)]).sum()), turn, int(row), int(col)))
    counts.sort()
    return counts[0], min(counts[1][0], misses + 1)


def place_patches(links, read, colours, least, misses, cells, turns):
    """Patches of up to a quarter more circles than `least`, in the order of their roots."""
    cells, turns, placed, tried = cells.copy(), turns.copy(), [], set()
    for root in range(len(links)):
        if turns[root] >= 0 or root in tried:
            continue
        places = gather(links, turns, root, least + least // 4)
        if len(places) < least:
            continue
        allowed = min(misses, len(places) - least)
        (wrong, turn, row, col), other = locate(places, read, colours, allowed)
        if wrong > allowed or other <= allowed:
            tried.update(list(places)[:9])
            continue
        for i, place in places.items():
            down, right = turned(place[:2], turn)
            inside = 0 <= row + down < colours.shape[0] and 0 <= col + right < colours.shape[1]
            if inside and colours[row + down, col + right] == read[i]:
                cells[i], turns[i] = (row + down, col + right), (place[2] + turn) % 4
                placed.append(i)
    return cells, turns, placed


def occupy(cells, shape):
    """Circle of each cell, -1 none, -2 several."""
    at = np.full(shape, -1)
    for i, cell in enumerate(cells):
        if cell[0] >= 0:
            at[tuple(cell)] = i if at[tuple(cell)] == -1 else -2
    return at


def ways(centres, at, fits, row, col):
    """Where rows and squares around have a cell's circle, and the steps between circles beside it, along a row and down a column."""

    def spot(down, right):
        r, c = row + down, col + right
        there = 0 <= r < at.shape[0] and 0 <= c < at.shape[1] and at[r, c] >= 0 and fits[at[r, c]]
        return centres[at[r, c]] if there else None

    around = [tuple(step[::-1]) for step in STEPS]
    straight, squares, middles, steps = [], [], [], [[], []]
    for d in range(4):
        one, other = around[d], around[(d + 1) % 4]
        a, far, b = spot(*one), spot(2 * one[0], 2 * one[1]), spot(*other)
        c = spot(one[0] + other[0], one[1] + other[1])
        if a is not None and far is not None:
            straight.append(2 * a - far)
            steps[d % 2].append((far - a) * sum(one))
        if a is not None and c is not None:
            steps[1 - d % 2].append((c - a) * sum(other))
        if b is not None and c is not None:
            steps[d % 2].append((c - b) * sum(one))
        if a is not None and b is not None and c is not None:
            squares.append(a + b - c)
    for d in range(2):
        a, b = spot(*around[d]), spot(*around[d + 2])
        if a is not None and b is not None:
            middles += [(a + b) / 2] * 2
            steps[d].append((a - b) / 2)
    return straight, squares, middles, steps


def expect(centres, at, fits, row, col):
    """The mean of all ways and the two lattice vectors as columns; None where they are not known."""
    straight, squares, middles, steps = ways(centres, at, fits, row, col)
    every = straight + squares + middles
    if not every or not steps[0] or not steps[1]:
        return None
    return np.mean(every, axis=0), np.column_stack([np.mean(s, axis=0) for s in steps]), len(every)


def off_by(place, frame, centre):
    """Pitches."""
    return np.linalg.norm(np.linalg.solve(frame, centre - place)) if np.linalg.det(frame) > 0 else np.inf


def grow(centres, likelihood, colours, gate, cells, at, fits):
    """From each circle of its cell's colour to the four cells beside; the nearest circle where no other is nearly as near."""
    cells, at, fits = cells.copy(), at.copy(), fits.copy()
    waiting = deque(np.flatnonzero(cells[:, 0] >= 0).tolist())
    while waiting:
        i = waiting.popleft()
        if not fits[i]:
            continue
        for step in STEPS:
            cell = tuple(cells[i] + step[::-1])
            inside = 0 <= cell[0] < colours.shape[0] and 0 <= cell[1] < colours.shape[1]
            if not inside or colours[cell] < 0 or at[cell] != -1:
                continue
            expected = expect(centres, at, fits, *cell)
            if expected is None:
                continue
            far = np.array([off_by(*expected[:2], centre) for centre in centres])
            best, second = np.argsort(far)[:2]
            if far[best] > gate or far[second] < 2 * far[best] or cells[best, 0] >= 0:
                continue
            cells[best], at[cell] = cell, best
            fits[best] = likelihood[best, colours[cell]] > 0
            waiting.append(best)
    return cells, at, fits


def rivals(centres, colours, cells, at, fits):
    """Distance of each circle with a cell from the nearest place where an empty cell beside others is expected, 1 at most."""
    out = np.ones(len(centres))
    for cell in np.argwhere((at == -1) & (colours >= 0)):
        beside = [tuple(cell + step) for step in STEPS]
        taken = [0 <= r < at.shape[0] and 0 <= c < at.shape[1] and at[r, c] >= 0 for r, c in beside]
        expected = expect(centres, at, fits, *cell) if any(taken) else None
        for i in np.flatnonzero(cells[:, 0] >= 0) if expected is not None else []:
            out[i] = min(out[i], off_by(*expected[:2], centres[i]))
    return out


def usual_areas(area, cells, at):
    """The median area of the eight circles around each, as far as they are there."""
    padded, out = np.pad(at, 1, constant_values=-1), np.full(len(cells), np.nan)
    for i in np.flatnonzero(cells[:, 0] >= 0):
        around = padded[cells[i, 0] : cells[i, 0] + 3, cells[i, 1] : cells[i, 1] + 3].ravel()[[0, 1, 2, 3, 5, 6, 7, 8]]
        if (around >= 0).any():
            out[i] = np.median(area[around[around >= 0]])
    return out


def evidence(at, fits, cells, own, radius):
    """Sums over the cells around that hang together by circles that fit: all, and the least of the four sides."""
    out = np.zeros((len(cells), 2))
    for i in np.flatnonzero(cells[:, 0] >= 0):
        reached, waiting = {(0, 0): i}, deque([i])
        while waiting:
            k = waiting.popleft()
            for step in STEPS if fits[k] else []:
                r, c = cells[k] + step[::-1]
                place = (int(r - cells[i, 0]), int(c - cells[i, 1]))
                inside = 0 <= r < at.shape[0] and 0 <= c < at.shape[1] and max(map(abs, place)) <= radius
                if inside and at[r, c] >= 0 and place not in reached:
                    reached[place] = at[r, c]
                    waiting.append(at[r, c])
        places, value = np.array(list(reached)), own[list(reached.values())]
        sides = [places[:, 1] >= 0, places[:, 0] >= 0, places[:, 1] <= 0, places[:, 0] <= 0]
        out[i] = value.sum(), min(value[side].sum() for side in sides)
    return out


def smoothness(centres, at, fits, cells):
    """Pitches from the mean of all ways, from the farthest row or square, and how many squares."""
    out = np.tile([np.inf, 0.0, 0.0], (len(cells), 1))
    for i in np.flatnonzero(cells[:, 0] >= 0):
        expected = expect(centres, at, fits, *cells[i])
        if expected is None:
            continue
        straight, squares, _, _ = ways(centres, at, fits, *cells[i])
        each = [off_by(place, expected[1], centres[i]) for place in straight + squares]
        out[i] = off_by(*expected[:2], centres[i]), max(each, default=0.0), len(squares)
    return out


def slants(centres, moments, at, fits, cells):
    """The largest cosine between the ways to two neighbours side by side, where the circle's own ellipse is made round."""
    out = np.zeros(len(cells))
    for i in np.flatnonzero(cells[:, 0] >= 0):
        ways = []
        for step in STEPS:
            r, c = cells[i] + step[::-1]
            j = at[r, c] if 0 <= r < at.shape[0] and 0 <= c < at.shape[1] else -1
            ways.append(np.linalg.solve(np.linalg.cholesky(moments[i]), centres[j] - centres[i]) if j >= 0 and fits[j] else None)
        for one, other in zip(ways, ways[1:] + ways[:1], strict=True):
            if one is not None and other is not None:
                out[i] = max(out[i], abs(one @ other) / np.linalg.norm(one) / np.linalg.norm(other))
    return out


def bumps(grey, centres, at, fits, cells, rise):
    """The largest fall after a rise on the way to a neighbour that fits, as a share of the lower end."""
    out = np.zeros(len(cells))
    for i in np.flatnonzero(cells[:, 0] >= 0):
        for step in STEPS:
            r, c = cells[i] + step[::-1]
            if not (0 <= r < at.shape[0] and 0 <= c < at.shape[1]) or at[r, c] < 0 or not fits[at[r, c]]:
                continue
            values, level = along(grey, centres[i], centres[at[r, c]], 12)
            end = max(min(values[0], values[-1]), 1.0)
            begin = np.flatnonzero((values - np.minimum.accumulate(values) > max(rise[0] * end, rise[1 + level]))[1:-1])
            if len(begin):
                after = values[begin[0] + 1 :]
                out[i] = max(out[i], (np.maximum.accumulate(after) - after).max() / end)
    return out


def stretches(moments, cells, at):
    """The logarithm of an ellipse's axes' ratio where the mean ellipse of the circles around is a circle."""
    out = np.zeros(len(cells))
    for i in np.flatnonzero(cells[:, 0] >= 0):
        r, c = cells[i]
        near = at[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2]
        others = near[(near >= 0) & (near != i)]
        if len(others):
            values = np.linalg.eigvals(np.linalg.solve(moments[others].mean(axis=0), moments[i])).real
            out[i] = 0.5 * np.log(values.max() / values.min())
    return out
