"""The thesis' own method (chapter 4 and section 5.2), complete, beside the whole body that `MarkerModel` labels by.

| step | section | names |
|---|---|---|
| features of a few points, shared with the anchors of the whole body | 4.3, table 4.1 | `FEATURES`, `feature_pool`, `describe` |
| weak classifiers: an interval of one feature | 4.3, eq. 4.4 | `FeatureRanges`, `WeakClassifiers`, `choose_widening` |
| boosting; the strong classifier | 4.4.1, eq. 4.5 | `WrongLabellings`, `StrongClassifier` |
| tree search | 4.4.2 | `Solver`, `build_search_tree`, `pack_solvers`, `unpack_solvers` |
| the full solver, for all markers at once | 5.2 | `FullSolver`, `FullSolverRules`, `boosting_table`, `solver_sizes`, `fit_printed` |
| search for partial solvers | 4.5.3, algorithms 4.1, 4.2 | `search_partial_solvers`, `SearchSettings`, `SolverSearch` |
| labelling matrix and its rules | 4.5.4 | `label_by_matrix`, `PartialSolvers`, `VotingRules`, `MATRIX_RULES` |
| capturability of a marker set | 4.5.2, 6.1 | `capturability`, `Capturability`, `CapturabilityRules` |

A pool of the thesis' three features over 15 markers has the 665 weak classifiers of section 5.2:

>>> from asterism.labelling.partial import feature_pool
>>> kinds, slots = feature_pool(15)
>>> len(kinds)
665

Frames are arrays (N, M, 3) in metres with z up, as `stack_frames` makes them of recordings. No part of the whole body imports this room;
a model has partial solvers only where its training was asked for them.
"""

from asterism.labelling.features.registry import FEATURES, THESIS, Feature, describe, feature_pool
from asterism.labelling.partial.capturability import Capturability, CapturabilityRules, MarkerSetChange, TargetRates, capturability
from asterism.labelling.partial.full_solver_study import ChosenClassifier, SolverSize, boosting_table, fit_printed, solver_sizes
from asterism.labelling.partial.matrix import MATRIX_RULES, PartialSolvers, Votes, VotingRules, label_by_matrix
from asterism.labelling.partial.search_strategies import MINERS, search_partial_solvers
from asterism.labelling.partial.solver import (
    FullSolver,
    FullSolverRules,
    Solver,
    build_search_tree,
    pack_solvers,
    replacement_table,
    stack_frames,
    unpack_solvers,
)
from asterism.labelling.partial.solver_search import MINIMAL, PRINTED, PRINTED_FEATURES, EvaluatedSolver, SearchSettings, SolverSearch
from asterism.labelling.partial.weak import (
    FeatureRanges,
    StrongClassifier,
    WeakClassifiers,
    WrongLabellings,
    choose_widening,
    classifiers_over,
)

__all__ = [
    "FEATURES",
    "MATRIX_RULES",
    "MINERS",
    "MINIMAL",
    "PRINTED",
    "PRINTED_FEATURES",
    "THESIS",
    "Capturability",
    "CapturabilityRules",
    "ChosenClassifier",
    "EvaluatedSolver",
    "Feature",
    "FeatureRanges",
    "FullSolver",
    "FullSolverRules",
    "MarkerSetChange",
    "PartialSolvers",
    "SearchSettings",
    "Solver",
    "SolverSearch",
    "SolverSize",
    "StrongClassifier",
    "TargetRates",
    "Votes",
    "VotingRules",
    "WeakClassifiers",
    "WrongLabellings",
    "boosting_table",
    "build_search_tree",
    "capturability",
    "choose_widening",
    "classifiers_over",
    "describe",
    "feature_pool",
    "fit_printed",
    "label_by_matrix",
    "pack_solvers",
    "replacement_table",
    "search_partial_solvers",
    "solver_sizes",
    "stack_frames",
    "unpack_solvers",
]
