"""What a model file may hold: the plain head and the arrays in, before anything is made of them; then what was made of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from asterism.labelling.body.model import BodyModel
    from asterism.labelling.training.model_state import ModelState

_HEAD = {
    "version": int,
    "marker_set": dict,
    "usual_score": float,
    "least_confidence": float,
    "look": dict,
    "about": dict,
}
_ARRAYS = {
    **{"markers": ("i", 1), "anchor_triples": ("i", 2), "anchor_low": ("f", 2), "anchor_high": ("f", 2)},
    **{"body_mean": ("f", 3), "body_load": ("f", 4), "body_noise": ("f", 4), "body_log_weight": ("f", 1)},
    **{"calibration_0": ("f", 2), "calibration_1": ("f", 2)},
}
"""Arrays that every model has: the kind of their numbers, and how many dimensions."""

_SAMPLE = {
    **{"sample_texts": ("u", 1), "sample_missing": ("u", 1), "sample_planes": ("u", 2)},
    **{"sample_numbers": ("i", 2), "sample_rates": ("f", 1)},
}
"""Arrays of the sample of the training, where there is one."""

_OPEN_ENDED = ("_low", "_high", "_hit_rates")
"""Ends of names of arrays whose numbers need not be finite: intervals that are open at one side, hit rates that no trial has shown."""

_LARGEST = 1e12
_MOST_MARKERS = 2000
_TIMES_DEFAULT, _BEYOND_DEFAULT = 1000.0, 1000.0
"""A setting is at most so many times its default, and so much more: settings bound loops and sizes."""


def check_contents(head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Raise ValueError, naming it, for an entry of the head or an array that is missing, of another type, not finite or absurd."""
    for name, kind in _HEAD.items():
        value = head.get(name)
        if isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else kind):
            raise ValueError(f"its {name} is {value if name not in head else type(value).__name__}, not {kind.__name__}")
    _check_numbers("head", head, 0)
    markers = head["marker_set"].get("names")
    if not isinstance(markers, list) or not all(isinstance(name, str) for name in markers) or len(markers) > _MOST_MARKERS:
        raise ValueError("its markers are no list of names")
    for name, (letter, dimensions) in {**_ARRAYS, **(_SAMPLE if "sample_numbers" in arrays else {})}.items():
        if name not in arrays:
            raise ValueError(f"it lacks {name}")
        if arrays[name].dtype.kind != letter or arrays[name].ndim != dimensions or not arrays[name].size:
            raise ValueError(f"{name} has {arrays[name].dtype} in {arrays[name].shape}")
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not name.endswith(_OPEN_ENDED) and not (np.abs(array) < _LARGEST).all():
            raise ValueError(f"{name} has a number that is not finite or too large")
        if array.dtype.kind == "i" and array.size and not (np.abs(array.astype(np.float64)) < _LARGEST).all():
            raise ValueError(f"{name} has a number that is too large")
    _check_sample(arrays, len(markers))


def check_state(state: ModelState) -> None:
    """Raise ValueError where what was made of a model file could not label: a covariance that is none, or a setting of another kind."""
    for body in (state.body, *([state.general_body] if state.general_body is not None else [])):
        _check_body(body)
    if state.general_body is not None and state.general_body.mean.shape[1:] != state.body.mean.shape[1:]:
        raise ValueError("its two bodies have different markers")
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
            raise ValueError("a curve of confidence is none")
    _check_like("look", state.frame_settings, type(state.frame_settings)())
    if state.training is not None:
        config = state.training.config
        _check_like("recipe", config.rules, type(config.rules)())
        if not 0.0 < config.target_hit_rate <= 1.0 or not (config.miner is None or isinstance(config.miner, str)):
            raise ValueError("its target hit rate or miner is none")


def _curves(calibration: Any) -> tuple[Any, ...]:
    return calibration if isinstance(calibration, tuple) else ()


def _check_body(body: BodyModel) -> None:
    poses, markers = body.mean.shape[:2]
    if body.load.shape[:3] != (poses, markers, 3) or body.noise.shape != (poses, markers, 3, 3) or body.log_weight.shape != (poses,):
        raise ValueError("the arrays of its body do not fit together")
    try:
        np.linalg.cholesky(body.noise)
    except np.linalg.LinAlgError:
        raise ValueError("a noise of its body is no covariance") from None
    for name in ("within", "between"):
        covariance = getattr(body, name)
        if covariance is not None:
            scale = max(float(np.abs(covariance).max(initial=0.0)), 1e-12)
            lopsided = np.abs(covariance - covariance.transpose(0, 2, 1)).max(initial=0.0) > 1e-6 * scale
            if lopsided or float(np.linalg.eigvalsh(covariance).min(initial=0.0)) < -1e-3 * scale:
                raise ValueError(f"how its bodies differ ({name}) is no covariance")


def _check_sample(arrays: Mapping[str, NDArray[Any]], markers: int) -> None:
    """That the lengths of the clips fit the samples, before anything of their size is made."""
    if "sample_numbers" not in arrays:
        return
    numbers, planes, missing = arrays["sample_numbers"], arrays["sample_planes"], arrays["sample_missing"]
    clips = len(arrays["sample_rates"])
    if numbers.shape != (3, clips) or (numbers[2] < 1).any() or planes.dtype != np.uint8 or planes.shape[0] != 4:
        raise ValueError("its sample of the training does not fit together")
    samples = int(numbers[2].sum()) * markers
    if planes.shape[1] != 3 * samples or len(missing) != (samples + 7) // 8:
        raise ValueError("its sample of the training has another length than it says")
    if not ((arrays["sample_rates"] > 0) & (arrays["sample_rates"] < 1e6)).all():
        raise ValueError("a frame rate of its sample is none")


def _check_numbers(where: str, value: Any, depth: int) -> None:
    """Plain values only, numbers finite."""
    if depth > 20:
        raise ValueError(f"its {where} is nested too deeply")
    if isinstance(value, float) and not math.isfinite(value) and where != "about":
        raise ValueError(f"its {where} holds {value}")
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise ValueError(f"its {where} holds {value:.3g}")
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_numbers("about" if where == "about" else str(key), inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check_numbers(where, inner, depth + 1)


def _check_like(where: str, value: Any, default: Any) -> None:
    """That settings have the types of the default ones, and are not beyond all use."""
    if is_dataclass(default):
        if type(value) is not type(default):
            raise ValueError(f"its {where} is {type(value).__name__}")
        for field in fields(default):
            _check_like(f"{where}.{field.name}", getattr(value, field.name), getattr(default, field.name))
    elif isinstance(default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"its {where} is {value!r}")
    elif isinstance(default, int | float):
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
