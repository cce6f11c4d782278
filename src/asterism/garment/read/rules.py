"""How circles are found and read."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReadRules:
    """Chosen on rendered suits and sheets of other seeds than those that the figures are measured on.

    least_colour   difference between the largest and smallest channel, of 255, that a circle has at least
    noisy          standard deviation of a pixel, of 255, from which on an image is smoothed more
    noise_factor   added to it for each unit of noise that smoothing leaves: colourless noise has differences, too
    least_area     px2, of a circle
    largest_area   px2
    longest_side   px, of its box
    least_fill     area as a share of the ellipse with its second moments
    least_height   how far a circle's highest pixel is above the threshold that bounds it
    noise_height   added to it for each unit of noise that smoothing leaves
    bound          threshold that bounds a circle, as a share of its highest value, at least
    most_circles   in one image
    centre_floor   px, standard deviation of a centre without noise: pixels are square
    blur_moment    px2, what lens, pixel and smoothing add to a circle's second moments
    least_moment   px2, of the shorter axis
    reach          pitches, how far neighbours are searched, as the circle's own ellipse has it
    side           (2,) pitches, of a lattice vector as the ellipse has it
    square         sine of the angle between two lattice vectors, as the ellipse has it, at least
    fit            pitches, by which a neighbour may be off its place
    length     (2,) pitches, of a link as the ellipses at its ends have it, in the mean
    rise       share of a circle's colourfulness by which the gap to its neighbour may rise and fall in between
    rise_noise the same, in standard deviations of the noise
    misread        share of colours that are misread at most, in the evidence
    alone          nats, evidence that the whole map of a neighbourhood needs beyond chance
    nearby         nats, evidence within two circles of one
    each_side      nats, evidence on the side of one that has least
    skew           how far a square of four linked circles may be from a parallelogram, as a share of its sides
    squares        of four linked circles that a circle closes, at least; one within half of `skew` counts twice
    astray         share of circles at the rim of a neighbourhood that are of another part of the cloth, before their colours are seen
    shown_few      (2,) identities measured whose circles close just so many squares, and how many of them were wrong
    shown_more     (2,) the same, of circles that close more. Measured on 102 rendered images of suits, 1280 x 960: three lights, noise of 1
                   to 10 %, blur, JPEG, two motions, three wearers, three patterns; not the images that the rest was chosen on
    """

    least_colour: float = 18.0
    noisy: float = 12.0
    noise_factor: float = 3.4
    noise_height: float = 2.5
    least_area: float = 4.0
    largest_area: float = 6000.0
    longest_side: float = 120.0
    least_fill: float = 0.88
    least_height: float = 12.0
    bound: float = 0.45
    most_circles: int = 20_000
    centre_floor: float = 0.03
    blur_moment: float = 0.5
    least_moment: float = 0.15
    reach: float = 1.9
    side: tuple[float, float] = (0.6, 1.6)
    square: float = 0.7
    fit: float = 0.34
    length: tuple[float, float] = (0.65, 1.4)
    rise: float = 0.08
    rise_noise: float = 1.3
    misread: float = 0.01
    alone: float = 16.0
    nearby: float = 12.0
    each_side: float = 5.0
    skew: float = 0.2
    squares: int = 2
    astray: float = 1e-3
    shown_few: tuple[int, int] = (8_839, 2)
    shown_more: tuple[int, int] = (93_827, 0)
