"""Photograph a scene for a low-light denoising dataset: the protocol, frame by frame.

A sibling of :mod:`eldata` that needs neither a decoder nor a tensor library.
"""

from capture.protocol import PAPER, RELEASED, CaptureProtocol, ProtocolFrame

__all__ = ["PAPER", "RELEASED", "CaptureProtocol", "ProtocolFrame"]
