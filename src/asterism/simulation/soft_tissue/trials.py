"""A plan in; points on skin over moving bones, and the truth about the bones, out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError
from asterism.recording import Floats, Ints, Recording
from asterism.simulation.soft_tissue.anatomy import ANATOMIES, REFERENCE_HEIGHT, Anatomy, Skin, dense_skin, sparse_skin

JOINTS = ("shoulder", "knee", "hip")
"""What GaMoCap measured (section 4.3). `simulate_soft_tissue` also knows "leg" (three limbs) and "rigid" (one)."""
MOTIONS = 3


@dataclass(frozen=True)
class SoftTissueRules:
    """How skin moves over bone. Each subject has amplitudes of its own, drawn between the two values.

    slide_m      peak sliding along the limb at the joint, in step with the joint angle: up to 20 mm, GaMoCap section 3.1 and the thigh of
                 Uchida and Seth (2022)
    reach_m      how much farther from the joint than the nearest skin sliding has fallen to 1/e
    bulge_m      peak of the bulges that muscles make anywhere on a limb, in step with the angle but not proportional to it
    bulges       how many on each limb; bulge_reach_m: their radius
    wobble_m     peak of the swinging that angular acceleration excites, near the joint
    most_m       no point is displaced farther
    """

    slide_m: tuple[float, float] = (0.012, 0.020)
    reach_m: tuple[float, float] = (0.07, 0.11)
    bulge_m: tuple[float, float] = (0.002, 0.005)
    bulges: int = 3
    bulge_reach_m: float = 0.07
    wobble_m: tuple[float, float] = (0.001, 0.004)
    most_m: float = 0.020


@dataclass(frozen=True)
class TrialPlan:
    """What is recorded of whom.

    joint    "shoulder", "knee", "hip", "leg" or "rigid"
    subject  number of the person: stature, skin and noise; motion: 0 repeated flexion, 1 with rotation about the other axes, 2 fast pulses
    points   on all limbs together, or, where `sparse`, on each limb
    noise_m  of the measurement, standard deviation per coordinate; missing: share of the samples that gaps take
    """

    joint: str = "knee"
    subject: int = 0
    motion: int = 0
    points: int = 3000
    sparse: bool = False
    frames: int = 100
    rate: float = 10.0
    noise_m: float = 0.001
    missing: float = 0.0
    rules: SoftTissueRules = field(default_factory=SoftTissueRules)


@dataclass(frozen=True)
class SoftTissueTrial:
    """A simulated recording and its truth.

    recording     (T, N) points P1, P2, ...
    limb_of       (N,) int, the bone that each point's skin lies over
    rotations     (L, T, 3, 3), translations (L, T, 3) m: where each bone has gone from the standing pose, x(t) = R x + t
    joints        (parent, child) of each joint; centres (J, T, 3) m of its centre; angles (J, T) rad of its rotation since frame 0
    displacement  (T, N, 3) m of the skin from where its bone would have carried it, in the bone's axes
    """

    recording: Recording
    limb_of: Ints
    rotations: Floats
    translations: Floats
    joints: tuple[tuple[int, int], ...]
    centres: Floats
    angles: Floats
    displacement: Floats


def simulate_soft_tissue(plan: TrialPlan, seed: int = 0) -> SoftTissueTrial:
    """Points on a person's skin during an exercise of one joint, with soft tissue artefacts that are not white noise.

    Skin slides in step with the joint angle, most at the joint; muscles bulge; skin wobbles after fast movements; all of it smooth over
    the surface, and none of it measurement noise. The same plan and seed give the same trial. Raises AsterismError for an unknown joint
    and for numbers that make no trial. O(T N) time and memory.

    >>> trial = simulate_soft_tissue(TrialPlan("knee", points=60, frames=40), seed=1)
    >>> trial.recording.positions.shape, bool(np.linalg.norm(trial.displacement, axis=2).max() <= 0.02 + 1e-9)
    ((40, 60, 3), True)
    """
    if plan.joint not in ANATOMIES:
        raise AsterismError(f"no joint is called {plan.joint}; choose from {', '.join(ANATOMIES)}.")
    if plan.frames < 2 or plan.points < 1 or not plan.rate > 0 or not 0 <= plan.missing < 1 or plan.noise_m < 0:
        raise AsterismError(f"{plan.points} points in {plan.frames} frames make no trial; at least 1 point and 2 frames are needed.")
    anatomy = ANATOMIES[plan.joint]
    number = list(ANATOMIES).index(plan.joint)
    # The person is the same in each motion; only the movement is drawn anew.
    person = np.random.default_rng([seed, number, plan.subject, int(plan.sparse)])
    rng = np.random.default_rng([seed, number, plan.subject, int(plan.sparse), 1 + plan.motion % MOTIONS])
    scale = float(person.uniform(1.55, 1.95)) / REFERENCE_HEIGHT
    skin = (sparse_skin if plan.sparse else dense_skin)(anatomy, plan.points, scale, person)
    relative = [_joint_rotations(plan, joint, rng) for joint in range(len(anatomy.joints))]
    rotations, translations = _bones(plan, anatomy, relative, scale, rng)
    displacement = np.zeros((plan.frames, len(skin.places), 3))
    centres = np.empty((len(anatomy.joints), plan.frames, 3))
    for j, joint in enumerate(anatomy.joints):
        centre = scale * np.asarray(joint.centre)
        angle = relative[j].magnitude()
        for limb in (joint.parent, joint.child):
            rows = np.nonzero(skin.limb_of == limb)[0]
            displacement[:, rows] += _skin_motion(plan, skin, rows, centre, angle, (person, rng))
        centres[j] = rotations[joint.parent] @ centre + translations[joint.parent]
    # The sum of three effects may be more than skin does.
    size = np.linalg.norm(displacement, axis=2, keepdims=True)
    displacement *= np.minimum(1.0, plan.rules.most_m / np.maximum(size, 1e-12))
    # Displaced on the bone, then carried by it: so soft tissue moves.
    positions = np.einsum("tnij,tnj->tni", rotations[skin.limb_of].swapaxes(0, 1), skin.places + displacement)
    positions += translations[skin.limb_of].swapaxes(0, 1)
    positions += plan.noise_m * rng.standard_normal(positions.shape)
    positions[_gaps(plan, len(skin.places), rng)] = np.nan
    angles = np.array([(one[0].inv() * one).magnitude() for one in relative]).reshape(len(relative), plan.frames)
    recording = Recording(
        positions,
        tuple(f"P{i + 1}" for i in range(len(skin.places))),
        plan.rate,
        metadata={"file": f"simulated {plan.joint}, subject {plan.subject}, motion {plan.motion}", "format": "simulated", "units": "m"},
    )
    pairs = tuple((joint.parent, joint.child) for joint in anatomy.joints)
    return SoftTissueTrial(recording, skin.limb_of, rotations, translations, pairs, centres, angles, displacement)


def _joint_rotations(plan: TrialPlan, joint: int, rng: np.random.Generator) -> Rotation:
    """The child's rotation in the parent's axes over time: flexion about y, and as the motion has it about x and z."""
    limits = ANATOMIES[plan.joint].joints[joint]
    time = np.arange(plan.frames) / plan.rate
    whole = plan.frames / plan.rate
    cycles = (2.0, 3.0, 4.0)[plan.motion % MOTIONS] * rng.uniform(0.9, 1.1)
    phase = 2 * np.pi * cycles * (time / whole) - 0.2 * rng.random() - 0.6 * joint
    swing = 0.5 - 0.5 * np.cos(phase)
    # Fast pulses: long rests between short movements.
    if plan.motion % MOTIONS == 2:
        swing = swing**3
    share = (0.25, 1.0, 0.4)[plan.motion % MOTIONS]
    peak = np.radians(limits.flexion_deg) * rng.uniform(0.8, 1.0)
    aside = np.radians(limits.other_deg[0]) * share * np.sin(phase * rng.uniform(0.8, 1.2) + rng.uniform(0, 6))
    about = np.radians(limits.other_deg[1]) * share * np.sin(phase * rng.uniform(0.8, 1.2) + rng.uniform(0, 6))
    return Rotation.from_euler("YXZ", np.stack([peak * swing, aside, about], axis=1))


def _bones(plan: TrialPlan, anatomy: Anatomy, relative: list[Rotation], scale: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """World from standing pose for each limb. The first limb sways, turns a little and drifts, as a person does who stands."""
    white = rng.standard_normal((plan.frames, 6))
    # Nobody stands still: the first limb sways slowly.
    smooth = gaussian_filter1d(white, max(0.8 * plan.rate, 1.0), axis=0, mode="reflect")
    smooth *= np.array([0.05, 0.05, 0.08, 0.02, 0.02, 0.01]) / np.maximum(smooth.std(axis=0), 1e-9)
    rotations = np.empty((len(anatomy.limbs), plan.frames, 3, 3))
    translations = np.empty((len(anatomy.limbs), plan.frames, 3))
    rotations[0] = Rotation.from_rotvec(smooth[:, :3]).as_matrix()
    translations[0] = smooth[:, 3:] + np.array([0.0, 0.0, 0.9 * scale])
    for joint, turned in zip(anatomy.joints, relative, strict=True):
        centre = scale * np.asarray(joint.centre)
        rotations[joint.child] = rotations[joint.parent] @ turned.as_matrix()
        at = rotations[joint.parent] @ centre + translations[joint.parent]
        translations[joint.child] = at - rotations[joint.child] @ centre
    return rotations, translations


def _skin_motion(
    plan: TrialPlan, skin: Skin, rows: Ints, centre: Floats, angle: Floats, draws: tuple[np.random.Generator, np.random.Generator]
) -> Floats:
    """(T, rows, 3) m: how the skin of one limb at one joint is displaced from its bone, in the bone's axes.

    draws  of the person (amplitudes, places of muscles) and of the trial (wobbling)
    """
    person, rng = draws
    rules, places = plan.rules, skin.places[rows]
    slide, reach, bulge, wobble = (
        float(person.uniform(*limits)) for limits in (rules.slide_m, rules.reach_m, rules.bulge_m, rules.wobble_m)
    )
    power, lean = person.uniform(0.8, 1.5), person.uniform(0, 2 * np.pi)
    bent = angle / max(float(np.max(angle)), 1e-9)
    distance = np.linalg.norm(places - centre, axis=1)
    near = np.exp(-(((distance - distance.min()) / reach) ** 2))
    axis = np.sign(places[:, 2].mean() - centre[2]) * np.array([0.0, 0.0, 1.0])
    # Sliding falls with the distance from the joint, and is stronger on one side.
    pattern = near * (0.65 + 0.35 * np.cos(skin.around[rows] - lean))
    out = -slide * bent[:, None, None] ** power * pattern[None, :, None] * axis
    # Muscles bulge with the angle, but each on its own course.
    for _ in range(rules.bulges):
        middle = places[person.integers(len(places))]
        bump = np.exp(-(((places - middle) ** 2).sum(axis=1)) / rules.bulge_reach_m**2)
        course = np.sin(0.5 * np.pi * bent) ** person.uniform(1.0, 2.0) * person.choice([-1.0, 1.0])
        out += bulge * course[:, None, None] * bump[None, :, None] * skin.outward[rows]
    # Skin swings after acceleration, so it is out of step with the angle.
    fast = np.gradient(np.gradient(angle)) * plan.rate**2
    shaken = gaussian_filter1d(fast * rng.standard_normal(len(fast)), 0.8)
    shaken /= max(float(np.abs(shaken).max()), 1e-9)
    way = person.standard_normal(3)
    swinging = near * np.cos(skin.around[rows] - person.uniform(0, 2 * np.pi))
    out += wobble * shaken[:, None, None] * swinging[None, :, None] * (way / np.linalg.norm(way))
    return np.asarray(out)


def _gaps(plan: TrialPlan, points: int, rng: np.random.Generator) -> np.ndarray:
    """(T, points) bool: one gap for each point, its length drawn around the share that is missing."""
    hidden = np.zeros((plan.frames, points), dtype=bool)
    if plan.missing > 0:
        length = np.minimum(rng.exponential(plan.missing * plan.frames, points).astype(int), plan.frames - 2)
        begin = (rng.random(points) * (plan.frames - length)).astype(int)
        time = np.arange(plan.frames)[:, None]
        hidden = (time >= begin) & (time < begin + length)
    return hidden
