"""How circles are found and read."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EndRules:
    """What a circle needs besides its odds where few others hold it: at the rim of a limb, beside a fold or a seam.

    Linear odds cannot say that. On 324 images (generator seeds 5501, 6602, 7703), of circles with weighted odds above 6.5, 24 of 8,341 were
    wrong that closed one square of four or none, 7 of 61,611 that closed two, and none of 317,654 others: at the rim of a limb the next row
    is hidden or a blob of several, and the one beyond it lies where it should and has its colour by chance. On the same images none of
    378,959 identities is wrong by these rules.

    squares  that a circle closes with three others: for those with so many at most. None at all is never enough
    slant    cosine of the angle between two ways to neighbours, as the circle's own ellipse has it, at most
    bump     fall of the colourfulness on the way to a neighbour, at most
    rival    pitches from where another, empty cell is expected, at least
    own      nats of the circle's own colour, at least
    """

    squares: int
    slant: float
    bump: float
    rival: float = 0.0
    own: float = 1.2


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
    most_circles   in one image; more are left out, which is said (`garment-many-circles`)
    centre_floor   px, standard deviation of a centre without noise: pixels are square
    blur_moment    px2, what lens, pixel and smoothing add to a circle's second moments
    least_moment   px2, of the shorter axis
    reach          pitches, how far neighbours are searched, as the circle's own ellipse has it
    side           (2,) pitches, of a lattice vector as the ellipse has it
    square         sine of the angle between two lattice vectors, as the ellipse has it, at least
    fit            pitches, by which a neighbour may be off its place
    length         (2,) pitches, of a link as the ellipses at its ends have it, in the mean
    rise           share of a circle's colourfulness by which the gap to its neighbour may rise and fall in between
    rise_noise     the same, in standard deviations of the noise
    cloth_noise    the same, in standard deviations of what dark cloth shows, at the size of the image at which the gap has some ten pixels
    misread        share of colours that are misread at most, in the evidence
    map_evidence   nats, evidence that the whole map of a neighbourhood needs beyond chance
    map_evidence_supported  the same where other maps that have `map_evidence` hold more than half of the circles that have a cell: the
                   image does show this garment then, and the place that a small patch really has is on the sheet
    patch          circles of a patch without whole blocks that have the colours of one place on the sheet, at least
    misses         colours of such a patch that may be others
    gate           pitches, by which a circle may be off where rows and columns go on
    bump           (2,) rise of the colourfulness between two neighbours that counts: as a share of the lower end, and at least
    weights        of log odds, fitted (logistic regression) on the circles of 45 rendered images, each with the colours of four patterns:
                   1, nats on the weakest side, a third of the nats around, logarithm of the pitches off the mean of all ways and off the
                   farthest one, pitches from where another cell is expected, squares, own nats, bump
    odds           log odds that a circle needs
    unlike         loss of log odds by how far the logarithm of a circle's area is from that of its neighbours
    slant, slanted how far its ellipse's shape may be from theirs, in what pixels and folds make of it, and the loss of log odds by the
                   square of what is beyond: of 42,947 right circles (36 rendered suits, seed 6203) 99 % are below 0.9, 99.9 % below 1.3
    end, corner    what it needs besides where it closes two squares at most, and one
    astray         pitches, by which a circle may be off one of the ways in which its neighbours expect it: where one of two
                   neighbouring lines of circles is a cell off, the ways across say so
    alike          how far the logarithm of a circle's area may be from that of its neighbours
    covered        standard deviation of a centre, as a share of the longer semi-axis, by how far the logarithm of the area is from that of
                   the neighbours; so that points in space have the errors that they state (a rendered suit, session seed 11)
    validated_count, validated_wrong  identities measured on 216 images (generator seeds 9904 and 8801) that no rule was chosen on, and
                   how many of them were wrong
    """

    least_colour: float = 18.0
    noisy: float = 12.0
    noise_factor: float = 3.4
    noise_height: float = 1.3
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
    cloth_noise: float = 4.0
    misread: float = 0.01
    map_evidence: float = 16.0
    map_evidence_supported: float = 10.0
    patch: int = 15
    misses: int = 1
    gate: float = 0.3
    bump: tuple[float, float] = (0.12, 4.0)
    weights: tuple[float, ...] = (-2.01, 0.158, 0.047, -1.622, -1.017, 0.392, 0.856, 0.366, -4.715)
    odds: float = 5.75
    unlike: float = 5.0
    slant: float = 1.1
    slanted: float = 8.0
    end: EndRules = EndRules(squares=2, slant=0.5, bump=0.2)
    corner: EndRules = EndRules(squares=1, slant=0.3, bump=0.1, rival=0.8)
    astray: float = 0.75
    alike: float = 0.65
    covered: float = 0.08
    validated_count: int = 254_185
    validated_wrong: int = 1
