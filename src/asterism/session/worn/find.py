"""The files of a run in; for each of them the marker set that is worn, how sure that is, and what else it may be, out.

Names decide where a file has them. Else each shipped set is held against some frames in a body that explains all points, whatever set they
belong to (`fit`); the files of one folder are of one person where they agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import softmax

from asterism.errors import AsterismError, NoMarkers
from asterism.geometry import rotate_z_up
from asterism.labelling import MarkerModel
from asterism.recording import Clouds, Floats, MarkerSet, Recording, shipped_sets, worn_marker_sets
from asterism.recording.marker_set import is_unnamed
from asterism.session.upright import other_verticals
from asterism.session.worn.compare import compare
from asterism.session.worn.fit import FitRules, FrameFit, as_a_thing, fit_frame
from asterism.session.worn.shapes import BodyShapes, body_shapes

GIVEN, BY_NAMES, BY_POINTS = "given", "names", "points"
"""Why a marker set was taken: a person said so; the file's names are its; the points lie as its markers do."""


@dataclass(frozen=True)
class FindRules:
    """How the evidence of frames becomes a probability. Chosen on the recordings of `movement`.

    frames       of a file that are looked at; the better half of them counts, since a posture that virtual people do not know explains none
    gap          m, more than from the hip to the next marker of the thigh: points this far from all others are of another person or thing.
                 At half, a thigh without markers parts legs from pelvis; at double, people who pass each other are one
    fewest       points that a body shows at least; four hold no body in place
    second       share of the points of the largest body that another one has at least: legs alone beside a whole body have 0.38
    temperature  nats of a frame that count as one: the frames of a file show one body with its markers placed once. At half, one file of
                 ten is called sure and is not; at double, sets that differ by two markers are never told apart
    sure         probability from which nothing is asked; below it, or where points are left over, models of the likely sets label some
                 frames
    likely       probability from which a set is held to be likely
    candidates   likely sets at most: each costs seconds where its model is not kept yet
    left_over    points that no marker explains, as a share of the set's markers, from which sets are compared in any case
    worn         share of a set's markers that the points show at least, or of the points if they are fewer; below it, nothing shipped is
                 worn
    better       nats a point by which a body must explain the points better than a thing of their size does, whose points are
                 anywhere in it. People in 20 recordings of shipped sets have 1.3 or more, trays of points and a mouse less than 0; one
                 leg has 0.4. Half and twice of it change none of these but the leg
    explained    share of the points that belong to it at least
    beside       files of a folder that are looked at besides
    agree        nats by which a file's own set may beat that of the folder
    """

    frames: int = 6
    gap: float = 0.5
    fewest: int = 8
    second: float = 0.3
    temperature: float = 3.0
    sure: float = 0.95
    likely: float = 0.003
    candidates: int = 3
    left_over: float = 0.3
    worn: float = 0.6
    better: float = 0.25
    explained: float = 0.35
    beside: int = 3
    agree: float = 12.0


@dataclass(frozen=True)
class WornMarkers:
    """Which markers a file's person wears.

    name          of the set: a shipped one, or its file
    marker_set    the set
    by            `GIVEN`, `BY_NAMES` or `BY_POINTS`
    probability   that it is this set; 1 where it was given
    others        sets that it may be instead, with their probabilities, the most probable first
    shown, points its markers that the points show in a frame, and the points of that frame; of names, those found and all
    second        the set of a second body in view, where there is one
    vertical      what points up where the points lie as its markers do; None where the file's names or a person decided
    """

    name: str
    marker_set: MarkerSet
    by: str
    probability: float = 1.0
    others: tuple[tuple[str, float], ...] = ()
    shown: int = 0
    points: int = 0
    second: WornMarkers | None = None
    vertical: Floats | None = None

    @property
    def words(self) -> str:
        """In words: what was taken, why, and how sure that is."""
        if self.by == GIVEN:
            return self.name
        if self.by == BY_NAMES:
            return f"{self.name} (by {self.shown} of {len(self.marker_set)} names)"
        return f"{self.name} ({100 * min(self.probability, 0.999):.3g} %, by its points)"

    def to_dict(self) -> dict[str, object]:
        """Plain values for JSON."""
        return {
            "name": self.name,
            "by": self.by,
            "probability": self.probability,
            "others": [{"name": name, "probability": chance} for name, chance in self.others],
            "shown": self.shown,
            "points": self.points,
            "second": None if self.second is None else self.second.to_dict(),
        }


@dataclass(frozen=True)
class _SetEvidence:
    """What a file's points say of the sets: nats of a frame, and the markers shown, by set; points of a frame; nats a point by which the
    best set explains them better than a thing of their size does; what points up. Second: of another body."""

    nats: Mapping[str, float]
    shown: Mapping[str, int]
    points: int
    better: float
    vertical: Floats
    second: _SetEvidence | None = None


@dataclass
class SetFinder:
    """Finds the marker set of each file of a run.

    given     sets that a person named: shipped ones, files, or marker sets; one for each body. Nothing is looked for then
    files     of the run
    vertical  what points up
    model_of  gives the model of virtual people who wear a shipped set, to compare sets that cannot be told apart otherwise
    """

    given: Sequence[str | Path | MarkerSet] = ()
    files: Sequence[Path] = ()
    vertical: ArrayLike | str | None = None
    model_of: Callable[[str], MarkerModel] | None = None
    rules: FindRules = field(default_factory=FindRules)
    _evidence: dict[Path, _SetEvidence | None] = field(default_factory=dict)

    def of(self, path: Path, recording: Recording) -> tuple[WornMarkers, ...]:
        """The set worn in a file, one for each body that was named. recording: the file, or some frames with all its columns.

        Raises AsterismError where no shipped set is like it.
        """
        if self.given:
            return self.given_sets()
        named = self._by_names(recording)
        if named is not None:
            return (named,)
        own = self._evidence_of(path, recording)
        if own is None:
            raise NoMarkers(f"{path} has no frame with {self.rules.fewest} points or more; name the marker set with --markers.")
        nats = self._pooled(path, own)
        # no models are made for what is no body: it is refused at once
        if own.better >= self.rules.better:
            nats = self._compared(replace(recording, vertical=own.vertical), nats, own)
        return (replace(self._decided(path, nats, own), vertical=own.vertical),)

    def given_sets(self) -> tuple[WornMarkers, ...]:
        """The sets that a person named. Raises AsterismError where one cannot be read."""
        return tuple(WornMarkers(_name_of(one), MarkerSet.load(one), GIVEN) for one in self.given)

    def _by_names(self, recording: Recording) -> WornMarkers | None:
        """The set of which most markers are named; None where the names are of none."""
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
        return WornMarkers(best.name, marker_set, BY_NAMES, share, others[:3], len(best.found), len(recording.labels) - unnamed)

    def _pooled(self, path: Path, own: _SetEvidence) -> Mapping[str, float]:
        """The evidence of a file with that of others in its folder, where they agree."""
        from asterism import formats

        total, best = dict(own.nats), max(own.nats.values())
        beside = [file for file in self.files if file != path and file.parent == path.parent][: self.rules.beside]
        for file in beside:
            if file not in self._evidence:
                try:
                    self._evidence_of(file, formats.read(file, vertical=self.vertical))
                except (AsterismError, OSError):
                    # it is named when it is labelled itself
                    self._evidence[file] = None
            other = self._evidence[file]
            if other is not None:
                top = max(other.nats, key=lambda name: other.nats[name])
                # a person who wears something else, or props alone, says nothing of this file
                if own.nats[top] > best - self.rules.agree:
                    for name, nats in other.nats.items():
                        total[name] += nats - other.nats[top]
        return total

    def _compared(self, recording: Recording, nats: Mapping[str, float], own: _SetEvidence) -> Mapping[str, float]:
        """The evidence, and what models of the likely sets find where it is in doubt."""
        found, rules = _most_probable(nats, own, self.rules), self.rules
        left_over = own.points - found.shown
        if self.model_of is None or (found.probability >= rules.sure and left_over < rules.left_over * len(found.marker_set)):
            return nats
        # where many points are left over, sets of many markers explain some of them by chance
        apart = -rules.temperature * math.log(rules.likely) * (1.0 if left_over < rules.left_over * len(found.marker_set) else 3.0)
        likely = [name for name in sorted(nats, key=lambda name: -nats[name]) if nats[name] > nats[found.name] - apart][: rules.candidates]
        if len(likely) < 2:
            return nats
        said = compare(recording.clouds(), likely, self.model_of)
        return {name: own + said[name] if name in said else -math.inf for name, own in nats.items()}

    def _evidence_of(self, path: Path, recording: Recording) -> _SetEvidence | None:
        """What a file's points say; None where no frame shows enough of them."""
        if path not in self._evidence:
            self._evidence[path] = self._upright(recording)
        return self._evidence[path]

    def _upright(self, recording: Recording) -> _SetEvidence | None:
        """What a file's points say with that up with which they are clearly a body, where nobody said what points up."""
        clouds, rules = recording.clouds(), self.rules
        best = evidence_of(clouds, rules)
        if best is None or self.vertical is not None:
            return best
        # log odds from which nothing is asked
        clearly = rules.temperature * math.log(rules.sure / (1.0 - rules.sure))
        others = other_verticals(recording, every=best.better < rules.better)
        # where any axis may be meant, two frames tell which are worth a look: things are no body with any of them
        few = replace(rules, frames=2) if len(others) > 1 else rules
        for vertical in others:
            other = evidence_of(replace(clouds, vertical=vertical), few)
            if other is not None and few is not rules and other.better >= rules.better:
                other = evidence_of(replace(clouds, vertical=vertical), rules)
            if other is not None and max(other.nats.values()) > max(best.nats.values()) + clearly:
                best = other
        return best

    def _decided(self, path: Path, nats: Mapping[str, float], own: _SetEvidence) -> WornMarkers:
        """The most probable set. Raises AsterismError where it explains too little of the points, or too few of its markers are shown."""
        found, rules = _most_probable(nats, own, self.rules), self.rules
        markers = len(found.marker_set)
        few_markers = found.shown < rules.worn * min(markers, own.points) or own.better < rules.better
        if few_markers or found.shown < rules.explained * own.points:
            few = ", ".join(
                f"{name} ({own.shown[name]} of {len(_shipped()[name])} markers)" for name in (found.name, *dict(found.others[:2]))
            )
            raise AsterismError(
                f"{path}: its {own.points} points are like no shipped marker set; the nearest are {few}. Name one of them with --markers, "
                "write one of your own (`asterism body place` makes it from a labelled trial), or train on labelled files."
            )
        # points of no marker speak for a set that is not shipped: as much as their share of all points
        share = min(1.0, found.shown / own.points)
        others = tuple((name, chance * share) for name, chance in found.others)
        return replace(found, probability=found.probability * share, others=others)


def evidence_of(clouds: Clouds, rules: FindRules | None = None, shapes: BodyShapes | None = None) -> _SetEvidence | None:
    """What some frames say of all shipped sets; None where no frame shows enough points. See `SetFinder`."""
    rules = rules or FindRules()
    counts = np.asarray(clouds.counts)
    if counts.max(initial=0) < rules.fewest:
        return None
    # frames that show most, far from each other
    full = np.nonzero(counts >= max(rules.fewest, np.quantile(counts, 0.5)))[0]
    chosen = full[np.unique(np.linspace(0, len(full) - 1, rules.frames + 2).round().astype(int)[1:-1])]
    fits, seconds = list[tuple[Floats, FrameFit]](), list[tuple[Floats, FrameFit]]()
    for frame in chosen:
        points = rotate_z_up(clouds[frame], clouds.vertical)
        bodies = _apart(points, rules)
        for place, body in zip((fits, seconds), bodies, strict=False):
            place.append((body, fit_frame(body, shapes or _shapes(), FitRules())))
    if not fits:
        return None
    # a second body is there where most frames show it
    second = _mean(seconds, clouds.vertical) if 2 * len(seconds) > len(fits) else None
    return _mean(fits, clouds.vertical, second)


def _mean(fits: Sequence[tuple[Floats, FrameFit]], vertical: Floats, second: _SetEvidence | None = None) -> _SetEvidence:
    """The mean of what the better half of the frames say: those in which a body is found best."""
    fits = sorted(fits, key=lambda each: -max(each[1].evidence.values()) / len(each[0]))[: (len(fits) + 1) // 2]
    names = fits[0][1].evidence
    worst = min((nats for _, fit in fits for nats in fit.evidence.values() if math.isfinite(nats)), default=0.0)
    nats = {name: float(np.mean([max(fit.evidence[name], worst - 10.0) for _, fit in fits])) for name in names}
    shown = {name: int(np.median([fit.matched[name] for _, fit in fits])) for name in names}
    better = float(np.median([(max(fit.evidence.values()) - as_a_thing(points)) / len(points) for points, fit in fits]))
    return _SetEvidence(nats, shown, int(np.median([len(points) for points, _ in fits])), better, vertical, second)


def _most_probable(nats: Mapping[str, float], own: _SetEvidence, rules: FindRules) -> WornMarkers:
    """The set with most evidence, with its probability, and what else it may be."""
    names = list(nats)
    chances = softmax(np.array([nats[name] for name in names]) / rules.temperature)
    order = np.argsort(-chances, kind="stable")
    first = names[int(order[0])]
    others = tuple((names[int(i)], float(chances[i])) for i in order[1:4])
    second = None if own.second is None else _most_probable(own.second.nats, own.second, rules)
    # a second thing that is like no set is a prop
    if second is not None and second.shown < rules.worn * min(len(second.marker_set), own.second.points if own.second else 0):
        second = None
    return WornMarkers(first, _shipped()[first], BY_POINTS, float(chances[order[0]]), others, own.shown[first], own.points, second)


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


def _name_of(given: str | Path | MarkerSet) -> str:
    return (given.title or "the given marker set") if isinstance(given, MarkerSet) else str(given)


@cache
def _shipped() -> Mapping[str, MarkerSet]:
    """The shipped sets that say where their markers sit."""
    return {name: one for name, one in shipped_sets().items() if len(one.places) == len(one)}


@cache
def _shapes() -> BodyShapes:
    return body_shapes(_shipped())
