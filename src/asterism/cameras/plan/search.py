"""The search for a rig: greedy, then exchange over a grid of mounts and aims, then a continuous polish. No chance in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from asterism.cameras.accuracy import Volume, information, sees
from asterism.cameras.accuracy.maps import FACINGS, NOISE, STEEPEST
from asterism.cameras.plan import _kernels
from asterism.cameras.plan.mounts import Mounts, camera_at
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Floats, Ints


@dataclass(frozen=True)
class PlanRules:
    """How far a plan is searched, and what its cameras may not do.

    places, fine_places  points of the volume at which the search over the grid, and the polish, ask what cameras see
    candidates           poses at most on the grid; mounts farther apart are taken where there would be more
    spacing              m between mounts of the grid at most, and `wider` times that where there are too many candidates
    aims_aside, aims_up  shares of the volume's width and depth, and of its height, at which poses of the grid aim
    sweeps               rounds at most in which each camera is exchanged for the best candidate
    glare                what it costs when every camera has every other one's lamps in its image
    strides              m, by which the polish moves a camera or its target
    apart                m between two cameras at least, in the polish
    nearest_target       m between a camera and its target at least
    lack                 what it costs, per share of the volume, to see less than the ring does
    least_gain           of the objective (0 to 1): smaller gains end a sweep or a step

    Chosen on the volumes and cameras of tests/test_plan.py and of the row `cameras --rows plan`.
    """

    places: int = 400
    fine_places: int = 2000
    candidates: int = 2000
    spacing: float = 0.5
    wider: float = 1.2
    aims_aside: tuple[float, ...] = (0.25, 0.5, 0.75)
    aims_up: tuple[float, ...] = (0.3, 0.6)
    sweeps: int = 4
    glare: float = 0.02
    strides: tuple[float, ...] = (0.6, 0.3, 0.15, 0.07, 0.03)
    apart: float = 0.3
    nearest_target: float = 0.5
    lack: float = 10.0
    least_gain: float = 1e-6


RULES = PlanRules()
_MOVES = [(which, sign) for which in (0, 1, 3, 4, 5) for sign in (1.0, -1.0)]
_PAIRS = np.array([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)])


@dataclass(frozen=True)
class RigPlan:
    """A proposal, and the ring that the thesis' guidelines (3.2.2) would give, with the same cameras on the same mounts.

    rig, ring              z is up
    worth, ring_worth      the objective, 0 to 1. Half of it: the share of the places that three cameras see (two count 0.4, one 0.1). A
                           quarter: the share of markers on a body that two cameras see (one counts half) from the side that they
                           face, over eight horizontal facings. A quarter: the precision of those markers: nothing for an RMS error of
                           10 mm or unseen, all for 0.1 mm, even steps per factor. Less 0.02 times the share of pairs of cameras of
                           which one has the other one's lamps in its image
    glare, ring_glare      how many times one camera has another one in its image
    """

    rig: Rig
    ring: Rig
    worth: float
    ring_worth: float
    glare: int
    ring_glare: int


def plan_rig(
    volume: Volume,
    cameras: int,
    size: tuple[int, int],
    focal: float,
    *,
    mounts: Mounts | None = None,
    noise: float = NOISE,
    progress: Progress | None = None,
) -> RigPlan:
    """Where to hang cameras of one kind for a volume: coverage by three of them, and the precision that they give (thesis 3.2, 3.3).

    volume  z is up
    size    px, width and height of each image; focal: px (`focal_length`)
    mounts  where cameras may hang; by default `Mounts.around(volume)`
    noise   px, standard deviation of a blob's x and y

    Greedy over a grid of mounts and aims, then cameras are exchanged one by one while that helps, then each is moved and turned
    continuously; the plain ring is polished too, and the better one is proposed. So it is never worth less than the ring, and neither
    what three cameras see of the volume nor what two see of markers on a body is less. The same arguments give the same rig.
    O(candidates x places x cameras). Raises AsterismError for fewer than two cameras.
    """
    if cameras < 2:
        raise AsterismError("one camera composes nothing: plan at least two.")
    if min(size) < 1 or not focal > 0 or not noise > 0:
        raise AsterismError("image size, focal length and noise must be positive.")
    given = Mounts.around(volume) if mounts is None else mounts
    coarse, hall = (_Hall(volume, given, size, focal, noise, places) for places in (RULES.places, RULES.fine_places))

    def say(fraction: float, doing: str) -> None:
        if progress is not None:
            progress(fraction, doing)

    ring = hall.ring(cameras)
    chosen = coarse.searched(cameras, lambda share: say(0.6 * share, "choosing mounts"))
    least = hall.shares(ring)
    polished: list[Floats] = []
    for start in (chosen, ring):
        done = 0.6 + 0.2 * len(polished)
        polished.append(hall.polished(start, least, lambda share, done=done: say(done + 0.2 * share, "polishing")))  # type: ignore[misc]
    best = max(polished, key=lambda poses: hall.worth(poses, least))
    best = best[np.argsort([_azimuth(given.position(pose[:3]), hall.centre) for pose in best], kind="stable")]
    glare = hall.glare(best), hall.glare(ring)
    return RigPlan(hall.rig(best), hall.rig(ring), hall.worth(best), hall.worth(ring), *glare)


def _azimuth(position: Floats, centre: Floats) -> float:
    return float(np.arctan2(position[1] - centre[1], position[0] - centre[0]) % (2 * np.pi))


class _Hall:
    """What a search asks again and again. A pose is (6,): a place on the mounts, and the target (3,) m."""

    def __init__(self, volume: Volume, mounts: Mounts, size: tuple[int, int], focal: float, noise: float, places: int) -> None:
        self.volume, self.mounts, self.size, self.focal, self.noise = volume, mounts, size, focal, noise
        self.centre = 0.5 * (volume.low + volume.high)
        # up to the faces of the box, where coverage ends first
        #
        counts = np.maximum(2, np.rint(volume.size / np.cbrt(volume.size.prod() / places)).astype(np.int64))
        axes = [np.linspace(*ends) for ends in zip(volume.low, volume.high, counts, strict=True)]
        self.places = np.stack([part.ravel() for part in np.meshgrid(*axes, indexing="ij")], axis=1)
        angle = 2 * np.pi * np.arange(FACINGS) / FACINGS
        self.facings = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)

    def rig(self, poses: Floats) -> Rig:
        cameras = [camera_at(f"c{i + 1}", self.mounts.position(pose[:3]), pose[3:], self.size, self.focal) for i, pose in enumerate(poses)]
        return Rig(tuple(cameras), vertical=np.array([0.0, 0.0, 1.0]))

    def ring(self, cameras: int) -> Floats:
        """Evenly around the centre, as high as may be, looking inwards."""
        angles = 2 * np.pi * (np.arange(cameras) + 0.5) / cameras
        return np.array([np.concatenate([self.mounts.toward(angle, self.centre), self.centre]) for angle in angles])

    def views(self, rig: Rig) -> tuple[NDArray[np.bool_], Floats, NDArray[np.bool_]]:
        """What each of K cameras sees (K, P), tells (K, P, 6) 1/m2 and is faced by (K, P, D)."""
        seen = sees(rig, self.places)
        information_of = np.ascontiguousarray(information(rig, self.places)[..., _PAIRS[:, 0], _PAIRS[:, 1]]) / self.noise**2
        # A camera that does not see a place tells nothing of it.
        information_of[~seen] = 0.0
        return seen, information_of, self._faces(np.stack([camera.position for camera in rig]))

    def _faces(self, eyes: Floats) -> NDArray[np.bool_]:
        toward = eyes[:, None] - self.places[None]
        # A camera in the middle of a place is no mount; the floor only keeps the division whole.
        toward /= np.maximum(np.linalg.norm(toward, axis=2, keepdims=True), 1e-9)
        faced: NDArray[np.bool_] = toward @ self.facings.T > STEEPEST
        return faced

    def worth(self, poses: Floats, least: tuple[float, float] = (0.0, 0.0)) -> float:
        """The objective of a whole rig; far below it where `shares` are less than `least`."""
        return self._beside(poses[:-1], least)(poses[-1])

    def _beside(self, others: Floats, least: tuple[float, float]) -> Callable[[Floats], float]:
        """What `worth` is of these cameras and one more, as a function of that one's pose (6,)."""
        rig = self.rig(others)
        eyes = np.stack([camera.position for camera in rig])
        base = self._base(*self.views(rig))
        glare, pairs = int(sees(rig, eyes).sum()), len(others) * (len(others) + 1)
        only = np.zeros(1, dtype=np.int64)

        def worth(pose: Floats) -> float:
            one = self.rig(pose[None])
            seen, information_of, faces = self.views(one)
            # Lamps sit on the cameras, so a camera that has another in its image is blinded by it, and the other way round.
            glaring = glare + int(sees(one, eyes).sum()) + int(sees(rig, one[0].position).sum())
            covered, sided = base[0] + seen[0] >= 3, base[1] + (seen[0, :, None] & faces[0]) >= 2
            # What the ring gives must not be lost: a share below it costs more than any gain in exactness.
            missing = max(0.0, least[0] - float(covered.mean())) + max(0.0, least[1] - float(sided.mean()))
            alone = float(self._worth_with(base, seen, information_of, faces, only)[0])
            return alone - RULES.glare * glaring / pairs - RULES.lack * missing

        return worth

    def shares(self, poses: Floats) -> tuple[float, float]:
        """The share of the volume that three cameras see, and that of the markers on a body that two do."""
        count, sided, _ = self._base(*self.views(self.rig(poses)))
        return float((count >= 3).mean()), float((sided >= 2).mean())

    def glare(self, poses: Floats) -> int:
        rig = self.rig(poses)
        return int(sees(rig, np.stack([camera.position for camera in rig])).sum())

    def _base(self, seen: NDArray[np.bool_], information_of: Floats, faces: NDArray[np.bool_]) -> tuple[Ints, Ints, Floats]:
        sided = seen[:, :, None] & faces
        of_facings = np.einsum("kpd,kpi->pdi", sided, information_of)
        return seen.sum(axis=0), sided.sum(axis=0), np.ascontiguousarray(of_facings)

    def _worth_with(
        self,
        base: tuple[Ints, Ints, Floats],
        seen: NDArray[np.bool_],
        information_of: Floats,
        faces: NDArray[np.bool_],
        mount: Ints,
    ) -> Floats:
        out = np.empty(len(seen))
        _kernels.worth_with(*base, seen, information_of, faces, mount, out)
        return out

    def searched(self, cameras: int, progress: Callable[[float], None]) -> Floats:
        """Greedy and exchange over a grid."""
        aims = self._aims()
        spacing = min(RULES.spacing, self.mounts.around_m / (2 * cameras))
        # A large hall has more mounts than can be compared; a wider grid is refined by polishing later.
        while len(self.mounts.candidates(spacing)) * len(aims) > RULES.candidates:
            spacing *= RULES.wider
        places = self.mounts.candidates(spacing)
        eyes = np.array([self.mounts.position(place) for place in places])
        # Every mount with every aim, so that a greedy choice can take any of them.
        mount = np.repeat(np.arange(len(places)), len(aims))
        poses = np.concatenate([places[mount], np.tile(aims, (len(places), 1))], axis=1)
        seen, information_of, _ = (
            np.concatenate(part) for part in zip(*(self.views(self.rig(block)) for block in np.array_split(poses, 10)), strict=True)
        )
        faces = self._faces(eyes)
        lamps = np.concatenate([sees(self.rig(block), eyes) for block in np.array_split(poses, 10)])
        chosen: list[int] = []

        def best_beside(beside: list[int]) -> tuple[int, float]:
            others = np.array(beside, dtype=np.int64)
            base = self._base(seen[others], information_of[others], faces[mount[others]])
            worth = self._worth_with(base, seen, information_of, faces, mount)
            glaring = lamps[:, mount[others]].sum(axis=1) + lamps[others][:, mount].sum(axis=0)
            worth -= RULES.glare * (glaring + lamps[np.ix_(others, mount[others])].sum()) / (cameras * (cameras - 1))
            # Two cameras do not fit on one mount.
            worth[np.isin(mount, mount[others])] = -np.inf
            return int(np.argmax(worth)), float(worth.max())

        for n in range(cameras):
            chosen.append(best_beside(chosen)[0])
            progress((n + 1) / (cameras * (1 + RULES.sweeps)))
        reached = -np.inf
        # Greedy cameras were chosen before the later ones were known: exchange each while that helps.
        for sweep in range(RULES.sweeps):
            before = reached
            for i in range(cameras):
                chosen[i], reached = best_beside(chosen[:i] + chosen[i + 1 :])
                progress((cameras * (1 + sweep) + i + 1) / (cameras * (1 + RULES.sweeps)))
            if reached <= before + RULES.least_gain:
                break
        return poses[chosen]

    def _aims(self) -> Floats:
        shares = np.array([(x, y, z) for x in RULES.aims_aside for y in RULES.aims_aside for z in RULES.aims_up])
        aims: Floats = self.volume.low + shares * self.volume.size
        return aims

    def polished(self, poses: Floats, least: tuple[float, float], progress: Callable[[float], None]) -> Floats:
        """Each camera moved along its mounts and turned, in ever smaller steps, while that helps."""
        poses = poses.copy()
        for s, stride in enumerate(RULES.strides):
            for i in range(len(poses)):
                others = np.delete(poses, i, axis=0)
                eyes = np.array([self.mounts.position(pose[:3]) for pose in others])
                worth = self._beside(others, least)
                reached = worth(poses[i])
                for which, sign in _MOVES:
                    while True:
                        trial = poses[i].copy()
                        # One coordinate at a time: the objective has corners where a place goes out of sight, and no gradient there.
                        trial[which] += sign * stride
                        here = self.mounts.position(trial[:3])
                        apart = np.linalg.norm(eyes - here, axis=1).min()
                        #
                        if apart < RULES.apart or np.linalg.norm(here - trial[3:]) < RULES.nearest_target:
                            break
                        found = worth(trial)
                        if found <= reached + RULES.least_gain:
                            break
                        poses[i], reached = trial, found
                progress((s * len(poses) + i + 1) / (len(RULES.strides) * len(poses)))
        return poses
