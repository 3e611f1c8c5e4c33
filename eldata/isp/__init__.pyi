from .libraw import render_libraw as render_libraw
from .rendering import Gamma as Gamma
from .rendering import Rendering as Rendering
from .rendering import render_pair_for_scoring as render_pair_for_scoring
from .response import ResponseCurve as ResponseCurve
from .response import read_response_table as read_response_table
