"""Marker sets: the markers of a body, their spellings in files, and which labels only number a point."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from importlib import resources
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError, guarded_reading, refuse_special
from asterism.files.toml import tables_of_toml
from asterism.recording.arrays import Ints
from asterism.recording.place import Place

_UNNAMED = re.compile(
    r"|\*.*|\d+|u\d+|x\d{2,}|(?:uname|unnamed|noname|unl|unlab|unlabel|unlabell?ed|unk|unknown|unid|unident|unidentified|ghost)[\s_:#-]*\d*\*?\d*",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class MarkerSet:
    """The markers of a body, and their spellings in files.

    names     marker names in order: the columns of every `Labelling` with this set
    aliases   for each name its other spellings; case, punctuation and a subject prefix are ignored
    pairs     (left, right) names that mirror each other
    segments  segment name -> names of the markers on it
    places    marker name -> where it sits on the body, in the order of the names; empty where the set does not say
    optional  names of markers that many laboratories leave out

    >>> legs = MarkerSet(("LKNE", "RKNE"), aliases={"LKNE": ("L.Knee",)}, pairs=(("LKNE", "RKNE"),))
    >>> legs.name_of("ann:l_knee"), legs.name_of("C7")
    ('LKNE', None)
    """

    names: tuple[str, ...]
    title: str = ""
    aliases: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    pairs: tuple[tuple[str, str], ...] = ()
    segments: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    places: Mapping[str, Place] = field(default_factory=dict)
    optional: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.names:
            raise AsterismError(f"marker set {self.title or '(unnamed)'} has no markers; list them under `markers`.")
        # Spellings are compared as files will be: without case and punctuation.
        spelled: dict[str, str] = {}
        for name in self.names:
            for spelling in (name, *self.aliases.get(name, ())):
                known = spelled.setdefault(canonical(spelling), name)
                if known != name:
                    raise AsterismError(
                        f"marker set {self.title or '(unnamed)'}: {spelling!r} stands for both {known} and {name}; keep it for one."
                    )
        if len(set(self.names)) != len(self.names):
            twice = next(name for name in self.names if self.names.count(name) > 1)
            raise AsterismError(f"marker set {self.title or '(unnamed)'}: {twice} is listed twice; keep it once.")
        unlisted = {m for pair in self.pairs for m in pair} | {m for ms in self.segments.values() for m in ms}
        unlisted = (unlisted | set(self.aliases) | set(self.places) | set(self.optional)) - set(self.names)
        if unlisted:
            raise AsterismError(
                f"marker set {self.title or '(unnamed)'}: {sorted(unlisted)[0]} is named in aliases, pairs, segments, places or optional "
                "but not among the markers; add it there or drop it here."
            )

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def _name_of_spelling(self) -> dict[str, str]:
        return {canonical(s): name for name in self.names for s in (name, *self.aliases.get(name, ()))}

    def name_of(self, label: str) -> str | None:
        """The marker that a file's label means, or None. A subject prefix ("Ann:LKNE", "Ann_LKNE:") is ignored."""
        # The whole label first: a prefix may be part of a name.
        return self._name_of_spelling.get(canonical(label)) or self._name_of_spelling.get(canonical(without_subject(label)))

    def columns_of(self, labels: Sequence[str]) -> Ints:
        """For each marker the column that carries its label: (M,), -1 where no column does.

        Raises AsterismError where two columns have one marker's label.

        >>> MarkerSet(("LKNE", "RKNE", "SACR")).columns_of(["*1", "Ann:SACR", "Ann:LKNE"])
        array([ 2, -1,  1])
        """
        columns = np.full(len(self.names), -1, dtype=np.int64)
        index = {name: i for i, name in enumerate(self.names)}
        for column, label in enumerate(labels):
            name = self.name_of(label)
            if name is None:
                continue
            if columns[index[name]] >= 0:
                raise AsterismError(
                    f"points {columns[index[name]] + 1} and {column + 1} are both labelled {name}; rename or remove one of them."
                )
            columns[index[name]] = column
        return columns

    def to_toml(self) -> str:
        """The set as the text of its TOML file, which `from_toml` reads back.

        The place of a pair's right marker is left out where it mirrors the left one's.

        >>> print(MarkerSet(("LKNE", "RKNE"), title="Knees", pairs=(("LKNE", "RKNE"),)).to_toml())
        title = "Knees"
        markers = ["LKNE", "RKNE"]
        pairs = [["LKNE", "RKNE"]]
        <BLANKLINE>
        """
        from asterism.recording._marker_set_file import text_of

        lists = {"aliases": self.aliases, "segments": self.segments}
        return text_of(self.title, self.names, self.pairs, lists, self.places, self.optional)

    @classmethod
    def load(cls, source: str | Path | MarkerSet | Sequence[str]) -> MarkerSet:
        """A shipped set by name ("helen-hayes"), a TOML file by path, a list of names, or a marker set.

        Raises AsterismError where the name is not shipped, or the file is missing or not a marker set.

        >>> len(MarkerSet.load("helen-hayes")), MarkerSet.load(["LASI", "RASI"]).names
        (15, ('LASI', 'RASI'))
        """
        if isinstance(source, MarkerSet):
            return source
        # A list of names is a set without aliases.
        if not isinstance(source, str | Path):
            names = tuple(source)
            return cls(names, title=f"list of {len(names)} names")
        # Shipped names come before files: a file of that name in the folder must not shadow them.
        if isinstance(source, str) and source in shipped_marker_sets():
            text = resources.files("asterism").joinpath("marker_sets", f"{source}.toml").read_text(encoding="utf-8")
            return cls.from_toml(text, origin=source)
        path = Path(source)
        refuse_special(path)
        if not path.is_file():
            raise AsterismError(f"marker set {str(source)!r} is neither shipped nor a TOML file that exists; {_near(str(source))}.")
        with guarded_reading(path):
            return cls.from_toml(path.read_text(encoding="utf-8", errors="replace"), origin=str(path))

    @classmethod
    def from_toml(cls, text: str, origin: str) -> MarkerSet:
        """A marker set from its TOML text; `origin` names it in messages."""
        from asterism.recording._marker_set_file import fields_of

        # A damaged file may nest too deeply, or hold values of any type.
        try:
            return cls(**fields_of(tables_of_toml(text), origin))
        except (RecursionError, ValueError) as problem:
            raise AsterismError(
                f"{origin} is not a marker set ({problem}); it is TOML with a list `markers`, "
                "if needed `aliases`, `pairs`, `segments` and `places`."
            ) from problem


def shipped_marker_sets() -> tuple[str, ...]:
    """Names of the marker sets that come with Asterism.

    >>> shipped_marker_sets()[:3]
    ('cast', 'cleveland-clinic', 'clouthier')
    """
    folder = resources.files("asterism").joinpath("marker_sets")
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


@cache
def shipped_sets() -> Mapping[str, MarkerSet]:
    """The marker sets that come with Asterism, by name; each is read once in a process."""
    return {name: MarkerSet.load(name) for name in shipped_marker_sets()}


def _near(name: str) -> str:
    """The shipped sets whose names are like this one, in words; all of them where none is."""
    from difflib import SequenceMatcher

    wanted, shipped = canonical(Path(name).stem), shipped_marker_sets()

    def likeness(one: str) -> float:
        words = one.split("-")
        # people write a part of a name, or its initials
        spellings = (canonical(one), *words, "".join(word[0] for word in words))
        return max(SequenceMatcher(None, wanted, spelling).ratio() for spelling in spellings)

    # most letters in common and in order; with half of them each name is like every other, with nine of ten "rizoli" is like none
    like = [one for one in shipped if likeness(one) > 0.7]
    near = sorted(like, key=lambda one: (-likeness(one), one))[:5]
    return f"shipped sets of such names are {', '.join(near)}" if near else f"the shipped ones are {', '.join(shipped)}"


@lru_cache(maxsize=4096)
def canonical(label: str) -> str:
    """A label without case and punctuation: R.ASIS, r_asis and RASIS give the same.

    >>> canonical("R.ASIS") == canonical("r_asis")
    True
    """
    return re.sub(r"[^\w*]|_", "", label.casefold())


@lru_cache(maxsize=4096)
def is_unnamed(label: str) -> bool:
    """Whether a label only numbers an unnamed point: *12, uname*3, U7, Unlabeled:108, 20100, Unidentified, or nothing at all.

    >>> is_unnamed("*12"), is_unnamed("LKNE")
    (True, False)
    """
    return _UNNAMED.fullmatch(without_subject(label).strip()) is not None


def plain_name(label: str) -> str:
    """What a label calls its marker, without the subject's name, case and punctuation: by this labels of files are compared.

    >>> plain_name("Ann:L_KNE") == plain_name("lkne")
    True
    """
    return canonical(without_subject(label))


def without_subject(label: str) -> str:
    """A label without the subject's name before the last colon.

    >>> without_subject("Ann:LKNE")
    'LKNE'
    """
    return label.rsplit(":", 1)[-1]
