from .digests import fields_digest as fields_digest
from .named import PROTOCOLS as PROTOCOLS
from .named import default_protocol as default_protocol
from .named import get_protocol as get_protocol
from .named import load_protocol as load_protocol
from .named import protocols_for as protocols_for
from .protocol import ClipProtocol as ClipProtocol
from .protocol import Protocol as Protocol
from .words import comparability as comparability

__all__ = [
    "PROTOCOLS",
    "ClipProtocol",
    "Protocol",
    "comparability",
    "default_protocol",
    "fields_digest",
    "get_protocol",
    "load_protocol",
    "protocols_for",
]
