"""Patterns of coloured circles: how many identities there are, what a rotation is, and the files."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.garment import Pattern, Piece, count_identities, count_rings
from asterism.garment.identities import RING, grid_identities, identities, ring_classes
from asterism.garment.pattern import spread_hues


def small_pattern(rows: int = 6, cols: int = 8, colours: int = 4, seed: int = 0, **given) -> Pattern:
    """The first random grid that is a pattern."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            return Pattern(rng.integers(0, colours, (rows, cols)), spread_hues(colours), **given)
        except AsterismError:
            continue


def slow_class(ring: tuple[int, ...]) -> tuple[int, ...] | None:
    """The smallest shift of a ring, None where it has a period."""
    shifts = [ring[k:] + ring[:k] for k in range(8)]
    return None if len(set(shifts)) < 8 else min(shifts)


@pytest.mark.parametrize("colours", [2, 3])
def test_the_classes_of_rings_are_those_of_a_plain_list(colours: int) -> None:
    classes = ring_classes(colours)
    named: dict[int, tuple[int, ...] | None] = {}
    for ring in product(range(colours), repeat=8):
        number = int(classes[sum(c * colours**k for k, c in enumerate(ring))])
        assert named.setdefault(number, slow_class(ring)) == slow_class(ring)
    assert set(named) == {-1, *range(count_rings(colours))}
    assert len(set(named.values())) == len(named)


def test_the_papers_counts() -> None:
    assert 4**9 == 262_144
    assert (count_rings(4), count_identities(4)) == (8160, 32_640)
    assert len(np.unique(ring_classes(4))) == 8160 + 1


@given(st.integers(2, 5), st.integers(0, 7), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_an_identity_survives_any_shift_of_its_ring(colours: int, shift: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, ring = rng.integers(0, colours, 5), rng.integers(0, colours, (5, 8))
    first = identities(centre, ring, colours)
    assert (first == identities(centre, np.roll(ring, shift, axis=1), colours)).all()
    assert (first < count_identities(colours)).all()
    periodic = (ring == np.roll(ring, 4, axis=1)).all(axis=1)
    assert ((first < 0) == periodic).all()


def test_a_turned_sheet_has_the_same_identities_and_a_mirrored_one_has_not() -> None:
    pattern = small_pattern()
    turned = grid_identities(np.rot90(pattern.colours).copy(), 4)
    assert (np.rot90(pattern.ids) == turned).all()
    mirrored = grid_identities(pattern.colours[:, ::-1].copy(), 4)[:, ::-1]
    assert (pattern.identity(0, np.zeros(8, int)) == -1) and np.mean(mirrored[1:-1, 1:-1] == pattern.ids[1:-1, 1:-1]) < 0.3


def test_lookups_agree_with_the_grid() -> None:
    pattern = small_pattern(pieces=(Piece("front", 0, 0, 6, 8),))
    assert len(pattern.known) == 4 * 6 and pattern.shape == (6, 8)
    for row, col in np.argwhere(pattern.ids >= 0):
        number = int(pattern.ids[row, col])
        assert pattern.cells(number).tolist() == [row, col]
        ring = [pattern.colours[row + dr, col + dc] for dr, dc in RING]
        assert pattern.identity(pattern.colours[row, col], ring) == number
        assert pattern.neighbours(number).tolist() == [pattern.ids[row + dr, col + dc] for dr, dc in RING]
        assert pattern.piece_of(number) == 0
    unknown = np.setdiff1d(np.arange(count_identities(4)), pattern.known)
    assert (pattern.cells(unknown) == -1).all() and (pattern.piece_of(np.array([unknown[0], -1])) == -1).all()
    assert pattern.cells([-1, 10**9]).tolist() == [[-1, -1], [-1, -1]]
    with pytest.raises(AsterismError, match="does not occur"):
        pattern.neighbours(int(unknown[0]))


def test_positions_are_metres_on_the_sheet_with_nan_outside_the_mask() -> None:
    colours = small_pattern().colours.copy()
    colours[0, 0] = -1
    places = Pattern(colours, pitch=0.02).positions()
    assert np.isnan(places[0, 0]).all() and places[2, 3].tolist() == [0.06, 0.04, 0.0]


def test_files_give_the_pattern_back(tmp_path: Path) -> None:
    colours = np.full((7, 15), -1, dtype=np.int8)
    whole = small_pattern(7, 14, seed=3)
    colours[:, :7], colours[:, 8:] = whole.colours[:, :7], whole.colours[:, 7:]
    pattern = Pattern(colours, pitch=0.02, diameter=0.012, pieces=(Piece("left", 0, 0, 7, 7), Piece("right", 0, 8, 7, 7)))
    description = pattern.save(tmp_path / "suit.npz")
    assert description == tmp_path / "suit.toml"
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for path in (description, tmp_path / "suit.npz"):
        back = Pattern.load(path)
        assert (back.colours == pattern.colours).all() and (back.ids == pattern.ids).all() and (back.hsv == pattern.hsv).all()
        assert (back.pitch, back.diameter, back.pieces) == (0.02, 0.012, pattern.pieces)
    pattern.save(description)
    assert first == {path.name: path.read_bytes() for path in tmp_path.iterdir()}, "the same bytes again"
    assert set(pattern.piece_of(pattern.known).tolist()) == {0, 1}
    description.write_text(description.read_text().replace("pitch = 0.02", "pitch = 0.0203"))
    assert Pattern.load(description).pitch == 0.0203, "what was measured on the cloth"


def test_damaged_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    description = small_pattern().save(tmp_path / "suit")
    lookup, text = tmp_path / "suit.npz", description.read_text()
    whole = lookup.read_bytes()
    later = text.replace("version = 1", "version = 9")
    for damage, words in (
        (later, "later Asterism"),
        ("[piece]\n", "does not describe"),
        ("=", "no TOML"),
        (text.split("pitch")[0], "damaged"),
    ):
        description.write_text(damage)
        with pytest.raises(AsterismError, match=words) as said:
            Pattern.load(description)
        assert "suit" in str(said.value)
    lookup.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(AsterismError, match=r"suit\.npz"):
        Pattern.load(lookup)
    np.savez(lookup, kind="recording", asterism=1)
    with pytest.raises(AsterismError, match="not a garment's lookup"):
        Pattern.load(lookup)
    with pytest.raises(AsterismError, match="does not exist"):
        Pattern.load(tmp_path / "none.npz")


def test_a_lookup_whose_identities_are_of_another_pattern_is_refused(tmp_path: Path) -> None:
    small_pattern().save(tmp_path / "suit")
    with np.load(tmp_path / "suit.npz") as stored:
        arrays = dict(stored)
    arrays["ids"] = np.where(arrays["ids"] >= 0, arrays["ids"][::-1], -1)
    np.savez(tmp_path / "suit.npz", **arrays)
    with pytest.raises(AsterismError, match="contradict each other"):
        Pattern.load(tmp_path / "suit.npz")


@pytest.mark.parametrize(
    "change, words",
    [
        ({"colours": np.zeros((5, 5), int)}, "rotational period"),
        ({"colours": np.tile(small_pattern(6, 6, seed=2).colours, (1, 2))}, "same identity"),
        ({"colours": np.full((5, 5), 4)}, "from -1 to 3"),
        ({"colours": np.zeros((0, 5), int)}, "whole numbers"),
        ({"hsv": spread_hues(4) * 360}, "from 0 to 1"),
        ({"pitch": 18.0, "diameter": 10.0}, "give metres"),
        ({"diameter": 0.02}, "not possible"),
        ({"pieces": (Piece("a", 0, 0, 6, 4),)}, "belong to no piece"),
        ({"pieces": (Piece("a", 0, 0, 6, 4), Piece("b", 0, 4, 6, 4))}, "touches another"),
        ({"pieces": (Piece("a", 0, 0, 6, 9),)}, "outside the sheet"),
        ({"pieces": (Piece("a", 0, 0, 6, 4), Piece("a", 0, 5, 6, 3))}, "a name of its own"),
    ],
)
def test_what_is_no_pattern_is_refused(change: dict, words: str) -> None:
    with pytest.raises(AsterismError, match=words):
        replace(small_pattern(), **change)
