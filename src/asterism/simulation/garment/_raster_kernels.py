"""Triangles on an image: which is in front at each sample, and what the cloth shows there. Twins: tests/twins_garment.py.

An image of h x w pixels has `samples` x `samples` samples in each pixel. Pixel (x, y) covers x - 0.5 to x + 0.5. Buffers cover a window of
samples whose first sample is `corner` (x, y), counted in samples from the upper left of the image.
"""

from __future__ import annotations

import math

from asterism._jit import kernel


@kernel
def rasterise(xy, nearness, triangles, samples, corner, front, owner):
    """Which triangle each sample sees.

    IN  xy (v, 2) px, NaN where a vertex cannot be seen; nearness (v,) 1/m, the inverse of the depth; triangles (t, 3); samples per
        pixel and axis; corner (2,) of the window
    OUT front (h, w) the nearness of the nearest triangle, 0 where none is; owner (h, w) its number, -1 where none is; both filled before
    O(t + samples inside), no allocation. The inverse of the depth is linear in the image; lens distortion within a triangle is left out.

    Bounds: the box of a triangle is cut to the window before its corners become whole numbers.
    """
    height, width = front.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay = (xy[a, 0] + 0.5) * samples - 0.5 - corner[0], (xy[a, 1] + 0.5) * samples - 0.5 - corner[1]
        bx, by = (xy[b, 0] + 0.5) * samples - 0.5 - corner[0], (xy[b, 1] + 0.5) * samples - 0.5 - corner[1]
        cx, cy = (xy[c, 0] + 0.5) * samples - 0.5 - corner[0], (xy[c, 1] + 0.5) * samples - 0.5 - corner[1]
        # Twice the area, with its sign; a triangle seen edge-on covers no sample.
        double = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        # Also where a vertex cannot be seen (NaN).
        if not math.fabs(double) > 1e-9:
            continue
        # Only the samples of the box around the triangle.
        first_x, last_x = max(0.0, math.ceil(min(ax, bx, cx))), min(width - 1.0, math.floor(max(ax, bx, cx)))
        first_y, last_y = max(0.0, math.ceil(min(ay, by, cy))), min(height - 1.0, math.floor(max(ay, by, cy)))
        if first_x > last_x or first_y > last_y:
            continue
        na, nb, nc = nearness[a], nearness[b], nearness[c]
        for y in range(int(first_y), int(last_y) + 1):
            for x in range(int(first_x), int(last_x) + 1):
                wb = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / double
                wc = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / double
                wa = 1.0 - wb - wc
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                # The inverse of the depth is linear in the image, the depth is not.
                near = wa * na + wb * nb + wc * nc
                if near > front[y, x]:
                    front[y, x] = near
                    owner[y, x] = t


@kernel
def shade(xy, nearness, triangles, sheet, light, piece, facing, cells, colours, inks, print_rules, samples, corner, owner, image, seen):
    """The colours of what each sample sees, added up by pixel, and how many samples show each circle.

    IN  xy, nearness, triangles, samples, corner, owner: see `rasterise`; sheet (v, 2) row and column on the sheet; light (v, 3) falling in;
        piece (t,) of the garment, -1 for skin; facing (t,) whether a triangle shows its outside; cells (p, 4) first row, last row, first
        column, last column of each piece; colours (rows, cols) int8; inks (q + 2, 3) reflectance: the colours, cloth, skin; print_rules
        (3,): radius of a circle, width of its soft edge, both in pitches, and 1 / samples^2
    OUT image (h, w, 4) red, green, blue and the share of the pixel that is covered, added to; seen (rows, cols) samples in each circle,
        added to
    O(samples in the window), no allocation.
    """
    height, width = owner.shape
    radius, soft, share = print_rules[0], print_rules[1], print_rules[2]
    q = len(inks) - 2
    for y in range(height):
        for x in range(width):
            t = owner[y, x]
            if t < 0:
                continue
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            px, py = (x + corner[0] + 0.5) / samples - 0.5, (y + corner[1] + 0.5) / samples - 0.5
            double = (xy[b, 0] - xy[a, 0]) * (xy[c, 1] - xy[a, 1]) - (xy[b, 1] - xy[a, 1]) * (xy[c, 0] - xy[a, 0])
            # Weights by nearness, so that a place on the cloth and not one in the image is found.
            wb = ((px - xy[a, 0]) * (xy[c, 1] - xy[a, 1]) - (py - xy[a, 1]) * (xy[c, 0] - xy[a, 0])) / double * nearness[b]
            wc = ((xy[b, 0] - xy[a, 0]) * (py - xy[a, 1]) - (xy[b, 1] - xy[a, 1]) * (px - xy[a, 0])) / double * nearness[c]
            wa = nearness[a] * (1.0 - wb / nearness[b] - wc / nearness[c])
            total = wa + wb + wc
            wa, wb, wc = wa / total, wb / total, wc / total
            # Cloth unless something is printed here: the inside and the seams show none.
            ink, cover = q, 0.0
            p = piece[t]
            # Skin has no print.
            if p < 0:
                ink, cover = q + 1, 1.0
            elif facing[t]:
                row = wa * sheet[a, 0] + wb * sheet[b, 0] + wc * sheet[c, 0]
                column = wa * sheet[a, 1] + wb * sheet[b, 1] + wc * sheet[c, 1]
                i, j = math.floor(row + 0.5), math.floor(column + 0.5)
                if cells[p, 0] <= i <= cells[p, 1] and cells[p, 2] <= j <= cells[p, 3] and colours[i, j] >= 0:
                    ink = colours[i, j]
                    # Distance on the sheet: folds and perspective are in the interpolation already.
                    off = math.sqrt((row - i) ** 2 + (column - j) ** 2)
                    if off <= radius:
                        seen[i, j] += 1
                    # Ink runs into cloth: the edge is soft.
                    cover = 0.5 * math.erfc((off - radius) / (1.4142135623730951 * soft))
            to_y, to_x = (y + corner[1]) // samples, (x + corner[0]) // samples
            image[to_y, to_x, 3] += share
            for channel in range(3):
                falls = wa * light[a, channel] + wb * light[b, channel] + wc * light[c, channel]
                shown = inks[q, channel] + cover * (inks[ink, channel] - inks[q, channel])
                image[to_y, to_x, channel] += share * falls * shown
