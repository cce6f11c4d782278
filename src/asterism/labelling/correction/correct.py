"""A model and a recording in; its labels while a person corrects them: pieces, touches, their consequences, undo and redo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding
from asterism.labelling.correction.event_log import CorrectionLog, hash_of_models, hash_of_points
from asterism.labelling.correction.history import History
from asterism.labelling.correction.pieces import (
    Pieces,
    cut_before,
    described,
    found_again,
    point_of_piece,
    table_of_pieces,
)
from asterism.labelling.correction.readiness import Readiness, readiness, to_look_at
from asterism.labelling.correction.relabelling import Relabelling
from asterism.labelling.correction.touches import Cut, Ghost, MarkerSpan, Name, PointInFrame, Request, Right, Swap, SwapMarkers, Touch
from asterism.labelling.recording_labeller import LabelledBodies, LabellingSettings, RecordingLabeller
from asterism.labelling.review import ReviewItem, review
from asterism.labelling.whole.relabel import FREE
from asterism.progress import Progress
from asterism.recording import NULL, Clouds, Event, Ints, Labelling, Recording
from asterism.tracking.linking import Tracklets

if TYPE_CHECKING:
    from asterism.labelling.marker_model import MarkerModel

GHOST = "ghost"
"""What a piece is that a person said to be no marker."""


@dataclass(frozen=True)
class PieceChange:
    """A piece, or part of one, whose label changed.

    piece            its id now
    first, last      frames in which the label changed, inclusive
    before, after    the marker, None without a label, or "ghost"
    by_person        whether a person said so; else it follows from what they said
    """

    piece: int
    first: int
    last: int
    before: str | None
    after: str | None
    by_person: bool


@dataclass(frozen=True)
class CorrectionChange:
    """What touches, or taking one back, changed.

    touches  what was said
    pieces   whose labels changed
    """

    touches: tuple[Touch, ...]
    pieces: tuple[PieceChange, ...]


@dataclass(frozen=True)
class FirstLabels:
    """The labels that a person corrects.

    labeller   what labelled: the models, perhaps narrowed to the person, and the settings
    labelling  of the recording's clouds, perhaps with names of its file
    bodies     what the models alone say; None where they said it of stretches
    found      what was found while the file was read and labelled
    """

    labeller: RecordingLabeller
    labelling: Labelling
    bodies: LabelledBodies | None
    found: Sequence[Finding] = ()

    @classmethod
    def of(cls, labeller: RecordingLabeller, clouds: Clouds, progress: Progress | None = None) -> FirstLabels:
        """What the models give of a recording that is in memory. Raises NoMarkers where it has no points."""
        labelling, bodies = labeller.label_with_bodies(clouds, progress)
        return cls(labeller, labelling, bodies)


@dataclass(frozen=True)
class _Solved:
    """The recording labelled with all that was said; said (J,): each tracklet's marker by its place, -1 for none, `FREE` for nothing."""

    tracklets: Tracklets
    said: Ints
    labelling: Labelling
    pieces: Pieces


class Correction(History[Touch]):
    """A recording's labels while a person corrects them.

    The recording is labelled once, as a whole. `apply` takes what a person says of a piece, labels the recording again with all that was
    said so far held, and gives what changed. `undo` and `redo` have no end. What was said, not the result, is the state: the same touches
    give the same labels, whatever was taken back between them.
    """

    def __init__(
        self,
        model: MarkerModel | Sequence[MarkerModel],
        recording: Recording,
        *,
        first: FirstLabels | None = None,
        workers: int = 1,
        progress: Progress | None = None,
    ) -> None:
        """Label the recording, as `MarkerModel.label` does, or begin with the labels that it has.

        model: one for each body. Raises NoMarkers where the recording has no points.
        """
        super().__init__()
        self.models = tuple(model) if isinstance(model, Sequence) else (model,)
        self.recording = recording
        self.clouds = recording.clouds()
        if first is None:
            labeller = RecordingLabeller(self.models, LabellingSettings(workers=workers))
            first = FirstLabels.of(labeller, self.clouds, progress)
        self.marker_set = first.labeller.marker_set
        self.names = self.marker_set.names
        self._found = first.found
        self._relabelling = Relabelling(first.labeller, self.clouds, first.labelling, first.bodies)
        self._solved = self._solve([])
        self._items: list[ReviewItem] | None = None
        self.last_change: CorrectionChange | None = None
        self.revision = 0
        """Rises with every change."""

    @property
    def labelling(self) -> Labelling:
        """The labels with all that was said; what a person said has confidence 1."""
        return self._solved.labelling

    @property
    def pieces(self) -> Pieces:
        """The pieces of tracks."""
        return self._solved.pieces

    @property
    def filled(self) -> tuple[MarkerSpan, ...]:
        """Gaps whose fill is accepted, in the order in which that was said."""
        accepted: dict[MarkerSpan, None] = {}
        for touch in self._done:
            accepted |= dict.fromkeys(touch.filled)
            for span in touch.unfilled:
                accepted.pop(span, None)
        return tuple(accepted)

    @property
    def events(self) -> tuple[Event, ...] | None:
        """The events as a person set them, s from the first frame; None where nothing was said of them."""
        events: tuple[Event, ...] | None = None
        for touch in self._done:
            if touch.events is not None:
                events = touch.events.applied(events or ())
        return events

    @cached_property
    def identity(self) -> tuple[str, str]:
        """Hashes of the recording's points and of the model: to whom a log of corrections belongs."""
        return hash_of_points(self.clouds), hash_of_models(self.models)

    def items(self) -> list[ReviewItem]:
        """All pieces of tracks with doubts, by expected gain, without what a person has answered."""
        if self._items is None:
            pieces = self.pieces
            found = review(self.labelling, self.clouds, tracklets=self._solved.tracklets)
            self._items = [item for item in found if not pieces.person[pieces.of_point[item.points[0]]]]
        return self._items

    def to_look_at(self) -> list[ReviewItem]:
        """Those of them that a person should look at: as many as `verdict` says."""
        return to_look_at(self.items())

    @property
    def verdict(self) -> Readiness:
        """Whether the recording can be used."""
        return readiness(self.labelling, self.clouds, self.items(), self._found)

    def candidates(self, piece: int) -> list[tuple[str, float]]:
        """All markers and the chance that the piece is each of them, the likeliest first.

        Raises AsterismError where there is no such piece.
        """
        pieces = self.pieces
        place = pieces.place_of(piece)
        points = np.nonzero(pieces.of_point == place)[0]
        chance = self._relabelling.chances(self.labelling, points)
        # what the list says of the piece is calibrated; the body alone is too sure, and ranks the other markers
        known = {int(pieces.marker[place]): float(pieces.confidence[place])} if pieces.marker[place] != NULL else {}
        none = 0.0
        for item in self.items():
            if item.points[0] == points[0]:
                known |= {self.names.index(name): share for name, share in item.alternatives}
                none = item.confidence if item.marker is None else 0.0
        # The rest of the chance is shared by what the body says of the other markers.
        for marker in known:
            chance[marker] = 0.0
        if known:
            chance *= min(1.0, max(0.0, 1.0 - none - sum(known.values())) / max(float(chance.sum()), 1e-300))
        for marker, share in known.items():
            chance[marker] = share
        order = np.argsort(-chance, kind="stable")
        return [(self.names[m], float(chance[m])) for m in order]

    def apply(self, request: Request) -> CorrectionChange:
        """Take what a person says, and label the recording again.

        Raises AsterismError where the piece, marker or frame does not exist; nothing changes then.
        """
        return self.touch(self._touch_of(request))

    def refuse(self, change: CorrectionChange, pieces: Sequence[int]) -> CorrectionChange:
        """Keep the labels that some pieces of a change had before it; what a person said in it stays unless it is named.

        pieces: their ids in the change. Raises AsterismError where one is not in it.
        """
        changed = {part.piece: part for part in change.pieces}
        # An id may be of an earlier state: a person may have answered on an old page.
        strangers = [piece for piece in pieces if piece not in changed]
        if strangers or not pieces:
            raise AsterismError(
                f"the piece {strangers[0]} did not change." if strangers else "no piece was named that should stay as it was."
            )
        labels = []
        for part in change.pieces:
            if part.piece in pieces:
                place = self.pieces.place_of(part.piece)
                point = described(point_of_piece(self.pieces, self.clouds, place, part.first), self.clouds)
                labels.append((point, None if part.before == GHOST else part.before))
        return self.touch(Touch("refuse", (), tuple(labels)))

    def touch(self, *touches: Touch) -> CorrectionChange:
        """Take touches as they are written in a log, one or several at once. Raises AsterismError as `apply` does."""
        # Solved first, then written: what cannot be taken must not be in the log.
        changes = any(touch.is_of_labels for touch in touches)
        solved = self._solve([*self._done, *touches]) if changes else self._solved
        self._add(*touches)
        return self._become(solved, touches)

    def undo(self) -> CorrectionChange:
        """Take the last touch back. Raises AsterismError where there is none."""
        touch = self._last_done()
        solved = self._solve(self._done[:-1]) if touch.is_of_labels else self._solved
        self._take_back()
        return self._become(solved, (touch,))

    def redo(self) -> CorrectionChange:
        """Take again what was taken back last. Raises AsterismError where there is nothing."""
        touch = self._last_undone()
        solved = self._solve([*self._done, touch]) if touch.is_of_labels else self._solved
        self._take_again()
        return self._become(solved, (touch,))

    def attach(self, log: CorrectionLog) -> None:
        """Take what a log holds, and write to it from now on. Raises AsterismError where an entry does not fit the recording."""
        done, undone = self._replayed(log, Touch.from_plain)
        # An entry that is well formed may still name a point that this recording lacks.
        try:
            solved = self._solve(done)
        except AsterismError as problem:
            why = " The answers were given with another model: give that one, or move the log away." if log.other_model else ""
            raise AsterismError(f"{log.path}: {problem}{why}") from problem
        self._done, self._undone, self._log = done, undone, log
        self._become(solved, ())

    def follow(self, earlier: Correction) -> CorrectionChange:
        """Go on from another labelling of the same recording: hold all that was said of it, and write its log from now on.

        Returns what changed. Raises AsterismError where the markers or points are others, an answer does not hold under these labels, or
        the log cannot be written; both corrections stay as they are then.
        """
        if earlier.names != self.names or earlier.identity[0] != self.identity[0]:
            raise AsterismError("the labels are of other markers or other points; start again to correct them.")
        solved = self._solve(earlier._done)
        if earlier._said_of_points(earlier._solved) != self._said_of_points(solved):
            raise AsterismError("an answer would be lost, since the models cut the tracks differently; keep the present labels.")
        # Written before anything is taken over: what is not in the log did not happen.
        if earlier._log is not None:
            earlier._log.relabelled(self.identity[1])
        self._done, self._undone, self._log, earlier._log = earlier._done, earlier._undone, earlier._log, None
        self._solved, self.revision = earlier._solved, earlier.revision
        return self._become(solved, ())

    def labelled_recording(self, by: str = "", *, keep_names: bool = False) -> Recording:
        """The recording under its labels, what was said counted in its processing log; by: what labelled, such as the model's file."""
        return self.logged(self.recording.with_labelling(self.labelling, self.clouds, keep_names=keep_names, by=by))

    def logged(self, labelled: Recording) -> Recording:
        """A recording under these labels, with what was said counted in its processing log."""
        if not self._done:
            return labelled
        # Counts of each kind, in the order in which they first came.
        kinds = [touch.kind for touch in self._done]
        counts = {kind: kinds.count(kind) for kind in dict.fromkeys(kinds)}
        return labelled.logged("corrected", "a person", touches=len(self._done), **counts)

    def _become(self, solved: _Solved, touches: tuple[Touch, ...]) -> CorrectionChange:
        """Take a solved state, and say what changed."""
        change = CorrectionChange(touches, self._differences(self._solved, solved))
        self._solved, self._items, self.last_change = solved, None, change
        self.revision += 1
        return change

    def _solve(self, touches: Sequence[Touch]) -> _Solved:
        """The recording labelled with these touches held; from the first labelling on, whatever was solved between."""
        # Points are found again by place, since pieces are numbered anew by each solving.
        cuts = np.array([found_again(point, self.clouds) for touch in touches for point in touch.cuts], dtype=np.int64)
        tracklets = cut_before(self._relabelling.tracklets, self.clouds, cuts)
        said = np.full(len(tracklets), FREE, dtype=np.int64)
        # In their order: a later answer wins over an earlier one that contradicts it.
        for touch in touches:
            for point, marker in touch.labels:
                self._say(said, tracklets, int(tracklets.of_point[found_again(point, self.clouds)]), marker)
        labelling = self._relabelling.label(tracklets, said) if touches else self._relabelling.first
        pieces = table_of_pieces(tracklets, self.clouds, labelling, said == NULL, said != FREE)
        return _Solved(tracklets, said, labelling, pieces)

    def _said_of_points(self, solved: _Solved) -> list[str | None]:
        """(P) what a person said of each point: a marker, "ghost", or None for nothing."""
        said = {FREE: None, NULL: GHOST} | dict(enumerate(self.names))
        return [said[number] for number in solved.said[solved.tracklets.of_point].tolist()]

    def _say(self, said: Ints, tracklets: Tracklets, piece: int, marker: str | None) -> None:
        """Put what was said of a tracklet into `said` (J,); what was said of others before that contradicts it is forgotten."""
        if marker is None:
            said[piece] = NULL
            return
        place = self._place_of(marker)
        # A marker is in one place at a time, so that others of that name at the same time lose it.
        together = (tracklets.first <= tracklets.last[piece]) & (tracklets.last >= tracklets.first[piece])
        said[together & (said == place)] = FREE
        said[piece] = place

    def _place_of(self, marker: str) -> int:
        if marker not in self.names:
            listed = ", ".join(self.names[:8])
            raise AsterismError(f"{marker[:60]!r} is no marker of the model ({listed}, ...); give one of its markers.")
        return self.names.index(marker)

    def _touch_of(self, request: Request) -> Touch:
        """What a request says, in terms that survive another labelling."""
        if isinstance(request, SwapMarkers):
            return self._swap_of_markers(request)
        pieces = self.pieces
        place = pieces.place_of(request.piece)
        if isinstance(request, Cut):
            if not pieces.first[place] < request.frame <= pieces.last[place]:
                raise AsterismError(
                    f"the piece is there in frames {pieces.first[place]} to {pieces.last[place]} and cannot be cut at {request.frame}; "
                    "give a frame after its first one."
                )
            return Touch("cut", (self._point(place, request.frame),))
        if isinstance(request, Swap):
            return self._swap_of_pieces(request)
        if isinstance(request, Name):
            self._place_of(request.marker)
            return Touch("name", (), ((self._point(place), request.marker),))
        if isinstance(request, Ghost):
            return Touch("ghost", (), ((self._point(place), None),))
        assert isinstance(request, Right)
        return Touch("right", (), ((self._point(place), self._marker(place)),))

    def _swap_of_pieces(self, request: Swap) -> Touch:
        pieces = self.pieces
        one, other = pieces.place_of(request.piece), pieces.place_of(request.other)
        if one == other:
            raise AsterismError("a piece cannot be exchanged with itself; give two pieces.")
        first = int(min(pieces.first[[one, other]])) if request.first is None else request.first
        last = int(max(pieces.last[[one, other]])) if request.last is None else request.last
        return self.swap_from((one, other), first, last)

    def swap_from(self, places: tuple[int, int], first: int, last: int | None = None) -> Touch:
        """The touch by which two pieces, by their places in the table, carry each other's labels in some frames.

        Raises AsterismError where both have the same label, or none is there.
        """
        one, other = places
        swapped = ((one, self._marker(other)), (other, self._marker(one)))
        if swapped[0][1] == swapped[1][1]:
            raise AsterismError("both pieces have the same label, so that there is nothing to exchange; name one of them.")
        return self._exchanged(swapped, first, len(self.clouds) - 1 if last is None else last)

    def _swap_of_markers(self, request: SwapMarkers) -> Touch:
        one, other = self._place_of(request.marker), self._place_of(request.other)
        last = len(self.clouds) - 1 if request.last is None else request.last
        swapped = []
        for place in np.nonzero(np.isin(self.pieces.marker, (one, other)))[0]:
            swapped.append((int(place), request.other if self.pieces.marker[place] == one else request.marker))
        return self._exchanged(swapped, request.first, last)

    def _exchanged(self, markers: Sequence[tuple[int, str | None]], first: int, last: int) -> Touch:
        """Pieces, by their places, get other markers from frame first to last, and are cut there."""
        pieces, cuts, labels = self.pieces, [], []
        for place, marker in markers:
            # A piece that is there for part of the frames is exchanged for that part only.
            begin, end = max(first, int(pieces.first[place])), min(last, int(pieces.last[place]))
            if begin > end:
                continue
            # Cut where the exchange begins and ends, so that the rest keeps its label.
            if begin > pieces.first[place]:
                cuts.append(self._point(place, begin))
            if end < pieces.last[place]:
                cuts.append(self._point(place, end + 1))
            labels.append((self._point(place, begin), marker))
        if not labels:
            raise AsterismError(f"neither of the two is there in frames {first} to {last}; give other frames.")
        return Touch("swap", tuple(cuts), tuple(labels))

    def _point(self, place: int, frame: int | None = None) -> PointInFrame:
        frame = int(self.pieces.first[place]) if frame is None else frame
        return described(point_of_piece(self.pieces, self.clouds, place, frame), self.clouds)

    def _marker(self, place: int) -> str | None:
        marker = int(self.pieces.marker[place])
        return self.names[marker] if marker != NULL else None

    def _differences(self, before: _Solved, after: _Solved) -> tuple[PieceChange, ...]:
        """The pieces, or parts of them, whose labels differ."""
        count = len(before.pieces)
        # Pieces may have been cut or joined between: each pair of old and new piece is compared once.
        pair, first_point, of_point = np.unique(
            after.pieces.of_point * count + before.pieces.of_point, return_index=True, return_inverse=True
        )
        now, then = np.divmod(pair, count)
        frames = self.clouds.frame_of
        last = np.zeros(len(pair), dtype=np.int64)
        np.maximum.at(last, of_point, frames)
        changed = (_labels_of(before.pieces)[then] != _labels_of(after.pieces)[now]).nonzero()[0]
        found = []
        # In the order in which a person meets them in time.
        for part in changed[np.argsort(first_point[changed], kind="stable")]:
            found.append(
                PieceChange(
                    int(after.pieces.id[now[part]]),
                    int(frames[first_point[part]]),
                    int(last[part]),
                    self._said_of(before.pieces, then[part]),
                    self._said_of(after.pieces, now[part]),
                    bool(after.pieces.person[now[part]]),
                )
            )
        return tuple(found)

    def _said_of(self, pieces: Pieces, place: int) -> str | None:
        if pieces.ghost[place]:
            return GHOST
        return self.names[pieces.marker[place]] if pieces.marker[place] != NULL else None


def _labels_of(pieces: Pieces) -> Ints:
    """(J,) the marker of each piece, -1 without a label, -2 for what a person said to be none."""
    return np.where(pieces.ghost, NULL - 1, pieces.marker)
