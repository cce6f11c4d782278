"""Calibration from boards: images and videos of a chessboard, ChArUco board or grid of circles in, a rig out."""

from asterism.cameras.boards.board import Board, size_of
from asterism.cameras.boards.calibrate import BoardCalibration, calibrate_board
from asterism.cameras.boards.footage import Footage, footage_of
from asterism.cameras.boards.views import BoardViews, find_board

__all__ = ["Board", "BoardCalibration", "BoardViews", "Footage", "calibrate_board", "find_board", "footage_of", "size_of"]
