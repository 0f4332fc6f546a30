"""The ChArUco board, and what a camera saw of it: specification, geometry, observations."""

from planeopt.board.file import board_from_dict, load_board, save_board
from planeopt.board.observations import Observations, SpotOnBoard, View
from planeopt.board.spec import Board

__all__ = [
    "Board",
    "Observations",
    "SpotOnBoard",
    "View",
    "board_from_dict",
    "load_board",
    "save_board",
]
