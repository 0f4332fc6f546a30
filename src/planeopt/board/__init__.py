"""The ChArUco board, and what a camera saw of it: specification, sheet to print, observations."""

from planeopt.board.design import Wishes, as_measured, design, paper_for
from planeopt.board.drawing import as_pdf, as_pixels, as_png
from planeopt.board.file import board_as_toml, board_from_dict, load_board, save_board
from planeopt.board.observations import Observations, SpotOnBoard, View
from planeopt.board.page import Page, lay_out
from planeopt.board.paper import Paper, paper_of
from planeopt.board.pattern import black_rectangles, printed_markers
from planeopt.board.spec import Board

__all__ = [
    "Board",
    "Observations",
    "Page",
    "Paper",
    "SpotOnBoard",
    "View",
    "Wishes",
    "as_measured",
    "as_pdf",
    "as_pixels",
    "as_png",
    "black_rectangles",
    "board_as_toml",
    "board_from_dict",
    "design",
    "lay_out",
    "load_board",
    "paper_for",
    "paper_of",
    "printed_markers",
    "save_board",
]
