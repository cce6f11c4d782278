"""Segments of the legs and forces under the feet in; moments and powers of hips, knees and ankles, as Plug-in-Gait has them, out.

Sources: Newton and Euler, from the foot upwards; masses, centres and radii of Dempster by Winter (2009), table 4.1; smoothing of Woltring
(1986). What these leave open was settled by the forces, moments and powers that 13 recordings of one laboratory hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from asterism.findings import Finding, Severity
from asterism.geometry import rotate_z_up
from asterism.motion.clinical.measures import SIDES, SubjectMeasures
from asterism.motion.clinical.plug_in_gait import LowerBody, marker_of, walking_axes
from asterism.motion.rigid.rotations import cross
from asterism.motion.splines import second_derivative
from asterism.recording import Floats, ForcePlate, Recording
from asterism.recording.arrays import nan_median

GRAVITY = np.array([0.0, 0.0, -9.81])
"""m/s^2."""
FADED = 5.0
"""N: a load next to a step that is less is drift. At half, drift of an amplifier counts; at double, toe off's last hundredth is lost."""
_ORDERS = {
    "Ankle": ((1, 2, 0), {"L": (1, -1, 1), "R": (1, 1, -1)}),
    "Knee": ((1, 0, 2), {"L": (-1, 1, 1), "R": (-1, -1, -1)}),
    "Hip": ((1, 0, 2), {"L": (1, 1, 1), "R": (1, -1, -1)}),
}
"""Which axes of the segment below a joint its three moments are about, and their signs: extension (plantar flexion) first."""


@dataclass(frozen=True)
class SegmentInertia:
    """Inertia of a segment: mass, of the body's; centre, of the length from the upper joint; radius of gyration, of the length."""

    mass: float
    centre: float
    radius: float


@dataclass(frozen=True)
class KineticRules:
    """How moments are computed.

    thigh, shank, foot  their inertia. The radii are those about the upper joint, as the vendor's program takes them with the moments about
                        the centre of mass; `ABOUT_CENTRE` has those that Euler's equation asks for
    foot_length         of the distance from ankle to toe marker, along the foot's axis: the marker is behind the toes. At half, the ankle's
                        moment in swing is a fifth
    turning             s, over which turns are differentiated, to each side. At half, turns at heel strike are larger by noise; at double,
                        a power's peak of 0.1 s is lower by a tenth
    """

    thigh: SegmentInertia = SegmentInertia(0.1, 0.433, 0.540)
    shank: SegmentInertia = SegmentInertia(0.0465, 0.433, 0.528)
    foot: SegmentInertia = SegmentInertia(0.0145, 0.5, 0.690)
    foot_length: float = 4.0 / 3.0
    turning: float = 0.02


ABOUT_CENTRE = KineticRules(SegmentInertia(0.1, 0.433, 0.323), SegmentInertia(0.0465, 0.433, 0.302), SegmentInertia(0.0145, 0.5, 0.475))
"""Radii of gyration about the centre of mass, as Euler's equation asks for; the vendor's program takes others, see `KineticRules`."""


@dataclass(frozen=True)
class KineticErrors:
    """Standard uncertainties of what moments and powers are made of; moments are in proportion to each.

    hip, knee, ankle  m, of a joint's centre along each direction: of regressions of the hip 15 to 30 mm were found against images (Leardini
                      et al. 1999); of knee and ankle a marker's placement and half of a width
    pressure          m, of the centre of pressure along the floor
    plate, mass       of the force, and of the body's mass, relative
    inertia           of what a segment's mass and its spread make, relative: tables differ by so much
    turning           rad/s, between the segments beside a joint: skin that slides by 1 mm in 40 ms on both, 0.2 m apart
    acceleration      m/s2, of a segment's centre along each direction: skin that sways by 1 mm five times a second, or markers that a file
                      holds to 0.1 mm. It is most of what is open in swing. At half, a tenth of the curves are beside their intervals there
    """

    hip: float = 0.015
    knee: float = 0.008
    ankle: float = 0.006
    pressure: float = 0.005
    plate: float = 0.01
    mass: float = 0.01
    inertia: float = 0.1
    turning: float = 0.2
    acceleration: float = 1.0


@dataclass(frozen=True)
class PlateContact:
    """A plate, by its number, is loaded from `begins` to `ends` (s from the first frame).

    side  "L" or "R", the foot that is alone on it; None where it is not one foot
    """

    plate: int
    side: str | None
    begins: float
    ends: float


@dataclass(frozen=True)
class Kinetics:
    """Moments and powers of one recording, by Plug-in-Gait's names.

    moments   such as "LKneeMoment" -> (T, 3) N m/kg in the axes of the segment below: extension (of the ankle: plantar flexion) first
    powers    such as "LKneePower" -> (T,) W/kg, positive where the joint does work
    ground    such as "LGroundReactionForce" -> (T, 3) N/kg, on the foot: ahead and to the left of the way that the person walks, upwards
    sigmas    by all these names, in their units and shapes: standard uncertainties, see `KineticErrors`
    per_kg    False where nobody gave the mass: then these are N m, W and N, in stance, of the ground's forces alone
    findings  steps that were left out, and why

    NaN where it is not known what acts on the foot, or a marker is missing.
    """

    moments: Mapping[str, Floats]
    powers: Mapping[str, Floats]
    ground: Mapping[str, Floats]
    per_kg: bool = True
    findings: tuple[Finding, ...] = field(default=())
    sigmas: Mapping[str, Floats] = field(default_factory=dict)


def inverse_dynamics(
    recording: Recording,
    body: LowerBody,
    plates: Sequence[ForcePlate],
    contacts: Sequence[PlateContact],
    swings: Mapping[str, Sequence[tuple[float, float]]],
    measures: SubjectMeasures,
    rules: KineticRules | None = None,
    errors: KineticErrors | None = None,
) -> Kinetics:
    """Moments and powers of the legs of a body that `lower_body` found in the recording. O(T + samples).

    contacts  of plates (`asterism.gait.plate_contacts`). Only a foot that is alone on its plates, heel and toe within their corners, counts
    swings    by side "L" or "R", from and to s: there the foot is in the air, and inertia alone acts
    measures  whose mass divides the result
    errors    what makes the result uncertain, by first-order propagation

    Raises AsterismError where a plate has fewer samples than the recording.
    """
    rules, errors = rules or KineticRules(), errors or KineticErrors()
    at_frames = {plate.number: plate.at(recording.rate, len(recording)) for plate in plates}
    file, found = str(recording.metadata.get("file", "the recording")), []
    if measures.mass is None and contacts:
        found.append(
            Finding(
                "kinetics-mass",
                Severity.WARNING,
                file,
                f"{file} does not say how heavy the person is: moments are in N m, not per kg, and without the inertia of the segments.",
                "Give --measure BodyMass=KG.",
            )
        )
    moments, powers, ground, sigmas = {}, {}, {}, {}
    room, pelvis = walking_axes(body), _turning(body.pelvis, recording.rate, rules)
    for side, leg in body.legs.items():
        if leg.foot is None:
            continue
        (force, moment), left_out = _under(recording, side, at_frames, contacts, swings.get(side, ()) if measures.mass else ())
        found += [_bad_step(file, side, contact, why) for contact, why in left_out]
        mass = measures.mass or 0.0
        per = measures.mass or 1.0
        for joint, one in _joints(recording, body, side, rules, mass, force, moment, pelvis).items():
            order, signs = _ORDERS[joint]
            local = np.einsum("tji,tj->ti", one.below, one.about) / per
            moments[f"{side}{joint}Moment"] = local[:, order] * np.array(signs[side])
            powers[f"{side}{joint}Power"] = np.einsum("ti,ti->t", one.about, one.turning) / per
            ways = np.concatenate([one.below, one.turning[:, :, None]], axis=2)
            spread = _variances(one, force, getattr(errors, joint.lower()), errors, ways)
            sigmas[f"{side}{joint}Moment"] = np.sqrt(spread[:, :3])[:, order] / per
            turned = spread[:, 3] + (one.about**2).sum(axis=1) * errors.turning**2
            sigmas[f"{side}{joint}Power"] = np.sqrt(turned) / per
        ground[f"{side}GroundReactionForce"] = force @ room / per
        # A plate's error is of the whole force, along each direction, as its channels cross; the mass' is in proportion.
        whole = errors.plate * np.linalg.norm(force, axis=1)[:, None]
        sigmas[f"{side}GroundReactionForce"] = np.hypot(whole, errors.mass * np.abs(force @ room)) / per
    for contact in contacts:
        if contact.side is None:
            found.append(_bad_step(file, None, contact, "it is not one foot alone that loads it"))
    return Kinetics(moments, powers, ground, measures.mass is not None, tuple(found), sigmas)


def _bad_step(file: str, side: str | None, contact: PlateContact, why: str) -> Finding:
    who = "a step" if side is None else f"the step of the {SIDES[side]} foot"
    return Finding(
        "kinetics-step",
        Severity.NOTE,
        f"plate {contact.plate}",
        f"{file}: {who} on plate {contact.plate} from {contact.begins:.2f} to {contact.ends:.2f} s is left out: {why}.",
        "Use the other steps, or record one that hits one plate with the whole foot.",
    )


def _under(
    recording: Recording,
    side: str,
    plates: Mapping[int, ForcePlate],
    contacts: Sequence[PlateContact],
    swings: Sequence[tuple[float, float]],
) -> tuple[tuple[Floats, Floats], list[tuple[PlateContact, str]]]:
    """Force (T, 3) N on a foot and its moment (T, 3) N m about the world's origin, z up; NaN where they are not known."""
    frames = np.arange(len(recording)) / recording.rate
    known = np.zeros(len(frames), dtype=bool)
    for begins, ends in swings:
        known |= (frames > begins) & (frames < ends)
    force, moment = np.zeros((len(frames), 3)), np.zeros((len(frames), 3))
    left_out = []
    for contact in contacts:
        if contact.side != side:
            continue
        inside = (frames >= contact.begins) & (frames <= contact.ends)
        together = [one.plate for one in contacts if one.side == side and one.begins < contact.ends and contact.begins < one.ends]
        if not _whole_foot(recording, side, inside, [plates[number] for number in together]):
            left_out.append((contact, "heel or toe is beside the plate"))
            known &= ~inside
            continue
        plate = plates[contact.plate]
        inside |= _fading(plate, inside)
        centre, on_foot, about = (rotate_z_up(part, recording.vertical) for part in (plate.centre, plate.force, plate.moment))
        force[inside] += on_foot[inside]
        moment[inside] += (cross(centre, on_foot) + about)[inside]
        known |= inside
    force[~known] = moment[~known] = np.nan
    return (force, moment), left_out


def _fading(plate: ForcePlate, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The frames next to those inside a contact in which the foot still pushes, or does already, less than a plate counts as loaded."""
    out = inside.copy()
    rows = np.flatnonzero(inside)
    pushing = plate.load > FADED
    for step, row in ((-1, rows[0]), (1, rows[-1])) if len(rows) else ():
        while 0 <= row + step < len(out) and pushing[row + step]:
            row += step
            out[row] = True
    return out


def _whole_foot(recording: Recording, side: str, inside: NDArray[np.bool_], plates: Sequence[ForcePlate]) -> bool:
    """Whether heel and toe marker are within the corners of plates in the middle third of a contact, when the foot is flat."""
    rows = np.flatnonzero(inside)
    rows = rows[len(rows) // 3 : max(2 * len(rows) // 3, len(rows) // 3 + 1)]
    for name in ("HEE", "TOE"):
        if side + name not in recording.labels:
            continue
        points = recording.positions[rows, recording.labels.index(side + name)]
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            continue
        point, on_one = np.median(points, axis=0), False
        for plate in plates:
            arm = point - plate.corners.mean(axis=0)
            edges = (plate.corners[0] - plate.corners[1], plate.corners[0] - plate.corners[3])
            on_one |= all(abs(arm @ edge) <= 0.5 * (edge @ edge) for edge in edges)
        if not on_one:
            return False
    return True


@dataclass(frozen=True)
class _JointLoad:
    """What acts at a joint on the segment below it, z up.

    about        (T, 3) N m, the moment; of the ground alone `by_ground`; pull (T, 3) N, the force
    below        (T, 3, 3) the axes of the segment; turning (T, 3) rad/s, against that above
    carried      of each segment below, its mass, kg, and its centre (T, 3) m, from the joint
    """

    about: Floats
    by_ground: Floats
    pull: Floats
    below: Floats
    turning: Floats
    carried: Sequence[tuple[float, Floats]]


def _variances(joint: _JointLoad, force: Floats, centre: float, errors: KineticErrors, ways: Floats) -> Floats:
    """(T, N) variance of a joint's moment, N m, along vectors `ways` (T, 3, N), times the squares of their lengths.

    centre: m, to which the joint's centre is known along each direction; force (T, 3) N of the ground.
    """

    def along(vectors: Floats) -> Floats:
        """The squares of what vectors (T, 3) have along the ways."""
        return np.asarray((vectors[:, None] @ ways)[:, 0] ** 2)

    def across(vectors: Floats) -> Floats:
        """The squares of what unit vectors of all directions, times vectors (T, 3) by the cross product, have along the ways."""
        return np.maximum((vectors**2).sum(axis=1)[:, None] * (ways**2).sum(axis=1) - along(vectors), 0.0)

    # Moved by d, a force f gives d x f more: alike in all directions across it.
    found = centre**2 * across(joint.pull)
    found += errors.acceleration**2 * sum(mass**2 * across(arm) for mass, arm in joint.carried)
    for axis in (0, 1):
        found += errors.pressure**2 * along(cross(np.eye(3)[axis], force))
    found += (errors.plate**2 + errors.mass**2) * along(joint.by_ground)
    return np.asarray(found + errors.inertia**2 * along(joint.about - joint.by_ground))


def _joints(
    recording: Recording, body: LowerBody, side: str, rules: KineticRules, mass: float, force: Floats, moment: Floats, pelvis: Floats
) -> dict[str, _JointLoad]:
    """By joint, what acts on the segment below it; pelvis: its turning (T, 3) rad/s."""
    leg, rate = body.legs[side], recording.rate
    assert leg.foot is not None
    toe = marker_of(recording)(f"{side}TOE")
    length = rules.foot_length * float(nan_median(np.linalg.norm(toe - leg.ankle, axis=1), axis=0))
    tip = leg.ankle - length * leg.foot[:, :, 2]
    chain = (
        ("Ankle", rules.foot, leg.ankle, tip, leg.foot),
        ("Knee", rules.shank, leg.knee, leg.ankle, leg.shank),
        ("Hip", rules.thigh, leg.hip, leg.knee, leg.thigh),
    )
    turnings = [*(_turning(axes, rate, rules) for axes in (leg.foot, leg.shank, leg.thigh)), pelvis]
    out = {}
    # What acts on the lower end of a segment: force, and moment about that end. The ground's moment is moved to the foot's tip.
    pushed, turned = force, moment - cross(tip, force)
    by_ground, centres = -turned, list[tuple[float, Floats]]()
    for (joint, segment, upper, lower, axes), (turning, above) in zip(chain, pairwise(turnings), strict=True):
        arm = lower - upper
        weight = segment.mass * mass
        pull = weight * (second_derivative(upper + segment.centre * arm, rate) - GRAVITY) - pushed
        inertia = weight * (segment.radius * float(nan_median(np.linalg.norm(arm, axis=1), axis=0))) ** 2
        levers = cross(segment.centre * arm, pull) - cross((1 - segment.centre) * arm, pushed)
        about = _spin(axes, turning, inertia, rate, rules) + levers - turned
        by_ground = by_ground - cross(arm, force)
        centres.append((weight, upper + segment.centre * arm))
        out[joint] = _JointLoad(about, by_ground, pull, axes, turning - above, [(one, centre - upper) for one, centre in centres])
        pushed, turned = -pull, -about
    return out


def _turning(axes: Floats, rate: float, rules: KineticRules) -> Floats:
    """(T, 3) rad/s, in the world, of axes (T, 3, 3); NaN at the ends and where axes are missing."""
    reach = max(1, round(rules.turning * rate))
    out = np.full((len(axes), 3), np.nan)
    step = axes[2 * reach :] @ axes[: -2 * reach].transpose(0, 2, 1)
    # The rotation vector of less than half a turn, NaN where axes are: no segment turns further in so short a time.
    twice = np.stack([step[:, 2, 1] - step[:, 1, 2], step[:, 0, 2] - step[:, 2, 0], step[:, 1, 0] - step[:, 0, 1]], axis=1)
    sine = np.linalg.norm(twice, axis=1)
    angle = np.arctan2(sine, np.trace(step, axis1=1, axis2=2) - 1.0)
    length = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 0.5)
    out[reach:-reach] = twice * length[:, None] * rate / (2 * reach)
    return out


def _spin(axes: Floats, turning: Floats, inertia: float, rate: float, rules: KineticRules) -> Floats:
    """(T, 3) N m that change the turning (T, 3) rad/s of a rod of this inertia (kg m^2) along its z axis."""
    reach = max(1, round(rules.turning * rate))
    along = np.einsum("ti,ti->t", turning, axes[:, :, 2])[:, None] * axes[:, :, 2]
    momentum = inertia * (turning - along)
    out = np.full(momentum.shape, np.nan)
    out[reach:-reach] = (momentum[2 * reach :] - momentum[: -2 * reach]) * rate / (2 * reach)
    return out
