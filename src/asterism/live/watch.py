"""Labelled frames of a session in, as they come; what is wrong with the whole of them, said within seconds, out.

A model of other markers, a wrong unit, a wrong axis and a wrong rate look alike to who waits for labels: nothing is labelled. What tells
them apart is in the points: how many there are, how far they spread and along which axis, and how often they come.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from asterism.findings import Finding, Severity
from asterism.live.chain import LabelledFrame
from asterism.live.reporting import labels_given
from asterism.recording import Clouds, Floats
from asterism.recording.display import significant
from asterism.session.left_over import LeftOver, left_on_body, set_worn_instead, sets_to_name

_EACH = 0.1
"""s between two frames that are looked at: what is wrong is wrong in all of them. Half of it costs twice as much and tells no more."""
_LOOKS = 20
"""Frames that are judged together, 2 s. After half of them a person who bends down wears other markers; twice as many keep who waits for
labels waiting for 4 s."""
_FAR, _NEAR = 30.0, 0.03
"""m within which the middle four fifths of a frame's points lie: a hall, and half a hand. A body in millimetres that are called metres
measures 1,000 of them, one in metres that are called millimetres two of them. Half or double is as far from both."""
_FEW_LABELS = 0.2
"""Share of the markers that may be labelled where the labels mean nothing: the best that other sets reach by chance. At half of it a foot
that both sets share hides that the others are others; at double a body half out of view is told."""
_RATE_OFF = 0.1
"""Share by which frames come less or more often than they are believed to: speeds are wrong by as much. 59.94 called 60 is a thousandth,
and pauses of a busy machine move the rate of 2 s by a twentieth; twice as much hides 100 called 120."""


_REMEMBERED = 0.8
"""Share of what was seen of each marker that the next 2 s leave: 10 s count. At half, somebody who crosses the arms lacks markers; without
forgetting, who takes other markers on after an hour is told an hour later."""
_OTHER_SET = "Give the model, or the set, of the markers that are worn."
_TALLER = 1.5
"""Times as far that points spread along another axis as along what is up, before it is told: a stride is as long as legs are high. Half
of it is a person with spread arms; twice as much hides a crouching one."""
_AGAIN = 2
"""Judgements in which something is wrong before it is told, since a person may just walk in. The first alone tells of who is half in view;
with twice as many it is told after 8 s."""
_KEPT = ("live-labels-given", "live-unit", "live-rate-changed")
"""What is reported at the end also where it was wrong for a part of the session."""


@dataclass(frozen=True)
class _Look:
    """A labelled frame, the spread (3,) m of its middle four fifths, and why no set was found yet."""

    found: LabelledFrame
    spread: Floats
    refusal: str

    @property
    def points(self) -> int:
        return len(self.found.frame.points)

    @property
    def labelled(self) -> int:
        return int((self.found.indices >= 0).sum())


@dataclass
class SessionWatch:
    """Looks at ten frames a second, and judges them two seconds at a time. Bounded memory, a tenth of a millisecond a look.

    name   of the source
    up     (3,) what points up; None for z
    timed  whether frames come when they are taken, so that their arrival shows their rate
    tell   what hears of a finding at once
    told   codes of what was said already
    now    what was wrong in the last 2 s, of what was told: gone when it is mended
    chosen whether somebody chose the marker set, so that it may be another one than is worn
    """

    name: str
    up: Floats | None = None
    timed: bool = True
    tell: Callable[[Finding], None] = lambda finding: None
    told: set[str] = field(default_factory=set)
    now: tuple[Finding, ...] = ()
    chosen: bool = False
    _looks: list[_Look] = field(default_factory=list)
    _next: int = 0
    _rate: float = 0.0
    _judged: int = 0
    _wrong: int = 0
    """of the judged ones, those in which something was wrong"""
    _times: dict[str, int] = field(default_factory=dict)
    _last: dict[str, Finding] = field(default_factory=dict)
    _kept_rate: bool = False
    _any_point: bool = False
    _shown: Floats = field(default_factory=lambda: np.zeros(0))
    """(M,) labels that each marker had in the looks that count, and how many looks these are"""
    _shown_in: float = 0.0
    _unlike_looks: list[_Look] = field(default_factory=list)
    _left: LeftOver | None = None
    _fullest: list[_Look] = field(default_factory=list)
    """those that were judged together and have most labels"""

    def add(self, found: LabelledFrame, rate: float, refusal: str = "") -> None:
        """Take a labelled frame; refusal: why no marker set was found yet."""
        if any(found.frame.names):
            self._say(labels_given(self.name), at=1)
        self._next -= 1
        if self._next > 0:
            return
        self._next, self._rate = max(1, round(_EACH * rate)), rate
        points = found.frame.points
        spread = np.diff(np.quantile(points, (0.1, 0.9), axis=0), axis=0)[0] if len(points) else np.zeros(3)
        self._looks.append(_Look(found, spread, refusal))
        if len(self._looks) == _LOOKS:
            self._judge(rate)
            self._looks.clear()

    def findings(self) -> list[Finding]:
        """What was wrong, if something was for most of the session, or once where that is enough."""
        if not self._judged and len(self._looks) >= _LOOKS // 4:
            # A session of less than 2 s is judged by what it had.
            self._judge(self._rate)
        wrong, often = self._wrong > self._judged / 2, min(2, self._judged)
        kept = [finding for code, finding in self._last.items() if self._times[code] >= often and (wrong or code in _KEPT)]
        if self.chosen and self._fullest and all(finding.severity == Severity.NOTE for finding in kept):
            kept += self._of_another_set(self._fullest)
        return [self._with_sets(finding) for finding in kept]

    def _of_another_set(self, looks: list[_Look]) -> list[Finding]:
        """That the labels are those of another set which is like the one that is worn; found out at the end, since it takes a second."""
        instead = set_worn_instead(self._clouds(looks), looks[-1].found.markers)
        sentence = f"{self.name}: {instead}: the labels are not those of the markers that are worn."
        return [Finding("live-other-markers", Severity.WARNING, self.name, sentence, _OTHER_SET)] if instead else []

    def _clouds(self, looks: list[_Look]) -> Clouds:
        return Clouds.from_points([look.found.frame.points for look in looks], 1.0 / _EACH, (0.0, 0.0, 1.0) if self.up is None else self.up)

    def _judge(self, rate: float) -> None:
        self._judged += 1
        self._any_point = self._any_point or any(look.points for look in self._looks)
        self._count_shown()
        labels = [sum(look.labelled for look in looks) for looks in (self._looks, self._fullest)]
        if len(self._looks) == _LOOKS and labels[0] > labels[1]:
            self._fullest = list(self._looks)
        found = [self._of_rate(rate) if self.timed else None, self._of_points()]
        self._wrong += any(each is not None for each in found)
        for finding in found:
            if finding is not None:
                self._say(finding)
        self.now = tuple(finding for finding in found if finding is not None and self._times[finding.code] >= _AGAIN)

    def _of_points(self) -> Finding | None:
        looks = self._looks
        points, labelled = (float(np.median([getattr(look, name) for look in looks])) for name in ("points", "labelled"))
        spread, markers = np.median([look.spread for look in looks], axis=0), len(looks[-1].found.markers)
        if not self._any_point:
            mend = "Look whether the system streams its points. In millimetres that are called metres, they are beyond what is believed."
            return Finding("live-no-points", Severity.WARNING, self.name, f"{self.name}: its frames have no points.", mend)
        if points >= 3 and not _NEAR < spread.max() < _FAR:
            sentence = f"{self.name}: the points of a frame lie within {significant(float(spread.max()), 2)} m, which no body does."
            mend = "Look at the unit in which it sends, and at the one that it says."
            return Finding("live-unit", Severity.WARNING, self.name, sentence, mend)
        if not markers:
            if not looks[-1].refusal:
                return None
            sentence = f"{self.name}: no marker set was found yet. {looks[-1].refusal}"
            return Finding("live-no-set", Severity.WARNING, self.name, sentence, "Name the set with --markers, or give a --model.")
        # Frames from before the set was known say nothing of its labels.
        looks = [look for look in looks if len(look.found.markers) == markers]
        labelled = float(np.median([look.labelled for look in looks]))
        if points > 3 * markers + _LOOKS:
            sentence = f"{self.name}: frames have {points:.0f} points, the marker set has {markers}."
            return Finding("live-many-points", Severity.WARNING, self.name, sentence, "Cover reflections, or mask them in the cameras.")
        fits = 2 * sum(look.found.fits for look in looks) >= len(looks)
        if points and (not fits or points < 0.5 * markers or labelled < _FEW_LABELS * min(points, markers)):
            return self._unlike(points, labelled, spread, markers)
        on_body = [left_on_body(look.found.frame.points, look.found.indices) for look in looks]
        left = LeftOver.of(self._shown / max(self._shown_in, 1.0), on_body)
        if left.tells:
            self._unlike_looks, self._left = list(looks), left
            return Finding("live-other-markers", Severity.WARNING, self.name, left.sentence(self.name, "the set"), _OTHER_SET)
        # Points on the body are markers that nobody asked for.
        beside = float(np.median([look.points - look.labelled - on for look, on in zip(looks, on_body, strict=True)]))
        if min(labelled, beside) > 0.7 * markers:
            sentence = f"{self.name}: {beside:.0f} points are left over beside a body of {labelled:.0f}; one person is labelled."
            return Finding("live-second-body", Severity.NOTE, self.name, sentence, "Have one person in view, or label the recording.")
        axis, times = self._taller(spread)
        if points and times > _TALLER:
            sentence = f"{self.name}: the points spread {significant(times, 2)} times as far along {axis} as along what is held for up."
            mend = f"Say --vertical {axis} if that is up; who lies down spreads so, too."
            return Finding("live-vertical", Severity.NOTE, self.name, sentence, mend)
        return None

    def _taller(self, spread: Floats) -> tuple[str, float]:
        """The axis along which the points spread most, and how many times as far as along what is up."""
        up = np.array([0.0, 0.0, 1.0]) if self.up is None else np.abs(self.up)
        return "xyz"[int(spread.argmax())], float(spread.max() / max(spread @ up, 1e-9))

    def _unlike(self, points: float, labelled: float, spread: Floats, markers: int) -> Finding:
        """Points that are nearly all without a label."""
        sentence = f"{self.name}: {labelled:.0f} of {markers} markers have a label, in frames of {points:.0f} points."
        if points < 0.5 * markers:
            mend = "Look whether the person is in view, and wears this set."
            return Finding("live-few-points", Severity.WARNING, self.name, sentence, mend)
        axis, times = self._taller(spread)
        if times > _TALLER:
            mend = f"They are tallest along {axis}: say --vertical {axis} if that is up, else give the model of these markers."
        else:
            mend, self._unlike_looks, self._left = _OTHER_SET, list(self._looks), None
        return Finding("live-other-markers", Severity.WARNING, self.name, sentence, mend)

    def _count_shown(self) -> None:
        """Add the labels of these looks to those before, of which each judgement forgets a share."""
        if not self._looks or self._shown.shape != self._looks[-1].found.indices.shape:
            self._shown, self._shown_in = np.zeros(len(self._looks[-1].found.indices) if self._looks else 0), 0.0
        own = [look.found.indices >= 0 for look in self._looks if look.found.indices.shape == self._shown.shape and look.points]
        self._shown = _REMEMBERED * self._shown + np.sum(own, axis=0) if own else self._shown
        self._shown_in = _REMEMBERED * self._shown_in + len(own) if own else self._shown_in

    def _with_sets(self, finding: Finding) -> Finding:
        """A finding on other markers, with the sets that the points are like: to find them out takes too long while frames come."""
        if finding.code != "live-other-markers" or not self._unlike_looks:
            return finding
        is_own, sets = sets_to_name(self._clouds(self._unlike_looks), self._unlike_looks[-1].found.markers)
        if is_own and self._left is not None:
            return self._left.note(self.name, "the set")
        return replace(finding, mend=f"{finding.mend} {sets}".strip())

    def _of_rate(self, rate: float) -> Finding | None:
        frames = np.diff([look.found.frame.number for look in self._looks])
        seconds = np.diff([look.found.frame.arrived for look in self._looks])
        if len(frames) < 1 or frames.sum() <= 0 or seconds.sum() <= 0:
            return None
        # A sender that pauses once is no slower for it.
        steady = np.arange(len(seconds)) != seconds.argmax()
        for kept in (np.ones(len(seconds), dtype=np.bool_), steady):
            if seconds[kept].sum() > 0 and abs(frames[kept].sum() / seconds[kept].sum() / rate - 1.0) <= _RATE_OFF:
                self._kept_rate = True
                return None
        seen = float(frames.sum() / seconds.sum())
        sentence = f"{self.name}: {significant(seen, 3)} frames come a second, not {significant(rate, 3)}."
        if self._kept_rate:
            mend = "Cameras that have more to see may be slower: lower their rate until it is held."
            return Finding("live-rate-changed", Severity.WARNING, self.name, sentence, mend)
        mend = f"Say --rate {significant(seen, 3)}, or look at what it sends: speeds are taken from the rate."
        return Finding("live-rate", Severity.WARNING, self.name, sentence, mend)

    def _say(self, finding: Finding, at: int = _AGAIN) -> None:
        """Tell it at its second time; at: another one."""
        code = finding.code
        self._times[code] = self._times.get(code, 0) + 1
        if self._times[code] == at:
            self._tell(finding)
        self._last[code] = finding

    def _tell(self, finding: Finding) -> None:
        if finding.code not in self.told:
            self.told.add(finding.code)
            self.tell(finding)
