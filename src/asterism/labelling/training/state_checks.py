"""What was made of a model file: whether it can label."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from asterism.labelling.body.model import BodyModel
from asterism.labelling.training.model_state import ModelState

_TIMES_DEFAULT, _BEYOND_DEFAULT = 1000.0, 1000.0
"""A setting is at most so many times its default, and so much more: settings bound loops and sizes."""


def check_state(state: ModelState) -> None:
    """Raise ValueError where what was made of a model file could not label: a covariance that is none, or a setting of another kind."""
    for body in (state.body, *([state.general_body] if state.general_body is not None else [])):
        _check_body(body)
    if state.general_body is not None and state.general_body.mean.shape[1:] != state.body.mean.shape[1:]:
        raise ValueError("its two bodies have different markers")
    # The kernels write by marker: one named twice would be written over.
    if len(set(state.markers.tolist())) != len(state.markers):
        raise ValueError("a marker is learned twice")
    if not (np.diff(np.sort(state.anchors.triples, axis=1), axis=1) > 0).all():
        raise ValueError("an anchor has a marker twice")
    for solvers in state.solvers.values():
        if len(solvers.targets) != len(state.markers):
            raise ValueError("its partial solvers are those of other markers")
    for name, value in (("least_confidence", state.least_confidence), ("least_confidence_in_time", state.certainty.least_confidence)):
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"its {name} is {value:g}, not a share")
    curves = [curve for curve in (*state.calibrations, *_curves(state.certainty.calibration))]
    for curve in curves:
        if (
            curve.margin.shape != curve.right.shape
            or (np.diff(curve.margin) < 0).any()
            or not ((curve.right >= 0) & (curve.right <= 1)).all()
        ):
            raise ValueError("a curve of confidence is broken")
    _check_like("look", state.frame_settings, type(state.frame_settings)())
    if state.training is not None:
        config = state.training.config
        _check_like("recipe", config.rules, type(config.rules)())
        if not 0.0 < config.target_hit_rate <= 1.0 or not (config.miner is None or isinstance(config.miner, str)):
            raise ValueError("its target hit rate or search of partial solvers is not possible")


def _curves(calibration: Any) -> tuple[Any, ...]:
    return calibration if isinstance(calibration, tuple) else ()


def _check_body(body: BodyModel) -> None:
    poses, markers = body.mean.shape[:2]
    if body.load.shape[:3] != (poses, markers, 3) or body.noise.shape != (poses, markers, 3, 3) or body.log_weight.shape != (poses,):
        raise ValueError("the arrays of its body do not fit together")
    # A covariance that is not positive would give NaN scores, and silently no labels.
    try:
        np.linalg.cholesky(body.noise)
    except np.linalg.LinAlgError:
        raise ValueError("a noise of its body is no covariance") from None
    for name in ("within", "between"):
        covariance = getattr(body, name)
        if covariance is not None:
            scale = max(float(np.abs(covariance).max(initial=0.0)), 1e-12)
            lopsided = np.abs(covariance - covariance.transpose(0, 2, 1)).max(initial=0.0) > 1e-6 * scale
            # A rounding error of the file may leave a tiny negative eigenvalue.
            if lopsided or float(np.linalg.eigvalsh(covariance).min(initial=0.0)) < -1e-3 * scale:
                raise ValueError(f"how its bodies differ ({name}) is no covariance")


def _check_like(where: str, value: Any, default: Any) -> None:
    """That settings have the types of the default ones, and are not beyond all use."""
    if is_dataclass(default):
        if type(value) is not type(default):
            raise ValueError(f"its {where} is of another kind")
        for field in fields(default):
            _check_like(f"{where}.{field.name}", getattr(value, field.name), getattr(default, field.name))
    elif isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"its {where} is {value!r}")
    elif isinstance(default, int | float):
        # A whole number stands for a float, but a float for no count.
        whole = isinstance(value, int) and not isinstance(value, bool)
        if not whole and (isinstance(default, int) or not isinstance(value, float)):
            raise ValueError(f"its {where} is {str(value)[:40]!r}, not a number like {default!r}")
        if not abs(value) <= _TIMES_DEFAULT * abs(default) + _BEYOND_DEFAULT:
            raise ValueError(f"its {where} is {value:g}, usual is {default:g}")
    elif isinstance(default, tuple) and default and is_dataclass(default[0]):
        if not isinstance(value, tuple) or len(value) > 1000:
            raise ValueError(f"its {where} is no list of settings")
        for item in value:
            _check_like(where, item, default[0])
