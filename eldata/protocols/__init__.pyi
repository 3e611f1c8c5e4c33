from .choosing import default_protocol as default_protocol
from .choosing import get_protocol as get_protocol
from .choosing import protocols_for as protocols_for
from .clips import ClipProtocol as ClipProtocol
from .comparability import comparability as comparability
from .custom import load_protocol as load_protocol
from .digests import fields_digest as fields_digest
from .named import PROTOCOLS as PROTOCOLS
from .protocol import Protocol as Protocol

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
