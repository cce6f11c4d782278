"""Kernels that find circles on dark cloth in an image's colourfulness, and measure them."""

from __future__ import annotations

import numpy as np

from asterism._jit import kernel


@kernel(inline=True)
def _smooth(above, row, below, down, out):
    """Weights 1, 2, 1 down and across, a row of pixels with three channels each; rounded to the nearest.

    IN  above, row, below (3 w,) uint8
    WORK down (3 w,) uint16
    OUT out (3 w,) uint8, of the pixels but for the first and the last

    The casts keep each sum in 16 bits, so that sixteen fit into a vector register. O(w), no allocation.
    """
    for i in range(len(row)):
        down[i] = np.uint16(np.uint16(above[i]) + np.uint16(np.uint16(row[i]) << np.uint16(1)) + np.uint16(below[i]))
    # Slices of equal length instead of indices with offsets: the compiler then takes many pixels at once.
    count = len(row) - 6
    left, middle, right, inner = down[:count], down[3 : 3 + count], down[6 : 6 + count], out[3 : 3 + count]
    for i in range(count):
        ends = np.uint16(left[i] + np.uint16(right[i] + np.uint16(8)))
        inner[i] = np.uint8(np.uint16(ends + np.uint16(middle[i] << np.uint16(1))) >> np.uint16(4))


@kernel
def colourfulness(image, smooth, out):
    """The difference between the largest and the smallest channel of each pixel; 0 in the outermost rows and columns.

    IN  image (h, 3 w) uint8, three channels of a pixel side by side; smooth, whether 3 x 3 pixels are averaged with weights 1, 2, 1
    OUT out (h, w) uint8

    O(h w), allocates two rows. Twin: tests/twins_garment_read.py
    """
    height, width = out.shape
    down, smoothed = np.empty(3 * width, np.uint16), np.empty(3 * width, np.uint8)
    for y in range(height):
        line = out[y]
        # The border has no neighbours to be smoothed with; 0 there also ends every run before the image does.
        if y == 0 or y == height - 1 or width < 3:
            line[:] = 0
            continue
        pixels = image[y]
        if smooth:
            _smooth(image[y - 1], image[y], image[y + 1], down, smoothed)
            pixels = smoothed
        for x in range(1, width - 1):
            a, b, c = pixels[3 * x], pixels[3 * x + 1], pixels[3 * x + 2]
            line[x] = max(max(a, b), c) - min(min(a, b), c)
        line[0], line[width - 1] = 0, 0


@kernel
def count_bends(image, counts):
    """How often each second difference of the green value along every eighth row occurs.

    IN  image (h, w, 3) uint8
    OUT counts (511,) int64, of the absolute values

    O(h w / 8), no allocation. Twin: tests/twins_garment_read.py
    """
    counts[:] = 0
    # Every eighth row is enough for a median of thousands of values.
    for y in range(0, image.shape[0], 8):
        row = image[y]
        for x in range(1, image.shape[1] - 1):
            counts[abs(2 * np.int64(row[x, 1]) - np.int64(row[x - 1, 1]) - np.int64(row[x + 1, 1]))] += 1


@kernel
def _longer(rows, least):
    """Rows (n, k), with as many again and `least` more that are not filled."""
    out = np.empty((2 * len(rows) + least, rows.shape[1]), np.int32)
    out[: len(rows)] = rows
    return out


@kernel
def _runs_above(grey, threshold):
    """Runs (n, 4) of an image's rows above a threshold, row by row: row, first and last column, highest value.

    Returns an array with room for more, and how many there are. The image's outermost columns are 0. Eight pixels at a time are passed over
    where none is above, and within a run where all are.

    Bounds: a row has no more runs than pixels, and before each row there is room for `width` more.
    """
    width = grey.shape[1]
    # At least eight zeros behind the row end its last run, and let eight pixels be read as one word.
    above = np.zeros((width + 15) // 8 * 8, np.uint8)
    words = above.view(np.uint64)
    none, whole = np.uint64(0), np.uint64(0x0101010101010101)
    runs, count = np.empty((4 * width, 4), np.int32), 0
    for y in range(len(grey)):
        line = grey[y]
        # A loop without a branch, which the compiler makes into a few wide comparisons.
        for x in range(width):
            above[x] = line[x] > threshold
        # Room for the fullest row is made before it, so that no run has to ask.
        if count + width > len(runs):
            runs = _longer(runs, width)
        first = -1
        for place in range(len(words)):
            word = words[place]
            # Nothing begins and nothing ends within these eight pixels.
            if (word == none and first < 0) or (word == whole and first >= 0):
                continue
            for x in range(8 * place, 8 * place + 8):
                if above[x] != 0:
                    first = x if first < 0 else first
                elif first >= 0:
                    # The highest value is looked up when a run ends: within it, whole words were passed over unread.
                    highest = np.uint8(0)
                    for k in range(first, x):
                        highest = max(highest, line[np.uint64(k)])
                    runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = y, first, x - 1, highest
                    count += 1
                    first = -1
    return runs, count


@kernel
def _runs_within(grey, threshold, within, runs):
    """The same of the pixels in other runs (m, 4), which are in the order of rows and columns. Returns how many.

    Bounds: runs within one are apart by a pixel at least, so that k of them take 2 k - 1 pixels. `runs` needs the sum of
    (length + 1) // 2 over the other runs.
    """
    count = 0
    for k in range(len(within)):
        y, last = np.uint64(within[k, 0]), np.int64(within[k, 2])
        # Its highest value says that nothing is left of this run.
        if within[k, 3] <= threshold:
            continue
        first, highest = np.int64(-1), 0
        for x in range(np.int64(within[k, 1]), last + 1):
            value = np.int64(grey[y, np.uint64(x)])
            if value > threshold:
                first = x if first < 0 else first
                highest = max(highest, value)
            elif first >= 0:
                runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = y, first, x - 1, highest
                count += 1
                first, highest = -1, 0
        if first >= 0:
            runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = y, first, last, highest
            count += 1
    return count


@kernel
def _connect(runs, count, roots, starts, order):
    """Parts of runs that hang together by the sides of their pixels, in the order of their first pixels, and the runs of each in order.

    IN   runs (n, 4) in the order of rows and columns, of which `count` are used
    WORK roots (n,)
    OUT  starts (n + 1,), order (n,): the runs of part k are order[starts[k] : starts[k + 1]]

    Returns how many parts; each has a run, so they are `count` at most. O(n), but for the search of roots. Union-find, the root is a part's
    first run.

    Bounds: each part has a run, so there are `count` at most, and `starts` has one more.
    """
    other = 0
    for k in range(count):
        roots[k] = k
        y, first, last = runs[k, 0], runs[k, 1], runs[k, 2]
        # Both rows are in order of columns: what ends before this run begins touches no later one either.
        while runs[other, 0] < y - 1 or (runs[other, 0] == y - 1 and runs[other, 2] < first):
            other += 1
        m = other
        while runs[m, 0] == y - 1 and runs[m, 1] <= last:
            a, b = roots[k], m
            # The ways of the row above are shortened as they are walked, since its later runs walk them again.
            while roots[b] != b:
                roots[b] = roots[roots[b]]
                b = roots[b]
            while roots[a] != a:
                a = roots[a]
            # The first run is the root, so that parts come in the order of their first pixels.
            roots[max(a, b)] = min(a, b)
            m += 1
    parts = 0
    for k in range(count):
        # What a run's entry leads to comes before it, and holds the number of its part by then: -1 for the first.
        if roots[k] == k:
            parts += 1
            roots[k], starts[parts] = -parts, 0
        else:
            roots[k] = roots[roots[k]]
        # Counting sort by part: sizes here, then where each begins, then each run to its place.
        starts[-roots[k]] += 1
    starts[0] = 0
    for k in range(parts):
        starts[k + 1] += starts[k]
    # From the last run to the first, so that each part's runs keep their order.
    for k in range(count - 1, -1, -1):
        part = -roots[k] - 1
        starts[part + 1] -= 1
        order[starts[part + 1]] = k
    for k in range(parts):
        starts[k] = starts[k + 1]
    starts[parts] = count
    return parts


@kernel
def _describe(runs, order, begin, end, box, sums):
    """How many pixels there are in the runs order[begin:end], and the highest value.

    Fills box (4,) with the smallest and largest x and y, sums (5,) with x, y, xx, xy, yy from the first pixel on.
    """
    # From the first pixel on: sums of squares stay small enough to be exact.
    y0, x0 = np.int64(runs[order[begin], 0]), np.int64(runs[order[begin], 1])
    area, left, right, y = 0, x0, x0, y0
    highest = np.int64(0)
    sx, sy, sxx, sxy, syy = 0, 0, 0, 0, 0
    for i in range(begin, end):
        k = order[i]
        y, first, last = np.int64(runs[k, 0]), np.int64(runs[k, 1]), np.int64(runs[k, 2])
        highest = max(highest, np.int64(runs[k, 3]))
        left, right = min(left, first), max(right, last)
        run, dx, dy = last - first + 1, first - x0, y - y0
        # Sums over a run in closed form: 0 + 1 + ... and their squares.
        within = run * (run - 1) // 2
        sum_x = run * dx + within
        area += run
        sx += sum_x
        sy += dy * run
        sxx += run * dx * dx + 2 * dx * within + within * (2 * run - 1) // 3
        sxy += dy * sum_x
        syy += dy * dy * run
    box[0], box[1], box[2], box[3] = left, right, y0, y
    sums[0], sums[1], sums[2], sums[3], sums[4] = sx, sy, sxx, sxy, syy
    return area, highest


@kernel
def _fill(area, sums):
    """The area of a region as a share of the ellipse that has its second moments: 1 for a filled ellipse, less for two that touch."""
    mx, my = sums[0] / area, sums[1] / area
    # A pixel is a square with a variance of its own, 1 / 12, without which a line would be an ellipse of no area.
    xx, xy, yy = sums[2] / area - mx * mx + 1 / 12, sums[3] / area - mx * my, sums[4] / area - my * my + 1 / 12
    return area / (4.0 * np.pi * np.sqrt(max(xx * yy - xy * xy, 1e-9)))


COUNT, KEPT, WAITS, USED = 0, 1, 2, 3
"""Places in the state of `_sort_out`: regions and their runs so far, parts that wait and their runs."""


@kernel
def _sort_out(size, limits, threshold, depth, runs, starts, order, first_part, last_part, regions, held, waiting, inner, state, box, sums):
    """Of the parts above a threshold, put those of an ellipse's shape among the regions, and let the others wait for a higher threshold.

    IN  size (2,) of the image; limits; threshold, depth: how many were lower; runs (n, 4), starts, order of `_connect`; first and last part
    IO  regions, held of `find_regions`; waiting (n, 3): first run in `inner`, next threshold, depth; inner (n, 4); state (4,)
    WORK box (4,), sums (5,)

    Bounds: the caller sees to it that `held` has room for all runs between `first_part` and `last_part`, and `waiting` and `inner` for
    those of a region of the lowest threshold.
    """
    for part in range(first_part, last_part):
        begin, end = np.int64(starts[part]), np.int64(starts[part + 1])
        area, most = _describe(runs, order, begin, end, box, sums)
        # Too small, or too flat to be told from noise: no higher threshold finds a circle in it.
        if area < limits[0] or most - threshold < limits[3]:
            continue
        # What is too large to be a circle may hold circles: it waits for a higher threshold.
        small = area <= limits[1] and max(box[1] - box[0], box[3] - box[2]) < limits[4]
        if small and threshold >= limits[5] * most and _fill(area, sums) >= limits[2]:
            # A circle that the image cuts has its centre in the wrong place.
            edge = box[0] <= 1 or box[2] <= 1 or box[1] >= size[1] - 2 or box[3] >= size[0] - 2
            count, kept = state[COUNT], state[KEPT]
            if count >= len(regions) or edge:
                continue
            for k in range(4):
                regions[count, k] = box[k]
            regions[count, 4], regions[count, 5], regions[count, 6] = most, threshold, kept
            for i in range(begin, end):
                k = order[i]
                held[kept, 0], held[kept, 1], held[kept, 2] = runs[k, 0], runs[k, 1], runs[k, 2]
                kept += 1
            regions[count, 7] = kept
            state[COUNT], state[KEPT] = count + 1, kept
        elif depth < 8 and area > 2 * limits[0]:
            # A quarter of what is left, but never less than what a circle must rise: few steps, and none passes over a circle.
            step = threshold + max(limits[3], (most - threshold) // 4)
            # Small enough for a circle: at once to the threshold that bounds one.
            if small:
                step = max(step, limits[5] * most)
            waits, used = state[WAITS], state[USED]
            waiting[waits, 0], waiting[waits, 1], waiting[waits, 2] = used, step, depth + 1
            for i in range(begin, end):
                k = order[i]
                inner[used, 0], inner[used, 1], inner[used, 2], inner[used, 3] = runs[k, 0], runs[k, 1], runs[k, 2], runs[k, 3]
                used += 1
            state[WAITS], state[USED] = waits + 1, used


@kernel
def find_regions(grey, lowest, limits, regions):
    """Regions of a filled ellipse's shape: those above the lowest threshold, and within the others those above a higher one.

    A region that is no ellipse (two that touch, one before a coloured wall) is cut again at a threshold a quarter of the way to its highest
    value, as often as something is left. All is done on runs of pixels in a row, so that the background costs one comparison a pixel.

    IN  grey (h, w) uint8 of `colourfulness`; lowest threshold; limits (6,): smallest and largest area px2, smallest fill, smallest height
        above the threshold, longest side of the box px, threshold as a share of the highest value
    OUT regions (most, 8) int32: smallest and largest x and y, highest value, threshold, first of its runs, first of the next one's

    Returns the number of regions and their runs (m, 3) int32: row, first and last column. Regions beyond `most` are left out.
    O(h w + pixels of regions times thresholds); allocates some 40 bytes a run of the lowest threshold, and 68 for each run that the
    largest region there can have at higher ones. Twin: tests/twins_garment_read.py

    Bounds: `room` is the largest sum over a region's runs of (length + 1) // 2. Two runs above a higher threshold are apart by a pixel at
    least, so that a run of n pixels holds (n + 1) // 2 of them at most; n = 1 holds one, which is why half of the pixels is too little.
    That bounds `parted`. Parts that wait share no pixel, and no two of their runs touch within a row: it bounds `inner`. Each part that
    waits has a run: it bounds `waiting`. `held` is made longer where the next part's runs may not fit.
    """
    size = grey.shape
    box, sums, state = np.empty(4, np.int64), np.empty(5), np.zeros(4, np.int64)
    whole, number = _runs_above(grey, lowest)
    ends = np.empty((3, number + 1), np.int32)
    starts, order = ends[1], ends[2]
    tops = _connect(whole, number, ends[0], starts, order)
    # Room for the largest region's runs at any threshold, see Bounds.
    room = 0
    for top in range(tops):
        divided = 0
        for i in range(starts[top], starts[top + 1]):
            divided += (np.int64(whole[order[i], 2]) - whole[order[i], 1] + 2) // 2
        room = max(room, divided)
    waiting = np.empty((room, 3), np.int64)
    inner, parted, inner_ends = np.empty((room, 4), np.int32), np.empty((room, 4), np.int32), np.empty((3, room + 1), np.int32)
    inner_starts, inner_order = inner_ends[1], inner_ends[2]
    held = np.empty((number + room, 3), np.int32)
    for top in range(tops):
        # Before the part, since `_sort_out` writes all of its runs or none.
        if state[KEPT] + room > len(held):
            held = _longer(held, room)
        _sort_out(size, limits, lowest, 0, whole, starts, order, top, top + 1, regions, held, waiting, inner, state, box, sums)
        while state[WAITS]:
            # The runs of the part that waits are the last ones in `inner`, and parts of it that wait are put in their place.
            state[WAITS] -= 1
            begin, threshold, depth = waiting[state[WAITS], 0], waiting[state[WAITS], 1], waiting[state[WAITS], 2]
            # Only the pixels of this part are looked at again, not the image.
            cut = _runs_within(grey, threshold, inner[begin : state[USED]], parted)
            parts = _connect(parted, cut, inner_ends[0], inner_starts, inner_order)
            # Its runs in `inner` are no longer needed: what waits of it takes their place.
            state[USED] = begin
            if state[KEPT] + cut > len(held):
                held = _longer(held, cut)
            _sort_out(
                size, limits, threshold, depth, parted, inner_starts, inner_order, 0, parts, regions, held, waiting, inner, state, box, sums
            )  # fmt: skip
    return state[COUNT], held[: state[KEPT]]


@kernel
def measure(image, linear, grey, held, regions, noise, out):
    """Centre, second moments, covariance and colour of each region, by how much of each pixel it covers.

    Coverage is 0 at the colourfulness of the cloth around the region and 1 at that of its inner pixels. It is summed over the region and
    two pixels around it that belong to no other.

    IN  image (h, w, 3) uint8 blue, green, red; linear (256,) light of a pixel's value; grey (h, w) uint8; held (m, 3) int32, regions (n, 8)
        of `find_regions`; noise, standard deviation of a channel's value
    OUT out (n, 12): x, y, covariance xx, xy, yy px2, second moments xx, xy, yy px2, area px2, mean light of blue, green, red

    O(pixels of the regions), no allocation. Twin: tests/twins_garment_read.py
    """
    height, width = grey.shape
    for i in range(len(regions)):
        # Two pixels around: the blurred rim of a circle lies outside the threshold and belongs to it.
        x0, x1 = max(regions[i, 0] - 2, 0), min(regions[i, 1] + 2, width - 1)
        y0, y1 = max(regions[i, 2] - 2, 0), min(regions[i, 3] + 2, height - 1)
        first_run, last_run, threshold = np.int64(regions[i, 6]), np.int64(regions[i, 7]), np.int64(regions[i, 5])
        # Inner pixels are those above half of the way, where coverage is nearly whole.
        half = 0.5 * (regions[i, 4] + regions[i, 5])
        inner, inners = 0, 0
        lowest = np.uint8(255)
        for y in range(y0, y1 + 1):
            for value in grey[y, x0 : x1 + 1]:
                lowest = min(lowest, value)
        for run in range(first_run, last_run):
            for value in grey[held[run, 0], held[run, 1] : held[run, 2] + 1]:
                if value >= half:
                    inner += np.int64(value)
                    inners += 1
        # The darkest pixel around is the cloth, raised by what the darkest of several noisy pixels lies below their mean.
        ground = min(lowest + 0.6 * noise, 0.5 * half)
        full = inner / inners
        # At least one grey value, so that a flat spot does not divide by zero.
        span = max(full - ground, 1.0)
        area, mx, my = 0.0, 0.0, 0.0
        xx, xy, yy = 0.0, 0.0, 0.0
        wxx, wxy, wyy = 0.0, 0.0, 0.0
        blue, green, red, cores = 0.0, 0.0, 0.0, 0.0
        cx, cy = 0.5 * (regions[i, 0] + regions[i, 1]), 0.5 * (regions[i, 2] + regions[i, 3])
        run = first_run
        for y in range(y0, y1 + 1):
            line, dy = grey[y], y - cy
            # Own pixels are those between `first` and `last`; then the next run's.
            first, last = x1 + 1, x1 + 1
            if run < last_run and held[run, 0] == y:
                first, last = np.int64(held[run, 1]), np.int64(held[run, 2])
                run += 1
            for x in range(x0, x1 + 1):
                if x > last:
                    first, last = x1 + 1, x1 + 1
                    if run < last_run and held[run, 0] == y:
                        first, last = np.int64(held[run, 1]), np.int64(held[run, 2])
                        run += 1
                value = np.int64(line[x])
                mine = x >= first
                # A pixel above the threshold that is not this region's is another circle's.
                if value <= ground or not (mine or value <= threshold):
                    continue
                cover = min((value - ground) / span, 1.0)
                # How far the centre moves with this pixel's noise: the derivative of its squared coverage.
                weight = (2.0 * cover) ** 2 if cover < 1.0 else 1.0
                # Squared, so that the rim, where light of the surroundings comes in, counts less.
                cover *= cover
                dx = x - cx
                area += cover
                mx += cover * dx
                my += cover * dy
                xx += cover * dx * dx
                xy += cover * dx * dy
                yy += cover * dy * dy
                wxx += weight * dx * dx
                wxy += weight * dx * dy
                wyy += weight * dy * dy
                # Colour from the inner pixels alone: the rim mixes it with the cloth's.
                if mine and cover > 0.4:
                    blue += linear[image[y, x, 0]]
                    green += linear[image[y, x, 1]]
                    red += linear[image[y, x, 2]]
                    cores += 1.0
        mx /= area
        my /= area
        # Variance of a centre whose pixels each have the noise, to first order.
        share = 2.0 * (noise / (span * area)) ** 2
        cores = max(cores, 1.0)
        out[i, 0], out[i, 1] = cx + mx, cy + my
        out[i, 2], out[i, 3], out[i, 4] = share * wxx, share * wxy, share * wyy
        out[i, 5], out[i, 6], out[i, 7] = xx / area - mx * mx, xy / area - mx * my, yy / area - my * my
        out[i, 8], out[i, 9], out[i, 10], out[i, 11] = area, blue / cores, green / cores, red / cores
