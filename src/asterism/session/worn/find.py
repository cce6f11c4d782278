"""The files of a run in; for each of them the marker set that is worn, how sure that is, and what else it may be, out.

Names decide where a file has them. Else each shipped set is held against some frames in a body that explains all points, whatever set they
belong to (`fit`); the files of one folder are mostly of one person.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import expit, log_softmax

from asterism.errors import AsterismError, NoMarkers
from asterism.geometry import rotate_z_up
from asterism.recording import Clouds, Floats, Ints, MarkerSet, Recording, labelled_live, shipped_sets, worn_marker_sets
from asterism.recording.display import significant
from asterism.recording.marker_set import is_unnamed
from asterism.session.people import people_in
from asterism.session.upright import other_verticals
from asterism.session.worn.fit import FitRules, FrameFit, fit_frame
from asterism.session.worn.shapes import BodyShapes, body_shapes
from asterism.tracking import find_tracklets

FRAMES_TO_FIND = 3000
"""Frames of a file among which the marker set is looked for: half a minute at 100 Hz. Of a longer file, a person has come into view by then
or the frames with most points are as good."""

GIVEN, BY_NAMES, BY_POINTS = "given", "names", "points"
"""Why a marker set was taken: a person said so; the file's names are its; the points lie as its markers do."""


class NoSetWorn(AsterismError):
    """Points that are like no shipped marker set."""


@dataclass(frozen=True)
class FindRules:
    """Which points and frames are looked at.

    frames  of a file that are looked at, and thrice as many where they leave doubt; the better half of them counts, since a posture that
            virtual people do not know explains none
    brief   s: points that last less, and less than half as long as the usual point of the file, are ghosts, and say nothing of the set.
            At half, ghosts count as markers; at double, markers that are often out of view are left out
    gap     m, more than from the hip to the next marker of the thigh: points this far from all others are of another person or thing.
            At half, a thigh without markers parts legs from pelvis; at double, people who pass each other are one
    fewest  points that a body shows at least; four hold no body in place
    second  share of the points of the largest body that another one has at least: legs alone beside a whole body have 0.38
    beside  files of a folder that are looked at besides
    sure    probability from which nothing is said; below it, more frames are looked at
    """

    frames: int = 6
    brief: float = 0.5
    gap: float = 0.5
    fewest: int = 8
    second: float = 0.3
    beside: int = 3
    sure: float = 0.95


@dataclass(frozen=True)
class SetCertainty:
    """How evidence becomes a probability.

    Fitted by maximum likelihood, with `FitRules.extra` and `FitRules.missing`, on 198 files of virtual people who wear all shipped sets and
    on 32 files of `movement`. Of the virtual ones a third lack markers and a third have others; four files of five weigh as if they were
    whole. A tenth wears no shipped set: the same files without the sets that share most names; and 28 files of props.

    nats    that count as one: the frames of a file show one body, with its markers placed once. At half, 4 of 199 sure sets are wrong; as
            it is, none of 176; at double, 137 are sure
    some    nats, where any marker of a set is seen in no frame: most files show all. Half and double cost 2 and 5 % of the log loss
    worn    log odds that a shipped set is worn at all, where its body explains the points no better than a box of their size does
    better  by which these grow with each nat a point by which the best body explains them better, times the fourth power of the share of
            its markers and points that are pairs of a marker and a point: points of which a fifth are left over tell 0.4 of it. With powers
            of 1, 2, 3, 4 and 6 the log loss is 0.250, 0.240, 0.232, 0.226 and 0.218, but with 6 three unshipped sets are sure
    same    probability that two files of one folder show the same set. Not fitted: sessions rarely change it. 0.95 and 0.8 change the log
            odds that another file can add from 5.7 to 6.4 and 4.9
    """

    nats: float = 3.7
    some: float = -5.7
    worn: float = -0.77
    better: float = 1.2
    same: float = 0.9


@dataclass(frozen=True)
class WornMarkers:
    """Which markers a file's person wears.

    name          of the set: a shipped one, or its file
    marker_set    the set
    by            `GIVEN`, `BY_NAMES` or `BY_POINTS`
    probability   that it is this set; 1 where it was given
    others        sets that it may be instead, with their probabilities, the most probable first
    same_names    probability that a point's name is right by which set ever: sets share most names, and differ in a few points
    shown, points its markers that the points show in a frame, and the points of that frame; of names, those found and all
    second        the set of the next body in view, where there is one; it has the one after that as its own
    vertical      what points up where the points lie as its markers do; None where the file's names or a person decided
    """

    name: str
    marker_set: MarkerSet
    by: str
    probability: float = 1.0
    others: tuple[tuple[str, float], ...] = ()
    same_names: float = 1.0
    shown: int = 0
    points: int = 0
    second: WornMarkers | None = None
    vertical: Floats | None = None

    @property
    def bodies(self) -> tuple[WornMarkers, ...]:
        """The sets of all bodies in view, this one first."""
        return (self,) if self.second is None else (self, *self.second.bodies)

    @property
    def words(self) -> str:
        """In words: what was taken, why, and how sure that is."""
        if self.by == GIVEN:
            return self.name
        if self.by == BY_NAMES:
            return f"{self.name} (by {self.shown} of {len(self.marker_set)} names)"
        names = f"; its names {_percent(self.same_names)}" if _percent(self.same_names) != _percent(self.probability) else ""
        return f"{self.name} ({_percent(self.probability)}, by its points{names})"

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            "name": self.name,
            "by": self.by,
            "probability": self.probability,
            "others": [{"name": name, "probability": chance} for name, chance in self.others],
            "same_names": self.same_names,
            "shown": self.shown,
            "points": self.points,
            "second": None if self.second is None else self.second.to_dict(),
        }


@dataclass(frozen=True)
class SetEvidence:
    """What a file's points say of the S shipped sets.

    every     fit of a frame
    vertical  what points up
    second    of the next body, which has that of the one after it
    """

    every: tuple[FrameFit, ...]
    vertical: Floats
    second: SetEvidence | None = None

    @property
    def fits(self) -> list[FrameFit]:
        """Those that count: the better half, in which a body is found best."""
        return sorted(self.every, key=lambda fit: -fit.better)[: (len(self.every) + 1) // 2]

    @property
    def nats(self) -> Floats:
        """(S,) the mean evidence of a frame."""
        return np.mean([fit.nats for fit in self.fits], axis=0)

    @property
    def seen(self) -> Ints:
        """(S,) markers of each set that have a point in any of the frames."""
        together = np.concatenate([fit.given for fit in self.fits], axis=1)
        return np.array([len(np.unique(given[given >= 0])) for given in together], dtype=np.int64)

    @property
    def better(self) -> float:
        """Nats a point by which a body explains them better than a box of their size does."""
        return float(np.mean([fit.better for fit in self.fits]))

    def is_body(self, certainty: SetCertainty) -> bool:
        """Whether a shipped set would rather be worn than not if each of the points had a marker, and each marker a point."""
        return certainty.worn + certainty.better * self.better >= 0.0

    def chances(self, certainty: SetCertainty) -> tuple[Floats, float]:
        """The log probabilities (S,) of the sets if one of them is worn, and the probability of that."""
        seen, sizes = self.seen, self.every[0].sizes
        nats = self.nats + certainty.some * (seen < sizes)
        best = int(nats.argmax())
        left_over = float(np.mean([(fit.given[best] < 0).sum() for fit in self.fits]))
        paired = seen[best] / (sizes[best] + left_over)
        return log_softmax(nats / certainty.nats), float(expit(certainty.worn + certainty.better * self.better * paired**4))


@dataclass
class SetFinder:
    """Finds the marker set of each file of a run.

    given     sets that a person named: shipped ones, files, or marker sets; one for each body. Nothing is looked for then
    files     of the run
    vertical  what points up
    """

    given: Sequence[str | Path | MarkerSet] = ()
    files: Sequence[Path] = ()
    vertical: ArrayLike | str | None = None
    rules: FindRules = field(default_factory=FindRules)
    certainty: SetCertainty = field(default_factory=SetCertainty)
    _evidence: dict[Path, SetEvidence | None] = field(default_factory=dict)

    def of(self, path: Path, recording: Recording) -> tuple[WornMarkers, ...]:
        """The set worn in a file, one for each body that was named. recording: the file, or some frames with all its columns.

        Raises NoSetWorn where no shipped set is like it.
        """
        if self.given:
            return self.given_sets()
        named = self._by_names(recording)
        if named is not None:
            return (named,) * max(1, len(people_in(recording.labels, named.marker_set)))
        worn = self._by_points(path, recording)
        if worn is not None and worn.same_names < self.rules.sure:
            # frames between those may show a posture that is better known
            own = self._evidence[path]
            assert own is not None
            self._evidence[path] = evidence_of(replace(recording.clouds(), vertical=own.vertical), self.rules, between=own)
            worn = self._by_points(path, recording)
        if worn is None:
            raise self._refusal(path, recording)
        return (worn,)

    def given_sets(self) -> tuple[WornMarkers, ...]:
        """The sets that a person named. Raises AsterismError where one cannot be read."""
        return tuple(WornMarkers(_name_of(one), MarkerSet.load(one), GIVEN) for one in self.given)

    def _by_names(self, recording: Recording) -> WornMarkers | None:
        """The set of which most markers are named; None where they are of none, or of one that was found live, in a second."""
        live = labelled_live(recording.log)
        if live is not None and not live.settings.get("markers"):
            return None
        worn = worn_marker_sets(recording.labels)
        if not worn:
            return None
        best, chosen = worn[0], None
        unnamed = sum(is_unnamed(label) for label in recording.labels)
        # points without a name may be markers of a larger set, of which these names are a part
        for one in worn:
            if unnamed and len(one.missing) <= unnamed and len(one.found) >= len(best.found) and not one.extra:
                chosen = one if chosen is None or len(one.found) + len(one.missing) > len(chosen.found) + len(chosen.missing) else chosen
        best = best if chosen is None else chosen
        marker_set = MarkerSet.load(best.name)
        others = tuple((one.name, len(one.found) / len(MarkerSet.load(one.name))) for one in worn if one.name != best.name)
        share = len(best.found) / len(marker_set)
        return WornMarkers(best.name, marker_set, BY_NAMES, share, others[:3], share, len(best.found), len(recording.labels) - unnamed)

    def _by_points(self, path: Path, recording: Recording) -> WornMarkers | None:
        """The set that the points of a file show, with those of others in its folder; None where they are no body."""
        own = self._evidence_of(path, recording)
        if own is None:
            raise NoMarkers(f"{path} has no frame with {self.rules.fewest} points or more; name the marker set with --markers.")
        chances, worn = own.chances(self.certainty)
        for other in self._beside(path):
            theirs, shipped = other.chances(self.certainty)
            same = self.certainty.same * shipped
            # a person who wears something else, or props alone, says nothing of this file
            chances = chances + np.log(same * np.exp(theirs) + (1.0 - same) / len(theirs))
        return _most_probable(own, chances - np.logaddexp.reduce(chances), worn, self.certainty) if own.is_body(self.certainty) else None

    def _beside(self, path: Path) -> list[SetEvidence]:
        """What other files of the folder say."""
        from asterism import formats

        found = []
        for file in islice((file for file in self.files if file != path and file.parent == path.parent), self.rules.beside):
            try:
                if file not in self._evidence:
                    self._evidence_of(file, formats.read(file, vertical=self.vertical))
            except (AsterismError, OSError):
                # it is named when it is labelled itself
                self._evidence[file] = None
            other = self._evidence[file]
            if other is not None:
                found.append(other)
        return found

    def _evidence_of(self, path: Path, recording: Recording) -> SetEvidence | None:
        """What a file's points say; None where no frame shows enough of them."""
        if path not in self._evidence:
            self._evidence[path] = self._upright(recording)
        return self._evidence[path]

    def _upright(self, recording: Recording) -> SetEvidence | None:
        """What a file's points say with that up with which they are clearly a body, where nobody said what points up."""
        clouds, rules = recording.clouds(), self.rules
        best = evidence_of(clouds, rules)
        if best is None or self.vertical is not None:
            return best
        # log odds from which nothing is said
        clearly = self.certainty.nats * math.log(rules.sure / (1.0 - rules.sure))
        others = other_verticals(recording, every=not best.is_body(self.certainty))
        # where any axis may be meant, two frames tell which are worth a look: things are no body with any of them
        few = replace(rules, frames=2) if len(others) > 1 else rules
        for vertical in others:
            other = evidence_of(replace(clouds, vertical=vertical), few)
            if other is not None and few is not rules and other.is_body(self.certainty):
                other = evidence_of(replace(clouds, vertical=vertical), rules)
            if other is not None and other.nats.max() > best.nats.max() + clearly:
                best = other
        return best

    def _refusal(self, path: Path, recording: Recording) -> NoSetWorn:
        """That no shipped set is worn, which are the nearest, and whether nobody is of that size."""
        from asterism.formats import unlike_a_person

        own = self._evidence[path]
        assert own is not None
        few = ", ".join(f"{name} ({seen} of {size} markers)" for name, (seen, size) in nearest_sets(own, self.certainty).items())
        size = unlike_a_person(recording.positions)
        size = f"{size}; " if size else ""
        return NoSetWorn(
            f"{path}: its {own.fits[0].given.shape[1]} points are like no shipped marker set; {size}the nearest are {few}. Name one "
            "of them with --markers, write one of your own (`asterism body place` makes it from a labelled trial), train on labelled "
            "files, or name the points once by clicking with `asterism review --serve`."
        )


def nearest_sets(evidence: SetEvidence, certainty: SetCertainty | None = None, most: int = 3) -> dict[str, tuple[int, int]]:
    """The shipped sets that points are most like, the first ones first: how many markers of each have a point in a frame, of how many."""
    nearest = np.argsort(-evidence.chances(certainty or SetCertainty())[0], kind="stable")[:most].tolist()
    names, fit = list(placed_sets()), evidence.fits[0]
    return {names[at]: (int((fit.given[at] >= 0).sum()), len(placed_sets()[names[at]])) for at in nearest}


def evidence_of(
    clouds: Clouds, rules: FindRules | None = None, shapes: BodyShapes | None = None, between: SetEvidence | None = None
) -> SetEvidence | None:
    """What some frames say of all shipped sets; None where no frame shows enough points. See `SetFinder`.

    between: what they said, to which the frames between them are added.
    """
    rules = rules or FindRules()
    clouds = _without_ghosts(clouds, rules)
    counts = np.asarray(clouds.counts)
    if counts.max(initial=0) < rules.fewest:
        return between
    # frames that show most, far from each other; every third is looked at first
    full = np.nonzero(counts >= max(rules.fewest, np.quantile(counts, 0.5)))[0]
    grid = np.linspace(0, len(full) - 1, 3 * rules.frames + 4).round().astype(int)[1:-1]
    first = np.unique(grid[2::3])
    chosen = full[first if between is None else np.setdiff1d(grid, first)]
    of_bodies = list[list[FrameFit]]()  # the largest of each frame first
    for frame in chosen:
        for rank, body in enumerate(_apart(rotate_z_up(clouds[frame], clouds.vertical), rules)):
            of_bodies += [[]] if rank == len(of_bodies) else []
            of_bodies[rank].append(fit_frame(body, shapes or _shapes(), FitRules()))
    if between is not None:
        return replace(between, every=(*between.every, *of_bodies[0])) if of_bodies else between
    found: SetEvidence | None = None
    for fits in reversed(of_bodies):
        # another body is there where most frames show it
        if 2 * len(fits) > len(of_bodies[0]):
            found = SetEvidence(tuple(fits), clouds.vertical, found)
    return found


def _without_ghosts(clouds: Clouds, rules: FindRules) -> Clouds:
    """The clouds without points that are seen briefly."""
    tracklets = find_tracklets(clouds)
    lasts = (tracklets.last - tracklets.first + 1)[tracklets.of_point]
    return clouds.select(lasts >= min(rules.brief * clouds.rate, 0.5 * float(np.median(lasts)))) if len(lasts) else clouds


def _most_probable(own: SetEvidence, chances: Floats, worn: float, certainty: SetCertainty) -> WornMarkers:
    """The set with most evidence, with its probability, and what else it may be. chances: log probabilities if one is worn."""
    names, probable = list(placed_sets()), np.exp(chances) * worn
    first, *others = np.argsort(-probable, kind="stable").tolist()
    same = float(probable @ _same_names(own.fits, first))
    shown = int(np.median([(fit.given[first] >= 0).sum() for fit in own.fits]))
    points = int(np.median([fit.given.shape[1] for fit in own.fits]))
    # a thing that is like no set is a prop, and bodies may come after it
    other = own.second
    while other is not None and not other.is_body(certainty):
        other = other.second
    second = None if other is None else _most_probable(other, *other.chances(certainty), certainty)
    instead = tuple((names[other], float(probable[other])) for other in others[:3])
    name = names[first]
    probability = float(probable[first])
    return WornMarkers(name, placed_sets()[name], BY_POINTS, probability, instead, min(1.0, same), shown, points, second, own.vertical)


def _same_names(fits: Sequence[FrameFit], one: int) -> Floats:
    """(S,) the share of the points named by the one set, or by another, that both call alike, by the aliases of the one."""
    names, shared = list(placed_sets()), np.ones(len(placed_sets()))
    mine = placed_sets()[names[one]]
    for number, name in enumerate(names):
        # each marker of the other set as the one calls it, -2 where it does not know it; the last place is for a point without a marker
        known = [mine.name_of(marker) for marker in placed_sets()[name].names]
        called = np.array([*(mine.names.index(marker) if marker is not None else -2 for marker in known), -1])
        named = [(fit.given[one] >= 0) | (fit.given[number] >= 0) for fit in fits]
        alike = [(called[fit.given[number]] == fit.given[one]) for fit in fits]
        shared[number] = np.median([alike[k][named[k]].mean() if named[k].any() else 0.0 for k in range(len(fits))])
    return shared


def set_instead(evidence: SetEvidence, asked: Sequence[str], sure: float | None = None) -> tuple[str, int] | None:
    """The shipped set that points surely show instead of a shipped one of these markers, and how many of these it does not have.

    sure: how probable it must be, as that of `FindRules`. None where no other set is so probable, or the asked one is none of these.
    """
    names, sets = list(placed_sets()), list(placed_sets().values())
    own = next((at for at, one in enumerate(sets) if one.names == tuple(asked)), None)
    chances, worn = evidence.chances(SetCertainty())
    best = int(chances.argmax())
    if own is None or own == best or worn * np.exp(chances[best]) < (FindRules().sure if sure is None else sure):
        return None
    return names[best], len(set(asked) - {sets[own].name_of(marker) for marker in sets[best].names})


def _apart(points: Floats, rules: FindRules) -> list[Floats]:
    """The groups of points that lie apart from each other and are large enough for a body, the largest first."""
    from scipy.cluster.hierarchy import fcluster, linkage

    if len(points) < rules.fewest:
        return []
    group = fcluster(linkage(points, "single"), rules.gap, "distance")
    sizes = np.bincount(group)
    order = [int(g) for g in np.argsort(-sizes, kind="stable") if sizes[g] >= rules.fewest]
    # where all is scattered, all of it is looked at
    if not order or sizes[order].sum() < 0.7 * len(points):
        return [points]
    large = sizes[order[0]]
    # hands and feet far from their neighbours belong to a body; another body has as many points
    others = [g for g in order[1:] if sizes[g] >= rules.second * large]
    if not others:
        return [points]
    return [points[group == g] for g in (order[0], *others)]


def _percent(chance: float) -> str:
    return f"{significant(100 * min(chance, 0.999), 3)} %"


def _name_of(given: str | Path | MarkerSet) -> str:
    return (given.title or "the given marker set") if isinstance(given, MarkerSet) else str(given)


@cache
def placed_sets() -> Mapping[str, MarkerSet]:
    """The shipped sets that say where their markers sit."""
    return {name: one for name, one in shipped_sets().items() if len(one.places) == len(one)}


@cache
def _shapes() -> BodyShapes:
    return body_shapes(placed_sets())
