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
    count = len(row) - 6
    left, middle, right, inner = down[:count], down[3 : 3 + count], down[6 : 6 + count], out[3 : 3 + count]
    for i in range(count):
        ends = np.uint16(left[i] + np.uint16(right[i] + np.uint16(8)))
        inner[i] = np.uint8(np.uint16(ends + np.uint16(middle[i] << np.uint16(1))) >> np.uint16(4))


@kernel
def colourfulness(image, smooth, out, highest):
    """The difference between the largest and the smallest channel of each pixel; 0 in the outermost rows and columns.

    IN  image (h, 3 w) uint8, three channels of a pixel side by side; smooth, whether 3 x 3 pixels are averaged with weights 1, 2, 1
    OUT out (h, w) uint8; highest (h, w // 16 + 1) uint8, the largest value of each 16 pixels of a row

    O(h w), allocates two rows. Twin: tests/twins_garment_read.py
    """
    height, width = out.shape
    down, smoothed = np.empty(3 * width, np.uint16), np.empty(3 * width, np.uint8)
    for y in range(height):
        line, most = out[y], highest[y]
        line[:] = 0
        most[:] = 0
        if y == 0 or y == height - 1 or width < 3:
            continue
        pixels = image[y]
        if smooth:
            _smooth(image[y - 1], image[y], image[y + 1], down, smoothed)
            pixels = smoothed
        for x in range(1, width - 1):
            a, b, c = pixels[3 * x], pixels[3 * x + 1], pixels[3 * x + 2]
            line[x] = max(max(a, b), c) - min(min(a, b), c)
        for x in range(width):
            most[x >> 4] = max(most[x >> 4], line[x])


@kernel
def _flood(grey, labels, width, start, old, new, threshold, stack, box, sums):
    """Give the pixels above a threshold that hang together with one another, by their sides, a new label. Returns how many and the highest.

    grey, labels and start are of the flat image, whose border is 0. Only pixels with the label `old` take part. Fills box (4,) with the
    smallest and largest x and y, sums (5,) with x, y, xx, xy, yy from the start on. Goes along runs of a row: where such a run meets
    pixels of the row above or below, the first of each wait on the stack.
    """
    y0 = start // width
    x0 = start - y0 * width
    stack[0, 0], stack[0, 1], stack[0, 2] = start, 0, 0
    top, area, highest = 1, 0, 0
    left, right, above, below = 0, 0, 0, 0
    sx, sy, sxx, sxy, syy = 0, 0, 0, 0, 0
    while top:
        top -= 1
        place = np.int64(stack[top, 0])
        if labels[place] != old:
            continue
        dx, dy = np.int64(stack[top, 1]), np.int64(stack[top, 2])
        while grey[place - 1] > threshold and labels[place - 1] == old:
            place -= 1
            dx -= 1
        left, above, below = min(left, dx), min(above, dy), max(below, dy)
        first, begin, sum_x = place, dx, 0
        while grey[place] > threshold and labels[place] == old:
            labels[place] = new
            highest = max(highest, np.int64(grey[place]))
            sum_x += dx
            sxx += dx * dx
            place += 1
            dx += 1
        run = dx - begin
        area += run
        right = max(right, dx - 1)
        sx += sum_x
        sy += dy * run
        sxy += dy * sum_x
        syy += dy * dy * run
        for down in (-1, 1):
            before = False
            for i in range(run):
                there = first + i + down * width
                now = grey[there] > threshold and labels[there] == old
                if now and not before:
                    stack[top, 0], stack[top, 1], stack[top, 2] = there, begin + i, dy + down
                    top += 1
                before = now
    box[0], box[1], box[2], box[3] = x0 + left, x0 + right, y0 + above, y0 + below
    sums[0], sums[1], sums[2], sums[3], sums[4] = sx, sy, sxx, sxy, syy
    return area, highest


@kernel
def _fill(area, sums):
    """The area of a region as a share of the ellipse that has its second moments: 1 for a filled ellipse, less for two that touch."""
    mx, my = sums[0] / area, sums[1] / area
    xx, xy, yy = sums[2] / area - mx * mx + 1 / 12, sums[3] / area - mx * my, sums[4] / area - my * my + 1 / 12
    return area / (4.0 * np.pi * np.sqrt(max(xx * yy - xy * xy, 1e-9)))


@kernel
def find_regions(grey, highest, lowest, limits, labels, stack, regions):
    """Regions of a filled ellipse's shape: those above the lowest threshold, and within the others those above a higher one.

    A region that is no ellipse (two that touch, one before a coloured wall) is cut again at a threshold a quarter of the way to its highest
    value, as often as something is left.

    IN   grey (h, w) uint8; highest (h, w // 16 + 1) uint8 of `colourfulness`; lowest threshold; limits (6,): smallest and largest area px2,
         smallest fill, smallest height above the threshold, longest side of the box px, threshold as a share of the highest value
    WORK labels (h, w) int32, filled with 0; stack (h w, 3) int32
    OUT  regions (most, 7) int32: smallest and largest x and y, highest value, threshold, label; labels as said there

    Returns their number. O(h w + pixels of regions times thresholds). Twin: tests/twins_garment_read.py
    """
    height, width = grey.shape
    flat, marks = grey.ravel(), labels.ravel()
    box, sums = np.empty(4, np.int64), np.empty(5)
    waiting = np.empty((4096, 7), np.int64)
    count, label = 0, 0
    for y0 in range(height):
        for block in range(highest.shape[1]):
            if highest[y0, block] <= lowest:
                continue
            for x0 in range(16 * block, min(16 * block + 16, width)):
                if grey[y0, x0] <= lowest or labels[y0, x0] != 0:
                    continue
                waits = 1
                waiting[0, 0], waiting[0, 1], waiting[0, 2], waiting[0, 3] = x0, x0, y0, y0
                waiting[0, 4], waiting[0, 5], waiting[0, 6] = lowest, 0, 0
                while waits:
                    waits -= 1
                    left, right, above, below = waiting[waits, 0], waiting[waits, 1], waiting[waits, 2], waiting[waits, 3]
                    threshold, old, depth = waiting[waits, 4], waiting[waits, 5], waiting[waits, 6]
                    for y in range(above, below + 1):
                        for x in range(left, right + 1):
                            if labels[y, x] != old or grey[y, x] <= threshold:
                                continue
                            label += 1
                            area, most = _flood(flat, marks, width, y * width + x, old, label, threshold, stack, box, sums)
                            if area < limits[0] or most - threshold < limits[3]:
                                continue
                            small = area <= limits[1] and max(box[1] - box[0], box[3] - box[2]) < limits[4]
                            edge = box[0] <= 1 or box[2] <= 1 or box[1] >= width - 2 or box[3] >= height - 2
                            if small and threshold >= limits[5] * most and _fill(area, sums) >= limits[2]:
                                if count < len(regions) and not edge:
                                    regions[count, 0], regions[count, 1], regions[count, 2], regions[count, 3] = (
                                        box[0],
                                        box[1],
                                        box[2],
                                        box[3],
                                    )
                                    regions[count, 4], regions[count, 5], regions[count, 6] = most, threshold, label
                                    count += 1
                            elif depth < 8 and waits < len(waiting) and area > 2 * limits[0]:
                                waiting[waits, 0], waiting[waits, 1], waiting[waits, 2], waiting[waits, 3] = box[0], box[1], box[2], box[3]
                                step = threshold + max(limits[3], (most - threshold) // 4)
                                if small:
                                    step = max(step, limits[5] * most)
                                waiting[waits, 4], waiting[waits, 5], waiting[waits, 6] = step, label, depth + 1
                                waits += 1
    return count


@kernel
def measure(image, linear, grey, labels, regions, noise, out):
    """Centre, second moments, covariance and colour of each region, by how much of each pixel it covers.

    Coverage is 0 at the colourfulness of the cloth around the region and 1 at that of its inner pixels. It is summed over the region and
    two pixels around it that belong to no other.

    IN  image (h, w, 3) uint8 blue, green, red; linear (256,) light of a pixel's value; grey (h, w) uint8; labels (h, w) int32;
        regions (n, 7) of `find_regions`; noise, standard deviation of a channel's value
    OUT out (n, 12): x, y, covariance xx, xy, yy px2, second moments xx, xy, yy px2, area px2, mean light of blue, green, red

    O(pixels of the regions), no allocation. Twin: tests/twins_garment_read.py
    """
    height, width = grey.shape
    for i in range(len(regions)):
        own = regions[i, 6]
        x0, x1 = max(regions[i, 0] - 2, 0), min(regions[i, 1] + 2, width - 1)
        y0, y1 = max(regions[i, 2] - 2, 0), min(regions[i, 3] + 2, height - 1)
        half = 0.5 * (regions[i, 4] + regions[i, 5])
        inner, inners = 0.0, 0
        lowest = 255
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                value = np.int64(grey[y, x])
                if labels[y, x] == own and value >= half:
                    inner += value
                    inners += 1
                lowest = min(lowest, value)
        ground = min(lowest + 0.6 * noise, 0.5 * half)
        full = inner / inners
        span = max(full - ground, 1.0)
        area, mx, my = 0.0, 0.0, 0.0
        xx, xy, yy = 0.0, 0.0, 0.0
        wxx, wxy, wyy = 0.0, 0.0, 0.0
        blue, green, red, cores = 0.0, 0.0, 0.0, 0.0
        cx, cy = 0.5 * (regions[i, 0] + regions[i, 1]), 0.5 * (regions[i, 2] + regions[i, 3])
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                mine = labels[y, x] == own
                if not mine and grey[y, x] > regions[i, 5]:
                    continue
                cover = min(max((grey[y, x] - ground) / span, 0.0), 1.0)
                weight = (2.0 * cover) ** 2 if cover < 1.0 else 1.0
                cover *= cover
                dx, dy = x - cx, y - cy
                area += cover
                mx += cover * dx
                my += cover * dy
                xx += cover * dx * dx
                xy += cover * dx * dy
                yy += cover * dy * dy
                wxx += weight * dx * dx
                wxy += weight * dx * dy
                wyy += weight * dy * dy
                if mine and cover > 0.4:
                    blue += linear[image[y, x, 0]]
                    green += linear[image[y, x, 1]]
                    red += linear[image[y, x, 2]]
                    cores += 1.0
        mx /= area
        my /= area
        share = 2.0 * (noise / (span * area)) ** 2
        cores = max(cores, 1.0)
        out[i, 0], out[i, 1] = cx + mx, cy + my
        out[i, 2], out[i, 3], out[i, 4] = share * wxx, share * wxy, share * wyy
        out[i, 5], out[i, 6], out[i, 7] = xx / area - mx * mx, xy / area - mx * my, yy / area - my * my
        out[i, 8], out[i, 9], out[i, 10], out[i, 11] = area, blue / cores, green / cores, red / cores
