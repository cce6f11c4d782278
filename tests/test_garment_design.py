"""The code generator: every block of 3 x 3 its own identity, for any outline and number of colours, with the constraints asked for."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import twins_garment_design as twins
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.garment import DesignRules, count_identities, design_pattern, tapered
from asterism.garment import _design_kernels as kernels
from asterism.garment.design import _count, _DesignArrays, _fill, fill_pattern, least_difference, smallest_rings, too_like
from asterism.garment.identities import count_rings, grid_identities
from asterism.garment.pattern import Piece

pytestmark = pytest.mark.kernels

BRIEF = DesignRules(raster_steps=200_000, search_steps=3_000_000)


@given(st.integers(2, 5), st.integers(0, 2**31))
@settings(max_examples=12, deadline=None)
def test_blocks_are_all_different_and_no_ring_has_a_period(colours: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    side = 5 if colours == 2 else int(rng.integers(6, 15))
    grid = design_pattern((side, side + 1), colours, seed=seed, rules=BRIEF).colours
    assert twins.conflicts(grid) == 0
    assert np.unique(grid).tolist() == list(range(colours))


def test_the_papers_grid_takes_no_search() -> None:
    pattern = design_pattern((90, 90), rules=DesignRules(search_steps=0))
    assert len(pattern.known) == 7744 == len(np.unique(pattern.known))


def test_same_seed_same_pattern_and_another_seed_another() -> None:
    first, again, other = (design_pattern((30, 20), seed=seed).colours for seed in (5, 5, 6))
    assert (first == again).all() and (first != other).mean() > 0.5


def test_what_the_fill_leaves_over_the_search_completes() -> None:
    """30 x 30 cells take 784 of the 2,430 identities of three colours, which so short a fill does not reach."""
    rules = DesignRules(raster_steps=600, search_steps=4_000_000)
    assert fill_pattern(30, 30, 3, rules=rules) < 30
    pattern = design_pattern((30, 30), 3, rules=rules)
    assert len(pattern.known) == 28 * 28 and twins.conflicts(pattern.colours) == 0


def test_pieces_share_no_identity_and_keep_their_outline() -> None:
    leg = tapered(30, 20, 10)
    assert leg[0].sum() == 20 and leg[-1].sum() == 10
    pattern = design_pattern({"front": (25, 18), "leg": leg}, rules=BRIEF)
    front, back = ({*pattern.ids[piece.cells][pattern.ids[piece.cells] >= 0].tolist()} for piece in pattern.pieces)
    assert len(front) == 23 * 16 and front.isdisjoint(back)
    assert ((pattern.colours[pattern.pieces[1].cells] >= 0) == leg).all()
    assert (pattern.colours[:, 18] == -1).all()


def test_a_sheet_with_pieces_of_the_users_own() -> None:
    mask = np.zeros((12, 12), bool)
    mask[:5, :5] = mask[6:, 6:] = True
    pieces = (Piece("cap", 0, 0, 5, 5), Piece("cuff", 6, 6, 6, 6))
    pattern = design_pattern(mask, pieces=pieces, size=(0.068, 0.04))
    assert pattern.pieces == pieces and pattern.pitch == 0.068 and ((pattern.colours >= 0) == mask).all()


def test_two_cells_differ_between_any_two_blocks_where_that_is_asked() -> None:
    pattern = design_pattern((14, 14), rules=DesignRules(least_difference=2, raster_steps=200_000))
    blocks = twins.blocks_of(pattern.colours)
    assert min(twins.difference(a, b) for a, b in combinations(blocks, 2)) == 2 == least_difference(pattern)
    assert least_difference(design_pattern((30, 30))) == 1


def test_a_misread_colour_is_no_other_identity_where_two_cells_differ() -> None:
    pattern = design_pattern((12, 12), rules=DesignRules(least_difference=2, raster_steps=200_000))
    for block in twins.blocks_of(pattern.colours):
        for cell in range(9):
            for step in (1, 2, 3):
                wrong = [*block]
                wrong[cell] = (wrong[cell] + step) % 4
                assert pattern.identity(wrong[0], wrong[1:]) == -1


def test_neighbours_differ_and_colours_are_balanced_where_that_is_asked() -> None:
    apart = design_pattern((30, 30), rules=DesignRules(equal_neighbours=False)).colours
    assert (apart[1:] != apart[:-1]).all() and (apart[:, 1:] != apart[:, :-1]).all()
    balanced = design_pattern((40, 40), rules=DesignRules(balance=0.01)).colours
    assert np.bincount(balanced.ravel()).max() <= 400 * 1.01 + 20


def test_the_papers_method_reaches_less_than_ours() -> None:
    paper = fill_pattern(70, 60, 3, rules=DesignRules(method="paper", raster_steps=50_000))
    ours = fill_pattern(70, 60, 3, rules=DesignRules(raster_steps=50_000))
    assert 5 < paper < ours < 70


@pytest.mark.parametrize(
    "outline, colours, rules, words",
    [
        ((200, 200), 4, None, "39204 identities, and 4 colours have at most 32640"),
        ((100, 100), 4, DesignRules(least_difference=2), "at most 8160"),
        ((60, 60), 4, DesignRules(equal_neighbours=False), "at most"),
        ((2, 9), 4, None, "no room"),
        ({"a": np.zeros((5, 5), bool)}, 4, None, "piece a has no room"),
        ((9, 9), 1, None, "1 colours is not possible"),
        ((9, 9), 9, None, "9 colours is not possible"),
        ((10, 10), 2, DesignRules(raster_steps=1000, search_steps=1000), "needs 64 identities"),
        ((9, 9), 2, DesignRules(raster_steps=1000, search_steps=1000), "no pattern was found"),
        pytest.param((9, 9), 8, DesignRules(least_difference=3), "not possible with 8 colours", marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_made_is_said(outline, colours: int, rules: DesignRules | None, words: str) -> None:
    with pytest.raises(AsterismError, match=words):
        design_pattern(outline, colours, rules=rules)


@pytest.mark.parametrize("change", [{"least_difference": 0}, {"balance": -1.0}, {"acceptance": 1.0}, {"raster_steps": -1}])
def test_rules_that_are_none_are_refused(change: dict) -> None:
    with pytest.raises(AsterismError):
        DesignRules(**change)


def test_progress_goes_on() -> None:
    told: list[float] = []
    design_pattern(
        (30, 30), 3, rules=DesignRules(raster_steps=600, search_steps=4_000_000), progress=lambda share, what: told.append(share)
    )
    assert len(told) > 1 and told == sorted(told) and told[-1] <= 1


def test_contexts_equal_their_twin() -> None:
    members, out = smallest_rings(3), np.zeros(8, np.int64)
    for identity in range(0, count_identities(3), 17):
        centre, ring = identity // count_rings(3), members[identity % count_rings(3)]
        kernels.contexts_of(identity, members, 3, out)
        named = {(int(v) // 3**7, *(int(v) // 3**k % 3 for k in range(7))) for v in out}
        assert named == twins.contexts_of(centre, tuple(int(ring) // 3**k % 3 for k in range(8)), 3)


def test_free_contexts_are_back_where_they_were_after_undoing() -> None:
    sheet = _DesignArrays(np.ones((12, 12), bool), 2, DesignRules())
    flat, missing = _fill(sheet, DesignRules(raster_steps=3000), np.random.default_rng(0), None)
    assert missing == (flat[sheet.order] < 0).sum() > 0
    grid = sheet.unpadded(flat)
    whole = grid_identities(grid, 2)
    assert len(np.unique(whole[whole >= 0])) == (whole >= 0).sum() > 10


def test_recolouring_counts_conflicts_as_its_twin_does() -> None:
    rng = np.random.default_rng(1)
    sheet = _DesignArrays(np.ones((9, 9), bool), 2, DesignRules())
    flat = np.full(len(sheet.is_cell), -1, np.int64)
    flat[sheet.order] = rng.integers(0, 2, 81)
    counted = _count(sheet, flat)
    for cell in rng.choice(sheet.order, 60):
        before = twins.conflicts(sheet.unpadded(flat))
        rest = (sheet.is_block, sheet.around, 2, sheet.classes, sheet.rings, *counted, sheet.near)
        change = kernels.recolour(cell, 1 - flat[cell], flat, *rest)
        assert twins.conflicts(sheet.unpadded(flat)) == before + change
        for kept, fresh in zip(counted, _count(sheet, flat), strict=True):
            assert (kept == fresh).all()


def test_identities_too_like_are_those_of_the_twin() -> None:
    near = too_like(2, 2)
    members = [(int(centre), *(int(ring) // 2**k % 2 for k in range(8))) for centre in range(2) for ring in smallest_rings(2)]
    for a, b in combinations(range(len(members)), 2):
        assert (b in near[a]) == (a in near[b]) == (twins.difference(members[a], members[b]) < 2)
