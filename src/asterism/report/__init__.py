"""Results in; self-contained HTML pages out, that need no network and keep their tables where no script may run."""

from asterism.recording.sides import marker_sides
from asterism.report.boards import board_report
from asterism.report.capturability import capturability_report
from asterism.report.detection import detection_report
from asterism.report.evaluation import evaluation_report
from asterism.report.gait import gait_report
from asterism.report.label import LabelledRecording, label_report
from asterism.report.naming import naming_report
from asterism.report.player import player_script, player_style
from asterism.report.recording import RecordingPage, plot_recording, recording_report
from asterism.report.refinement import refinement_report
from asterism.report.review import ReviewEntry, review_report
from asterism.report.rig import rig_report
from asterism.report.skeleton import marker_bones
from asterism.report.wand import wand_report

__all__ = [
    "LabelledRecording",
    "RecordingPage",
    "ReviewEntry",
    "board_report",
    "capturability_report",
    "detection_report",
    "evaluation_report",
    "gait_report",
    "label_report",
    "marker_bones",
    "marker_sides",
    "naming_report",
    "player_script",
    "player_style",
    "plot_recording",
    "recording_report",
    "refinement_report",
    "review_report",
    "rig_report",
    "wand_report",
]
