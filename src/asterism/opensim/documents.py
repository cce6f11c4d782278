"""Values in; the XML documents of OpenSim's tools, out: marker set, scaling, inverse kinematics, inverse dynamics.

Source: the documentation and the property names of OpenSim 4.6, whose tools read them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from asterism.opensim.scaling import BodyScale, PlacedMarker

_VERSION = "40000"


def _document(tag: str, name: str) -> tuple[Element, Element]:
    root = Element("OpenSimDocument", Version=_VERSION)
    return root, SubElement(root, tag, name=name)


def _text(root: Element) -> str:
    indent(root, "\t")
    return '<?xml version="1.0" encoding="UTF-8" ?>\n' + tostring(root, encoding="unicode") + "\n"


def _fill(parent: Element, values: Mapping[str, object]) -> None:
    for tag, value in values.items():
        SubElement(parent, tag).text = str(value).lower() if isinstance(value, bool) else str(value)


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.6f}" for value in values)


def _objects(parent: Element, tag: str, name: str | None = None) -> Element:
    holder = SubElement(parent, tag) if name is None else SubElement(parent, tag, name=name)
    return SubElement(holder, "objects")


def marker_set(name: str, markers: Sequence[PlacedMarker]) -> str:
    """The markers on the bodies of the generic model."""
    root, document = _document("MarkerSet", name)
    objects = SubElement(document, "objects")
    for marker in markers:
        one = SubElement(objects, "Marker", name=marker.name)
        _fill(one, {"socket_parent_frame": f"/bodyset/{marker.body}", "location": _numbers(marker.location), "fixed": marker.centre})
    return _text(root)


def _tasks(parent: Element, name: str, weights: Mapping[str, float], held: Iterable[str]) -> None:
    objects = _objects(parent, "IKTaskSet", name)
    for marker, weight in weights.items():
        _fill(SubElement(objects, "IKMarkerTask", name=marker), {"apply": True, "weight": f"{weight:.4g}"})
    for coordinate in held:
        task = SubElement(objects, "IKCoordinateTask", name=coordinate)
        _fill(task, {"apply": True, "weight": 1, "value_type": "default_value", "value": 0})


@dataclass(frozen=True)
class ScaleTask:
    """What the scale tool is asked to do.

    model, markers, trial  files beside its document: the generic model, the marker set, the trial
    times                  s, from and to
    mass                   kg; None: the generic model's
    scales                 of the bodies; pairs  body -> two markers whose distance tells its factor. Others get theirs as a number
    weights, held          markers of the standing pose with their weights, and coordinates that keep their values there
    placing                whether the trial shows a standing pose, onto which markers are moved
    output                 the scaled model's file
    """

    model: str
    markers: str
    trial: str
    times: tuple[float, float]
    mass: float | None
    scales: Mapping[str, BodyScale]
    pairs: Mapping[str, tuple[str, str]]
    weights: Mapping[str, float]
    held: Sequence[str]
    placing: bool
    output: str


def scale_setup(name: str, task: ScaleTask) -> str:
    """The scale tool's document."""
    root, tool = _document("ScaleTool", name)
    _fill(tool, {"mass": -1 if task.mass is None else f"{task.mass:.3f}", "height": -1, "age": -1})
    maker = SubElement(tool, "GenericModelMaker")
    _fill(maker, {"model_file": task.model, "marker_set_file": task.markers})
    scaler = SubElement(tool, "ModelScaler")
    _fill(scaler, {"apply": True, "scaling_order": "measurements manualScale"})
    measurements = _objects(scaler, "MeasurementSet")
    for key, pair in task.pairs.items():
        one = SubElement(measurements, "Measurement", name=key)
        _fill(one, {"apply": True})
        _fill(SubElement(_objects(one, "MarkerPairSet"), "MarkerPair"), {"markers": " ".join(pair)})
        _fill(SubElement(_objects(one, "BodyScaleSet"), "BodyScale", name=key), {"axes": "X Y Z"})
    manual = _objects(scaler, "ScaleSet")
    for body, scale in task.scales.items():
        if body not in task.pairs:
            _fill(SubElement(manual, "Scale"), {"scales": _numbers([scale.factor] * 3), "segment": body, "apply": True})
    span = _numbers(task.times)
    last = {} if task.placing else {"output_model_file": task.output}
    _fill(scaler, {"marker_file": task.trial, "time_range": span, "preserve_mass_distribution": True, **last})
    # a tool whose placer is not applied says that it failed; without a placer it does not
    if task.placing:
        placer = SubElement(tool, "MarkerPlacer")
        _fill(placer, {"apply": True})
        _tasks(placer, f"{name}_pose", task.weights, task.held)
        _fill(placer, {"marker_file": task.trial, "time_range": span, "max_marker_movement": -1})
        _fill(placer, {"output_model_file": task.output, "output_motion_file": f"{name}_pose.mot"})
    return _text(root)


@dataclass(frozen=True)
class MotionTask:
    """What inverse kinematics and inverse dynamics are asked to do: the files beside their documents, and s, from and to.

    model, trial    the scaled model, and the trial's markers; coordinates  the table that the first writes and the second reads
    weights, held   as in `ScaleTask`
    loads           external loads; cut_off  Hz, of the low-pass filter of the coordinates
    """

    model: str
    trial: str
    times: tuple[float, float]
    coordinates: str
    weights: Mapping[str, float]
    held: Sequence[str]
    loads: str
    cut_off: float


def kinematics_setup(name: str, task: MotionTask) -> str:
    """The document of inverse kinematics."""
    root, tool = _document("InverseKinematicsTool", f"{name}_ik")
    _fill(tool, {"model_file": task.model, "constraint_weight": "Inf", "accuracy": 1e-5})
    _tasks(tool, f"{name}_tasks", task.weights, task.held)
    _fill(tool, {"marker_file": task.trial, "time_range": _numbers(task.times), "report_errors": True})
    _fill(tool, {"output_motion_file": task.coordinates})
    return _text(root)


def dynamics_setup(name: str, task: MotionTask) -> str:
    """The document of inverse dynamics."""
    root, tool = _document("InverseDynamicsTool", f"{name}_id")
    _fill(tool, {"results_directory": ".", "model_file": task.model, "time_range": _numbers(task.times), "forces_to_exclude": "Muscles"})
    _fill(tool, {"external_loads_file": task.loads, "coordinates_file": task.coordinates})
    _fill(tool, {"lowpass_cutoff_frequency_for_coordinates": f"{task.cut_off:g}", "output_gen_force_file": f"{name}_id.sto"})
    return _text(root)
