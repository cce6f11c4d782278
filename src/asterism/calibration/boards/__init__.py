"""Calibration from boards: images and videos of a chessboard, ChArUco board or grid of circles in, a rig out."""

from asterism.calibration.boards.board import Board, size_of
from asterism.calibration.boards.calibrate import BoardCalibration, calibrate_board
from asterism.calibration.boards.footage import Footage, footage_of
from asterism.calibration.boards.views import BoardViews, find_board

__all__ = ["Board", "BoardCalibration", "BoardViews", "Footage", "calibrate_board", "find_board", "footage_of", "size_of"]
